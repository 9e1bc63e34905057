//! Scripts of steps for the robot: goals, paths, speeds, stops.
//!
//! [`parse`] reads a script and refuses the whole script if one line is invalid. [`execute`] executes the steps.

use crate::base::error::Error;
use crate::base::{numbers, spelling};
use crate::paths;
use crate::paths::{MAX_COORDINATE_M, Path, PathError};
use crate::run::drive::{DriveTask, Progress, drive};
use crate::run::end::{Cause, EndKind, RunEnd};
use crate::run::keyboard::Keyboard;
use crate::run::path_run;
use crate::run::path_run::{PathMode, Route};
use crate::run::robot::{Record, Robot};
use crate::scenario::Scenario;
use crate::targets::HostCommand;
use core_algos::bus::field::{Calibrate, CalibrationResult};
use core_algos::bus::{self, LeadMode, Message};
use core_algos::control::regulator::Phase;
use core_algos::link::protocol::Placement;
use core_algos::math::Posture;
use core_algos::node::lead::{DEAD_MAN, Task};
use core_algos::safety::{Condition, OperatingState};
use core_algos::time::Micros;
use core_algos::topology::{FrameId, Node};
use serde::Serialize;

/// Interval of speed commands, µs: a quarter of the timeout after which the robot stops.
const SPEED_INTERVAL_US: Micros = DEAD_MAN / 4;
/// Longest duration of a stop, of clearing the faults or of setting a posture, s.
const SHORT_S: f64 = 10.0;
/// Shortest duration of a speed step, s: the interval of its commands.
const SHORTEST_S: f64 = 0.05;
/// Longest duration of a wait or speed step, s.
const LONGEST_S: f64 = 36_000.0;
/// Commanded speed below which the robot counts as at rest, m/s.
const REST_M_S: f32 = 1e-3;

/// Names of the steps with their arguments.
const STEPS: [(&str, &str); 8] = [
    ("goto", "X Y PHI"),
    ("follow", "PATH [SIZE [LAPS]]"),
    ("speed", "V KAPPA SECONDS"),
    ("stop", ""),
    ("clear", ""),
    ("wait", "SECONDS"),
    ("pose", "X Y PHI"),
    ("zero", ""),
];

/// Step of a script.
#[derive(Clone, Debug, PartialEq)]
pub enum ScriptStep {
    /// Drive to a posture: m, m, rad.
    Goto([f64; 3]),
    /// Follow a path.
    Follow {
        /// Path to follow.
        path: Box<Path>,
        /// Number of laps of a closed path.
        laps: u32,
        /// True if the path begins at the robot's posture; waypoints of a file are global.
        from_robot: bool,
    },
    /// Drive with a speed and a curvature.
    Speed {
        /// Commanded speed, m/s.
        speed_m_s: f64,
        /// Commanded curvature, 1/m.
        curvature_per_m: f64,
        /// Duration of the step, s.
        seconds: f64,
    },
    /// Brake and hold.
    Stop,
    /// Switch the motors off and clear the faults whose causes are gone.
    Clear,
    /// Do nothing for a time, s.
    Wait(f64),
    /// Switch the motors off and set the robot's posture: m, m, rad.
    Pose([f64; 3]),
    /// Switch the motors off and set the zeros of the gauges; the strip must be straight.
    Zero,
    /// Drive by keys until the user ends the run.
    Hand(Keyboard),
}

impl ScriptStep {
    /// Time limit of the step, s.
    pub fn limit_s(&self, scenario: &Scenario) -> f64 {
        match self {
            Self::Goto(_) => scenario.mission.time_limit_s,
            Self::Follow { path, laps, .. } => {
                let route = Route::new(path, *laps, scenario);
                route.map_or(SHORT_S, |route| route.limit_s())
            }
            Self::Speed { seconds, .. } | Self::Wait(seconds) => SHORT_S + seconds,
            Self::Hand(_) => f64::MAX,
            _ => SHORT_S,
        }
    }
}

