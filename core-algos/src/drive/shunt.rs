//! Motor current from counts of the converter: a shunt in the motor's lead and an amplifier whose output is at
//! mid-supply without current (INA240 and similar).
//!
//! The reference of the converter is the supply of the amplifier, so mid-supply is the middle of the counts. The
//! remaining offset of the amplifier is measured while the motors are off.
//!
//! [`Config::build`] validates; [`Shunt::read`] and [`Zeroing`] cannot fail.

use crate::config::{Allowed, ConfigError, declare, require};

declare! {
    /// Amplifier and converter.
    ///
    /// Default: 10 mΩ and an amplification of 20.
    pub struct Config {
        /// Shunt times amplification; negative if the shunt is wired the other way round.
        pub volts_per_ampere: f32 = 0.2, "V/A": Range(-10.0, 10.0);
        /// Reference of the converter.
        pub reference_v: f32 = 3.3, "V": Range(1.0, 5.5);
        /// Counts closer than this to 0 or to full scale are rejected.
        pub rail_margin_counts: u16 = 20, "counts": Range(0.0, 999.0);
        /// Largest accepted offset of the zero from the middle.
        pub max_offset_a: f32 = 0.2, "A": Range(0.0, 100.0);
        /// Largest accepted standard deviation of the readings at rest.
        pub max_noise_a: f32 = 0.1, "A": Range(1e-4, 100.0);
    }
}

/// Counts of the 12-bit converter.
const SPAN: f32 = 4096.0;
const MIDDLE: f32 = 2048.0;
/// Samples of a zeroing: 0.1 s at 20 kHz.
const SAMPLES: u32 = 2000;

impl Config {
    /// Builds the scale; the error names the invalid field.
    pub fn build(&self) -> Result<Shunt, ConfigError> {
        self.check_ranges()?;
        let slope = self.volts_per_ampere;
        require(
            slope.abs() >= 1e-3 && slope.abs() <= 10.0,
            "volts_per_ampere",
            slope,
            Allowed::Condition("from 0.001 to 10 in magnitude"),
        )?;
        let reference = self.reference_v;
        Ok(Shunt {
            amperes_per_count: reference / (SPAN * slope),
            lowest: self.rail_margin_counts,
            highest: 4095 - self.rail_margin_counts,
            max_offset: self.max_offset_a,
            max_noise: self.max_noise_a,
        })
    }
}

/// Scale of one current channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shunt {
    amperes_per_count: f32,
    lowest: u16,
    highest: u16,
    max_offset: f32,
    max_noise: f32,
}

impl Shunt {
    /// Current of a count, A; `zero` is the count without current. `None` at either end of the converter.
    pub fn read(&self, count: u16, zero: f32) -> Option<f32> {
        (count >= self.lowest && count <= self.highest)
            .then(|| (f32::from(count) - zero) * self.amperes_per_count)
    }
}

/// Measurement of the count without current, while the motors are off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Zeroing {
    samples: u32,
    sum: u32,
    squares: u64,
}

/// Result of a zeroing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Zeroed {
    /// Not enough samples yet.
    Pending,
    /// The count without current.
    Found(f32),
    /// The readings scatter too much, or are too far from the middle; the zeroing restarts.
    Refused,
}

