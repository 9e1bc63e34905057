//! `cfmmr hil --virtual`: the experiment with the images that users flash, on virtual boards.

use super::posture::{self, Trial, Variant};
use super::{Context, watch_for_interrupt};
use crate::cli::HilArgs;
use crate::error::Error;
use crate::simulation::{self, Robot, Span};
use crate::supervision::Status;
use crate::table::Table;
use crate::targets::board_log::{self, BoardLog};
use crate::virtual_robot::{BoardReport, Images, Options, VirtualRobot};
use core_algos::node::Micros;
use core_algos::node::board::Role;
use core_algos::safety::OperatingState;
use serde::Serialize;
use serde_json::Value;
use std::time::Instant;

/// What the boards add to the result of the experiment.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Report {
    /// Result of the experiment.
    #[serde(flatten)]
    experiment: Value,
    /// Distance of the midpoint from the goal at the end, m.
    e_m: f64,
    /// Heading less that of the goal at the end, rad.
    heading_rad: f64,
    /// Whether the robot came to rest on the goal.
    reached: bool,
    /// Time from power on until all nodes were ready, s.
    boot_s: f64,
    /// Simulated time, boot included, s.
    simulated_s: f64,
    /// Time it took, s.
    wall_s: f64,
    /// Frames on the bus.
    frames: u64,
    /// The boards.
    boards: Vec<BoardReport>,
    /// What the nodes said of themselves: every change of state.
    nodes: Vec<Status>,
    /// Why the run ended before its task, if so.
    ended: Option<String>,
}

/// Runs the command.
pub fn run(args: &HilArgs) -> Result<(), Error> {
    let mut context = Context::new(&args.common, "hil")?;
    let scenario = &mut context.scenario;
    scenario.mission.rps &= !args.no_rps;
    scenario.sensors.gyro.fitted |= args.imu;
    scenario.sensors.accelerometer.fitted |= args.imu;
    scenario.check()?;
    let variant = Variant::of(scenario);
    let axle = args.axle_image.as_deref();
    let front = args.front_image.as_deref().or(axle);
    let rear = args.rear_image.as_deref().or(axle);
    let images = Images::open(front, rear, args.beam_image.as_deref())?;
    context.output()?;
    let interrupt = watch_for_interrupt()?;
    let logs = Role::ALL.map(|_| BoardLog::default());
    let scenario = variant.apply(&context.scenario);
    let start = Instant::now();
    let drive = || -> Result<(Trial, Report), Error> {
        let mut options = Options::default();
        if let Some(threads) = args.common.threads {
            options.threads = threads.into();
        }
        let mut robot = VirtualRobot::new(&scenario, &images, context.seed, 0, &options, &logs)?;
        robot.limit(Span {
            least: (args.duration * 1e6) as Micros,
            most: args.stop_after.map(|seconds| (seconds * 1e6) as Micros),
        });
        robot.stop_on(interrupt.clone());
        let mut trial = Trial::default();
        let outcome =
            simulation::regulate_on(&mut robot, &scenario, |record| trial.see(record, true))?;
        trial.outcome = outcome;
        let report = report(&mut robot, &trial, &scenario.mission.goal, start);
        Ok((trial, report))
    };
    let (trial, mut report) = match drive() {
        Ok(done) => done,
        Err(error) => {
            // What the boards said may tell why.
            let mut files = context.output()?;
            if board_log::put(&mut files, &logs) {
                files.commit()?;
            }
            return Err(error);
        }
    };
    let goal = context.scenario.mission.goal;
    let trials = std::slice::from_ref(&trial);
    let (text, experiment, mut files) =
        posture::publish(&context, &[variant], &[variant], trials, goal)?;
    report.experiment =
        serde_json::to_value(experiment).map_err(|error| Error::Failure(error.to_string()))?;
    board_log::put(&mut files, &logs);
    files.json("result.json", &report);
    let text = format!("{text}\n{}", summary(&report));
    context.finish_with(&text, &report, files, Vec::new())?;
    match judge(&report, args.stop_after.is_some()) {
        Some(why) => Err(Error::Failure(why)),
        None => Ok(()),
    }
}

