//! `cfmmr faults`: every fault of the catalogue, at several times and with several seeds.

pub mod on_virtual;
pub mod run;

use crate::base::error::Error;
use crate::base::interrupt::watch_for_interrupt;
use crate::base::numbers::whole;
use crate::base::progress::Progress;
use crate::experiments::arguments::WorldChoice;
use crate::experiments::faults::run::{Bounds, Case, End, Outcome};
use crate::experiments::result::{JsonArgs, Provenance};
use crate::scenario::Scenario;
use crate::world::faults::{CATALOGUE, Entry};
use clap::Args;
use core_algos::time::Micros;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::atomic::Ordering::Relaxed;

/// Arguments of `faults`.
#[derive(Clone, Debug, Args)]
pub struct FaultsArgs {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Number of seeds of each fault
    #[arg(long, default_value_t = 2, value_parser = whole::<u32>(1..=1000))]
    pub seeds: u32,
    /// Run only faults whose name contains this text; may be repeated
    #[arg(long, value_name = "TEXT")]
    pub only: Vec<String>,
    /// Inject faults of the boards: virtual boards run the default images
    #[arg(long = "virtual")]
    pub virtual_boards: bool,
    /// With --virtual: each fault at one time with one seed, and a selection of the instants of
    /// power failure
    #[arg(long, requires = "virtual_boards", conflicts_with = "seeds")]
    pub quick: bool,
    /// With --virtual: number of threads; does not change the result [default: one a core]
    #[arg(long, value_name = "N", requires = "virtual_boards", value_parser = whole::<u16>(1..=1024))]
    pub threads: Option<u16>,
    /// With --virtual: write the line coverage of the firmware to this file (lcov)
    #[arg(long, value_name = "FILE", requires = "virtual_boards")]
    pub coverage: Option<PathBuf>,
    /// With --virtual: use this image (ELF) on both axle boards
    #[arg(long, value_name = "ELF", requires = "virtual_boards")]
    pub axle_image: Option<PathBuf>,
    /// With --virtual: use this image (ELF) on the beam board
    #[arg(long, value_name = "ELF", requires = "virtual_boards")]
    pub beam_image: Option<PathBuf>,
    /// With --virtual: exit 1 if a row differs from the committed table, or with --quick, if an
    /// outcome is not in its row
    #[arg(long, requires = "virtual_boards")]
    pub check: bool,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
}

/// Times of the faults, µs after the start of the task: during planning and start, under way with
/// the frame bent, and close to the goal.
pub const TIMES: [Micros; 3] = [300_000, 4_000_000, 9_000_000];

/// All runs of one fault.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the fault.
    pub fault: &'static str,
    /// Number of runs.
    pub runs: usize,
    /// Runs that finished the task.
    pub finished: usize,
    /// Runs that stopped in time and for the right reason.
    pub stopped: usize,
    /// Runs that ended in any other way.
    pub wrong: Vec<End>,
    /// Names of the first reasons.
    pub reasons: BTreeSet<&'static str>,
    /// Longest time from the fault to rest with motors off, s.
    pub stop_s: Option<f64>,
    /// Time allowed for it, s.
    pub stop_within_s: f64,
    /// Largest distance from the goal of the finished runs, m.
    pub error_m: Option<f64>,
    /// Largest speed, m/s.
    pub speed_m_s: f64,
    /// Largest true steering angle |ψ|, rad.
    pub steering_rad: f64,
    /// Largest force of the frame, N.
    pub force_n: f64,
    /// Each run.
    pub outcomes: Vec<Outcome>,
}

