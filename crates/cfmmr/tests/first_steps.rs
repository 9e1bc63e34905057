//! First steps of a user: mistakes, help, completions and `cfmmr doctor`.

use crate::program::{Run, assert_refused, command, json_file, succeed};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;

/// Wrong commands, each with texts that its error contains.
const MISTAKES: &str = r#"
postur | postur | posture | --help
posture --trial 3 | --trial' | --trials
posture --trials many | --trials | many | 1 to 1000000
posture --trials -3 | --trials | -3 | 1 to 1000000
posture --seed one | --seed | one | whole number of at least 0
posture --seed -1 | --seed | -1 | whole number of at least 0
posture --rows both | --rows | both | all, pair
posture --json | --json | <FILE>
posture --scenario none.toml | --scenario none.toml | TOML | cfmmr config > FILE
posture --scenario key.toml | key.toml | line 2 | frictoin | did you mean plant.friction? | cfmmr keys
posture --scenario unit.toml | unit.toml | line 2: plant.strip_length_m | expected a number
posture --scenario range.toml | bus.loss | 1.5 | 0 | 1
posture --set friction=1 | friction | did you mean plant.friction?
posture --set plant.friction=high | plant.friction | high | expected a number
posture --set plant.friction | --set plant.friction | KEY=VALUE | for example
posture --from 1m,2m,0 | --from | X = 1m | -50 | 50 m, | --from -1.5,0.2,90deg
posture --from 1,2,90 | --from | PHI = 90 | -6.28319 | 6.28319 rad | 90deg
follow --path fig8 | --path fig8 | line, circle, figure-eight | CSV
follow --path other.csv | other.csv | line 1 | x and y
follow --speed 20cm | --speed <M/S> | 20cm | plain number
follow --speed -0.1 | --speed -0.1 | from 0.02 to 0.25 m/s
hil | --on virtual | --on serial: | cfmmr doctor
hil --on serial:front=/dev/no-such-port | front=/dev/no-such-port | serial port | cfmmr doctor
params lst | lst | list | --help
calibrate wheel | wheel | wheels, gauges, imu
calibrate imu --seed x | --seed | x | whole number of at least 0
replay none.mcap | none.mcap | cfmmr posture --log FILE
"#;

#[test]
fn error_of_a_mistake_names_what_to_type() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, content: &str| fs::write(folder.path().join(name), content).unwrap();
    write("key.toml", "[plant]\nfrictoin = 0.5\n");
    write("unit.toml", "[plant]\nstrip_length_m = \"370 mm\"\n");
    write("range.toml", "[bus]\nloss = 1.5\n");
    write("other.csv", "a\n1\n");
    assert_refused(folder.path(), "", MISTAKES);
}

/// Names of all subcommands.
fn commands() -> Vec<String> {
    let command = cfmmr::cli::command();
    let names = command
        .get_subcommands()
        .map(|sub| sub.get_name().to_owned());
    names.collect()
}

#[test]
fn completions_work_in_bash_and_contain_every_command() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = succeed(folder.path(), &format!("completions {shell}"));
        for name in commands() {
            assert!(script.contains(&name), "{shell}: no {name}");
        }
        fs::write(folder.path().join(shell), script).unwrap();
    }
    let bash = |script: &str| -> Run {
        let mut command = Command::new("bash");
        let command = command.args(["-c", script]).current_dir(folder.path());
        command.output().unwrap().into()
    };
    bash("bash -n bash").ends_with(0);
    let complete = |words: &str, place: usize| {
        let script = format!(
            "source ./bash; COMP_WORDS=({words}); COMP_CWORD={place}; \
             _cfmmr cfmmr \"${{COMP_WORDS[COMP_CWORD]}}\" \"${{COMP_WORDS[COMP_CWORD-1]}}\"; \
             echo \"${{COMPREPLY[@]}}\""
        );
        bash(&script).out.trim().to_owned()
    };
    assert_eq!(complete("cfmmr pos", 1), "posture");
    assert_eq!(complete("cfmmr hil --comp", 2), "--compare");
    assert_refused(folder.path(), "completions", "tcl | bash");
}

/// Folder of fake programs that is the whole PATH of a test.
struct Machine(tempfile::TempDir);

impl Machine {
    fn new() -> Self {
        let machine = Self(tempfile::tempdir().unwrap());
        machine.prints("rustc", "rustc 99.1.0 (abcdef 2026-01-01)");
        machine.prints("cargo", "cargo 99.1.0 (abcdef 2026-01-01)");
        machine.prints("cc", "cc (Debian) 12.2.0");
        machine.with_target(true);
        machine
    }

