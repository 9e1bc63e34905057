//! Mission of a robot and its outcome: regulation to a posture, a path, or the steps of a script.

use super::steps;
use super::steps::Steps;
use crate::experiments::Context;
use crate::experiments::follow;
use crate::experiments::follow::{Course, MAX_ROWS};
use crate::experiments::posture;
use crate::experiments::posture::{Trial, Variant};
use crate::experiments::result::end_lines;
use crate::thinned::Thinned;
use host_sim::base::error::Error;
use host_sim::run::end::{Ended, RunEnd};
use host_sim::run::keyboard::Keyboard;
use host_sim::run::path_run;
use host_sim::run::path_run::{PathEpoch, PathMode};
use host_sim::run::regulate::regulate_on;
use host_sim::run::robot::{Record, Robot};
use host_sim::run::script::{Line, ScriptStep};
use host_sim::scenario::Scenario;
use output::files::OutputDir;
use serde_json::Value;

/// Mission of a robot in a run: a goal, a path or a script.
pub enum Mission {
    /// Regulation to the goal of the scenario.
    Posture(Variant),
    /// Path following, or trajectory tracking along a path.
    Path(Box<Course>, PathMode),
    /// Steps of a script.
    Script {
        /// The steps.
        lines: Vec<Line>,
        /// True if the start posture is sent to a real robot.
        placed: bool,
    },
}

/// Outcome of a mission.
pub enum Outcome {
    /// Outcome of a posture regulation.
    Posture(Box<Trial>),
    /// Outcome of path following or trajectory tracking.
    Path(Box<path_run::Outcome>, Vec<PathEpoch>),
    /// Outcome of a script.
    Script(Steps),
}

impl Ended for Outcome {
    /// End of the mission; in a script, the end of the first failed step, else of the last step.
    fn end(&self) -> RunEnd {
        match self {
            Self::Posture(trial) => trial.outcome.end.clone(),
            Self::Path(outcome, _) => outcome.end.clone(),
            Self::Script(steps) => steps.end(),
        }
    }
}

impl Outcome {
    /// Reason for a failure of the mission.
    pub fn failure(&self) -> Option<String> {
        match self {
            Self::Script(steps) => steps.failure(),
            _ => self.end().failure(),
        }
    }

    /// Duration of the mission, s.
    pub fn duration_s(&self) -> f64 {
        match self {
            Self::Script(steps) => steps.ends.iter().map(|step| step.end.duration_s).sum(),
            _ => self.end().duration_s,
        }
    }

    /// State at each kept epoch.
    pub fn records(&self) -> Vec<Record> {
        match self {
            Self::Posture(trial) => trial.records.clone(),
            Self::Path(_, moments) => moments.iter().map(|moment| moment.record.clone()).collect(),
            Self::Script(steps) => steps.records.clone(),
        }
    }
}

impl Mission {
    /// Keyboard of a script that drives by keyboard, else a keyboard without drive commands.
    pub fn keyboard(&self) -> Keyboard {
        match self {
            Self::Script { lines, .. } => match lines.first().map(|line| &line.step) {
                Some(ScriptStep::Hand(keyboard)) => keyboard.clone(),
                _ => Keyboard::default(),
            },
            _ => Keyboard::default(),
        }
    }

    /// True if the start posture is sent to a real robot.
    pub fn is_placed(&self) -> bool {
        !matches!(self, Self::Script { placed: false, .. })
    }

    /// Goal, NaN if there is none, and points of the path, empty if there is none.
    pub fn goal(&self, scenario: &Scenario) -> ([f64; 3], Vec<[f64; 3]>) {
        match self {
            Self::Posture(_) => (scenario.mission.goal, Vec::new()),
            Self::Path(course, _) => (course.route.goal(), course.route.postures()),
            Self::Script { lines, .. } => {
                let goal = steps::goal(lines).unwrap_or([f64::NAN; 3]);
                (goal, Vec::new())
            }
        }
    }

    /// Time limit of the run, s.
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

    /// Drives the mission with a robot.
    pub fn drive(&self, robot: &mut impl Robot, scenario: &Scenario) -> Result<Outcome, Error> {
        Ok(match self {
            Self::Posture(_) => {
                let mut trial = Trial::default();
                let outcome = regulate_on(robot, scenario, |record| trial.push(record, true))?;
                trial.outcome = outcome;
                Outcome::Posture(Box::new(trial))
            }
            Self::Path(course, path_mode) => {
                let mut kept = Thinned::new(MAX_ROWS);
                let keep = |moment: &PathEpoch| kept.push(moment.clone());
                let outcome = path_run::drive_on(robot, scenario, &course.route, *path_mode, keep)?;
                Outcome::Path(Box::new(outcome), kept.into_values())
            }
            Self::Script { lines, .. } => Outcome::Script(Steps::execute(robot, scenario, lines)),
        })
    }

    /// Table, result and files of a run. Prints a warning on standard error if the end is uncertain.
    pub fn publish(
        &self,
        context: &Context,
        outcome: Outcome,
    ) -> Result<(String, Value, OutputDir), Error> {
        let (text, report, files) = match (self, outcome) {
            (Self::Posture(variant), Outcome::Posture(trial)) => {
                let variants = [*variant];
                let end = trial.outcome.end.clone();
                let blocks = [vec![*trial]];
                let (report, files) = posture::publish(context, &variants, &variants, &blocks)?;
                let text = posture::table(&report.rows, &variants);
                let text = format!("{text}{}", end_lines(&end, "goal"));
                (text, serde_json::to_value(report), files)
            }
            (Self::Path(course, path_mode), Outcome::Path(outcome, moments)) => {
                let (text, report, files) =
                    follow::publish(context, course, *path_mode, &outcome, &moments)?;
                (text, serde_json::to_value(report), files)
            }
            (Self::Script { .. }, Outcome::Script(steps)) => {
                return steps::publish(context, &steps);
            }
            _ => return Err(Error::Failure("outcome of another mission".to_owned())),
        };
        let report = report.map_err(|error| Error::Failure(error.to_string()))?;
        Ok((text, report, files))
    }
}
