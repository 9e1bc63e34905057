//! Filter banks: which frames go into which FIFO (RM0090, "Identifier filtering").
//!
//! Not modelled: identifier lists and 16-bit filters; the use of these is a finding.

use crate::wire::{Frame, Id};

/// Banks of CAN1 and CAN2 together.
pub(super) const BANKS: usize = 28;
/// Mask of all banks, one bit each.
pub(super) const ALL: u32 = (1 << BANKS) - 1;
/// Bit of FMR: initialisation mode of the filters.
pub(super) const FINIT: u32 = 1;

/// Registers of the filters. In `mode`, `scale`, `assignment` and `active`, bit n belongs to bank n.
#[derive(Clone)]
pub(super) struct Filters {
    pub fmr: u32,
    /// Banks with an identifier list instead of a mask. A list counts in the filter numbers; its matching is not
    /// modelled.
    pub mode: u32,
    /// Banks with one 32-bit filter instead of two 16-bit filters, which are not modelled.
    pub scale: u32,
    /// Banks assigned to FIFO 1 instead of FIFO 0.
    pub assignment: u32,
    pub active: u32,
    pub banks: [[u32; 2]; BANKS],
}

impl Default for Filters {
    fn default() -> Self {
        Self {
            fmr: 0x2a1c_0e01,
            mode: 0,
            scale: 0,
            assignment: 0,
            active: 0,
            banks: [[0; 2]; BANKS],
        }
    }
}

/// Destination of a frame: the FIFO, and the number of the matching filter within the FIFO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Match {
    pub fifo: usize,
    pub index: u8,
}

/// Identifier of a frame in the format of the 32-bit registers: STID, EXID, IDE, RTR.
pub(super) fn wide(frame: &Frame) -> u32 {
    let remote = u32::from(frame.is_remote()) << 1;
    match frame.id() {
        Id::Standard(id) => u32::from(id) << 21 | remote,
        Id::Extended(id) => id << 3 | 1 << 2 | remote,
    }
}

impl Filters {
    /// True if an active bank is not a single 32-bit mask.
    pub fn are_unknown(&self) -> bool {
        self.fmr & FINIT == 0 && self.active & (self.mode | !self.scale) != 0
    }

    /// Destination of a frame, from the first matching bank; `None` if no bank matches, or in initialisation mode.
    pub fn find(&self, frame: &Frame) -> Option<Match> {
        if self.fmr & FINIT != 0 {
            return None;
        }
        let id = wide(frame);
        let mut numbers = [0u8; 2];
        // Banks from CAN2SB on belong to CAN2.
        let own = ((self.fmr >> 8 & 0x3f) as usize).min(BANKS);
        for (bank, [value, mask]) in self.banks[..own].iter().enumerate() {
            let bit = |register: u32| register >> bank & 1;
            let fifo = bit(self.assignment) as usize;
            // Bit 0 is unused.
            if bit(self.active) == 1 && (id ^ value) & mask & !1 == 0 {
                let index = numbers[fifo];
                return Some(Match { fifo, index });
            }
            // Filter numbers also count inactive banks: a list counts twice, and so do 16-bit filters.
            numbers[fifo] += 1 << bit(self.mode) << bit(!self.scale);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_matching_mask_selects_fifo_and_filter_number() {
        let mut filters = Filters {
            fmr: 0x2a1c_0e00,
            scale: 0b1_1011,
            mode: 0b1000,
            assignment: 0b10,
            active: 0b1_0011,
            ..Filters::default()
        };
        // Bank 0 passes standard data frames to FIFO 0, bank 1 extended frames to FIFO 1, bank 4 all other frames to
        // FIFO 0. Bank 2 has two 16-bit masks, bank 3 is a list of two identifiers; both are inactive.
        filters.banks[0] = [7 << 21, 0xffe0_0006];
        filters.banks[1] = [7 << 3 | 4, !0];
        let find = |filters: &Filters, frame| filters.find(&frame).map(|m| (m.fifo, m.index));
        let [standard, extended] = [Id::Standard(7), Id::Extended(7)].map(|id| Frame::new(id, &[]));
        assert_eq!(find(&filters, standard), Some((0, 0)));
        assert_eq!(find(&filters, extended), Some((1, 0)));
        let remote = Frame::remote(Id::Standard(7), 0);
        assert_eq!(find(&filters, remote), Some((0, 5)));
        filters.active = 1;
        assert_eq!(find(&filters, extended), None);
        // Banks from number 4 on belong to CAN2.
        (filters.active, filters.fmr) = (1 << 4, 0x2a1c_0400);
        assert_eq!(find(&filters, standard), None);
        assert!(!filters.are_unknown());
        filters.active = 1 << 3;
        assert!(filters.are_unknown());
        filters.fmr |= FINIT;
        assert!(!filters.are_unknown());
    }
}
