//! Tasks of a robot, driven by a robot on boards of any kind: regulation to a posture, or a path.

use crate::experiments::Context;
use crate::experiments::arguments::LogArgs;
use crate::experiments::arguments::PlanArgs;
use crate::experiments::driven;
use crate::experiments::driven::Driven;
use crate::experiments::follow;
use crate::experiments::follow::{Course, MOST_ROWS};
use crate::experiments::posture;
use crate::experiments::posture::{Trial, Variant};
use crate::experiments::recorder::Stage;
use crate::experiments::result::end_lines;
use crate::thinned::Thinned;
use core_algos::safety::OperatingState;
use core_algos::time::Micros;
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::run::end::{Ended, RunEnd};
use host_sim::run::path_run;
use host_sim::run::path_run::{Moment, PathMode};
use host_sim::run::recovery::Status;
use host_sim::run::regulate::regulate_on;
use host_sim::run::robot::{Record, Robot, Span};
use host_sim::run::script::{Line, Step};
use host_sim::scenario::Scenario;
use host_sim::targets::{Event, Failure, FailureMode};
use output::files::OutputDir;
use serde_json::Value;

/// The task.
pub enum Mission {
    /// Regulation to the goal of the scenario.
    Posture(Variant),
    /// A path, or a trajectory along it.
    Path(Box<Course>, PathMode),
    /// Steps of a script.
    Script {
        /// The steps.
        lines: Vec<Line>,
        /// True if a real robot is told where it starts.
        placed: bool,
    },
}

/// Result.
pub enum Outcome {
    /// Of a regulation.
    Posture(Box<Trial>),
    /// Along a path.
    Path(Box<path_run::Outcome>, Vec<Moment>),
    /// Of a script.
    Script(Driven),
}

impl Ended for Outcome {
    /// End of the task; of a script, of the first step that was not carried out or of the last.
    fn end(&self) -> RunEnd {
        match self {
            Self::Posture(trial) => trial.outcome.end.clone(),
            Self::Path(outcome, _) => outcome.end.clone(),
            Self::Script(driven) => driven.end(),
        }
    }
}

impl Outcome {
    /// Reason for a failure of the command, if there is one.
    pub fn failure(&self) -> Option<String> {
        match self {
            Self::Script(driven) => driven.failure(),
            _ => self.end().failure(),
        }
    }

    /// Time from the beginning of the task to its end, s.
    pub fn duration_s(&self) -> f64 {
        match self {
            Self::Script(driven) => driven.steps.iter().map(|step| step.end.duration_s).sum(),
            _ => self.end().duration_s,
        }
    }

    /// State at each epoch that was kept.
    pub fn records(&self) -> Vec<Record> {
        match self {
            Self::Posture(trial) => trial.records.clone(),
            Self::Path(_, moments) => moments.iter().map(|moment| moment.record).collect(),
            Self::Script(driven) => driven.records.clone(),
        }
    }
}

impl Mission {
    /// The scenario of the run.
    pub fn scenario(&self, context: &Context) -> Scenario {
        match self {
            Self::Posture(variant) => variant.apply(&context.scenario),
            Self::Path(..) | Self::Script { .. } => context.scenario.clone(),
        }
    }

    /// Prepares the display of the run.
    pub fn prepare(&self, stage: &mut Stage) {
        if let Self::Script { lines, .. } = self
            && let Some(Step::Hand(keyboard)) = lines.first().map(|line| &line.step)
        {
            stage.keyboard = keyboard.clone();
            stage.real_time = true;
        }
    }

    /// True if a real robot is told where it starts.
    pub fn is_placed(&self) -> bool {
        !matches!(self, Self::Script { placed: false, .. })
    }

    /// Goal, NaN if there is none, and points of the path.
    pub fn goal(&self, scenario: &Scenario) -> ([f64; 3], Vec<[f64; 3]>) {
        match self {
            Self::Posture(_) => (scenario.mission.goal, Vec::new()),
            Self::Path(course, _) => (course.route.goal(), course.route.postures()),
            Self::Script { lines, .. } => {
                let goal = driven::goal(lines).unwrap_or([f64::NAN; 3]);
                (goal, Vec::new())
            }
        }
    }

    /// Longest time of the run, s.
    pub fn limit_s(&self, scenario: &Scenario) -> f64 {
        let limit_s = match self {
            Self::Posture(_) => scenario.mission.time_limit_s,
            Self::Path(course, _) => course.route.limit_s(),
            Self::Script { lines, .. } => {
                lines.iter().map(|line| line.step.limit_s(scenario)).sum()
            }
        };
        scenario.mission.settle_s + limit_s
    }

    /// Has a robot carry it out.
    pub fn drive(&self, robot: &mut impl Robot, scenario: &Scenario) -> Result<Outcome, Error> {
        Ok(match self {
            Self::Posture(_) => {
                let mut trial = Trial::default();
                let outcome = regulate_on(robot, scenario, |record| trial.see(record, true))?;
                trial.outcome = outcome;
                Outcome::Posture(Box::new(trial))
            }
            Self::Path(course, path_mode) => {
                let mut kept = Thinned::new(MOST_ROWS);
                let see = |moment: &Moment| kept.push(*moment);
                let outcome = path_run::drive_on(robot, scenario, &course.route, *path_mode, see)?;
                Outcome::Path(Box::new(outcome), kept.into_values())
            }
            Self::Script { lines, .. } => Outcome::Script(Driven::by(robot, scenario, lines)),
        })
    }

