//! `cfmmr doctor`: checks the tools and devices for simulation and hardware in the loop, and prints remedies.

use super::arguments::{AxlesArg, BoardArgs, JsonArgs};
use crate::cli::doctor_boards;
use crate::experiments::result::Provenance;
use clap::Args;
use host_sim::base::error::Error;
use output::table::Table;
use remote::images::TARGET;
use rustix::fs::Access;
use serde::Serialize;
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

/// Arguments of `doctor`.
#[derive(Clone, Debug, Args)]
pub struct DoctorArgs {
    /// Boards of a robot to ask for image, stack and faults, instead of the checks of this computer
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Option that sets the number of axles whose boards are read.
    #[command(flatten)]
    pub axles: AxlesArg,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
}

/// Timeout of a program that prints its version. The first call may download a toolchain.
const TIMEOUT: Duration = Duration::from_secs(120);
/// Oldest Python that runs the scripts and their packages.
const OLDEST_PYTHON: Version = [3, 10, 0];

type Version = [u32; 3];

/// Verdict on a tool or device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Finding {
    /// Usable.
    Ok,
    /// Not installed or not connected.
    Missing,
    /// Older than the oldest usable version.
    TooOld,
    /// Present and unusable.
    Unusable,
}

impl Finding {
    fn text(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Missing => "missing",
            Self::TooOld => "too old",
            Self::Unusable => "unusable",
        }
    }
}

/// Check of a tool or device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// Tool or device.
    pub name: &'static str,
    /// True if simulation or hardware in the loop need the tool or device.
    pub needed: bool,
    /// Verdict on the tool or device.
    pub finding: Finding,
    /// Version, name or path; the error if there is none.
    pub found: String,
    /// Remedy; empty if none is needed.
    pub remedy: String,
}

impl Check {
    fn ok(name: &'static str, found: impl Into<String>) -> Self {
        Self {
            name,
            needed: false,
            finding: Finding::Ok,
            found: found.into(),
            remedy: String::new(),
        }
    }

    fn problem(
        name: &'static str,
        finding: Finding,
        found: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            finding,
            remedy: remedy.into(),
            ..Self::ok(name, found)
        }
    }

    fn needed(self) -> Self {
        Self {
            needed: true,
            ..self
        }
    }

    fn fails(&self) -> bool {
        self.needed && self.finding != Finding::Ok
    }
}

/// Checks of this machine, the JSON output of `doctor`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DoctorReport {
    /// True if everything needed is installed.
    pub ok: bool,
    /// Checks of all tools and devices.
    pub checks: Vec<Check>,
}

/// Runs `cfmmr doctor`.
pub fn run(args: &DoctorArgs) -> Result<(), Error> {
    let json = args.json.open()?;
    args.boards.check()?;
    if args.boards.on.is_outside() {
        return doctor_boards::run(args.axles.topology(), &args.boards, &json);
    }
    let groups = fs::read_to_string("/etc/group").unwrap_or_default();
    let checks = vec![
        toolchain("rustc").needed(),
        toolchain("cargo").needed(),
        linker().needed(),
        target().needed(),
        probe_rs(),
        runner(env::var(RUNNER_VARIABLE).ok().as_deref()),
        probe(),
        ports(&serial_ports(Path::new("/dev"), &groups)),
        python(),
    ];
    let failed: Vec<_> = checks.iter().filter(|check| check.fails()).collect();
    let names: Vec<_> = failed.iter().map(|check| check.name).collect();
    let report = DoctorReport {
        ok: failed.is_empty(),
        checks: checks.clone(),
    };
    json.write(&Provenance::default(), &report)?;
    json.print(&table(&checks))?;
    match names.as_slice() {
        [] => json.print("\neverything for simulation and hardware in the loop is installed\n"),
        names => Err(Error::Failure(format!(
            "missing for simulation or hardware in the loop: {}",
            names.join(", ")
        ))),
    }
}

