//! `cfmmr drive`: the robot takes the steps of a script or one step of the command line.

use super::arguments::{Common, LogArgs, RobotArgs, SensorArgs, parse_posture};
use crate::dashboard;
use crate::experiments::Context;
use crate::experiments::run::mission::Mission;
use crate::experiments::run::place::Place;
use clap::Args;
use host_sim::base::error::Error;
use host_sim::base::input;
use host_sim::run::keyboard::Keyboard;
use host_sim::run::script;
use host_sim::run::script::{Line, ScriptStep};
use host_sim::scenario::effect::{Taken, Use};
use output::terminal;
use std::fmt::Display;
use std::path::PathBuf;

/// Arguments of `drive`.
#[derive(Clone, Debug, Args)]
pub struct DriveArgs {
    /// Step: goto X Y PHI, follow PATH, speed V KAPPA SECONDS, stop, clear, wait SECONDS, pose X Y PHI or zero
    /// (docs/driving.md); without a step and a script the keyboard drives
    #[arg(value_name = "STEP", num_args = 1..)]
    pub step: Vec<String>,
    /// Script with one step a line; comments begin with #
    #[arg(long, value_name = "FILE", conflicts_with = "step")]
    pub script: Option<PathBuf>,
    /// Start posture of the midpoint O, for example -1.5,0.2,90deg [default: 0,0,0; of a real robot: where it believes
    /// to be]
    #[arg(long, value_name = "X,Y,PHI", allow_hyphen_values = true)]
    pub from: Option<String>,
    /// Sensors.
    #[command(flatten)]
    pub sensors: SensorArgs,
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Recording of the run.
    #[command(flatten)]
    pub log: LogArgs,
    /// The robot.
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// Keys that the steps decide.
const STEPS: Taken = &[
    ("mission.start", "in a drive: use --from"),
    ("mission.goal", "in a drive: use goto"),
];

/// Runs the command.
pub fn run(args: &DriveArgs) -> Result<(), Error> {
    let mut context = args.common.context("drive")?;
    args.sensors.apply(&mut context.scenario);
    let from = args.from.as_deref().map(parse_posture).transpose()?;
    context.scenario.mission.start = from.unwrap_or_default();
    context.scenario.check()?;
    let lines = match args.script.is_none() && args.step.is_empty() {
        true => {
            let keyboard = Keyboard::of_driver(script::limits(&context.scenario));
            if !terminal::is_interactive() {
                return Err(Error::input(
                    "STEP or --script FILE: needed where there is no terminal to drive at",
                ));
            }
            dashboard::check()?;
            script::by_hand(keyboard)
        }
        false => lines_of(args, &context)?,
    };
    let place = &args.robot.boards.on;
    let no_zero = lines
        .iter()
        .find(|line| !place.is_outside() && line.step == ScriptStep::Zero);
    if let Some(line) = no_zero {
        return Err(Error::input(format!(
            "line {}: zero: must have --on virtual or --on serial: boards in this program have no calibration procedure",
            line.number
        )));
    }
    let told = match place {
        Place::Serial(_) => from,
        _ => Some(context.scenario.mission.start),
    };
    script::check_starts(&lines, told, &context.scenario)?;
    let mission = Mission::Script {
        lines,
        placed: from.is_some(),
    };
    args.robot
        .check(&args.sensors, &args.common.scenario.choice)?;
    match place {
        Place::InProcess => context.check_keys(STEPS, &[(&context.scenario, Use::Regulate)])?,
        Place::Virtual => context.check_keys(STEPS, &[(&context.scenario, Use::Virtual)])?,
        Place::Serial(_) => context.check_mission_keys()?,
    }
    let threads = args.common.run.threads;
    args.robot.run(&context, &mission, &args.log, threads)
}

/// Steps of the script or the command line.
fn lines_of(args: &DriveArgs, context: &Context) -> Result<Vec<Line>, Error> {
    let scenario = &context.scenario;
    match (&args.script, args.step.as_slice()) {
        (Some(file), _) => {
            let named =
                |error: &dyn Display| Error::input(format!("--script {}: {error}", file.display()));
            let text = input::text(file).map_err(|error| named(&error))?;
            script::parse(&text, scenario).map_err(|error| named(&error))
        }
        // A step in quotes.
        (None, [line]) => script::parse(line, scenario),
        (None, words) => {
            // A space keeps a negative angle from being an option.
            let words = words.iter().map(|word| match word.strip_prefix(" -") {
                Some(rest) => format!("-{rest}"),
                None => word.clone(),
            });
            let words: Vec<String> = words.collect();
            Ok(vec![script::parse_words(&words, 1, scenario)?])
        }
    }
}
