//! Directory of a campaign: a copy of the study and one file per block of runs.
//!
//! A block's content depends on the study only, so any number of shards can fill one directory. A killed shard keeps
//! its finished blocks: a file is written completely or not at all.

use super::rows::{CampaignRow, StoredBlock};
use super::study::Study;
use crate::BUILD;
use host_sim::base::error::Error;
use host_sim::base::input;
use output::files;
use std::fs;
use std::path::{Path, PathBuf};

/// Name of the copy of the study.
const COPY: &str = "study.toml";

/// Directory of a campaign.
#[derive(Clone, Debug)]
pub struct Directory {
    path: PathBuf,
    study: Study,
    canonical: String,
}

/// State of a block.
#[derive(Clone, Debug, PartialEq)]
pub enum Block {
    /// Runs of the block.
    Complete(Vec<CampaignRow>),
    /// The block has no file.
    Missing,
    /// Unusable file, with the reason.
    Damaged(String),
}

impl Directory {
    /// Opens or creates the directory of `study`; fails if the directory belongs to a different study.
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
                let failure = |error| Error::Failure(format!("{}: {error}", path.display()));
                fs::create_dir_all(path).map_err(failure)?;
                files::write_file(&copy, &canonical)?;
            }
            Err(error) => return Err(Error::input(format!("{}: {error}", copy.display()))),
        }
        Ok(Self {
            path: path.to_owned(),
            study,
            canonical,
        })
    }

    /// Opens an existing directory.
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

    /// Study of this campaign.
    pub fn study(&self) -> &Study {
        &self.study
    }

    fn file(&self, block: u64) -> PathBuf {
        self.path.join(format!("block-{block:06}.jsonl"))
    }

    /// Numbers of the blocks without a file.
    pub fn absent(&self) -> Vec<u64> {
        let blocks = 0..self.study.blocks();
        blocks.filter(|&block| !self.file(block).exists()).collect()
    }

    /// State of a block.
    pub fn block(&self, block: u64) -> Result<Block, Error> {
        let path = self.file(block);
        let content = match input::bytes(&path, input::MAX_DATA_BYTES) {
            Ok(content) => content,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(Block::Missing);
            }
            Err(error) => return Err(Error::Failure(format!("{}: {error}", path.display()))),
        };
        let damaged = |why: String| Ok(Block::Damaged(format!("{}: {why}", path.display())));
        let mut read = match StoredBlock::from_lines(&content) {
            Ok(read) => read,
            Err(error) => return damaged(error),
        };
        if read.study != self.canonical {
            return damaged("belongs to a different study".to_owned());
        }
        if read.made_by != BUILD {
            return damaged(format!("was written by another build than {BUILD}"));
        }
        let runs = read.rows.iter().map(|row| row.run);
        if !runs.eq(self.study.block_runs(block)) {
            return damaged("does not contain the runs of its block".to_owned());
        }
        for row in &mut read.rows {
            (row.cell, row.trial) = self.study.cell_and_trial(row.run);
            row.values = self.study.values(row.cell, row.trial)?;
        }
        Ok(Block::Complete(read.rows))
    }

    /// Writes the runs of a block.
    pub fn write(&self, block: u64, rows: Vec<CampaignRow>) -> Result<(), Error> {
        let stored = StoredBlock {
            made_by: BUILD.to_owned(),
            study: self.canonical.clone(),
            rows,
        };
        let file = self.file(block);
        let lines = stored.to_lines()?;
        // JSON cannot represent NaN; fail before such a block is written.
        StoredBlock::from_lines(lines.as_bytes())
            .map_err(|why| Error::Failure(format!("{}: {why}", file.display())))?;
        Ok(files::write_file(&file, lines)?)
    }
}
