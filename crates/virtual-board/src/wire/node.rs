//! What a wire and its nodes tell each other.

use super::frame::Frame;
use super::timing::BitTiming;
use crate::time::Time;

/// Errors that a controller detects on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ErrorKind {
    /// Six equal bits where stuff bits are.
    Stuff,
    /// A bit of fixed level had the other.
    Form,
    /// Nobody acknowledged.
    Acknowledgement,
    /// Sent recessive, read dominant.
    BitRecessive,
    /// Sent dominant, read recessive.
    BitDominant,
    /// The checksum does not fit.
    Crc,
}

impl ErrorKind {
    /// All of them, at their index.
    pub const ALL: [Self; 6] = [
        Self::Stuff,
        Self::Form,
        Self::Acknowledgement,
        Self::BitRecessive,
        Self::BitDominant,
        Self::Crc,
    ];

    /// The name in tables and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Stuff => "stuff",
            Self::Form => "form",
            Self::Acknowledgement => "acknowledgement",
            Self::BitRecessive => "bit recessive",
            Self::BitDominant => "bit dominant",
            Self::Crc => "checksum",
        }
    }
}

/// How a controller takes part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Whether it takes part at all.
    pub on: bool,
    /// Its bit timing.
    pub timing: BitTiming,
    /// It leaves bus-off by itself.
    pub recover: bool,
    /// Its output reaches the transceiver.
    pub sends: bool,
    /// The transceiver's output reaches it.
    pub hears: bool,
}

impl Settings {
    /// An ordinary controller with this bit timing.
    pub fn new(timing: BitTiming) -> Self {
        Self {
            on: true,
            timing,
            recover: true,
            sends: true,
            hears: true,
        }
    }
}

/// What a node does, told to the wire after the quantum in which it did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// The controller is cut from the bus at once and forgets everything: a reset.
    Reset,
    /// The controller takes part in another way. To leave it finishes what goes on; to take part it
    /// waits for eleven recessive bits.
    Set(Settings),
    /// A mailbox is to be sent.
    Request {
        /// Its number; the lowest goes first among equal identifiers.
        mailbox: u8,
        /// The frame.
        frame: Frame,
    },
    /// A mailbox is not to be sent any more. One that is being sent ends first.
    Abort {
        /// Its number.
        mailbox: u8,
    },
}

/// What happens to a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum What {
    /// Eleven recessive bits were seen: it takes part now.
    Joined,
    /// It has left, as it was asked to.
    Left,
    /// The start of frame of a mailbox.
    Started {
        /// The mailbox.
        mailbox: u8,
    },
    /// A mailbox was sent and acknowledged.
    Sent {
        /// The mailbox.
        mailbox: u8,
        /// Sample point of the start of frame.
        start: Time,
    },
    /// A mailbox lost the arbitration or met an error.
    Failed {
        /// The mailbox.
        mailbox: u8,
        /// Lost the arbitration.
        lost: bool,
        /// It is sent again.
        again: bool,
    },
    /// A frame was received.
    Received {
        /// The frame.
        frame: Frame,
        /// Sample point of the start of frame.
        start: Time,
    },
    /// An error was detected.
    Error(ErrorKind),
    /// The counters have changed otherwise.
    Counted,
    /// Too many errors: it is off the bus now.
    Off,
    /// It is back from bus-off.
    Recovered,
}

/// What happens to a node, with its error counters then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// When.
    pub at: Time,
    /// What.
    pub what: What,
    /// Transmit error counter, up to 255.
    pub tec: u8,
    /// Receive error counter.
    pub rec: u8,
}

/// A controller on the wire.
pub trait Node {
    /// The next thing that it did, in order of time, each once.
    fn take_action(&mut self) -> Option<(Time, Action)>;
    /// Something happens to it. Times lie ahead where they can be known ahead (see
    /// [`Wire`](super::Wire)), in order.
    fn event(&mut self, event: Event);
}
