//! Result of a script: table, picture, page and files.

use crate::base::error::Error;
use crate::base::output::OutputDir;
use crate::base::table::Table;
use crate::experiments::Context;
use crate::experiments::posture::pictures;
use crate::recording::csv;
use crate::run::robot::{Record, Robot};
use crate::run::script::{self, Line, Step, StepEnd};
use crate::scenario::Scenario;
use crate::view::figures::{self, PathsPanel};
use crate::view::page;
use crate::view::style::End;
use core_algos::safety::Condition;
use serde::Serialize;

/// Result of the command.
#[derive(Debug, Serialize)]
struct Report<'a> {
    steps: &'a [StepEnd],
}

/// Steps that were taken, and the state at each epoch.
#[derive(Clone, Debug, Default)]
pub struct Driven {
    /// Ends of the steps.
    pub ends: Vec<StepEnd>,
    /// State at each epoch.
    pub records: Vec<Record>,
    /// Number of steps that were to be taken.
    pub count: usize,
}

impl Driven {
    /// Has a robot take the steps.
    pub fn by(robot: &mut impl Robot, scenario: &Scenario, lines: &[Line]) -> Result<Self, Error> {
        let mut records = Vec::new();
        let ends = script::carry_out(robot, scenario, lines, |record| records.push(*record))?;
        Ok(Self {
            ends,
            records,
            count: lines.len(),
        })
    }

    /// Why the steps were not taken to the last, if so.
    pub fn failure(&self) -> Option<String> {
        match self.ends.iter().find(|end| !end.done) {
            Some(end) => {
                let code = end.code.as_deref().unwrap_or("time limit");
                Some(format!("line {}: {}: not done: {code}", end.line, end.step))
            }
            None if self.ends.len() < self.count => Some(format!(
                "{} of {} steps were taken",
                self.ends.len(),
                self.count
            )),
            None => None,
        }
    }
}

/// Posture of the last `goto` of a script that ends there.
pub fn goal(lines: &[Line]) -> Option<[f64; 3]> {
    match lines.last()?.step {
        Step::Goto(goal) => Some(goal),
        _ => None,
    }
}

/// Table, result and files.
pub fn publish(
    context: &Context,
    lines: &[Line],
    driven: &Driven,
) -> Result<(String, serde_json::Value, OutputDir), Error> {
    let mut files = context.output()?;
    files.csv("log.csv", csv::of_records(&driven.records));
    let last = driven.records.last();
    if let Some(last) = last.filter(|last| !last.midpoint[0].is_nan()) {
        let body = context.body();
        let done = driven.failure().is_none();
        let at = last.lead.fused.robot.posture;
        let estimate = [at.x, at.y, at.phi].map(f64::from);
        let panel = PathsPanel {
            title: format!("{} of {} steps", driven.ends.len(), driven.count),
            others: Vec::new(),
            path: driven
                .records
                .iter()
                .map(|at| [at.midpoint[0], at.midpoint[1]])
                .collect(),
            wheels: pictures::wheel_paths(&driven.records, body.half_track_m),
            snapshots: pictures::snapshots(&driven.records),
            goal: goal(lines).unwrap_or(estimate),
            ends: vec![(End::of(done, true), last.midpoint)],
        };
        let figure = figures::paths("Path of the robot", &body, &[panel]);
        files.text("paths.svg", figure.svg());
        files.bytes("paths.png", figure.png());
        let page = page_of(context, driven);
        page::add(&mut files, &context.name, context.seed, &body, &[page]);
    }
    let report = serde_json::to_value(Report {
        steps: &driven.ends,
    });
    let report = report.map_err(|error| Error::Failure(error.to_string()))?;
    for end in &driven.ends {
        if let Some(notice) = end.uncertain() {
            report_uncertain(&format!("line {}", end.line), notice, end.claimed_m);
        }
    }
    Ok((table(&driven.ends), report, files))
}

/// Says on standard error under which notice a robot is at its goal, what it claims, and what to do.
pub fn report_uncertain(what: &str, notice: Condition, claimed_m: Option<f64>) {
    let entry = notice.entry();
    let claim = claimed_m.map(|claim| format!(" ±{:.1} cm", 100.0 * claim));
    eprintln!(
        "cfmmr: {what}: {}{} (code {:#04x}); {}",
        entry.name,
        claim.unwrap_or_default(),
        entry.code,
        entry.remedy
    );
}

/// The drive for the report page: error of the estimate.
fn page_of<'a>(context: &'a Context, driven: &'a Driven) -> page::Run<'a> {
    let error = |record: &Record| {
        let at = record.lead.fused.robot.posture;
        let [x, y, phi] = record.midpoint;
        let off = (f64::from(at.x) - x).hypot(f64::from(at.y) - y);
        [[0.0; 2], [off, f64::from(at.phi) - phi]]
    };
    let row = |end: &StepEnd| {
        let name = format!("{}: {}", end.line, end.step);
        let state = end.name();
        (name, format!("{state} after {:.1} s", end.duration_s))
    };
    page::Run {
        title: "Drive".to_owned(),
        name: "drive".to_owned(),
        goal: None,
        reference: Vec::new(),
        records: driven.records.iter().collect(),
        errors: driven.records.iter().map(error).collect(),
        distance: "Distance of the estimate from the truth",
        summary: driven.ends.iter().map(row).collect(),
        scenario: &context.scenario,
    }
}

/// Table of the steps.
pub fn table(ends: &[StepEnd]) -> String {
    let mut table = Table::new([
        "line", "step", "end", "code", "x (m)", "y (m)", "φ (°)", "off (cm)", "time (s)",
    ]);
    for end in ends {
        let off = end.truth.map(|[x, y, _]| (x - end.x).hypot(y - end.y));
        table.row([
            end.line.to_string(),
            end.step.clone(),
            end.name(),
            end.code.clone().unwrap_or_default(),
            format!("{:.3}", end.x),
            format!("{:.3}", end.y),
            format!("{:.2}", end.phi.to_degrees()),
            off.map_or(String::new(), |off| format!("{:.1}", 100.0 * off)),
            format!("{:.1}", end.duration_s),
        ]);
    }
    format!(
        "{table}\nPostures are the robot's estimates; off: distance of the true midpoint from the estimate.\n"
    )
}
