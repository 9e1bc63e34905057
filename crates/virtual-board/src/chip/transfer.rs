//! From a voltage to a count: resolution, errors of the converter, alignment.

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

/// Bits of a resolution (RES of CR1).
fn bits(resolution: u32) -> u32 {
    12 - 2 * resolution
}

/// A count of twelve bits at a resolution.
pub(super) fn resolve(count: u32, resolution: u32) -> u32 {
    count >> (2 * resolution)
}

/// A count as the data register of the regular group shows it.
pub(super) fn align_regular(count: u32, resolution: u32, left: bool) -> u32 {
    match (left, resolution) {
        (false, _) => count,
        // Six bits are aligned within a byte.
        (true, 3) => count << 2,
        (true, _) => count << (16 - bits(resolution)),
    }
}

/// A count less its offset as a data register of the injected group shows it.
pub(super) fn align_injected(count: u32, offset: u32, resolution: u32, left: bool) -> u32 {
    let signed = count.wrapping_sub(offset);
    let shifted = match (left, resolution) {
        (false, _) => signed,
        (true, 3) => signed << 1,
        (true, _) => signed << (15 - bits(resolution)),
    };
    shifted & 0xffff
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

    #[test]
    fn data_are_aligned_as_in_the_manuals_figures() {
        assert_eq!(align_regular(0xabc, 0, false), 0xabc);
        assert_eq!(align_regular(0xabc, 0, true), 0xabc0);
        assert_eq!(align_regular(0x2a, 3, true), 0xa8);
        assert_eq!(align_injected(0x123, 0x125, 0, false), 0xfffe);
        assert_eq!(align_injected(0xabc, 0, 0, true), 0x55e0);
        assert_eq!(align_injected(0, 1, 0, true), 0xfff8);
        assert_eq!(align_injected(0x2a, 0, 3, true), 0x54);
        assert_eq!(align_injected(0, 1, 3, true), 0xfffe);
        assert_eq!(resolve(0xfff, 2), 0xff);
    }
}
