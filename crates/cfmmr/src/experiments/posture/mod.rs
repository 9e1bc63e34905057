//! Posture regulation with and without the relative position sensor, as in the paper's experiment.

pub mod pictures;
mod publish;
mod report;
pub mod trials;

use crate::experiments::run::stage::Outputs;
use crate::experiments::{Context, Seeds};
use host_sim::base::error::Error;
use host_sim::scenario::Scenario;
pub use host_sim::scenario::variant::{ROWS, Variant};
pub use publish::{publish, summaries};
pub use report::{CHI_SQUARE_99, PostureReport, PostureRow, summarize, table, trials_csv};
pub use trials::Trial;

/// Runs trials of each variant, records the first trial if requested, and publishes the result. A live run has one
/// trial of one variant.
pub fn run(
    context: &Context,
    outputs: &Outputs,
    variants: &[Variant],
    seeds: Seeds,
) -> Result<(), Error> {
    // An impossible recording is refused before the trials.
    outputs.check()?;
    let (blocks, recorded) = match outputs.is_live() {
        true => {
            let (trial, recorded) = trials::first(context, outputs, variants)?;
            (vec![vec![trial]], recorded)
        }
        false => {
            let rows = variants.iter().map(|row| row.apply(&context.scenario));
            let rows: Vec<Scenario> = rows.collect();
            let pictured = trials::pictured(variants);
            let is_shown = |row: usize| pictured.contains(&variants[row]);
            let blocks = trials::run(&context.workers, &rows, seeds, is_shown)?;
            let records = outputs.records() && !context.workers.is_interrupted();
            let recorded = match records {
                true => trials::first(context, outputs, variants)?.1,
                false => Vec::new(),
            };
            (blocks, recorded)
        }
    };
    publish::trials(context, variants, &blocks, &recorded)
}