/// Line of a script.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Number of the line, from 1.
    pub number: usize,
    /// Text of the line.
    pub text: String,
    /// Step that the line describes.
    pub step: ScriptStep,
}

/// End of a step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepEnd {
    /// Number of the step's line, from 1.
    pub line: usize,
    /// Text of the step.
    pub step: String,
    /// Goal of the step, or the end of its path: m, m, rad.
    pub goal: Option<[f64; 3]>,
    /// End of the step.
    pub end: RunEnd,
}

/// Script whose only step is a drive by hand.
pub fn by_hand(keyboard: Keyboard) -> Vec<Line> {
    vec![Line {
        number: 1,
        text: "keyboard".to_owned(),
        step: ScriptStep::Hand(keyboard),
    }]
}

/// Largest allowed speed (m/s) and curvature (1/m) of a step.
pub fn limits(scenario: &Scenario) -> [f64; 2] {
    let most = f64::from(scenario.robot.limits.max_speed_m_s);
    let bound = path_run::bounds(scenario).max_curvature();
    [most, bound].map(|value| (value * 1e4).floor() / 1e4)
}

/// Reads the steps of a script: one per line, comments after #. An error names the line.
pub fn parse(text: &str, scenario: &Scenario) -> Result<Vec<Line>, Error> {
    let mut lines = Vec::new();
    // Some editors begin a file with a byte order mark.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (index, line) in text.lines().enumerate() {
        let number = index + 1;
        let words = shlex::split(line.trim()).ok_or_else(|| {
            let line = line.trim();
            Error::input(format!("line {number}: {line}: unmatched quotation mark"))
        })?;
        if !words.is_empty() {
            lines.push(parse_words(&words, number, scenario)?);
        }
    }
    match lines.is_empty() {
        true => Err(Error::input("the script has no step")),
        false => Ok(lines),
    }
}

/// Reads the step in `words` as line `number` of a script. An error names the line.
pub fn parse_words(words: &[String], number: usize, scenario: &Scenario) -> Result<Line, Error> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let text = shlex::try_join(words.iter().copied()).unwrap_or_else(|_| words.join(" "));
    let step = step(&words, scenario)
        .map_err(|error| Error::input(format!("line {number}: {text}: {error}")))?;
    Ok(Line { number, text, step })
}

/// Checks each path for which the final posture of the previous steps is known: refuses a path beyond the limits of the
/// frame, and a path that begins too far from that posture. `at` is the posture at the start; `None` if unknown.
pub fn check_starts(
    lines: &[Line],
    mut at: Option<[f64; 3]>,
    scenario: &Scenario,
) -> Result<(), Error> {
    for line in lines {
        at = match (&line.step, at) {
            (ScriptStep::Goto(goal) | ScriptStep::Pose(goal), _) => Some(*goal),
            (ScriptStep::Follow { .. }, Some(from)) => {
                let [planned, _] = path_run::start_distances(scenario);
                let route = route(&line.step, from, planned, scenario).map_err(|error| {
                    Error::input(format!("line {}: {}: {error}", line.number, line.text))
                })?;
                route.map(|route| route.goal())
            }
            (
                ScriptStep::Follow {
                    path,
                    laps,
                    from_robot: false,
                },
                None,
            ) => {
                let route = Route::new(path, *laps, scenario);
                route.ok().map(|route| route.goal())
            }
            (ScriptStep::Stop | ScriptStep::Clear | ScriptStep::Wait(_) | ScriptStep::Zero, at) => {
                at
            }
            _ => None,
        };
    }
    Ok(())
}

/// Route of a path step for a robot at posture `at`, at most `most` (m) from its start; `None` for another step.
fn route(
    step: &ScriptStep,
    at: [f64; 3],
    most: f64,
    scenario: &Scenario,
) -> Result<Option<Route>, PathError> {
    let ScriptStep::Follow {
        path,
        laps,
        from_robot,
    } = step
    else {
        return Ok(None);
    };
    let path = match from_robot {
        true => path.placed(at),
        false => Path::clone(path),
    };
    let route = Route::new(&path, *laps, scenario)?;
    route.check_start(at, most)?;
    Ok(Some(route))
}

