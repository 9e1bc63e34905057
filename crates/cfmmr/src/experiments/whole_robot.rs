//! `posture` with boards, `follow` and `track`. With `--on virtual`: the images that users flash, on virtual boards with
//! everything that is wired to them. The robot gets its task at the serial port of the front board.

use crate::experiments::arguments::LogArgs;
use crate::experiments::arguments::{Common, Place, RobotArgs, SensorArgs};
use crate::experiments::follow;
use crate::experiments::follow::FollowArgs;
use crate::experiments::mission::{Mission, Outcome, Plan, happenings};
use crate::experiments::posture;
use crate::experiments::posture::{PostureArgs, Variant};
use crate::experiments::recorder;
use crate::experiments::recorder::Stage;
use crate::experiments::{Context, real_robot};
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::run::end::{EndKind, Ended};
use host_sim::run::final_error::FinalError;
use host_sim::run::path_run::PathMode;
use host_sim::run::real_time::RealTimeLimiter;
use host_sim::run::recovery::Status;
use host_sim::run::robot::Robot;
use host_sim::scenario::Scenario;
use host_sim::scenario::effect::Use;
use host_sim::targets::Event;
use output::table::Table;
use remote::board_log;
use remote::board_log::BoardLog;
use remote::images::Images;
use remote::virtual_robot::tools::profile;
use remote::virtual_robot::tools::profile::Profile;
use remote::virtual_robot::{BoardReport, Options, VirtualRobot};
use serde::Serialize;
use serde_json::Value;
use std::path::PathBuf;
use std::time::Instant;

/// Result of a run on virtual boards.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Report {
    /// Result of the experiment.
    #[serde(flatten)]
    experiment: Value,
    /// Distance of the midpoint from the goal at the end, m.
    e_m: f64,
    /// Heading less that of the goal at the end, rad.
    heading_rad: f64,
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
    /// Heartbeats: every change of state.
    nodes: Vec<Status>,
    /// Boards lost and restarted.
    events: Vec<Event>,
    /// Ticks that began more than a tick late, when pace was to be kept.
    late_ticks: Option<u32>,
}

/// Failures on the way, checked against the fitted boards and the longest time of the run, s.
fn plan(args: &RobotArgs, scenario: &Scenario, limit_s: f64) -> Result<Plan, Error> {
    let plan = Plan::new(&args.plan, 0.0)?;
    let mission = &scenario.mission;
    let most = plan.span.most.map_or(f64::MAX, |most| most as f64 * 1e-6);
    let end = most.min(limit_s);
    for (failure, text) in plan.failures.iter().zip(&args.plan.kill) {
        if failure.role == Role::Beam && !mission.rps {
            return Err(Error::input(format!(
                "--kill {text}: must be front or rear: no beam board without the relative position \
                 sensor"
            )));
        }
        let at = f64::from(failure.at) * 1e-3;
        if at >= end {
            return Err(Error::input(format!(
                "--kill {text}: {at} s: must be before the run ends, at {end} s"
            )));
        }
    }
    Ok(plan)
}

/// Runs `cfmmr posture` with boards.
pub fn posture(args: &PostureArgs) -> Result<(), Error> {
    if args.trials.is_some() || args.rows.is_some() {
        return Err(Error::input(
            "--trials, --rows: only in process; on boards there is one run of one robot",
        ));
    }
    let mut context = Context::new(&args.common, "posture")?;
    check_options(&args.robot, &args.sensors, &args.common)?;
    args.sensors.apply(&mut context.scenario);
    posture::place(args, &mut context)?;
    let variant = Variant::of(&context.scenario);
    let from = args.from.as_ref().map(|_| ("mission.start", "with --from"));
    let taken: Vec<_> = from.into_iter().collect();
    context.check_keys(&taken, &[(&context.scenario, Use::Virtual)])?;
    let mission = Mission::Posture(variant);
    run_on(&context, &mission, (&args.common, &args.log, &args.robot))
}

/// Runs `cfmmr follow` or `cfmmr track`.
pub fn follow(args: &FollowArgs, path_mode: PathMode) -> Result<(), Error> {
    let mut context = Context::new(&args.common, follow::names(path_mode).0)?;
    check_options(&args.robot, &args.drive.sensors, &args.common)?;
    let used = match args.robot.has_boards() {
        true => Use::VirtualPath,
        false => Use::Path,
    };
    let course = follow::prepare(args, &mut context, used)?;
    let mission = Mission::Path(Box::new(course), path_mode);
    run_on(&context, &mission, (&args.common, &args.log, &args.robot))
}

/// Refuses options of boards without boards, and what a real robot has of its own.
pub fn check_options(
    robot: &RobotArgs,
    sensors: &SensorArgs,
    common: &Common,
) -> Result<(), Error> {
    if !robot.has_boards() {
        return robot.refuse_without_boards();
    }
    let given = [
        ("--imu", sensors.imu),
        ("--no-rps", sensors.no_rps),
        ("--world", common.scenario.choice.world.is_some()),
    ];
    match given.iter().find(|(_, given)| *given) {
        Some((option, _)) if matches!(robot.boards.on, Place::Serial(_)) => {
            Err(Error::input(format!(
                "{option}: no effect with --on serial: a real robot has its sensors and its surroundings"
            )))
        }
        _ => Ok(()),
    }
}

