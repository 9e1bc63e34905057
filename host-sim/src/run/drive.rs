//! The run loop: a robot carries out a task, with its boards in this process or behind links.

use crate::base::error::Error;
use crate::run::end::{Cause, EndKind, RunEnd};
use crate::run::robot::{Record, Robot};
use crate::scenario::Scenario;
use crate::targets::HostCommand;
use core_algos::node::lead::Task;
use core_algos::time::{EPOCH, Micros, TICK};

/// Progress of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// The task is in progress.
    Driving,
    /// The lead node reports the task as done; the run ends after the robot has rested.
    Done,
    /// The task is carried out; the run ends at once.
    Over,
}

/// Time after the start of a task from which a failure reported by the lead node belongs to that task, µs.
const FAILURE_VALID_AFTER_US: Micros = 5 * EPOCH;

/// Time at rest after which all notices of the end have arrived, µs.
const NOTICE_DELAY_US: Micros = 10 * EPOCH;

/// Task that the host gives and observes.
pub trait DriveTask<R: Robot> {
    /// Task that the lead node gets once the robot has settled. `None` keeps the lead node's present task.
    fn task(&self) -> Option<Task>;

    /// Sends further commands at the beginning of an epoch, such as points of a path.
    fn feed(&mut self, _robot: &mut R) -> Result<(), Error> {
        Ok(())
    }

    /// Progress after a tick, from the start of the task.
    fn tick(&mut self, _robot: &R) -> Progress {
        Progress::Driving
    }

    /// True if the run must end, even if the task is not done.
    fn must_end(&self, robot: &R) -> bool {
        robot.must_end()
    }

    /// Progress at the end of an epoch. `since` is the time since the lead node received the task, µs; `None` before.
    fn epoch(&mut self, robot: &R, record: &Record, since: Option<Micros>) -> Progress;
}

/// Runs a task on a robot: waits until the robot has settled, gives the task, and steps the robot. The run ends when
/// the robot has rested after the task, when the task is over or has failed, or `limit_s` after the start of the task.
pub fn drive<R: Robot>(
    robot: &mut R,
    scenario: &Scenario,
    limit_s: f64,
    drive_task: &mut impl DriveTask<R>,
) -> Result<RunEnd, Error> {
    let micros = |seconds: f64| (seconds * 1e6) as Micros;
    let settle = micros(scenario.mission.settle_s) / EPOCH * EPOCH;
    // A robot past its settling time gets the task at the next epoch.
    let settle = settle.max(robot.now().next_multiple_of(EPOCH));
    let limit = settle.saturating_add(micros(limit_s));
    let rest = micros(scenario.mission.rest_s).max(NOTICE_DELAY_US);
    robot.monitor_mut().begin_task();
    // Failures end the run only if the run loop gave the task. A drive task handles the failures of the tasks that it
    // gives itself.
    let given = drive_task.task().is_some();
    let (mut began, mut done_at): (Option<Micros>, Option<Micros>) = (None, None);
    let mut cause = None;
    // A task that is done at the time limit runs on until the notices of its end have arrived.
    while robot.now() < limit || done_at.is_some_and(|at| robot.now() < at + NOTICE_DELAY_US) {
        let now = robot.now();
        if now.is_multiple_of(EPOCH) {
            drive_task.feed(robot)?;
        }
        if now == settle
            && let Some(task) = drive_task.task()
        {
            robot.command(&HostCommand::Task(task))?;
        }
        if began.is_none() && now >= settle && robot.is_settled() {
            began = Some(now);
        }
        match robot.step() {
            Err(Error::NoAnswer(why)) => {
                cause = Some(Cause::NoAnswer(why));
                break;
            }
            stepped => stepped?,
        }
        if now >= settle && drive_task.tick(robot) == Progress::Over {
            break;
        }
        if !robot.now().is_multiple_of(EPOCH) {
            continue;
        }
        let record = robot.record();
        let since = began.map(|began| robot.now() - began);
        match drive_task.epoch(robot, &record, since) {
            Progress::Driving => done_at = None,
            Progress::Over => {
                cause = Some(Cause::Done);
                break;
            }
            Progress::Done => {
                let since = *done_at.get_or_insert(robot.now() - TICK);
                if now - since >= rest && robot.may_end() {
                    break;
                }
            }
        }
        let failed = given && record.lead.failed.is_some() && since >= Some(FAILURE_VALID_AFTER_US);
        if failed || drive_task.must_end(robot) {
            break;
        }
    }
    let interrupted = match () {
        () if robot.is_interrupted() => Some(Cause::Interrupted(None)),
        () if robot.is_out_of_time() => Some(Cause::Interrupted(Some("--stop-after"))),
        () => None,
    };
    let done = done_at.filter(|_| robot.failure().is_none());
    let done = done.map(|_| Cause::AtGoal);
    let cause = cause.or(done).or(interrupted);
    let seconds = |at: Micros| at.saturating_sub(settle) as f64 * 1e-6;
    let duration_s = seconds(done_at.unwrap_or(robot.now()));
    let mut end = RunEnd::of(robot, cause.unwrap_or(Cause::Unfinished), duration_s);
    if let (EndKind::Stopped, Some(fault)) = (end.kind, robot.monitor().first_fault()) {
        end.duration_s = seconds(micros(fault.time_s));
    }
    Ok(end)
}
