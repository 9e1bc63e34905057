//! Requests of a host and replies of a board: each payload is a number and a [`Request`] or [`Reply`]
//! as postcard.
//!
//! [`Request::Hello`] and [`Reply::Hello`] are the first variants and stay as they are in every
//! version, so that two sides of different versions can tell.

use super::framing::{Counters, MAX_PAYLOAD, SerialFrame};
use super::lease::Stamp;
use super::order::Order;
pub use super::order::{POINTS, Place};
use crate::bus;
use crate::control::path::PathError;
use crate::node::lead::{self, LeadNode};
use crate::node::outbox;
use crate::node::{axle, beam};
use crate::params::Source;
use crate::time::{Micros, TICK};
use crate::topology::{Role, Wheels};
use serde::{Deserialize, Serialize};

/// Version of the protocol: changes with every change of what is said, or of a configuration.
pub const PROTOCOL: u16 = 13;
/// Largest encoded configuration, bytes.
pub const MAX_CONFIG: usize = 2048;
/// Bytes of a configuration in one request.
pub const CONFIG_CHUNK: usize = 200;
/// Bytes of the lead node's output that go with one reply. It is spread over the ticks that follow
/// the lead node's, so that no reply is much longer than another.
pub const TELEMETRY_CHUNK: usize = 40;
/// Largest encoded output of the lead node: all of it before the epoch ends.
pub const MAX_TELEMETRY: usize = 7 * TELEMETRY_CHUNK;
/// Largest number of bus frames in a request.
pub const MAX_BUS_FRAMES: usize = 21;
/// Largest number of bus frames in a reply: a board sends no more than its outbox holds.
pub const MAX_SENT_FRAMES: usize = outbox::CAPACITY;

/// From host to board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request<'a> {
    /// Begins a session. The board stops what it did and forgets the configuration it was sent, but
    /// not the parameters that it keeps.
    Hello {
        /// Version the host speaks.
        protocol: u16,
        /// Comes back in the reply, so that the reply to an earlier hello is not taken for it.
        nonce: u32,
    },
    /// Asks a board that drives for a session with a rig: it answers and resets into one. Its motors must be off.
    Rig,
    /// Ends the session: the board answers and resets.
    Leave,
    /// A part of the encoded [`crate::node::robot::RobotConfig`].
    Configure {
        /// Bytes of the whole.
        total: u16,
        /// Place of the first byte of this part.
        offset: u16,
        /// The part.
        bytes: &'a [u8],
    },
    /// Builds the nodes from the parameters.
    Start {
        /// CRC-32C of the encoded parameters.
        hash: u32,
        /// The first tick that will come, ms.
        tick: u32,
        /// Start posture of the robot, for the lead node.
        place: Option<Place>,
    },
    /// Gives the lead node an order. A board that drives takes it from the host that holds its lease.
    Order {
        /// Sender and place of the order.
        stamp: Stamp,
        /// The order.
        order: Order,
    },
    /// Takes or renews the lease of a board that drives.
    Keep(Stamp),
    /// Ends the lease.
    Release(Stamp),
    /// One tick of an axle board.
    Axle {
        /// Time, ms.
        tick: u32,
        /// Readings of its sensors.
        samples: axle::Samples,
        /// Bus frames that arrived, see [`Packed`].
        bus: &'a [u8],
    },
    /// One tick of a beam board.
    Beam {
        /// Time, ms.
        tick: u32,
        /// Readings of its sensors.
        samples: beam::Samples,
    },
    /// The board stood still, and goes on with this tick: time has passed without it.
    Resume {
        /// The tick that will come next, ms; none that was already carried out.
        tick: u32,
    },
    /// Asks for [`Reply::Stack`].
    Stack,
    /// Asks for [`Reply::Parameters`]. The parameters that a board keeps are those of its store, and
    /// what [`Self::SetParameter`] changed since. Its nodes run with what [`Self::Configure`] sent
    /// and nothing else: a host that wants the kept ones asks for them and sends them.
    Parameters,
    /// Asks for [`Reply::Parameter`].
    Parameter {
        /// Place in [`crate::params::TABLE`].
        index: u8,
    },
    /// Gives a parameter another value, until the board is reset or [`Self::SaveParameters`]. Motors
    /// must be off.
    SetParameter {
        /// Place in the table.
        index: u8,
        /// The value.
        value: f32,
    },
    /// Writes what has changed to the store. Motors must be off.
    SaveParameters,
    /// Has a board that drives send [`Reply::Report`] unasked, until it is reset.
    Watch,
    /// Has a board that drives send a request to another board, over the bus.
    Relay {
        /// The other board.
        role: Role,
        /// Number and request, as for a port of its own.
        payload: &'a [u8],
    },
    /// Has a board that drives send a message of [`crate::topology::Node::Service`] on the bus.
    Send {
        /// The frame, see [`Packed`].
        bus: &'a [u8],
    },
    /// Asks a board that drives for [`Reply::Crash`].
    Crash,
    /// Asks a board that drives for [`Reply::Configuration`].
    Configuration {
        /// Place of the first byte.
        offset: u16,
    },
    /// Has the nodes of a board that drives begin anew, and its reports hold all that replay needs: see
    /// [`super::record`]. The motors must be off. The front board takes it from the host that holds its lease.
    Record(Stamp),
}

