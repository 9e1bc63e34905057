//! Tables, pictures and files of trials.

use super::pictures::Picture;
use super::trials::pictured;
use super::{Report, Row, Trial, Variant, paper, report, summarize};
use crate::experiments::Context;
use host_sim::base::error::Error;
use host_sim::scenario::Scenario;
use output::files::OutputDir;
use output::terminal::wrapped;
use recording::csv;
use std::path::PathBuf;
use view::{figures, page};

/// Writes and prints the result of trials: a block of each variant, then those of the paper's robot.
pub fn trials(
    context: &Context,
    variants: &[Variant],
    mut blocks: Vec<Vec<Trial>>,
    recorded: &[PathBuf],
) -> Result<(), Error> {
    let of_paper = blocks.split_off(variants.len());
    let blocks = (blocks.as_slice(), of_paper.as_slice());
    let (report, files) = publish(context, variants, &pictured(variants), blocks)?;
    let text = screen(context, &report, variants);
    let failed = failure(&report, variants);
    context.finish(&text, &report, files, recorded, failed)
}

/// Result and files of trials: a block of each variant, and one of each row of the paper's robot. The variants in
/// `shown` get pictures and logs.
pub fn publish<'a>(
    context: &Context,
    variants: &[Variant],
    shown: &[Variant],
    (blocks, of_paper): (&'a [Vec<Trial>], &'a [Vec<Trial>]),
) -> Result<(Report, OutputDir), Error> {
    let goal = context.scenario.mission.goal;
    if blocks.iter().chain(of_paper).any(Vec::is_empty) {
        let text = "interrupted before each row had a trial: nothing is written";
        return Err(Error::Interrupted(text.to_owned()));
    }
    let pairs = variants.iter().zip(blocks);
    let rows: Vec<Row> = pairs
        .map(|(variant, block)| summarize(variant, block, goal))
        .collect();
    let mut files = context.output()?;
    let body = context.body();
    let mut panels = Vec::new();
    let mut columns = Vec::new();
    let applied: Vec<Scenario> = shown.iter().map(|v| v.apply(&context.scenario)).collect();
    let mut runs = Vec::new();
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
    }
    page::add(&mut files, &context.subtitle(), &body, &runs);
    let figure = figures::paths("Robot paths during posture regulation", &body, &panels);
    files.text("paths.svg", figure.svg());
    files.bytes("paths.png", figure.png());
    let figure = figures::errors("Posture errors", &columns);
    files.text("errors.svg", figure.svg());
    files.bytes("errors.png", figure.png());
    let named = |table: &'static str| {
        move |(variant, block): (_, &'a Vec<Trial>)| (table, variant, block.as_slice())
    };
    let all = variants.iter().zip(blocks).map(named("main"));
    let all = all.chain(paper::ROWS.iter().zip(of_paper).map(named("paper")));
    files.csv("trials.csv", report::trials_csv(all, goal));
    let report = Report {
        trials: blocks.iter().map(Vec::len).max().unwrap_or(0) as u32,
        rows,
        paper: paper::ROWS
            .iter()
            .zip(of_paper)
            .map(|(variant, block)| summarize(variant, block, goal))
            .collect(),
    };
    Ok((report, files))
}

/// The tables on the screen, and commands to type next.
fn screen(context: &Context, report: &Report, variants: &[Variant]) -> String {
    let world = context.scenario.world.label();
    let mut text = format!(
        "Posture regulation, {} trials a row, seed {}, world {world}\n\n{}",
        report.trials,
        context.seed,
        report::table(&report.rows, variants)
    );
    if !report.paper.is_empty() {
        text += &format!(
            "\nThe paper's algorithms in world paper (constants fitted, see docs/worlds.md)\n\n{}{}",
            paper::table(&report.paper),
            wrapped(paper::FIXED)
        );
    }
    let folder = context.folder().display();
    text + &format!(
        "\nopen {folder}/report.html, {folder}/paths.png\n\
         type cargo cfmmr follow, cargo cfmmr posture --rows all, cargo cfmmr --help\n"
    )
}

/// Reason if no trial of a row ended as commanded.
fn failure(report: &Report, variants: &[Variant]) -> Option<String> {
    let row = report.rows.iter().position(|row| row.done == 0.0)?;
    let (row, variant) = (&report.rows[row], &variants[row]);
    Some(format!(
        "no trial of row {} was carried out: {}",
        variant.label(),
        row.ends.text()
    ))
}
