//! Identity of the board, for the bus: its chip, its image and the image's messages.

use core_algos::bus::Message;
use core_algos::bus::field::Hash24;
use core_algos::bus::layout::schema;
use core_algos::topology::Role;

use crate::timing::Every;

/// Health reports between two messages: a second.
const EVERY: u8 = 10;

/// The board's identity.
pub struct Identity {
    chip: Hash24,
    build: Hash24,
    schema: u8,
    every: Every,
}

impl Identity {
    /// That of the chip with this number, and of the image named `build`.
    pub fn new(chip: &[u8; 12], build: &str) -> Self {
        Self {
            chip: Hash24::of(chip),
            build: Hash24::of_build(build),
            schema: schema(),
            every: Every::new(EVERY),
        }
    }

    /// To be called with each health report: the message, once a second.
    pub fn message(&mut self, board: Role, sequence: u8) -> Option<Message> {
        self.every.tick().then_some(Message::BoardIdentity {
            board,
            sequence,
            chip: self.chip,
            build: self.build,
            schema: self.schema,
        })
    }
}
