//! From a voltage to a count: errors of the converter.

use crate::noise::Noise;

/// Errors of a converter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Noise, counts rms.
    pub noise: f64,
    /// Added to every count.
    pub offset: f64,
    /// Gain over the ideal one, less one.
    pub gain: f64,
}

/// Noise that leaves 10.8 effective bits (data sheet, typical). The steps alone have a twelfth of a
/// count squared; each bit less than twelve makes that four times as much, and the noise is what is
/// missing: √((4^1.2 − 1)/12).
const NOISE: f64 = 0.597;

impl Default for Errors {
    fn default() -> Self {
        Self {
            noise: NOISE,
            offset: 0.0,
            gain: 0.0,
        }
    }
}

impl Errors {
    /// The count of twelve bits for a voltage over the reference. The first step lies at half a count
    /// (vendor's AN2834).
    pub(super) fn count(&self, ratio: f64, noise: &mut Noise) -> u32 {
        let ideal = 4096.0 * ratio;
        let count = ideal * (1.0 + self.gain) + self.offset + self.noise * noise.normal() + 0.5;
        count.clamp(0.0, 4095.0) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_leaves_the_data_sheets_effective_bits() {
        // A sine of full scale, converted; what differs from it is noise and steps.
        let (errors, mut noise) = (Errors::default(), Noise::new(7));
        let n = 200_000;
        let mut power = 0.0;
        for k in 0..n {
            let phase = f64::from(k) * 0.618_034 * std::f64::consts::TAU;
            let ratio = 0.5 + 0.499 * phase.sin();
            let error = f64::from(errors.count(ratio, &mut noise)) - 4096.0 * ratio;
            power += error * error / f64::from(n);
        }
        let signal = 4096.0f64.powi(2) / 8.0;
        let effective = (10.0 * (signal / power).log10() - 1.76) / 6.02;
        assert!((effective - 10.8).abs() < 0.02, "{effective}");
    }

    #[test]
    fn errors_shift_and_stretch_and_counts_stay_within_their_range() {
        let mut noise = Noise::new(1);
        let mut errors = Errors {
            noise: 0.0,
            ..Errors::default()
        };
        // The first step at half a count, the last one and a half below full scale.
        for (ratio, count) in [
            (0.0, 0),
            (0.49 / 4096.0, 0),
            (0.51 / 4096.0, 1),
            (0.5, 2048),
            (1.2, 4095),
            (-0.1, 0),
        ] {
            assert_eq!(errors.count(ratio, &mut noise), count, "{ratio}");
        }
        (errors.offset, errors.gain) = (-3.0, 0.01);
        assert_eq!(errors.count(0.5, &mut noise), 2065);
    }
}
