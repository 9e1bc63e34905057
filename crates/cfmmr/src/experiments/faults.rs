//! Campaign of faults: every known fault at several times and with several seeds.

use core_algos::safety::Condition;
use host_sim::base::error::Error;
use host_sim::scenario::Scenario;
use output::progress::Progress;
use rayon::prelude::*;
use remote::interrupt::watch_for_interrupt;
use remote::virtual_robot::faults::{
    Campaign, End, Entry, FaultCase, Outcome, Reference, RunKind, SILENCE, SharedRobots, model,
    reference, run as run_case,
};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::sync::atomic::Ordering::Relaxed;

/// Times of a fault on virtual boards, ms after the button is pressed: during the start, and under way.
const TIMES: [u64; 3] = [400, 900, 1600];
/// Times of a fault on in-process boards, ms after the start of the task: during planning and start, under way with the
/// frame bent, and close to the goal.
const MODEL_TIMES: [u64; 3] = [300, 4000, 9000];
/// Outcomes and time limits of all runs with one fault.
#[derive(Clone, Debug, Serialize)]
pub struct FaultRow {
    /// Name of the fault.
    pub fault: String,
    /// Signal or part that the fault changes.
    pub seam: &'static str,
    /// Number of different times at which the fault comes.
    pub times: usize,
    /// Number of instants of power failure, or of damages, that all runs of this fault together try.
    pub cases: usize,
    /// True if the fault silences the bus: the phase of the bus decides which code of [`SILENCE`] comes first.
    #[serde(skip)]
    pub silences: bool,
    /// Time limit until all motors are off, s; `None` if the robot must not stop or does not drive.
    pub off_within_s: Option<f64>,
    /// Time limit until the last pulse of the affected axle, s; `None` without such a limit.
    pub own_within_s: Option<f64>,
    /// Outcome of each run.
    pub outcomes: Vec<Outcome>,
}

impl FaultRow {
    fn of(entry: &Entry, outcomes: Vec<Outcome>) -> Self {
        let times: BTreeSet<u64> = outcomes.iter().map(|run| run.after_ms).collect();
        let driven = matches!(entry.kind, RunKind::Drive(_) | RunKind::Model(_));
        let may_stop = driven && (!entry.goes_on || !entry.codes.is_empty());
        Self {
            fault: entry.name.clone(),
            seam: entry.seam,
            times: times.len(),
            cases: outcomes.iter().map(|run| run.cases).sum(),
            silences: SILENCE.iter().all(|code| entry.codes.contains(code)),
            off_within_s: may_stop.then_some(entry.off_within_s),
            own_within_s: entry.own_within_s,
            outcomes,
        }
    }

    fn count(&self, end: &End) -> usize {
        let same = |run: &&Outcome| run.end == *end;
        self.outcomes.iter().filter(same).count()
    }

    fn wrong(&self) -> impl Iterator<Item = (&Outcome, &String)> {
        self.outcomes.iter().filter_map(|run| match &run.end {
            End::Wrong(why) => Some((run, why)),
            _ => None,
        })
    }

    fn codes(&self) -> BTreeSet<&'static str> {
        let reasons = self.outcomes.iter().filter_map(|run| run.reason);
        let name = |reason: Condition| match self.silences && SILENCE.contains(&reason) {
            true => "silence",
            false => reason.entry().name,
        };
        reasons.map(name).collect()
    }

    fn longest(&self, pick: fn(&Outcome) -> Option<f64>) -> Option<f64> {
        let times = self.outcomes.iter().filter_map(pick);
        times.reduce(f64::max)
    }

    /// Longest time to motors off, s; `None` without a time limit, or if no run stopped.
    fn off_s(&self) -> Option<f64> {
        self.longest(|run| run.off_s)
            .filter(|_| self.off_within_s.is_some())
    }

    fn markdown(&self) -> String {
        let codes: Vec<&str> = self.codes().into_iter().collect();
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.3}"));
        let limit = |value: Option<f64>| value.map_or(String::new(), |v| v.to_string());
        let runs = self.outcomes.len();
        let seeds = runs / self.times.max(1);
        let tried = match self.cases > runs {
            true => format!("{} cases, {seeds} seeds", self.cases),
            false => format!("{} × {seeds}", self.times),
        };
        format!(
            "| {} | {} | {tried} | {} | {} | {} | {} | {} | {} | {} | {} |",
            self.fault,
            self.seam,
            self.count(&End::WentOn),
            self.count(&End::Stopped),
            self.wrong().count(),
            codes.join(", "),
            number(self.off_s()),
            limit(self.off_within_s),
            number(
                self.longest(|run| run.own_off_s)
                    .filter(|_| self.own_within_s.is_some())
                    .map(|s| 1e3 * s)
            ),
            limit(self.own_within_s.map(|s| 1e3 * s)),
        )
    }
}