fn report(robot: &mut VirtualRobot, trial: &Trial, goal: &[f64; 3], start: Instant) -> Report {
    let error = posture::FinalError::of(trial.outcome.midpoint, *goal);
    Report {
        experiment: Value::Null,
        e_m: error.e_m,
        heading_rad: error.heading_rad,
        reached: trial.outcome.done,
        boot_s: robot.boot_s(),
        simulated_s: robot.boot_s() + robot.now() as f64 * 1e-6,
        wall_s: start.elapsed().as_secs_f64(),
        frames: robot.frames(),
        boards: robot.reports(),
        nodes: robot.monitor().changes().to_vec(),
        ended: robot.failure().map(str::to_owned),
    }
}

/// What is wrong with the run, if anything; one that was to end early need not reach the goal.
fn judge(report: &Report, early: bool) -> Option<String> {
    if let Some(why) = &report.ended {
        return Some(why.clone());
    }
    for board in &report.boards {
        if let Some((time_s, cause)) = board.resets.first() {
            return Some(format!(
                "{} board: reset by {cause} at {time_s:.3} s",
                board.name
            ));
        }
        if let Some(finding) = board.findings.first() {
            return Some(format!(
                "{} board: {}: {}, in {}",
                board.name, finding.kind, finding.text, finding.place
            ));
        }
        for (count, what) in [
            (u64::from(board.missed_ticks), "ticks missed"),
            (board.can.overrun, "frames lost by overrun"),
            (board.can.error_frames, "error frames"),
        ] {
            if count > 0 {
                return Some(format!("{} board: {count} {what}", board.name));
            }
        }
    }
    (!report.reached && !early).then(|| "the robot did not come to rest on the goal".to_owned())
}

/// What is to be said of the boards.
fn summary(report: &Report) -> String {
    let mut table = Table::new([
        "board",
        "resets",
        "findings",
        "longest tick (µs)",
        "late (µs)",
        "loop (µs)",
        "missed",
        "load",
        "stack (bytes)",
        "boot (bytes)",
        "sent",
        "received",
        "overrun",
        "errors",
    ]);
    let or_none = |value: Option<String>| value.unwrap_or_default();
    for board in &report.boards {
        let stack = board.stack_used.zip(board.stack_size);
        table.row([
            board.name.to_owned(),
            board.resets.len().to_string(),
            board.findings.len().to_string(),
            board.longest_tick_us.to_string(),
            board.tick_lateness_us.to_string(),
            or_none(board.longest_current_loop_us.map(|us| format!("{us:.1}"))),
            board.missed_ticks.to_string(),
            format!("{:.0} %", 100.0 * board.load),
            or_none(stack.map(|(used, size)| format!("{used} of {size}"))),
            or_none(board.boot_stack.map(|used| used.to_string())),
            board.can.sent.to_string(),
            board.can.received.to_string(),
            board.can.overrun.to_string(),
            board.can.error_frames.to_string(),
        ]);
    }
    let instructions: u64 = report.boards.iter().map(|board| board.instructions).sum();
    let mut text = format!(
        "{table}\nReady {:.2} s after power on; {} frames. {:.1} s simulated in {:.1} s: {:.2} times real \
         time, {:.0} MIPS.\n",
        report.boot_s,
        report.frames,
        report.simulated_s,
        report.wall_s,
        report.simulated_s / report.wall_s,
        instructions as f64 * 1e-6 / report.wall_s,
    );
    for board in &report.boards {
        for (time_s, cause) in &board.resets {
            text += &format!("{time_s:.3} s: {} board reset by {cause}\n", board.name);
        }
        for finding in &board.findings {
            text += &format!(
                "{:.6} s: {} board: {}: {}, in {} ({} times)\n",
                finding.time_s,
                board.name,
                finding.kind,
                finding.text,
                finding.place,
                finding.count
            );
        }
    }
    let faults = report.nodes.iter();
    for status in faults.filter(|status| status.state == OperatingState::Fault) {
        text += &format!("{status}\n");
    }
    text
}
