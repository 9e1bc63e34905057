//! Slow analog channels: temperature from a thermistor, supply voltage behind a divider.

use crate::config::{ConfigError, declare};
use crate::math::trig::ln;

declare! {
    /// A thermistor from the pin to ground, and a fixed resistor from the pin to the converter's reference:
    /// `ln(R/R₂₅) = B (1/T − 1/298.15 K)`. Ratiometric: the reference voltage cancels.
    pub struct ThermistorConfig {
        /// Resistance at 25 °C (R₂₅).
        pub resistance_25_ohm: f32 = 10e3, "Ω": Range(10.0, 1e7);
        /// B value of the thermistor.
        pub b_k: f32 = 3950.0, "K": Range(1000.0, 10_000.0);
        /// Fixed resistor.
        pub pull_up_ohm: f32 = 10e3, "Ω": Range(10.0, 1e7);
    }
}

impl ThermistorConfig {
    /// Builds the validated channel; the error names the invalid field.
    pub fn build(&self) -> Result<Thermistor, ConfigError> {
        self.check_ranges()?;
        let nominal = self.resistance_25_ohm;
        let pull_up = self.pull_up_ohm;
        Ok(Thermistor {
            per_b: 1.0 / self.b_k,
            ratio: pull_up / nominal,
        })
    }
}

/// Thermistor channel with checked constants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thermistor {
    per_b: f32,
    ratio: f32,
}

/// Temperature of the nominal resistance R₂₅, 25 °C, in K.
const T25_K: f32 = 298.15;

impl Thermistor {
    /// Temperature, °C, at `count` of `full` counts. `None` within 1 % of either end of the range: the thermistor is
    /// open or shorted.
    pub fn read(&self, count: f32, full: f32) -> Option<f32> {
        let share = count / full;
        if !(share > 0.01 && share < 0.99) {
            return None;
        }
        let resistance = self.ratio * share / (1.0 - share);
        Some(1.0 / (1.0 / T25_K + self.per_b * ln(resistance)) - 273.15)
    }
}

declare! {
    /// A voltage behind a divider.
    ///
    /// Default: 47 kΩ over 10 kΩ, up to 18.8 V.
    pub struct SupplyConfig {
        /// Ratio of the voltage to the pin voltage: (upper + lower)/lower resistor.
        pub divider: f32 = 5.7, "": Range(1.0, 100.0);
        /// Reference voltage of the converter.
        pub reference_v: f32 = 3.3, "V": Range(1.0, 5.5);
    }
}

impl SupplyConfig {
    /// Builds the validated channel; the error names the invalid field.
    pub fn build(&self) -> Result<Supply, ConfigError> {
        self.check_ranges()?;
        let divider = self.divider;
        let reference = self.reference_v;
        Ok(Supply {
            volts_per_count: divider * reference / 4096.0,
        })
    }
}

/// Channel of the supply voltage with checked constants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supply {
    volts_per_count: f32,
}

impl Supply {
    /// Voltage before the divider, V, for a count of the 12-bit converter.
    pub fn read(&self, count: u16) -> f32 {
        f32::from(count) * self.volts_per_count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thermistor_temperature_matches_the_b_equation() {
        let thermistor = ThermistorConfig::default().build().unwrap();
        // NTC 10 kΩ, B 3950: resistances at temperature from the definition in double precision.
        for celsius in [-20.0, 0.0, 25.0, 60.0, 100.0, 120.0f64] {
            let ohm = 10e3 * (3950.0 * (1.0 / (celsius + 273.15) - 1.0 / 298.15)).exp();
            let count = (4096.0 * ohm / (ohm + 10e3)) as f32;
            let read = thermistor.read(count, 4096.0).unwrap();
            assert!((f64::from(read) - celsius).abs() < 0.01, "{celsius} {read}");
        }
        for broken in [0.0, 20.0, 4080.0, 4095.0, f32::NAN] {
            assert_eq!(thermistor.read(broken, 4096.0), None);
        }
    }

    #[test]
    fn supply_voltage_matches_hand_calculation() {
        let supply = SupplyConfig::default().build().unwrap();
        // 12 V: 2.105 V at the pin, 2613 counts.
        assert!((supply.read(2613) - 12.0).abs() < 5e-3);
        crate::config::refusal_of(SupplyConfig::default(), |c| c.build())
            .names(&[("divider", |c| c.divider = 0.5)]);
    }
}
