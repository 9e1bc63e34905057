//! Identity message of the board: hashes of the chip number, the image and the message layout.

use core_algos::bus::Message;
use core_algos::bus::field::Hash24;
use core_algos::bus::layout::schema;
use core_algos::topology::Role;

use crate::timing::Every;

/// Health reports per identity message; 10 are one second.
const EVERY: u8 = 10;

/// Composes the board's identity messages.
pub struct Identity {
    chip: Hash24,
    build: Hash24,
    schema: u8,
    every: Every,
}

impl Identity {
    /// Identity of the chip with this number and the image named `build`.
    pub fn new(chip: &[u8; 12], build: &str) -> Self {
        Self {
            chip: Hash24::of(chip),
            build: Hash24::of_build(build),
            schema: schema(),
            every: Every::new(EVERY),
        }
    }

    /// Returns the identity message once a second, `None` otherwise; call it with each health report.
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
