//! Requests of the host and replies of the board. A payload is a number and a [`Request`] or [`Reply`], encoded by
//! postcard.
//!
//! [`Request::Hello`] and [`Reply::Hello`] are the first variants and never change, so that sides of different versions
//! detect the mismatch.

use super::framing::{Counters, MAX_PAYLOAD, SerialFrame};
use super::lease::Stamp;
use super::order::Order;
pub use super::order::{POINTS, Placement};
use crate::bus;
use crate::control::path::PathError;
use crate::node::lead::{self, LeadNode};
use crate::node::outbox;
use crate::node::{axle, beam};
use crate::params::Source;
use crate::time::{EPOCH, Micros, TICK, since_epoch_start};
use crate::topology::{Role, Wheels};
use serde::{Deserialize, Serialize};

/// Protocol version; changes with every change of a request, a reply or the configuration.
pub const PROTOCOL: u16 = 14;
/// Largest encoded configuration, bytes.
pub const MAX_CONFIG: usize = 2048;
/// Bytes of a configuration in one request.
pub const CONFIG_CHUNK: usize = 200;
/// Bytes of the lead node's output in one reply. An output is spread over the replies of several ticks, so that replies
/// have similar lengths. Of a robot with many axles the lead node's step is late in the epoch, and the parts are longer.
pub const TELEMETRY_CHUNK: usize = 40;
/// Largest encoded output of the lead node, bytes; sent completely before the epoch ends.
pub const MAX_TELEMETRY: usize = 7 * TELEMETRY_CHUNK;
/// Largest number of bus frames in a request. More frames of a tick are sent ahead by [`Request::Frames`].
pub const MAX_BUS_FRAMES: usize = 21;
/// Bytes of the longest reply to a tick without its bus frames and its part of the lead node's output.
pub const TICK_REPLY_HEAD: usize = 16;
/// Largest number of bus frames in a reply: the capacity of the outbox.
pub const MAX_SENT_FRAMES: usize = outbox::CAPACITY;

/// Request from the host to the board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request<'a> {
    /// Begins a session. The board stops its nodes and discards the received configuration. The parameters that it
    /// keeps remain. A driving board only identifies itself.
    Hello {
        /// Protocol version of the host.
        protocol: u16,
        /// Returned in the reply, so that the reply to an earlier hello is not mistaken for it.
        nonce: u32,
    },
    /// Asks a driving board for a session with a rig: the board answers and resets. Its motors must be off.
    Rig,
    /// Ends the session: the board answers and resets.
    EndSession,
    /// A part of the encoded [`crate::node::robot::RobotConfig`].
    Configure {
        /// Length of the encoded configuration, bytes.
        total: u16,
        /// Offset of this part, bytes.
        offset: u16,
        /// Bytes of this part.
        bytes: &'a [u8],
    },
    /// Builds the nodes from the received configuration.
    Start {
        /// CRC-32C of the encoded configuration.
        hash: u32,
        /// First tick of the nodes, ms.
        tick: u32,
        /// Start posture of the robot, for the lead node.
        place: Option<Placement>,
    },
    /// Order for the lead node. A driving board takes orders only from the host that holds its lease.
    Order {
        /// Sender and sequence number of the order.
        stamp: Stamp,
        /// The order.
        order: Order,
    },
    /// Takes or renews the lease of a driving board.
    Keep(Stamp),
    /// Ends the lease.
    Release(Stamp),
    /// One tick of an axle board.
    Axle {
        /// Time of the tick, ms.
        tick: u32,
        /// Readings of its sensors.
        samples: axle::Samples,
        /// Bus frames that arrived, see [`Packed`].
        bus: &'a [u8],
    },
    /// One tick of a beam board.
    Beam {
        /// Time of the tick, ms.
        tick: u32,
        /// Readings of its sensors.
        samples: beam::Samples,
    },
    /// Skips ticks: time has passed without the board.
    Resume {
        /// Next tick, ms; not one that was already carried out.
        tick: u32,
    },
    /// Asks for [`Reply::Stack`].
    Stack,
    /// Asks for [`Reply::Parameters`]. The parameters that a board keeps are the stored values and later changes by
    /// [`Self::SetParameter`]. In a session the nodes use only the configuration sent by [`Self::Configure`]: a host
    /// that wants the kept parameters reads them and sends them.
    Parameters,
    /// Asks for [`Reply::Parameter`].
    Parameter {
        /// Index in [`crate::params::TABLE`].
        index: u8,
    },
    /// Sets a parameter. A reset discards the value unless [`Self::SaveParameters`] stored it. Motors must be off.
    SetParameter {
        /// Index in [`crate::params::TABLE`].
        index: u8,
        /// New value of the parameter.
        value: f32,
    },
    /// Writes changed parameters to the store. Motors must be off.
    SaveParameters,
    /// Requests [`Reply::Report`] from a driving board, repeatedly until its reset.
    Watch,
    /// Requests that a driving board forward a request to another board over the bus.
    Relay {
        /// Board that receives the request.
        role: Role,
        /// Number and request, encoded as for a direct link.
        payload: &'a [u8],
    },
    /// Requests that a driving board send a message of [`crate::topology::Node::Service`] on the bus.
    Send {
        /// The frame, see [`Packed`].
        bus: &'a [u8],
    },
    /// Asks a driving board for [`Reply::Crash`].
    Crash,
    /// Asks a driving board for [`Reply::Configuration`].
    Configuration {
        /// Offset of the requested part, bytes.
        offset: u16,
    },
    /// Restarts the nodes of a driving board, so that its reports hold all inputs of a replay, see [`super::record`].
    /// The motors must be off. The front board requires the lease.
    Record(Stamp),
    /// Bus frames for the next tick of an axle board that do not fit the tick's request. The nodes receive them first.
    Frames {
        /// Time of the next tick, ms.
        tick: u32,
        /// Bus frames that arrived, see [`Packed`].
        bus: &'a [u8],
    },
}

