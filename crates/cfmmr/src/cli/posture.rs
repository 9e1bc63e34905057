//! `cfmmr posture`: posture regulation with and without the relative position sensor, as in the paper's experiment.

use super::arguments::{Common, LogArgs, RobotArgs, SensorArgs, parse_posture};
use crate::experiments::Context;
use crate::experiments::posture::{self, ROWS, Variant};
use crate::experiments::run::mission::Mission;
use crate::experiments::run::stage::Outputs;
use clap::{Args, ValueEnum};
use core_algos::topology::Topology;
use host_sim::base::error::Error;
use host_sim::base::numbers::whole;
use host_sim::scenario::Scenario;
use host_sim::scenario::effect;
use host_sim::scenario::effect::Use;
use host_sim::scenario::own::Own;

/// Selection of the rows (sensors and fusion) of the result table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RowSelection {
    /// Encoders alone, the paper's fusion, the joint filter.
    Main,
    /// Every fusion, with and without inertial sensors.
    All,
    /// Encoders alone and the joint filter.
    Pair,
    /// The joint filter, without and with inertial sensors.
    Joint,
}

/// Arguments of `posture`.
#[derive(Clone, Debug, Args)]
pub struct PostureArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Options of recording and display.
    #[command(flatten)]
    pub log: LogArgs,
    /// Run this number of paired trials per row [default: 50]
    #[arg(long, value_parser = whole::<u32>(1..=1_000_000), conflicts_with_all = ["dashboard", "live"])]
    pub trials: Option<u32>,
    /// Start at this posture of the midpoint O: m, m, rad, or heading with `deg`: -1.5,0.2,90deg
    #[arg(long, value_name = "X,Y,PHI", allow_hyphen_values = true)]
    pub from: Option<String>,
    /// Run these rows of the table [default: main]
    #[arg(long, value_enum, conflicts_with_all = ["dashboard", "live"])]
    pub rows: Option<RowSelection>,
    /// Options that select the sensors.
    #[command(flatten)]
    pub sensors: SensorArgs,
    /// Options of the robot: its boards and the duration of the run.
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// Default number of trials per row.
const TRIALS: u32 = 50;

/// Runs `cfmmr posture`.
pub fn run(args: &PostureArgs, own: &Own) -> Result<(), Error> {
    let outside = args.robot.boards.on.is_outside();
    if outside && (args.trials.is_some() || args.rows.is_some()) {
        return Err(Error::input(
            "--trials, --rows: only with --on in-process; with other boards, posture is one run of one robot",
        ));
    }
    let mut context = args.common.context("posture", own)?;
    args.robot
        .check(&args.sensors, &args.common.scenario.choice)?;
    if let Some(text) = &args.from {
        context.scenario.mission.start = parse_posture(text)?;
    }
    let outputs = args.log.outputs();
    match outside {
        true => on_boards(args, context),
        false => trials(args, &context, &outputs),
    }
}

/// Scenario key that `--from` replaces, with the reason.
fn start(args: &PostureArgs) -> Option<(&'static str, &'static str)> {
    args.from.as_ref().map(|_| ("mission.start", "with --from"))
}

/// Drives once on virtual or real boards.
fn on_boards(args: &PostureArgs, mut context: Context) -> Result<(), Error> {
    args.sensors.apply(&mut context.scenario);
    context.scenario.check()?;
    let taken: Vec<_> = start(args).into_iter().collect();
    context.check_keys(&taken, &[(&context.scenario, Use::Virtual)])?;
    if args.robot.boards.on.has_ports() {
        context.check_mission_keys()?;
    }
    let mission = Mission::Posture(Variant::of(&context.scenario));
    let threads = args.common.run.threads;
    args.robot.run(&context, &mission, &args.log, threads)
}

/// Runs the trials of all rows with in-process boards.
fn trials(args: &PostureArgs, context: &Context, outputs: &Outputs) -> Result<(), Error> {
    context.scenario.check()?;
    let variants = args.variants(context.scenario.robot.topology(), outputs)?;
    let rows = variants.iter().map(|row| row.apply(&context.scenario));
    let rows: Vec<Scenario> = rows.collect();
    let runs: Vec<effect::Run> = rows.iter().map(|row| (row, Use::Regulate)).collect();
    let taken: Vec<_> = ROWS.iter().copied().chain(start(args)).collect();
    context.check_keys(&taken, &runs)?;
    let seeds = context.seeds(args.trials.unwrap_or(TRIALS) as usize);
    posture::run(context, outputs, &variants, seeds)
}

impl PostureArgs {
    /// Selected rows of the table: `--no-rps` keeps rows without gauges, `--imu` adds inertial sensors to every row.
    /// With `--live` or `--dashboard` there is one row. Fusions of one pair of axles are left out on longer robots.
    fn variants(&self, robot: Topology, outputs: &Outputs) -> Result<Vec<Variant>, Error> {
        let sensors = &self.sensors;
        let rows = match self.rows.unwrap_or(RowSelection::Main) {
            RowSelection::Main => &Variant::MAIN[..],
            RowSelection::All => &Variant::ALL,
            RowSelection::Pair => &Variant::PAIR,
            RowSelection::Joint => &Variant::JOINT,
        };
        let shown = match outputs.is_live() {
            true if sensors.no_rps => &Variant::PAIR[..1],
            true => &Variant::PAIR[1..],
            false => rows,
        };
        let mut kept: Vec<Variant> = Vec::new();
        let kept_row = |row: &&Variant| row.fits(robot) && !(sensors.no_rps && row.rps);
        for row in shown.iter().filter(kept_row) {
            let row = Variant {
                imu: row.imu || sensors.imu,
                ..*row
            };
            if !kept.contains(&row) {
                kept.push(row);
            }
        }
        match kept.is_empty() {
            true => Err(Error::input(
                "--no-rps: no row is left; every row of --rows joint has gauges",
            )),
            false => Ok(kept),
        }
    }
}
