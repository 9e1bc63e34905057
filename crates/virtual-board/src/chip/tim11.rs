//! TIM11 as an input capture of the divided crystal.
//!
//! Source: reference manual RM0090, chapter 19 (TI1_RMP: 19.5.11). The only modelled use measures the crystal against
//! the clock of the timer: the counter runs, and every first, second, fourth or eighth rising edge of HSE_RTC captures
//! the count.
//!
//! Not modelled: compare and PWM, interrupts, one-pulse mode, inputs at pins. Enabling compare or an interrupt is a
//! finding.

use super::Peripheral;
use super::register::{Register, narrow};
use super::shared::Shared;
use crate::finding::FindingKind;
use crate::time::{Cycles, Time};

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    narrow(CR1, "CR1", 0x387), narrow(DIER, "DIER", 3), narrow(SR, "SR", 0x203), narrow(EGR, "EGR", 3),
    narrow(CCMR1, "CCMR1", 0xff), narrow(CCER, "CCER", 0xb), narrow(CNT, "CNT", 0xffff), narrow(PSC, "PSC", 0xffff),
    narrow(ARR, "ARR", 0xffff), narrow(CCR1, "CCR1", 0xffff), narrow(OR, "OR", 3),
];

const CR1: u32 = 0x00;
const DIER: u32 = 0x0c;
const SR: u32 = 0x10;
const EGR: u32 = 0x14;
const CCMR1: u32 = 0x18;
const CCER: u32 = 0x20;
const CNT: u32 = 0x24;
const PSC: u32 = 0x28;
const ARR: u32 = 0x2c;
const CCR1: u32 = 0x34;
const OR: u32 = 0x50;

/// Flags of SR: a capture occurred; a capture occurred before the previous one was read.
const CC1IF: u32 = 1 << 1;
const CC1OF: u32 = 1 << 9;
/// Value of OR that selects the crystal, divided for the real-time clock, as the input.
const HSE_RTC: u32 = 2;

#[derive(Clone)]
pub(crate) struct Tim11 {
    registers: [u32; 0x54 / 4],
    /// Cycle at which the counter was zero.
    zero: Cycles,
    /// Time at which capturing began.
    since: Time,
    /// Number of captures up to the latest capture that the program has read.
    read: u64,
}

impl Default for Tim11 {
    fn default() -> Self {
        let mut registers = [0; 0x54 / 4];
        registers[ARR as usize / 4] = 0xffff;
        Self {
            registers,
            zero: 0,
            since: Time(0),
            read: 0,
        }
    }
}

impl Tim11 {
    fn reg(&self, offset: u32) -> u32 {
        self.registers[offset as usize / 4]
    }

    fn runs(&self) -> bool {
        self.reg(CR1) & 1 != 0
    }

    fn captures(&self) -> bool {
        let channel = self.reg(CCMR1) & 3 == 1 && self.reg(CCER) & 1 != 0;
        channel && self.runs() && self.reg(OR) & 3 == HSE_RTC
    }

    /// Time between two captures; `None` if the timer does not capture.
    fn span(&self, shared: &Shared) -> Option<Time> {
        let period = shared.divided_crystal.filter(|_| self.captures())?;
        Some(Time(period.0 << (self.reg(CCMR1) >> 2 & 3)))
    }

    /// Number of captures so far.
    fn count(&self, shared: &Shared) -> u64 {
        let span = self.span(shared);
        span.map_or(0, |span| (shared.time() - self.since).0 / span.0.max(1))
    }

    /// Count at a cycle.
    fn at(&self, cycle: Cycles, shared: &Shared) -> u32 {
        let step = shared.clocks.timer2 * u64::from(self.reg(PSC) + 1);
        let counts = cycle.saturating_sub(self.zero) / step;
        (counts % u64::from(self.reg(ARR) + 1)) as u32
    }

    fn begin(&mut self, shared: &Shared) {
        (self.since, self.read) = (shared.time(), 0);
    }
}

impl Peripheral for Tim11 {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        let count = self.count(shared);
        match offset {
            CNT if self.runs() => self.at(shared.now, shared),
            SR => {
                let unread = count.saturating_sub(self.read);
                (if unread > 0 { CC1IF } else { 0 }) | (if unread > 1 { CC1OF } else { 0 })
            }
            CCR1 => {
                self.read = count;
                let span = self.span(shared).unwrap_or_default();
                let at = self.since + Time(span.0 * count);
                self.at(shared.base.cycle_of(at), shared)
            }
            _ => self.reg(offset),
        }
    }

    fn write(&mut self, offset: u32, value: u32, _mask: u32, shared: &mut Shared) {
        let captured = self.captures();
        match offset {
            SR => self.read = self.count(shared),
            EGR => self.zero = shared.now,
            _ => {
                let old = std::mem::replace(&mut self.registers[offset as usize / 4], value);
                if offset == CR1 && value & !old & 1 != 0 {
                    self.zero = shared.now;
                }
            }
        }
        let outside = offset == DIER && value != 0
            || offset == CCER
                && value & 1 != 0
                && !(self.reg(CCMR1) & 3 == 1 && self.reg(OR) == HSE_RTC);
        if outside {
            shared.note(
                FindingKind::NotModelled,
                "TIM11: all except captures of the divided crystal",
            );
        }
        if self.captures() && !captured {
            self.begin(shared);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    /// A timer that captures every eighth edge of a crystal divided by 31.
    fn started(shared: &mut Shared, crystal_hz: u64) -> Tim11 {
        shared.divided_crystal = Some(Time(31 * 1_000_000_000_000 / crystal_hz));
        let mut timer = Tim11::default();
        for (offset, value) in [(OR, HSE_RTC), (CCMR1, 1 | 3 << 2), (CCER, 1), (CR1, 1)] {
            timer.write(offset, value, !0, shared);
        }
        timer
    }

    #[test]
    fn captures_differ_by_the_period_of_the_divided_crystal() {
        for (crystal_hz, cycles) in [(8_000_000, 496), (12_000_000, 330)] {
            let mut shared = shared();
            let mut timer = started(&mut shared, crystal_hz);
            let mut counts = Vec::new();
            while counts.len() < 3 {
                shared.now += 10;
                if timer.read(SR, &mut shared) & CC1IF != 0 {
                    counts.push(timer.read(CCR1, &mut shared));
                }
            }
            for pair in counts.windows(2) {
                assert!((pair[1] - pair[0]).abs_diff(cycles) <= 1, "{counts:?}");
            }
        }
    }

    #[test]
    fn missed_capture_sets_the_overcapture_flag_and_the_counter_wraps() {
        let mut shared = shared();
        let mut timer = started(&mut shared, 8_000_000);
        shared.now += 1_000;
        assert_eq!(timer.read(SR, &mut shared), CC1IF | CC1OF);
        shared.now = 65_536 + 7;
        assert_eq!(timer.read(CNT, &mut shared), 7);
        assert!(timer.read(CCR1, &mut shared) > 65_536 - 496);
        assert_eq!(timer.read(SR, &mut shared), 0);
    }

    #[test]
    fn without_a_crystal_nothing_is_captured() {
        let mut shared = shared();
        let mut timer = started(&mut shared, 8_000_000);
        shared.divided_crystal = None;
        shared.now += 100_000;
        assert_eq!(timer.read(SR, &mut shared), 0);
    }

    #[test]
    fn compare_and_interrupts_are_findings() {
        for (offset, value) in [(DIER, 2), (CCER, 1)] {
            let mut shared = shared();
            Tim11::default().write(offset, value, !0, &mut shared);
            assert_eq!(shared.kinds(), [FindingKind::NotModelled]);
        }
    }
}
