//! Power control: voltage scaling, voltage detector, brown-out.
//!
//! Source: reference manual RM0090, chapter 5; thresholds are typical ones of the data sheet. Not
//! modelled: stop and standby modes, backup regulator; asking for one is a finding.

use super::Peripheral;
use super::register::{Register, merge, word};
use super::shared::{Effect, Shared};
use crate::finding::Kind;

const REGISTERS: &[Register] = &[
    word(0x00, "CR", 0x0000_ffff),
    word(0x04, "CSR", 0x0000_430f),
];

/// Reset below this supply, by the brown-out level of the option bytes (0 is level 3), falling, V.
const BROWN_OUT_V: [f64; 4] = [2.70, 2.40, 2.12, 1.70];
/// It is let go when the supply has risen by so much above that, V.
const HYSTERESIS_V: f64 = 0.1;
/// Below this supply static memory forgets, V.
const RETENTION_V: f64 = 1.2;
/// Thresholds of the voltage detector by PLS, falling, V.
const DETECTOR_V: [f64; 8] = [2.0, 2.1, 2.3, 2.5, 2.6, 2.7, 2.8, 2.9];

/// What the supply does to the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Supplied {
    /// It runs.
    On,
    /// It is held in reset.
    Held,
    /// It is held in reset and has forgotten its memory.
    Forgetting,
}

/// Power control.
pub(crate) struct Pwr {
    cr: u32,
    csr: u32,
    volts: f64,
}

impl Default for Pwr {
    fn default() -> Self {
        Self {
            cr: 0x4000,
            csr: 0,
            volts: 3.3,
        }
    }
}

impl Pwr {
    /// The supply, V.
    pub fn volts(&self) -> f64 {
        self.volts
    }

    /// The supply is another, V; what that does with this brown-out level to a chip that was held in
    /// reset or not.
    pub fn supply(&mut self, volts: f64, level: u32, held: bool, shared: &mut Shared) -> Supplied {
        self.volts = volts;
        let limit = BROWN_OUT_V[level as usize & 3] + if held { HYSTERESIS_V } else { 0.0 };
        self.detect(shared);
        if volts >= limit {
            Supplied::On
        } else if volts >= RETENTION_V {
            Supplied::Held
        } else {
            Supplied::Forgetting
        }
    }

    fn is_low(&self) -> bool {
        self.cr & 1 << 4 != 0 && self.volts < DETECTOR_V[(self.cr >> 5 & 7) as usize]
    }

    fn detect(&self, shared: &mut Shared) {
        shared.effect(Effect::VoltageDetector(self.is_low()));
    }

    /// Whether scale 1 is set, which clocks above 144 MHz need.
    pub fn is_scale_1(&self) -> bool {
        self.cr & 1 << 14 != 0
    }
}

impl Peripheral for Pwr {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            // The regulator is ready at once.
            0x04 => self.csr | 1 << 14 | u32::from(self.is_low()) << 2,
            _ => self.cr,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        if offset == 0x04 {
            if value & 0x300 != 0 {
                shared.note(Kind::NotModelled, "PWR: wake-up pin, backup regulator");
            }
            return;
        }
        // CWUF and CSBF only clear.
        self.cr = merge(self.cr, value, mask) & 0x43f3;
        self.detect(shared);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    #[test]
    fn brown_out_holds_until_the_supply_has_risen_above_its_hysteresis() {
        let (mut pwr, mut shared) = (Pwr::default(), shared());
        assert_eq!(pwr.supply(2.71, 0, false, &mut shared), Supplied::On);
        assert_eq!(pwr.supply(2.69, 0, false, &mut shared), Supplied::Held);
        assert_eq!(pwr.supply(2.75, 0, true, &mut shared), Supplied::Held);
        assert_eq!(pwr.supply(2.81, 0, true, &mut shared), Supplied::On);
        assert_eq!(pwr.supply(2.0, 3, false, &mut shared), Supplied::On);
        assert_eq!(pwr.supply(1.0, 3, false, &mut shared), Supplied::Forgetting);
    }

    #[test]
    fn the_detector_shows_a_low_supply() {
        let (mut pwr, mut shared) = (Pwr::default(), shared());
        pwr.write(0x00, 0x4000 | 1 << 4 | 7 << 5, !0, &mut shared);
        pwr.supply(2.85, 0, false, &mut shared);
        assert_ne!(pwr.read(0x04, &mut shared) & 1 << 2, 0);
        assert_eq!(shared.effects.back(), Some(&Effect::VoltageDetector(true)));
    }
}
