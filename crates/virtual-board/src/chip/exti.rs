//! External interrupts and the choice of their ports.
//!
//! Source: reference manual RM0090, chapters 9 and 12. Lines 0 to 15 are pins, 16 is the voltage
//! detector. An edge pends its line whether its interrupt is enabled or not.
//!
//! Not modelled: events for WFE and as triggers of the converter, and the lines of the real-time clock,
//! USB and Ethernet; switching one on is a finding.

use super::Peripheral;
use super::effect::{Effect, Trigger};
use super::interrupt::Interrupt;
use super::pin::PORTS;
use super::register::{Register, merge, narrow, word};
use super::shared::Shared;
use crate::finding::Kind;

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    word(0x00, "IMR", 0x7f_ffff), word(0x04, "EMR", 0x7f_ffff), word(0x08, "RTSR", 0x7f_ffff),
    word(0x0c, "FTSR", 0x7f_ffff), word(0x10, "SWIER", 0x7f_ffff), word(0x14, "PR", 0x7f_ffff),
];

/// Lines that are modelled.
const LINES: u32 = 0x1_ffff;

/// Edges of pins become interrupts.
#[derive(Default)]
pub(crate) struct Exti {
    mask: u32,
    rising: u32,
    falling: u32,
    pending: u32,
    levels: u32,
    software: u32,
}

impl Exti {
    /// The level that a line listens to, where there is no edge: after a reset.
    pub fn begin(&mut self, line: u32, level: bool) {
        let bit = 1 << line;
        self.levels = if level {
            self.levels | bit
        } else {
            self.levels & !bit
        };
    }

    /// Whether the program waits for a line.
    pub fn listens(&self, line: u32) -> bool {
        (self.rising | self.falling) & self.mask & 1 << line != 0
    }

    /// What a line listens to has another level, or it listens to something else now.
    pub fn level(&mut self, line: u32, level: bool, shared: &mut Shared) {
        let bit = 1 << line;
        let before = self.levels & bit != 0;
        self.begin(line, level);
        let edges = if level { self.rising } else { self.falling };
        if before != level && edges & bit != 0 {
            self.pending |= bit;
            self.update(shared);
            // The converter takes two of the lines as triggers.
            let trigger = match line {
                11 => Trigger::Exti11,
                15 => Trigger::Exti15,
                _ => return,
            };
            shared.effect(Effect::Trigger(trigger, true));
            shared.effect(Effect::Trigger(trigger, false));
        }
    }

    fn update(&self, shared: &mut Shared) {
        let active = self.pending & self.mask;
        for (lines, interrupt) in [
            (1, Interrupt::Exti0),
            (1 << 1, Interrupt::Exti1),
            (1 << 2, Interrupt::Exti2),
            (1 << 3, Interrupt::Exti3),
            (1 << 4, Interrupt::Exti4),
            (0x3e0, Interrupt::Exti9To5),
            (0xfc00, Interrupt::Exti15To10),
            (1 << 16, Interrupt::Pvd),
        ] {
            shared.line(interrupt, active & lines != 0);
        }
    }
}

impl Peripheral for Exti {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            0x00 => self.mask,
            0x08 => self.rising,
            0x0c => self.falling,
            0x10 => self.software,
            0x14 => self.pending,
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        let unknown = match offset {
            0x04 => !0,
            0x14 => 0,
            _ => !LINES,
        };
        if value & unknown != 0 {
            shared.note(Kind::NotModelled, "EXTI: events, and lines beyond 16");
        }
        match offset {
            0x00 => self.mask = merge(self.mask, value, mask),
            0x08 => self.rising = merge(self.rising, value, mask),
            0x0c => self.falling = merge(self.falling, value, mask),
            0x10 => {
                self.pending |= value & mask & !self.software & self.mask;
                self.software |= value & mask;
            }
            0x14 => {
                self.pending &= !value;
                self.software &= !value;
            }
            _ => {}
        }
        self.update(shared);
    }
}

#[rustfmt::skip]
const CONFIGURATION: &[Register] = &[
    narrow(0x00, "MEMRMP", 3), narrow(0x04, "PMC", 0x80_0000), narrow(0x08, "EXTICR1", 0xffff), narrow(0x0c, "EXTICR2", 0xffff),
    narrow(0x10, "EXTICR3", 0xffff), narrow(0x14, "EXTICR4", 0xffff), narrow(0x20, "CMPCR", 0x101),
];

