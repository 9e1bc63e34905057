//! `cfmmr replay`: runs the nodes on the inputs in a log, with the recorded or with other parameters.

use super::arguments::JsonArgs;
use clap::Args;
use host_sim::base::error::Error;
use std::path::PathBuf;

/// Arguments of `replay`.
#[derive(Clone, Debug, Args)]
pub struct ReplayArgs {
    /// Log that `--log` wrote
    pub log: PathBuf,
    /// Write the intact records of a truncated or damaged log to a new log, and replay the new log
    #[arg(long)]
    pub recover: bool,
    /// Write the recovered log to this file [default: LOG with the ending .recovered.mcap]
    #[arg(long, value_name = "FILE", requires = "recover")]
    pub out: Option<PathBuf>,
    /// Estimate again with the parameters in this file (table `[robot]` of a scenario)
    #[arg(long, value_name = "FILE")]
    pub with: Option<PathBuf>,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
}

/// Runs `cfmmr replay`.
#[cfg(feature = "full")]
pub fn run(args: &ReplayArgs) -> Result<(), Error> {
    use crate::experiments::replay::{ReplayOptions, run};
    use crate::experiments::result::Provenance;
    let json = args.json.open()?;
    let (report, text) = run(&ReplayOptions {
        log: args.log.clone(),
        recover: args.recover,
        out: args.out.clone(),
        with: args.with.clone(),
    })?;
    json.write(&Provenance::default(), &report)?;
    json.print(&text)?;
    match report.difference {
        Some(_) => Err(Error::Failure("not identical".to_owned())),
        None => Ok(()),
    }
}

/// Fails: this build has no logs.
#[cfg(not(feature = "full"))]
pub fn run(args: &ReplayArgs) -> Result<(), Error> {
    let log = args.log.display();
    Err(output::terminal::left_out(&format!("replay {log}")))
}
