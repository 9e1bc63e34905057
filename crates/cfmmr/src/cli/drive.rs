//! `cfmmr drive`: drives the robot by a script, by one step of the command line, or by keyboard.

use super::arguments::{Common, LogArgs, RobotArgs, SensorArgs, parse_posture};
use crate::dashboard;
use crate::experiments::Context;
use crate::experiments::run::mission::Mission;
use crate::experiments::run::place::BoardPlace;
use clap::Args;
use host_sim::base::error::Error;
use host_sim::base::input;
use host_sim::run::keyboard::Keyboard;
use host_sim::run::script;
use host_sim::run::script::{Line, ScriptStep};
use host_sim::scenario::effect::{Taken, Use};
use host_sim::scenario::own::Own;
use output::terminal;
use std::fmt::Display;
use std::path::PathBuf;

/// Arguments of `drive`.
#[derive(Clone, Debug, Args)]
pub struct DriveArgs {
    /// Step: goto X Y PHI, follow PATH, speed V KAPPA SECONDS, stop, clear, wait SECONDS, pose X Y PHI or zero
    /// (docs/driving.md); without STEP and --script, the keyboard drives
    #[arg(value_name = "STEP", num_args = 1..)]
    pub step: Vec<String>,
    /// Execute the steps in this file, one step per line; comments begin with #
    #[arg(long, value_name = "FILE", conflicts_with = "step")]
    pub script: Option<PathBuf>,
    /// Start at this posture of the midpoint O, for example -1.5,0.2,90deg [default: 0,0,0; real robot: its estimate]
    #[arg(long, value_name = "X,Y,PHI", allow_hyphen_values = true)]
    pub from: Option<String>,
    /// Options that select the sensors.
    #[command(flatten)]
    pub sensors: SensorArgs,
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Options of recording and display.
    #[command(flatten)]
    pub log: LogArgs,
    /// Options of the robot: its boards and the duration of the run.
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// Scenario keys that the steps replace.
const STEPS: Taken = &[
    ("mission.start", "with drive: use --from"),
    ("mission.goal", "with drive: use the step goto"),
];

/// Runs `cfmmr drive`.
pub fn run(args: &DriveArgs, own: &Own) -> Result<(), Error> {
    let mut context = args.common.context("drive", own)?;
    args.sensors.apply(&mut context.scenario);
    let from = args.from.as_deref().map(parse_posture).transpose()?;
    context.scenario.mission.start = from.unwrap_or_default();
    context.scenario.check()?;
    let lines = match args.script.is_none() && args.step.is_empty() {
        true => {
            let keyboard = Keyboard::of_driver(script::limits(&context.scenario));
            if !terminal::is_interactive() {
                return Err(Error::input(
                    "STEP or --script FILE: missing: the keyboard drives only if standard input and output are \
                     a terminal",
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
    let start = match place {
        BoardPlace::Serial(_) => from,
        _ => Some(context.scenario.mission.start),
    };
    script::check_starts(&lines, start, &context.scenario)?;
    let mission = Mission::Script {
        lines,
        placed: from.is_some(),
    };
    args.robot
        .check(&args.sensors, &args.common.scenario.choice)?;
    match place {
        BoardPlace::InProcess => {
            context.check_keys(STEPS, &[(&context.scenario, Use::Regulate)])?
        }
        BoardPlace::Virtual => context.check_keys(STEPS, &[(&context.scenario, Use::Virtual)])?,
        BoardPlace::Serial(_) => context.check_mission_keys()?,
    }
    let threads = args.common.run.threads;
    args.robot.run(&context, &mission, &args.log, threads)
}

/// Steps to drive, from the script or the command line.
fn lines_of(args: &DriveArgs, context: &Context) -> Result<Vec<Line>, Error> {
    let scenario = &context.scenario;
    match (&args.script, args.step.as_slice()) {
        (Some(file), _) => {
            let named =
                |error: &dyn Display| Error::input(format!("--script {}: {error}", file.display()));
            let text = input::text(file).map_err(|error| named(&error))?;
            script::parse(&text, scenario).map_err(|error| named(&error))
        }
        // The whole step is one argument, for example in quotes.
        (None, [line]) => script::parse(line, scenario),
        (None, words) => {
            // `cli::word_for_clap` has put a space before each negative angle.
            let words = words.iter().map(|word| match word.strip_prefix(" -") {
                Some(rest) => format!("-{rest}"),
                None => word.clone(),
            });
            let words: Vec<String> = words.collect();
            Ok(vec![script::parse_words(&words, 1, scenario)?])
        }
    }
}
