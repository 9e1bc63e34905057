//! Trials of each row, and the one that is recorded or shown.

use super::{Variant, pictures};
use crate::experiments::run::plan::Plan;
use crate::experiments::run::stage::{Stage, Watch};
use crate::experiments::{Context, Seeds, Workers};
use host_sim::base::error::Error;
use host_sim::run::keyboard::Keyboard;
use host_sim::run::regulate::{Outcome, regulate, regulate_on};
use host_sim::run::robot::Record;
use host_sim::scenario::Scenario;
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
            self.records.push(record.clone());
        }
    }
}

/// Trials of each scenario; an interrupted command has fewer. Rows for which `is_shown` is true keep the paths of
/// their trials, and every epoch of the median trial.
pub fn run(
    workers: &Workers,
    rows: &[Scenario],
    seeds: Seeds,
    is_shown: impl Fn(usize) -> bool + Sync,
) -> Result<Vec<Vec<Trial>>, Error> {
    let mut blocks = workers.run_rows("trials", (rows.len(), seeds.trials), |row, trial| {
        let keep = is_shown(row) && trial < PICTURED;
        let mut kept = Trial::default();
        kept.outcome = regulate(&rows[row], seeds.seed, trial as u64, |record| {
            if keep {
                kept.see(record, trial == 0);
            }
        })?;
        Ok(kept)
    })?;
    for (row, (scenario, block)) in rows.iter().zip(&mut blocks).enumerate() {
        // The median trial is drawn in full, and is known only now.
        if is_shown(row) && !block.is_empty() {
            let median = pictures::median_trial(block, scenario.mission.goal);
            if block[median].records.is_empty() {
                let see = |record: &Record| block[median].see(record, true);
                regulate(scenario, seeds.seed, median as u64, see)?;
            }
        }
    }
    Ok(blocks)
}

/// The first trial of the last variant in the pictures, recorded and shown as asked for, and the files.
pub fn first(
    context: &Context,
    watch: &Watch,
    variants: &[Variant],
) -> Result<(Trial, Vec<PathBuf>), Error> {
    let shown = pictured(variants);
    let variant = shown.last().copied().unwrap_or(Variant::PAIR[1]);
    let scenario = variant.apply(&context.scenario);
    let goal = (scenario.mission.goal, &[][..]);
    let stage = Stage::begin(watch, context, &scenario, goal, Keyboard::default())?;
    let mut simulation = stage.simulation()?;
    let mut trial = Trial::default();
    let driven = stage.run(&Plan::default(), &mut simulation, |robot| {
        regulate_on(robot, &scenario, |record| trial.see(record, true))
    })?;
    trial.outcome = driven.outcome;
    Ok((trial, driven.recorded))
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