impl Row {
    fn of(entry: &Entry, runs: &[Outcome]) -> Self {
        let count = |end: End| runs.iter().filter(|run| run.end == end).count();
        let largest = |pick: fn(&Outcome) -> f64| runs.iter().map(pick).fold(0.0, f64::max);
        let finished = runs.iter().filter(|run| run.end == End::Finished);
        Self {
            fault: entry.name,
            runs: runs.len(),
            finished: count(End::Finished),
            stopped: count(End::Stopped),
            wrong: runs
                .iter()
                .map(|run| run.end)
                .filter(|end| !end.is_right())
                .collect(),
            reasons: runs
                .iter()
                .filter_map(Outcome::code)
                .map(|code| code.entry().name)
                .collect(),
            stop_s: runs.iter().filter_map(|run| run.stop_s).reduce(f64::max),
            stop_within_s: entry.stop_within_s,
            error_m: finished.map(|run| run.error_m).reduce(f64::max),
            speed_m_s: largest(|run| run.speed_m_s),
            steering_rad: largest(|run| run.steering_rad),
            force_n: largest(|run| run.force_n),
            outcomes: runs.to_vec(),
        }
    }
}

/// The result of the campaign.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// World of the runs.
    pub world: String,
    /// Seeds 1 to this.
    pub seeds: u64,
    /// Limits that no run may exceed for more than a moment.
    pub bounds: Bounds,
    /// True if Ctrl-C ended the campaign early.
    #[serde(skip)]
    pub interrupted: bool,
    /// Fault by fault.
    pub rows: Vec<Row>,
}

/// The robot with everything fitted, on tyres that roll with a little resistance: with its motors
/// off it comes to rest.
pub(super) fn scenario(world: Option<&str>) -> Result<Scenario, Error> {
    let mut scenario = Scenario::in_world(world)?;
    let plant = &mut scenario.world.plant;
    plant.rolling_resistance = plant.rolling_resistance.max(0.02);
    scenario.world.sensors.gyro.fitted = true;
    scenario.world.sensors.accelerometer.fitted = true;
    scenario.mission.time_limit_s = 60.0;
    Ok(scenario)
}

/// Runs the campaign on the threads of the current pool.
pub fn campaign(world: Option<&str>, seeds: u64, only: &[String]) -> Result<Report, Error> {
    let (scenario, bounds) = (scenario(world)?, Bounds::default());
    let chosen = |entry: &&Entry| is_chosen(entry.name, only);
    let entries: Vec<&Entry> = CATALOGUE.iter().filter(chosen).collect();
    let each = TIMES.len() * seeds as usize;
    let progress = Progress::new(entries.len() * each, "runs");
    let interrupt = watch_for_interrupt()?;
    let outcomes: Vec<Result<Option<Outcome>, Error>> = (0..entries.len() * each)
        .into_par_iter()
        .with_max_len(1)
        .map(|i| {
            if interrupt.load(Relaxed) {
                return Ok(None);
            }
            let (time, seed) = (
                TIMES[i % each % TIMES.len()],
                (i % each / TIMES.len()) as u64,
            );
            let case = Case {
                entry: entries[i / each],
                after: time,
                seed: 1 + seed,
            };
            let outcome = run::run(&scenario, &case, &bounds)?;
            progress.advance();
            Ok(Some(outcome))
        })
        .collect();
    let outcomes: Vec<Option<Outcome>> = outcomes.into_iter().collect::<Result<_, _>>()?;
    let runs = |chunk: &[Option<Outcome>]| chunk.iter().flatten().cloned().collect::<Vec<_>>();
    let rows = entries.iter().zip(outcomes.chunks(each).map(runs));
    let rows = rows.filter(|(_, runs)| !runs.is_empty());
    Ok(Report {
        world: scenario.world.label(),
        seeds,
        bounds,
        interrupted: interrupt.load(Relaxed),
        rows: rows.map(|(entry, runs)| Row::of(entry, &runs)).collect(),
    })
}

impl Report {
    /// Number of runs that ended in a way they may not.
    pub fn wrong(&self) -> usize {
        self.rows.iter().map(|row| row.wrong.len()).sum()
    }