/// From board to host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply<'a> {
    /// Who the board is.
    Hello {
        /// Version the board speaks.
        protocol: u16,
        /// As in the request.
        nonce: u32,
        /// Board.
        role: Role,
        /// Build identification.
        build: &'a str,
        /// Frames since the board was started.
        counters: Counters,
        /// True in a session with a rig; other requests than [`Request::Rig`] wait for one.
        session: bool,
    },
    /// The request was carried out.
    Done,
    /// CRC-32C of the parameters so far.
    Configured {
        /// The check sum.
        hash: u32,
    },
    /// Output of an axle board.
    Axle {
        /// Wheel torques, N m.
        torque_nm: Wheels<f32>,
        /// True if the axle follows a reference.
        active: bool,
        /// Bus frames that could not be decoded or encoded at this tick.
        refused: u8,
        /// Bus frames that it sends, see [`Packed`].
        bus: &'a [u8],
        /// The next part of the lead node's output.
        telemetry: &'a [u8],
    },
    /// Output of a beam board.
    Beam {
        /// Messages that could not be encoded at this tick.
        refused: u8,
        /// Bus frames that it sends, see [`Packed`].
        bus: &'a [u8],
    },
    /// The request was not carried out.
    Refused(Refusal<'a>),
    /// Stack use of the board.
    Stack(StackUse),
    /// The parameters that the board keeps.
    Parameters {
        /// Hash of its table, see [`crate::params::fingerprint`].
        table: u32,
        /// Number of parameters.
        count: u8,
        /// True if those of its store together made no working node, so that it uses none of them.
        unusable: bool,
    },
    /// One of them.
    Parameter {
        /// The value.
        value: f32,
        /// Source of the value at the board's start, or at the latest save.
        source: Source,
        /// True if the board would have this value after a reset.
        saved: bool,
    },
    /// The store holds them.
    Saved {
        /// Values that were written.
        values: u8,
    },
    /// Answers no request: what the board's nodes got and did, and the lead node's output.
    Report {
        /// Number of the report.
        sequence: u16,
        /// Entries since the start of the watch that found no room.
        lost: u16,
        /// Whole entries, see [`super::record`].
        entries: &'a [u8],
        /// Place of the part in the output.
        offset: u16,
        /// The next part of the lead node's output, see [`Spread`].
        telemetry: &'a [u8],
    },
    /// Reply of another board to [`Request::Relay`]; the number is that of the reply.
    Relayed {
        /// Number and reply.
        payload: &'a [u8],
    },
    /// Faults of the program since power came on.
    Crash {
        /// Panics, faults of the processor, resets by the watchdog, overflows of the stack.
        counts: [u32; 4],
        /// Message of the fault that caused the latest start, if one did.
        message: &'a str,
    },
    /// A part of the encoded [`crate::node::robot::RobotConfig`] of the nodes.
    Configuration {
        /// Bytes of the whole.
        total: u16,
        /// The part.
        bytes: &'a [u8],
    },
}

/// Crash record of a board: what [`Reply::Crash`] holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CrashRecord {
    /// Panics, faults of the processor, resets by the watchdog, overflows of the stack.
    pub counts: [u32; 4],
    /// Message of the fault that caused the latest start; empty if none did.
    pub message: heapless::String<160>,
}

/// Stack use of a board since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StackUse {
    /// Most bytes in use at any time.
    pub used_bytes: u32,
    /// Bytes that it may use.
    pub budget_bytes: u32,
    /// Bytes there are; 0 where the stack is not measured.
    pub size_bytes: u32,
}

impl StackUse {
    /// Value for a stack that is not measured.
    pub const fn unknown() -> Self {
        Self {
            used_bytes: 0,
            budget_bytes: 0,
            size_bytes: 0,
        }
    }

    /// True if it was measured, and more was used than may be.
    pub fn is_beyond(&self) -> bool {
        self.size_bytes > 0 && self.used_bytes > self.budget_bytes
    }
}

