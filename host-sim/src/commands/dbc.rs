//! `cfmmr dbc`: the bus description, and the load of the bus.

use crate::cli::DbcArgs;
use crate::error::Error;
use crate::{dbc, output};

/// Prints the description or the load, or writes the description to a file.
pub fn run(args: &DbcArgs) -> Result<(), Error> {
    if args.load {
        return super::print(&dbc::load());
    }
    match &args.out {
        Some(path) => {
            output::write_file(path, dbc::description())?;
            super::print(&format!("wrote {}\n", path.display()))
        }
        None => super::print(&dbc::description()),
    }
}
