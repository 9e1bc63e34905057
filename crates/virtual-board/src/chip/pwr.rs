//! Power control: voltage scaling, voltage detector, brown-out.
//!
//! Source: reference manual RM0090, chapter 5; thresholds are typical ones of the data sheet (embedded
//! reset and power control block). The regulator is ready at once.
//!
//! Not modelled: stop and standby modes, wake-up pin, backup regulator; asking for one is a finding.

use super::Peripheral;
use super::effect::Effect;
use super::register::{Register, merge, narrow};
use super::shared::Shared;
use crate::finding::Kind;

// The part has one bit of VOS; HALs of the family write the two of its larger relatives, so that bit 15
// counts as one.
const REGISTERS: &[Register] = &[
    narrow(0x00, "CR", 0x0000_c3ff),
    narrow(0x04, "CSR", 0x0000_430f),
];

// Bits of CR.
bits! {
    LPDS 0, PDDS 1, PVDE 4, DBP 8, FPDS 9, VOS 14
}
const PLS: u32 = 7 << 5;
// Bits of CSR.
bits! {
    PVDO 2, EWUP 8, BRE 9, VOSRDY 14
}

/// Below the lower one the detector or reset acts, above the upper one it lets go, mV.
#[derive(Clone, Copy)]
struct Threshold {
    falls: u32,
    rises: u32,
}

const fn threshold(falls: u32, rises: u32) -> Threshold {
    Threshold { falls, rises }
}

impl Threshold {
    /// Whether a supply is too low, V, that was so before or not; one that is not a number is.
    fn is_low(self, volts: f64, before: bool) -> bool {
        let limit = if before { self.rises } else { self.falls };
        !is_at_least(volts, limit)
    }
}

fn is_at_least(volts: f64, millivolts: u32) -> bool {
    volts * 1e3 >= f64::from(millivolts)
}

/// Of the reset, by the brown-out level of the option bytes: 0 is level 3, 3 is off.
const BROWN_OUT: [Threshold; 4] = [
    threshold(2830, 2920),
    threshold(2500, 2590),
    threshold(2190, 2290),
    POWER,
];
/// Of the power-on and power-down reset, which is always there.
const POWER: Threshold = threshold(1680, 1720);
/// Of the voltage detector by PLS.
const DETECTOR: [Threshold; 8] = [
    threshold(2040, 2140),
    threshold(2190, 2300),
    threshold(2350, 2450),
    threshold(2510, 2600),
    threshold(2660, 2760),
    threshold(2840, 2930),
    threshold(2930, 3030),
    threshold(3030, 3140),
];

/// Below this supply static memory forgets, mV.
const RETENTION: u32 = 1200;

/// Whether a supply holds the chip in reset, which was so before or not, at this brown-out level.
pub(crate) fn holds(volts: f64, level: u32, held: bool) -> bool {
    BROWN_OUT[level as usize & 3].is_low(volts, held)
}

/// Whether a supply is so low that the next start is a power-on.
pub(crate) fn is_off(volts: f64) -> bool {
    POWER.is_low(volts, false)
}

/// Whether static memory keeps its contents.
pub(crate) fn is_remembered(volts: f64) -> bool {
    is_at_least(volts, RETENTION)
}

/// Power control.
#[derive(Clone)]
pub(crate) struct Pwr {
    cr: u32,
    csr: u32,
    /// The voltage detector has seen the supply fall below its threshold, and not rise above it since.
    low: bool,
}

impl Default for Pwr {
    fn default() -> Self {
        Self {
            cr: VOS,
            csr: 0,
            low: false,
        }
    }
}

impl Pwr {
    /// The supply or the threshold is another.
    pub fn detect(&mut self, shared: &mut Shared) {
        let threshold = DETECTOR[(self.cr & PLS) as usize >> 5];
        let low = self.cr & PVDE != 0 && threshold.is_low(shared.volts, self.low);
        if low != self.low {
            self.low = low;
            shared.effect(Effect::VoltageDetector { low });
        }
    }

    /// Whether scale 1 is set, which clocks above 144 MHz need.
    pub fn is_scale_1(&self) -> bool {
        self.cr & VOS != 0
    }

    /// Whether the program may write the backup domain.
    pub fn is_backup_open(&self) -> bool {
        self.cr & DBP != 0
    }
}

impl Peripheral for Pwr {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            0x04 => self.csr | VOSRDY | if self.low { PVDO } else { 0 },
            _ => self.cr,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        let (old, off) = match offset {
            0x04 => (self.csr, EWUP | BRE),
            _ => (self.cr, LPDS | PDDS | FPDS),
        };
        let value = merge(old, value, mask);
        if value & !old & off != 0 {
            let text = "PWR: stop and standby modes, wake-up pin, backup regulator";
            shared.note(Kind::NotModelled, text);
        }
        if offset == 0x04 {
            self.csr = value & (EWUP | BRE);
        } else {
            // CWUF and CSBF only clear.
            self.cr = value & (LPDS | PDDS | PVDE | PLS | DBP | FPDS | VOS);
            self.detect(shared);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    #[test]
    fn brown_out_holds_until_the_supply_has_risen_above_its_hysteresis() {
        // Level 3 by the data sheet: 2.75 to 2.88 V falling, 2.85 to 2.97 V rising.
        assert!(!holds(2.89, 0, false));
        assert!(holds(2.74, 0, false));
        assert!(holds(2.84, 0, true));
        assert!(!holds(2.98, 0, true));
        // Off: only the power-down reset at 1.60 to 1.76 V.
        assert!(!holds(1.77, 3, false));
        assert!(holds(1.59, 3, false));
        assert!(holds(f64::NAN, 3, false));
        assert!(is_off(1.59) && !is_off(1.77));
    }

    #[test]
    fn the_detector_shows_a_low_supply_with_hysteresis() {
        let (mut pwr, mut shared) = (Pwr::default(), shared());
        shared.volts = 3.2;
        pwr.write(0x00, VOS | PVDE | PLS, !0, &mut shared);
        assert!(shared.effects.is_empty());
        // Level 7 by the data sheet: 2.95 to 3.09 V falling, 3.07 to 3.21 V rising.
        let mut seen = Vec::new();
        for volts in [3.1, 2.94, 3.06, 3.22] {
            shared.volts = volts;
            pwr.detect(&mut shared);
            seen.push(pwr.read(0x04, &mut shared) & PVDO != 0);
        }
        assert_eq!(seen, [false, true, true, false]);
        let told = [
            Effect::VoltageDetector { low: true },
            Effect::VoltageDetector { low: false },
        ];
        assert!(shared.effects.iter().eq(&told));
    }

    #[test]
    fn the_detector_that_is_switched_on_at_a_low_supply_tells_at_once() {
        let (mut pwr, mut shared) = (Pwr::default(), shared());
        shared.volts = 2.0;
        pwr.detect(&mut shared);
        assert!(shared.effects.is_empty(), "it is off");
        pwr.write(0x00, VOS | PVDE, !0, &mut shared);
        assert_eq!(
            shared.effects.back(),
            Some(&Effect::VoltageDetector { low: true })
        );
    }
}
