//! `cfmmr completions`: what a shell needs to complete the command line.

use crate::cli::{self, CompletionsArgs};
use crate::error::Error;

/// Runs the command.
pub fn run(args: &CompletionsArgs) -> Result<(), Error> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut cli::command(), "cfmmr", &mut script);
    super::print(&String::from_utf8_lossy(&script))
}
