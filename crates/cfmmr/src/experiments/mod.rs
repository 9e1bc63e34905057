//! Experiments: runs, tables and files. Command line parsing is in [`cli`](crate::cli).
//!
//! Trials are functions of a [`Scenario`] and [`Seeds`], computed by [`Workers`]: see
//! [`posture::trials::run`] and [`consistency::measure`]. [`run`] drives one mission on in-process, virtual or real
//! boards. [`Context`] holds the inputs of an experiment and the destination of its result.

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
use host_sim::scenario::{Scenario, belief, effect, own};
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

/// Pool of `threads` threads; `None` starts one thread per core.
pub fn pool(threads: Option<u16>) -> Result<rayon::ThreadPool, Error> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.map_or(0, usize::from));
    pool.build()
        .map_err(|error| Error::Failure(error.to_string()))
}

/// Seeds of trials: trial n, from 0, draws from `seed` and n.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seeds {
    /// Seed of all draws.
    pub seed: u64,
    /// Number of trials.
    pub trials: usize,
}

/// Threads of an experiment, and the flag that ends the experiment early.
pub struct Workers {
    interrupt: Arc<AtomicBool>,
    pool: rayon::ThreadPool,
}

impl Workers {
    /// Starts the threads; `None` starts one thread per core. Ctrl-C sets the flag.
    pub fn new(threads: Option<u16>) -> Result<Self, Error> {
        Ok(Self {
            interrupt: watch_for_interrupt()?,
            pool: pool(threads)?,
        })
    }

    /// Flag that Ctrl-C sets.
    pub fn interrupt(&self) -> &Arc<AtomicBool> {
        &self.interrupt
    }

    /// True if Ctrl-C was pressed.
    pub fn is_interrupted(&self) -> bool {
        self.interrupt.load(Relaxed)
    }

    /// Runs `count` independent pieces of work on all threads. Returns results by index, `None` for pieces that an
    /// interrupt skipped, or the first error by index.
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
                // Single pieces balance the load at the end.
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

    /// Runs `count` trials of each row. All rows run trial n before trial n + 1, so an interrupted command has trials
    /// of every row.
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

/// Scenario, seed and destinations of an experiment, as the command line gives them.
pub struct Inputs {
    /// The scenario with the changes of the command line.
    pub scenario: Scenario,
    /// Scenario keys set by the command line and the scenario file.
    pub given: GivenKeys,
    /// Seed of all draws.
    pub seed: u64,
    /// Number of threads [default: one per core].
    pub threads: Option<u16>,
    /// Folder for result files [default: `out/COMMAND`].
    pub out: Option<PathBuf>,
    /// Destination of the result as JSON.
    pub json: Json,
}

/// Scenario, threads and output folder of an experiment that runs.
pub struct Context {
    /// The scenario with the changes of the command line.
    pub scenario: Scenario,
    /// Seed of all draws.
    pub seed: u64,
    /// Name of the command.
    pub name: String,
    /// Threads of the command.
    pub workers: Workers,
    given: GivenKeys,
    out: PathBuf,
    _reserved: Reserved,
    json: Json,
}

impl Context {
    /// Prepares threads and output of a command. Prints notices on standard error if configured and true values of the
    /// robot differ.
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
        // An unusable folder is refused before the computation.
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

    /// Seeds of `trials` trials.
    pub fn seeds(&self, trials: usize) -> Seeds {
        Seeds {
            seed: self.seed,
            trials,
        }
    }

    /// Command, seed, program and parts of the user, below the title of a report page.
    pub fn subtitle(&self) -> String {
        let own = own::title(&self.scenario.own.names());
        format!("cfmmr {}, seed {}, {BUILD}{own}", self.name, self.seed)
    }

    /// Refuses keys of `--set` without effect in any of the runs, and reports such keys of the scenario file.
    pub fn check_keys(&self, taken: Taken, runs: &[effect::Run]) -> Result<(), Error> {
        self.given.check(taken, runs)
    }

    /// Refuses keys of `--set` without effect on a real robot, whose parameters are in its boards.
    pub fn check_mission_keys(&self) -> Result<(), Error> {
        let rps = (
            "mission.rps",
            "for a real robot: the fitted sensors are used",
        );
        self.given.check(&[rps], &[])?;
        self.given.check_only(
            // The number of axles tells the program which boards there are.
            "mission robot.geometry.axles",
            "for a real robot: set parameters in its boards by `cfmmr params`",
        )
    }

    /// Path of the output folder, which may not exist.
    pub fn folder(&self) -> &Path {
        &self.out
    }

    /// Creates the folder for result files.
    pub fn output(&self) -> Result<OutputDir, Error> {
        OutputDir::create(&self.out).map_err(|error| Error::input(format!("--out: {error}")))
    }

    /// Writes the JSON result and all files, then prints the table and the names of the files. `failed` holds the
    /// reason if the command fails although it has results.
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
        let mut text = own::remark(&self.scenario.own);
        text += &wrapped(&format!(
            "wrote {}: {}",
            self.out.display(),
            names(&written).join(" ")
        ));
        for path in recorded {
            text += &format!("wrote {}\n", path.display());
        }
        let printed = self.json.print(&format!("{table}\n{text}"));
        match failed {
            // After an interrupt, an error of printing is ignored.
            _ if self.workers.is_interrupted() => Err(Error::Interrupted(
                "interrupted: the results are incomplete".to_owned(),
            )),
            Some(why) => Err(Error::Failure(match printed {
                Ok(()) => why,
                Err(error) => format!("{why}; {error}"),
            })),
            None => printed,
        }
    }

    /// Dimensions of the robot in pictures.
    pub fn body(&self) -> Body {
        Body::of(&self.scenario.world.plant)
    }
}
