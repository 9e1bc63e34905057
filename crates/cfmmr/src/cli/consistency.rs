//! `cfmmr consistency`: compares errors of the fused estimates with their covariance (NEES).

use super::arguments::Common;
use crate::experiments::consistency;
use crate::experiments::posture::{ROWS, Variant};
use clap::{Args, ValueEnum};
use host_sim::base::error::Error;
use host_sim::base::numbers::whole;
use host_sim::scenario::Scenario;
use host_sim::scenario::effect;
use host_sim::scenario::effect::Use;
use host_sim::scenario::own::Own;

/// Fusions that `consistency` compares, by [`Variant::fusion`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Fusion {
    /// Odometry alone, without the relative position sensor
    Odometry,
    /// Covariance intersection
    Intersection,
    /// Covariance intersection and internal posture error correction
    IntersectionIpec,
    /// Joint filter of both axles
    Joint,
}

/// Arguments of `consistency`.
#[derive(Clone, Debug, Args)]
pub struct ConsistencyArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Run this number of trials per row
    #[arg(long, default_value_t = 200, value_parser = whole::<u32>(2..=1_000_000))]
    pub trials: u32,
    /// Compare these fusions, separated by commas [default: all]
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
    pub fusion: Vec<Fusion>,
}

/// Runs `cfmmr consistency`.
pub fn run(args: &ConsistencyArgs, own: &Own) -> Result<(), Error> {
    let context = args.common.context("consistency", own)?;
    let robot = context.scenario.robot.topology();
    let mut variants = Variant::ALL.to_vec();
    // A fusion that the user names is refused if it does not fit; of all fusions, those that fit remain.
    variants.retain(|row| row.fits(robot) || !args.fusion.is_empty());
    if !args.fusion.is_empty() {
        let names = args.fusion.iter().filter_map(ValueEnum::to_possible_value);
        let names: Vec<_> = names.collect();
        variants.retain(|v| names.iter().any(|name| name.get_name() == v.fusion()));
    }
    let rows = variants.iter().map(|v| v.apply(&context.scenario));
    let rows: Vec<Scenario> = rows.collect();
    rows.iter().try_for_each(Scenario::check)?;
    let runs: Vec<effect::Run> = rows.iter().map(|row| (row, Use::Regulate)).collect();
    context.check_keys(ROWS, &runs)?;
    let seeds = context.seeds(args.trials as usize);
    let report = consistency::measure(&context.workers, &context.scenario, seeds, &variants)?;
    consistency::publish(&context, &report, &variants)
}