    fn program(&self, name: &str, script: &str) {
        let path = self.0.path().join(name);
        fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn prints(&self, name: &str, line: &str) {
        self.program(name, &format!("echo '{line}'"));
    }

    /// Adds a fake compiler; the libraries of the boards' target are installed if `there` is true.
    fn with_target(&self, there: bool) {
        let libraries = match there {
            true => self.0.path().to_owned(),
            false => self.0.path().join("no-such-libraries"),
        };
        self.program(
            "rustc",
            &format!(
                "case \"$1\" in --print) echo {} ;; *) echo 'rustc 99.1.0 (a b)' ;; esac",
                libraries.display()
            ),
        );
    }

    fn without(&self, name: &str) {
        fs::remove_file(self.0.path().join(name)).unwrap();
    }

    /// Exit code, result of each check, and the whole output.
    fn doctor(&self) -> (i32, BTreeMap<String, Value>, String) {
        let folder = self.0.path();
        let mut command = command(folder, "doctor --json result.json");
        let run = Run::from(command.env("PATH", folder).output().unwrap());
        let result = json_file(folder, "result.json");
        let code = run.code.unwrap();
        assert_eq!(result["ok"], code == 0);
        let checks = result["checks"].as_array().unwrap().iter();
        let checks =
            checks.map(|check| (check["name"].as_str().unwrap().to_owned(), check.clone()));
        (code, checks.collect(), run.out + &run.error)
    }
}

#[test]
fn doctor_reports_each_tool_and_prints_remedies() {
    let machine = Machine::new();
    let (code, checks, output) = machine.doctor();
    assert_eq!(code, 0, "{output}");
    for name in ["rustc", "cargo", "cc", "target"] {
        assert_eq!(checks[name]["finding"], "ok", "{output}");
        assert_eq!(checks[name]["needed"], true);
    }
    for name in ["probe-rs", "debug probe", "python3"] {
        assert_eq!(checks[name]["finding"], "missing", "{output}");
        assert_eq!(checks[name]["needed"], false);
        assert!(!checks[name]["remedy"].as_str().unwrap().is_empty());
    }
    assert!(output.contains("missing (optional)"), "{output}");
    let lines = |name: &str| output.lines().filter(|line| line.starts_with(name)).count();
    assert!(
        checks.keys().all(|name| lines(&format!("{name}  ")) == 1),
        "{output}"
    );

    machine.prints("python3", "Python 3.11.2");
    machine.program(
        "probe-rs",
        "case \"$1\" in list) echo 'The following debug probes were found:'; \
         echo '[0]: STLink V3 -- 0483:374e:001A (ST-LINK)' ;; *) echo 'probe-rs 0.29.1' ;; esac",
    );
    let (_, checks, _) = machine.doctor();
    assert_eq!(checks["python3"]["found"], "3.11.2");
    assert_eq!(checks["probe-rs"]["finding"], "ok");
    assert_eq!(checks["debug probe"]["found"], "STLink V3");
}

#[test]
fn doctor_fails_for_missing_needed_tools_only() {
    let case = |remove_or_replace: &dyn Fn(&Machine), name: &str, finding: &str, remedy: &str| {
        let machine = Machine::new();
        remove_or_replace(&machine);
        let (code, checks, output) = machine.doctor();
        assert_eq!(code, 1, "{name}: {output}");
        assert_eq!(checks[name]["finding"], finding, "{output}");
        let printed_remedy = checks[name]["remedy"].as_str().unwrap();
        assert!(printed_remedy.contains(remedy), "{name}: {printed_remedy}");
        assert!(output.contains(remedy), "{name}: {output}");
        let last = output.lines().last().unwrap();
        assert!(last.starts_with("cfmmr:") && last.contains(name), "{last}");
    };
    let missing = |name: &'static str| move |machine: &Machine| machine.without(name);
    case(&missing("rustc"), "rustc", "missing", "https://rustup.rs");
    case(&missing("cargo"), "cargo", "missing", "https://rustup.rs");
    case(&missing("cc"), "cc", "missing", "C compiler");
    let old = |name: &'static str, line: &'static str| move |m: &Machine| m.prints(name, line);
    case(
        &old("cargo", "cargo 1.80.0 (a b)"),
        "cargo",
        "too-old",
        "1.95.0",
    );
    case(
        &|machine: &Machine| {
            machine.prints("cargo", "cargo 1.80.0 (a b)");
            machine.prints("rustup", "rustup 1.28.0");
        },
        "cargo",
        "too-old",
        "rustup toolchain install 1.95.0",
    );
    case(
        &|machine: &Machine| machine.with_target(false),
        "target",
        "missing",
        "rustup target add thumbv7em-none-eabihf",
    );

    let machine = Machine::new();
    machine.prints("python3", "Python 3.5.1");
    machine.program("probe-rs", "echo broken >&2; exit 3");
    let (code, checks, output) = machine.doctor();
    assert_eq!(code, 0, "optional things never fail: {output}");
    assert_eq!(checks["python3"]["finding"], "too-old");
    assert_eq!(checks["probe-rs"]["finding"], "unusable");
}
