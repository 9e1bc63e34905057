//! Command line of `cfmmr`.

use cfmmr::cli;
use cfmmr::cli::{Cli, Command};
use host_sim::base::error::Error;
use host_sim::run::path_run::PathMode;
use output::terminal::note;
use std::process::ExitCode;

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
        None => cli::posture::run(&cli.posture),
        Some(Command::Posture(args)) => cli::posture::run(args),
        Some(Command::Paper(args)) => cli::paper::run(args),
        Some(Command::Follow(args)) => cli::follow::run(args, PathMode::Follow),
        Some(Command::Track(args)) => cli::follow::run(args, PathMode::Track),
        Some(Command::Drive(args)) => cli::drive::run(args),
        Some(Command::Hil(args)) => cli::hil::run(args),
        Some(Command::Replay(args)) => cli::replay::run(args),
        Some(Command::Consistency(args)) => cli::consistency::run(args),
        Some(Command::Eval(args)) => cli::eval::run(args),
        Some(Command::Calibrate(args)) => cli::calibrate::run(args),
        Some(Command::Params(args)) => cli::params::run(args),
        Some(Command::Parameters) => cli::parameters::run(),
        Some(Command::Codes) => cli::codes::run(),
        Some(Command::Dbc(args)) => cli::dbc::run(args),
        Some(Command::Topics) => cli::topics::run(),
        Some(Command::Serial) => cli::serial::run(),
        Some(Command::Config(args)) => cli::config::run(args),
        Some(Command::Keys(args)) => cli::keys::run(args),
        Some(Command::World(args)) => cli::world::run(args),
        Some(Command::Faults(args)) => cli::faults::run(args),
        Some(Command::Soak(args)) => cli::soak::run(args),
        Some(Command::Campaign(args)) => cli::campaign::run(args),
        Some(Command::Glossary(args)) => cli::glossary::run(args),
        Some(Command::Doctor(args)) => cli::doctor::run(args),
        Some(Command::Completions(args)) => cli::completions::run(args),
    }
}
