//! Pins, interrupts and bus in a file for GTKWave, PulseView and others.

use crate::base::error::Error;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use virtual_board::image::Image;
use virtual_board::network::Network;
use virtual_board::probe::waves;
use virtual_board::wire::Record;

/// A file that is being written.
pub(super) struct Waves {
    path: PathBuf,
    waves: waves::Waves<BufWriter<File>>,
}

fn failed(path: &Path, error: &io::Error) -> Error {
    Error::Failure(format!("--vcd {}: {error}", path.display()))
}

impl Waves {
    /// Begins a file of these boards.
    pub fn create(
        path: &Path,
        network: &mut Network,
        boards: &[(&str, &Image)],
    ) -> Result<Self, Error> {
        let folder = path.parent().map_or(Ok(()), fs::create_dir_all);
        let file = folder.and_then(|()| File::create(path));
        let file = file.map_err(|error| failed(path, &error))?;
        Ok(Self {
            path: path.to_path_buf(),
            waves: waves::Waves::new(BufWriter::new(file), network, boards),
        })
    }

    /// A sending on the bus that has ended.
    pub fn frame(&mut self, sending: &Record) {
        self.waves.frame(sending);
    }

    /// Writes what has happened.
    pub fn follow(&mut self, network: &mut Network) -> Result<(), Error> {
        let done = self.waves.follow(network);
        done.map_err(|error| failed(&self.path, &error))
    }

    /// Ends the file; gives where it is.
    pub fn finish(self, network: &mut Network) -> Result<PathBuf, Error> {
        let done = self.waves.finish(network);
        done.map_err(|error| failed(&self.path, &error))?;
        Ok(self.path)
    }
}
