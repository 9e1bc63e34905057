//! The program `cfmmr`.
//!
//! | module | holds |
//! |---|---|
//! | [`cli`] | the command line, and commands that print |
//! | [`experiments`] | commands that run or configure a robot |
//! | [`dashboard`] | a run on the terminal |
//!
//! The feature `full` adds logs with replay and live server, the dashboard, page layout on the terminal, and the text
//! of the boards' logs. Without this feature, `--log`, `--live`, `--dashboard` and `replay` name the command to type,
//! and pages are printed as Markdown.

#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "a test compares with another implementation"
    )
)]

#[cfg(test)]
#[macro_use]
#[path = "../../../core-algos/src/properties.rs"]
mod properties;

pub mod cli;
#[cfg(feature = "full")]
pub mod dashboard;
#[cfg(not(feature = "full"))]
#[path = "no_dashboard.rs"]
pub mod dashboard;
pub mod experiments;
mod thinned;

use cli::{Cli, Command};
use host_sim::base::error::Error;
use host_sim::run::path_run::PathMode;
use host_sim::scenario::own::Own;
use output::terminal::note;
use std::process::ExitCode;

/// Name and version of the program, and a hash of its sources.
pub const BUILD: &str = env!("BUILD");

/// Runs the command line of this process with parts of the user, on boards in this process. Returns the exit code of
/// the process.
///
/// `posture`, `follow`, `track`, `drive`, `campaign`, `consistency` and `soak` use the parts. Other commands that simulate
/// the robot print on standard error that they run without the parts.
pub fn main_with(own: Own) -> ExitCode {
    match Cli::read().and_then(|cli| run(&cli, &own)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            note(format!("cfmmr: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn run(cli: &Cli, own: &Own) -> Result<(), Error> {
    let built_in = matches!(
        cli.command,
        Some(Command::Paper(_) | Command::Replay(_) | Command::Calibrate(_) | Command::Faults(_))
    );
    let names = own.names();
    if built_in && !names.is_empty() {
        let names = names.join(" and ");
        note(format!(
            "cfmmr: this command runs without the user's {names}"
        ));
    }
    match &cli.command {
        None => cli::posture::run(&cli.posture, own),
        Some(Command::Posture(args)) => cli::posture::run(args, own),
        Some(Command::Paper(args)) => cli::paper::run(args),
        Some(Command::Follow(args)) => cli::follow::run(args, PathMode::Follow, own),
        Some(Command::Track(args)) => cli::follow::run(args, PathMode::Track, own),
        Some(Command::Drive(args)) => cli::drive::run(args, own),
        Some(Command::Hil(args)) => cli::hil::run(args, own),
        Some(Command::Replay(args)) => cli::replay::run(args),
        Some(Command::Consistency(args)) => cli::consistency::run(args, own),
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
        Some(Command::Soak(args)) => cli::soak::run(args, own),
        Some(Command::Campaign(args)) => cli::campaign::run(args, own),
        Some(Command::Glossary(args)) => cli::glossary::run(args),
        Some(Command::Doctor(args)) => cli::doctor::run(args),
        Some(Command::Completions(args)) => cli::completions::run(args),
    }
}
