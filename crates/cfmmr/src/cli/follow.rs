//! `cfmmr follow` and `cfmmr track`: path following and trajectory tracking.

use super::arguments::{Common, LogArgs, RobotArgs, SensorArgs, parse_posture};
use crate::experiments::follow;
use crate::experiments::follow::{PATH, PathOptions};
use crate::experiments::run::mission::Mission;
use clap::Args;
use host_sim::base::error::Error;
use host_sim::base::numbers::{number, whole};
use host_sim::run::path_run::PathMode;
use host_sim::scenario::effect::Use;
use host_sim::scenario::own::Own;

/// Speed, size, laps, start and sensors of a drive along a path.
#[derive(Clone, Debug, Args)]
pub struct CourseArgs {
    /// Limit the speed along the path, m/s; `track` allows at most 90 % of the robot's limit
    /// [default: the scenario's, 0.2]
    #[arg(long, value_name = "M/S", value_parser = number)]
    pub speed: Option<f64>,
    /// Set the length of the line, radius of the circle or half width of the figure eight, m [default: 3,
    /// 1, 1.5]
    #[arg(long, value_name = "M", value_parser = number)]
    pub size: Option<f64>,
    /// Drive this number of laps of a closed path
    #[arg(long, default_value_t = 1, value_parser = whole::<u32>(1..=10_000))]
    pub laps: u32,
    /// Start at this posture of the midpoint O, as in `posture` [default: on the first point of the path,
    /// along the path]
    #[arg(long, value_name = "X,Y,PHI", allow_hyphen_values = true)]
    pub from: Option<String>,
    /// Options that select the sensors.
    #[command(flatten)]
    pub sensors: SensorArgs,
}

impl CourseArgs {
    /// Options of a drive along `path`, from the command line.
    pub fn path_options(&self, path: &str) -> Result<PathOptions, Error> {
        Ok(PathOptions {
            path: path.to_owned(),
            size: self.size,
            laps: self.laps,
            speed_m_s: self.speed,
            start: self.from.as_deref().map(parse_posture).transpose()?,
        })
    }
}

/// Arguments of `follow` and `track`.
#[derive(Clone, Debug, Args)]
pub struct FollowArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Options of recording and display.
    #[command(flatten)]
    pub log: LogArgs,
    /// Drive along this path: line, circle, figure-eight, or a CSV file of waypoints (columns x,y in m)
    #[arg(long, default_value = "figure-eight", value_name = "PATH")]
    pub path: String,
    /// Options of path, start and sensors.
    #[command(flatten)]
    pub drive: CourseArgs,
    /// Options of the robot: its boards and the duration of the run.
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// Runs `cfmmr follow` or `cfmmr track`.
pub fn run(args: &FollowArgs, path_mode: PathMode, own: &Own) -> Result<(), Error> {
    let mut context = args.common.context(follow::names(path_mode).0, own)?;
    let boards = &args.robot.boards;
    args.robot
        .check(&args.drive.sensors, &args.common.scenario.choice)?;
    let used = match boards.on.is_outside() {
        true => Use::VirtualPath,
        false => Use::Path,
    };
    args.drive.sensors.apply(&mut context.scenario);
    let path_options = args.drive.path_options(&args.path)?;
    let course = follow::prepare(&path_options, &mut context.scenario)?;
    context.check_keys(PATH, &[(&context.scenario, used)])?;
    context.output()?;
    if boards.on.has_ports() {
        context.check_mission_keys()?;
    }
    let mission = Mission::Path(Box::new(course), path_mode);
    let threads = args.common.run.threads;
    args.robot.run(&context, &mission, &args.log, threads)
}
