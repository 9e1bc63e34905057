//! `cfmmr paper`: the paper's experiment beside the figures that the paper prints.

use super::arguments::RunArgs;
use crate::experiments::paper;
use clap::Args;
use host_sim::base::error::Error;
use host_sim::base::numbers::whole;
use host_sim::scenario::effect::GivenKeys;

/// Arguments of `paper`.
#[derive(Clone, Debug, Args)]
pub struct PaperArgs {
    /// Number of trials a row
    #[arg(long, default_value_t = 50, value_parser = whole::<u32>(1..=1_000_000))]
    pub trials: u32,
    /// Options of seed, threads and output.
    #[command(flatten)]
    pub run: RunArgs,
}

/// Runs `cfmmr paper`.
pub fn run(args: &PaperArgs) -> Result<(), Error> {
    let [_, with_gauges] = paper::scenarios()?;
    let context = args
        .run
        .context("paper", with_gauges, GivenKeys::default())?;
    paper::run(&context, context.seeds(args.trials as usize))
}