fn step(words: &[&str], scenario: &Scenario) -> Result<ScriptStep, Error> {
    let (&name, words) = words.split_first().unwrap_or((&"", &[]));
    let Some((_, usage)) = STEPS.iter().find(|(known, _)| *known == name) else {
        let hint = spelling::hint(name, STEPS.map(|(name, _)| name));
        let known = STEPS.map(|(name, _)| name).join(", ");
        return Err(Error::input(format!("must begin with {known}{hint}")));
    };
    let count = || Error::input(format!("must be: {name} {usage}"));
    let number = |place: usize, what: &str, least: f64, most: f64| {
        let text = words.get(place).ok_or_else(count)?;
        match text.parse::<f64>() {
            Ok(value) if value >= least && value <= most => Ok(value),
            _ => Err(Error::input(format!(
                "{what} = {text}: must be a number from {least} to {most}"
            ))),
        }
    };
    let posture = || match *words {
        [x, y, phi] => numbers::posture([x, y, phi], MAX_COORDINATE_M).map_err(Error::Input),
        _ => Err(count()),
    };
    let exactly = |expected: usize| match words.len() == expected {
        true => Ok(()),
        false => Err(count()),
    };
    match name {
        "goto" => posture().map(ScriptStep::Goto),
        "pose" => posture().map(ScriptStep::Pose),
        "wait" => exactly(1)
            .and_then(|()| number(0, "SECONDS", 0.0, LONGEST_S))
            .map(ScriptStep::Wait),
        "speed" => {
            exactly(3)?;
            let [most, bound] = limits(scenario);
            Ok(ScriptStep::Speed {
                speed_m_s: number(0, "V (m/s)", -most, most)?,
                curvature_per_m: number(1, "KAPPA (1/m)", -bound, bound)?,
                seconds: number(2, "SECONDS", SHORTEST_S, LONGEST_S)?,
            })
        }
        "follow" => {
            if words.is_empty() || words.len() > 3 {
                return Err(count());
            }
            let size = words.get(1).map(|text| {
                let read = numbers::number(text);
                read.map_err(|_| {
                    Error::input(format!("SIZE (m) = {text}: must be a number above 0"))
                })
            });
            let laps = (words.len() > 2).then(|| number(2, "LAPS", 1.0, 10_000.0));
            let laps = laps.transpose()?.unwrap_or(1.0);
            let path = paths::named(words[0], ("SIZE", size.transpose()?))?;
            if laps.fract() != 0.0 || (laps > 1.0 && !path.is_closed()) {
                return Err(Error::input(format!(
                    "LAPS = {laps}: must be a whole number, and 1 for an open path"
                )));
            }
            let laps = laps as u32;
            Route::new(&path, laps, scenario).map_err(|error| Error::input(error.to_string()))?;
            Ok(ScriptStep::Follow {
                path: Box::new(path),
                laps,
                from_robot: paths::NAMES.contains(&words[0]),
            })
        }
        "stop" => exactly(0).map(|()| ScriptStep::Stop),
        "zero" => exactly(0).map(|()| ScriptStep::Zero),
        _ => exactly(0).map(|()| ScriptStep::Clear),
    }
}

