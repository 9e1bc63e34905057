//! Recording of a run: inputs and outputs of its boards and the true state of a simulated robot, as an MCAP file, as
//! tables, or for live viewers.
//!
//! A [`Session`] is one recording. [`Session::tap`] wraps each board in a recorder. As an [`Observer`], the session
//! takes the true state of a simulated robot once per epoch. A thread (`writer`) writes the recording; `Mcap` in
//! `log/file.rs` writes the messages of a log. [`topics`] is the table of topics, [`entry`] declares the messages,
//! [`log::read`] reads a log.
//!
//! Times count from the start of the run, in a log in nanoseconds. A simulated run gives identical bytes every time.

#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "a test compares with another implementation"
    )
)]

#[cfg(test)]
#[macro_use]
#[path = "../../../core-algos/src/properties.rs"]
mod properties;

pub mod csv;
pub mod dbc;
pub mod entry;
#[cfg(feature = "logs")]
pub mod log;
#[cfg(not(feature = "logs"))]
#[path = "no_log.rs"]
pub mod log;
mod schema;
pub mod tables;
mod tap;
pub mod topics;
mod writer;

use core_algos::bus::CanFrame;
use core_algos::link::framing::crc32c;
use core_algos::link::protocol::Placement;
use core_algos::node::board::Samples;
use core_algos::node::lead::{self, Task};
use core_algos::node::robot::RobotConfig;
use core_algos::topology::{Role, Wheels};
use entry::{AxleTick, BeamTick, Can, Exact, Hex, HostCommandEntry, Off, Start};
use host_sim::base::error::Error;
use host_sim::run::end::RunEnd;
use host_sim::run::robot::{Observer, Record, Robot};
use host_sim::scenario::Scenario;
use host_sim::targets::board_record::BoardEvent;
use host_sim::targets::{HostCommand, Target, TargetReport};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use tables::Tables;
use writer::{Files, Note, Writer};

/// Destinations of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Destinations {
    /// Path of the MCAP file; `None` without a log.
    pub log: Option<PathBuf>,
    /// Path of the CSV file of the epochs, or of the folder with tables of epochs, ticks and bus frames; `None` without
    /// tables.
    pub csv: Option<PathBuf>,
    /// Address of the server for live viewers; `None` without a server.
    pub live: Option<SocketAddr>,
    /// Origins of web pages that may connect to the server; pages of this machine are always allowed.
    pub live_origin: Vec<String>,
}

impl Destinations {
    /// True if the run is recorded or served.
    pub fn any(&self) -> bool {
        self.log.is_some() || self.csv.is_some() || self.live.is_some()
    }

    /// Checks the paths before a long computation.
    pub fn check(&self) -> Result<(), Error> {
        log::check(self)?;
        if let Some(path) = &self.csv {
            tables::TableDestination::new(path)?;
        }
        Ok(())
    }
}

/// Parses the server's address: an address with a port, or a port for this machine only.
pub fn address(text: &str) -> Result<SocketAddr, String> {
    let local = || {
        text.parse()
            .map(|port: u16| (Ipv4Addr::LOCALHOST, port).into())
    };
    text.parse().or_else(|_| local()).map_err(|_| {
        "must be ADDRESS:PORT or a port, for example 8765 for viewers on this machine or \
         0.0.0.0:8765 for others too"
            .to_owned()
    })
}

/// Description of a recorded run.
#[derive(Clone, Debug)]
pub struct About<'a> {
    /// Command line of the run.
    pub command: &'a str,
    /// Name, version and source hash of the program.
    pub build: &'a str,
    /// Seed of all random draws.
    pub seed: u64,
    /// Number of the trial.
    pub trial: u64,
    /// Scenario of the run.
    pub scenario: &'a Scenario,
}

/// Error for a log that could not be written.
fn failed(error: impl std::fmt::Display) -> Error {
    Error::Failure(format!("log: {error}"))
}

/// Handle of a recording, shared by its clones. A separate thread writes the recording.
#[derive(Clone)]
pub struct Session {
    writer: Arc<Mutex<Writer>>,
    /// Common time of the boards at the start of the run, µs; empty until it is known.
    zero: Arc<OnceLock<i64>>,
}

