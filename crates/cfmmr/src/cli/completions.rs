//! `cfmmr completions`: prints the script by which a shell completes the command line.

use crate::cli;
use clap::Args;
use host_sim::base::error::Error;
use output::terminal;

/// Arguments of `completions`.
#[derive(Clone, Debug, Args)]
pub struct CompletionsArgs {
    /// Shell
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

/// Runs `cfmmr completions`.
pub fn run(args: &CompletionsArgs) -> Result<(), Error> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut cli::command(), "cfmmr", &mut script);
    terminal::print(&String::from_utf8_lossy(&script))
}
