//! `cfmmr world`: the true robot and its surroundings, each figure with its reason.

use crate::cli::WorldArgs;
use crate::error::Error;
use crate::world::{self, NAMES, World};

/// Prints a world, or the names of those that are built in.
pub fn run(args: &WorldArgs) -> Result<(), Error> {
    let Some(name) = &args.name else {
        return super::print(&(NAMES.join("\n") + "\n"));
    };
    let checked = World::load(name)?;
    if args.json {
        let json = serde_json::to_string_pretty(&checked);
        return super::print(&(json.map_err(|error| Error::Failure(error.to_string()))? + "\n"));
    }
    super::print(&world::text(name)?)
}