/// System configuration: which port each line listens to.
#[derive(Default)]
pub(crate) struct Syscfg {
    ports: [u32; 4],
}

impl Syscfg {
    /// The port that a line listens to.
    pub fn port_of(&self, line: u32) -> usize {
        (self.ports[line as usize / 4] >> (4 * (line % 4)) & 15) as usize
    }
}

impl Peripheral for Syscfg {
    fn registers(&self) -> &'static [Register] {
        CONFIGURATION
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            0x08..=0x14 => self.ports[offset as usize / 4 - 2],
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        match offset {
            0x08..=0x14 => {
                let register = &mut self.ports[offset as usize / 4 - 2];
                *register = merge(*register, value, mask);
                if (0..4).any(|k| *register >> (4 * k) & 15 >= PORTS as u32) {
                    shared.note(Kind::Forbidden, "SYSCFG_EXTICR: there are ports A to I");
                }
            }
            _ if value != 0 => {
                shared.note(Kind::NotModelled, "SYSCFG: memory remap, compensation cell")
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    const IMR: u32 = 0x00;
    const RTSR: u32 = 0x08;
    const FTSR: u32 = 0x0c;
    const SWIER: u32 = 0x10;
    const PR: u32 = 0x14;

    #[test]
    fn chosen_edges_pend_until_they_are_cleared() {
        let (mut exti, mut shared) = (Exti::default(), shared());
        exti.write(IMR, 1 << 7, !0, &mut shared);
        exti.write(FTSR, 1 << 7, !0, &mut shared);
        exti.level(7, true, &mut shared);
        assert_eq!(shared.lines, 0);
        exti.level(7, false, &mut shared);
        assert_eq!(shared.lines, 1 << Interrupt::Exti9To5 as u32);
        exti.write(PR, 1 << 7, !0, &mut shared);
        assert_eq!(shared.lines, 0);
        let mut syscfg = Syscfg::default();
        syscfg.write(0x0c, 2 << 12, !0, &mut shared);
        assert_eq!((syscfg.port_of(7), syscfg.port_of(6)), (2, 0));
    }

    #[test]
    fn lines_have_the_interrupts_of_the_manuals_vector_table() {
        for (line, number) in [
            (0, 6),
            (1, 7),
            (2, 8),
            (3, 9),
            (4, 10),
            (5, 23),
            (9, 23),
            (10, 40),
            (15, 40),
            (16, 1),
        ] {
            let (mut exti, mut shared) = (Exti::default(), shared());
            exti.write(IMR, 1 << line, !0, &mut shared);
            exti.write(RTSR, 1 << line, !0, &mut shared);
            exti.level(line, true, &mut shared);
            assert_eq!(shared.lines, 1u128 << number, "line {line}");
        }
    }

    #[test]
    fn a_masked_line_pends_and_interrupts_when_it_is_unmasked() {
        let (mut exti, mut shared) = (Exti::default(), shared());
        exti.write(RTSR, 1, !0, &mut shared);
        exti.level(0, true, &mut shared);
        assert_eq!((exti.read(PR, &mut shared), shared.lines), (1, 0));
        exti.write(IMR, 1, !0, &mut shared);
        assert_eq!(shared.lines, 1 << Interrupt::Exti0 as u32);
    }

    #[test]
    fn software_pends_a_line_that_is_enabled_and_clearing_takes_both_away() {
        let (mut exti, mut shared) = (Exti::default(), shared());
        exti.write(IMR, 2, !0, &mut shared);
        exti.write(SWIER, 6, !0, &mut shared);
        assert_eq!(exti.read(PR, &mut shared), 2);
        exti.write(PR, 2, !0, &mut shared);
        assert_eq!([SWIER, PR].map(|at| exti.read(at, &mut shared)), [4, 0]);
        assert_eq!(shared.lines, 0);
    }

    #[test]
    fn events_and_lines_that_are_not_there_are_found() {
        for (offset, value) in [(0x04, 1), (IMR, 1 << 17), (RTSR, 1 << 22)] {
            let (mut exti, mut shared) = (Exti::default(), shared());
            exti.write(offset, value, !0, &mut shared);
            assert_eq!(shared.findings.list()[0].kind, Kind::NotModelled);
        }
    }
}
