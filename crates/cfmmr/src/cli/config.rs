//! `cfmmr config`: the scenario with all defaults.

use super::arguments::ScenarioArgs;
use clap::Args;
use host_sim::base::error::Error;
use output::terminal;

/// Arguments of `config`.
#[derive(Clone, Debug, Args)]
pub struct ConfigArgs {
    /// Options that select and change the scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
}

/// Prints the scenario as TOML.
pub fn run(args: &ConfigArgs) -> Result<(), Error> {
    terminal::print(&args.scenario.load()?.to_toml()?)
}
