//! `cfmmr hil`: an experiment with virtual or real boards in the loop.

use crate::experiments::Context;
use crate::experiments::arguments::LogArgs;
use crate::experiments::arguments::{BoardArgs, Common, PlanArgs, RobotArgs, parse_posture};
use crate::experiments::boards::{DEFAULT_FLASH, Links};
use crate::experiments::follow;
use crate::experiments::follow::DriveArgs;
use crate::experiments::follow::FollowArgs;
use crate::experiments::mission::{Mission, Outcome, Plan, happenings};
use crate::experiments::posture::Variant;
use crate::experiments::recorder::Stage;
use clap::Args;
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::run::bit_compare::{Difference, Trace};
use host_sim::run::end::Ended;
use host_sim::run::path_run::PathMode;
use host_sim::run::real_time::RealTimeLimiter;
use host_sim::run::recovery::PAUSE;
use host_sim::run::recovery::Status;
use host_sim::run::robot::Robot;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::scenario::effect::Use;
use host_sim::targets;
use host_sim::targets::{Event, InProcess, Report as BoardReport, Target, What};
use output::table::Table;
use remote::Remote;
use remote::board_log;
use remote::board_log::BoardLog;
use serde::Serialize;
use serde_json::Value;
use std::path::PathBuf;

/// Arguments of `hil`.
#[derive(Clone, Debug, Args)]
pub struct HilArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Recording of the run.
    #[command(flatten)]
    pub log: LogArgs,
    /// Place of the boards.
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Use the parameters in the boards' flash, laid over those of the scenario
    #[arg(long)]
    pub stored: bool,
    /// With --on virtual: folder of the files with the boards' stores
    #[arg(long, value_name = "DIR", requires = "on")]
    pub flash: Option<PathBuf>,
    /// Run the nodes in this program too and compare every bit
    #[arg(long)]
    pub compare: bool,
    /// Sensors, start and speed.
    #[command(flatten)]
    pub drive: DriveArgs,
    /// Follow this path, as `follow --path`
    #[arg(long, value_name = "PATH", conflicts_with = "track")]
    pub follow: Option<String>,
    /// Track this trajectory, as `track --path`
    #[arg(long, value_name = "PATH")]
    pub track: Option<String>,
    /// Duration and failures.
    #[command(flatten)]
    pub plan: PlanArgs,
}

/// Minimum run time, s.
const LEAST_S: f64 = 20.0;

/// Result of an experiment with boards in the loop.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Result of the experiment.
    #[serde(flatten)]
    pub experiment: Value,
    /// True if every bit equals the run in process; `None` without `--compare`.
    pub identical: Option<bool>,
    /// First difference.
    pub difference: Option<String>,
    /// Ticks of the run.
    pub ticks: usize,
    /// Time the run took, s: from the first tick to the last.
    pub wall_s: f64,
    /// The boards.
    pub boards: Vec<BoardReport>,
    /// Boards lost and restarted.
    pub events: Vec<Event>,
    /// Heartbeats: the first of each node, and every change of state.
    pub nodes: Vec<Status>,
    /// Ticks that began more than a tick late, when pace was to be kept.
    pub late_ticks: Option<u32>,
}

/// Runs the command.
pub fn run(args: &HilArgs) -> Result<(), Error> {
    let mut context = Context::new(&args.common, "hil")?;
    let task = prepare(args, &mut context)?;
    let plan = Plan::new(&args.plan, LEAST_S)?;
    if !context.scenario.world.bus.quantise && args.boards.any() {
        return Err(Error::input(
            "bus.quantise = false: must be true with boards behind links",
        ));
    }
    let logs = Role::ALL.map(|_| BoardLog::default());
    let result = measure(args, &context, &task, &plan, &logs);
    let measured = board_log::kept(result, &logs, || context.output())?;
    let Measured {
        outcome,
        difference,
        mut report,
        recorded,
    } = measured;
    let end = outcome.end();
    // A run that the user ends early need not carry out its task.
    let stopped = end
        .failure()
        .map(|why| format!("the task was not carried out: {why}"));
    let (text, experiment, mut files) = task.publish(&context, outcome)?;
    report.experiment = experiment;
    board_log::put(&mut files, &logs);
    let text = format!("{text}\n{}", summary(&report));
    let excess = report.boards.iter().find_map(BoardReport::stack_excess);
    let different = difference.map(|difference| format!("not identical: {difference}"));
    let failed = excess.or(different).or(stopped);
    context.finish(&text, &report, files, &recorded, failed)
}

