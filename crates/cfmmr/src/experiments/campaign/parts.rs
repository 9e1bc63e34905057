//! Shards of a campaign. [`compute`] computes the missing blocks of one shard; [`merge`] merges all blocks.

use super::directory::{Block, Directory};
use super::report::CampaignReport;
use super::rows::CampaignRow;
use super::shard::Shard;
use super::study::Study;
use super::{pictures, rows};
use crate::experiments::Workers;
use core_algos::link::framing::crc32c;
use host_sim::base::error::Error;
use host_sim::run::regulate::regulate;
use host_sim::scenario::own::Own;
use output::files::OutputDir;
use output::progress::Progress;
use output::terminal::note;
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;

/// Numbers of computed and of already complete runs of a finished shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Computed {
    /// Number of computed runs.
    pub runs: u64,
    /// Number of runs already complete at the start.
    pub before: u64,
}

/// Computes the missing blocks of one shard, with parts of the user.
pub fn compute(
    directory: &Directory,
    shard: &Shard,
    workers: &Workers,
    own: &Own,
) -> Result<Computed, Error> {
    let study = directory.study();
    let mine = (0..study.blocks()).filter(|&block| shard.has(block));
    let mine: Vec<u64> = mine.collect();
    let to_do = missing(directory, &mine)?;
    let runs_of = |&block: &u64| study.block_runs(block).count() as u64;
    let count = |blocks: &[u64]| -> u64 { blocks.iter().map(runs_of).sum() };
    let progress = Progress::new(count(&to_do) as usize, "runs");
    for (n, &block) in to_do.iter().enumerate() {
        if workers.is_interrupted() {
            return Err(interrupted(count(&to_do[..n]), count(&to_do)));
        }
        let run = |index| {
            let finished = run_trial(study, index, own);
            progress.advance();
            finished
        };
        let range = study.block_runs(block).into_par_iter();
        let rows: Result<Vec<CampaignRow>, Error> =
            workers.pool.install(|| range.map(run).collect());
        directory.write(block, rows?)?;
    }
    let runs = count(&to_do);
    Ok(Computed {
        runs,
        before: count(&mine) - runs,
    })
}

/// Next step for the user: merge if every block has a file, else the missing blocks.
pub fn next_step(directory: &Directory, out: &Path) -> String {
    let (absent, out) = (directory.absent(), out.display());
    match absent.is_empty() {
        true => format!("all blocks are complete; next: cfmmr campaign merge {out}\n"),
        false => format!(
            "missing: {} of {} blocks ({}), of other parts\n\
             after these parts: cfmmr campaign merge {out}\n",
            absent.len(),
            directory.study().blocks(),
            ranges(&absent)
        ),
    }
}

/// Ascending numbers as ranges, for example `0-2, 5`; an ellipsis after the first eight.
pub fn ranges(numbers: &[u64]) -> String {
    const SHOWN: usize = 8;
    let ranges = numbers.chunk_by(|a, b| a + 1 == *b);
    let text = |range: &[u64]| match range {
        [first, .., last] => format!("{first}-{last}"),
        _ => range[0].to_string(),
    };
    let mut texts: Vec<String> = ranges.map(text).collect();
    if texts.len() > SHOWN {
        texts.truncate(SHOWN);
        texts.push("…".to_owned());
    }
    texts.join(", ")
}

fn interrupted(done: u64, all: u64) -> Error {
    Error::Interrupted(format!(
        "interrupted after {done} of {all} runs; repeat the command to compute the other runs"
    ))
}

/// Missing and damaged blocks; a note is printed for each damaged one.
fn missing(directory: &Directory, blocks: &[u64]) -> Result<Vec<u64>, Error> {
    let mut missing = Vec::new();
    for &block in blocks {
        match directory.block(block)? {
            Block::Complete(_) => {}
            Block::Missing => missing.push(block),
            Block::Damaged(why) => {
                note(format!("{why}: the block is recomputed"));
                missing.push(block);
            }
        }
    }
    Ok(missing)
}