fn table(checks: &[Check]) -> String {
    let mut table = Table::new(["", "state", "found"]).left_aligned();
    // Remedies stand below the table, because a table cell would wrap a command, which could then not be copied.
    let mut remedies = String::new();
    for check in checks {
        let optional = match (check.needed, check.finding) {
            (false, finding) if finding != Finding::Ok => " (optional)",
            _ => "",
        };
        let state = format!("{}{optional}", check.finding.text());
        table.row([check.name, &state, &check.found]);
        if !check.remedy.is_empty() {
            remedies += &format!("\n{}: {}", check.name, check.remedy);
        }
    }
    format!("{table}{remedies}\n")
}

/// Folder of the workspace, whose files select the toolchain; `None` if the folder has moved since the build.
fn workspace() -> Option<PathBuf> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    workspace.is_dir().then_some(workspace)
}

/// Standard output and standard error of a program; an error if the program does not start, fails or exceeds
/// `TIMEOUT`.
fn program_output(program: &str, arguments: &[&str]) -> io::Result<String> {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null());
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    if let Some(workspace) = workspace() {
        command.current_dir(workspace);
    }
    let mut child = command.spawn()?;
    let deadline = Instant::now() + TIMEOUT;
    // The output fits into the pipes' buffers, so the program does not wait for a reader.
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if Instant::now() > deadline {
            child.kill()?;
            child.wait()?;
            return Err(ErrorKind::TimedOut.into());
        }
        thread::sleep(Duration::from_millis(5));
    };
    let mut text = String::new();
    if let Some(mut output) = child.stdout.take() {
        output.read_to_string(&mut text)?;
    }
    if let Some(mut output) = child.stderr.take() {
        output.read_to_string(&mut text)?;
    }
    match status.success() {
        true => Ok(text),
        false => Err(io::Error::other(format!("{status}: {}", text.trim()))),
    }
}

/// First version number in the output of a program, such as `rustc 1.90.0 (…)`; `None` without a version.
fn version(text: &str) -> Option<Version> {
    text.split_whitespace().find_map(|word| {
        let word = word.trim_start_matches('v');
        let mut numbers = word.split('.').map(|part| {
            let digits = part.find(|c: char| !c.is_ascii_digit());
            part.get(..digits.unwrap_or(part.len()))?.parse().ok()
        });
        let (major, minor) = (numbers.next()??, numbers.next()??);
        Some([major, minor, numbers.next().flatten().unwrap_or(0)])
    })
}

fn version_text([major, minor, patch]: Version) -> String {
    format!("{major}.{minor}.{patch}")
}

/// Check of a program that must have version `oldest` or newer.
fn program(name: &'static str, arguments: &[&str], oldest: Version, remedy: &str) -> Check {
    let problem = |finding, found: String| {
        let need = format!("{remedy} (version {} or newer)", version_text(oldest));
        Check::problem(name, finding, found, need)
    };
    match program_output(name, arguments) {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            problem(Finding::Missing, "not on the PATH".to_owned())
        }
        Err(error) => problem(Finding::Unusable, one_line(&error.to_string())),
        Ok(text) => match version(&text) {
            Some(found) if found >= oldest => Check::ok(name, version_text(found)),
            Some(found) => problem(Finding::TooOld, version_text(found)),
            None => problem(Finding::Unusable, one_line(&text)),
        },
    }
}

/// First 60 characters of a text, without line breaks.
fn one_line(text: &str) -> String {
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    line.chars().take(60).collect()
}

/// Rust version in `rust-toolchain.toml`.
fn pinned_toolchain() -> String {
    let text: toml::Table = toml::from_str(include_str!("../../../../rust-toolchain.toml"))
        .expect("the workspace's own file");
    let channel = text["toolchain"]["channel"].as_str();
    channel.unwrap_or_default().to_owned()
}

fn toolchain(name: &'static str) -> Check {
    let channel = pinned_toolchain();
    let oldest = version(&channel).unwrap_or_default();
    let remedy = match program_output("rustup", &["--version"]) {
        Ok(_) => format!("rustup toolchain install {channel}"),
        Err(_) => "install Rust with rustup (https://rustup.rs)".to_owned(),
    };
    program(name, &["--version"], oldest, &remedy)
}

/// Checks the C compiler, which Rust uses as linker.
fn linker() -> Check {
    let name = "cc";
    match program_output(name, &["--version"]) {
        Ok(text) => Check::ok(name, one_line(text.lines().next().unwrap_or_default())),
        Err(error) => Check::problem(
            name,
            Finding::Missing,
            one_line(&error.to_string()),
            "install a C compiler, whose linker Rust uses (Debian: apt-get install gcc)",
        ),
    }
}

