//! From a voltage to a count of the converter.

use crate::noise::Noise;

/// Noise that leaves 10.8 effective bits (data sheet, typical), counts rms. The steps alone have a twelfth
/// of a count squared; each bit less than twelve makes that four times as much, and the noise is what is
/// missing: √((4^1.2 − 1)/12).
pub(super) const NOISE: f64 = 0.597;

/// The count of twelve bits for a voltage over the reference, with an error and so much noise (counts). The first step
/// lies at half a count (vendor's AN2834).
pub(super) fn count(ratio: f64, error: f64, noise_counts: f64, noise: &mut Noise) -> u32 {
    let count = 4096.0 * ratio + error + noise_counts * noise.normal() + 0.5;
    count.clamp(0.0, 4095.0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_leaves_the_data_sheets_effective_bits() {
        // A sine of full scale, converted; what differs from it is noise and steps.
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
    fn the_first_step_lies_at_half_a_count_and_the_last_one_and_a_half_below_full_scale() {
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
