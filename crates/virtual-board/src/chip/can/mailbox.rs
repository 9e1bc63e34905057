//! Transmit mailboxes.

use crate::wire::{Frame, Id};

// Bits of TSR for mailbox 0; the bits of each next mailbox are 8 positions higher.
bits! { pub(super):
    RQCP 0, TXOK 1, ALST 2, TERR 3, ABRQ 7
}

/// Bits of TIxR: transmit request, remote frame, extended identifier.
pub(super) const TXRQ: u32 = 1;
const RTR: u32 = 1 << 1;
const IDE: u32 = 1 << 2;

#[derive(Clone, Debug, Default)]
pub(super) struct Mailbox {
    /// Registers TIxR, TDTxR, TDLxR, TDHxR.
    pub words: [u32; 4],
    /// Flags RQCP, TXOK, ALST, TERR, ABRQ.
    pub flags: u32,
}

impl Mailbox {
    /// True while the mailbox waits or is being transmitted.
    pub fn is_pending(&self) -> bool {
        self.words[0] & TXRQ != 0
    }

    pub fn frame(&self) -> Frame {
        let [id, control, low, high] = self.words;
        let data = (u64::from(high) << 32 | u64::from(low)).to_le_bytes();
        let identifier = if id & IDE != 0 {
            Id::Extended(id >> 3)
        } else {
            Id::Standard((id >> 21) as u16)
        };
        Frame::raw(identifier, id & RTR != 0, (control & 15) as u8, data)
    }

    /// Empties the mailbox. `flags` is the result of the last attempt, or 0 without an attempt.
    pub fn complete(&mut self, flags: u32) {
        self.words[0] &= !TXRQ;
        let kept = if flags == 0 { ALST | TERR } else { 0 };
        self.flags = self.flags & kept | RQCP | flags;
    }
}

/// Bits of TSR for all mailboxes.
pub(super) fn status(mailboxes: &[Mailbox; 3]) -> u32 {
    let mut status = 0;
    for (k, mailbox) in mailboxes.iter().enumerate() {
        status |= mailbox.flags << (8 * k);
        status |= u32::from(!mailbox.is_pending()) << (26 + k);
    }
    let waiting = mailboxes.iter().enumerate().filter(|(_, m)| m.is_pending());
    let last = waiting.max_by_key(|(k, m)| (m.frame().priority(), *k));
    let free = mailboxes.iter().position(|m| !m.is_pending());
    let pending = mailboxes.iter().filter(|m| m.is_pending()).count();
    if let Some((last, _)) = last
        && pending > 1
    {
        status |= 1 << (29 + last);
    }
    let code = free.or(last.map(|(k, _)| k)).unwrap_or(0);
    status | (code as u32) << 24
}