/// Why a request was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Refusal<'a> {
    /// There is no session, or it is of another protocol: say hello first. A board that was
    /// restarted answers so.
    NoSession,
    /// The request is none of this version.
    Malformed,
    /// The request is for another kind of board.
    OtherBoard {
        /// Role of this board.
        role: Role,
    },
    /// A part of the parameters does not follow the one before, or they are too long.
    Part {
        /// Bytes received so far.
        received: u16,
    },
    /// The check sum of the parameters is another one.
    Hash {
        /// That of the parameters received.
        found: u32,
    },
    /// The parameters cannot be decoded.
    Undecodable,
    /// A parameter is out of range.
    Parameter {
        /// Name, value and range.
        text: &'a str,
    },
    /// The nodes have not been started.
    NotStarted,
    /// A tick was left out or comes twice.
    Tick {
        /// The tick that was expected, ms.
        expected: u32,
    },
    /// A point of a path or trajectory, a goal or a speed was not taken.
    Point(PathError),
    /// Motors may be on: a session and a record need motors that are off; a new place, and parameters changed or saved,
    /// need nodes that have not been started or an axle that gives no torque.
    Armed,
    /// There is no such parameter.
    Index {
        /// Number of parameters.
        count: u8,
    },
    /// The store could not be written, or did not hold afterwards what was written.
    NotSaved,
    /// Another host commands the robot.
    Leased,
    /// The order is not newer than the latest one.
    OldOrder,
}

/// Output of the lead node, and the room in its buffers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// Its output.
    pub output: lead::Output,
    /// Time of the step, ms.
    pub tick: u32,
    /// Points the path has room for.
    pub path_room: u16,
    /// Points the trajectory has room for.
    pub trajectory_room: u16,
}

impl Telemetry {
    /// Output of a step of the lead node at `now`, with the room it has.
    pub fn of(now: Micros, output: lead::Output, lead: &mut LeadNode) -> Self {
        let path = lead.path_task();
        Self {
            output,
            tick: (now / TICK) as u32,
            path_room: path.path_room() as u16,
            trajectory_room: path.trajectory_room() as u16,
        }
    }
}

/// The lead node's output on its way, a part with each reply. It begins with its length.
#[derive(Clone, Debug, Default)]
pub struct Spread {
    bytes: heapless::Vec<u8, MAX_TELEMETRY>,
    sent: usize,
}

impl Spread {
    /// Puts an output in place of the one before.
    pub fn fill(&mut self, telemetry: &Telemetry) {
        let mut encoded = [0; MAX_TELEMETRY - 2];
        // Its largest size is known to fit; nothing is sent otherwise.
        let encoded = postcard::to_slice(telemetry, &mut encoded).map_or(&[][..], |used| used);
        self.bytes.clear();
        let length = (encoded.len() as u16).to_le_bytes();
        for part in [&length[..], encoded] {
            let _ = self.bytes.extend_from_slice(part);
        }
        self.sent = 0;
    }

    /// The next part, of `most` bytes.
    pub fn next(&mut self, most: usize) -> &[u8] {
        let end = self.bytes.len().min(self.sent + most);
        let part = self.bytes.get(self.sent..end).unwrap_or_default();
        self.sent = end;
        part
    }

    /// Bytes that were sent.
    pub fn sent(&self) -> usize {
        self.sent
    }

    /// Bytes that are left to send.
    pub fn left(&self) -> usize {
        self.bytes.len() - self.sent
    }
}

/// The frame of a numbered message; `None` if it does not fit.
pub fn encode<T: Serialize>(number: u8, message: &T) -> Option<SerialFrame> {
    let mut payload = [0; MAX_PAYLOAD];
    let used = postcard::to_slice(&(number, message), &mut payload).ok()?;
    SerialFrame::new(used)
}

/// Number and message of a payload; `None` if it is none of this version.
pub fn decode<'a, T: Deserialize<'a>>(payload: &'a [u8]) -> Option<(u8, T)> {
    match postcard::take_from_bytes(payload) {
        Ok((message, [])) => Some(message),
        _ => None,
    }
}

/// Bus frames, each as identifier and length in two bytes and then its data.
#[derive(Clone, Debug, Default)]
pub struct Packed(heapless::Vec<u8, { 10 * MAX_BUS_FRAMES }>);

impl Packed {
    /// No frames.
    pub fn new() -> Self {
        Self::default()
    }

    /// Appends a frame; `false` if there is no room.
    pub fn push(&mut self, frame: &bus::CanFrame) -> bool {
        let data = frame.bytes();
        let head = frame.id & 0x7ff | (data.len() as u16) << 12;
        let room = self.0.capacity() - self.0.len() >= 2 + data.len();
        room && self.0.extend_from_slice(&head.to_le_bytes()).is_ok()
            && self.0.extend_from_slice(data).is_ok()
    }

    /// The bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }
}

/// The frames in packed bytes; ends at the first that is cut short.
pub fn unpack(mut bytes: &[u8]) -> impl Iterator<Item = bus::CanFrame> {
    core::iter::from_fn(move || {
        let (head, rest) = bytes.split_at_checked(2)?;
        let head = u16::from_le_bytes([*head.first()?, *head.last()?]);
        let length = head >> 12;
        let (from, rest) = rest.split_at_checked(usize::from(length))?;
        let mut data = [0; 8];
        data.get_mut(..from.len())?.copy_from_slice(from);
        bytes = rest;
        Some(bus::CanFrame {
            id: head & 0x7ff,
            length: length as u8,
            data,
        })
    })
}

#[cfg(test)]
mod tests;
