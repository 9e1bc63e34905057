//! Actions and events exchanged between a wire and its nodes.

use super::frame::Frame;
use super::timing::BitTiming;
use crate::time::Time;

/// Errors that a controller detects on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ErrorKind {
    /// Six equal bits in the stuffed part.
    Stuff,
    /// Wrong level of a bit with fixed level.
    Form,
    /// No node acknowledged the frame.
    Acknowledgement,
    /// A recessive bit was transmitted, a dominant bit was read.
    BitRecessive,
    /// A dominant bit was transmitted, a recessive bit was read.
    BitDominant,
    /// The checksum is wrong.
    Crc,
}

impl ErrorKind {
    /// All kinds, in the order of their indices.
    pub const ALL: [Self; 6] = [
        Self::Stuff,
        Self::Form,
        Self::Acknowledgement,
        Self::BitRecessive,
        Self::BitDominant,
        Self::Crc,
    ];

    /// Name in tables and in JSON.
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

/// Settings of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// True if the controller takes part in the bus.
    pub on: bool,
    /// Bit timing of the controller.
    pub timing: BitTiming,
    /// True if the controller recovers from bus-off automatically.
    pub recover: bool,
    /// True if the controller's output reaches the transceiver.
    pub transmit_enabled: bool,
    /// True if the transceiver's output reaches the controller.
    pub receive_enabled: bool,
}

impl Settings {
    /// Settings of an ordinary controller with this bit timing.
    pub fn new(timing: BitTiming) -> Self {
        Self {
            on: true,
            timing,
            recover: true,
            transmit_enabled: true,
            receive_enabled: true,
        }
    }
}

/// Action of a node, delivered to the wire after the quantum in which it occurred.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Reset: the controller leaves the bus at once and loses all state except the statistics.
    Reset,
    /// Changes the settings. A controller that leaves the bus completes the present frame; a controller that joins
    /// waits for eleven recessive bits.
    Set(Settings),
    /// Requests transmission of a mailbox.
    Request {
        /// Number of the mailbox; of frames with equal identifiers, the frame in the lowest mailbox is sent first.
        mailbox: u8,
        /// Frame to send.
        frame: Frame,
    },
    /// Cancels transmission of a mailbox. A transmission in progress ends first.
    Abort {
        /// Number of the mailbox.
        mailbox: u8,
    },
}

/// Kind of an event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EventKind {
    /// The controller detected eleven recessive bits and takes part from now on.
    Joined,
    /// The controller left the bus, as requested.
    Left,
    /// Transmission of a mailbox began.
    Started {
        /// Number of the mailbox.
        mailbox: u8,
    },
    /// A mailbox was transmitted and acknowledged.
    Sent {
        /// Number of the mailbox.
        mailbox: u8,
        /// Sample point of the start of frame.
        start: Time,
    },
    /// A mailbox lost arbitration or met an error.
    Failed {
        /// Number of the mailbox.
        mailbox: u8,
        /// True if arbitration was lost.
        lost: bool,
        /// True if the transmission will be repeated.
        again: bool,
    },
    /// A frame was received.
    Received {
        /// Received frame.
        frame: Frame,
        /// Sample point of the start of frame.
        start: Time,
    },
    /// An error was detected.
    Error(ErrorKind),
    /// The error counters rose without a newly detected error.
    Counted,
    /// Bus-off: too many errors.
    Off,
    /// The controller recovered from bus-off.
    Recovered,
}

/// An event of a node, with its error counters at that time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// Time of the event.
    pub at: Time,
    /// Kind of the event.
    pub kind: EventKind,
    /// Transmit error counter, up to 255.
    pub tec: u8,
    /// Receive error counter.
    pub rec: u8,
}

/// A controller on the bus.
pub trait Node {
    /// Takes the node's next action, in order of time; `None` if no action is left.
    fn take_action(&mut self) -> Option<(Time, Action)>;
    /// Delivers an event, in order of time. The time of the event may be in the node's future (see
    /// [`Wire`](super::Wire)).
    fn event(&mut self, event: Event);
}
