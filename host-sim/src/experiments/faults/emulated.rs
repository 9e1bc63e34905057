//! `cfmmr faults --emulated`: the faults on boards in QEMU, and the same run in process beside each.
//!
//! Bus, sensors, motors and frame are simulated on the host, so their faults reach the boards as
//! frames and samples. Boards that fail are processes that are killed, stopped and started again.

use crate::base::error::Error;
use crate::base::interrupt::watch_for_interrupt;
use crate::base::progress::Progress;
use crate::experiments::faults::run::{self, Bounds, Case, End, Outcome};
use crate::experiments::faults::{FaultsArgs, check_choice, is_chosen, scenario};
use crate::experiments::result::Provenance;
use crate::run::bit_compare::Trace;
use crate::run::simulation::Simulation;
use crate::scenario::Scenario;
use crate::targets::board_log::BoardLog;
use crate::targets::emulated::{self, Images, Wire};
use crate::targets::{Failure, FailureMode, Report as BoardReport};
use crate::world::faults::{CATALOGUE, Entry, Fault};
use core_algos::time::Micros;
use core_algos::topology::Role;
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// Time of the faults, µs after the start of the task: under way with the frame bent.
const AFTER: Micros = 4_000_000;
const SEED: u64 = 1;
/// Page that holds the committed table.
const PAGE: &str = "docs/faults_emulated.md";

/// Boards that fail without the host's doing, and the fault of the catalogue that this is.
const UNANNOUNCED: [(&str, &str, Role, FailureMode); 4] = [
    (
        "rear board ends by itself",
        "rear board lost",
        Role::Rear,
        FailureMode::Crash,
    ),
    (
        "beam board ends by itself",
        "beam board lost",
        Role::Beam,
        FailureMode::Crash,
    ),
    (
        "front board hangs",
        "front board lost",
        Role::Front,
        FailureMode::Hang,
    ),
    (
        "rear board hangs",
        "rear board lost",
        Role::Rear,
        FailureMode::Hang,
    ),
];

/// One run to do.
#[derive(Clone, Copy)]
struct Trial {
    name: &'static str,
    entry: &'static Entry,
    /// A board that fails, in another way than the entry's.
    unannounced: Option<(Role, FailureMode)>,
}

/// Every fault of the catalogue, and boards that fail unannounced.
fn trials() -> Vec<Trial> {
    let catalogue = CATALOGUE.iter().map(|entry| Trial {
        name: entry.name,
        entry,
        unannounced: None,
    });
    let others = UNANNOUNCED.iter().filter_map(|&(name, same, role, mode)| {
        let entry = CATALOGUE.iter().find(|entry| entry.name == same)?;
        Some(Trial {
            name,
            entry,
            unannounced: Some((role, mode)),
        })
    });
    catalogue.chain(others).collect()
}

impl Trial {
    /// Kind and place of the fault.
    fn seam(&self) -> &'static str {
        match (self.unannounced, self.entry.fault) {
            (Some((_, FailureMode::Hang)), _) => "process stopped, unannounced",
            (Some(_), _) => "process killed, unannounced",
            (None, Fault::None) => "",
            (None, Fault::Bus(_) | Fault::Partition(_)) => "frames on the bus",
            (None, Fault::Reset(..)) => "process killed and restarted",
            (None, Fault::Loss(_)) => "process killed",
            (None, Fault::Freeze(..) | Fault::SlowClock(..)) => "process stopped and continued",
            (
                None,
                Fault::MotorWeak(..)
                | Fault::MotorStuckOn(..)
                | Fault::WheelLifted(_)
                | Fault::FrameSnapped,
            ) => "plant",
            (None, Fault::Reported(..)) => "drivers' reports, plant",
            (None, _) => "samples",
        }
    }
}