/// Checks that the compilation target of the boards is installed.
fn target() -> Check {
    let remedy = format!("rustup target add {TARGET}");
    let arguments = ["--print", "target-libdir", "--target", TARGET];
    match program_output("rustc", &arguments) {
        Ok(text) if Path::new(text.trim()).is_dir() => Check::ok("target", TARGET),
        Ok(_) => Check::problem("target", Finding::Missing, TARGET, remedy),
        Err(error) => Check::problem(
            "target",
            Finding::Missing,
            one_line(&error.to_string()),
            remedy,
        ),
    }
}

/// Oldest probe-rs that has the options of the runner in .cargo/config.toml.
const OLDEST_PROBE_RS: Version = [0, 28, 0];

fn probe_rs() -> Check {
    let remedy = "cargo install probe-rs-tools, to flash boards";
    program("probe-rs", &["--version"], OLDEST_PROBE_RS, remedy)
}

/// Options that keep probe-rs from halting a board at a reset or a hard fault.
const RUNNER_OPTIONS: [&str; 2] = ["--no-catch-reset", "--no-catch-hardfault"];
/// Environment variable that replaces the runner in .cargo/config.toml.
const RUNNER_VARIABLE: &str = "CARGO_TARGET_THUMBV7EM_NONE_EABIHF_RUNNER";

/// Checks the runner of `cargo flash-axle` and `cargo flash-beam`; `replaced_by` is the value of [`RUNNER_VARIABLE`].
fn runner(replaced_by: Option<&str>) -> Check {
    const NAME: &str = "runner of the boards";
    let complete = |runner: &str| RUNNER_OPTIONS.iter().all(|option| runner.contains(option));
    match replaced_by {
        None => Check::ok(NAME, "as in .cargo/config.toml"),
        Some(runner) if complete(runner) || !runner.contains("probe-rs") => {
            Check::ok(NAME, one_line(runner))
        }
        Some(runner) => Check::problem(
            NAME,
            Finding::Unusable,
            one_line(runner),
            format!(
                "unset {RUNNER_VARIABLE}, or add {} to its value: otherwise a board halts at resets and hard faults",
                RUNNER_OPTIONS.join(" ")
            ),
        ),
    }
}

/// Checks that a debug probe is connected: `probe-rs list` prints a line `[0]: NAME -- …` for each.
fn probe() -> Check {
    const NAME: &str = "debug probe";
    let listed = program_output("probe-rs", &["list"]);
    let Ok(text) = listed else {
        let remedy = "install probe-rs first";
        return Check::problem(NAME, Finding::Missing, "cannot be checked", remedy);
    };
    let probes: Vec<_> = text
        .lines()
        .filter_map(|line| line.trim().strip_prefix('[')?.split_once("]: "))
        .map(|(_, probe)| probe.split(" -- ").next().unwrap_or(probe).to_owned())
        .collect();
    match probes.is_empty() {
        false => Check::ok(NAME, probes.join(", ")),
        true => Check::problem(
            NAME,
            Finding::Missing,
            "none",
            "connect a debug probe; on Linux, install the udev rules of probe-rs (https://probe.rs/docs)",
        ),
    }
}

/// Serial port of this machine.
#[derive(Clone, Debug, PartialEq)]
struct Port {
    path: PathBuf,
    /// True if this user may read and write the port.
    permitted: bool,
    /// Group that may read and write the port.
    group: String,
}

/// Serial ports of boards and USB adapters below `devices`; `groups` is the content of /etc/group.
fn serial_ports(devices: &Path, groups: &str) -> Vec<Port> {
    const PREFIXES: [&str; 4] = ["ttyACM", "ttyUSB", "cu.usbmodem", "cu.usbserial"];
    let entries = fs::read_dir(devices).into_iter().flatten().flatten();
    let port = |path: PathBuf| {
        let group = fs::metadata(&path).map(|metadata| metadata.gid());
        let named = |gid: u32| {
            let mut lines = groups.lines().map(|line| line.split(':'));
            lines.find_map(|mut line| {
                let (name, _, number) = (line.next()?, line.next()?, line.next()?);
                (number.parse() == Ok(gid)).then(|| name.to_owned())
            })
        };
        Port {
            permitted: rustix::fs::access(&path, Access::READ_OK | Access::WRITE_OK).is_ok(),
            group: group.ok().and_then(named).unwrap_or("dialout".to_owned()),
            path,
        }
    };
    let mut ports: Vec<_> = entries
        .map(|entry| entry.path())
        .filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            PREFIXES.iter().any(|prefix| name.starts_with(prefix))
        })
        .map(port)
        .collect();
    ports.sort_by(|a, b| a.path.cmp(&b.path));
    ports
}

