//! What became of a node's frames.

use super::node::ErrorKind;

/// Counts of one node since the beginning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Frames sent and acknowledged.
    pub sent: u64,
    /// Frames received without error.
    pub received: u64,
    /// Frames given up before they were sent.
    pub given_up: u64,
    /// Arbitrations lost; the frame goes later.
    pub arbitrations_lost: u64,
    /// Errors by kind, in the order of [`ErrorKind::ALL`].
    pub errors: [u64; 6],
    /// Error flags sent, active ones and passive ones.
    pub active_flags: u64,
    /// Passive error flags.
    pub passive_flags: u64,
    /// Overload flags sent.
    pub overloads: u64,
    /// How often it went off the bus.
    pub bus_offs: u64,
}

impl Statistics {
    /// Error frames begun.
    pub fn error_frames(&self) -> u64 {
        self.active_flags + self.passive_flags
    }

    /// Errors of a kind.
    pub fn errors_of(&self, kind: ErrorKind) -> u64 {
        self.errors[kind as usize]
    }
}