/// One fault on emulated boards.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the fault.
    pub fault: &'static str,
    /// Kind and place of the fault.
    pub seam: &'static str,
    /// Outcome of the run.
    pub outcome: Outcome,
    /// Ticks of the run.
    pub ticks: usize,
    /// First difference from the run in process.
    pub difference: Option<String>,
    /// The boards.
    pub boards: Vec<BoardReport>,
}

impl Row {
    /// True if the outcome is allowed and identical to the run in process.
    fn is_right(&self) -> bool {
        self.outcome.end.is_right() && self.difference.is_none()
    }

    fn markdown(&self) -> String {
        let outcome = &self.outcome;
        let number = |value: Option<f64>, digits: usize| {
            value.map_or(String::new(), |value| format!("{value:.digits$}"))
        };
        let end = match outcome.end {
            End::Finished => "finished".to_owned(),
            End::Stopped => "stopped".to_owned(),
            other => format!("{other:?}"),
        };
        let finished = outcome.end == End::Finished;
        format!(
            "| {} | {} | {end} | {} | {} | {} | {} | {} |",
            self.fault,
            self.seam,
            outcome.code().map_or("", |code| code.entry().name),
            number(outcome.stop_s, 2),
            number(finished.then_some(1e2 * outcome.error_m), 1),
            self.ticks,
            self.difference.as_deref().unwrap_or("identical"),
        )
    }
}

/// The result of the campaign.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// World of the runs.
    pub world: String,
    /// Fault by fault.
    pub rows: Vec<Row>,
}

impl Report {
    /// The page.
    fn markdown(&self) -> String {
        let mut text = format!(
            "# Faults on emulated boards\n\n\
             Printed by `cfmmr faults --emulated`. The faults of [faults.md](faults.md), and failures of\n\
             the boards themselves, with the three boards in QEMU: {} s after the start of the task, seed\n\
             {SEED}, to the end of the run. *Seam* is the place of the fault. The host simulates inputs, bus\n\
             and motors of the boards; each board is a process. *Identical*: every torque, frame and output\n\
             of the lead node, and the outcome, equal bit by bit those of the nodes in the program. World: {}.\n\n\
             | fault | seam | ended | first reason | to rest (s) | error (cm) | ticks | compared with in process |\n\
             |---|---|---|---|---|---|---|---|\n",
            AFTER as f64 * 1e-6,
            self.world,
        );
        for row in &self.rows {
            // Writing to a string does not fail.
            let _ = writeln!(text, "{}", row.markdown());
        }
        let wrong = self.rows.iter().filter(|row| !row.is_right()).count();
        let _ = writeln!(text, "\n{} runs, {wrong} failed.", self.rows.len());
        text
    }

    /// Largest stack use of each board.
    fn stacks(&self) -> String {
        let boards = || self.rows.iter().flat_map(|row| &row.boards);
        let mut text = String::new();
        for role in Role::ALL.map(Role::name) {
            let stacks = boards().filter(|board| board.role == role);
            let most = stacks
                .filter_map(|board| board.stack)
                .max_by_key(|stack| stack.used_bytes);
            if let Some(stack) = most {
                let (used, budget) = (stack.used_bytes, stack.budget_bytes);
                let _ = writeln!(text, "{role} board: stack {used} of {budget} bytes");
            }
        }
        text
    }

    /// The first row that is not in the committed page.
    fn unexpected(&self, committed: &str) -> Option<String> {
        let mut rows = self.rows.iter().map(Row::markdown);
        rows.find(|row| !committed.lines().any(|line| line == row))
    }
}

/// A run that is recorded; what it came to and what the boards did.
fn recorded(
    simulation: &mut Simulation,
    scenario: &Scenario,
    case: &Case,
) -> Result<(Outcome, Trace), Error> {
    simulation.record_trace();
    let outcome = run::run_on(simulation, scenario, case, &Bounds::default())?;
    Ok((outcome, simulation.take_trace().unwrap_or_default()))
}

/// Source of the boards.
struct Source<'a> {
    qemu: &'a str,
    images: Images,
    interrupt: Arc<AtomicBool>,
}

