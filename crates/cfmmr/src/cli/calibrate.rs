//! `cfmmr calibrate`: calibrates wheels, strain gauges and gyros of a simulated robot on in-process or virtual boards,
//! and the strain gauges of a real robot.

use super::arguments::{BoardArgs, JsonArgs, ScenarioArgs};
use super::params::save;
use crate::experiments::calibrate::procedures::{
    CalibrationReport, calibrate_gauges, calibrate_gyros, calibrate_wheels,
};
use crate::experiments::calibrate::{CalibrationBench, real};
use crate::experiments::result::{Json, Provenance};
use crate::experiments::run::links::Links;
use crate::experiments::run::place::ROBOT;
use clap::{Args, ValueEnum};
use core_algos::topology::Topology;
use host_sim::base::error::Error;
use host_sim::base::numbers::{number, whole};
use host_sim::scenario::Scenario;
use host_sim::scenario::effect::Use;
use host_sim::targets::Target;
use output::files;
use remote::Remote;
use remote::board_log::BoardLog;
use remote::interrupt::watch_for_interrupt;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;

/// Subject of a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CalibrateWhat {
    /// Wheel radius, wheel ratio and track of each axle: straight line, then squares in both directions
    /// (UMBmark)
    Wheels,
    /// Zeros and gains of the strain gauges: strip straight, then on formers
    Gauges,
    /// Scale and bias of the gyros: known turns and rests
    Imu,
}

/// Arguments of `calibrate`.
#[derive(Clone, Debug, Args)]
pub struct CalibrateArgs {
    /// Options that select and change the scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// Part to calibrate
    #[arg(value_enum)]
    pub what: CalibrateWhat,
    /// Options that select where the boards run; by default in this process, with their flash in files.
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Keep the flash of in-process and virtual boards in files in this folder
    #[arg(long, value_name = "DIR", default_value = "out/flash")]
    pub flash: PathBuf,
    /// Use this seed for the robot's errors and all random draws
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Drive this number of squares in each direction at each speed
    #[arg(long, default_value_t = 6, value_parser = whole::<u32>(1..=100))]
    pub laps: u32,
    /// Determine the gains of a real robot, with the strip on a former of this curvature; without --former, determine
    /// the zeros with the strip straight
    #[arg(long, value_name = "1/M", value_parser = number, allow_hyphen_values = true)]
    pub former: Option<f64>,
    /// Save without asking for confirmation
    #[arg(long)]
    pub yes: bool,
    /// Write the calibrated parameters to this file, for `params import` or `--scenario`
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
}

/// Runs `cfmmr calibrate`.
pub fn run(args: &CalibrateArgs) -> Result<(), Error> {
    args.boards.check()?;
    if args.boards.on.has_ports() {
        return calibrate_real(args);
    }
    if args.former.is_some() {
        return Err(Error::input(
            "--former: only with --on serial: the simulated robot has formers of ±1 and ±2 per metre",
        ));
    }
    let scenario = args.scenario.load()?;
    let axles = scenario.robot.geometry.axles;
    if axles > 2 {
        return Err(Error::input(format!(
            "robot.geometry.axles = {axles}: must be 2 with calibrate, whose procedures move one pair of axles"
        )));
    }
    args.scenario
        .given()?
        .check(&[], &[(&scenario, Use::Calibrate)])?;
    let json = args.json.open()?;
    let mut report = calibrate(args, &scenario, args.seed)?;
    json.print(&report.text())?;
    if let Some(path) = &args.out {
        files::write_file(path, report.found.to_toml()?)?;
        json.print(&format!("wrote {}\n", path.display()))?;
    }
    report.saved = confirm_saving(args, &json)?;
    if report.saved {
        let written = save(&args.boards, &args.flash, &report.found)?;
        json.print(&format!("{written} values written to the flash\n"))?;
    }
    json.write(&Provenance::of(&scenario, args.seed), &report)?;
    Ok(())
}

/// Calibrates the strain gauges of a real robot.
fn calibrate_real(args: &CalibrateArgs) -> Result<(), Error> {
    if args.what != CalibrateWhat::Gauges {
        return Err(Error::input(
            "--on serial: must be in-process or virtual: only `calibrate gauges` acts on a real robot",
        ));
    }
    if args.out.is_some() || args.scenario.is_given() || args.seed != 1 || args.laps != 6 {
        return Err(Error::input(
            "--out, --world, --scenario, --set, --seed, --laps: no effect with --on serial: the beam board computes and \
             saves the calibration; read the values with cfmmr params export",
        ));
    }
    let json = args.json.open()?;
    let links = Links::new(ROBOT, &args.boards.on, args.boards.baud(), None)?;
    real::run(&links, args.former, !args.yes, &json)
}

fn calibrate(
    args: &CalibrateArgs,
    scenario: &Scenario,
    seed: u64,
) -> Result<CalibrationReport, Error> {
    let mut bench = CalibrationBench::new(scenario, seed, boards(args, scenario.robot.topology())?);
    bench.interrupt = watch_for_interrupt()?;
    let mut report = match args.what {
        CalibrateWhat::Wheels => calibrate_wheels(scenario, &mut bench, args.laps)?,
        CalibrateWhat::Gauges => calibrate_gauges(scenario, &mut bench)?,
        CalibrateWhat::Imu => calibrate_gyros(scenario, &mut bench)?,
    };
    report.seed = seed;
    report.world = scenario.world.label();
    Ok(report)
}

/// True if the new values may be saved: `--yes` is given or the user confirms.
fn confirm_saving(args: &CalibrateArgs, json: &Json) -> Result<bool, Error> {
    if args.yes {
        return Ok(true);
    }
    if !io::stdin().is_terminal() || !io::stdout().is_terminal() {
        json.print("not saved: no terminal for a confirmation; use --yes\n")?;
        return Ok(false);
    }
    json.print("save to the boards? [y/N] ")?;
    io::stdout().flush()?;
    let mut answer = String::new();
    io::stdin().read_line(&mut answer)?;
    let yes = matches!(answer.trim(), "y" | "Y" | "yes");
    if !yes {
        json.print("not saved\n")?;
    }
    Ok(yes)
}

/// Virtual boards; `None` if the nodes run in this process.
fn boards(args: &CalibrateArgs, robot: Topology) -> Result<Option<Vec<Box<dyn Target>>>, Error> {
    if !args.boards.on.is_outside() {
        return Ok(None);
    }
    let links = Links::new(robot, &args.boards.on, args.boards.baud(), None)?;
    let mut boards = Vec::new();
    for role in robot.boards() {
        if let Some(link) = links.open(role, &BoardLog::new(robot.name(role)))? {
            boards.push(Box::new(Remote::new(robot, role, link)) as Box<dyn Target>);
        }
    }
    Ok((boards.len() == robot.board_count()).then_some(boards))
}
