//! Receive FIFOs of three messages.

use crate::time::{Cycles, NEVER};

/// Number of messages in a FIFO.
const DEPTH: usize = 3;

/// Bits of RFxR: release of the output mailbox, overrun, full.
pub(super) const RFOM: u32 = 1 << 5;
pub(super) const FOVR: u32 = 1 << 4;
pub(super) const FULL: u32 = 1 << 3;

/// Message in the format of the registers RIxR, RDTxR, RDLxR, RDHxR.
pub(super) type Message = [u32; 4];

#[derive(Clone, Debug)]
pub(super) struct Fifo {
    messages: [Message; DEPTH],
    count: usize,
    flags: u32,
    /// Cycle at which the requested release completes.
    pub release: Cycles,
}

impl Default for Fifo {
    fn default() -> Self {
        Self {
            messages: [[0; 4]; DEPTH],
            count: 0,
            flags: 0,
            release: NEVER,
        }
    }
}

impl Fifo {
    /// Value of the register RFxR.
    pub fn status(&self) -> u32 {
        let release = if self.release == NEVER { 0 } else { RFOM };
        self.count as u32 | self.flags | release
    }

    /// A word of the output mailbox.
    pub fn output(&self, word: usize) -> u32 {
        self.messages[0][word]
    }

    /// Writes RFxR; `release` is the cycle at which a release requested now completes.
    pub fn write(&mut self, value: u32, release: Cycles) {
        self.flags &= !value;
        if value & RFOM != 0 && self.count > 0 && self.release == NEVER {
            self.release = release;
        }
    }

    /// Completes the release.
    pub fn released(&mut self) {
        self.release = NEVER;
        if self.count > 0 {
            self.messages.copy_within(1.., 0);
            self.count -= 1;
        }
    }

    /// Stores a received message. True if the FIFO was full: the message then overwrites the newest one.
    pub fn push(&mut self, message: Message) -> bool {
        let full = self.count == DEPTH;
        if !full {
            self.messages[self.count] = message;
            self.count += 1;
            if self.count == DEPTH {
                self.flags |= FULL;
            }
            return false;
        }
        self.flags |= FOVR;
        self.messages[DEPTH - 1] = message;
        true
    }
}
