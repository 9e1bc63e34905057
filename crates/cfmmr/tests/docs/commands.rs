//! Commands of the pages: commands in `sh` blocks are run, in the order of the page and in one folder
//! per page; commands in the text must be well formed.
//!
//! Blocks whose fence names a file (`toml slippery.toml`) are written to that file. [`NOT_RUN`] lists commands that are
//! not run, with the reason; [`SHORTER`] lists commands with options that shorten them.

use super::pages::{self, Page, root};
use crate::program::with_input;
use cfmmr::cli::Cli;
use clap::Parser;
use clap::error::ErrorKind;
use rayon::prelude::*;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Option names with their values.
type Options = &'static [(&'static str, &'static str)];

/// Options that shorten a command, and why the short command tests the same.
const SHORTER: &[(&str, Options, &str)] = &[
    (
        "posture",
        &[("--trials", "1")],
        "trials do not depend on each other",
    ),
    (
        "calibrate wheels",
        &[("--laps", "1")],
        "more laps are more of the same",
    ),
    (
        "posture --on virtual",
        &[("--stop-after", "0.4")],
        "the whole way is driven by ci.sh",
    ),
    (
        "track --on virtual",
        &[("--stop-after", "1")],
        "the whole way is driven by virtual_boards.rs",
    ),
    (
        "drive --on virtual",
        &[("--stop-after", "1")],
        "the whole way is driven by drive.rs",
    ),
    (
        "hil --on virtual",
        &[("--stop-after", "0.4")],
        "what follows are more ticks of the same kind",
    ),
];

/// Replacements that shorten the committed study of 2000 runs.
const STUDY: &[(&str, &str)] = &[
    ("trials = 250", "trials = 1"),
    ("block = 50", "block = 2"),
    ("time_limit_s = 60.0", "time_limit_s = 5.0"),
];

