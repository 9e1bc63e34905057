//! Receive FIFOs of three messages.

use crate::time::{Cycles, NEVER};

/// Messages in a FIFO.
const DEPTH: usize = 3;

/// RFxR: release the output mailbox, overrun, full.
pub(super) const RFOM: u32 = 1 << 5;
pub(super) const FOVR: u32 = 1 << 4;
pub(super) const FULL: u32 = 1 << 3;

/// A message as the registers RIxR, RDTxR, RDLxR, RDHxR show it.
pub(super) type Message = [u32; 4];

#[derive(Debug)]
pub(super) struct Fifo {
    messages: [Message; DEPTH],
    count: usize,
    flags: u32,
    /// When the release that was asked for is done.
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
    /// The register RFxR.
    pub fn status(&self) -> u32 {
        let release = if self.release == NEVER { 0 } else { RFOM };
        self.count as u32 | self.flags | release
    }

    /// A word of the output mailbox.
    pub fn output(&self, word: usize) -> u32 {
        self.messages[0][word]
    }

    /// Writes RFxR; `release` is when a release asked for now is done.
    pub fn write(&mut self, value: u32, release: Cycles) {
        self.flags &= !value;
        if value & RFOM != 0 && self.count > 0 && self.release == NEVER {
            self.release = release;
        }
    }

    /// The release is done.
    pub fn released(&mut self) {
        self.release = NEVER;
        if self.count > 0 {
            self.messages.copy_within(1.., 0);
            self.count -= 1;
        }
    }

    /// A message arrives; whether one was lost. `locked`: the new one is, not the last.
    pub fn push(&mut self, message: Message, locked: bool) -> bool {
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
        if !locked {
            self.messages[DEPTH - 1] = message;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn release(fifo: &mut Fifo) -> u32 {
        let first = fifo.output(0);
        fifo.write(RFOM, 10);
        assert_ne!(fifo.status() & RFOM, 0);
        fifo.released();
        first
    }

    #[test]
    fn a_fourth_message_is_an_overrun_and_which_is_lost_is_a_setting() {
        for (locked, last) in [(false, 4), (true, 3)] {
            let mut fifo = Fifo::default();
            for n in 1..=3 {
                assert!(!fifo.push([n, 0, 0, 0], locked));
            }
            assert_eq!(fifo.status(), 3 | FULL);
            assert!(fifo.push([4, 0, 0, 0], locked));
            assert_eq!(fifo.status(), 3 | FULL | FOVR);
            fifo.write(FULL | FOVR, NEVER);
            assert_eq!(fifo.status(), 3);
            let order: Vec<_> = (0..3).map(|_| release(&mut fifo)).collect();
            assert_eq!(order, [1, 2, last]);
            assert_eq!(fifo.status(), 0);
        }
    }
}
