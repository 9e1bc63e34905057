//! Experiments: what is run, its table and its files. They use no parser of arguments.
//!
//! Trials are functions of a [`Scenario`] and [`Seeds`], computed by [`Workers`]: see
//! [`posture::trials::run`] and [`consistency::measure`]. [`run`] carries out one task, here or on boards
//! elsewhere. [`Context`] is what a command gives an experiment, and where its result goes.

pub mod calibrate;
pub mod campaign;
pub mod consistency;
pub mod eval;
pub mod faults;
pub mod follow;
pub mod paper;
pub mod posture;
#[cfg(feature = "full")]
pub mod replay;
pub mod result;
pub mod run;
pub mod soak;

use crate::BUILD;
use crate::experiments::result::{Json, Provenance};
use host_sim::base::error::Error;
use host_sim::scenario::effect::{GivenKeys, Taken};
use host_sim::scenario::{Scenario, belief, effect};
use host_sim::world::body::Body;
use output::files::{OutputDir, Reserved};
use output::progress::Progress;
use output::terminal::{note, wrapped};
use rayon::prelude::*;
use remote::interrupt::watch_for_interrupt;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// So many threads; without a number one a core.
pub fn pool(threads: Option<u16>) -> Result<rayon::ThreadPool, Error> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.map_or(0, usize::from));
    pool.build()
        .map_err(|error| Error::Failure(error.to_string()))
}

/// Seeds of trials: trial n, from 0, has the draws of seed and n.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seeds {
    /// Seed of all draws.
    pub seed: u64,
    /// Number of trials.
    pub trials: usize,
}

/// Threads of an experiment, and the flag that ends it early.
pub struct Workers {
    interrupt: Arc<AtomicBool>,
    pool: rayon::ThreadPool,
}

impl Workers {
    /// So many threads; without a number one a core. Ctrl-C sets the flag.
    pub fn new(threads: Option<u16>) -> Result<Self, Error> {
        Ok(Self {
            interrupt: watch_for_interrupt()?,
            pool: pool(threads)?,
        })
    }

    /// A flag that Ctrl-C sets.
    pub fn interrupt(&self) -> &Arc<AtomicBool> {
        &self.interrupt
    }

    /// True if Ctrl-C was pressed.
    pub fn is_interrupted(&self) -> bool {
        self.interrupt.load(Relaxed)
    }

    /// Runs `count` independent pieces of work on all threads; results in order of their index, none of
    /// the pieces that an interrupt left undone; the first error by index if any failed.
    pub fn run<T: Send>(
        &self,
        label: &'static str,
        count: usize,
        work: impl Fn(usize) -> Result<T, Error> + Sync,
    ) -> Result<Vec<Option<T>>, Error> {
        let progress = Progress::new(count, label);
        let results: Vec<Result<Option<T>, Error>> = self.pool.install(|| {
            (0..count)
                .into_par_iter()
                // A thread that is done takes over single pieces: no other is left with a long rest.
                .with_max_len(1)
                .map(|index| {
                    if self.is_interrupted() {
                        return Ok(None);
                    }
                    let result = work(index)?;
                    progress.advance();
                    Ok(Some(result))
                })
                .collect()
        });
        results.into_iter().collect()
    }

    /// Runs `count` trials of each row, trial by trial, so that an interrupt leaves trials of every row.
    pub fn run_rows<T: Send>(
        &self,
        trials: &'static str,
        (rows, count): (usize, usize),
        work: impl Fn(usize, usize) -> Result<T, Error> + Sync,
    ) -> Result<Vec<Vec<T>>, Error> {
        let results = self.run(trials, rows * count, |index| {
            work(index % rows, index / rows)
        })?;
        let mut blocks: Vec<Vec<T>> = (0..rows).map(|_| Vec::new()).collect();
        for (index, result) in results.into_iter().enumerate() {
            blocks[index % rows].extend(result);
        }
        Ok(blocks)
    }
}

/// Scenario, seed and destinations of an experiment, from the command line.
pub struct Inputs {
    /// The scenario with the changes of the command line.
    pub scenario: Scenario,
    /// Keys of the scenario that the command line and the scenario file name.
    pub given: GivenKeys,
    /// Seed of all draws.
    pub seed: u64,
    /// Number of threads; one a core without.
    pub threads: Option<u16>,
    /// Folder for result files; `out/COMMAND` without.
    pub out: Option<PathBuf>,
    /// Destination of the result as JSON.
    pub json: Json,
}

