//! `cfmmr campaign`: a Monte Carlo study over variations of a scenario, in any number of parts.

use crate::experiments::arguments::WorldChoice;
use crate::experiments::campaign::directory::{Block, Directory};
use crate::experiments::campaign::pictures;
use crate::experiments::campaign::report::Report;
use crate::experiments::campaign::rows;
use crate::experiments::campaign::rows::Row;
use crate::experiments::campaign::shard::Shard;
use crate::experiments::campaign::study::Study;
use crate::experiments::pool;
use crate::experiments::result::{JsonArgs, Provenance};
use clap::{Args, Subcommand};
use core_algos::link::framing::crc32c;
use host_sim::base::error::Error;
use host_sim::base::numbers::whole;
use host_sim::run::regulate::regulate;
use output::files::OutputDir;
use output::progress::Progress;
use output::terminal::{note, print};
use rayon::prelude::*;
use remote::interrupt::watch_for_interrupt;
use serde::Serialize;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;

/// Arguments of `campaign`.
#[derive(Clone, Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct CampaignArgs {
    /// Action on the files of the parts
    #[command(subcommand)]
    pub action: Option<CampaignAction>,
    /// Study, a TOML file (docs/campaigns.md)
    #[arg(value_name = "FILE", required = true)]
    pub file: Option<PathBuf>,
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Part I of N, from 0 [default: that of the Slurm or Kubernetes job, else all]
    #[arg(long, value_name = "I/N")]
    pub shard: Option<String>,
    /// Folder of the study's files [default: out/FILE]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Number of threads; does not change the result [default: one a core]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=1024))]
    pub threads: Option<u16>,
}

/// Action on the files of a campaign.
#[derive(Clone, Debug, Subcommand)]
pub enum CampaignAction {
    /// Merge all runs into one CSV file, with a table and pictures
    Merge(CampaignMerge),
    /// Count finished and missing runs
    Status(CampaignStatus),
}

/// Arguments of `campaign merge`.
#[derive(Clone, Debug, Args)]
pub struct CampaignMerge {
    /// Folder of the study's files
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Folder of the result [default: DIR/merged]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Leave out missing and damaged blocks
    #[arg(long)]
    pub partial: bool,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
}

/// Arguments of `campaign status`.
#[derive(Clone, Debug, Args)]
pub struct CampaignStatus {
    /// Folder of the study's files
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// List the missing blocks and their runs
    #[arg(long)]
    pub missing: bool,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
}

/// Runs the command.
pub fn run(args: &CampaignArgs) -> Result<(), Error> {
    match &args.action {
        Some(CampaignAction::Merge(args)) => merge(args),
        Some(CampaignAction::Status(args)) => status(args),
        None => shard(args, |name| std::env::var_os(name)),
    }
}

/// Computes the missing blocks of one part; `variable` reads the environment.
pub(super) fn shard(
    args: &CampaignArgs,
    variable: impl Fn(&str) -> Option<OsString>,
) -> Result<(), Error> {
    let Some(file) = &args.file else {
        return Err(Error::input(
            "missing argument: give the FILE of a study, merge or status",
        ));
    };
    let mut study = Study::load(file)?;
    if let Some(world) = &args.choice.world {
        let world = world.clone().into();
        study.scenario.insert("world".to_owned(), world);
        study.check()?;
    }
    let shard = match &args.shard {
        Some(text) => Shard::parse(text)?,
        None => Shard::from_environment(variable)?,
    };
    let out = args.out.clone().unwrap_or_else(|| {
        let stem = file.file_stem().unwrap_or_default();
        PathBuf::from("out").join(stem)
    });
    let directory = Directory::open_for(study, &out)?;
    let study = directory.study();
    let mine = (0..study.blocks()).filter(|&block| shard.has(block));
    let mine: Vec<u64> = mine.collect();
    let to_do = missing(&directory, &mine)?;
    let pool = pool(args.threads)?;
    let runs_of = |&block: &u64| study.block_runs(block).count() as u64;
    let count = |blocks: &[u64]| -> u64 { blocks.iter().map(runs_of).sum() };
    let progress = Progress::new(count(&to_do) as usize, "runs");
    let interrupt = watch_for_interrupt()?;
    for (n, &block) in to_do.iter().enumerate() {
        if interrupt.load(Relaxed) {
            return Err(interrupted(count(&to_do[..n]), count(&to_do)));
        }
        let run = |index| {
            let finished = one(study, index);
            progress.advance();
            finished
        };
        let range = study.block_runs(block).into_par_iter();
        let rows: Result<Vec<Row>, Error> = pool.install(|| range.map(run).collect());
        directory.write(block, rows?)?;
    }
    print(&format!(
        "{}: part {} of {}: {} runs computed, {} already complete; in {}\n{}",
        study.name,
        shard.index,
        shard.count,
        count(&to_do),
        count(&mine) - count(&to_do),
        out.display(),
        next_step(&directory, &out)
    ))
}

