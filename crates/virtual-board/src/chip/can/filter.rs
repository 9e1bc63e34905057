//! Filter banks: which frames go into which FIFO (RM0090, "Identifier filtering").

use crate::wire::{Frame, Id};

/// Banks of CAN1 and CAN2 together.
pub(super) const BANKS: usize = 28;
/// All banks, a bit each.
pub(super) const ALL: u32 = (1 << BANKS) - 1;
/// FMR: initialisation mode of the filters.
pub(super) const FINIT: u32 = 1;

/// The filters' registers.
pub(super) struct Filters {
    pub fmr: u32,
    /// List instead of mask.
    pub mode: u32,
    /// 32 bits instead of twice 16.
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

/// A frame's identifier as a half: STID, RTR, IDE, the highest three bits of EXID.
fn half(wide: u32) -> u32 {
    (wide >> 21 & 0x7ff) << 5 | (wide >> 1 & 1) << 4 | (wide >> 2 & 1) << 3 | wide >> 18 & 7
}

impl Filters {
    fn is_wide(&self, bank: usize) -> bool {
        self.scale >> bank & 1 == 1
    }

    fn is_list(&self, bank: usize) -> bool {
        self.mode >> bank & 1 == 1
    }

    fn fifo(&self, bank: usize) -> usize {
        (self.assignment >> bank & 1) as usize
    }

    /// Filters in a bank, each with a number.
    fn count(&self, bank: usize) -> u8 {
        match (self.is_wide(bank), self.is_list(bank)) {
            (true, false) => 1,
            (true, true) | (false, false) => 2,
            (false, true) => 4,
        }
    }

    /// Which of a bank's filters a frame passes.
    fn passes(&self, bank: usize, wide: u32) -> Option<u8> {
        let [first, second] = self.banks[bank];
        // Bit 0 of a wide register is not used.
        let (id, halves) = (wide & !1, [first, second]);
        let short = half(wide);
        match (self.is_wide(bank), self.is_list(bank)) {
            (true, false) => ((id ^ first) & second & !1 == 0).then_some(0),
            (true, true) => halves.iter().position(|r| r & !1 == id).map(|k| k as u8),
            (false, false) => halves
                .iter()
                .position(|r| (short ^ r) & (r >> 16) & 0xffff == 0)
                .map(|k| k as u8),
            (false, true) => halves
                .iter()
                .flat_map(|r| [r & 0xffff, r >> 16])
                .position(|r| r == short)
                .map(|k| k as u8),
        }
    }

    /// Where a frame goes. Wide filters come before narrow ones, lists before masks, then low numbers.
    pub fn find(&self, frame: &Frame) -> Option<Match> {
        if self.fmr & FINIT != 0 {
            return None;
        }
        let wide = wide(frame);
        let mut numbers = [0u8; 2];
        let mut best: Option<((bool, bool), Match)> = None;
        // Banks from CAN2SB on are CAN2's.
        let own = ((self.fmr >> 8 & 0x3f) as usize).min(BANKS);
        for bank in 0..own {
            let fifo = self.fifo(bank);
            // Numbers count inactive banks too.
            let number = numbers[fifo];
            numbers[fifo] += self.count(bank);
            if self.active >> bank & 1 == 0 {
                continue;
            }
            let order = (!self.is_wide(bank), !self.is_list(bank));
            if best.is_none_or(|(known, _)| order < known)
                && let Some(place) = self.passes(bank, wide)
            {
                let index = number + place;
                best = Some((order, Match { fifo, index }));
            }
        }
        best.map(|(_, found)| found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn standard(id: u16) -> Frame {
        Frame::new(Id::Standard(id), &[])
    }

    #[test]
    fn numbers_are_those_of_the_manuals_example() {
        // RM0090, "Example of filter numbering", FIFO 0: bank 0 32-bit list (0, 1), bank 1 32-bit
        // mask (2), bank 3 16-bit list (3..6), bank 5 inactive 32-bit list (7, 8), bank 6 16-bit mask
        // (9, 10), bank 9 32-bit list (11, 12), bank 13 32-bit mask (13).
        let mut filters = Filters {
            fmr: 0x2a1c_0e00,
            ..Filters::default()
        };
        let on = |banks: &[usize]| banks.iter().fold(0, |all, b| all | 1 << b);
        filters.mode = on(&[0, 3, 5, 9, 4, 8]);
        filters.scale = on(&[0, 1, 5, 9, 13, 2, 8, 10]);
        filters.assignment = on(&[2, 4, 7, 8, 10, 11, 12]);
        filters.active = on(&[0, 1, 3, 6, 9, 13]);
        // Each filter that can have a number of its own gets an identifier; masks are full.
        let id = |n: u32| n << 21;
        filters.banks[0] = [id(100), id(101)];
        filters.banks[1] = [id(102), 0xffe0_0006];
        filters.banks[3] = [103 << 5 | 104 << 21, 105 << 5 | 106 << 21];
        filters.banks[6] = [109 << 5 | 0xfff8 << 16, 110 << 5 | 0xfff8 << 16];
        filters.banks[9] = [id(111), id(112)];
        filters.banks[13] = [id(113), 0xffe0_0006];
        for n in [0u8, 1, 2, 3, 4, 5, 6, 9, 10, 11, 12, 13] {
            let found = filters.find(&standard(100 + u16::from(n)));
            assert_eq!(found, Some(Match { fifo: 0, index: n }));
        }
        for n in [107, 108, 99] {
            assert_eq!(filters.find(&standard(n)), None);
        }
    }

    #[test]
    fn lists_come_before_masks_and_wide_before_narrow() {
        let mut filters = Filters {
            fmr: 0x2a1c_0e00,
            active: 0xf,
            scale: 0b1100,
            mode: 0b1010,
            ..Filters::default()
        };
        // 0: narrow mask that takes all; 1: narrow list; 2: wide mask that takes all; 3: wide list.
        filters.banks[1] = [7 << 5; 2];
        filters.banks[3] = [7 << 21; 2];
        let index = |filters: &Filters, frame| filters.find(&frame).map(|m| m.index);
        assert_eq!(index(&filters, standard(7)), Some(7));
        assert_eq!(index(&filters, standard(8)), Some(6));
        filters.active = 0b11;
        assert_eq!(index(&filters, standard(7)), Some(2));
        assert_eq!(index(&filters, standard(8)), Some(0));
        // Extended and remote frames have their own bits.
        assert_eq!(index(&filters, Frame::remote(Id::Standard(7), 0)), Some(0));
        filters.fmr |= FINIT;
        assert_eq!(index(&filters, standard(7)), None);
    }

    #[test]
    fn narrow_filters_see_three_bits_of_the_extension() {
        let mut filters = Filters {
            fmr: 0x2a1c_0e00,
            active: 1,
            mode: 1,
            ..Filters::default()
        };
        let frame = Frame::new(Id::Extended(0x123 << 18 | 5 << 15 | 0x77), &[]);
        filters.banks[0] = [0x123 << 5 | 1 << 3 | 5, 0];
        assert_eq!(filters.find(&frame), Some(Match { fifo: 0, index: 0 }));
        filters.banks[0] = [0x123 << 5 | 1 << 3 | 4, 0];
        assert_eq!(filters.find(&frame), None);
    }
}
