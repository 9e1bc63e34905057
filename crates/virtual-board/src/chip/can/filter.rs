//! Filter banks: which frames go into which FIFO (RM0090, "Identifier filtering").
//!
//! Not modelled: lists, and filters of 16 bits; using one is a finding.

use crate::wire::{Frame, Id};

/// Banks of CAN1 and CAN2 together.
pub(super) const BANKS: usize = 28;
/// All banks, a bit each.
pub(super) const ALL: u32 = (1 << BANKS) - 1;
/// FMR: initialisation mode of the filters.
pub(super) const FINIT: u32 = 1;

/// The filters' registers.
#[derive(Clone)]
pub(super) struct Filters {
    pub fmr: u32,
    /// List instead of mask: counted, not modelled.
    pub mode: u32,
    /// 32 bits instead of twice 16, which is not modelled.
    pub scale: u32,
    /// FIFO 1 instead of FIFO 0.
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

/// Where a frame goes: the FIFO, and the number of the filter among those of the FIFO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Match {
    pub fifo: usize,
    pub index: u8,
}

/// A frame's identifier as in the registers of 32 bits: STID, EXID, IDE, RTR.
pub(super) fn wide(frame: &Frame) -> u32 {
    let remote = u32::from(frame.is_remote()) << 1;
    match frame.id() {
        Id::Standard(id) => u32::from(id) << 21 | remote,
        Id::Extended(id) => id << 3 | 1 << 2 | remote,
    }
}

impl Filters {
    /// True if a bank in use is not one mask of 32 bits.
    pub fn are_unknown(&self) -> bool {
        self.fmr & FINIT == 0 && self.active & (self.mode | !self.scale) != 0
    }

    /// Where a frame goes: by the first bank that it passes.
    pub fn find(&self, frame: &Frame) -> Option<Match> {
        if self.fmr & FINIT != 0 {
            return None;
        }
        let id = wide(frame);
        let mut numbers = [0u8; 2];
        // Banks from CAN2SB on are CAN2's.
        let own = ((self.fmr >> 8 & 0x3f) as usize).min(BANKS);
        for (bank, [value, mask]) in self.banks[..own].iter().enumerate() {
            let bit = |register: u32| register >> bank & 1;
            let fifo = bit(self.assignment) as usize;
            // Bit 0 is not used.
            if bit(self.active) == 1 && (id ^ value) & mask & !1 == 0 {
                let index = numbers[fifo];
                return Some(Match { fifo, index });
            }
            // Numbers count inactive banks too: two in a list, two of 16 bits instead of one of 32.
            numbers[fifo] += 1 << bit(self.mode) << bit(!self.scale);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_mask_that_a_frame_passes_counts_the_filters_before_it() {
        let mut filters = Filters {
            fmr: 0x2a1c_0e00,
            scale: 0b1_1011,
            mode: 0b1000,
            assignment: 0b10,
            active: 0b1_0011,
            ..Filters::default()
        };
        // A standard data frame, to FIFO 0; an extended one, to FIFO 1; all others. Bank 2 has two masks of 16
        // bits, bank 3 is a list of two.
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
        // Banks from the fourth on are CAN2's.
        (filters.active, filters.fmr) = (1 << 4, 0x2a1c_0400);
        assert_eq!(find(&filters, standard), None);
        assert!(!filters.are_unknown());
        filters.active = 1 << 3;
        assert!(filters.are_unknown());
        filters.fmr |= FINIT;
        assert!(!filters.are_unknown());
    }
}
