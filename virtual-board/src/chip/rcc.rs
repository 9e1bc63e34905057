//! Reset and clock control: oscillators, PLL, clocks of buses and peripherals, causes of resets.
//!
//! Source: reference manual RM0090, chapter 7 (STM32F405). Start-up times are typical ones of the data
//! sheet; ready flags come after them. A clock beyond its limit is a finding when it is switched.
//!
//! Not modelled: MCO outputs, PLLI2S, LSE and the real-time clock, spread spectrum; switching one of
//! them on is a finding. Enables for sleep are kept and do nothing.

use super::Peripheral;
use super::interrupt::Interrupt;
use super::register::{Register, merge, word};
use super::shared::{Clocks, Effect, Shared, Source};
use crate::finding::Kind;
use crate::time::{NEVER, Time, Timebase};

/// Why the chip was reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power came on.
    PowerOn,
    /// The supply sagged below the brown-out level.
    BrownOut,
    /// The reset pin.
    Pin,
    /// The program.
    Software,
    /// The independent watchdog.
    Watchdog,
}

impl Cause {
    /// The name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::PowerOn => "power on",
            Self::BrownOut => "brown-out",
            Self::Pin => "reset pin",
            Self::Software => "software",
            Self::Watchdog => "watchdog",
        }
    }

    /// Flags of CSR that the reset sets: an internal reset pulls the pin low too.
    fn flags(self) -> u32 {
        PINRSTF
            | match self {
                Self::PowerOn => PORRSTF | BORRSTF,
                Self::BrownOut => BORRSTF,
                Self::Pin => 0,
                Self::Software => SFTRSTF,
                Self::Watchdog => IWDGRSTF,
            }
    }
}

// Flags of CSR.
const BORRSTF: u32 = 1 << 25;
const PINRSTF: u32 = 1 << 26;
const PORRSTF: u32 = 1 << 27;
const SFTRSTF: u32 = 1 << 28;
const IWDGRSTF: u32 = 1 << 29;
const CAUSES: u32 = 0xfe00_0000;

/// Frequency of the crystal, Hz.
const CRYSTAL_HZ: u64 = 8_000_000;
/// Frequency of the internal oscillator, Hz.
const INTERNAL_HZ: u64 = 16_000_000;
/// Start-up of crystal, internal oscillator, slow oscillator and PLL.
const CRYSTAL_START: Time = Time::from_micros(2_000);
const INTERNAL_START: Time = Time::from_nanos(2_200);
const SLOW_START: Time = Time::from_micros(15);
const PLL_LOCK: Time = Time::from_micros(100);

/// Registers.
#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    word(0x00, "CR", 0x0f0f_fffb), word(0x04, "PLLCFGR", 0x2f43_7fff), word(0x08, "CFGR", 0xffff_fcff),
    word(0x0c, "CIR", 0x00bf_3fbf), word(0x10, "AHB1RSTR", 0x2260_11ff), word(0x14, "AHB2RSTR", 0xf1),
    word(0x18, "AHB3RSTR", 1), word(0x20, "APB1RSTR", 0x36fe_c9ff), word(0x24, "APB2RSTR", 0x0007_5933),
    word(0x30, "AHB1ENR", 0x7e74_11ff), word(0x34, "AHB2ENR", 0xf1), word(0x38, "AHB3ENR", 1),
    word(0x40, "APB1ENR", 0x36fe_c9ff), word(0x44, "APB2ENR", 0x0007_5f33),
    word(0x50, "AHB1LPENR", 0x7e67_91ff), word(0x54, "AHB2LPENR", 0xf1), word(0x58, "AHB3LPENR", 1),
    word(0x60, "APB1LPENR", 0x36fe_c9ff), word(0x64, "APB2LPENR", 0x0007_5f33),
    word(0x70, "BDCR", 0x0001_8307), word(0x74, "CSR", 0xff00_0003), word(0x80, "SSCGR", 0xcfff_ffff),
    word(0x84, "PLLI2SCFGR", 0x7000_7fc0),
    // Of the STM32F42x; here it reads as zero, and drivers for the whole family look at it.
    word(0x8c, "DCKCFGR", 0),
];

