//! Executed steps of a script: table, picture, page and files.

use super::picture::draw;
use crate::experiments::Context;
use crate::experiments::follow::MAX_ROWS;
use crate::experiments::result::warn;
use crate::thinned::Thinned;
use host_sim::base::error::Error;
use host_sim::run::end::{EndKind, RunEnd};
use host_sim::run::robot::{Record, Robot};
use host_sim::run::script;
use host_sim::run::script::{Line, ScriptStep, StepEnd};
use host_sim::scenario::Scenario;
use output::files::{Csv, OutputDir};
use output::table::Table;
use output::terminal::wrapped;
use recording::csv;
use serde::Serialize;

/// Executed steps of a script, for the JSON output.
#[derive(Debug, Serialize)]
struct ScriptValues<'a> {
    /// Executed steps with their ends.
    steps: &'a [StepEnd],
}

/// Executed steps of a script, and the records of the kept epochs.
#[derive(Clone, Debug, Default)]
pub struct Steps {
    /// Executed steps with their ends.
    pub ends: Vec<StepEnd>,
    /// Records of the kept epochs.
    pub records: Vec<Record>,
    /// Number of steps in the script.
    pub count: usize,
}

impl Steps {
    /// Executes the steps with a robot.
    pub fn execute(robot: &mut impl Robot, scenario: &Scenario, lines: &[Line]) -> Self {
        let (mut records, mut ends) = (Thinned::new(MAX_ROWS), Vec::new());
        let observe = |record: &Record| records.push(record.clone());
        // The end of the last step contains an error.
        let _ = script::execute(robot, scenario, lines, observe, &mut ends);
        Self {
            ends,
            records: records.into_values(),
            count: lines.len(),
        }
    }

    /// Step that decides the script's end: the first failed step, else the last step.
    fn last(&self) -> Option<&StepEnd> {
        let failed = self.ends.iter().find(|step| !step.end.is_success());
        failed.or(self.ends.last())
    }

    /// End of the step that decides the script's end; *interrupted* if the user ended the script between two steps.
    pub fn end(&self) -> RunEnd {
        let end = self.last().map(|step| step.end.clone());
        let mut end = end.unwrap_or_default();
        if end.is_success() && self.ends.len() < self.count {
            // The user ended the run between two steps.
            end.kind = EndKind::Interrupted;
        }
        end
    }

    /// Goal of the last step with a goal; `None` after a `pose` step, because later goals are not in the frame of the
    /// truth.
    pub fn goal(&self) -> Option<[f64; 3]> {
        let posed = self.ends.iter().any(|step| step.step.starts_with("pose"));
        let mut last = self.ends.iter().rev();
        last.find_map(|step| step.goal).filter(|_| !posed)
    }

    /// Reason if a step failed or was not executed.
    pub fn failure(&self) -> Option<String> {
        let step = self.last()?;
        match step.end.failure() {
            Some(why) => Some(format!("line {}: {}: {why}", step.line, step.step)),
            None if self.ends.len() < self.count || !step.end.is_success() => {
                let (executed, count) = (self.ends.len(), self.count);
                Some(format!("{executed} of {count} steps were executed"))
            }
            None => None,
        }
    }
}

/// Goal of the script's last step, if the step is a `goto`.
pub fn goal(lines: &[Line]) -> Option<[f64; 3]> {
    match lines.last()?.step {
        ScriptStep::Goto(goal) => Some(goal),
        _ => None,
    }
}

/// Text table, JSON report and files of a script.
pub fn publish(
    context: &Context,
    executed: &Steps,
) -> Result<(String, serde_json::Value, OutputDir), Error> {
    let mut files = context.output()?;
    let done = executed.ends.iter().filter(|step| step.end.is_success());
    let title = format!("{} of {} steps succeeded", done.count(), executed.count);
    let end = executed.end();
    draw(
        context,
        &mut files,
        &executed.records,
        (&end, executed.goal()),
        title,
        summary(&executed.ends),
    );
    files.csv("ends.csv", csv_of(&executed.ends));
    let report = serde_json::to_value(ScriptValues {
        steps: &executed.ends,
    });
    let report = report.map_err(|error| Error::Failure(error.to_string()))?;
    for step in &executed.ends {
        warn(&step.end, &format!("line {}", step.line));
    }
    Ok((table(&executed.ends), report, files))
}

/// CSV file with one row per step: text, goal and end.
pub fn csv_of(steps: &[StepEnd]) -> Csv {
    csv::CsvRow::table(steps.iter().map(|step| {
        let mut row = csv::CsvRow::default();
        row.put("line", &[step.line]);
        row.put("step", &[step.step.as_str()]);
        let goal = step.goal.unwrap_or([f64::NAN; 3]);
        row.put("goal_x_m goal_y_m goal_phi_rad", &goal);
        row.end(&step.end);
        row
    }))
}

/// Names and values in the summary of the report page: each step with its end.
pub fn summary(steps: &[StepEnd]) -> Vec<(String, String)> {
    let row = |step: &StepEnd| (format!("{}: {}", step.line, step.step), step.end.text());
    steps.iter().map(row).collect()
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
        "error (cm)",
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
        "{table}\nPostures are estimates; error: distance of the estimated from the true midpoint.\n{notices}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_sim::run::robot::Observer;
    use host_sim::run::simulation::Simulation;

    /// Display that fails after 1 s.
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
        let driven = Steps::execute(&mut robot, &scenario, &lines);
        let done = |step: &StepEnd| (step.line, step.end.is_success());
        let ends: Vec<_> = driven.ends.iter().map(done).collect();
        assert_eq!(ends, [(1, true), (3, false)]);
        let failure = driven.failure().unwrap();
        assert!(
            failure.contains("line 3: wait 9: stopped") && failure.contains(": no display"),
            "{failure}"
        );
    }
}