/// The experiment that the arguments ask for; what they change is written into the scenario.
fn prepare(args: &HilArgs, context: &mut Context) -> Result<Mission, Error> {
    if !args.boards.any() {
        return Err(Error::input(
            "hil: needs --on virtual or serial ports (--on serial:front=PORT,rear=PORT,beam=PORT); `cfmmr \
             doctor` lists the ports",
        ));
    }
    let scenario = &mut context.scenario;
    args.drive.sensors.apply(scenario);
    if !scenario.mission.rps && args.boards.port(Role::Beam).is_some() {
        return Err(Error::input(
            "--on serial:beam: no beam board without the relative position sensor",
        ));
    }
    let (path, path_mode) = match (&args.follow, &args.track) {
        (Some(path), _) => (path, PathMode::Follow),
        (None, Some(path)) => (path, PathMode::Track),
        (None, None) => {
            if args.drive.speed.is_some() || args.drive.size.is_some() {
                return Err(Error::input(
                    "--speed, --size: only with --follow or --track",
                ));
            }
            if let Some(text) = &args.drive.from {
                scenario.mission.start = parse_posture(text).map_err(Error::Input)?;
            }
            scenario.check()?;
            let variant = Variant::of(scenario);
            context.check_keys(&[], &[(&context.scenario, Use::Regulate)])?;
            return Ok(Mission::Posture(variant));
        }
    };
    let args = FollowArgs {
        common: args.common.clone(),
        log: args.log.clone(),
        path: path.clone(),
        drive: args.drive.clone(),
        robot: RobotArgs::default(),
    };
    let course = follow::prepare(&args, context, Use::Path)?;
    Ok(Mission::Path(Box::new(course), path_mode))
}

/// The boards that the arguments ask for. What they keep is laid over the scenario, if that is wanted.
fn boards(
    args: &HilArgs,
    scenario: &mut Scenario,
    logs: &[BoardLog; 3],
) -> Result<[Box<dyn Target>; 3], Error> {
    let kept = args.stored.then(|| PathBuf::from(DEFAULT_FLASH));
    let links = Links::new(&args.boards, args.flash.clone().or(kept))?;
    let mut board = |role: Role| -> Result<Box<dyn Target>, Error> {
        let link = match scenario.mission.rps || role != Role::Beam {
            true => links.open(role, &logs[role as usize])?,
            false => None,
        };
        let Some(link) = link else {
            return Ok(Box::new(InProcess::new(role)));
        };
        let mut remote = Remote::new(role, link);
        if args.stored {
            remote.greet()?;
            scenario.boards.put(role, &remote.own_parameters()?);
        }
        Ok(Box::new(remote))
    };
    let targets = [board(Role::Front)?, board(Role::Rear)?, board(Role::Beam)?];
    scenario.check()?;
    Ok(targets)
}

struct Measured {
    outcome: Outcome,
    difference: Option<Difference>,
    report: Report,
    recorded: Vec<PathBuf>,
}

