//! Starts the program as a user does. Each test program uses a part of this module.
#![allow(dead_code)]

use serde_json::Value;
use std::ffi::OsStr;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// Files of a run on virtual boards that must be equal in repeated runs.
pub const RUN_FILES: [&str; 4] = [
    "log-joint.csv",
    "board-front.log",
    "board-rear.log",
    "board-beam.log",
];

/// Exit code, standard output and standard error of a run of `cfmmr`.
pub struct Run {
    pub code: Option<i32>,
    pub out: String,
    pub error: String,
}

impl From<Output> for Run {
    fn from(output: Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self {
            code: output.status.code(),
            out: text(&output.stdout),
            error: text(&output.stderr),
        }
    }
}

impl Run {
    /// Checks the exit code and returns the run.
    #[track_caller]
    pub fn ends_with(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{}{}", self.out, self.error);
        self
    }

    /// Standard output as JSON.
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap()
    }
}

/// Command `cfmmr` with arguments separated by spaces in a folder, on one thread.
pub fn command(folder: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cfmmr"));
    command.args(arguments.split_whitespace());
    // Tests run in parallel, one per core.
    command.env("RAYON_NUM_THREADS", "1");
    command.current_dir(folder).stdin(Stdio::null());
    command
}

/// Runs `cfmmr` with arguments separated by spaces in a folder.
pub fn cfmmr(folder: &Path, arguments: &str) -> Run {
    command(folder, arguments).output().unwrap().into()
}

/// Standard output of a run that succeeds.
#[track_caller]
pub fn succeed(folder: &Path, arguments: &str) -> String {
    cfmmr(folder, arguments).ends_with(0).out
}

/// Runs `cfmmr` with arguments and standard input in a folder.
pub fn with_input(folder: &Path, arguments: &[impl AsRef<OsStr>], input: &str) -> Run {
    let mut command = command(folder, "");
    let pipes = command.args(arguments).stdin(Stdio::piped());
    let pipes = pipes.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = pipes.spawn().unwrap();
    // A command that refuses its arguments or does not read may end before all input is written.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    child.wait_with_output().unwrap().into()
}

/// Runs each line of a table: arguments, then parts of the error text, separated by bars. Checks that the exit code is
/// 2, that the error has all parts, and that no file is written.
pub fn assert_refused(folder: &Path, command: &str, table: &str) {
    let files = || fs::read_dir(folder).unwrap().count();
    let before = files();
    for line in table.lines().map(str::trim).filter(|line| !line.is_empty()) {
        let mut parts = line.split('|').map(str::trim);
        let arguments = parts.next().unwrap();
        let run = cfmmr(folder, &format!("{command} {arguments}"));
        assert_eq!(run.code, Some(2), "{command} {line}: {}", run.error);
        for part in parts {
            let error = &run.error;
            assert!(
                error.contains(part),
                "{command} {line}: no {part:?} in {error}"
            );
        }
        assert_eq!(files(), before, "{command} {line}: wrote files");
    }
}

/// Content of a JSON file in a folder.
pub fn json_file(folder: &Path, name: &str) -> Value {
    serde_json::from_slice(&fs::read(folder.join(name)).unwrap()).unwrap()
}

/// Names and bytes of all files below a directory.
pub fn files(directory: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    let mut open = vec![directory.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                let name = path.strip_prefix(directory).unwrap();
                found.push((name.display().to_string(), fs::read(&path).unwrap()));
            }
        }
    }
    found.sort();
    found
}
