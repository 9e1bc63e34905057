//! Result of a script: table, picture, page and files.

use crate::experiments::Context;
use crate::experiments::follow::MOST_ROWS;
use crate::experiments::posture::pictures;
use crate::experiments::result::warn;
use crate::thinned::Thinned;
use host_sim::base::error::Error;
use host_sim::run::end::{EndKind, RunEnd, Verdict};
use host_sim::run::robot::{Record, Robot};
use host_sim::run::script;
use host_sim::run::script::{Line, Step, StepEnd};
use host_sim::scenario::Scenario;
use output::files::{Csv, OutputDir};
use output::table::Table;
use output::terminal::wrapped;
use recording::csv;
use serde::Serialize;
use view::figures;
use view::figures::PathsPanel;
use view::page;

/// Result of the command.
#[derive(Debug, Serialize)]
struct Report<'a> {
    /// Steps with their ends.
    steps: &'a [StepEnd],
}

/// Steps that were taken, and the state at each epoch.
#[derive(Clone, Debug, Default)]
pub struct Driven {
    /// Steps with their ends.
    pub steps: Vec<StepEnd>,
    /// State at each epoch.
    pub records: Vec<Record>,
    /// Number of steps that were to be taken.
    pub count: usize,
}

impl Driven {
    /// Has a robot take the steps.
    pub fn by(robot: &mut impl Robot, scenario: &Scenario, lines: &[Line]) -> Self {
        let (mut records, mut steps) = (Thinned::new(MOST_ROWS), Vec::new());
        let see = |record: &Record| records.push(*record);
        // An error is the end of the last step.
        let _ = script::carry_out(robot, scenario, lines, see, &mut steps);
        Self {
            steps,
            records: records.into_values(),
            count: lines.len(),
        }
    }

    /// The step that ended the script: the first that was not carried out, or the last.
    fn last(&self) -> Option<&StepEnd> {
        let failed = self.steps.iter().find(|step| !step.end.is_success());
        failed.or(self.steps.last())
    }

    /// End of that step.
    pub fn end(&self) -> RunEnd {
        let end = self.last().map(|step| step.end.clone());
        let mut end = end.unwrap_or_default();
        if end.is_success() && self.steps.len() < self.count {
            // The user ended the run between two steps.
            end.kind = EndKind::Interrupted;
        }
        end
    }

    /// Goal of the last step that has one; none after a new pose, from which on goals are not in the frame of the truth.
    pub fn goal(&self) -> Option<[f64; 3]> {
        let posed = self.steps.iter().any(|step| step.step.starts_with("pose"));
        let mut last = self.steps.iter().rev();
        last.find_map(|step| step.goal).filter(|_| !posed)
    }

