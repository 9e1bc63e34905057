//! Conversion of a voltage to a count.

use crate::noise::Noise;

/// Noise of the converter, counts rms, for 10.8 effective bits (data sheet, typical). Quantization alone has a variance
/// of 1/12 counts²; each effective bit less than twelve multiplies the total variance by four. The noise is the
/// difference: √((4^1.2 − 1)/12).
pub(super) const NOISE: f64 = 0.597;

/// 12-bit count for `ratio` of the reference voltage. `error`, counts, is added, and noise of `noise_counts` rms.
/// The first step is at half a count (ST application note AN2834).
pub(super) fn count(ratio: f64, error: f64, noise_counts: f64, noise: &mut Noise) -> u32 {
    let count = 4096.0 * ratio + error + noise_counts * noise.normal() + 0.5;
    count.clamp(0.0, 4095.0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_yields_the_effective_bits_of_the_data_sheet() {
        // Converts a full-scale sine; the residual is noise and quantization.
        let mut noise = Noise::new(7);
        let n = 200_000;
        let mut power = 0.0;
        for k in 0..n {
            let phase = f64::from(k) * 0.618_034 * std::f64::consts::TAU;
            let ratio = 0.5 + 0.499 * phase.sin();
            let error = f64::from(count(ratio, 0.0, NOISE, &mut noise)) - 4096.0 * ratio;
            power += error * error / f64::from(n);
        }
        let signal = 4096.0f64.powi(2) / 8.0;
        let effective = (10.0 * (signal / power).log10() - 1.76) / 6.02;
        assert!((effective - 10.8).abs() < 0.02, "{effective}");
    }

    #[test]
    fn first_step_is_at_half_a_count_and_last_at_one_and_a_half_below_full_scale() {
        for (ratio, expected) in [
            (0.0, 0),
            (0.49 / 4096.0, 0),
            (0.51 / 4096.0, 1),
            (0.5, 2048),
            (4094.49 / 4096.0, 4094),
            (1.2, 4095),
            (-0.1, 0),
        ] {
            assert_eq!(
                count(ratio, 0.0, 0.0, &mut Noise::new(1)),
                expected,
                "{ratio}"
            );
        }
    }
}
