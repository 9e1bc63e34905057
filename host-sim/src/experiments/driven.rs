//! Result of a script: table, picture, page and files.

use crate::base::error::Error;
use crate::base::output::OutputDir;
use crate::base::table::Table;
use crate::base::thinned::Thinned;
use crate::experiments::Context;
use crate::experiments::follow::MOST_ROWS;
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
    /// Error in the last step.
    pub error: Option<String>,
}

impl Driven {
    /// Has a robot take the steps.
    pub fn by(robot: &mut impl Robot, scenario: &Scenario, lines: &[Line]) -> Self {
        let (mut records, mut ends) = (Thinned::new(MOST_ROWS), Vec::new());
        let see = |record: &Record| records.push(*record);
        let taken = script::carry_out(robot, scenario, lines, see, &mut ends);
        Self {
            ends,
            records: records.into_values(),
            count: lines.len(),
            error: taken.err().map(|error| error.to_string()),
        }
    }

    /// Why the steps were not taken to the last, if so.
    pub fn failure(&self) -> Option<String> {
        match self.ends.iter().find(|end| !end.done) {
            Some(end) => {
                let error = self.error.as_deref().or(end.code.as_deref());
                let error = error.unwrap_or("time limit");
                Some(format!(
                    "line {}: {}: not done: {error}",
                    end.line, end.step
                ))
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
    let done = driven.failure().is_none();
    let title = format!("{} of {} steps", driven.ends.len(), driven.count);
    let to = goal(lines).unwrap_or([f64::NAN; 3]);
    draw(
        context,
        &mut files,
        &driven.records,
        (done, to),
        title,
        summary(&driven.ends),
    );
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

/// Rows of the report page's summary.
pub fn summary(ends: &[StepEnd]) -> Vec<(String, String)> {
    let row = |end: &StepEnd| {
        let name = format!("{}: {}", end.line, end.step);
        let state = end.name();
        (name, format!("{state} after {:.1} s", end.duration_s))
    };
    ends.iter().map(row).collect()
}

/// Log, picture and report page of a run that is done, or not, to a goal, which is NaN if there is none. Of a robot whose true
/// posture is not known, the estimate is drawn.
pub fn draw(
    context: &Context,
    files: &mut OutputDir,
    records: &[Record],
    (done, goal): (bool, [f64; 3]),
    title: String,
    summary: Vec<(String, String)>,
) {
    files.csv("log.csv", csv::of_records(records));
    let seen: Vec<Record> = records.iter().map(Record::seen).collect();
    let Some(last) = seen.last() else {
        return;
    };
    let body = context.body();
    let panel = PathsPanel {
        title: title.clone(),
        others: Vec::new(),
        path: seen
            .iter()
            .map(|at| [at.midpoint[0], at.midpoint[1]])
            .collect(),
        wheels: pictures::wheel_paths(&seen, body.half_track_m),
        snapshots: pictures::snapshots(&seen),
        goal: if goal[0].is_nan() {
            last.midpoint
        } else {
            goal
        },
        ends: vec![(End::of(done, true), last.midpoint)],
    };
    let heading = match records[0].midpoint[0].is_nan() {
        true => "Path of the robot, as estimated",
        false => "Path of the robot",
    };
    let figure = figures::paths(heading, &body, &[panel]);
    files.text("paths.svg", figure.svg());
    files.bytes("paths.png", figure.png());
    let error = |record: &Record| {
        let at = record.lead.fused.robot.posture;
        let [x, y, phi] = record.midpoint;
        let off = (f64::from(at.x) - x).hypot(f64::from(at.y) - y);
        [[0.0; 2], [off, f64::from(at.phi) - phi]]
    };
    let run = page::Run {
        title: heading.to_owned(),
        name: title,
        goal: (!goal[0].is_nan()).then_some(goal),
        reference: Vec::new(),
        records: records.iter().collect(),
        errors: records.iter().map(error).collect(),
        distance: "Distance of the estimate from the truth",
        summary,
        scenario: &context.scenario,
    };
    page::add(files, &context.name, context.seed, &body, &[run]);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::robot::Observer;
    use crate::run::simulation::Simulation;

    /// A display that fails after a second.
    struct Failing;

    impl Observer for Failing {
        fn epoch(&mut self, _robot: &dyn Robot, record: &Record) -> Result<(), Error> {
            match record.time_s < 1.0 {
                true => Ok(()),
                false => Err(Error::Failure("no display".to_owned())),
            }
        }
    }

    #[test]
    fn steps_before_an_error_are_in_the_result() {
        let scenario = Scenario::default();
        let lines = script::parse("stop\n\nwait 9\nstop", &scenario).unwrap();
        let mut robot = Simulation::new(&scenario, 1, 0).unwrap();
        robot.observe(Box::new(Failing));
        let driven = Driven::by(&mut robot, &scenario, &lines);
        let ends: Vec<_> = driven.ends.iter().map(|end| (end.line, end.done)).collect();
        assert_eq!(ends, [(1, true), (3, false)]);
        let failure = driven.failure().unwrap();
        assert!(
            failure.contains("line 3: wait 9: not done: no display"),
            "{failure}"
        );
    }
}
