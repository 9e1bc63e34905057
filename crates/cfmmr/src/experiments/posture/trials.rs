//! Trials of each row, and the one that is recorded or shown.

use super::{Plan, Variant, pictures};
use crate::experiments::Context;
use crate::experiments::recorder::Stage;
use host_sim::base::error::Error;
use host_sim::run::regulate::{Outcome, regulate, regulate_on};
use host_sim::run::robot::Record;
use std::path::PathBuf;

/// Trials of a row whose paths are kept for the picture, which shows no more: so the memory does not
/// grow with their number, but for the outcome of each.
const PICTURED: usize = 200;

/// Data of a trial.
#[derive(Clone, Debug, Default)]
pub struct Trial {
    /// Result.
    pub outcome: Outcome,
    /// The midpoint's path, at 10 Hz.
    pub path: Vec<[f64; 2]>,
    /// Every epoch.
    pub records: Vec<Record>,
}

impl Trial {
    /// Takes in the state after one more epoch; `all` keeps it.
    pub fn see(&mut self, record: &Record, all: bool) {
        if self.path.len() * 10 <= records_seen(record) {
            self.path.push([record.midpoint[0], record.midpoint[1]]);
        }
        if all {
            self.records.push(*record);
        }
    }
}

/// Trials that were run.
pub struct Trials {
    /// Scenario, threads and output.
    pub context: Context,
    /// Rows of the table.
    pub variants: Vec<Variant>,
    /// Trials of each row, then those of the rows of the paper's robot, if there are any.
    pub blocks: Vec<Vec<Trial>>,
    /// Files that were recorded.
    pub recorded: Vec<PathBuf>,
}

impl Plan<'_> {
    /// Runs the trials. Of an interrupted command they are fewer.
    pub fn run(self) -> Result<Trials, Error> {
        let (blocks, recorded) = match self.log.is_watched() {
            true => {
                let (trial, recorded) = self.first()?;
                (vec![vec![trial]], recorded)
            }
            false => {
                let blocks = self.all()?;
                let records = self.log.any() && !self.context.is_interrupted();
                (blocks, if records { self.first()?.1 } else { Vec::new() })
            }
        };
        Ok(Trials {
            context: self.context,
            variants: self.variants,
            blocks,
            recorded,
        })
    }

    /// Trials of each scenario.
    fn all(&self) -> Result<Vec<Vec<Trial>>, Error> {
        let goal = self.context.scenario.mission.goal;
        let shown = pictured(&self.variants);
        let is_shown = |row: usize| self.variants.get(row).is_some_and(|it| shown.contains(it));
        let rows = (self.scenarios.len(), self.count);
        let mut blocks = self.context.run_rows("trials", rows, |row, trial| {
            let keep = is_shown(row) && trial < PICTURED;
            let mut kept = Trial::default();
            kept.outcome = regulate(
                &self.scenarios[row],
                self.context.seed,
                trial as u64,
                |record| {
                    if keep {
                        kept.see(record, trial == 0);
                    }
                },
            )?;
            Ok(kept)
        })?;
        for (row, (scenario, block)) in self.scenarios.iter().zip(&mut blocks).enumerate() {
            // The median trial is drawn in full, and is known only now.
            if is_shown(row) && !block.is_empty() {
                let median = pictures::median_trial(block, goal);
                if block[median].records.is_empty() {
                    let see = |record: &Record| block[median].see(record, true);
                    regulate(scenario, self.context.seed, median as u64, see)?;
                }
            }
        }
        Ok(blocks)
    }

    /// The first trial of the last row in the pictures, recorded and shown as asked for, and the files.
    fn first(&self) -> Result<(Trial, Vec<PathBuf>), Error> {
        let shown = pictured(&self.variants);
        let variant = shown.last().copied().unwrap_or(Variant::PAIR[1]);
        let scenario = variant.apply(&self.context.scenario);
        let goal = (scenario.mission.goal, &[][..]);
        let stage = Stage::begin(self.log, &self.context, &scenario, goal)?;
        let mut simulation = stage.simulation()?;
        let mut trial = Trial::default();
        let driven = stage.run(&mut simulation, |robot| {
            regulate_on(robot, &scenario, |record| trial.see(record, true))
        })?;
        trial.outcome = driven.outcome;
        Ok((trial, driven.recorded))
    }
}

/// Rows in the pictures: encoders alone and the joint filter, with the inertial sensors that the rows have; else the
/// first row.
pub fn pictured(variants: &[Variant]) -> Vec<Variant> {
    let pair = |imu| Variant::PAIR.map(|row| Variant { imu, ..row });
    let pair = [true, false].map(pair).into_iter();
    let kept = pair.map(|pair| {
        pair.into_iter()
            .filter(|row| variants.contains(row))
            .collect()
    });
    let found = kept.max_by_key(|rows: &Vec<Variant>| rows.len());
    let found = found.filter(|rows| !rows.is_empty());
    found.unwrap_or_else(|| variants.iter().take(1).copied().collect())
}

/// Epochs since the start of the simulation.
fn records_seen(record: &Record) -> usize {
    (record.time_s * 100.0).round() as usize
}
