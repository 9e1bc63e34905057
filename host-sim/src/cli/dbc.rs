//! `cfmmr dbc`: the bus description, and the load of the bus.

use crate::base::error::Error;
use crate::base::output;
use crate::base::terminal;
use crate::bus::dbc;
use clap::Args;
use std::path::PathBuf;

/// Arguments of `dbc`.
#[derive(Clone, Debug, Args)]
pub struct DbcArgs {
    /// Write to this file instead of the terminal
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Print the worst-case load of the bus by message
    #[arg(long, conflicts_with = "out")]
    pub load: bool,
    /// Print the messages as a table
    #[arg(long, conflicts_with_all = ["out", "load"])]
    pub table: bool,
}

/// Prints the description or the load, or writes the description to a file.
pub fn run(args: &DbcArgs) -> Result<(), Error> {
    if args.load {
        return terminal::print(&dbc::load());
    }
    if args.table {
        return terminal::print_page(&dbc::page());
    }
    match &args.out {
        Some(path) => {
            output::write_file(path, dbc::description())?;
            terminal::print(&format!("wrote {}\n", path.display()))
        }
        None => terminal::print(&dbc::description()),
    }
}
