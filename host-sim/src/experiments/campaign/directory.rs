//! The directory of a study: the study itself and one file for each block of runs.
//!
//! A block is the same whoever runs it, so shards of any number fill one directory, and what a killed
//! shard had finished stays. A file is complete or not there.

use super::columns::{Columns, Noted, Values};
use super::study::{Run, Study};
use crate::base::error::Error;
use crate::base::input;
use crate::base::output;
use crate::recording::BUILD;
use crate::run::final_error::FinalError;
use crate::run::regulate::Outcome;
use std::fs;
use std::path::{Path, PathBuf};

/// Name of the copy of the study.
const COPY: &str = "study.toml";

/// One run and how it ended.
pub struct Finished {
    /// Its number in the study.
    pub index: u64,
    /// Run.
    pub run: Run,
    /// Result.
    pub outcome: Outcome,
}

/// A study's directory.
#[derive(Clone, Debug)]
pub struct Directory {
    path: PathBuf,
    study: Study,
    canonical: String,
}

/// State of a block.
#[derive(Clone, Debug, PartialEq)]
pub enum Block {
    /// Its runs.
    Complete(Columns),
    /// Nothing.
    Missing,
    /// A file that cannot be used, and why.
    Spoiled(String),
}

impl Directory {
    /// The directory for the runs of `study`. One that is there must be of the same study.
    pub fn open_for(study: Study, path: &Path) -> Result<Self, Error> {
        let canonical = study.canonical()?;
        let copy = path.join(COPY);
        match input::text(&copy) {
            Ok(found) if found == canonical => {}
            Ok(_) => {
                return Err(Error::input(format!(
                    "{}: belongs to a different study: choose another --out, or remove the folder",
                    copy.display()
                )));
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                fs::create_dir_all(path)
                    .map_err(|error| Error::Failure(format!("{}: {error}", path.display())))?;
                output::write_file(&copy, &canonical)?;
            }
            Err(error) => return Err(Error::input(format!("{}: {error}", copy.display()))),
        }
        Ok(Self {
            path: path.to_owned(),
            study,
            canonical,
        })
    }

    /// A directory that shards have written to.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let copy = path.join(COPY);
        let study = Study::load(&copy).map_err(|error| match copy.exists() {
            true => error,
            false => Error::input(format!(
                "{}: not a campaign folder: {COPY} is missing",
                path.display()
            )),
        })?;
        Self::open_for(study, path)
    }

    /// The study.
    pub fn study(&self) -> &Study {
        &self.study
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn file(&self, block: u64) -> PathBuf {
        self.path.join(format!("block-{block:06}.jsonl"))
    }

    /// State of a block.
    pub fn block(&self, block: u64) -> Result<Block, Error> {
        let path = self.file(block);
        let content = match input::bytes(&path) {
            Ok(content) => content,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(Block::Missing);
            }
            Err(error) => return Err(Error::Failure(format!("{}: {error}", path.display()))),
        };
        let spoiled = |why: String| Ok(Block::Spoiled(format!("{}: {why}", path.display())));
        let read = match Noted::from_lines(&content) {
            Ok(read) => read,
            Err(error) => return spoiled(error),
        };
        if read.study != self.canonical {
            return spoiled("belongs to a different study".to_owned());
        }
        if read.made_by != BUILD {
            return spoiled(format!("was not written by {BUILD}"));
        }
        let expected = self.study.block_runs(block);
        let runs = read.columns.integers("run").iter();
        if !runs.copied().eq(expected.map(|run| run as i64)) {
            return spoiled("does not contain the runs of its block".to_owned());
        }
        Ok(Block::Complete(read.columns))
    }

    /// Writes the runs of a block.
    pub fn write(&self, block: u64, runs: &[Finished]) -> Result<(), Error> {
        let noted = Noted {
            made_by: BUILD.to_owned(),
            study: self.canonical.clone(),
            columns: columns(&self.study, runs),
        };
        Ok(output::write_file(&self.file(block), noted.to_lines()?)?)
    }
}

/// The table of some runs: what they were, then how they ended.
fn columns(study: &Study, runs: &[Finished]) -> Columns {
    let whole = |pick: &dyn Fn(&Finished) -> i64| Values::Integer(runs.iter().map(pick).collect());
    let flag = |pick: &dyn Fn(&Finished) -> bool| Values::Flag(runs.iter().map(pick).collect());
    let number = |pick: &dyn Fn(&Finished) -> f64| Values::Double(runs.iter().map(pick).collect());
    let mut columns = vec![
        ("run".to_owned(), whole(&|r| r.index as i64)),
        ("cell".to_owned(), whole(&|r| r.run.cell as i64)),
        ("trial".to_owned(), whole(&|r| r.run.trial.into())),
    ];
    for (i, vary) in study.vary.iter().enumerate() {
        let values = match vary.is_numeric() {
            true => number(&|r| super::study::number(&r.run.values[i]).unwrap_or(f64::NAN)),
            false => Values::Text(runs.iter().map(|r| r.run.values[i].to_string()).collect()),
        };
        columns.push((vary.key.clone(), values));
    }
    let error = |r: &Finished| FinalError::of(r.outcome.midpoint, r.run.scenario.mission.goal);
    for (i, name) in ["start_x_m", "start_y_m", "start_phi_rad"]
        .into_iter()
        .enumerate()
    {
        let start = number(&|r| r.run.scenario.mission.start[i]);
        columns.push((name.to_owned(), start));
    }
    let fault = |r: &Finished| {
        let reason = r.outcome.fault.as_ref().and_then(|fault| fault.reason);
        reason.map_or(0, |condition| condition.code().into())
    };
    let ends = [
        ("e_m", number(&|r| error(r).e_m)),
        ("heading_rad", number(&|r| error(r).heading_rad)),
        ("within_3cm_3deg", flag(&|r| error(r).is_near())),
        ("done", flag(&|r| r.outcome.done)),
        ("gave_up", flag(&|r| r.outcome.gave_up)),
        ("fault_code", whole(&fault)),
        ("x_m", number(&|r| r.outcome.midpoint[0])),
        ("y_m", number(&|r| r.outcome.midpoint[1])),
        ("phi_rad", number(&|r| r.outcome.midpoint[2])),
        (
            "estimate_error_m",
            number(&|r| {
                let ([x, y, _], [u, v, _]) = (r.outcome.midpoint, r.outcome.estimate);
                (u - x).hypot(v - y)
            }),
        ),
        (
            "drift_m",
            number(&|r| r.outcome.relative_error[0].hypot(r.outcome.relative_error[1])),
        ),
        ("force_rms_n", number(&|r| r.outcome.force_rms_n)),
        ("max_curvature_1_m", number(&|r| r.outcome.max_curvature)),
        ("duration_s", number(&|r| r.outcome.duration_s)),
        ("path_m", number(&|r| r.outcome.path_m)),
    ];
    columns.extend(ends.map(|(name, values)| (name.to_owned(), values)));
    Columns(columns)
}
