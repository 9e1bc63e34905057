//! Interface of a board, and boards in this process.
//!
//! Each tick the simulation hands a board the messages that arrived and its samples ([`Target::receive`],
//! [`Target::begin`]), then takes its torques and messages ([`Target::finish`]). Boards behind links (crate `remote`) work
//! at the same time in between. The bus is simulated here, wherever the boards are.

pub mod board_record;
pub mod boards;
pub mod host_command;
pub mod in_process;
pub mod losses;

pub use boards::{Boards, Failure, FailureMode};
pub use host_command::HostCommand;
pub use in_process::InProcess;
pub use losses::{Event, Losses, What};

use crate::base::error::Error;
use core_algos::bus::{CanFrame, Message};
use core_algos::link::protocol::{Place, StackUse};
use core_algos::node::board::Samples;
use core_algos::node::lead;
use core_algos::node::robot::RobotConfig;
use core_algos::time::Micros;
use core_algos::topology::{Topology, Wheels};
use serde::Serialize;

/// Output of a board at a tick.
#[derive(Clone, Copy, Debug, Default)]
pub struct Output {
    /// Wheel torques, N m.
    pub torque_nm: Wheels<f32>,
    /// Latest output of the lead node; known before the end of the epoch.
    pub lead: Option<lead::Output>,
}

/// Frame or message that a board sends.
#[derive(Clone, Copy, Debug)]
pub enum Posted<'a> {
    /// A message still to be encoded.
    Message(&'a Message),
    /// Frame that the board encoded.
    Frame(&'a CanFrame),
}

/// Points the lead node has room for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// Of a path.
    pub path: usize,
    /// Of a trajectory.
    pub trajectory: usize,
}

/// Why a board gave no answer.
#[derive(Debug)]
pub enum Fault {
    /// It has been restarted and knows nothing.
    Restarted,
    /// It does not answer, and why.
    Silent(String),
    /// The run cannot go on.
    Fatal(Error),
}

impl From<Error> for Fault {
    fn from(error: Error) -> Self {
        Self::Fatal(error)
    }
}

/// Traffic of the link to a board so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Frames received from the board.
    pub frames: u64,
    /// Requests that had to be repeated because they, or their answers, were lost or damaged.
    pub lost: u64,
    /// Damaged frames received from the board.
    pub damaged: u64,
}

/// The link to one of a robot's boards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardTraffic {
    /// Name of the board.
    pub name: &'static str,
    /// True if the board is fitted and on.
    pub on: bool,
    /// Traffic of its link; `None` for a board without a port.
    pub traffic: Option<Traffic>,
}

/// Report of a board after a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Board.
    pub role: &'static str,
    /// Place of its nodes.
    pub target: &'static str,
    /// Commit that its image was built from.
    pub build: String,
    /// Frames received from the board.
    pub frames: u64,
    /// Requests that had to be repeated because they, or their answers, were lost or damaged.
    pub lost: u64,
    /// Damaged frames received from the board.
    pub damaged: u64,
    /// Bytes sent to the board at ticks, on average.
    pub sent_per_tick: f64,
    /// Bytes received from the board at ticks, on average.
    pub received_per_tick: f64,
    /// From sending a tick to its answer.
    pub latency: Option<Latency>,
    /// Largest stack use since its latest start; `None` if not measured.
    pub stack: Option<StackUse>,
}

impl Report {
    /// Violation of the stack budget, if any.
    pub fn stack_excess(&self) -> Option<String> {
        let stack = self.stack.filter(StackUse::is_beyond)?;
        Some(format!(
            "{} board: its stack took {} bytes: must be at most its budget of {} bytes (memory.x)",
            self.role, stack.used_bytes, stack.budget_bytes
        ))
    }
}

/// Distribution of times.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Latency {
    /// Mean, µs.
    pub mean_us: f64,
    /// Half of them are no longer, µs.
    pub median_us: u32,
    /// 99 of 100 are no longer, µs.
    pub p99_us: u32,
    /// The longest, µs.
    pub max_us: u32,
}

impl Latency {
    /// The distribution; none of no times.
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

/// A board, wherever it runs.
pub trait Target: Send {
    /// Starts the nodes afresh with these parameters; `tick` will be the first, ms. The lead node
    /// begins at `place`, or does not know where it is.
    fn start(
        &mut self,
        config: &RobotConfig,
        tick: u32,
        place: Option<&Place>,
    ) -> Result<(), Fault>;

    /// Tells the lead node something; for the front board only.
    fn command(&mut self, command: &HostCommand) -> Result<(), Fault>;

    /// Room in the lead node's buffers at the end of an epoch; for the front board only.
    fn room(&mut self) -> Room;

    /// A message that arrived at `now`.
    fn receive(&mut self, now: Micros, frame: &CanFrame, message: &Message);

    /// Hands over the samples of a tick, ms.
    fn begin(&mut self, tick: u32, samples: &Samples) -> Result<(), Fault>;

    /// Takes what the board did at that tick; its messages go to `post` in order.
    fn finish(&mut self, post: &mut dyn FnMut(Posted)) -> Result<Output, Fault>;

    /// The board stood still; its next tick will be this one, ms.
    fn resume(&mut self, _tick: u32) -> Result<(), Fault> {
        Ok(())
    }

    /// Stops the board's processor, or lets it go on; one in this process has none of its own.
    fn halt(&mut self, _halted: bool) -> Result<(), Error> {
        Ok(())
    }

    /// Ends the board as if it had failed by itself.
    fn crash(&mut self) -> Result<(), Error> {
        self.kill()
    }

    /// Switches the board off.
    fn kill(&mut self) -> Result<(), Error>;

    /// Switches the board on again; it is to be started then.
    fn revive(&mut self) -> Result<(), Error>;

    /// Largest stack use so far; `None` if not measured or without an answer.
    fn stack(&mut self) -> Option<StackUse> {
        None
    }

    /// Traffic of its link so far, if it has a link.
    fn traffic(&self) -> Option<Traffic> {
        None
    }

    /// Report without a request to the board.
    fn report(&self) -> Report;
}

/// The boards of a robot: all in this process.
pub fn in_process(topology: Topology) -> Vec<Box<dyn Target>> {
    let target = |role| Box::new(InProcess::new(topology, role)) as Box<dyn Target>;
    topology.boards().map(target).collect()
}
