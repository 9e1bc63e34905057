//! External interrupts: the line of the voltage detector.
//!
//! Source: reference manual RM0090, chapter 12. An edge sets the pending bit even if the interrupt is masked.
//!
//! Not modelled: lines of pins, real-time clock, USB and Ethernet; events for WFE; pending bits set by the program.
//! Enabling one of these is a finding.

use super::Peripheral;
use super::interrupt::Interrupt;
use super::register::{Register, merge, word};
use super::shared::Shared;
use crate::finding::FindingKind;

// Offsets of registers.
const IMR: u32 = 0x00;
const RTSR: u32 = 0x08;
const FTSR: u32 = 0x0c;
const PR: u32 = 0x14;

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    word(IMR, "IMR", 0x7f_ffff), word(0x04, "EMR", 0x7f_ffff), word(RTSR, "RTSR", 0x7f_ffff),
    word(FTSR, "FTSR", 0x7f_ffff), word(0x10, "SWIER", 0x7f_ffff), word(PR, "PR", 0x7f_ffff),
];

/// Bit of the voltage detector's line in each register.
const LINE: u32 = 1 << 16;

/// Turns edges of the voltage detector into interrupts.
#[derive(Clone, Default)]
pub(crate) struct Exti {
    mask: u32,
    rising: u32,
    falling: u32,
    pending: u32,
    level: bool,
}

impl Exti {
    /// Sets the level of the voltage detector's output.
    pub fn level(&mut self, level: bool, shared: &mut Shared) {
        let before = std::mem::replace(&mut self.level, level);
        if before != level {
            self.pending |= LINE & if level { self.rising } else { self.falling };
            self.update(shared);
        }
    }

    fn update(&self, shared: &mut Shared) {
        shared.line(Interrupt::Pvd, self.pending & self.mask & LINE != 0);
    }
}

impl Peripheral for Exti {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            IMR => self.mask,
            RTSR => self.rising,
            FTSR => self.falling,
            PR => self.pending,
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        let modelled = match offset {
            IMR | RTSR | FTSR => LINE,
            PR => !0,
            _ => 0,
        };
        if value & !modelled != 0 {
            let text = "EXTI: lines other than 16, events, SWIER";
            shared.note(FindingKind::NotModelled, text);
        }
        match offset {
            IMR => self.mask = merge(self.mask, value, mask),
            RTSR => self.rising = merge(self.rising, value, mask),
            FTSR => self.falling = merge(self.falling, value, mask),
            PR => self.pending &= !value,
            _ => {}
        }
        self.update(shared);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    #[test]
    fn enabled_edges_set_pending_until_cleared() {
        for (edges, rises, falls) in [(RTSR, true, false), (FTSR, false, true)] {
            let (mut exti, mut shared) = (Exti::default(), shared());
            exti.write(IMR, LINE, !0, &mut shared);
            exti.write(edges, LINE, !0, &mut shared);
            for (level, pends) in [(true, rises), (false, falls)] {
                exti.level(level, &mut shared);
                exti.level(level, &mut shared);
                assert_eq!(shared.lines, u128::from(pends) << Interrupt::Pvd as u32);
                exti.write(PR, LINE, !0, &mut shared);
                assert_eq!(shared.lines, 0);
            }
        }
    }

    #[test]
    fn masked_line_sets_pending_and_interrupts_when_unmasked() {
        let (mut exti, mut shared) = (Exti::default(), shared());
        exti.write(RTSR, LINE, !0, &mut shared);
        exti.level(true, &mut shared);
        assert_eq!((exti.read(PR, &mut shared), shared.lines), (LINE, 0));
        exti.write(IMR, LINE, !0, &mut shared);
        assert!(shared.is_high(Interrupt::Pvd));
    }

    #[test]
    fn enabling_a_line_that_is_not_modelled_is_a_finding() {
        for (offset, value) in [(0x04, LINE), (IMR, 1), (RTSR, 1 << 22), (0x10, LINE)] {
            let (mut exti, mut shared) = (Exti::default(), shared());
            exti.write(offset, value, !0, &mut shared);
            assert_eq!(shared.kinds(), [FindingKind::NotModelled]);
        }
    }
}
