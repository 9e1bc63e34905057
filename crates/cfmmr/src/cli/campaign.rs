//! `cfmmr campaign`: computes a Monte Carlo study over variations of a scenario, in any number of shards.

use super::arguments::{AxlesArg, JsonArgs, WorldChoice};
use crate::experiments::Workers;
use crate::experiments::campaign::directory::Directory;
use crate::experiments::campaign::parts;
use crate::experiments::campaign::parts::Merged;
use crate::experiments::campaign::shard::Shard;
use crate::experiments::campaign::study::Study;
use crate::experiments::result::Provenance;
use clap::{Args, Subcommand};
use host_sim::base::error::Error;
use host_sim::base::numbers::whole;
use host_sim::base::toml_file;
use host_sim::scenario::own::Own;
use output::terminal::print;
use std::ffi::OsString;
use std::path::PathBuf;

/// Arguments of `campaign`.
#[derive(Clone, Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct CampaignArgs {
    /// Action on the files of the parts
    #[command(subcommand)]
    pub action: Option<CampaignAction>,
    /// Study in TOML (docs/campaigns.md)
    #[arg(value_name = "FILE", required = true)]
    pub file: Option<PathBuf>,
    /// Option that selects the world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Option that sets the number of axles.
    #[command(flatten)]
    pub axles: AxlesArg,
    /// Compute part I of N, counted from 0 [default: the part of the Slurm or Kubernetes job, else all parts]
    #[arg(long, value_name = "I/N")]
    pub shard: Option<String>,
    /// Write the study's files to this folder [default: out/FILE]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Use N threads; the number does not change the result [default: one per core]
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
    /// Write the result to this folder [default: DIR/merged]
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

/// Runs `cfmmr campaign`.
pub fn run(args: &CampaignArgs, own: &Own) -> Result<(), Error> {
    match &args.action {
        Some(CampaignAction::Merge(args)) => merge(args),
        Some(CampaignAction::Status(args)) => status(args),
        None => shard(args, own, |name| std::env::var_os(name)),
    }
}

/// Computes the missing blocks of one shard; `variable` reads an environment variable.
fn shard(
    args: &CampaignArgs,
    own: &Own,
    variable: impl Fn(&str) -> Option<OsString>,
) -> Result<(), Error> {
    let Some(file) = &args.file else {
        return Err(Error::input(
            "missing argument: type FILE (a study), merge or status",
        ));
    };
    let mut study = Study::load(file)?;
    if let Some(world) = &args.choice.world {
        let world = world.clone().into();
        study.scenario.insert("world".to_owned(), world);
        study.check()?;
    }
    let axles = toml_file::changes(&args.axles.changes(&[])?)?;
    if !axles.is_empty() {
        toml_file::merge_config(&mut study.scenario, axles);
        study.check()?;
    }
    study.set_own(own)?;
    let shard = match &args.shard {
        Some(text) => Shard::parse(text)?,
        None => Shard::from_environment(variable)?,
    };
    let out = args.out.clone().unwrap_or_else(|| {
        let stem = file.file_stem().unwrap_or_default();
        PathBuf::from("out").join(stem)
    });
    let directory = Directory::open_for(study, &out)?;
    let done = parts::compute(&directory, &shard, &Workers::new(args.threads)?, own)?;
    print(&format!(
        "{}: part {} of {}: {} runs computed, {} already complete; in {}\n{}",
        directory.study().name,
        shard.index,
        shard.count,
        done.runs,
        done.before,
        out.display(),
        parts::next_step(&directory, &out)
    ))
}

fn status(args: &CampaignStatus) -> Result<(), Error> {
    let json = args.json.open()?;
    let directory = Directory::open(&args.directory)?;
    let (status, _) = parts::read_blocks(&directory)?;
    let blocks = status.blocks as usize - status.missing.len() - status.damaged.len();
    let mut text = format!(
        "{}: {} of {} runs in {blocks} of {} blocks\n",
        status.name, status.runs_done, status.runs, status.blocks
    );
    for why in &status.damaged {
        text += &format!("{why}\n");
    }
    if args.missing {
        for &block in &status.missing {
            let runs = directory.study().block_runs(block);
            let (first, last) = (runs.start, runs.end - 1);
            text += &format!("missing: block {block}, runs {first} to {last}\n");
        }
    }
    json.write(&Provenance::default(), &status)?;
    json.print(&text)
}

