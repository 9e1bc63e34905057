//! `cfmmr faults --virtual`: faults of the boards that run the images that users flash, at several
//! times and with several seeds.

use crate::base::error::Error;
use crate::base::output;
use crate::base::progress::Progress;
use crate::experiments::faults::{FaultsArgs, check_choice, is_chosen, scenario};
use crate::experiments::result::Provenance;
use crate::run::virtual_robot::faults::{
    self, Campaign, Case, Course, End, Entry, Outcome, Reference, SILENCE, catalogue,
};
use crate::run::virtual_robot::tools::coverage;
use crate::targets::images::Images;
use core_algos::safety::Condition;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::sync::Arc;

/// Times of the faults, ms after the press of the button: during the start, and under way.
const TIMES: [u64; 3] = [400, 900, 1600];
/// Page that holds the committed table.
const PAGE: &str = "docs/faults_virtual.md";

/// All runs of one fault.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the fault.
    pub fault: &'static str,
    /// Place of the fault.
    pub seam: &'static str,
    /// Times of the fault.
    pub times: usize,
    /// Cases of a board by itself.
    pub cases: usize,
    /// True if the fault silences the bus: the first of [`SILENCE`] depends on the phase of the bus.
    #[serde(skip)]
    pub silences: bool,
    /// Longest time allowed to all motors off, s, if the robot may stop.
    pub off_within_s: Option<f64>,
    /// Longest time allowed to the last pulse of the struck axle, s.
    pub own_within_s: Option<f64>,
    /// Each run.
    pub outcomes: Vec<Outcome>,
}

impl Row {
    fn of(entry: &Entry, outcomes: Vec<Outcome>) -> Self {
        let times: BTreeSet<u64> = outcomes.iter().map(|run| run.after_ms).collect();
        let driven = matches!(entry.course, Course::Drive(_));
        let may_stop = driven && (!entry.goes_on || !entry.codes.is_empty());
        Self {
            fault: entry.name,
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

    fn markdown(&self) -> String {
        let codes: Vec<&str> = self.codes().into_iter().collect();
        let longest = |pick: fn(&Outcome) -> Option<f64>| {
            let times = self.outcomes.iter().filter_map(pick);
            times.reduce(f64::max)
        };
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.3}"));
        let limit = |value: Option<f64>| value.map_or(String::new(), |v| v.to_string());
        let stops = self.off_within_s.is_some();
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
            number(longest(|run| run.off_s).filter(|_| stops)),
            limit(self.off_within_s),
            number(
                longest(|run| run.own_off_s)
                    .filter(|_| self.own_within_s.is_some())
                    .map(|s| 1e3 * s)
            ),
            limit(self.own_within_s.map(|s| 1e3 * s)),
        )
    }
}

/// The result of the campaign.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// World of the runs.
    pub world: String,
    /// Seeds 1 to this.
    pub seeds: u64,
    /// Fault by fault.
    pub rows: Vec<Row>,
}

impl Report {
    fn markdown(&self) -> String {
        let seconds: Vec<String> = TIMES
            .iter()
            .map(|ms| format!("{} s", *ms as f64 * 1e-3))
            .collect();
        let mut text = format!(
            "# Faults of virtual boards\n\n\
             Printed by `cfmmr faults --virtual`. The default images run on [virtual boards](virtual_boards.md)\n\
             and drive the simulated robot. Each fault occurs {} after the button was pressed, with {} seeds\n\
             each; the seed also selects the affected board or wheel.\n\n\
             - *Goes on*: a second later (or after the restart of the affected board) the robot drives, no node\n\
               has stopped, and the robot is within 2 cm of its place without the fault.\n\
             - *Stops*: no motor carries current after the allowed time. The simulated current decides, not the\n\
               report of a board. The drivers of the affected axle end their last pulse within the allowed time.\n\n\
             A run fails if neither holds, if the first code does not fit ([codes](codes.md)), if a reset or a\n\
             finding is not explained by the fault, if a restart is not reported, or if parameters in the flash\n\
             have changed. *Silence*: bus off, neighbour lost, neighbour stopped or command timeout; which of them\n\
             comes first depends on the phase of the bus. World: {}.\n\n\
             | fault | seam | times × seeds | goes on | stops | other | codes | motors off (s) | allowed (s) | last pulse of struck axle (ms) | allowed (ms) |\n\
             |---|---|---|---|---|---|---|---|---|---|---|\n",
            seconds.join(", "),
            self.seeds,
            self.world,
        );
        for row in &self.rows {
            // Writing to a string does not fail.
            let _ = writeln!(text, "{}", row.markdown());
        }
        let runs: usize = self.rows.iter().map(|row| row.outcomes.len()).sum();
        let rows = self.rows.len();
        let _ = writeln!(
            text,
            "\n{rows} faults, {runs} runs, {} failed.",
            self.wrong()
        );
        text
    }

