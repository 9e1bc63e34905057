//! Interface of a board, and boards in this process.
//!
//! Each tick the simulation hands a board the messages that arrived and its samples ([`Target::receive`],
//! [`Target::begin`]), then takes its torques and messages ([`Target::finish`]). In between, boards behind links (crate
//! `remote`) work in parallel. The host simulates the bus of all boards, also of those behind links.

pub mod board_record;
pub mod boards;
pub mod host_command;
pub mod in_process;
pub mod losses;

pub use boards::{Boards, Failure, FailureMode};
pub use host_command::HostCommand;
pub use in_process::InProcess;
pub use losses::{Event, EventKind, Losses};

use crate::base::error::Error;
use crate::scenario::own::Own;
use core_algos::bus::{CanFrame, Message};
use core_algos::link::protocol::{Placement, StackUse};
use core_algos::node::board::Samples;
use core_algos::node::lead;
use core_algos::node::robot::RobotConfig;
use core_algos::time::Micros;
use core_algos::topology::{Topology, Wheels};
use serde::Serialize;

/// Torques of a board at a tick, and the lead node's output.
#[derive(Clone, Copy, Debug, Default)]
pub struct Output {
    /// Wheel torques, N m.
    pub torque_nm: Wheels<f32>,
    /// Output of the lead node, given before its epoch ends; `None` at ticks without an output.
    pub lead: Option<lead::Output>,
}

/// Frame or message that a board sends.
#[derive(Clone, Copy, Debug)]
pub enum Outgoing<'a> {
    /// Message that the host encodes.
    Message(&'a Message),
    /// Frame that the board encoded.
    Frame(&'a CanFrame),
}

/// Free room of the lead node's buffers, points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// Free room for points of a path.
    pub path: usize,
    /// Free room for points of a trajectory.
    pub trajectory: usize,
}

/// Reason that a board gave no answer.
#[derive(Debug)]
pub enum Fault {
    /// The board has restarted and lost its state.
    Restarted,
    /// The board does not answer, with the reason.
    Silent(String),
    /// The run cannot continue.
    Fatal(Error),
}

impl From<Error> for Fault {
    fn from(error: Error) -> Self {
        Self::Fatal(error)
    }
}

/// Numbers of frames and losses on the link to a board since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Frames received from the board.
    pub frames: u64,
    /// Requests repeated because the request or its answer was lost or damaged.
    pub lost: u64,
    /// Damaged frames received from the board.
    pub damaged: u64,
}

/// Traffic of the link to one board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardTraffic {
    /// Name of the board.
    pub name: &'static str,
    /// True if the board is fitted and on.
    pub on: bool,
    /// Traffic of the board's link; `None` for a board without a port.
    pub traffic: Option<Traffic>,
}

/// Build, traffic and stack use of a board in a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TargetReport {
    /// Name of the board.
    pub role: &'static str,
    /// Place where the nodes run.
    pub target: &'static str,
    /// Commit that the image was built from; for a board in this process the version of the program.
    pub build: String,
    /// Frames received from the board.
    pub frames: u64,
    /// Requests repeated because the request or its answer was lost or damaged.
    pub lost: u64,
    /// Damaged frames received from the board.
    pub damaged: u64,
    /// Bytes sent to the board at ticks, on average.
    pub sent_per_tick: f64,
    /// Bytes received from the board at ticks, on average.
    pub received_per_tick: f64,
    /// Time from sending a tick to the board until its answer; `None` without a link.
    pub latency: Option<Latency>,
    /// Largest stack use since the latest start of the board; `None` if not measured.
    pub stack: Option<StackUse>,
}

impl TargetReport {
    /// Violation of the stack budget; `None` if there is none.
    pub fn stack_excess(&self) -> Option<String> {
        let stack = self.stack.filter(StackUse::is_beyond)?;
        Some(format!(
            "{} board: its stack took {} bytes: must be at most its budget of {} bytes (memory.x)",
            self.role, stack.used_bytes, stack.budget_bytes
        ))
    }
}

/// Mean, percentiles and maximum of latencies.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Latency {
    /// Mean latency, µs.
    pub mean_us: f64,
    /// Median latency, µs.
    pub median_us: u32,
    /// 99th percentile of the latency, µs.
    pub p99_us: u32,
    /// Largest latency, µs.
    pub max_us: u32,
}

impl Latency {
    /// Statistics of the latencies `times_us`; `None` without a latency.
    pub fn of(times_us: &[u32]) -> Option<Self> {
        let mut sorted = times_us.to_vec();
        sorted.sort_unstable();
        let at = |share: f64| {
            let place = share * sorted.len().saturating_sub(1) as f64;
            sorted.get(place.round() as usize).copied()
        };
        Some(Self {
            mean_us: times_us.iter().map(|&t| f64::from(t)).sum::<f64>() / times_us.len() as f64,
            median_us: at(0.5)?,
            p99_us: at(0.99)?,
            max_us: at(1.0)?,
        })
    }
}

/// Board, in this process or behind a link.
pub trait Target: Send {
    /// Starts the nodes with these parameters; `tick` is their first tick, ms. `place` is the initial posture of the
    /// lead node; without `place` the posture is unknown.
    fn start(
        &mut self,
        config: &RobotConfig,
        tick: u32,
        place: Option<&Placement>,
    ) -> Result<(), Fault>;

    /// Sends a command to the lead node; for the front board only.
    fn command(&mut self, command: &HostCommand) -> Result<(), Fault>;

    /// Free room of the lead node's buffers at the end of an epoch; for the front board only.
    fn room(&mut self) -> Room;

    /// Delivers a message that arrived at `now`.
    fn receive(&mut self, now: Micros, frame: &CanFrame, message: &Message);

    /// Sends the samples of the board's sensors at `tick`, ms, which begins the tick.
    fn begin(&mut self, tick: u32, samples: &Samples) -> Result<(), Fault>;

    /// Ends the tick: returns the board's output and passes its messages to `send` in order.
    fn finish(&mut self, send: &mut dyn FnMut(Outgoing)) -> Result<Output, Fault>;

    /// Sets the number of the next tick (ms) of a board after a gap in its ticks.
    fn resume(&mut self, _tick: u32) -> Result<(), Fault> {
        Ok(())
    }

    /// Stops the board's processor or lets it continue; no effect on a board in this process.
    fn halt(&mut self, _halted: bool) -> Result<(), Error> {
        Ok(())
    }

    /// Ends the board without an announcement, as a failure of the board would.
    fn crash(&mut self) -> Result<(), Error> {
        self.switch_off()
    }

    /// Switches the board off.
    fn switch_off(&mut self) -> Result<(), Error>;

    /// Switches the board on; [`Self::start`] must follow.
    fn switch_on(&mut self) -> Result<(), Error>;

    /// Largest stack use since the start; `None` if not measured or without an answer.
    fn stack(&mut self) -> Option<StackUse> {
        None
    }

    /// Traffic of the board's link; `None` without a link.
    fn traffic(&self) -> Option<Traffic> {
        None
    }

    /// Build, traffic and stack use of the board, without a request to the board.
    fn report(&self) -> TargetReport;
}

/// Boards of a robot that all run in this process.
pub fn in_process(topology: Topology) -> Vec<Box<dyn Target>> {
    in_process_with(topology, &Own::default())
}

/// All boards of a robot, in this process, with parts of the user.
pub fn in_process_with(topology: Topology, own: &Own) -> Vec<Box<dyn Target>> {
    let target = |role| Box::new(InProcess::with_own(topology, role, own)) as Box<dyn Target>;
    topology.boards().map(target).collect()
}
