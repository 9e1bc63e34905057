//! Tables, pictures and files of trials.

use super::pictures::Picture;
use super::trials::pictured;
use super::{PostureReport, PostureRow, Trial, Variant, report, summarize};
use crate::experiments::Context;
use host_sim::base::error::Error;
use host_sim::scenario::Scenario;
use output::files::OutputDir;
use recording::csv;
use std::path::PathBuf;
use view::{animation, figures, page};

/// Writes and prints the result of trials; `blocks` has the trials of each variant.
pub fn trials(
    context: &Context,
    variants: &[Variant],
    blocks: &[Vec<Trial>],
    recorded: &[PathBuf],
) -> Result<(), Error> {
    let (report, files) = publish(context, variants, &pictured(variants), blocks)?;
    let text = screen(context, &report, variants);
    let failed = failure(&report, variants);
    context.finish(&text, &report, files, recorded, failed)
}

/// Result and files of trials; `blocks` has the trials of each variant. Variants in `shown` have pictures and logs.
pub fn publish(
    context: &Context,
    variants: &[Variant],
    shown: &[Variant],
    blocks: &[Vec<Trial>],
) -> Result<(PostureReport, OutputDir), Error> {
    let goal = context.scenario.mission.goal;
    let pairs = || variants.iter().zip(blocks);
    let rows = summaries(pairs(), goal)?;
    let mut files = context.output()?;
    let body = context.body();
    let mut panels = Vec::new();
    let mut columns = Vec::new();
    let applied: Vec<Scenario> = shown.iter().map(|v| v.apply(&context.scenario)).collect();
    let (mut runs, mut animated) = (Vec::new(), Vec::new());
    for (variant, scenario) in shown.iter().zip(&applied) {
        let Some(row) = variants.iter().position(|v| v == variant) else {
            continue;
        };
        let picture = Picture::of(variant, scenario, &blocks[row]);
        panels.push(picture.paths(body.half_track_m));
        columns.push(picture.errors());
        let log = format!("log-{}.csv", variant.fusion());
        files.csv(&log, csv::of_records(&blocks[row][0].records));
        runs.push(picture.page(&rows[row]));
        animated.push(picture.animation());
    }
    files.text("drive.svg", animation::svg(&body, &animated));
    page::add(&mut files, &context.subtitle(), &body, &runs);
    figures::paths("Robot paths during posture regulation", &body, &panels)
        .add(&mut files, "paths");
    figures::errors("Posture errors", &columns).add(&mut files, "errors");
    files.csv("trials.csv", report::trials_csv(pairs(), goal));
    let trials = blocks.iter().map(Vec::len).max().unwrap_or(0) as u32;
    Ok((PostureReport { trials, rows }, files))
}

/// Row of each variant; fails if an interrupt left a variant without a trial.
pub fn summaries<'a>(
    blocks: impl Iterator<Item = (&'a Variant, &'a Vec<Trial>)>,
    goal: [f64; 3],
) -> Result<Vec<PostureRow>, Error> {
    let rows = blocks.map(|(variant, block)| match block.is_empty() {
        true => Err(Error::Interrupted(
            "interrupted before each row had a trial: nothing is written".to_owned(),
        )),
        false => Ok(summarize(variant, block, goal)),
    });
    rows.collect()
}

/// Verdict, table, meaning of its words, and commands to type next.
fn screen(context: &Context, report: &PostureReport, variants: &[Variant]) -> String {
    let world = context.scenario.world.label();
    let folder = context.folder().display();
    let tolerance = [
        context.scenario.mission.tolerance_m,
        context.scenario.mission.tolerance_rad,
    ];
    format!(
        "{}Posture regulation, {} trials a row, seed {}, world {world}\n\n{}{}\n\
         open {folder}/report.html, {folder}/paths.png\n\
         next: cargo cfmmr follow, cargo cfmmr paper, cargo cfmmr glossary\n",
        report::verdict(&report.rows, variants),
        report.trials,
        context.seed,
        report::table(&report.rows, variants),
        report::meanings(&report.rows, tolerance),
    )
}

/// Reason if no trial of a row ended as commanded.
fn failure(report: &PostureReport, variants: &[Variant]) -> Option<String> {
    let row = report.rows.iter().position(|row| row.done == 0.0)?;
    let (row, variant) = (&report.rows[row], &variants[row]);
    Some(format!(
        "no trial of row {} was carried out: {}",
        variant.label(),
        row.ends.text()
    ))
}