    fn wrong(&self) -> usize {
        self.rows.iter().map(|row| row.wrong().count()).sum()
    }

    /// Each wrong run, in words.
    fn complaints(&self) -> String {
        let mut text = String::new();
        for row in &self.rows {
            for (run, why) in row.wrong() {
                let (name, seed, after) = (row.fault, run.seed, run.after_ms);
                let _ = writeln!(text, "{name}, seed {seed}, {after} ms: {why}");
            }
        }
        text
    }

    /// The first row that is not in the committed page, or, of few runs, has an end that the page does not.
    fn unexpected(&self, committed: &str, few: bool) -> Option<String> {
        self.rows.iter().map(Row::markdown).find(|row| {
            let known = committed.lines().any(|line| match few {
                true => covers(line, row),
                false => line == row,
            });
            !known
        })
    }
}

/// True if a row of the page contains all ends and codes of a row of fewer runs.
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

/// Every run of these faults.
fn cases<'a>(entries: &[&'a Entry], seeds: u64, times: &[u64]) -> Vec<Case<'a>> {
    let mut cases = Vec::new();
    for entry in entries {
        let times = match entry.course {
            Course::Drive(_) => times,
            _ => &times[..1],
        };
        for &after_ms in times {
            for seed in 1..=seeds {
                cases.push(Case {
                    entry,
                    after_ms,
                    seed,
                });
            }
        }
    }
    cases
}

/// Does all runs on the threads of the current pool.
fn campaign(campaign: &Campaign, entries: &[&Entry], seeds: u64) -> Result<Report, Error> {
    let times = if campaign.quick {
        &TIMES[..1]
    } else {
        &TIMES[..]
    };
    let longest = times.iter().copied().max().unwrap_or(0);
    let all = cases(entries, seeds, times);
    let progress = Progress::new(all.len(), "runs");
    let references: Result<Vec<Reference>, Error> = (1..=seeds)
        .into_par_iter()
        .map(|seed| faults::reference(campaign, seed, longest))
        .collect();
    let references = references?;
    let outcomes: Result<Vec<Outcome>, Error> = all
        .par_iter()
        .with_max_len(1)
        .map(|case| {
            let outcome = faults::run(campaign, case, &references[case.seed as usize - 1]);
            progress.advance();
            outcome.map_err(|error| Error::Failure(format!("{}: {error}", case.entry.name)))
        })
        .collect();
    let mut outcomes = outcomes?.into_iter();
    let rows = entries.iter().map(|entry| {
        let runs = all
            .iter()
            .filter(|case| std::ptr::eq(case.entry, *entry))
            .count();
        Row::of(entry, outcomes.by_ref().take(runs).collect())
    });
    Ok(Report {
        world: campaign.scenario.world.label(),
        seeds,
        rows: rows.collect(),
    })
}

/// Runs the command.
pub fn run(args: &FaultsArgs) -> Result<(), Error> {
    let all = catalogue();
    let names: Vec<&str> = all.iter().map(|entry| entry.name).collect();
    check_choice(&args.only, &names)?;
    let committed = match args.check {
        true => std::fs::read_to_string(PAGE)
            .map_err(|error| Error::input(format!("{PAGE}: {error}")))?,
        false => String::new(),
    };
    let entries: Vec<&Entry> = all
        .iter()
        .filter(|entry| is_chosen(entry.name, &args.only))
        .collect();
    let axle = args.axle_image.as_deref();
    let trials = Campaign {
        scenario: scenario(args.choice.world.as_deref())?,
        images: Images::open(axle, axle, args.beam_image.as_deref())?,
        quick: args.quick,
        coverage: args.coverage.is_some().then(Arc::default),
    };
    if let Some(file) = &args.coverage {
        coverage::check(&trials.images)?;
        output::try_file(file)?;
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.threads.map_or(0, usize::from))
        .build()
        .map_err(|error| Error::Failure(error.to_string()))?;
    let seeds = if args.quick { 1 } else { u64::from(args.seeds) };
    let report = pool.install(|| campaign(&trials, &entries, seeds))?;
    args.json
        .write(&Provenance::of(&trials.scenario, 1), &report)?;
    let page = report.markdown();
    let mut text = page + &report.complaints();
    if let (Some(file), Some(Ok(coverage))) = (
        &args.coverage,
        trials.coverage.as_ref().map(|sum| sum.lock()),
    ) {
        output::write_file(file, coverage.lcov())?;
        text += &format!("\nLine coverage of the firmware\n{coverage}");
    }
    args.json.print_page(&text)?;
    match report.wrong() {
        0 => {}
        wrong => return Err(Error::Failure(format!("{wrong} runs failed"))),
    }
    match report.unexpected(&committed, args.quick) {
        Some(row) if args.check => Err(Error::Failure(format!(
            "differs from {PAGE} (tools/scripts/regenerate.py faults-virtual rewrites it):\n{row}"
        ))),
        _ => Ok(()),
    }
}