/// Outcomes of the fault campaign.
#[derive(Clone, Debug, Serialize)]
pub struct FaultsReport {
    /// World of the runs; in JSON a field of `run`.
    #[serde(skip)]
    pub world: String,
    /// Number of seeds, from seed 1.
    pub seeds: u64,
    /// True if Ctrl-C ended the campaign early.
    #[serde(skip)]
    pub interrupted: bool,
    /// One row per fault.
    pub rows: Vec<FaultRow>,
}

impl FaultsReport {
    /// The report as a page in Markdown.
    pub fn markdown(&self) -> String {
        let seconds = |[a, b, c]: [u64; 3]| {
            let [a, b, c] = [a, b, c].map(|ms| ms as f64 * 1e-3);
            format!("{a}, {b} or {c}")
        };
        let [position, heading] = model::TOLERANCE;
        let [speed, steering, force] = model::BOUNDS;
        let mut text = format!(
            "# Faults\n\n\
             {}\n\n\
             Printed by `cfmmr faults --on virtual`. Each fault comes at several times with {} seeds each; the seed also\n\
             selects the affected board or wheel. World: {}. *Seam*: signal or part that the fault changes.\n\n\
             - Seams *samples*, *frames*, *boards* and *plant*: the boards run in this process and the robot drives to its\n\
             goal. The fault comes {} s after the start. `cfmmr faults` prints these rows alone; it needs no images.\n\
             - The other seams: the default images run on [virtual boards](virtual_boards.md). The fault comes {} s after\n\
             the start; on a robot of three or more axles, which plans first, after its first motion.\n\
             - *Cases*: instants or damages that the seeds together try; a seed counts as one run.\n\n\
             A run has one of these ends:\n\n\
             - *Goes on*: the true goal error is within {:.0} cm and {:.0}°, or within the estimated 95 % error if that is larger.\n\
             On virtual boards: a second later, or after the restart of the affected board, the robot drives, no node has\n\
             stopped, and the robot is within 2 cm of its place without the fault.\n\
             - *Stops*: all motors are off within the allowed time.\n\
             - *Other*: any other end, a first code that does not fit ([codes](codes.md)), a reset or a finding that the\n\
             fault does not explain, a restart that is not reported, changed parameters in the flash, or a speed beyond\n\
             {speed} m/s, a steering angle beyond {:.0}° or a force of the frame beyond {force} N for more than 0.3 s. The run fails.\n\n\
             *Silence*: bus off, neighbour lost, neighbour stopped or command timeout; which of them comes first depends on\n\
             the phase of the bus.\n\n\
             *Motors off*: time from the fault until no motor of the robot is driven, the longest of the runs: detection, then the\n\
             coordinated stop of the sound axles of about 1 s. On virtual boards the simulated current decides, not the report of\n\
             a board; a motor that its bridge shorts to brake is off. In process the torques are zero and the robot is at rest.\n\
             *Last pulse of struck axle*: the affected axle does not wait for the others after a cut or at its emergency stop.\n\
             *Allowed*: detection 0.1 s and `stop_timeout_s` 2 s; less if a board is lost, more if the robot may drive on first.\n\n\
             | fault | seam | times × seeds | goes on | stops | other | codes | motors off (s) | allowed (s) | last pulse of struck axle (ms) | allowed (ms) |\n\
             |---|---|---|---|---|---|---|---|---|---|---|\n",
            self.verdict(),
            self.seeds,
            self.world,
            seconds(MODEL_TIMES),
            seconds(TIMES),
            1e2 * position,
            heading.to_degrees(),
            steering.to_degrees(),
        );
        for row in &self.rows {
            // Writing to a string does not fail.
            let _ = writeln!(text, "{}", row.markdown());
        }
        text
    }

    /// Numbers of faults, runs and failures, and the longest stop.
    fn verdict(&self) -> String {
        let runs: usize = self.rows.iter().map(|row| row.outcomes.len()).sum();
        let (rows, wrong) = (self.rows.len(), self.wrong());
        let stops = self
            .rows
            .iter()
            .filter_map(|row| Some((row.off_s()?, &row.fault)));
        let longest = stops.max_by(|a, b| a.0.total_cmp(&b.0));
        let longest = longest.map_or(String::new(), |(off_s, fault)| {
            format!(" Longest time to motors off: {off_s:.3} s (*{fault}*).")
        });
        format!("{rows} faults, {runs} runs, {wrong} failed.{longest}")
    }

    /// Number of failed runs.
    pub fn wrong(&self) -> usize {
        self.rows.iter().map(|row| row.wrong().count()).sum()
    }

    /// Text with a line for each failed run.
    pub fn failures_text(&self) -> String {
        let mut text = String::new();
        for row in &self.rows {
            for (run, why) in row.wrong() {
                let (name, seed, after) = (&row.fault, run.seed, run.after_ms);
                let _ = writeln!(text, "{name}, seed {seed}, {after} ms: {why}");
            }
        }
        text
    }

