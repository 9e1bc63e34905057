//! Reset and clock control: oscillators, PLL, clocks of buses and peripherals, reset causes.
//!
//! Source: reference manual RM0090, chapter 7 (STM32F405). Start-up times are the typical values of the data sheet;
//! ready flags are set after them. A clock beyond its limit is a finding when the program sets it.
//!
//! If the crystal fails while clock security is off and the core runs on the crystal, the core has no clock, because
//! the manual does not specify the frequency of the PLL. Everything driven by the core clock then stops, outputs keep
//! their levels, and only the watchdog continues.
//!
//! Not modelled: clock outputs MCO, PLLI2S, an external clock instead of the crystal (HSEBYP), the low-speed crystal,
//! spread spectrum, trimming of the internal oscillator; enabling one is a finding. Clock enables for sleep mode are
//! stored without effect. A peripheral works from the cycle after its clock was enabled; the chip needs at least two
//! cycles (errata sheet, 2.1.13), so an early access without a DSB is a finding (see `enabled.rs`).

mod tree;

use super::Peripheral;
use super::cause::Cause;
use super::effect::{Clocks, Effect};
use super::interrupt::Interrupt;
use super::map::Unit;
use super::register::{Register, merge, narrow};
use super::shared::Shared;
use crate::finding::FindingKind;
use crate::time::{NEVER, Time};
use tree::Pll;

/// Frequency that stands for a stopped core clock, Hz: the lowest that the time base supports.
const STALLED_HZ: u64 = 1_000;
/// Start-up times of the internal oscillator, of the slow oscillator and of the PLL.
const INTERNAL_START: Time = Time::from_nanos(2_200);
const SLOW_START: Time = Time::from_micros(15);
const PLL_LOCK: Time = Time::from_micros(100);
/// Time in reset after the supply is sufficient, and after other resets.
const POWER_DELAY: Time = Time::from_micros(1_500);
const RESET_PULSE: Time = Time::from_micros(20);

// Bit 29 of PLLCFGR is reserved with reset value one. HALs of the family, including the vendor's, write zero there
// without harm, so the bit is not treated as reserved.
#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    narrow(0x00, "CR", 0x0f0f_fffb), narrow(0x04, "PLLCFGR", 0x2f43_7fff), narrow(0x08, "CFGR", 0xffff_fcff),
    narrow(0x0c, "CIR", 0x00bf_3fbf), narrow(0x10, "AHB1RSTR", 0x2260_11ff), narrow(0x14, "AHB2RSTR", 0xf1),
    narrow(0x18, "AHB3RSTR", 1), narrow(0x20, "APB1RSTR", 0x36fe_c9ff), narrow(0x24, "APB2RSTR", 0x0007_5933),
    narrow(0x30, "AHB1ENR", 0x7e74_11ff), narrow(0x34, "AHB2ENR", 0xf1), narrow(0x38, "AHB3ENR", 1),
    narrow(0x40, "APB1ENR", 0x36fe_c9ff), narrow(0x44, "APB2ENR", 0x0007_5f33),
    narrow(0x50, "AHB1LPENR", 0x7e67_91ff), narrow(0x54, "AHB2LPENR", 0xf1), narrow(0x58, "AHB3LPENR", 1),
    narrow(0x60, "APB1LPENR", 0x36fe_c9ff), narrow(0x64, "APB2LPENR", 0x0007_5f33),
    narrow(BDCR, "BDCR", 0x0001_8307), narrow(CSR, "CSR", 0xff00_0003), narrow(0x80, "SSCGR", 0xcfff_ffff),
    narrow(0x84, "PLLI2SCFGR", 0x7000_7fc0),
    // A register of the STM32F42x that reads as zero here; drivers for the whole family read it.
    narrow(0x8c, "DCKCFGR", 0),
];

/// Offset of the backup domain control register.
pub(crate) const BDCR: u32 = 0x70;
/// Registers that enable the clocks of peripherals.
pub(crate) const ENABLES: [u32; 5] = [0x30, 0x34, 0x38, 0x40, 0x44];
const CSR: u32 = 0x74;
/// Distance from the reset register to the enable register of the same peripherals.
const RESET_TO_ENABLE: u32 = 0x20;