/// Reply of the board to the host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply<'a> {
    /// Identity of the board.
    Hello {
        /// Protocol version of the board.
        protocol: u16,
        /// Nonce of the request.
        nonce: u32,
        /// Role of the board.
        role: Role,
        /// Build identification.
        build: &'a str,
        /// Frames received since the start of the board.
        counters: Counters,
        /// True in a session; false on a driving board, which needs [`Request::Rig`] first.
        session: bool,
    },
    /// The request was carried out.
    Done,
    /// The part of the configuration was received.
    Configured {
        /// CRC-32C of the parts received so far.
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
        /// Bus frames sent, see [`Packed`].
        bus: &'a [u8],
        /// Next part of the lead node's output.
        telemetry: &'a [u8],
    },
    /// Output of a beam board.
    Beam {
        /// Messages that could not be encoded at this tick.
        refused: u8,
        /// Bus frames sent, see [`Packed`].
        bus: &'a [u8],
    },
    /// The request was not carried out.
    Refused(Refusal<'a>),
    /// Stack use of the board.
    Stack(StackUse),
    /// Summary of the parameters that the board keeps.
    Parameters {
        /// Hash of the parameter table, see [`crate::params::fingerprint`].
        table: u32,
        /// Number of parameters.
        count: u8,
        /// True if the stored parameters were rejected as a set; the board then uses none of them.
        unusable: bool,
    },
    /// A parameter that the board keeps.
    Parameter {
        /// Present value of the parameter.
        value: f32,
        /// Source of the value at the board's start, or at the latest save.
        source: Source,
        /// True if the value would remain after a reset.
        saved: bool,
    },
    /// The parameters are stored.
    Saved {
        /// Number of values written.
        values: u8,
    },
    /// Report after [`Request::Watch`]: inputs and outputs of the board's nodes, and the lead node's output.
    Report {
        /// Sequence number of the report.
        sequence: u16,
        /// Number of recorded events lost for lack of room since the watch began.
        lost: u16,
        /// Recorded events, none of them cut, see [`super::record`].
        entries: &'a [u8],
        /// Offset of `telemetry` in the output, bytes.
        offset: u16,
        /// Next part of the lead node's output, see [`Spread`].
        telemetry: &'a [u8],
    },
    /// Reply of another board to [`Request::Relay`], with the number of that reply.
    Relayed {
        /// Number and reply.
        payload: &'a [u8],
    },
    /// Numbers of faults since power-on, and the latest message.
    Crash {
        /// Numbers of panics, processor faults, watchdog resets and stack overflows.
        counts: [u32; 4],
        /// Message of the fault that caused the latest start; empty if none did.
        message: &'a str,
    },
    /// A part of the encoded [`crate::node::robot::RobotConfig`] of the nodes.
    Configuration {
        /// Length of the encoded configuration, bytes.
        total: u16,
        /// Bytes of this part.
        bytes: &'a [u8],
    },
}

/// Crash record of a board, the content of [`Reply::Crash`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CrashRecord {
    /// Numbers of panics, processor faults, watchdog resets and stack overflows.
    pub counts: [u32; 4],
    /// Message of the fault that caused the latest start; empty if none did.
    pub message: heapless::String<160>,
}

/// Stack use of a board since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StackUse {
    /// Largest use so far.
    pub used_bytes: u32,
    /// Limit of the use.
    pub budget_bytes: u32,
    /// Size of the stack; 0 if the stack is not measured.
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

    /// True if the measured use exceeds the budget.
    pub fn is_beyond(&self) -> bool {
        self.size_bytes > 0 && self.used_bytes > self.budget_bytes
    }
}