impl Session {
    /// Starts a recording, if a destination is given.
    pub fn begin(to: &Destinations, about: &About) -> Result<Option<Self>, Error> {
        if !to.any() {
            return Ok(None);
        }
        let tables = to.csv.as_deref();
        let tables = tables.map(|path| Tables::new(path, about.scenario.robot.topology()));
        let tables = tables.transpose()?;
        let mcap = log::open(to, about)?;
        Ok(Some(Self::of(Files { mcap, tables }, to.live.is_some())))
    }

    fn of(files: Files, prompt: bool) -> Self {
        Self {
            writer: Arc::new(Mutex::new(Writer::new(files, prompt))),
            zero: Arc::default(),
        }
    }

    fn writer(&self) -> MutexGuard<'_, Writer> {
        self.writer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Wraps the boards of a scenario so that their inputs and outputs are recorded.
    pub fn tap(&self, targets: Vec<Box<dyn Target>>, scenario: &Scenario) -> Vec<Box<dyn Target>> {
        let encoded = scenario.world.bus.quantise;
        let boards = scenario.robot.topology().boards();
        let tapped = boards.zip(targets).map(|(role, target)| {
            Box::new(tap::Tap::new(role, target, self.clone(), encoded)) as Box<dyn Target>
        });
        tapped.collect()
    }

    /// Records goal and path of the run.
    pub fn plan(&self, goal: [f64; 3], path: &[[f64; 3]]) {
        let mut writer = self.writer();
        match writer.files().map(|files| &mut files.mcap) {
            Some(Some(mcap)) => mcap.plan(goal, path),
            Some(None) => {}
            None => writer.take(Note::Plan(goal, path.to_vec())),
        }
    }

    /// Waits for a viewer if the run is served and no event was recorded yet; an error if `interrupt` is set meanwhile.
    pub fn await_viewer(&self, interrupt: &AtomicBool) -> Result<(), Error> {
        match self.writer().files().and_then(|files| files.mcap.as_ref()) {
            Some(mcap) => mcap.await_viewer(interrupt),
            None => Ok(()),
        }
    }

    /// Ends the recording with the end of the run; returns the paths of the files.
    pub fn close(&self, end: &RunEnd) -> Result<Vec<PathBuf>, Error> {
        match self.writer().finish()? {
            Some(files) => files.close(end),
            None => Ok(Vec::new()),
        }
    }

    /// Common time of the boards at a tick of the run, ms.
    fn common(&self, tick: u32) -> u32 {
        let zero = self.zero.get().copied().unwrap_or_default();
        u32::try_from(i64::from(tick) + zero / 1000).unwrap_or_default()
    }

    /// Passes an event of the recording to the writer.
    fn note(&self, line: Line) {
        self.writer().take(Note::Line(line));
    }
}

impl Observer for Session {
    fn epoch(&mut self, _robot: &dyn Robot, record: &Record) -> Result<(), Error> {
        self.writer().take(Note::Epoch(Box::new(record.clone())));
        Ok(())
    }

    fn board(&mut self, role: Role, image: String) {
        self.note(Line::Board(role, image));
    }

    fn event(&mut self, role: Role, zero: i64, event: &BoardEvent) {
        if self.zero.set(zero).is_ok() {
            self.note(Line::Zero(zero));
        }
        match event {
            BoardEvent::Begin(tick, config) => {
                let start = Box::new((Start::new(*tick, config, None), None));
                self.note(Line::Start(role, start));
            }
            BoardEvent::Command(tick, command) => {
                self.note(Line::Command(HostCommandEntry::new(*tick, command)));
            }
            BoardEvent::Lead(tick, output) => self.note(Line::Lead(*tick, output.clone())),
            BoardEvent::End(tick, reason) => {
                let (tick, reason) = (*tick, reason.clone());
                self.note(Line::Off(role, Off { tick, reason }));
            }
            BoardEvent::Tick(tick) => {
                if !tick.sent.is_empty() {
                    self.note(Line::Frames {
                        role,
                        tick: tick.tick,
                        frames: tick.sent.clone(),
                    });
                }
                let received = tick.received.iter().copied().map(Can).collect();
                self.note(Line::of_tick(
                    role,
                    (tick.tick, &tick.samples),
                    received,
                    tick.torque_nm,
                ));
            }
        }
    }

    fn frames(&mut self, role: Role, tick: u32, frames: Vec<CanFrame>) {
        self.note(Line::Frames {
            role,
            tick: self.common(tick),
            frames,
        });
    }