// Bits of CR.
bits! {
    HSION 0, HSEON 16, HSEBYP 18, CSSON 19, PLLON 24, PLLI2SON 26
}
const TRIM: u32 = 0xf8;
/// Bit of PLLCFGR: the PLL's source is the crystal, not the internal oscillator.
const PLLSRC: u32 = 1 << 22;
/// Flag of CIR: the crystal failed.
const CSSF: u32 = 1 << 7;
// Bits of BDCR.
const RTCSEL: u32 = 0x300;
const RTCEN: u32 = 1 << 15;
const BDRST: u32 = 1 << 16;

/// An oscillator or PLL with a start-up time.
#[derive(Clone, Copy, Debug, Default)]
struct Oscillator {
    ready: bool,
    /// Time at which the oscillator becomes ready; `None` if it is not starting.
    due: Option<Time>,
}

/// Indices of the oscillators. The core can run on the first three; their index is the value of SW.
const INTERNAL: usize = 0;
const CRYSTAL: usize = 1;
const PLL: usize = 2;
const SLOW: usize = 3;

/// Ready flag of each oscillator in CIR.
const READY_FLAGS: [u32; 4] = [1 << 2, 1 << 3, 1 << 4, 1];

/// State that a reset keeps.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Kept {
    causes: u32,
    crystal_dead: bool,
    backup: u32,
}

/// Reset and clock control.
#[derive(Clone)]
pub(crate) struct Rcc {
    /// Registers that only store the written value, by offset / 4.
    plain: [u32; 36],
    oscillators: [Oscillator; 4],
    /// Oscillator or PLL that drives the core.
    system: usize,
    causes: u32,
    /// Ready flags and clock security flag of CIR.
    flags: u32,
    crystal_dead: bool,
    clocks: Clocks,
    /// True if the core clock has failed.
    stalled: bool,
    /// Time at which the reset is released; `None` after the release.
    release: Option<Time>,
}

impl Default for Rcc {
    fn default() -> Self {
        let mut plain = [0; 36];
        for (offset, value) in [
            (0x00, 0x81),
            (0x04, 0x2400_3010),
            (0x30, 0x0010_0000),
            (0x50, 0x7e67_91ff),
            (0x54, 0xf1),
            (0x58, 1),
            (0x60, 0x36fe_c9ff),
            (0x64, 0x0007_5f33),
            (0x84, 0x2000_3000),
        ] {
            plain[offset / 4] = value;
        }
        let mut oscillators = [Oscillator::default(); 4];
        oscillators[INTERNAL].ready = true;
        Self {
            plain,
            oscillators,
            system: INTERNAL,
            causes: 0,
            flags: 0,
            crystal_dead: false,
            clocks: Clocks::RESET,
            stalled: false,
            release: None,
        }
    }
}

impl Rcc {
    /// State kept over a reset: reset flags except on a power reset, the backup domain except on a power-on.
    pub fn kept(&self, cause: Cause) -> Kept {
        let keep = |kept: bool, value: u32| if kept { value } else { 0 };
        Kept {
            causes: keep(!cause.is_power(), self.causes),
            crystal_dead: self.crystal_dead,
            backup: keep(cause != Cause::PowerOn, self.reg(BDCR)),
        }
    }

    /// Starts from the reset state.
    pub fn begin(&mut self, kept: Kept, cause: Cause, shared: &mut Shared) {
        self.causes = kept.causes | cause.flags();
        self.clocks = shared.clocks;
        self.crystal_dead = kept.crystal_dead;
        *self.reg_mut(BDCR) = kept.backup;
        let delay = if cause.is_power() {
            POWER_DELAY
        } else {
            RESET_PULSE
        };
        self.release = Some(shared.time() + delay);
        self.update_rtc_clock_and_schedule(shared);
    }

    /// True if the core stands still: the reset is not released yet, or the core clock has failed.
    pub fn is_held(&self) -> bool {
        self.stalled || self.release.is_some()
    }

    /// Content of an enable register.
    pub fn enabled_by(&self, register: u32) -> u32 {
        self.reg(register)
    }

