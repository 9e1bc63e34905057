//! Recording as CSV tables for a spreadsheet.

use super::Line;
use super::entry::{AxleTick, BeamTick};
use crate::csv;
use crate::schema::Schema;
use core_algos::bus::CanFrame;
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use host_sim::bus::virtual_bus::name_of;
use host_sim::run::end::RunEnd;
use host_sim::run::robot::Record;
use output::files::{Cell, Csv, OutputDir, try_file, write_file};
use std::path::{Path, PathBuf};

/// Destination of the tables: a file or a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum TableDestination {
    /// Table of epochs only.
    File(PathBuf),
    /// Tables of epochs, ticks, frames and the end of the run.
    Folder(PathBuf),
}

impl TableDestination {
    /// A file if the name of `path` ends in `.csv`, otherwise a folder.
    pub(super) fn new(path: &Path) -> Result<Self, Error> {
        let is_file = path
            .extension()
            .is_some_and(|end| end.eq_ignore_ascii_case("csv"));
        match is_file && !path.is_dir() {
            true => {
                try_file(path)?;
                Ok(Self::File(path.to_path_buf()))
            }
            false => {
                OutputDir::create(path)?;
                Ok(Self::Folder(path.to_path_buf()))
            }
        }
    }
}

/// Column names: `own`, then the columns of a message of the log.
fn header(own: &[&str], schema: &Schema) -> Vec<String> {
    let own = own.iter().map(|name| (*name).to_owned());
    own.chain(schema.columns()).collect()
}

/// CSV tables of a run, collected in memory.
pub struct Tables {
    destination: TableDestination,
    robot: Topology,
    records: Vec<Record>,
    axles: Csv,
    beam: Csv,
    bus: Csv,
    /// Common time of the boards at the start of the run, µs.
    zero: i64,
}

impl Tables {
    /// Empty tables of a robot, to be written to `path`: a file if its name ends in `.csv`, otherwise a folder.
    pub fn new(path: &Path, robot: Topology) -> Result<Self, Error> {
        Ok(Self {
            destination: TableDestination::new(path)?,
            robot,
            records: Vec::new(),
            axles: Csv::new(header(&["time_s", "board"], &AxleTick::SCHEMA)),
            beam: Csv::new(match robot.frame_count() {
                1 => header(&["time_s"], &BeamTick::SCHEMA),
                _ => header(&["time_s", "board"], &BeamTick::SCHEMA),
            }),
            zero: 0,
            bus: Csv::new(["time_s", "board", "identifier_hex", "message", "data_hex"]),
        })
    }

    /// Adds the record of an epoch to the table of epochs.
    pub fn epoch(&mut self, record: &Record) {
        self.records.push(record.clone());
    }

    fn all(&self) -> bool {
        matches!(self.destination, TableDestination::Folder(_))
    }

    /// Adds an event of the recording to the table of its kind.
    pub(super) fn note(&mut self, line: &Line) {
        match line {
            Line::Zero(zero) => self.zero = *zero,
            _ if !self.all() => {}
            Line::Axle(role, tick) => self.axle(*role, tick),
            Line::Beam(role, tick) => {
                let name = Cell::from(self.robot.name(*role));
                let name = Some(name).filter(|_| self.robot.frame_count() > 1);
                let own = [self.seconds(tick.tick)].into_iter().chain(name);
                self.beam.row(own.chain(tick.cells()));
            }
            Line::Frames { role, tick, frames } => {
                frames
                    .iter()
                    .for_each(|frame| self.frame(*role, *tick, frame));
            }
            Line::Start(..)
            | Line::Off(..)
            | Line::Command(_)
            | Line::Lead(..)
            | Line::Board(..) => {}
        }
    }

    /// Cell with the time of the run at a tick of the boards, s.
    fn seconds(&self, tick: u32) -> Cell {
        (f64::from(tick) * 1e-3 - self.zero as f64 * 1e-6).into()
    }

    fn axle(&mut self, role: Role, tick: &AxleTick) {
        let own = [self.seconds(tick.tick), self.robot.name(role).into()];
        self.axles.row(own.into_iter().chain(tick.cells()));
    }

    fn frame(&mut self, role: Role, tick: u32, frame: &CanFrame) {
        let data = frame.data.iter().take(usize::from(frame.length));
        let name = name_of(self.robot, frame.id).unwrap_or("unknown");
        let time = self.seconds(tick);
        self.bus.row::<Cell>([
            time,
            self.robot.name(role).into(),
            Cell::Text(format!("{:#05x}", frame.id)),
            name.into(),
            match frame.length {
                0 => Cell::Empty,
                _ => {
                    Cell::Text(data.fold("0x".to_owned(), |text, byte| format!("{text}{byte:02x}")))
                }
            },
        ]);
    }

    /// Writes the tables and the end of the run; returns the paths of the files.
    pub fn write(self, end: &RunEnd) -> Result<Vec<PathBuf>, Error> {
        let epochs = csv::of_records(&self.records);
        match self.destination {
            TableDestination::File(path) => {
                write_file(&path, epochs.into_bytes())?;
                Ok(vec![path])
            }
            TableDestination::Folder(path) => {
                let mut files = OutputDir::create(path)?;
                files.csv("epochs.csv", epochs);
                files.csv("axles.csv", self.axles);
                files.csv("beam.csv", self.beam);
                files.csv("bus.csv", self.bus);
                files.csv("end.csv", csv::of_ends([end]));
                Ok(files.commit()?)
            }
        }
    }
}