/// Executes the steps in order, up to the first that fails. `observe` gets the record of each epoch. `ends` gets the
/// end of each step, also of a step with an error.
pub fn execute(
    robot: &mut impl Robot,
    scenario: &Scenario,
    lines: &[Line],
    mut observe: impl FnMut(&Record),
    ends: &mut Vec<StepEnd>,
) -> Result<(), Error> {
    for line in lines {
        let began = robot.now();
        let taken = execute_step(robot, scenario, &line.step, &mut observe);
        let mut goal = match line.step {
            ScriptStep::Goto(goal) => Some(goal),
            _ => None,
        };
        let (end, error) = match taken {
            Ok((end, at)) => {
                goal = goal.or(at);
                (end, None)
            }
            Err(error) => {
                let seconds = (robot.now() - began) as f64 * 1e-6;
                let mut end = RunEnd::of(robot, Cause::Unfinished, seconds);
                end.kind = EndKind::Stopped;
                let refused = matches!(
                    (&line.step, &error),
                    (
                        ScriptStep::Follow { .. },
                        Error::Input(_) | Error::Parameter(_)
                    )
                );
                end.condition = refused.then_some(Condition::PathLost).or(end.condition);
                end.reason = Some(error.to_string());
                (end, Some(error))
            }
        };
        let succeeded = end.is_success();
        ends.push(StepEnd {
            line: line.number,
            step: line.text.clone(),
            goal,
            end,
        });
        match error {
            Some(error) => return Err(error),
            None if !succeeded || robot.must_end() => break,
            None => {}
        }
    }
    Ok(())
}

/// Executes a step. Gives the end of the step and the last posture of its path.
fn execute_step(
    robot: &mut impl Robot,
    scenario: &Scenario,
    step: &ScriptStep,
    observe: &mut impl FnMut(&Record),
) -> Result<(RunEnd, Option<[f64; 3]>), Error> {
    if matches!(step, ScriptStep::Follow { .. }) {
        // The estimate is valid once the robot has settled.
        execute_step(robot, scenario, &ScriptStep::Wait(0.0), observe)?;
        let at = robot.record().lead.fused.robot.posture;
        let at = [at.x, at.y, at.phi].map(f64::from);
        let [_, most] = path_run::start_distances(scenario);
        let route = route(step, at, most, scenario);
        let route = route.map_err(|error| Error::input(error.to_string()))?;
        if let Some(route) = route {
            let on_epoch = |epoch: &path_run::PathEpoch| observe(&epoch.record);
            let outcome = path_run::drive_on(robot, scenario, &route, PathMode::Follow, on_epoch)?;
            return Ok((outcome.end, Some(route.goal())));
        }
    }
    let mut step_task = StepTask {
        step,
        scenario,
        observe,
        commanded_at: None,
        requested: false,
        // A robot whose motors are off needs no stop.
        stopped: robot.record().lead.mode == LeadMode::Idle,
    };
    let limit_s = step.limit_s(scenario);
    Ok((drive(robot, scenario, limit_s, &mut step_task)?, None))
}

/// Step in progress.
struct StepTask<'a, F> {
    step: &'a ScriptStep,
    scenario: &'a Scenario,
    observe: &'a mut F,
    /// Time of the latest command, µs.
    commanded_at: Option<Micros>,
    /// True if the posture, or the request for the zeros, has been sent.
    requested: bool,
    /// True if a robot driven by hand needs no further stop.
    stopped: bool,
}

impl<F> StepTask<'_, F> {
    /// Task that the keys command; `None` after a stop has been sent, until the next key.
    fn by_hand(&mut self, keyboard: &Keyboard) -> Option<Task> {
        let hand = keyboard.hand();
        let rests = hand.speed_m_s == 0.0;
        let stopped = std::mem::replace(&mut self.stopped, rests);
        let drive = Task::Drive {
            speed_m_s: hand.speed_m_s as f32,
            curvature: hand.curvature as f32,
        };
        let task = match rests {
            false => Some(drive),
            true => (!stopped).then_some(Task::Stop),
        };
        keyboard.take_task().or(task)
    }
}

/// Progress of a step without a goal: over if `finished`, else driving.
fn over(finished: bool) -> Progress {
    match finished {
        true => Progress::Over,
        false => Progress::Driving,
    }
}