/// Runs a task in this process, on virtual boards or on a real robot.
pub fn run_on(
    context: &Context,
    mission: &Mission,
    arguments: (&Common, &LogArgs, &RobotArgs),
) -> Result<(), Error> {
    let (_, log, args) = arguments;
    match args.boards.on {
        Place::InProcess => mission.in_process(context, log),
        Place::Virtual => run(context, mission, arguments),
        Place::Serial(_) => real_robot::run(context, mission, (log, args)),
    }
}

fn run(
    context: &Context,
    mission: &Mission,
    (common, log, args): (&Common, &LogArgs, &RobotArgs),
) -> Result<(), Error> {
    let plan = plan(args, &context.scenario, mission.limit_s(&context.scenario))?;
    recorder::check(log)?;
    let options = Options {
        threads: common.threads.map_or_else(Options::threads, usize::from),
        profile: args.profile,
        record: log.any(),
        ..Options::default()
    };
    let images = args.images.open()?;
    let logs = Role::ALL.map(|_| BoardLog::default());
    let drive = Drive {
        args,
        log,
        context,
        mission,
        scenario: mission.scenario(context),
        plan,
    };
    let done = drive.run(&images, &options, &logs);
    let done = board_log::kept(done, &logs, || context.output())?;
    let DriveOutcome {
        outcome,
        mut report,
        recorded,
        profiles,
    } = done;
    let undone = outcome.failure();
    // A script that --stop-after ends need not take all its steps.
    let undone = undone.filter(|_| outcome.end().kind != EndKind::Interrupted);
    let failed = failure(&report, undone);
    let (text, experiment, mut files) = mission.publish(context, outcome)?;
    report.experiment = experiment;
    board_log::put(&mut files, &logs);
    let mut text = format!("{text}\n{}", summary(&report));
    if args.profile {
        files.json("profile.json", &profiles);
        for profile in &profiles {
            files.text(
                &format!("profile-{}.folded", profile.board),
                profile.folded.as_str(),
            );
            text += &format!("\n{}", profile.table);
        }
    }
    context.finish(&text, &report, files, &recorded, failed)
}

/// A run that is about to begin.
struct Drive<'a> {
    args: &'a RobotArgs,
    log: &'a LogArgs,
    context: &'a Context,
    mission: &'a Mission,
    scenario: Scenario,
    plan: Plan,
}

/// Result.
struct DriveOutcome {
    outcome: Outcome,
    report: Report,
    /// Files that were written on the way.
    recorded: Vec<PathBuf>,
    profiles: Vec<Profile>,
}

impl Drive<'_> {
    fn run(
        &self,
        images: &Images,
        options: &Options,
        logs: &[BoardLog; 3],
    ) -> Result<DriveOutcome, Error> {
        let Self {
            log,
            context,
            mission,
            scenario,
            plan,
            ..
        } = self;
        let start = Instant::now();
        let (goal, path) = mission.goal(scenario);
        let mut stage = Stage::begin(log, context, scenario, (goal, &path))?;
        stage.span = plan.span;
        stage.real_time |= self.args.plan.real_time;
        mission.prepare(&mut stage);
        let mut robot = VirtualRobot::new(scenario, images, context.seed, 0, options, logs)?;
        robot.plan(plan.failures.clone(), plan.restart_after);
        let driven = stage.run(&mut robot, |robot| mission.drive(robot, scenario))?;
        let report = report(&mut robot, &goal, start);
        Ok(DriveOutcome {
            profiles: profile::of(&mut robot, &report.boards),
            outcome: driven.outcome,
            report,
            recorded: driven.recorded,
        })
    }
}

fn report(robot: &mut VirtualRobot, goal: &[f64; 3], start: Instant) -> Report {
    let error = FinalError::of(robot.record().midpoint, *goal);
    Report {
        experiment: Value::Null,
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

/// Failure of the run, if any: a task that was not carried out, or a problem of a board.
fn failure(report: &Report, undone: Option<String>) -> Option<String> {
    let cut = !report.events.is_empty();
    let problem = || report.boards.iter().find_map(|board| board.problem(cut));
    let undone = undone.map(|why| format!("the task was not carried out: {why}"));
    undone.or_else(problem)
}

/// Summary of the boards.
fn summary(report: &Report) -> String {
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
    for board in &report.boards {
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
    let instructions: u64 = report.boards.iter().map(|board| board.instructions).sum();
    let mut text = format!(
        "{table}\nReady {:.2} s after power on; {} frames.\n\
         {:.1} s simulated in {:.1} s: {:.2} times real time, {:.0} MIPS.\n",
        report.boot_s,
        report.frames,
        report.simulated_s,
        report.wall_s,
        report.simulated_s / report.wall_s,
        instructions as f64 * 1e-6 / report.wall_s,
    );
    text += &happenings(report.late_ticks, &report.events, &report.nodes);
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
    text
}