/// Scenario, threads and output of an experiment.
pub struct Context {
    /// The scenario with the changes of the command line.
    pub scenario: Scenario,
    /// Seed of all draws.
    pub seed: u64,
    /// The command.
    pub name: String,
    /// Threads.
    pub workers: Workers,
    given: GivenKeys,
    out: PathBuf,
    _reserved: Reserved,
    json: Json,
}

impl Context {
    /// Prepares threads and output of a command. Standard error names what the robot believes otherwise than it is.
    pub fn new(name: &str, inputs: Inputs) -> Result<Self, Error> {
        let Inputs {
            scenario,
            given,
            seed,
            threads,
            out,
            json,
        } = inputs;
        for notice in belief::notices(&scenario) {
            note(format!("cfmmr: {notice}"));
        }
        let workers = Workers::new(threads)?;
        let out = out.unwrap_or_else(|| PathBuf::from("out").join(name));
        // Refused before the computation rather than after it.
        let reserved = Reserved::new(&out);
        Ok(Self {
            scenario,
            seed,
            name: name.to_owned(),
            workers,
            given,
            out,
            _reserved: reserved.map_err(|error| Error::input(format!("--out: {error}")))?,
            json,
        })
    }

    /// Seeds of so many trials.
    pub fn seeds(&self, trials: usize) -> Seeds {
        Seeds {
            seed: self.seed,
            trials,
        }
    }

    /// Command, seed and program, below the title of a report page.
    pub fn subtitle(&self) -> String {
        format!("cfmmr {}, seed {}, {BUILD}", self.name, self.seed)
    }

    /// Refuses keys of `--set` that have an effect in none of the runs. Such keys of the scenario file are reported.
    pub fn check_keys(&self, taken: Taken, runs: &[effect::Run]) -> Result<(), Error> {
        self.given.check(taken, runs)
    }

    /// Refuses keys of `--set` that a real robot has no use for: its parameters are those of its boards.
    pub fn check_mission_keys(&self) -> Result<(), Error> {
        let rps = ("mission.rps", "for a real robot: it has its sensors");
        self.given.check(&[rps], &[])?;
        self.given.check_only(
            "mission",
            "for a real robot: its boards have their parameters, see `cfmmr params`",
        )
    }

    /// Path of the directory for result files.
    pub fn folder(&self) -> &Path {
        &self.out
    }

    /// The directory for result files.
    pub fn output(&self) -> Result<OutputDir, Error> {
        OutputDir::create(&self.out).map_err(|error| Error::input(format!("--out: {error}")))
    }

    /// Writes the result where `--json` asked for it, and all files; then prints the table and their
    /// folder. `failed` says why no run ended as commanded, if none did.
    pub fn finish(
        &self,
        table: &str,
        result: &impl Serialize,
        mut files: OutputDir,
        recorded: &[PathBuf],
        failed: Option<String>,
    ) -> Result<(), Error> {
        let run = Provenance::of(&self.scenario, self.seed);
        self.json.write(&run, result)?;
        files.text("result.json", run.json(result));
        let written = files.commit()?;
        let names = |paths: &[PathBuf]| {
            let names = paths.iter().filter_map(|path| path.file_name());
            names
                .map(|name| name.to_string_lossy().into_owned())
                .collect::<Vec<_>>()
        };
        let mut text = wrapped(&format!(
            "wrote {}: {}",
            self.out.display(),
            names(&written).join(" ")
        ));
        for path in recorded {
            text += &format!("wrote {}\n", path.display());
        }
        let printed = self.json.print(&format!("{table}\n{text}"));
        match failed {
            // Nobody may be there to read it.
            _ if self.workers.is_interrupted() => Err(Error::Interrupted(
                "interrupted: the results are those of what was done".to_owned(),
            )),
            Some(why) => Err(Error::Failure(match printed {
                Ok(()) => why,
                Err(error) => format!("{why}; {error}"),
            })),
            None => printed,
        }
    }

    /// Dimensions of the robot for pictures.
    pub fn body(&self) -> Body {
        Body::of(&self.scenario.world.plant)
    }
}
