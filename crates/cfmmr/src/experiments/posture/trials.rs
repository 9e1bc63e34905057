//! Trials of each row, and the recorded or live trial.

use super::{Variant, pictures};
use crate::experiments::run::plan::Plan;
use crate::experiments::run::stage::{Outputs, Stage};
use crate::experiments::{Context, Seeds, Workers};
use host_sim::base::error::Error;
use host_sim::run::keyboard::Keyboard;
use host_sim::run::regulate::{Outcome, regulate, regulate_on};
use host_sim::run::robot::Record;
use host_sim::scenario::Scenario;
use std::path::PathBuf;

/// Trials per row whose paths are kept; bounds memory.
const KEPT_PATHS: usize = 200;

/// Data of a trial.
#[derive(Clone, Debug, Default)]
pub struct Trial {
    /// Outcome of the trial.
    pub outcome: Outcome,
    /// The midpoint's path, at 10 Hz.
    pub path: Vec<[f64; 2]>,
    /// State at every epoch, if kept.
    pub records: Vec<Record>,
}

impl Trial {
    /// Adds the state after an epoch to the path; `all` also keeps the record.
    pub fn push(&mut self, record: &Record, all: bool) {
        if self.path.len() * 10 <= epochs_since_start(record) {
            self.path.push([record.midpoint[0], record.midpoint[1]]);
        }
        if all {
            self.records.push(record.clone());
        }
    }
}

/// Runs the trials of each scenario; an interrupt leaves out trials. Rows with `is_shown` keep paths of their trials
/// and every epoch of the first and of the median trial.
pub fn run(
    workers: &Workers,
    rows: &[Scenario],
    seeds: Seeds,
    is_shown: impl Fn(usize) -> bool + Sync,
) -> Result<Vec<Vec<Trial>>, Error> {
    let mut blocks = workers.run_rows("trials", (rows.len(), seeds.trials), |row, trial| {
        let keep = is_shown(row) && trial < KEPT_PATHS;
        let mut kept = Trial::default();
        kept.outcome = regulate(&rows[row], seeds.seed, trial as u64, |record| {
            if keep {
                kept.push(record, trial == 0);
            }
        })?;
        Ok(kept)
    })?;
    for (row, (scenario, block)) in rows.iter().zip(&mut blocks).enumerate() {
        // The median trial is known only after all trials, so it is repeated to record every epoch.
        if is_shown(row) && !block.is_empty() {
            let median = pictures::median_trial(block, scenario.mission.goal);
            if block[median].records.is_empty() {
                let push_record = |record: &Record| block[median].push(record, true);
                regulate(scenario, seeds.seed, median as u64, push_record)?;
            }
        }
    }
    Ok(blocks)
}

/// Runs the first trial of the last pictured variant, recorded and shown as `outputs` requests. Returns the trial and
/// the recorded files.
pub fn first(
    context: &Context,
    outputs: &Outputs,
    variants: &[Variant],
) -> Result<(Trial, Vec<PathBuf>), Error> {
    let shown = pictured(variants);
    let variant = shown.last().copied().unwrap_or(Variant::PAIR[1]);
    let scenario = variant.apply(&context.scenario);
    let goal = (scenario.mission.goal, &[][..]);
    let stage = Stage::begin(outputs, context, &scenario, goal, Keyboard::default())?;
    let mut simulation = stage.simulation()?;
    let mut trial = Trial::default();
    let driven = stage.run(&Plan::default(), &mut simulation, |robot| {
        regulate_on(robot, &scenario, |record| trial.push(record, true))
    })?;
    trial.outcome = driven.outcome;
    Ok((trial, driven.recorded))
}

/// Variants in the pictures: encoders alone and the joint filter, both with or both without inertial sensors; without
/// either, the first variant.
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
fn epochs_since_start(record: &Record) -> usize {
    (record.time_s * 100.0).round() as usize
}