    /// True if a bit of an enable register is set.
    pub fn is_enabled(&self, register: u32, bit: u32) -> bool {
        self.reg(register) >> bit & 1 != 0
    }

    /// True if the program holds the peripheral of this enable bit in reset.
    pub fn is_in_reset(&self, register: u32, bit: u32) -> bool {
        self.reg(register - RESET_TO_ENABLE) >> bit & 1 != 0
    }

    fn reg(&self, offset: u32) -> u32 {
        self.plain[offset as usize / 4]
    }

    fn reg_mut(&mut self, offset: u32) -> &mut u32 {
        &mut self.plain[offset as usize / 4]
    }

    /// Handles a failure or recovery of the crystal.
    pub fn crystal(&mut self, works: bool, shared: &mut Shared) {
        self.crystal_dead = !works;
        if works {
            if self.reg(0) & HSEON != 0 && !self.oscillators[CRYSTAL].ready {
                self.start(CRYSTAL, shared);
            }
            return;
        }
        let ran = self.oscillators[CRYSTAL].ready;
        let used = self.is_used(CRYSTAL);
        self.oscillators[CRYSTAL] = Oscillator::default();
        if self.pll_source() == CRYSTAL {
            self.oscillators[PLL] = Oscillator::default();
        }
        self.update_rtc_clock_and_schedule(shared);
        if ran && self.reg(0) & CSSON != 0 {
            self.take_over(used, shared);
        } else if used {
            let text = "the crystal failed without clock security: the core stops";
            shared.note(FindingKind::ClockLimit, text);
            self.stalled = true;
            shared.effect(Effect::Frequency(STALLED_HZ));
        }
    }

    /// Handles a crystal failure detected by the clock security system.
    fn take_over(&mut self, used: bool, shared: &mut Shared) {
        *self.reg_mut(0) &= !HSEON;
        self.flags |= CSSF;
        if used {
            if self.system == PLL {
                *self.reg_mut(0) &= !PLLON;
            }
            *self.reg_mut(0) |= HSION;
            self.oscillators[INTERNAL] = Oscillator {
                ready: true,
                due: None,
            };
            *self.reg_mut(8) &= !3;
            self.switch(INTERNAL, shared);
        }
        shared.effect(Effect::ClockFailure);
    }

    fn pll_source(&self) -> usize {
        if self.reg(4) & PLLSRC != 0 {
            CRYSTAL
        } else {
            INTERNAL
        }
    }

    /// True if the core runs on an oscillator, directly or through the PLL.
    fn is_used(&self, which: usize) -> bool {
        which == self.system || self.system == PLL && which == self.pll_source()
    }

    fn source_hz(&self, which: usize, shared: &Shared) -> u64 {
        match which {
            INTERNAL => shared.variation.internal_hz,
            CRYSTAL => shared.variation.crystal_hz,
            _ => self.pll(shared).core_hz,
        }
    }

    fn pll(&self, shared: &Shared) -> Pll {
        Pll::of(self.reg(4), self.source_hz(self.pll_source(), shared))
    }

    fn start(&mut self, which: usize, shared: &mut Shared) {
        let after = match which {
            INTERNAL => INTERNAL_START,
            CRYSTAL if self.crystal_dead => return,
            CRYSTAL => shared.variation.crystal_start,
            PLL => PLL_LOCK,
            _ => SLOW_START,
        };
        self.oscillators[which].due = Some(shared.time() + after);
        self.update_rtc_clock_and_schedule(shared);
    }

    fn update_rtc_clock_and_schedule(&self, shared: &mut Shared) {
        let divider = u64::from(self.reg(8) >> 16 & 31);
        let hz = shared.variation.crystal_hz;
        let divided = Time(divider * 1_000_000_000_000 / hz.max(1));
        let runs = self.oscillators[CRYSTAL].ready && divider >= 2;
        shared.divided_crystal = runs.then_some(divided);
        let dues = self.oscillators.iter().filter_map(|one| one.due);
        let next = dues.chain(self.release).min();
        let cycle = next.map_or(NEVER, |at| shared.base.cycle_of(at).max(shared.now + 1));
        shared.schedule(Unit::Rcc, cycle);
    }