impl<R: Robot, F: FnMut(&Record)> DriveTask<R> for StepTask<'_, F> {
    fn task(&self) -> Option<Task> {
        match *self.step {
            ScriptStep::Goto(goal) => Some(self.scenario.mission.regulate(goal)),
            ScriptStep::Speed {
                speed_m_s,
                curvature_per_m,
                ..
            } => Some(Task::Drive {
                speed_m_s: speed_m_s as f32,
                curvature: curvature_per_m as f32,
            }),
            ScriptStep::Stop => Some(Task::Stop),
            ScriptStep::Clear => Some(Task::Clear),
            ScriptStep::Pose(_) | ScriptStep::Zero => Some(Task::Idle),
            ScriptStep::Wait(_) | ScriptStep::Follow { .. } | ScriptStep::Hand(_) => None,
        }
    }

    fn feed(&mut self, robot: &mut R) -> Result<(), Error> {
        let now = robot.now();
        if let (ScriptStep::Hand(keyboard), Some(commanded_at)) = (self.step, self.commanded_at) {
            if now - commanded_at < SPEED_INTERVAL_US {
                return Ok(());
            }
            self.commanded_at = Some(now);
            let task = self.by_hand(keyboard);
            return task.map_or(Ok(()), |task| robot.command(&HostCommand::Task(task)));
        }
        let off = robot.record().lead.supervision.state == OperatingState::Idle;
        match (self.step, self.commanded_at, DriveTask::<R>::task(self)) {
            (ScriptStep::Speed { .. }, Some(commanded_at), Some(task))
                if now - commanded_at >= SPEED_INTERVAL_US =>
            {
                self.commanded_at = Some(now);
                robot.command(&HostCommand::Task(task))
            }
            (ScriptStep::Pose(pose), Some(_), _) if off && !self.requested => {
                self.requested = true;
                robot.command(&HostCommand::SetPose(place(robot, self.scenario, *pose)))
            }
            (ScriptStep::Zero, Some(_), _) if off && !self.requested => {
                self.requested = true;
                robot.monitor_mut().calibrated = None;
                let request = Message::BeamCalibration {
                    frame: FrameId(0),
                    sequence: 0,
                    calibrate: Calibrate::Zero(0.0),
                };
                bus::encode(&request).map_or(Ok(()), |frame| robot.send(&frame))
            }
            (ScriptStep::Zero, ..) => match robot.monitor().calibrated {
                Some((result, gauge)) => calibration_error(result, gauge).map_or(Ok(()), Err),
                None => Ok(()),
            },
            _ => Ok(()),
        }
    }

    fn must_end(&self, robot: &R) -> bool {
        // A fault does not end the steps `Clear` and `Hand`, in which faults are cleared.
        match self.step {
            ScriptStep::Clear | ScriptStep::Hand(_) => {
                robot.is_interrupted() || robot.is_out_of_time()
            }
            _ => robot.must_end(),
        }
    }

    fn epoch(&mut self, robot: &R, record: &Record, since: Option<Micros>) -> Progress {
        (self.observe)(record);
        let Some(since) = since else {
            return Progress::Driving;
        };
        self.commanded_at.get_or_insert(robot.now());
        let lead = &record.lead;
        let passed = |seconds: f64| since as f64 * 1e-6 >= seconds;
        match *self.step {
            ScriptStep::Goto(_) => match lead.phase {
                Phase::Done if lead.done && lead.mode == LeadMode::Hold => Progress::Done,
                _ => Progress::Driving,
            },
            ScriptStep::Speed { seconds, .. } | ScriptStep::Wait(seconds) => over(passed(seconds)),
            ScriptStep::Stop => over(passed(0.05) && lead.motion.v.abs() < REST_M_S),
            ScriptStep::Clear => over(passed(0.05) && is_clear(robot)),
            ScriptStep::Pose([x, y, _]) => {
                let at = lead.fused.robot.posture;
                let off = libm::hypot(f64::from(at.x) - x, f64::from(at.y) - y);
                over(self.requested && robot.is_settled() && off < 1e-3)
            }
            ScriptStep::Zero => {
                let result = robot.monitor().calibrated.map(|(result, _)| result);
                over(self.requested && result == Some(CalibrationResult::Stored))
            }
            ScriptStep::Follow { .. } => Progress::Over,
            ScriptStep::Hand(ref keyboard) => {
                over(keyboard.is_ended() && !keyboard.is_interrupted())
            }
        }
    }
}