/// Reason for which the board refuses a request.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Refusal<'a> {
    /// No session of this protocol version: the host must send a hello first, also after a restart of the board.
    NoSession,
    /// The payload is no request of this version, or none that this state of the board allows.
    Malformed,
    /// The request is for another kind of board.
    OtherBoard {
        /// Role of this board.
        role: Role,
    },
    /// A part of the configuration does not follow the previous part, or the configuration is too long.
    Part {
        /// Bytes received so far.
        received: u16,
    },
    /// The configuration is incomplete, or its checksum differs.
    Hash {
        /// CRC-32C of the received configuration.
        found: u32,
    },
    /// The configuration cannot be decoded.
    Undecodable,
    /// A parameter is out of range.
    Parameter {
        /// Name of the parameter, value and allowed range.
        text: &'a str,
    },
    /// The nodes have not been started.
    NotStarted,
    /// A tick was skipped or repeated.
    Tick {
        /// Expected tick, ms.
        expected: u32,
    },
    /// The lead node refused the order: a point, posture, goal, tolerance, speed or curvature is invalid.
    Point(PathError),
    /// Motors may be on. [`Request::Rig`] and [`Request::Record`] require motors off; [`Order::SetPose`] and changed or
    /// saved parameters require nodes not started or an axle without torque.
    Armed,
    /// No parameter has this index.
    Index {
        /// Number of parameters.
        count: u8,
    },
    /// Writing the store failed, or the values read back differ.
    NotSaved,
    /// Another host commands the robot.
    Leased,
    /// The sequence number of the order is not newer than the latest one.
    OldOrder,
}

/// Output of the lead node, and the room in its buffers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// Output of the lead node's step.
    pub output: lead::Output,
    /// Time of the step, ms.
    pub tick: u32,
    /// Number of points that can still be appended to the path.
    pub path_room: u16,
    /// Number of points that can still be appended to the trajectory.
    pub trajectory_room: u16,
}

impl Telemetry {
    /// Output of a step of the lead node at `now`, with the room in its buffers.
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

/// Encoded output of the lead node, sent in parts, one per reply. The first two bytes are the length.
#[derive(Clone, Debug, Default)]
pub struct Spread {
    bytes: heapless::Vec<u8, MAX_TELEMETRY>,
    sent: usize,
}

impl Spread {
    /// Replaces the output; the rest of the previous output is not sent.
    pub fn fill(&mut self, telemetry: &Telemetry) {
        let mut encoded = [0; MAX_TELEMETRY - 2];
        // The largest output fits. If an output did not fit, a length of 0 would be sent.
        let encoded = postcard::to_slice(telemetry, &mut encoded).map_or(&[][..], |used| used);
        self.bytes.clear();
        let length = (encoded.len() as u16).to_le_bytes();
        for part in [&length[..], encoded] {
            let _ = self.bytes.extend_from_slice(part);
        }
        self.sent = 0;
    }

    /// Next part of the encoded output, at most `most` bytes.
    pub fn next(&mut self, most: usize) -> &[u8] {
        let end = self.bytes.len().min(self.sent + most);
        let part = self.bytes.get(self.sent..end).unwrap_or_default();
        self.sent = end;
        part
    }

    /// Number of bytes of a part that are sent at `now`, so that the rest of the output is sent before the epoch ends:
    /// [`TELEMETRY_CHUNK`] if that suffices.
    pub fn chunk(&self, now: Micros) -> usize {
        let ticks = (EPOCH - since_epoch_start(now)) / TICK;
        TELEMETRY_CHUNK.max(self.left().div_ceil(ticks as usize))
    }

    /// Number of bytes of the encoded output that were sent.
    pub fn sent(&self) -> usize {
        self.sent
    }

    /// Number of bytes of the encoded output left to send.
    pub fn left(&self) -> usize {
        self.bytes.len() - self.sent
    }
}

/// The frame of a numbered message; `None` if the payload would be longer than [`MAX_PAYLOAD`].
pub fn encode<T: Serialize>(number: u8, message: &T) -> Option<SerialFrame> {
    let mut payload = [0; MAX_PAYLOAD];
    let used = postcard::to_slice(&(number, message), &mut payload).ok()?;
    SerialFrame::new(used)
}

/// Number and message of a payload; `None` unless the payload is exactly one message of this version.
pub fn decode<'a, T: Deserialize<'a>>(payload: &'a [u8]) -> Option<(u8, T)> {
    match postcard::take_from_bytes(payload) {
        Ok((message, [])) => Some(message),
        _ => None,
    }
}

/// Packed bus frames: for each frame two bytes of identifier and length, then the data.
#[derive(Clone, Debug, Default)]
pub struct Packed(heapless::Vec<u8, { 10 * MAX_BUS_FRAMES }>);

impl Packed {
    /// Packed bytes without a frame.
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

    /// The packed bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }
}

/// Frames in packed bytes; ends at a truncated frame.
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