    /// First row of the table that differs from `committed`, the text of docs/faults.md. With `few` runs: first row
    /// with an end or code that the row of `committed` lacks.
    pub fn unexpected(&self, committed: &str, few: bool) -> Option<String> {
        self.rows.iter().map(FaultRow::markdown).find(|row| {
            let known = committed.lines().any(|line| match few {
                true => covers(line, row),
                false => line == row,
            });
            !known
        })
    }
}

/// True if the row `page` of docs/faults.md contains all kinds of ends and all codes of `row`, which has fewer runs.
fn covers(page: &str, row: &str) -> bool {
    let cells =
        |row: &str| -> Vec<String> { row.split('|').map(|c| c.trim().to_owned()).collect() };
    let (page, row) = (cells(page), cells(row));
    let [_, name, _, _, on, stops, _, codes, ..] = row.as_slice() else {
        return false;
    };
    let [_, known, _, _, on_known, stops_known, _, codes_known, ..] = page.as_slice() else {
        return false;
    };
    let fits = |count: &str, known: &str| count == "0" || known != "0";
    let known_codes: Vec<&str> = codes_known.split(", ").collect();
    name == known
        && fits(on, on_known)
        && fits(stops, stops_known)
        && codes
            .split(", ")
            .all(|code| code.is_empty() || known_codes.contains(&code))
}

/// Runs to execute for the given faults: each fault at each of its times with each seed.
fn cases<'a>(entries: &[&'a Entry], seeds: u64, quick: bool) -> Vec<FaultCase<'a>> {
    let mut cases = Vec::new();
    for entry in entries {
        let times = match entry.kind {
            RunKind::Drive(_) => &TIMES[..],
            RunKind::Model(_) => &MODEL_TIMES[..],
            _ => &TIMES[..1],
        };
        for &after_ms in times.iter().take(if quick { 1 } else { times.len() }) {
            cases.extend((1..=seeds).map(|seed| FaultCase {
                entry,
                after_ms,
                seed,
            }));
        }
    }
    cases
}

/// Executes the runs of the given faults on the threads of the current pool.
pub fn campaign(
    campaign: &Campaign,
    entries: &[&Entry],
    seeds: u64,
) -> Result<FaultsReport, Error> {
    let all = cases(entries, seeds, campaign.quick);
    let progress = Progress::new(all.len(), "runs");
    let interrupt = watch_for_interrupt()?;
    let longest = if campaign.quick { TIMES[0] } else { TIMES[2] };
    let references: Vec<Reference> = match entries.iter().any(|entry| entry.needs_images()) {
        true => (1..=seeds)
            .into_par_iter()
            .map(|seed| reference(campaign, seed, longest))
            .collect::<Result<_, Error>>()?,
        false => vec![Reference::new(); seeds as usize],
    };
    let robots = SharedRobots::of(&all);
    let mut order: Vec<usize> = (0..all.len()).collect();
    order.sort_by_cached_key(|&k| robots.group_index(&all[k]));
    let done: Vec<(usize, Option<Outcome>)> = order
        .into_par_iter()
        .with_max_len(1)
        .map(|k| {
            let case = &all[k];
            if interrupt.load(Relaxed) {
                return Ok((k, None));
            }
            let reference = &references[case.seed as usize - 1];
            let outcome = run_case(campaign, case, reference, &robots);
            progress.advance();
            let named = |error| Error::Failure(format!("{}: {error}", case.entry.name));
            let outcome = outcome.map_err(named)?;
            Ok((k, Some(outcome)))
        })
        .collect::<Result<_, Error>>()?;
    let mut outcomes = vec![None; all.len()];
    for (k, outcome) in done {
        outcomes[k] = outcome;
    }
    let rows = entries.iter().map(|entry| {
        let runs = all.iter().zip(&outcomes);
        let runs = runs.filter(|(case, _)| std::ptr::eq(case.entry, *entry));
        FaultRow::of(entry, runs.filter_map(|(_, run)| run.clone()).collect())
    });
    Ok(FaultsReport {
        world: campaign.scenario.world.label(),
        seeds,
        interrupted: interrupt.load(Relaxed),
        rows: rows.filter(|row| !row.outcomes.is_empty()).collect(),
    })
}

/// Scenario with all sensors fitted and rolling resistance, so that the robot comes to rest with its motors off.
/// `changes` are settings KEY=VALUE.
pub fn scenario(world: Option<&str>, changes: &[String]) -> Result<Scenario, Error> {
    let mut scenario = Scenario::parse(world, "", "scenario", changes)?;
    let plant = &mut scenario.world.plant;
    plant.rolling_resistance = plant.rolling_resistance.max(0.02);
    scenario.world.sensors.gyro.fitted = true;
    scenario.world.sensors.accelerometer.fitted = true;
    scenario.mission.time_limit_s = 60.0;
    Ok(scenario)
}