/// Error of a calibration by the beam board; `None` if the result is stored. Gauges are numbered from 0 at the root.
pub fn calibration_error(result: CalibrationResult, gauge: u8) -> Option<Error> {
    let gauge = u32::from(gauge) + 1;
    let why = match result {
        CalibrationResult::Stored => return None,
        CalibrationResult::MotorsOn => "its motors are on: stop the robot".to_owned(),
        CalibrationResult::BadSample => {
            format!("gauge {gauge} is saturated or missing: check its wires")
        }
        CalibrationResult::Noisy => format!("gauge {gauge} scatters: hold the strip still"),
        CalibrationResult::Drifting => format!("gauge {gauge} moved: hold the strip still"),
        CalibrationResult::OutOfRange => {
            "the result is out of range: check the curvature, calibrate the zeros first".to_owned()
        }
        CalibrationResult::NotStored => {
            "the calibration is in use, but writing the flash failed".to_owned()
        }
    };
    Some(Error::Failure(format!("beam board: not calibrated: {why}")))
}

/// True if the lead node is idle and reports no condition.
fn is_clear(robot: &impl Robot) -> bool {
    let lead = robot.monitor().latest(Node::Lead);
    lead.is_some_and(|lead| lead.state == OperatingState::Idle && lead.reason.is_none())
}

