//! `cfmmr config`: the scenario with all defaults.

use crate::cli::ConfigArgs;
use crate::error::Error;

/// Prints the scenario as TOML.
pub fn run(args: &ConfigArgs) -> Result<(), Error> {
    let scenario = super::scenario(
        args.choice.world.as_deref(),
        args.scenario.as_deref(),
        &args.set,
    )?;
    super::print(&scenario.to_toml()?)
}