/// The merge if every block has a file; else the missing blocks.
pub(super) fn next_step(directory: &Directory, out: &Path) -> String {
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
pub(super) fn ranges(numbers: &[u64]) -> String {
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
        "interrupted after {done} of {all} runs; the same command computes the others"
    ))
}

/// Blocks that are not there, or damaged.
fn missing(directory: &Directory, blocks: &[u64]) -> Result<Vec<u64>, Error> {
    let mut missing = Vec::new();
    for &block in blocks {
        match directory.block(block)? {
            Block::Complete(_) => {}
            Block::Missing => missing.push(block),
            Block::Spoiled(why) => {
                note(format!("{why}: recomputed"));
                missing.push(block);
            }
        }
    }
    Ok(missing)
}

fn one(study: &Study, index: u64) -> Result<Row, Error> {
    let run = study.run(index)?;
    let outcome = regulate(&run.scenario, study.seed, run.trial.into(), |_| {})?;
    Ok(Row::of(index, run, &outcome))
}

/// Finished and missing runs of a campaign.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct Status {
    name: String,
    runs: u64,
    runs_done: u64,
    blocks: u64,
    missing: Vec<u64>,
    spoiled: Vec<String>,
}

/// Looks at every block; gives what is there.
fn look(directory: &Directory) -> Result<(Status, Vec<Row>), Error> {
    let study = directory.study();
    let mut status = Status {
        name: study.name.clone(),
        runs: study.runs(),
        blocks: study.blocks(),
        ..Status::default()
    };
    let mut all = Vec::new();
    for block in 0..study.blocks() {
        match directory.block(block)? {
            Block::Complete(rows) => all.extend(rows),
            Block::Missing => status.missing.push(block),
            Block::Spoiled(why) => status.spoiled.push(why),
        }
    }
    status.runs_done = all.len() as u64;
    Ok((status, all))
}

fn status(args: &CampaignStatus) -> Result<(), Error> {
    let directory = Directory::open(&args.directory)?;
    let (status, _) = look(&directory)?;
    let blocks = status.blocks as usize - status.missing.len() - status.spoiled.len();
    let mut text = format!(
        "{}: {} of {} runs in {blocks} of {} blocks\n",
        status.name, status.runs_done, status.runs, status.blocks
    );
    for why in &status.spoiled {
        text += &format!("{why}\n");
    }
    if args.missing {
        for &block in &status.missing {
            let runs = directory.study().block_runs(block);
            let (first, last) = (runs.start, runs.end - 1);
            text += &format!("missing: block {block}, runs {first} to {last}\n");
        }
    }
    args.json.write(&Provenance::default(), &status)?;
    args.json.print(&text)
}

pub(super) fn merge(args: &CampaignMerge) -> Result<(), Error> {
    let directory = Directory::open(&args.directory)?;
    let (status, runs) = look(&directory)?;
    if status.runs_done != status.runs || !status.spoiled.is_empty() {
        let spoiled: String = status
            .spoiled
            .iter()
            .map(|why| format!("{why}\n"))
            .collect();
        let missing = match status.missing.is_empty() {
            true => String::new(),
            false => format!("; missing blocks: {}", ranges(&status.missing)),
        };
        let left_out = format!(
            "{spoiled}{}: {} of {} runs are complete{missing}",
            status.name, status.runs_done, status.runs
        );
        if !args.partial || status.runs_done == 0 {
            return Err(Error::Failure(format!(
                "{left_out}: run the missing parts, listed by cfmmr campaign status {} --missing",
                args.directory.display()
            )));
        }
        note(format!("cfmmr: {left_out}: the others are left out"));
    }
    let study = directory.study();
    let content = rows::csv(study, &runs).into_bytes();
    let hash = crc32c(&content);
    let report = Report::of(study, &runs);
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| args.directory.join("merged"));
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
        files.text(&format!("{name}.svg"), figure.svg());
        files.bytes(&format!("{name}.png"), figure.png());
    }
    let run = Provenance::of_files("cfmmr campaign merge");
    files.text("result.json", run.json(&report));
    args.json.write(&run, &report)?;
    let written = files.commit()?;
    let lines = written
        .iter()
        .map(|path| format!("wrote {}", path.display()));
    let lines: Vec<String> = lines.collect();
    args.json.print(&format!(
        "{}\nCRC-32C of runs.csv: {hash:08x}\n{}\n",
        report.text(),
        lines.join("\n")
    ))
}
