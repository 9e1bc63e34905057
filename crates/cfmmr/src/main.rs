//! Command line of `cfmmr`.

use cfmmr::cli;
use cfmmr::cli::{Cli, Command};
use cfmmr::experiments;
use cfmmr::experiments::posture::PostureArgs;
use cfmmr::experiments::whole_robot;
use host_sim::base::error::Error;
use host_sim::run::path_run::PathMode;
use output::terminal::note;
use std::process::ExitCode;

fn posture(args: &PostureArgs) -> Result<(), Error> {
    match args.robot.has_boards() {
        true => whole_robot::posture(args),
        false => experiments::posture::run(args),
    }
}

fn main() -> ExitCode {
    match Cli::read().and_then(run) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            note(format!("cfmmr: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn run(cli: Cli) -> Result<(), Error> {
    match &cli.command {
        None => posture(&cli.posture),
        Some(Command::Posture(args)) => posture(args),
        Some(Command::Follow(args)) => whole_robot::follow(args, PathMode::Follow),
        Some(Command::Track(args)) => whole_robot::follow(args, PathMode::Track),
        Some(Command::Drive(args)) => experiments::drive::run(args),
        Some(Command::Hil(args)) => experiments::hil::run(args),
        Some(Command::Replay(args)) => experiments::replay::run(args),
        Some(Command::Consistency(args)) => experiments::consistency::run(args),
        Some(Command::Eval(args)) => cli::eval::run(args),
        Some(Command::Calibrate(args)) => experiments::calibrate::command::run(args),
        Some(Command::Params(args)) => experiments::params::run(args),
        Some(Command::Parameters) => cli::parameters::run(),
        Some(Command::Codes) => cli::codes::run(),
        Some(Command::Dbc(args)) => cli::dbc::run(args),
        Some(Command::Topics) => cli::topics::run(),
        Some(Command::Serial) => cli::serial::run(),
        Some(Command::Config(args)) => cli::config::run(args),
        Some(Command::World(args)) => cli::world::run(args),
        Some(Command::Faults(args)) => experiments::faults::run(args),
        Some(Command::Soak(args)) => experiments::soak::command::run(args),
        Some(Command::Campaign(args)) => experiments::campaign::command::run(args),
        Some(Command::Doctor(args)) => cli::doctor::run(args),
        Some(Command::Completions(args)) => cli::completions::run(args),
    }
}