fn ports(found: &[Port]) -> Check {
    const NAME: &str = "serial ports";
    let names: Vec<_> = found.iter().map(|p| p.path.display().to_string()).collect();
    let names = names.join(", ");
    match found.iter().find(|port| !port.permitted) {
        _ if found.is_empty() => Check::problem(
            NAME,
            Finding::Missing,
            "none",
            "connect a board's USB serial adapter (docs/hil.md)",
        ),
        None => Check::ok(NAME, names),
        Some(port) => Check::problem(
            NAME,
            Finding::Unusable,
            format!("no permission for {}", port.path.display()),
            format!("sudo usermod -aG {} $USER, then log in again", port.group),
        ),
    }
}

/// Checks Python, which runs `tools/scripts/`.
fn python() -> Check {
    let remedy = "install Python 3 with venv and pip, for tools/scripts/";
    program("python3", &["--version"], OLDEST_PYTHON, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn version_is_found_in_program_output() {
        for (text, found) in [
            ("rustc 1.95.0 (59807616e 2026-04-14)", [1, 95, 0]),
            ("rustc 1.96.0-nightly (abc 2026-05-01)", [1, 96, 0]),
            ("Python 3.11", [3, 11, 0]),
            ("tool v12.4.1\nmore 1.0", [12, 4, 1]),
        ] {
            assert_eq!(version(text), Some(found), "{text}");
        }
        for text in ["", "no number", "12", "1.x"] {
            assert_eq!(version(text), None, "{text}");
        }
        assert!(
            version(&pinned_toolchain()) >= Some([1, 95, 0]),
            "{}",
            pinned_toolchain()
        );
    }

    #[test]
    fn runner_catches_neither_resets_nor_hard_faults() {
        let text: toml::Table =
            toml::from_str(include_str!("../../../../.cargo/config.toml")).unwrap();
        let own = text["target"][TARGET]["runner"].as_str().unwrap();
        assert_eq!(runner(Some(own)).finding, Finding::Ok);
        assert_eq!(runner(None).finding, Finding::Ok);
        assert_eq!(runner(Some("openocd.sh")).finding, Finding::Ok);
        for option in RUNNER_OPTIONS {
            let without = runner(Some(&own.replace(option, "")));
            assert_eq!(without.finding, Finding::Unusable, "{option}");
            assert!(without.remedy.contains(option));
        }
    }

    #[test]
    fn serial_ports_are_listed_with_their_group() {
        let devices = tempfile::tempdir().unwrap();
        for name in ["ttyUSB1", "ttyACM0", "tty0", "null"] {
            fs::write(devices.path().join(name), "").unwrap();
        }
        let gid = fs::metadata(devices.path()).unwrap().gid();
        let groups = format!("nobody:x:{}:\nmodem:x:{gid}:someone\n", gid + 1);
        let found = serial_ports(devices.path(), &groups);
        let names: Vec<_> = found.iter().map(|p| p.path.file_name().unwrap()).collect();
        assert_eq!(names, ["ttyACM0", "ttyUSB1"]);
        assert!(found.iter().all(|p| p.permitted && p.group == "modem"));
        assert_eq!(ports(&found).finding, Finding::Ok);
        assert_eq!(ports(&[]).finding, Finding::Missing);
        let mut locked = found;
        locked[1].permitted = false;
        let check = ports(&locked);
        assert_eq!(check.finding, Finding::Unusable);
        assert!(check.found.contains("ttyUSB1") && check.remedy.contains("usermod -aG modem"));
        assert!(serial_ports(Path::new("/no/such/folder"), "").is_empty());
    }
}
