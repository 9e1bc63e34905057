//! Experiments: the commands that compute, each with its arguments, run, table and files.
//!
//! Imports every room but [`cli`](crate::cli). Start with [`posture`]; [`Context`] is what experiments
//! share.

pub mod arguments;
pub mod boards;
pub mod calibrate;
pub mod campaign;
pub mod consistency;
pub mod eval;
pub mod faults;
pub mod follow;
pub mod hil;
pub mod loop_bench;
pub mod params;
pub mod plant_bench;
pub mod posture;
pub mod recorder;
pub mod replay;
pub mod soak;
pub mod sweep;

use crate::base::error::Error;
use crate::base::output::{self, OutputDir};
use crate::base::progress::Progress;
use crate::base::{spelling, toml_file};
use crate::experiments::arguments::Common;
use crate::scenario::Scenario;
use crate::scenario::effect::{Given, Run, Taken};
use crate::world::body::Body;
use rayon::prelude::*;
use serde::Serialize;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use toml::Table;

/// Prints to standard output; a reader that has seen enough is no failure.
pub fn print(text: &str) -> Result<(), Error> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

/// The scenario in a file with the changes of the command line; an error says what to type instead.
pub fn scenario(
    world: Option<&str>,
    file: Option<&Path>,
    changes: &[String],
) -> Result<Scenario, Error> {
    Scenario::load(world, file, changes).map_err(|error| {
        let defaults = Table::try_from(Scenario::default()).unwrap_or_default();
        spelling::on_scenario(error, file, &defaults)
    })
}

/// A result, and the world that it is of.
#[derive(Serialize)]
pub struct InWorld<'a, T> {
    world: &'a str,
    #[serde(flatten)]
    result: &'a T,
}

impl<'a, T: Serialize> InWorld<'a, T> {
    /// A result in a world of this name.
    pub const fn new(world: &'a str, result: &'a T) -> Self {
        Self { world, result }
    }

    /// As JSON.
    pub fn json(&self) -> String {
        output::json(self)
    }
}

/// What an experiment needs besides its own arguments.
pub struct Context {
    /// The scenario with the changes of the command line.
    pub scenario: Scenario,
    /// Seed of all draws.
    pub seed: u64,
    /// The command.
    pub name: String,
    given: Given,
    out: PathBuf,
    json: Option<PathBuf>,
    pool: rayon::ThreadPool,
}

impl Context {
    /// Reads the scenario and prepares the threads; `name` is the command.
    pub fn new(common: &Common, name: &str) -> Result<Self, Error> {
        let scenario = scenario(
            common.choice.world.as_deref(),
            common.scenario.as_deref(),
            &common.set,
        )?;
        let (file, _) = toml_file::read(common.scenario.as_deref())?;
        let given = Given::new(&common.set, &file)?;
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(common.threads.map_or(0, usize::from))
            .build()
            .map_err(|error| Error::Failure(error.to_string()))?;
        Ok(Self {
            scenario,
            seed: common.seed,
            name: name.to_owned(),
            given,
            out: common
                .out
                .clone()
                .unwrap_or_else(|| PathBuf::from("out").join(name)),
            json: common.json.clone(),
            pool,
        })
    }

    /// Refuses keys of `--set` without effect in any of the runs, and reports those of the scenario file.
    pub fn check_keys(&self, taken: Taken, runs: &[Run]) -> Result<(), Error> {
        self.given.check(taken, runs)
    }

    /// Runs `count` independent pieces of work on all threads; results in order of their index,
    /// the first error by index if any failed.
    pub fn run<T: Send>(
        &self,
        label: &'static str,
        count: usize,
        work: impl Fn(usize) -> Result<T, Error> + Sync,
    ) -> Result<Vec<T>, Error> {
        let progress = Progress::new(count, label);
        let results: Vec<Result<T, Error>> = self.pool.install(|| {
            (0..count)
                .into_par_iter()
                // A thread that is done takes over single pieces: no other is left with a long rest.
                .with_max_len(1)
                .map(|index| {
                    let result = work(index);
                    progress.advance();
                    result
                })
                .collect()
        });
        results.into_iter().collect()
    }

    /// The directory for result files.
    pub fn output(&self) -> Result<OutputDir, Error> {
        Ok(OutputDir::create(&self.out)?)
    }

    /// Writes the result where `--json` asked for it, and all files; then prints the table and
    /// where they are.
    pub fn finish(
        &self,
        table: &str,
        result: &impl Serialize,
        files: OutputDir,
    ) -> Result<(), Error> {
        self.finish_with(table, result, files, Vec::new())
    }

    /// The same after a recording, whose files are named too.
    pub fn finish_with(
        &self,
        table: &str,
        result: &impl Serialize,
        mut files: OutputDir,
        recorded: Vec<PathBuf>,
    ) -> Result<(), Error> {
        let world = self.scenario.world.label();
        let json = InWorld::new(&world, result).json();
        if let Some(path) = &self.json {
            output::write_file(path, &json)?;
        }
        files.text("result.json", json);
        let mut written = files.commit()?;
        written.extend(recorded);
        let lines: Vec<String> = written
            .iter()
            .map(|path| format!("wrote {}", path.display()))
            .collect();
        print(&format!("{table}\nworld {world}\n{}\n", lines.join("\n")))
    }

    /// Dimensions of the robot for pictures.
    pub fn body(&self) -> Body {
        Body::of(&self.scenario.world.plant)
    }
}