fn run_trial(study: &Study, index: u64, own: &Own) -> Result<CampaignRow, Error> {
    let mut run = study.run(index)?;
    run.scenario.own = own.clone();
    let outcome = regulate(&run.scenario, study.seed, run.trial.into(), |_| {})?;
    Ok(CampaignRow::of(index, run, &outcome))
}

/// Finished and missing runs of a campaign.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CampaignProgress {
    /// Name of the study.
    pub name: String,
    /// Number of all runs.
    pub runs: u64,
    /// Number of runs in complete blocks.
    pub runs_done: u64,
    /// Number of all blocks.
    pub blocks: u64,
    /// Numbers of the blocks without a file.
    pub missing: Vec<u64>,
    /// Blocks that cannot be used, each as path and what is wrong with the file.
    #[serde(rename = "spoiled")]
    pub damaged: Vec<String>,
}

/// Reads every block: status, and the runs of complete blocks.
pub fn read_blocks(directory: &Directory) -> Result<(CampaignProgress, Vec<CampaignRow>), Error> {
    let study = directory.study();
    let mut status = CampaignProgress {
        name: study.name.clone(),
        runs: study.runs(),
        blocks: study.blocks(),
        ..CampaignProgress::default()
    };
    let mut all = Vec::new();
    for block in 0..study.blocks() {
        match directory.block(block)? {
            Block::Complete(rows) => all.extend(rows),
            Block::Missing => status.missing.push(block),
            Block::Damaged(why) => status.damaged.push(why),
        }
    }
    status.runs_done = all.len() as u64;
    Ok((status, all))
}

/// Merged runs of a campaign.
pub struct Merged {
    /// Report on the merged runs.
    pub report: CampaignReport,
    /// Table and pictures, not yet written.
    pub files: OutputDir,
    /// CRC-32C of the table of all runs.
    pub hash: u32,
}

/// Merges the runs of all shards; `partial` leaves out missing and damaged blocks.
pub fn merge(
    directory: &Directory,
    from: &Path,
    out: &Path,
    partial: bool,
) -> Result<Merged, Error> {
    let (status, runs) = read_blocks(directory)?;
    if status.runs_done != status.runs || !status.damaged.is_empty() {
        let damaged: String = status
            .damaged
            .iter()
            .map(|why| format!("{why}\n"))
            .collect();
        let missing = match status.missing.is_empty() {
            true => String::new(),
            false => format!("; missing blocks: {}", ranges(&status.missing)),
        };
        let left_out = format!(
            "{damaged}{}: {} of {} runs are complete{missing}",
            status.name, status.runs_done, status.runs
        );
        if !partial || status.runs_done == 0 {
            return Err(Error::Failure(format!(
                "{left_out}: run the missing parts, listed by cfmmr campaign status {} --missing",
                from.display()
            )));
        }
        note(format!(
            "cfmmr: {left_out}: missing and damaged blocks are left out"
        ));
    }
    let study = directory.study();
    let content = rows::csv(study, &runs).into_bytes();
    let hash = crc32c(&content);
    let report = CampaignReport::of(study, &runs);
    let mut files = OutputDir::create(out)?;
    files.bytes("runs.csv", content);
    let mut pictures = vec![
        ("distributions", pictures::distributions(study, &runs)),
        ("map", pictures::map(study, &runs)),
    ];
    let sensitivity = pictures::sensitivity(study, &runs);
    pictures.extend(sensitivity.map(|figure| ("sensitivity", figure)));
    let correlations = pictures::correlations(study, &runs, &report.influences);
    pictures.extend(correlations.map(|figure| ("correlations", figure)));
    for (name, figure) in pictures {
        figure.add(&mut files, name);
    }
    Ok(Merged {
        report,
        files,
        hash,
    })
}
