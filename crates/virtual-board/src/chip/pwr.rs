//! Power control: voltage scaling, voltage detector, brown-out.
//!
//! Source: reference manual RM0090, chapter 5. Thresholds are the typical values of the data sheet (embedded reset and
//! power control block). The regulator is always ready.
//!
//! Not modelled: stop and standby modes, wake-up pin, backup regulator; enabling one of these is a finding.

use super::Peripheral;
use super::effect::Effect;
use super::register::{Register, merge, narrow};
use super::shared::Shared;
use crate::finding::FindingKind;

// VOS is one bit on this chip. HALs of the family write the two bits of larger chips, so bit 15 is not treated as
// reserved.
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

/// Voltage threshold with hysteresis, mV: a supply below `falls` is low until it reaches `rises`.
#[derive(Clone, Copy)]
struct Threshold {
    falls: u32,
    rises: u32,
}

const fn threshold(falls: u32, rises: u32) -> Threshold {
    Threshold { falls, rises }
}

impl Threshold {
    /// True if the supply, V, is too low; `before` is the previous state. NaN is too low.
    fn is_low(self, volts: f64, before: bool) -> bool {
        let limit = if before { self.rises } else { self.falls };
        !is_at_least(volts, limit)
    }
}

fn is_at_least(volts: f64, millivolts: u32) -> bool {
    volts * 1e3 >= f64::from(millivolts)
}

/// Thresholds of the brown-out reset by the level in the option bytes: 0 is level 3, 3 is off.
const BROWN_OUT: [Threshold; 4] = [
    threshold(2830, 2920),
    threshold(2500, 2590),
    threshold(2190, 2290),
    POWER,
];
/// Threshold of the power-on and power-down reset, which is always active.
const POWER: Threshold = threshold(1680, 1720);
/// Thresholds of the voltage detector by PLS.
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

/// Supply below which static memory loses its content, mV.
const RETENTION: u32 = 1200;

/// True if the supply holds the chip in reset at this brown-out level; `held` is the previous state.
pub(crate) fn holds(volts: f64, level: u32, held: bool) -> bool {
    BROWN_OUT[level as usize & 3].is_low(volts, held)
}

/// True if a supply is so low that the next start is a power-on.
pub(crate) fn is_off(volts: f64) -> bool {
    POWER.is_low(volts, false)
}

/// True if static memory keeps its content at this supply.
pub(crate) fn is_remembered(volts: f64) -> bool {
    is_at_least(volts, RETENTION)
}

#[derive(Clone)]
pub(crate) struct Pwr {
    cr: u32,
    csr: u32,
    /// Output of the voltage detector: true if the supply fell below the lower threshold and has not reached the upper
    /// threshold since.
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
    /// Updates the voltage detector after a change of supply or threshold.
    pub fn detect(&mut self, shared: &mut Shared) {
        let threshold = DETECTOR[(self.cr & PLS) as usize >> 5];
        let low = self.cr & PVDE != 0 && threshold.is_low(shared.volts, self.low);
        if low != self.low {
            self.low = low;
            shared.effect(Effect::VoltageDetector { low });
        }
    }

    /// True if the regulator is at scale 1, which clocks above 144 MHz need.
    pub fn is_scale_1(&self) -> bool {
        self.cr & VOS != 0
    }

    /// True if the program may write to the backup domain.
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
            shared.note(FindingKind::NotModelled, text);
        }
        if offset == 0x04 {
            self.csr = value & (EWUP | BRE);
        } else {
            // CWUF and CSBF only clear flags, which are not modelled.
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
    fn brown_out_holds_until_the_supply_exceeds_the_rising_threshold() {
        // Level 3 in the data sheet: 2.75 to 2.88 V falling, 2.85 to 2.97 V rising.
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
    fn voltage_detector_reports_low_supply_with_hysteresis() {
        let (mut pwr, mut shared) = (Pwr::default(), shared());
        shared.volts = 3.2;
        pwr.write(0x00, VOS | PVDE | PLS, !0, &mut shared);
        assert!(shared.effects.is_empty());
        // Level 7 in the data sheet: 2.95 to 3.09 V falling, 3.07 to 3.21 V rising.
        let mut outputs = Vec::new();
        for volts in [3.1, 2.94, 3.06, 3.22] {
            shared.volts = volts;
            pwr.detect(&mut shared);
            outputs.push(pwr.read(0x04, &mut shared) & PVDO != 0);
        }
        assert_eq!(outputs, [false, true, true, false]);
        let expected = [
            Effect::VoltageDetector { low: true },
            Effect::VoltageDetector { low: false },
        ];
        assert!(shared.effects.iter().eq(&expected));
    }

    #[test]
    fn voltage_detector_enabled_at_low_supply_reports_at_once() {
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