    /// Switches the core to another oscillator.
    fn switch(&mut self, system: usize, shared: &mut Shared) {
        self.system = system;
        self.update(shared);
    }

    /// Recomputes the frequencies.
    fn update(&mut self, shared: &mut Shared) {
        let system_hz = self.source_hz(self.system, shared);
        let clocks = tree::clocks(self.reg(8), system_hz);
        for text in tree::too_fast(&clocks, system_hz) {
            shared.note(FindingKind::ClockLimit, text);
        }
        if clocks != self.clocks {
            self.clocks = clocks;
            shared.clocks = Clocks {
                hclk_hz: shared.clocks.hclk_hz,
                ..clocks
            };
            shared.effect(Effect::Frequency(clocks.hclk_hz));
        }
    }

    fn write_cr(&mut self, mut value: u32, shared: &mut Shared) {
        let old = self.reg(0);
        let enables = [(INTERNAL, HSION), (CRYSTAL, HSEON), (PLL, PLLON)];
        for (which, bit) in enables {
            if old & !value & bit == 0 {
                continue;
            }
            if self.is_used(which) {
                let text = "the oscillator of the core clock is switched off";
                shared.note(FindingKind::Forbidden, text);
                value |= bit;
            } else {
                self.oscillators[which] = Oscillator::default();
            }
        }
        for (changed, text) in [
            (value & !old & PLLI2SON != 0, "PLLI2S"),
            (value & !old & HSEBYP != 0, "external clock (HSEBYP)"),
            (
                (value ^ old) & TRIM != 0,
                "trimming of the internal oscillator",
            ),
        ] {
            if changed {
                shared.note(FindingKind::NotModelled, text);
            }
        }
        *self.reg_mut(0) = value & (HSION | TRIM | HSEON | HSEBYP | CSSON | PLLON | PLLI2SON);
        if value & !old & PLLON != 0 {
            self.check_pll(shared);
        }
        for (which, bit) in enables {
            if value & !old & bit != 0 {
                self.start(which, shared);
            }
        }
        self.update_rtc_clock_and_schedule(shared);
    }

    /// Checks the settings of the PLL when it is switched on.
    fn check_pll(&self, shared: &mut Shared) {
        for text in self.pll(shared).violations() {
            shared.note(FindingKind::ClockLimit, text);
        }
        if !self.oscillators[self.pll_source()].ready {
            let text = "PLL switched on before its source is ready";
            shared.note(FindingKind::Forbidden, text);
        }
    }

    fn write_cfgr(&mut self, mut value: u32, shared: &mut Shared) {
        let old = self.reg(8);
        if (value ^ old) & 0xffe0_0000 != 0 {
            shared.note(FindingKind::NotModelled, "clock outputs MCO, clock of I2S");
        }
        if value & 3 == 3 {
            shared.note(FindingKind::Forbidden, "RCC_CFGR: SW = 3");
            value = merge(value, old, 3);
        }
        *self.reg_mut(8) = value & !0xc;
        if !self.follow_switch(shared) && (value ^ old) & 0xfcf0 != 0 {
            self.update(shared);
        }
        self.update_rtc_clock_and_schedule(shared);
    }

    /// Switches to the requested oscillator once it is ready; true if switched.
    fn follow_switch(&mut self, shared: &mut Shared) -> bool {
        let wanted = (self.reg(8) & 3) as usize;
        let switches = wanted != self.system && self.oscillators[wanted].ready;
        if switches {
            self.switch(wanted, shared);
        }
        switches
    }

    fn write_backup(&mut self, value: u32, shared: &mut Shared) {
        let old = self.reg(BDCR);
        if value & BDRST != 0 {
            *self.reg_mut(BDCR) = BDRST;
            return;
        }
        if value & 1 != 0 {
            shared.note(FindingKind::NotModelled, "the low-speed crystal");
        }
        // Once selected, the source is fixed; drivers of the family write other values without harm.
        let source = match old & RTCSEL {
            0 => value & RTCSEL,
            chosen => chosen,
        };
        *self.reg_mut(BDCR) = value & (RTCEN | 5) | source;
    }

