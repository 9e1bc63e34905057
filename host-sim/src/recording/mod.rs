//! Recording a run: everything its boards got and did, and what the robot really did meanwhile, as
//! an MCAP file, as tables, or both.
//!
//! A [`Session`] is one recording. [`Session::tap`] puts a listener on each board, wherever it runs;
//! as an [`Observer`] it takes in the true state once an epoch. [`topics`] is the table of what is
//! written, [`entry`] declares the messages, [`read`] the way back.
//!
//! Times are simulated time since the start, in a log as nanoseconds: one run gives the same bytes
//! every time.

pub mod csv;
pub mod entry;
mod file;
mod gate;
mod intact;
mod live;
pub mod read;
pub mod recover;
pub mod replay;
mod schema;
mod sink;
mod standard;
pub mod tables;
mod tap;
pub mod topics;
mod writer;

use crate::base::error::Error;
use crate::base::output;
use crate::run::end::RunEnd;
use crate::run::robot::{Observer, Record, Robot};
use crate::scenario::Scenario;
use crate::targets::board_record::BoardEvent;
use crate::targets::{HostCommand, Report, Target};
use core_algos::bus::CanFrame;
use core_algos::link::framing::crc32c;
use core_algos::link::protocol::Place;
use core_algos::node::board::Samples;
use core_algos::node::lead::{self, Task};
use core_algos::node::robot::RobotConfig;
use core_algos::topology::Role;
use entry::{AxleTick, BeamTick, Can, Exact, Hex, HostCommandEntry, Off, Start};
use file::Mcap;
use sink::Sink;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use tables::Tables;
use writer::{Files, Note, Writer};

/// Commit that this program was built from.
pub const BUILD: &str = env!("BUILD");

/// Recording, dashboard and server of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, clap::Args)]
pub struct LogArgs {
    /// Record the inputs and outputs of the boards in this MCAP file (docs/logs.md); with several
    /// trials: the plotted one
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Write the run as CSV: epochs to FILE.csv, or epochs, ticks and bus frames to DIR
    #[arg(long, value_name = "DIR|FILE")]
    pub csv: Option<PathBuf>,
    /// Show the run on the terminal in real time; q ends the run
    #[arg(long)]
    pub dashboard: bool,
    /// Serve the run to Foxglove by websocket in real time, from the first viewer on; ADDR is
    /// ADDRESS:PORT or a port [default: 127.0.0.1:8765] (docs/live.md)
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "127.0.0.1:8765", value_parser = live::address)]
    pub live: Option<SocketAddr>,
    /// Let web pages of this origin (scheme and host) connect to --live; may be repeated [default: pages of this machine
    /// only]
    #[arg(long, value_name = "ORIGIN", requires = "live")]
    pub live_origin: Vec<String>,
}

impl LogArgs {
    /// True if the run is recorded or served.
    pub fn any(&self) -> bool {
        self.log.is_some() || self.csv.is_some() || self.live.is_some()
    }

    /// True if the run is shown or served, so that it runs in real time.
    pub fn is_watched(&self) -> bool {
        self.dashboard || self.live.is_some()
    }

    /// Checks the options before a long computation.
    pub fn check(&self) -> Result<(), Error> {
        if let Some(path) = &self.csv {
            Tables::new(path)?;
        }
        if let Some(path) = &self.log {
            output::try_file(path)?;
        }
        Ok(())
    }
}

/// Description of a recorded run.
#[derive(Clone, Debug)]
pub struct About<'a> {
    /// The command.
    pub command: &'a str,
    /// Seed of all draws.
    pub seed: u64,
    /// Number of the trial.
    pub trial: u64,
    /// The scenario as it was run.
    pub scenario: &'a Scenario,
}

/// Error of a log.
fn failed(error: impl std::fmt::Display) -> Error {
    Error::Failure(format!("log: {error}"))
}

/// A recording; its clones are the same one. It is written down on a thread of its own.
#[derive(Clone)]
pub struct Session {
    writer: Arc<Mutex<Writer>>,
    /// Common time of recorded boards at the start of the run, µs.
    zero: Arc<OnceLock<i64>>,
}