    fn lead(&mut self, tick: u32, output: &lead::Output) {
        self.note(Line::Lead(self.common(tick), Box::new(*output)));
    }

    fn off(&mut self, role: Role, tick: u32, reason: &str) {
        let (tick, reason) = (self.common(tick), reason.to_owned());
        self.note(Line::Off(role, Off { tick, reason }));
    }
}

/// Event of a recording.
#[cfg_attr(
    not(feature = "logs"),
    expect(dead_code, reason = "tables hold a part")
)]
enum Line {
    /// Common time of the boards at the start of the run, µs.
    Zero(i64),
    /// The nodes of a board were started.
    Start(Role, Box<(Start, Option<TargetReport>)>),
    /// A board was switched off or lost.
    Off(Role, Off),
    /// The host sent a command to the lead node.
    Command(HostCommandEntry),
    /// A board sent frames on the bus.
    Frames {
        role: Role,
        /// Tick of the board, ms.
        tick: u32,
        frames: Vec<CanFrame>,
    },
    /// Output of the lead node at a tick.
    Lead(u32, Box<lead::Output>),
    /// Role of a board, and the build of the image that the board runs.
    Board(Role, String),
    /// A tick of an axle board.
    Axle(Role, AxleTick),
    /// A tick of a beam board.
    Beam(Role, BeamTick),
}

impl Line {
    /// Event of a tick of an axle or beam board.
    fn of_tick(
        role: Role,
        (tick, samples): (u32, &Samples),
        received: Vec<Can>,
        torque_nm: Wheels<f32>,
    ) -> Self {
        match *samples {
            Samples::Axle(samples) => Self::Axle(
                role,
                AxleTick {
                    tick,
                    encoder: samples.encoder.list(),
                    gyro_rad_s: samples.gyro_rad_s.map(Exact),
                    acceleration_m_s2: samples.acceleration_m_s2.map(Exact),
                    conditions: samples.conditions,
                    received,
                    torque_nm: torque_nm.map(Exact).list(),
                },
            ),
            Samples::Beam(samples) => Self::Beam(
                role,
                BeamTick {
                    tick,
                    counts: samples.counts,
                    conditions: samples.conditions,
                    received,
                },
            ),
        }
    }
}

impl Start {
    fn new(tick: u32, config: &RobotConfig, place: Option<&Placement>) -> Self {
        let parameters = Hex::of(config);
        Self {
            tick,
            parameters_hash: format!("{:08x}", crc32c(&parameters.0)),
            parameters,
            place: place.map(Hex::of),
        }
    }
}

impl HostCommandEntry {
    fn new(tick: u32, command: &HostCommand) -> Self {
        Self {
            tick,
            text: in_words(command),
            bits: Hex::of(command),
        }
    }
}

/// Description of a command in words.
fn in_words(command: &HostCommand) -> String {
    let list = |count: usize, what: &str, end: bool| {
        let end = if end { ", the last" } else { "" };
        format!("{count} points of the {what}{end}")
    };
    match command {
        HostCommand::Task(Task::Regulate { goal, .. }) => {
            format!("regulate to {} m, {} m, {} rad", goal.x, goal.y, goal.phi)
        }
        HostCommand::Task(task) => format!("{task:?}").to_lowercase(),
        HostCommand::SetPose(place) => {
            let at = place.center.posture;
            format!("posture {} m, {} m, {} rad", at.x, at.y, at.phi)
        }
        HostCommand::Lost => "host lost".to_owned(),
        HostCommand::Path { points, end } => list(points.len(), "path", *end),
        HostCommand::Trajectory { points, end } => list(points.len(), "trajectory", *end),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn address_without_host_is_this_machine() {
        let text = |text| address(text).map(|address| address.to_string());
        assert_eq!(text("0.0.0.0:8765").as_deref(), Ok("0.0.0.0:8765"));
        assert_eq!(text("[::1]:80").as_deref(), Ok("[::1]:80"));
        assert_eq!(text("9000").as_deref(), Ok("127.0.0.1:9000"));
        for bad in ["", "localhost", "1.2.3.4", "65536", "1.2.3.4:x", "-1"] {
            assert!(address(bad).unwrap_err().contains("0.0.0.0:8765"), "{bad}");
        }
    }
}