/// What comes up some time after it is switched on: its enable bit in CR (or CSR), and its ready bit.
#[derive(Clone, Copy, Debug, Default)]
struct Oscillator {
    ready: bool,
    /// When it is ready.
    due: Option<Time>,
}

/// Oscillators at their index.
const INTERNAL: usize = 0;
const CRYSTAL: usize = 1;
const PLL: usize = 2;
const SLOW: usize = 3;

/// What a reset leaves as it is.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Kept {
    causes: u32,
    crystal_dead: bool,
}

/// Reset and clock control.
pub(crate) struct Rcc {
    /// Registers that only hold what is written, by offset over 4.
    plain: [u32; 36],
    oscillators: [Oscillator; 4],
    /// What the core runs on: 0 internal, 1 crystal, 2 PLL.
    system: u32,
    causes: u32,
    /// Ready flags of CIR, and that of the clock security system.
    flags: u32,
    crystal_dead: bool,
    hclk_hz: u64,
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
            system: 0,
            causes: 0,
            flags: 0,
            crystal_dead: false,
            hclk_hz: INTERNAL_HZ,
        }
    }
}

impl Rcc {
    /// What is kept over a reset.
    pub fn kept(&self, cause: Cause) -> Kept {
        Kept {
            causes: if cause == Cause::PowerOn {
                0
            } else {
                self.causes
            },
            crystal_dead: self.crystal_dead,
        }
    }

    /// After a reset.
    pub fn begin(&mut self, kept: Kept, cause: Cause) {
        self.causes = kept.causes | cause.flags();
        self.crystal_dead = kept.crystal_dead;
    }

    /// Whether a bit of an enable register is set.
    pub fn is_enabled(&self, register: u32, bit: u32) -> bool {
        self.plain[register as usize / 4] >> bit & 1 != 0
    }

    /// Frequency of the core, Hz.
    pub fn hclk_hz(&self) -> u64 {
        self.hclk_hz
    }

    /// The crystal works or fails.
    pub fn crystal(&mut self, works: bool, shared: &mut Shared) {
        self.crystal_dead = !works;
        let on = self.plain[0] & 1 << 16 != 0;
        if works {
            if on && !self.oscillators[CRYSTAL].ready {
                self.start(CRYSTAL, CRYSTAL_START, shared);
            }
            return;
        }
        let ran = self.oscillators[CRYSTAL].ready;
        self.oscillators[CRYSTAL] = Oscillator::default();
        let used = self.system == 1 || self.system == 2 && self.pll_of_crystal();
        if on && ran && self.plain[0] & 1 << 19 != 0 {
            // Clock security: crystal and PLL off, the core goes on with the internal oscillator.
            self.plain[0] &= !(1 << 16 | 1 << 24 | 1 << 19);
            self.oscillators[PLL] = Oscillator::default();
            self.plain[0] |= 1;
            self.oscillators[INTERNAL].ready = true;
            self.flags |= 1 << 7;
            if used {
                self.plain[2] &= !3;
                self.switch(0, shared);
            }
            shared.effect(Effect::ClockFailure);
        } else if used {
            // The PLL goes on at its lowest frequency, 100 MHz at most; nobody knows which.
            shared.note(
                Kind::ClockLimit,
                "the crystal failed without clock security: the core stands still",
            );
            shared.effect(Effect::Frequency(0));
        }
    }

    fn pll_of_crystal(&self) -> bool {
        self.plain[1] & 1 << 22 != 0
    }

    fn start(&mut self, which: usize, after: Time, shared: &mut Shared) {
        let at = shared.time() + after;
        self.oscillators[which].due = Some(at);
        self.plan(shared);
    }

    fn plan(&self, shared: &mut Shared) {
        let next = self
            .oscillators
            .iter()
            .filter_map(|oscillator| oscillator.due)
            .min();
        let cycle = next.map_or(NEVER, |at| shared.base.cycle_of(at).max(shared.now + 1));
        shared.schedule(Source::Rcc, cycle);
    }