impl Session {
    /// Begins a recording, if one is asked for.
    pub fn begin(args: &LogArgs, about: &About) -> Result<Option<Self>, Error> {
        if !args.any() {
            return Ok(None);
        }
        let tables = args.csv.as_deref().map(Tables::new).transpose()?;
        let mut sink = args.log.as_deref().map(Sink::to_file).transpose()?;
        if let Some(address) = args.live {
            sink.get_or_insert_with(Sink::nowhere)
                .serve(address, &args.live_origin)?;
        }
        let mcap = sink.map(|sink| Mcap::new(sink, about)).transpose()?;
        Ok(Some(Self::of(Files { mcap, tables }, args.live.is_some())))
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

    /// Listens to these boards, which run in this scenario.
    pub fn tap(&self, targets: [Box<dyn Target>; 3], scenario: &Scenario) -> [Box<dyn Target>; 3] {
        let encoded = scenario.world.bus.quantise;
        let mut roles = Role::ALL.into_iter();
        targets.map(|target| {
            let role = roles.next().unwrap_or(Role::Beam);
            Box::new(tap::Tap::new(role, target, self.clone(), encoded)) as Box<dyn Target>
        })
    }

    /// Goal and path of the run.
    pub fn plan(&self, goal: [f64; 3], path: &[[f64; 3]]) {
        let mut writer = self.writer();
        match writer.files().map(|files| &mut files.mcap) {
            Some(Some(mcap)) => mcap.plan(goal, path),
            Some(None) => {}
            None => writer.take(Note::Plan(goal, path.to_vec())),
        }
    }

    /// Waits for a viewer of a run that is served and has not begun; an error if the flag is set
    /// meanwhile.
    pub fn await_viewer(&self, interrupt: &AtomicBool) -> Result<(), Error> {
        match self.writer().files().and_then(|files| files.mcap.as_ref()) {
            Some(mcap) => mcap.await_viewer(interrupt),
            None => Ok(()),
        }
    }

    /// Ends the recording; gives the files. `end` is the end of the run.
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

    /// Has a line written down.
    fn note(&self, line: Line) {
        self.writer().take(Note::Line(line));
    }
}

impl Observer for Session {
    fn epoch(&mut self, _robot: &dyn Robot, record: &Record) -> Result<(), Error> {
        self.writer().take(Note::Epoch(Box::new(*record)));
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
                    self.note(Line::Frames(role, tick.tick, tick.sent.clone()));
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
        self.note(Line::Frames(role, self.common(tick), frames));
    }

    fn lead(&mut self, tick: u32, output: &lead::Output) {
        self.note(Line::Lead(self.common(tick), Box::new(*output)));
    }

    fn off(&mut self, role: Role, tick: u32, reason: &str) {
        let (tick, reason) = (self.common(tick), reason.to_owned());
        self.note(Line::Off(role, Off { tick, reason }));
    }
}

/// Event at a tap.
enum Line {
    /// Common time of the boards at the start of the run, µs.
    Zero(i64),
    /// A board's nodes were started.
    Start(Role, Box<(Start, Option<Report>)>),
    /// A board went off.
    Off(Role, Off),
    /// The host told the lead node something.
    Command(HostCommandEntry),
    /// A board put frames on the bus.
    Frames(Role, u32, Vec<CanFrame>),
    /// The lead node's output, at a tick.
    Lead(u32, Box<lead::Output>),
    /// Role of a board and its image.
    Board(Role, String),
    /// A tick of an axle board.
    Axle(Role, AxleTick),
    /// A tick of the beam board.
    Beam(BeamTick),
}

impl Line {
    /// The line of a tick.
    fn of_tick(
        role: Role,
        (tick, samples): (u32, &Samples),
        received: Vec<Can>,
        torque_nm: [f32; 2],
    ) -> Self {
        match *samples {
            Samples::Axle(samples) => Self::Axle(
                role,
                AxleTick {
                    tick,
                    encoder: samples.encoder,
                    gyro_rad_s: samples.gyro_rad_s.map(Exact),
                    acceleration_m_s2: samples.acceleration_m_s2.map(Exact),
                    conditions: samples.conditions,
                    received,
                    torque_nm: torque_nm.map(Exact),
                },
            ),
            Samples::Beam(samples) => Self::Beam(BeamTick {
                tick,
                counts: samples.counts,
                conditions: samples.conditions,
                received,
            }),
        }
    }
}

impl Start {
    fn new(tick: u32, config: &RobotConfig, place: Option<&Place>) -> Self {
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

/// A command in words.
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
        HostCommand::Place(place) => {
            let at = place.center.posture;
            format!("posture {} m, {} m, {} rad", at.x, at.y, at.phi)
        }
        HostCommand::Lost => "host lost".to_owned(),
        HostCommand::Path(points, end) => list(points.len(), "path", *end),
        HostCommand::Trajectory(points, end) => list(points.len(), "trajectory", *end),
    }
}
