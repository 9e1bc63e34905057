//! Robot on virtual boards, which run the images for real boards with simulated wiring. The robot is commanded through
//! the serial port of the front board.

use super::mission::Outcome;
use super::place::Site;
use super::stage::Driven;
use super::{BoardValues, Boards, Run, events_text};
use host_sim::base::error::Error;
use host_sim::run::final_error::FinalError;
use host_sim::run::real_time::RealTimeLimiter;
use host_sim::run::recovery::Status;
use host_sim::run::robot::Robot;
use host_sim::targets::Event;
use output::files;
use output::table::Table;
use remote::board_log;
use remote::board_log::BoardLog;
use remote::images::Images;
use remote::virtual_robot::tools::profile;
use remote::virtual_robot::{BoardReport, Options, VirtualRobot};
use serde::Serialize;
use std::time::Instant;

/// Result of virtual boards after a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct VirtualBoardValues {
    /// Distance of the true midpoint from the goal at the end, m.
    e_m: f64,
    /// True heading less goal heading at the end, rad.
    heading_rad: f64,
    /// Time from power on until all nodes were ready, s.
    boot_s: f64,
    /// Simulated time, boot included, s.
    simulated_s: f64,
    /// Wall-clock time, boot included, s.
    wall_s: f64,
    /// Number of frames on the bus.
    frames: u64,
    boards: Vec<BoardReport>,
    /// Heartbeats at each change of a node's state.
    nodes: Vec<Status>,
    /// Boards lost and restarted.
    events: Vec<Event>,
    /// Number of ticks that began more than one tick late, in a run in real time.
    late_ticks: Option<u32>,
}

/// Drives the mission and publishes the result.
pub(super) fn run(run: &Run, site: &Site) -> Result<(), Error> {
    let context = run.context;
    let [axle, beam] = site.images.each_ref().map(|image| image.as_deref());
    let images = Images::open(axle, beam)?;
    let options = Options {
        threads: site.threads,
        profile: site.profile,
        record: run.outputs.records(),
        ..Options::default()
    };
    let logs = BoardLog::of_boards(context.scenario.robot.topology());
    let driven = drive(run, &images, &options, &logs);
    let (driven, mut boards) = board_log::keep_logs_on_error(driven, &logs, || context.output())?;
    boards.files.extend(board_log::files(&logs));
    run.publish(driven, boards)
}

/// Drives the mission with a robot on virtual boards.
fn drive(
    run: &Run,
    images: &Images,
    options: &Options,
    logs: &[BoardLog],
) -> Result<(Driven<Outcome>, Boards), Error> {
    let Run { context, plan, .. } = run;
    let scenario = &context.scenario;
    let mut start = Instant::now();
    let (mut robot, driven) = run.on(|_| {
        start = Instant::now();
        let mut robot = VirtualRobot::new(scenario, images, context.seed, 0, options, logs)?;
        robot.plan(plan.failures.clone(), plan.restart_after);
        Ok(robot)
    })?;
    let (goal, _) = run.mission.goal(scenario);
    let values = values(&mut robot, &goal, start);
    let cut = !values.events.is_empty();
    let mut boards = Boards {
        text: summary(&values),
        problem: values.boards.iter().find_map(|board| board.problem(cut)),
        ..Boards::default()
    };
    let profiles = profile::of(&mut robot, &values.boards);
    if !profiles.is_empty() {
        let json = files::json(&profiles);
        boards.files.push(("profile.json".to_owned(), json));
    }
    for profile in profiles {
        let name = format!("profile-{}.folded", profile.board);
        boards.text += &format!("\n{}", profile.table);
        boards.files.push((name, profile.folded));
    }
    boards.values = BoardValues::Virtual(values);
    Ok((driven, boards))
}

fn values(robot: &mut VirtualRobot, goal: &[f64; 3], start: Instant) -> VirtualBoardValues {
    let error = FinalError::of(robot.record().midpoint, *goal);
    VirtualBoardValues {
        e_m: error.e_m,
        heading_rad: error.heading_rad,
        boot_s: robot.boot_s(),
        simulated_s: robot.boot_s() + robot.now() as f64 * 1e-6,
        wall_s: start.elapsed().as_secs_f64(),
        frames: robot.frames(),
        boards: robot.reports(),
        nodes: robot.monitor().changes().to_vec(),
        events: robot.events().to_vec(),
        late_ticks: robot.control().pace.as_ref().map(RealTimeLimiter::late),
    }
}

fn summary(values: &VirtualBoardValues) -> String {
    let mut table = Table::new([
        "board",
        "build",
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
    for board in &values.boards {
        let stack = board.stack_used.zip(board.stack_size);
        table.row([
            board.name.to_owned(),
            or_none(board.build.clone()),
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
    let table = table.transposed();
    let instructions: u64 = values.boards.iter().map(|board| board.instructions).sum();
    let mut text = format!(
        "{table}\nReady {:.2} s after power on; {} frames.\n\
         {:.1} s simulated in {:.1} s: {:.2} times real time, {:.0} MIPS.\n",
        values.boot_s,
        values.frames,
        values.simulated_s,
        values.wall_s,
        values.simulated_s / values.wall_s,
        instructions as f64 * 1e-6 / values.wall_s,
    );
    text += &events_text(values.late_ticks, &values.events, &values.nodes);
    for board in &values.boards {
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
    text
}