    /// Output of the PLL for the core, and of its voltage-controlled oscillator and input, Hz.
    fn pll(&self) -> [u64; 3] {
        let c = self.plain[1];
        let source = if self.pll_of_crystal() {
            CRYSTAL_HZ
        } else {
            INTERNAL_HZ
        };
        let input = source / u64::from((c & 63).max(1));
        let vco = input * u64::from(c >> 6 & 511);
        [vco / u64::from(2 * (c >> 16 & 3) + 2), vco, input]
    }

    /// Judges the settings of the PLL as it is switched on.
    fn judge_pll(&self, shared: &mut Shared) {
        let [out, vco, input] = self.pll();
        let (m, n) = (self.plain[1] & 63, self.plain[1] >> 6 & 511);
        for (wrong, text) in [
            (
                !(2..=63).contains(&m),
                format!("PLLM = {m}: must be 2 to 63"),
            ),
            (
                !(50..=432).contains(&n),
                format!("PLLN = {n}: must be 50 to 432"),
            ),
            (
                !(950_000..=2_100_000).contains(&input),
                format!("PLL input {input} Hz: must be 1 to 2 MHz"),
            ),
            (
                !(100_000_000..=432_000_000).contains(&vco),
                format!("PLL oscillator {vco} Hz: must be 100 to 432 MHz"),
            ),
            (
                out > 168_000_000,
                format!("PLL output {out} Hz: must be at most 168 MHz"),
            ),
        ] {
            if wrong {
                shared.note(Kind::ClockLimit, text);
            }
        }
        let source = if self.pll_of_crystal() {
            CRYSTAL
        } else {
            INTERNAL
        };
        if !self.oscillators[source].ready {
            shared.note(
                Kind::Forbidden,
                "PLL switched on before its source is ready",
            );
        }
    }

    /// The core goes on with another clock.
    fn switch(&mut self, system: u32, shared: &mut Shared) {
        self.system = system;
        self.update(shared);
    }

    /// Frequencies anew.
    fn update(&mut self, shared: &mut Shared) {
        let source = match self.system {
            0 => INTERNAL_HZ,
            1 => CRYSTAL_HZ,
            _ => self.pll()[0],
        };
        let cfgr = self.plain[2];
        let ahb = match cfgr >> 4 & 15 {
            0..=7 => 1,
            k => [2, 4, 8, 16, 64, 128, 256, 512][k as usize - 8],
        };
        let apb = |bits: u32| if bits < 4 { 1 } else { 2u64 << (bits - 4) };
        let (apb1, apb2) = (apb(cfgr >> 10 & 7), apb(cfgr >> 13 & 7));
        let hclk = source / ahb;
        let timer = |apb: u64| if apb == 1 { 1 } else { apb / 2 };
        let clocks = Clocks {
            hclk_hz: hclk,
            apb1,
            apb2,
            timer1: timer(apb1),
            timer2: timer(apb2),
        };
        for (name, hz, most) in [
            ("HCLK", hclk, 168_000_000),
            ("PCLK1", hclk / apb1, 42_000_000),
            ("PCLK2", hclk / apb2, 84_000_000),
        ] {
            if hz > most {
                shared.note(
                    Kind::ClockLimit,
                    format!("{name} {hz} Hz: must be at most {most} Hz"),
                );
            }
        }
        let changed = hclk != self.hclk_hz;
        self.hclk_hz = hclk;
        shared.clocks = Clocks {
            hclk_hz: shared.clocks.hclk_hz,
            ..clocks
        };
        if changed {
            shared.effect(Effect::Frequency(hclk));
        }
    }

    fn write_cr(&mut self, value: u32, shared: &mut Shared) {
        let old = self.plain[0];
        let on = |bit: u32| value >> bit & 1 != 0 && old >> bit & 1 == 0;
        let off = |bit: u32| value >> bit & 1 == 0 && old >> bit & 1 != 0;
        let used = [self.system == 0, self.system == 1, self.system == 2];
        for (which, bit) in [(INTERNAL, 0), (CRYSTAL, 16), (PLL, 24)] {
            if off(bit) {
                if used[which] {
                    shared.note(
                        Kind::Forbidden,
                        "the oscillator that the core runs on is switched off",
                    );
                    return;
                }
                self.oscillators[which] = Oscillator::default();
            }
        }
        self.plain[0] = value & 0x050d_00f9;
        if on(0) {
            self.start(INTERNAL, INTERNAL_START, shared);
        }
        if on(16) && !self.crystal_dead {
            self.start(CRYSTAL, CRYSTAL_START, shared);
        }
        if on(24) {
            self.judge_pll(shared);
            self.start(PLL, PLL_LOCK, shared);
        }
        if on(26) {
            shared.note(Kind::NotModelled, "PLLI2S");
        }
    }

