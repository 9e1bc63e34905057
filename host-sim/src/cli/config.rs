//! `cfmmr config`: the scenario with all defaults.

use crate::base::error::Error;
use crate::base::terminal;
use crate::experiments::arguments::WorldChoice;
use clap::Args;
use std::path::PathBuf;

/// Arguments of `config`.
#[derive(Clone, Debug, Args)]
pub struct ConfigArgs {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Scenario file (TOML); missing keys are completed with defaults
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Change one key of the scenario; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

/// Prints the scenario as TOML.
pub fn run(args: &ConfigArgs) -> Result<(), Error> {
    let scenario = crate::experiments::scenario(
        args.choice.world.as_deref(),
        args.scenario.as_deref(),
        &args.set,
    )?;
    terminal::print(&scenario.to_toml()?)
}
