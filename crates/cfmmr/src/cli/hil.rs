//! `cfmmr hil`: an experiment with virtual or real boards in the loop.

use super::arguments::{BoardArgs, Common, LogArgs, PlanArgs, parse_posture};
use super::follow::CourseArgs;
use crate::experiments::Context;
use crate::experiments::follow;
use crate::experiments::follow::PATH;
use crate::experiments::posture::Variant;
use crate::experiments::run::mission::Mission;
use crate::experiments::run::{Run, check, in_the_loop};
use clap::Args;
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::run::path_run::PathMode;
use host_sim::scenario::effect::Use;
use host_sim::scenario::own::Own;
use remote::board_log;
use remote::board_log::BoardLog;
use std::path::PathBuf;

/// Arguments of `hil`.
#[derive(Clone, Debug, Args)]
pub struct HilArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Options of recording and display.
    #[command(flatten)]
    pub log: LogArgs,
    /// Options that select where the boards run.
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Use the parameters in the boards' flash instead of the scenario's parameters
    #[arg(long)]
    pub stored: bool,
    /// Keep the flash of virtual boards in files in this folder
    #[arg(long, value_name = "DIR", requires = "on")]
    pub flash: Option<PathBuf>,
    /// Repeat the run in this program and check that every output is identical
    #[arg(long)]
    pub compare: bool,
    /// Options of path, start and sensors.
    #[command(flatten)]
    pub drive: CourseArgs,
    /// Follow this path, as `follow --path`
    #[arg(long, value_name = "PATH", conflicts_with = "track")]
    pub follow: Option<String>,
    /// Track this trajectory, as `track --path`
    #[arg(long, value_name = "PATH")]
    pub track: Option<String>,
    /// Options of duration and board failures.
    #[command(flatten)]
    pub plan: PlanArgs,
}

/// Minimum run time, s.
const MIN_DURATION_S: f64 = 20.0;

/// Runs `cfmmr hil`.
pub fn run(args: &HilArgs, own: &Own) -> Result<(), Error> {
    own.check_outside("hil")?;
    let mut context = args.common.context("hil", own)?;
    args.boards.check()?;
    let mission = prepare(args, &mut context)?;
    let plan = args
        .plan
        .plan(context.scenario.robot.topology(), MIN_DURATION_S)?;
    if !context.scenario.world.bus.quantise {
        return Err(Error::input(
            "bus.quantise = false: must be true with boards in the loop",
        ));
    }
    let outputs = args.log.outputs();
    check(&context.scenario, &mission, &plan, &outputs)?;
    let boards = in_the_loop::BoardUse {
        stored: args.stored,
        flash: args.flash.clone(),
    };
    let logs = BoardLog::of_boards(context.scenario.robot.topology());
    let place = (&args.boards.on, args.boards.baud());
    let targets = in_the_loop::connect(place, &boards, &mut context.scenario, &logs);
    let targets = board_log::keep_logs_on_error(targets, &logs, || context.output())?;
    let run = Run {
        context: &context,
        mission: &mission,
        plan,
        outputs: &outputs,
    };
    in_the_loop::run(&run, targets, &logs, args.compare)
}

/// Mission that the arguments select; writes sensors, start and path settings into the scenario.
fn prepare(args: &HilArgs, context: &mut Context) -> Result<Mission, Error> {
    if !args.boards.on.is_outside() {
        return Err(Error::input(
            "hil: needs --on virtual or serial ports (--on serial:front=PORT,rear=PORT,beam=PORT); `cfmmr \
             doctor` lists the ports",
        ));
    }
    let scenario = &mut context.scenario;
    args.drive.sensors.apply(scenario);
    let robot = scenario.robot.topology();
    args.boards.on.check(robot)?;
    let mut beams = robot.frames().map(Role::Beam);
    let port = beams.find(|beam| args.boards.on.port(robot, *beam).is_some());
    if let Some(beam) = port.filter(|_| !scenario.mission.rps) {
        return Err(Error::input(format!(
            "--on serial: {}=PORT: must be left out without the relative position sensor (--no-rps)",
            robot.name(beam)
        )));
    }
    let (path, path_mode) = match (&args.follow, &args.track) {
        (Some(path), _) => (path, PathMode::Follow),
        (None, Some(path)) => (path, PathMode::Track),
        (None, None) => {
            let drive = &args.drive;
            if drive.speed.is_some() || drive.size.is_some() || drive.laps != 1 {
                return Err(Error::input(
                    "--speed, --size, --laps: only with --follow or --track",
                ));
            }
            if let Some(text) = &args.drive.from {
                scenario.mission.start = parse_posture(text)?;
            }
            scenario.check()?;
            let variant = Variant::of(scenario);
            context.check_keys(&[], &[(&context.scenario, Use::Regulate)])?;
            return Ok(Mission::Posture(variant));
        }
    };
    let path_options = args.drive.path_options(path)?;
    let course = follow::prepare(&path_options, &mut context.scenario)?;
    context.check_keys(PATH, &[(&context.scenario, Use::Path)])?;
    context.output()?;
    Ok(Mission::Path(Box::new(course), path_mode))
}