    fn write_cfgr(&mut self, value: u32, shared: &mut Shared) {
        let old = self.plain[2];
        self.plain[2] = value & !0xc;
        if (value ^ old) & 0x67e0_0000 & value != 0 {
            shared.note(Kind::NotModelled, "clock output MCO");
        }
        let wanted = value & 3;
        if wanted == 3 {
            shared.note(Kind::Forbidden, "RCC_CFGR: SW = 3");
        } else if wanted != self.system {
            let ready = self.oscillators[wanted as usize].ready;
            if ready {
                return self.switch(wanted, shared);
            }
            // The switch waits until the oscillator is ready.
        }
        if (value ^ old) & 0xfcf0 != 0 {
            self.update(shared);
        }
    }

    fn read_cr(&self) -> u32 {
        let ready = |which: usize, bit: u32| u32::from(self.oscillators[which].ready) << bit;
        self.plain[0] | ready(INTERNAL, 1) | ready(CRYSTAL, 17) | ready(PLL, 25) | 0x80 << 8
    }

    fn line(&self, shared: &mut Shared) {
        let enabled = self.plain[3] >> 8 & 0x3f;
        shared.line(Interrupt::Rcc, self.flags & 0x3f & enabled != 0);
    }
}

impl Peripheral for Rcc {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            0x00 => self.read_cr(),
            0x08 => self.plain[2] | self.system << 2,
            0x0c => self.plain[3] & 0x3f00 | self.flags,
            0x74 => {
                let slow = u32::from(self.oscillators[SLOW].ready) << 1;
                self.causes | slow | self.plain[0x1d] & 1
            }
            _ => self.plain[offset as usize / 4],
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        let place = offset as usize / 4;
        let old = self.plain[place];
        let value = merge(old, value, mask);
        match offset {
            0x00 => self.write_cr(value, shared),
            0x04 => {
                if self.plain[0] & 1 << 24 != 0 && value != old {
                    shared.note(Kind::Forbidden, "RCC_PLLCFGR written while the PLL is on");
                } else {
                    self.plain[1] = value;
                }
            }
            0x08 => self.write_cfgr(value, shared),
            0x0c => {
                self.flags &= !(value >> 16 & 0xbf);
                self.plain[3] = value & 0x3f00;
                self.line(shared);
            }
            0x10..=0x24 => {
                for bit in 0..32 {
                    if value >> bit & 1 != 0 && old >> bit & 1 == 0 {
                        shared.effect(Effect::ResetUnit(offset + 0x20, bit));
                    }
                }
                self.plain[place] = value;
            }
            0x74 => {
                if value & 1 << 24 != 0 {
                    self.causes = 0;
                }
                if value & 1 != 0 && old & 1 == 0 {
                    self.start(SLOW, SLOW_START, shared);
                } else if value & 1 == 0 {
                    self.oscillators[SLOW] = Oscillator::default();
                }
                self.plain[place] = value & 1;
            }
            0x70 => {
                if value & 1 != 0 {
                    shared.note(Kind::NotModelled, "the slow crystal (LSE)");
                }
                self.plain[place] = value & 0x0001_8304;
            }
            0x80 if value & 1 << 31 != 0 => shared.note(Kind::NotModelled, "spread spectrum"),
            _ => self.plain[place] = value,
        }
    }

    fn event(&mut self, _source: Source, shared: &mut Shared) {
        let now = shared.time();
        for (which, flag) in [(INTERNAL, 2), (CRYSTAL, 3), (PLL, 4), (SLOW, 0)] {
            let oscillator = &mut self.oscillators[which];
            if oscillator.due.is_some_and(|due| due <= now) {
                *oscillator = Oscillator {
                    ready: true,
                    due: None,
                };
                self.flags |= 1 << flag;
            }
        }
        let wanted = self.plain[2] & 3;
        if wanted < 3 && wanted != self.system && self.oscillators[wanted as usize].ready {
            self.switch(wanted, shared);
        }
        self.line(shared);
        self.plan(shared);
    }

    fn clocks_changed(&mut self, _old: &Timebase, shared: &mut Shared) {
        self.plan(shared);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    /// Runs what is due until nothing is, or `until`.
    fn pass(rcc: &mut Rcc, shared: &mut Shared, micros: u64) {
        let end = shared.after(Time::from_micros(micros));
        while shared.due(Source::Rcc) <= end {
            shared.now = shared.due(Source::Rcc);
            shared.schedule(Source::Rcc, NEVER);
            rcc.event(Source::Rcc, shared);
        }
        shared.now = end;
    }

    fn start(rcc: &mut Rcc, shared: &mut Shared) {
        rcc.write(0x00, 0x0001_0081, !0, shared);
        assert_eq!(rcc.read(0x00, shared) & 1 << 17, 0, "not at once");
        pass(rcc, shared, 2_100);
        assert_ne!(rcc.read(0x00, shared) & 1 << 17, 0);
        // 8 MHz / 4 · 168 / 2.
        rcc.write(0x04, 0x2040_2a04 | 7 << 24, !0, shared);
        rcc.write(0x00, 0x0101_0081, !0, shared);
        rcc.write(0x08, 0x0000_9402, !0, shared);
        pass(rcc, shared, 200);
    }

    #[test]
    fn the_manuals_way_to_168_mhz() {
        let (mut rcc, mut shared) = (Rcc::default(), shared());
        start(&mut rcc, &mut shared);
        assert_eq!(rcc.read(0x08, &mut shared) >> 2 & 3, 2);
        assert_eq!(rcc.hclk_hz(), 168_000_000);
        assert!(shared.effects.contains(&Effect::Frequency(168_000_000)));
        let Clocks {
            apb1,
            apb2,
            timer1,
            timer2,
            ..
        } = shared.clocks;
        assert_eq!([apb1, apb2, timer1, timer2], [4, 2, 2, 1]);
        assert!(
            shared.findings.list().is_empty(),
            "{:?}",
            shared.findings.list()
        );
    }

    #[test]
    fn clocks_beyond_their_limits_are_found() {
        let (mut rcc, mut shared) = (Rcc::default(), shared());
        start(&mut rcc, &mut shared);
        // APB1 at 84 MHz.
        rcc.write(0x08, 0x0000_9002, !0, &mut shared);
        let found = shared.findings.list();
        assert!(
            found.len() == 1 && found[0].text.contains("PCLK1 84000000"),
            "{found:?}"
        );
    }

    #[test]
    fn clock_security_takes_over_when_the_crystal_fails() {
        let (mut rcc, mut shared) = (Rcc::default(), shared());
        start(&mut rcc, &mut shared);
        rcc.write(0x00, 0x0109_0081, !0, &mut shared);
        shared.effects.clear();
        rcc.crystal(false, &mut shared);
        assert_eq!(rcc.hclk_hz(), INTERNAL_HZ);
        assert!(shared.effects.contains(&Effect::ClockFailure));
        assert_ne!(rcc.read(0x0c, &mut shared) & 1 << 7, 0);
        rcc.write(0x0c, 1 << 23, !0, &mut shared);
        assert_eq!(rcc.read(0x0c, &mut shared) & 1 << 7, 0);
    }

    #[test]
    fn causes_add_up_until_they_are_cleared() {
        let mut rcc = Rcc::default();
        let mut shared = shared();
        rcc.begin(Kept::default(), Cause::PowerOn);
        assert_eq!(rcc.read(0x74, &mut shared) & CAUSES, 0x0e00_0000);
        let kept = rcc.kept(Cause::Watchdog);
        let mut rcc = Rcc::default();
        rcc.begin(kept, Cause::Watchdog);
        assert_eq!(rcc.read(0x74, &mut shared) & CAUSES, 0x2e00_0000);
        rcc.write(0x74, 1 << 24, !0, &mut shared);
        assert_eq!(rcc.read(0x74, &mut shared) & CAUSES, 0);
    }
}
