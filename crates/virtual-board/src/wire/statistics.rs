//! Statistics of a node.

use super::node::ErrorKind;

/// Counts of one node since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Frames transmitted and acknowledged.
    pub sent: u64,
    /// Frames received without error.
    pub received: u64,
    /// Frames cancelled before they were transmitted and acknowledged.
    pub given_up: u64,
    /// Lost arbitrations; the frame is transmitted later.
    pub arbitrations_lost: u64,
    /// Errors by kind, in the order of [`ErrorKind::ALL`].
    pub errors: [u64; 6],
    /// Number of error flags sent.
    pub error_frames: u64,
    /// Number of overload flags sent.
    pub overloads: u64,
    /// Number of transitions to bus-off.
    pub bus_offs: u64,
}

impl Statistics {
    /// Errors of a kind.
    pub fn errors_of(&self, kind: ErrorKind) -> u64 {
        self.errors[kind as usize]
    }
}
