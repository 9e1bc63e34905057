//! Runs the tests of a module once per change.

use crate::tree::modules;
use crate::{Mutant, module};
use anyhow::{Context, Result, bail};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, IsTerminal};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// Result of the tests with a change.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// The first test that failed.
    Failed(String),
    /// The tests exceeded the timeout.
    TimedOut,
    /// All tests passed.
    Passed,
}

impl Outcome {
    /// Test that detected the change, or `time` for a timeout.
    pub fn noticed_by(&self) -> Option<&str> {
        match self {
            Self::Failed(test) => Some(test),
            Self::TimedOut => Some("time"),
            Self::Passed => None,
        }
    }
}

/// Program with the tests of core-algos, and the timeouts of the tests.
pub struct Tests {
    program: PathBuf,
    folder: PathBuf,
    /// Timeout of the tests by module.
    timeouts: BTreeMap<String, Duration>,
}

impl Tests {
    /// Runs the tests of each module without a change; fails if a test fails.
    pub fn new(program: &Path, folder: &Path, mutants: &[Mutant]) -> Result<Self> {
        let mut tests = Self {
            program: program.to_owned(),
            folder: folder.to_owned(),
            timeouts: BTreeMap::new(),
        };
        for module in modules(mutants) {
            let began = Instant::now();
            if let Outcome::Failed(test) = tests.outcome(0, module)? {
                bail!("{test} fails without a change");
            }
            let timeout = 10 * began.elapsed() + Duration::from_secs(10);
            eprintln!("tests of {module}: {:.1} s", began.elapsed().as_secs_f64());
            tests.timeouts.insert(module.to_owned(), timeout);
        }
        Ok(tests)
    }

    /// Outcome of each change, in order.
    pub fn run(&self, mutants: &[Mutant], jobs: usize) -> Vec<(Mutant, Outcome)> {
        let (next, outcomes) = (AtomicUsize::new(0), Mutex::new(BTreeMap::new()));
        let work = || {
            while let Some(mutant) = mutants.get(next.fetch_add(1, Ordering::Relaxed)) {
                let outcome = self
                    .outcome(mutant.number, module(&mutant.file))
                    .unwrap_or_else(|error| Outcome::Failed(error.to_string()));
                let mut outcomes = outcomes.lock().expect("no thread panics");
                outcomes.insert(mutant.number, (mutant.clone(), outcome));
                if std::io::stderr().is_terminal() {
                    eprint!("\r{} of {}", outcomes.len(), mutants.len());
                }
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..jobs {
                scope.spawn(work);
            }
        });
        let outcomes = outcomes.into_inner().expect("no thread panics");
        outcomes.into_values().collect()
    }

    /// Runs the tests of a module with a change until a test fails.
    fn outcome(&self, number: usize, module: &str) -> Result<Outcome> {
        let mut child = Command::new(&self.program)
            .args([&format!("{module}::"), "--test-threads", "1"])
            .current_dir(&self.folder)
            .env("CFMMR_MUTANT", number.to_string())
            .env("PROPTEST_DISABLE_FAILURE_PERSISTENCE", "1")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .context("the tests do not start")?;
        let stdout = child.stdout.take().context("no output")?;
        let (send, lines) = mpsc::channel();
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if send.send(line).is_err() {
                    break;
                }
            }
        });
        let end = self
            .timeouts
            .get(module)
            .map(|timeout| Instant::now() + *timeout);
        let failed = loop {
            let left = end.map_or(Duration::from_secs(3600), |end| {
                end.saturating_duration_since(Instant::now())
            });
            match lines.recv_timeout(left) {
                Ok(line) if line.ends_with("FAILED") => {
                    let name = line.trim_start_matches("test ");
                    let end = name.find(" ...").unwrap_or(name.len());
                    break Some(Outcome::Failed(name[..end].to_owned()));
                }
                Ok(_) => {}
                Err(mpsc::RecvTimeoutError::Timeout) => break Some(Outcome::TimedOut),
                Err(mpsc::RecvTimeoutError::Disconnected) => break None,
            }
        };
        if let Some(outcome) = failed {
            let _ = child.kill();
            child.wait()?;
            return Ok(outcome);
        }
        match child.wait()?.success() {
            true => Ok(Outcome::Passed),
            false => Ok(Outcome::Failed("the program of the tests".to_owned())),
        }
    }
}