    fn write_csr(&mut self, value: u32, shared: &mut Shared) {
        if value & 1 << 24 != 0 {
            self.causes = 0;
        }
        let old = std::mem::replace(self.reg_mut(CSR), value & 1);
        if value & !old & 1 != 0 {
            self.start(SLOW, shared);
        } else if value & 1 == 0 {
            self.oscillators[SLOW] = Oscillator::default();
            self.update_rtc_clock_and_schedule(shared);
        }
    }

    fn write_reset(&mut self, offset: u32, value: u32, shared: &mut Shared) {
        let old = std::mem::replace(self.reg_mut(offset), value);
        for bit in (0..32).filter(|bit| value & !old & 1 << bit != 0) {
            shared.effect(Effect::ResetUnit {
                register: offset + RESET_TO_ENABLE,
                bit,
            });
        }
    }

    fn read_cr(&self) -> u32 {
        let ready = |which: usize, bit: u32| u32::from(self.oscillators[which].ready) << bit;
        // HSICAL: factory calibration of the internal oscillator.
        let calibration = 0x80 << 8;
        self.reg(0) | ready(INTERNAL, 1) | ready(CRYSTAL, 17) | ready(PLL, 25) | calibration
    }

    fn line(&self, shared: &mut Shared) {
        let enabled = self.reg(0x0c) >> 8 & 0x3f;
        shared.line(Interrupt::Rcc, self.flags & enabled != 0);
    }

    /// Sets an oscillator ready.
    fn set_ready(&mut self, which: usize, shared: &mut Shared) {
        self.oscillators[which] = Oscillator {
            ready: true,
            due: None,
        };
        // The ready flag is set only if its interrupt is enabled.
        self.flags |= READY_FLAGS[which] & self.reg(0x0c) >> 8;
        if self.stalled && which == self.system {
            self.stalled = false;
            shared.effect(Effect::Frequency(self.clocks.hclk_hz));
        } else if self.stalled && which == self.pll_source() {
            self.start(PLL, shared);
        }
    }
}

impl Peripheral for Rcc {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            0x00 => self.read_cr(),
            0x08 => self.reg(8) | (self.system as u32) << 2,
            0x0c => self.reg(0x0c) | self.flags,
            CSR => self.causes | u32::from(self.oscillators[SLOW].ready) << 1 | self.reg(CSR),
            _ => self.reg(offset),
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        let old = self.reg(offset);
        let value = merge(old, value, mask);
        match offset {
            0x00 => self.write_cr(value, shared),
            0x04 if old != value && self.reg(0) & PLLON != 0 => {
                shared.note(
                    FindingKind::Forbidden,
                    "RCC_PLLCFGR written while the PLL is on",
                );
            }
            0x08 => self.write_cfgr(value, shared),
            0x0c => {
                self.flags &= !(value >> 16 & 0xbf);
                *self.reg_mut(0x0c) = value & 0x3f00;
                self.line(shared);
            }
            0x10..=0x24 => self.write_reset(offset, value, shared),
            BDCR => self.write_backup(value, shared),
            CSR => self.write_csr(value, shared),
            0x80 if value & 1 << 31 != 0 => {
                shared.note(FindingKind::NotModelled, "spread spectrum")
            }
            _ => *self.reg_mut(offset) = value,
        }
    }

    fn event(&mut self, shared: &mut Shared) {
        let now = shared.time();
        let is_due = |due: Option<Time>| due.is_some_and(|due| due <= now);
        if is_due(self.release) {
            self.release = None;
        }
        for which in [INTERNAL, CRYSTAL, PLL, SLOW] {
            if is_due(self.oscillators[which].due) {
                self.set_ready(which, shared);
            }
        }
        self.follow_switch(shared);
        self.line(shared);
        self.update_rtc_clock_and_schedule(shared);
    }

    fn clocks_changed(&mut self, shared: &mut Shared) {
        self.update_rtc_clock_and_schedule(shared);
    }
}

#[cfg(test)]
mod tests;