    /// Why the steps were not taken to the last, if so.
    pub fn failure(&self) -> Option<String> {
        let step = self.last()?;
        match step.end.failure() {
            Some(why) => Some(format!("line {}: {}: {why}", step.line, step.step)),
            None if self.steps.len() < self.count || !step.end.is_success() => {
                let (taken, count) = (self.steps.len(), self.count);
                Some(format!("{taken} of {count} steps were taken"))
            }
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
    driven: &Driven,
) -> Result<(String, serde_json::Value, OutputDir), Error> {
    let mut files = context.output()?;
    let taken = driven.steps.iter().filter(|step| step.end.is_success());
    let title = format!("{} of {} steps carried out", taken.count(), driven.count);
    let end = driven.end();
    draw(
        context,
        &mut files,
        &driven.records,
        (&end, driven.goal()),
        title,
        summary(&driven.steps),
    );
    files.csv("ends.csv", csv_of(&driven.steps));
    let report = serde_json::to_value(Report {
        steps: &driven.steps,
    });
    let report = report.map_err(|error| Error::Failure(error.to_string()))?;
    for step in &driven.steps {
        warn(&step.end, &format!("line {}", step.line));
    }
    Ok((table(&driven.steps), report, files))
}

/// Ends of the steps as CSV.
pub fn csv_of(steps: &[StepEnd]) -> Csv {
    csv::Row::table(steps.iter().map(|step| {
        let mut row = csv::Row::default();
        row.put("line", &[step.line]);
        row.put("step", &[step.step.as_str()]);
        let goal = step.goal.unwrap_or([f64::NAN; 3]);
        row.put("goal_x_m goal_y_m goal_phi_rad", &goal);
        row.end(&step.end);
        row
    }))
}

/// Rows of the report page's summary.
pub fn summary(steps: &[StepEnd]) -> Vec<(String, String)> {
    let row = |step: &StepEnd| (format!("{}: {}", step.line, step.step), step.end.text());
    steps.iter().map(row).collect()
}

/// Log, picture and report page of a run with its end and its goal, if there is one. Of a robot whose true posture is not
/// known, the estimate is drawn.
pub fn draw(
    context: &Context,
    files: &mut OutputDir,
    records: &[Record],
    (end, goal): (&RunEnd, Option<[f64; 3]>),
    title: String,
    summary: Vec<(String, String)>,
) {
    files.csv("log.csv", csv::of_records(records));
    let seen: Vec<Record> = records.iter().map(Record::seen).collect();
    let Some(last) = seen.last() else {
        return;
    };
    let body = context.body();
    let mission = &context.scenario.mission;
    let within = goal.is_none_or(|goal| mission.is_near(last.midpoint, goal));
    let panel = PathsPanel {
        title: title.clone(),
        others: Vec::new(),
        path: seen
            .iter()
            .map(|at| [at.midpoint[0], at.midpoint[1]])
            .collect(),
        wheels: pictures::wheel_paths(&seen, body.half_track_m),
        snapshots: pictures::snapshots(&seen),
        goal,
        tolerance: [mission.tolerance_m, mission.tolerance_rad],
        ends: vec![(Verdict::of(end.kind, within), last.midpoint)],
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
        let off = libm::hypot(f64::from(at.x) - x, f64::from(at.y) - y);
        [[f64::NAN; 2], [off, f64::from(at.phi) - phi]]
    };
    let run = page::Run {
        title: heading.to_owned(),
        name: title,
        goal,
        reference: Vec::new(),
        records: records.iter().collect(),
        errors: records.iter().map(error).collect(),
        distance: "Distance of the estimate from the truth",
        end,
        summary,
        scenario: &context.scenario,
    };
    page::add(files, &context.subtitle(), &body, &[run]);
}

/// Table of the steps, with their notices.
pub fn table(steps: &[StepEnd]) -> String {
    let mut table = Table::new([
        "line",
        "step",
        "end",
        "code",
        "95 % error",
        "x (m)",
        "y (m)",
        "φ (°)",
        "off (cm)",
        "time (s)",
    ]);
    let mut notices = String::new();
    for StepEnd {
        line, step, end, ..
    } in steps
    {
        let [x, y, phi] = end.estimate.unwrap_or([f64::NAN; 3]);
        let off = end.truth.map(|[a, b, _]| libm::hypot(a - x, b - y));
        let number = |value: f64, digits: usize| match value.is_nan() {
            true => String::new(),
            false => format!("{value:.digits$}"),
        };
        table.row([
            line.to_string(),
            step.clone(),
            end.label(),
            end.code().unwrap_or_default(),
            end.error_text().unwrap_or_default(),
            number(x, 3),
            number(y, 3),
            number(phi.to_degrees(), 2),
            number(100.0 * off.unwrap_or(f64::NAN), 1),
            format!("{:.1}", end.duration_s),
        ]);
        if let Some(text) = end.notices_text() {
            notices += &wrapped(&format!("line {line}: {text}"));
        }
    }
    format!(
        "{table}\nPostures are the robot's estimates; off: distance of the true midpoint from the estimate.\n{notices}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_sim::run::robot::Observer;
    use host_sim::run::simulation::Simulation;

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
        let done = |step: &StepEnd| (step.line, step.end.is_success());
        let ends: Vec<_> = driven.steps.iter().map(done).collect();
        assert_eq!(ends, [(1, true), (3, false)]);
        let failure = driven.failure().unwrap();
        assert!(
            failure.contains("line 3: wait 9: stopped") && failure.contains(": no display"),
            "{failure}"
        );
    }
}