    /// The page.
    pub fn markdown(&self) -> String {
        let bounds = &self.bounds;
        let runs: usize = self.rows.iter().map(|row| row.runs).sum();
        let mut text = format!(
            "# Faults\n\n\
             Printed by `cfmmr faults`. Each fault is injected {} s, {} s and {} s after the start of the\n\
             task, with {} seeds each. A run passes if the robot finishes its task within {:.0} cm and {:.0}°,\n\
             or stops with its motors off within the allowed time and with a code that fits the fault. In\n\
             addition speed ({} m/s), steering ({:.0}°) and force of the frame ({} N) must not exceed their\n\
             limits for more than {} s. [codes.md](codes.md) explains the codes. World: {}.\n\n\
             | fault | finished | stopped | other | reasons | to rest (s) | allowed (s) | error (cm) | speed (m/s) | steering (°) | force (N) |\n\
             |---|---|---|---|---|---|---|---|---|---|---|\n",
            TIMES[0] as f64 * 1e-6,
            TIMES[1] as f64 * 1e-6,
            TIMES[2] as f64 * 1e-6,
            self.seeds,
            1e2 * run::TOLERANCE[0],
            run::TOLERANCE[1].to_degrees(),
            bounds.speed_m_s,
            bounds.steering_rad.to_degrees(),
            bounds.force_n,
            bounds.moment_s,
            self.world,
        );
        for row in &self.rows {
            let reasons: Vec<&str> = row.reasons.iter().copied().collect();
            let number = |value: Option<f64>, scale: f64, digits: usize| {
                value.map_or(String::new(), |v| format!("{:.digits$}", v * scale))
            };
            let wrong: Vec<String> = row.wrong.iter().map(|end| format!("{end:?}")).collect();
            let allowed = (row.stop_within_s > 0.0).then_some(row.stop_within_s);
            // Writing to a string does not fail.
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {} | {} | {} | {} | {:.2} | {:.0} | {:.0} |",
                row.fault,
                row.finished,
                row.stopped,
                if wrong.is_empty() {
                    "0".to_owned()
                } else {
                    wrong.join(", ")
                },
                reasons.join(", "),
                number(row.stop_s, 1.0, 2),
                number(allowed, 1.0, 1),
                number(row.error_m, 1e2, 1),
                row.speed_m_s,
                row.steering_rad.to_degrees(),
                row.force_n,
            );
        }
        let _ = writeln!(text, "\n{runs} runs, {} failed.", self.wrong());
        text
    }
}

/// True if `--only` selects a fault of this name.
pub(super) fn is_chosen(name: &str, only: &[String]) -> bool {
    only.is_empty() || only.iter().any(|only| name.contains(only.as_str()))
}

/// Checks that each `--only` is in a name.
pub(super) fn check_choice(only: &[String], names: &[&str]) -> Result<(), Error> {
    let unknown = |only: &&String| !names.iter().any(|name| name.contains(only.as_str()));
    match only.iter().find(unknown) {
        Some(only) => Err(Error::input(format!(
            "--only {only}: no fault has this text in its name; the faults are: {}",
            names.join(", ")
        ))),
        None => Ok(()),
    }
}

/// `cfmmr faults`.
pub fn run(args: &FaultsArgs) -> Result<(), Error> {
    let names: Vec<&str> = CATALOGUE.iter().map(|entry| entry.name).collect();
    check_choice(&args.only, &names)?;
    args.json.check()?;
    let world = args.choice.world.as_deref();
    let report = campaign(world, u64::from(args.seeds), &args.only)?;
    args.json
        .write(&Provenance::of(&scenario(world)?, 1), &report)?;
    let page = report.markdown();
    args.json.print_page(&page)?;
    if report.interrupted {
        let text = "interrupted: the table is that of the runs so far";
        return Err(Error::Interrupted(text.to_owned()));
    }
    match report.wrong() {
        0 => Ok(()),
        wrong => Err(Error::Failure(format!("{wrong} runs failed"))),
    }
}