impl Source<'_> {
    /// One run on emulated boards and the same in process.
    fn compare(&self, trial: &Trial, scenario: &Scenario) -> Result<Row, Error> {
        let case = Case {
            entry: trial.entry,
            after: AFTER,
            seed: SEED,
        };
        if self.interrupt.load(Relaxed) {
            return Err(Error::Interrupted("interrupted".to_owned()));
        }
        let (fault, tick) = (trial.entry.fault, case.tick(scenario));
        let logs = Role::ALL.map(|_| BoardLog::default());
        let boards = self.images.start(self.qemu, Wire::Pipe, &logs)?;
        let mut there = Simulation::on(boards, scenario, SEED, 0)?;
        there.inject(fault, tick);
        if let Some((role, mode)) = trial.unannounced {
            let at = tick;
            let failure = Failure { role, at, mode };
            there.boards().plan(vec![failure], None);
        }
        let (outcome, trace) = recorded(&mut there, scenario, &case)?;
        let boards = there.boards().reports();
        drop(there);
        let mut here = Simulation::new(scenario, SEED, 0)?;
        here.inject(fault, tick);
        let (reference, expected) = recorded(&mut here, scenario, &case)?;
        let outcomes = (outcome != reference).then(|| "the outcomes differ".to_owned());
        let difference = trace.difference(&expected);
        Ok(Row {
            fault: trial.name,
            seam: trial.seam(),
            ticks: trace.ticks(),
            difference: difference.map(|found| found.to_string()).or(outcomes),
            outcome,
            boards,
        })
    }
}

/// Runs the command.
pub fn run(args: &FaultsArgs) -> Result<(), Error> {
    let trials = trials();
    let names: Vec<&str> = trials.iter().map(|trial| trial.name).collect();
    check_choice(&args.only, &names)?;
    let committed = match args.check {
        true => std::fs::read_to_string(PAGE)
            .map_err(|error| Error::input(format!("{PAGE}: {error}")))?,
        false => String::new(),
    };
    emulated::check_qemu(&args.qemu)?;
    let source = Source {
        qemu: &args.qemu,
        images: Images::build()?,
        interrupt: watch_for_interrupt()?,
    };
    let chosen: Vec<&Trial> = trials
        .iter()
        .filter(|trial| is_chosen(trial.name, &args.only))
        .collect();
    let scenario = scenario(args.choice.world.as_deref())?;
    let progress = Progress::new(chosen.len(), "faults");
    let rows: Result<Vec<Row>, Error> = chosen
        .into_par_iter()
        .map(|trial| {
            let row = source.compare(trial, &scenario);
            progress.advance();
            row.map_err(|error| Error::Failure(format!("{}: {error}", trial.name)))
        })
        .collect();
    let report = Report {
        world: scenario.world.label(),
        rows: rows?,
    };
    drop(progress);
    args.json.write(&Provenance::of(&scenario, SEED), &report)?;
    let page = report.markdown();
    args.json
        .print_page(&format!("{page}\n{}", report.stacks()))?;
    judge(&report, args.check.then_some(&committed))
}

/// An error if a run is not right, or not as committed.
fn judge(report: &Report, committed: Option<&String>) -> Result<(), Error> {
    let wrong = report.rows.iter().filter(|row| !row.is_right()).count();
    if wrong > 0 {
        return Err(Error::Failure(format!("{wrong} runs failed")));
    }
    let boards = report.rows.iter().flat_map(|row| &row.boards);
    if let Some(excess) = boards.filter_map(BoardReport::stack_excess).next() {
        return Err(Error::Failure(excess));
    }
    match committed.and_then(|page| report.unexpected(page)) {
        Some(row) => Err(Error::Failure(format!(
            "differs from {PAGE} (tools/scripts/regenerate.py faults-emulated rewrites it):\n{row}"
        ))),
        None => Ok(()),
    }
}