impl Zeroing {
    /// Adds a count; returns the zero once there are enough samples.
    pub fn step(&mut self, shunt: &Shunt, count: u16) -> Zeroed {
        self.samples += 1;
        self.sum += u32::from(count);
        self.squares += u64::from(count) * u64::from(count);
        if self.samples < SAMPLES {
            return Zeroed::Pending;
        }
        let n = u64::from(self.samples);
        let sum = u64::from(self.sum);
        // n Σc² − (Σc)² is computed in integers, at most 2^46, so that no digits cancel.
        let spread = (n * self.squares).saturating_sub(sum * sum);
        let mean = self.sum as f32 / self.samples as f32;
        let variance = spread as f32 / (self.samples as f32 * self.samples as f32);
        *self = Self::default();
        let scale = shunt.amperes_per_count;
        let sound = ((mean - MIDDLE) * scale).abs() <= shunt.max_offset
            && variance * scale * scale <= shunt.max_noise * shunt.max_noise;
        if sound {
            Zeroed::Found(mean)
        } else {
            Zeroed::Refused
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::testing::Random;

    /// Count of the converter for a current, computed from the circuit.
    fn count(current: f64, offset_v: f64, noise_v: f64) -> u16 {
        let volts = 1.65 + 0.010 * 20.0 * current + offset_v + noise_v;
        (volts / 3.3 * 4096.0).floor().clamp(0.0, 4095.0) as u16
    }

    fn find(shunt: &Shunt, mut sample: impl FnMut() -> u16) -> Zeroed {
        let mut zeroing = Zeroing::default();
        for _ in 0..SAMPLES - 1 {
            assert_eq!(zeroing.step(shunt, sample()), Zeroed::Pending);
        }
        zeroing.step(shunt, sample())
    }

    #[test]
    fn offset_is_found_and_current_read() {
        let shunt = Config::default().build().unwrap();
        let mut random = Random::new(3);
        let mut sample = || count(0.0, 0.012, 0.002 * random.normal());
        let Zeroed::Found(zero) = find(&shunt, &mut sample) else {
            panic!("not found");
        };
        for current in [-7.0, -0.5, 0.0, 0.02, 3.0, 7.5] {
            let read = shunt.read(count(current, 0.012, 0.0), zero).unwrap();
            // A count is 4 mA.
            assert!((f64::from(read) - current).abs() < 5e-3, "{current} {read}");
        }
        // Counts within 20 of either end of the converter's range are refused.
        let readable = [0, 19, 20, 4075, 4076, 4095].map(|count| shunt.read(count, zero).is_some());
        assert_eq!(readable, [false, false, true, true, false, false]);
    }

    /// One count is 1/256 A, so that offset and scatter are exact.
    #[test]
    fn zero_is_found_up_to_the_allowed_offset_and_noise_in_each_zeroing() {
        let config = Config {
            volts_per_ampere: 0.125,
            reference_v: 2.0,
            max_offset_a: 0.25,
            max_noise_a: 0.125,
            ..Config::default()
        };
        let shunt = config.build().unwrap();
        let mut zeroing = Zeroing::default();
        for (mean, scatter, sound) in [
            (2112, 32, true),
            (2113, 0, false),
            (1984, 32, true),
            (1983, 0, false),
            (2048, 33, false),
            (2050, 0, true),
        ] {
            for k in 1..SAMPLES {
                let count = if k % 2 == 0 {
                    mean + scatter
                } else {
                    mean - scatter
                };
                assert_eq!(zeroing.step(&shunt, count), Zeroed::Pending);
            }
            let expected = if sound {
                Zeroed::Found(f32::from(mean))
            } else {
                Zeroed::Refused
            };
            assert_eq!(
                zeroing.step(&shunt, mean + scatter),
                expected,
                "{mean} {scatter}"
            );
        }
    }

    #[test]
    fn slopes_from_a_thousandth_to_ten_are_accepted_with_either_sign() {
        for (slope, accepted) in [(1e-3, true), (0.99e-3, false), (10.0, true), (10.1, false)] {
            for volts_per_ampere in [slope, -slope] {
                let config = Config {
                    volts_per_ampere,
                    ..Config::default()
                };
                assert_eq!(config.build().is_ok(), accepted, "{slope}");
            }
        }
        crate::config::refusal_of(Config::default(), |c| c.build())
            .names(&[("volts_per_ampere", |c| c.volts_per_ampere = f32::NAN)]);
    }

    #[test]
    fn current_or_loose_wire_is_refused_as_zero() {
        let shunt = Config::default().build().unwrap();
        assert_eq!(find(&shunt, || count(0.5, 0.0, 0.0)), Zeroed::Refused);
        assert_eq!(find(&shunt, || 4095), Zeroed::Refused);
        let mut k = 0;
        let swinging = || {
            k += 1;
            count(if k % 2 == 0 { 0.3 } else { -0.3 }, 0.0, 0.0)
        };
        assert_eq!(find(&shunt, swinging), Zeroed::Refused);
    }
}