    /// Carries it out by a robot whose boards are in this process, and publishes the result.
    pub fn in_process(&self, context: &Context, log: &LogArgs) -> Result<(), Error> {
        let scenario = self.scenario(context);
        let (goal, path) = self.goal(&scenario);
        let mut stage = Stage::begin(log, context, &scenario, (goal, &path))?;
        self.prepare(&mut stage);
        let mut simulation = stage.simulation()?;
        let driven = stage.run(&mut simulation, |robot| self.drive(robot, &scenario))?;
        let failed = driven.outcome.failure().or(driven.restless);
        let (text, report, files) = self.publish(context, driven.outcome)?;
        context.finish(&text, &report, files, &driven.recorded, failed)
    }

    /// Table, result and files of a run. Standard error names a goal that is reached without certainty.
    pub fn publish(
        &self,
        context: &Context,
        outcome: Outcome,
    ) -> Result<(String, Value, OutputDir), Error> {
        let (text, report, files) = match (self, outcome) {
            (Self::Posture(variant), Outcome::Posture(trial)) => {
                let variants = [*variant];
                let end = trial.outcome.end.clone();
                let blocks = ([vec![*trial]], []);
                let (report, files) =
                    posture::publish(context, &variants, &variants, (&blocks.0, &blocks.1))?;
                let text = posture::table(&report.rows, &variants);
                let text = format!("{text}{}", end_lines(&end, "goal"));
                (text, serde_json::to_value(report), files)
            }
            (Self::Path(course, path_mode), Outcome::Path(outcome, moments)) => {
                let (text, report, files) =
                    follow::publish(context, course, *path_mode, &outcome, &moments)?;
                (text, serde_json::to_value(report), files)
            }
            (Self::Script { .. }, Outcome::Script(driven)) => {
                return driven::publish(context, &driven);
            }
            _ => return Err(Error::Failure("another task's outcome".to_owned())),
        };
        let report = report.map_err(|error| Error::Failure(error.to_string()))?;
        Ok((text, report, files))
    }
}

/// Lines on late ticks, boards lost and restarted, and nodes in a fault.
pub fn happenings(late_ticks: Option<u32>, events: &[Event], nodes: &[Status]) -> String {
    let faults = nodes.iter();
    let faults = faults.filter(|status| status.state == OperatingState::Fault);
    let late = late_ticks.map(|late| format!("{late} ticks began more than a tick late\n"));
    let lines = events.iter().map(|event| format!("{event}\n"));
    let lines = late.into_iter().chain(lines);
    lines
        .chain(faults.map(|status| format!("{status}\n")))
        .collect()
}

/// End of the run, and failures of boards on the way.
pub struct Plan {
    /// Bounds of the time.
    pub span: Span,
    /// Boards that are switched off.
    pub failures: Vec<Failure>,
    /// Time until a lost board is switched on again, ms.
    pub restart_after: Option<u32>,
}

impl Plan {
    /// The plan of these arguments; the run lasts at least `least_s`.
    pub fn new(args: &PlanArgs, least_s: f64) -> Result<Self, Error> {
        let micros =
            |name: &str, value: f64| seconds(name, value, 0.0).map(|s| (s * 1e6) as Micros);
        let failures = args.kill.iter().map(|text| failure(text));
        let restart_after = args
            .restart_after
            .map(|value| seconds("--restart-after", value, 0.001).map(|s| (s * 1e3) as u32));
        let most = args.stop_after.map(|value| micros("--stop-after", value));
        Ok(Self {
            span: Span {
                least: micros("--duration", args.duration.unwrap_or(least_s))?,
                most: most.transpose()?,
            },
            failures: failures.collect::<Result<_, _>>()?,
            restart_after: restart_after.transpose()?,
        })
    }
}

fn seconds(name: &str, value: f64, least: f64) -> Result<f64, Error> {
    if value >= least && value <= 36_000.0 {
        Ok(value)
    } else {
        Err(Error::input(format!(
            "{name} {value}: must be a number from {least} to 36000"
        )))
    }
}

/// A failure from `BOARD@S`.
fn failure(text: &str) -> Result<Failure, Error> {
    let parts = text.split_once('@').and_then(|(board, time)| {
        let role = Role::ALL.into_iter().find(|role| role.name() == board)?;
        Some((role, time.parse::<f64>().ok()?))
    });
    let Some((role, time)) = parts else {
        return Err(Error::input(format!(
            "--kill {text}: must be front, rear or beam, then @ and a time in seconds"
        )));
    };
    let at = (seconds("--kill", time, 0.0)? * 1e3).round() as u32;
    Ok(Failure {
        role,
        at,
        mode: FailureMode::Off,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_name_a_board_and_a_time() {
        let found = failure("front@8.0").unwrap();
        assert_eq!((found.role, found.at), (Role::Front, 8000));
        for bad in [
            "front", "middle@1", "rear@", "rear@nan", "beam@-1", "beam@1e9",
        ] {
            assert_eq!(failure(bad).unwrap_err().exit_code(), 2, "{bad}");
        }
    }
}