/// Robot placed at a posture. Its frame is bent as the lead node estimates, or straight without an estimate.
fn place(robot: &impl Robot, scenario: &Scenario, pose: [f64; 3]) -> Placement {
    let fused = robot.record().lead.fused;
    let at = Posture::from(pose.map(|value| value as f32));
    let mut place = scenario
        .robot
        .placement(at, &scenario.mission.configured_placement());
    let known = fused.robot.covariance[0][0] > 0.0;
    if known {
        place.relative.posture = fused.front.posture.relative_to(fused.rear.posture);
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::simulation::Simulation;

    fn error(text: &str) -> String {
        let error = parse(text, &Scenario::default()).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{text}");
        error.to_string()
    }

    #[test]
    fn invalid_line_is_refused_with_number_and_fault() {
        for (text, expected) in [
            ("", "no step"),
            (
                "stop\ngotto 1 2 3",
                "line 2: gotto 1 2 3: must begin with goto",
            ),
            ("gotto 1 2 3", "did you mean goto?"),
            ("goto 1 2", "line 1: goto 1 2: must be: goto X Y PHI"),
            ("goto 1 x 2", "Y = x: must be a number from -1000 to 1000 m"),
            ("goto 1 2 inf", "PHI = inf: must be a number from"),
            ("goto 1 2 400deg", "from -360.00000 to 360.00000 °"),
            (
                "follow line sp.csv",
                "SIZE (m) = sp.csv: must be a number above 0",
            ),
            ("follow \"a b.csv", "unmatched quotation mark"),
            ("speed 9 0 1", "V (m/s) = 9: must be a number from -"),
            (
                "speed 0.1 50 1",
                "KAPPA (1/m) = 50: must be a number from -",
            ),
            ("speed 0.1 0 0", "SECONDS = 0: must be a number from 0.05"),
            ("wait -1", "SECONDS = -1: must be a number from 0"),
            ("stop now", "must be: stop"),
            ("follow circle 0.05", "curvature"),
            ("follow line 2 3", "LAPS = 3"),
            ("follow nowhere.csv", "nowhere.csv"),
        ] {
            let error = error(text);
            assert!(error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn quoted_words_are_read_alike_in_scripts_and_on_the_command_line() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("sp ace #1.csv");
        std::fs::write(&file, "0,0\n1,0\n2,0.1\n").unwrap();
        let file = file.display().to_string();
        let scenario = Scenario::default();
        let quoted = parse(&format!("follow \"{file}\" # comment"), &scenario).unwrap();
        let words = ["follow".to_owned(), file];
        let line = parse_words(&words, 1, &scenario).unwrap();
        assert_eq!(quoted, std::slice::from_ref(&line));
        // The text of a line, read as a script, gives the same line.
        assert_eq!(parse(&line.text, &scenario).unwrap(), [line]);
        let turn = |text: &str| parse(text, &scenario).unwrap().remove(0).step;
        assert_eq!(
            turn("goto 1 2 180deg"),
            ScriptStep::Goto([1.0, 2.0, std::f64::consts::PI])
        );
        assert_eq!(
            turn("pose 1 2 -90°"),
            ScriptStep::Pose([1.0, 2.0, -std::f64::consts::FRAC_PI_2])
        );
    }

    /// Compares the true posture of the plant after each step with the posture of the step.
    #[test]
    fn steps_end_at_their_true_postures() {
        let mut scenario = Scenario::default();
        scenario.mission.start = [0.0; 3];
        let text = "goto 1 0.2 0.3 # first\n\nspeed 0.1 0.5 4\nstop\nclear\npose 5 5 0\n\
                    follow line 0.5\nwait 0.5\ngoto 6 5 0";
        let lines = parse(text, &scenario).unwrap();
        let mut robot = Simulation::new(&scenario, 1, 0).unwrap();
        let mut ends = Vec::new();
        execute(&mut robot, &scenario, &lines, |_| (), &mut ends).unwrap();
        let numbers: Vec<usize> = ends.iter().map(|end| end.line).collect();
        assert_eq!(numbers, [1, 3, 4, 5, 6, 7, 8, 9]);
        assert!(ends.iter().all(|step| step.end.is_success()), "{ends:?}");
        let truth = |n: usize| ends[n].end.truth.unwrap();
        let estimate = |n: usize| ends[n].end.estimate.unwrap();
        let near = |at: [f64; 3], x: f64, y: f64| {
            let off = (at[0] - x).hypot(at[1] - y);
            assert!(off < 0.05, "{at:?}, expected {x}, {y}");
        };
        near(truth(0), 1.0, 0.2);
        // The robot drives an arc to the left; its length is speed times time less the ramps.
        let driven = (truth(2)[0] - 1.0).hypot(truth(2)[1] - 0.2);
        assert!((0.3..0.45).contains(&driven), "{driven}");
        assert!(
            (0.1..0.3).contains(&(truth(2)[2] - truth(0)[2])),
            "{ends:?}"
        );
        // Step pose shifts the estimate of all later steps; the robot does not move.
        near(truth(4), truth(3)[0], truth(3)[1]);
        assert!(
            (estimate(4)[0] - 5.0).hypot(estimate(4)[1] - 5.0) < 1e-3,
            "{ends:?}"
        );
        let moved = (truth(5)[0] - truth(4)[0]).hypot(truth(5)[1] - truth(4)[1]);
        assert!((moved - 0.5).abs() < 0.03, "{moved}");
        assert!(
            (estimate(7)[0] - 6.0).hypot(estimate(7)[1] - 5.0) < 0.01,
            "{ends:?}"
        );
    }
    /// After a stop the robot is at rest with its motors off. The latest end of the run also ends a drive by hand.
    #[test]
    fn simulated_robot_is_brought_to_rest_and_its_run_ends_in_time() {
        let mut scenario = Scenario::default();
        scenario.mission.start = [0.0; 3];
        let mut robot = Simulation::new(&scenario, 1, 0).unwrap();
        robot.control_mut().span.most = Some(2_000_000);
        let mut lines = parse("speed 0.2 0 9", &scenario).unwrap();
        execute(&mut robot, &scenario, &lines, |_| (), &mut Vec::new()).unwrap();
        assert!(robot.speed() > 0.1 && robot.now() == 2_000_000);
        robot.stop().unwrap();
        assert!(robot.speed() < 5e-3 && robot.torque() == [[0.0; 2]; 2]);
        lines = by_hand(Keyboard::default());
        execute(&mut robot, &scenario, &lines, |_| (), &mut Vec::new()).unwrap();
    }
}