fn merge(args: &CampaignMerge) -> Result<(), Error> {
    let json = args.json.open()?;
    let directory = Directory::open(&args.directory)?;
    let default = || args.directory.join("merged");
    let out = args.out.clone().unwrap_or_else(default);
    let merged = parts::merge(&directory, &args.directory, &out, args.partial)?;
    let Merged {
        report,
        mut files,
        hash,
    } = merged;
    let run = Provenance::of_files("cfmmr campaign merge");
    files.text("result.json", run.json(&report));
    json.write(&run, &report)?;
    let written = files.commit()?;
    let lines = written
        .iter()
        .map(|path| format!("wrote {}", path.display()));
    let lines: Vec<String> = lines.collect();
    json.print(&format!(
        "{}\nCRC-32C of runs.csv: {hash:08x}\n{}\n",
        report.text(),
        lines.join("\n")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use std::path::Path;

    /// Parses a command line of `campaign`.
    fn typed(line: &[&str]) -> CampaignArgs {
        #[derive(Parser)]
        struct Typed {
            #[command(flatten)]
            args: CampaignArgs,
        }
        let words = ["campaign"].iter().chain(line);
        Typed::try_parse_from(words).unwrap().args
    }

    /// A study of two blocks in a new folder, and the arguments of `campaign`.
    fn in_folder(folder: &Path, options: &[&str]) -> CampaignArgs {
        let file = folder.join("study.toml");
        std::fs::write(
            &file,
            "name = \"test\"\ntrials = 2\nblock = 1\n[scenario.mission]\ntime_limit_s = 0.1\n",
        )
        .unwrap();
        let out = folder.join("out");
        let fixed = [
            file.to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
            "--threads",
            "1",
        ];
        typed(&[&fixed, options].concat())
    }

    /// Files of a folder, without the copy of the study.
    fn files(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<String> = names.filter(|name| name != "study.toml").collect();
        names.sort();
        names
    }

    #[test]
    fn part_in_an_incomplete_environment_is_refused_and_writes_nothing() {
        for (name, value) in [
            ("CFMMR_SHARDS", "3"),
            ("CFMMR_SHARDS", "-1"),
            ("CFMMR_SHARDS", ""),
            ("JOB_COMPLETION_INDEX", "0"),
            ("SLURM_ARRAY_TASK_ID", "0"),
            ("SLURM_ARRAY_TASK_STEP", "0"),
        ] {
            let folder = tempfile::tempdir().unwrap();
            let args = in_folder(folder.path(), &[]);
            let variable = |asked: &str| (asked == name).then(|| OsString::from(value));
            let error = shard(&args, &Own::default(), variable).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{error}");
            assert!(
                error.to_string().contains(&format!("{name}={value}")),
                "{error}"
            );
            assert!(
                files(folder.path()).is_empty(),
                "{:?}",
                files(folder.path())
            );
        }
    }

    #[test]
    fn option_has_precedence_over_the_environment() {
        let folder = tempfile::tempdir().unwrap();
        let pod = |asked: &str| match asked {
            "JOB_COMPLETION_INDEX" => Some("0".into()),
            "CFMMR_SHARDS" => Some("2".into()),
            _ => None,
        };
        let out = folder.path().join("out");
        let own = Own::default();
        shard(&in_folder(folder.path(), &["--shard", "1/2"]), &own, pod).unwrap();
        assert_eq!(files(&out), ["block-000001.jsonl"]);
        // An environment that is refused without --shard is ignored with --shard.
        let refused = |asked: &str| (asked == "CFMMR_SHARDS").then(|| "x".into());
        shard(
            &in_folder(folder.path(), &["--shard", "1/2"]),
            &own,
            refused,
        )
        .unwrap();
        assert_eq!(files(&out), ["block-000001.jsonl"]);
        shard(&in_folder(folder.path(), &[]), &own, pod).unwrap();
        assert_eq!(files(&out), ["block-000000.jsonl", "block-000001.jsonl"]);
    }
}
