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
    /// Error frames begun.
    pub error_frames: u64,
    /// Overload flags sent.
    pub overloads: u64,
    /// How often it went off the bus.
    pub bus_offs: u64,
}

impl Statistics {
    /// Errors of a kind.
    pub fn errors_of(&self, kind: ErrorKind) -> u64 {
        self.errors[kind as usize]
    }
}