/// Runs the experiment on the boards, and again in process if that is to be compared.
fn measure(
    args: &HilArgs,
    context: &Context,
    task: &Mission,
    plan: &Plan,
    logs: &[BoardLog; 3],
) -> Result<Measured, Error> {
    let mut scenario = task.scenario(context);
    let targets = boards(args, &mut scenario, logs)?;
    let (goal, path) = task.goal(&scenario);
    let mut stage = Stage::begin(&args.log, context, &scenario, (goal, &path))?;
    stage.span = plan.span;
    stage.real_time |= args.plan.real_time;
    let prepare = |targets: [Box<dyn Target>; 3]| -> Result<Simulation, Error> {
        let mut simulation = Simulation::on(targets, &scenario, context.seed, 0)?;
        simulation
            .boards()
            .plan(plan.failures.clone(), plan.restart_after);
        if plan.restart_after.is_some() {
            simulation.recover();
        }
        simulation.control_mut().span = plan.span;
        simulation.control_mut().interrupt = Some(context.interrupt().clone());
        simulation.record_trace();
        Ok(simulation)
    };
    let mut simulation = prepare(stage.tap(targets))?;
    let driven = stage.run(&mut simulation, |robot| task.drive(robot, &scenario))?;
    let trace = simulation.take_trace().unwrap_or_default();
    let difference = match args.compare {
        true => {
            let mut reference = prepare(targets::in_process())?;
            task.drive(&mut reference, &scenario)?;
            Some(trace.difference(&reference.take_trace().unwrap_or_default()))
        }
        false => None,
    };
    let report = report(&mut simulation, &trace, driven.wall_s, difference.as_ref());
    Ok(Measured {
        outcome: driven.outcome,
        difference: difference.flatten(),
        report,
        recorded: driven.recorded,
    })
}

fn report(
    simulation: &mut Simulation,
    trace: &Trace,
    wall_s: f64,
    difference: Option<&Option<Difference>>,
) -> Report {
    Report {
        experiment: Value::Null,
        identical: difference.map(Option::is_none),
        difference: difference
            .and_then(Option::as_ref)
            .map(Difference::to_string),
        ticks: trace.ticks(),
        wall_s,
        events: simulation.boards().events().to_vec(),
        boards: simulation.boards().reports(),
        nodes: simulation.monitor().changes().to_vec(),
        late_ticks: simulation
            .control()
            .pace
            .as_ref()
            .map(RealTimeLimiter::late),
    }
}

/// Summary of the boards.
fn summary(report: &Report) -> String {
    let mut table = Table::new([
        "board",
        "where",
        "image",
        "frames",
        "lost",
        "bytes a tick",
        "mean (µs)",
        "99 % (µs)",
        "max (µs)",
        "stack (bytes)",
    ]);
    for board in &report.boards {
        let mut row = vec![
            board.role.to_owned(),
            board.target.to_owned(),
            board.build.clone(),
            board.frames.to_string(),
            board.lost.to_string(),
            format!(
                "{:.0} + {:.0}",
                board.sent_per_tick, board.received_per_tick
            ),
        ];
        match &board.latency {
            Some(latency) => row.extend([
                format!("{:.0}", latency.mean_us),
                latency.p99_us.to_string(),
                latency.max_us.to_string(),
            ]),
            None => row.extend([const { String::new() }; 3]),
        }
        if let Some(stack) = &board.stack {
            row.push(format!("{} of {}", stack.used_bytes, stack.budget_bytes));
        }
        table.row(row);
    }
    let table = table.transposed();
    let simulated = report.ticks as f64 * 1e-3;
    let mut text = format!(
        "{table}\nlost: requests repeated; bytes: sent + received; times: from a tick to its answer, other\n\
         boards' included; stack: most used since the latest start, of its budget\n\n\
         {} ticks ({simulated:.1} s) in {:.1} s\n",
        report.ticks, report.wall_s
    );
    text += &happenings(report.late_ticks, &report.events, &report.nodes);
    if report
        .events
        .iter()
        .any(|event| event.what == What::Cleared)
    {
        let pause = f64::from(PAUSE) * 1e-3;
        text += &format!(
            "after a restart the host waited {pause} s, cleared the faults and repeated the task;\n\
             without the host the robot stays at rest\n"
        );
    }
    match (&report.difference, report.identical) {
        (Some(difference), _) => text += &format!("NOT identical: {difference}\n"),
        (None, Some(_)) => text += &format!("identical over {} ticks\n", report.ticks),
        (None, None) => {}
    }
    text
}