/// Check that is made instead of running a command.
enum Check {
    /// The alias is in `.cargo/config.toml`.
    Alias,
    /// The script exists and is executable.
    Script,
    /// The file is in the repository.
    File(&'static str),
    /// No check: the command is not part of this project.
    Nothing,
}

/// Beginnings of commands that are not run, with check and reason.
const NOT_RUN: &[(&str, Check, &str)] = &[
    ("git clone ", Check::Nothing, "the address is the reader's"),
    ("cd ", Check::Nothing, "a folder of the reader's"),
    ("rustup target add ", Check::File("ci.sh"), "ci.sh does it"),
    ("tools/cluster/", Check::Script, "needs Slurm"),
    ("python3 tools/cluster/", Check::Nothing, "needs Ray"),
    (
        "python -m cfmmr.mujoco ",
        Check::File("bindings/python/tests/test_mujoco.py"),
        "it parses them",
    ),
    ("pip install ", Check::Nothing, "a tool from elsewhere"),
    ("squeue ", Check::Nothing, "needs Slurm"),
    ("scancel ", Check::Nothing, "needs Slurm"),
    ("podman ", Check::Nothing, "needs a container engine"),
    ("kubectl ", Check::Nothing, "needs a Kubernetes cluster"),
    ("cargo install ", Check::Nothing, "a tool from elsewhere"),
    ("cargo build-", Check::Alias, "ci.sh builds every image"),
    ("cargo build ", Check::File("ci.sh"), "ci.sh does it"),
    ("cargo test ", Check::File("ci.sh"), "ci.sh does it"),
    ("cargo doc ", Check::File("ci.sh"), "ci.sh does it"),
    ("cargo flash-", Check::Alias, "needs a debug probe"),
    ("./ci.sh", Check::Script, "it runs this test"),
    ("bindings/web/build", Check::Script, "ci.sh runs it"),
    (
        "tools/scripts/",
        Check::Script,
        "ci.sh runs it, or it needs what that installs",
    ),
    ("rerun ", Check::Nothing, "a viewer from elsewhere"),
];

/// Start of the paths of real boards' serial ports.
const HARDWARE: &str = "/dev/tty";

/// Placeholders in the commands of the text, and their values.
const PLACEHOLDERS: &[(&str, &str)] = &[
    ("COMMAND", "posture"),
    ("NAME", "ekf"),
    ("K", "2.5"),
    ("I/N", "0/1"),
    ("N", "2"),
    ("…", "line"),
];

/// Words of a command, split as by a shell, without the redirection of output.
fn words(command: &str) -> Vec<String> {
    let words = shlex::split(command).unwrap_or_else(|| panic!("{command}: a quote is open"));
    words.into_iter().take_while(|word| word != ">").collect()
}

/// Arguments of `cfmmr`; `None` if the words are another command.
fn arguments(words: &[String]) -> Option<&[String]> {
    let word = |k: usize| words.get(k).map(String::as_str);
    match word(0)? {
        "cfmmr" | "target/release/cfmmr" => Some(&words[1..]),
        "cargo" => match (word(1), word(2), word(3)) {
            (Some("cfmmr"), ..) => Some(&words[2..]),
            (Some("run"), Some("--release"), None) => Some(&[]),
            (Some("run"), Some("--release"), _) => {
                let end = words.iter().position(|word| word == "--")?;
                Some(&words[end + 1..])
            }
            _ => None,
        },
        _ => None,
    }
}

/// Parses arguments by the parser of `cfmmr`.
fn parse(arguments: &[String]) -> Result<(), String> {
    let name = "cfmmr".to_owned();
    match Cli::try_parse_from(std::iter::once(&name).chain(arguments)) {
        Ok(_) => Ok(()),
        Err(error) => match error.kind() {
            ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => Ok(()),
            _ => Err(error.to_string()),
        },
    }
}

fn set(arguments: &mut Vec<String>, option: &str, value: &str) {
    if let Some(at) = arguments.iter().position(|word| word == option) {
        arguments.drain(at..(at + 2).min(arguments.len()));
    }
    arguments.extend([option.to_owned(), value.to_owned()]);
}

/// Arguments with the shortening options of [`SHORTER`].
fn shorter(arguments: &[String]) -> Vec<String> {
    let mut arguments = arguments.to_vec();
    for (command, options, _) in SHORTER {
        let mut names = command.split(' ');
        let first = names.next().unwrap_or_default();
        let this = match arguments.first() {
            Some(word) if !word.starts_with('-') => word == first,
            _ => first == "posture",
        };
        let virtual_run = arguments.iter().any(|word| word == "virtual");
        if virtual_run && *command == "posture" {
            continue;
        }
        if this && names.all(|name| arguments.iter().any(|word| word == name)) {
            for (option, value) in *options {
                set(&mut arguments, option, value);
            }
        }
    }
    arguments
}

/// Lines of a block; continued lines are joined.
fn lines(text: &str) -> Vec<String> {
    let joined = text.replace("\\\n", " ");
    let lines = joined.lines().map(str::trim);
    lines
        .filter(|line| !line.is_empty())
        .map(Into::into)
        .collect()
}

fn run(folder: &Path, arguments: &[String], input: &str) -> Result<(), String> {
    let run = with_input(folder, arguments, input);
    match run.code {
        Some(0) => Ok(()),
        code => Err(format!("{code:?}: {}", run.error)),
    }
}

fn check(command: &str, words: &[String], check: &Check) -> Result<(), String> {
    let first = words[0].trim_start_matches("./");
    match check {
        Check::Nothing => Ok(()),
        Check::File(path) if root().join(path).is_file() => Ok(()),
        Check::File(path) => Err(format!("{path}: no such file")),
        Check::Alias => {
            let aliases = fs::read_to_string(root().join(".cargo/config.toml")).unwrap();
            match aliases.contains(&format!("\n{} = ", words[1])) {
                true => Ok(()),
                false => Err(format!("{command}: no such alias")),
            }
        }
        Check::Script => {
            use std::os::unix::fs::PermissionsExt;
            let metadata = fs::metadata(root().join(first));
            match metadata.map(|metadata| metadata.permissions().mode() & 0o111) {
                Ok(0) => Err(format!("{first}: cannot be run")),
                Ok(_) => Ok(()),
                Err(error) => Err(format!("{first}: {error}")),
            }
        }
    }
}

/// Runs a line of a block, or makes the check that replaces running.
fn run_line(folder: &Path, line: &str, boards: bool) -> Result<(), String> {
    let (input, command) = match line.strip_prefix("echo ").and_then(|l| l.split_once(" | ")) {
        Some((input, command)) => (words(input).join(" ") + "\n", command),
        None => (String::new(), line),
    };
    let words = words(command);
    if words.is_empty() {
        return Ok(());
    }
    if let Some(arguments) = arguments(&words) {
        parse(arguments)?;
        let on_boards = command.contains("--on virtual");
        if command.contains(HARDWARE) || (on_boards && !boards) {
            return Ok(());
        }
        return run(folder, &shorter(arguments), &input);
    }
    let joined = words.join(" ") + " ";
    match NOT_RUN.iter().find(|(start, ..)| joined.starts_with(start)) {
        Some((_, instead, _)) => check(command, &words, instead),
        None => Err("not a command that this test knows; see NOT_RUN".to_owned()),
    }
}

/// Writes the files that the commands of a page read: blocks with a file name, and the shortened study.
fn prepare(folder: &Path, page: &Page) {
    for block in &page.blocks {
        if let Some(name) = block.info.get(1) {
            fs::write(folder.join(name), &block.text).unwrap();
        }
    }
    let studies = folder.join("tools/studies");
    fs::create_dir_all(&studies).unwrap();
    let name = "tyres_and_sensor.toml";
    let mut study = fs::read_to_string(root().join("tools/studies").join(name)).unwrap();
    for (entry, shorter) in STUDY {
        assert!(study.contains(entry), "{name} has no {entry}");
        study = study.replace(entry, shorter);
    }
    fs::write(studies.join(name), study).unwrap();
}

/// True if the boards' Rust target is installed, as by ci.sh; otherwise commands on virtual boards are only parsed.
fn has_target() -> bool {
    let arguments = "--print target-libdir --target thumbv7em-none-eabihf";
    let output = Command::new("rustc").args(arguments.split(' ')).output();
    output.is_ok_and(|output| {
        let folder = String::from_utf8_lossy(&output.stdout).into_owned();
        output.status.success() && Path::new(folder.trim()).is_dir()
    })
}

/// Runs the commands of a page in a folder; returns their number and the errors.
fn run_page(page: &Page, boards: bool) -> (usize, Vec<String>) {
    let (folder, mut count, mut wrong) = (tempfile::tempdir().unwrap(), 0, Vec::new());
    prepare(folder.path(), page);
    for block in page.blocks.iter().filter(|b| b.language() == "sh") {
        for line in lines(&block.text) {
            count += 1;
            let begun = std::time::Instant::now();
            if let Err(error) = run_line(folder.path(), &line, boards) {
                let place = format!("{}:{}", page.path.display(), block.line);
                wrong.push(format!("{place}: {line}: {error}"));
            }
            println!("{:5.1} s  {line}", begun.elapsed().as_secs_f32());
        }
    }
    (count, wrong)
}

#[test]
fn commands_in_blocks_run() {
    let boards = has_target();
    let pages = pages::all();
    let done = pages.par_iter().map(|page| run_page(page, boards));
    let (counts, wrong): (Vec<usize>, Vec<_>) = done.unzip();
    let (count, wrong) = (counts.iter().sum::<usize>(), wrong.concat());
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
    assert!(count > 20, "only {count} commands");
}

#[test]
fn commands_in_the_text_are_well_formed() {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for page in pages::all() {
        for code in &page.codes {
            let ours = ["cfmmr ", "cargo ", "target/release/"];
            if !ours.iter().any(|start| code.text.starts_with(start)) {
                continue;
            }
            let mut words = words(&code.text);
            for word in &mut words {
                if let Some((_, value)) = PLACEHOLDERS.iter().find(|(name, _)| name == word) {
                    *word = (*value).to_owned();
                }
            }
            let Some(arguments) = arguments(&words) else {
                continue;
            };
            count += 1;
            // A command name alone is checked with --help.
            let mut arguments = arguments.to_vec();
            if arguments.len() == 1 {
                arguments.push("--help".to_owned());
            }
            if let Err(error) = parse(&arguments) {
                let place = format!("{}:{}", page.path.display(), code.line);
                wrong.push(format!("{place}: {}: {error}", code.text));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
    assert!(count > 20, "only {count} commands");
}

#[test]
fn commands_are_split_as_by_a_shell() {
    let taken = words("cfmmr faults --only \"board resets\" -x 'a # b' > out  # comment");
    assert_eq!(
        taken,
        ["cfmmr", "faults", "--only", "board resets", "-x", "a # b"]
    );
    let run = words("cargo run --release   # the experiment");
    assert_eq!(arguments(&run), Some(&[][..]));
    assert_eq!(shorter(&[]), ["--trials", "1"]);
    let given = words("posture --rows pair --trials 20 --seed 2");
    let expected = words("posture --rows pair --seed 2 --trials 1");
    assert_eq!(shorter(&given), expected);
    assert_eq!(shorter(&words("hil --rear x")), words("hil --rear x"));
    assert!(parse(&words("posture --trails 3")).is_err());
    let folder = tempfile::tempdir().unwrap();
    assert!(run_line(folder.path(), "frobnicate --all", false).is_err());
    assert!(run_line(folder.path(), "tools/scripts/no_such.sh", false).is_err());
    assert!(run_line(folder.path(), "cargo build-nothing", false).is_err());
    assert!(run_line(folder.path(), "cfmmr hil --rear /dev/ttyACM0 --bad", false).is_err());
}
