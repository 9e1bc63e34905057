//! Zeros and gains of the strain gauges from postures in which the strip is held: straight, and laid
//! on formers of known curvature.

use core_algos::beam::MAX_GAUGES;
use host_sim::base::statistics::square;

/// Mean counts of the gauges while the strip was held at a known strain.
#[derive(Clone, Copy, Debug)]
pub struct Held {
    /// Strain of the outer fibre.
    pub strain: f64,
    /// Mean counts.
    pub counts: [f64; MAX_GAUGES],
}

/// A gauge's zero (counts) and gain (true strain over the one read), by least squares over the
/// postures; none if they do not differ.
pub fn fit(held: &[Held], gauge: usize, strain_per_count: f64) -> Option<(f64, f64)> {
    let count = held.len() as f64;
    let mean = |value: &dyn Fn(&Held) -> f64| held.iter().map(value).sum::<f64>() / count;
    let strain = mean(&|item| item.strain);
    let counts = mean(&|item| item.counts[gauge]);
    let square = mean(&|item| square(item.strain - strain));
    let product = mean(&|item| (item.strain - strain) * (item.counts[gauge] - counts));
    let counts_per_strain = product / square;
    let gain = 1.0 / (counts_per_strain * strain_per_count);
    let zero = counts - counts_per_strain * strain;
    (square > 0.0 && gain.is_finite()).then_some((zero, gain))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_and_gain_of_a_line_are_found_and_one_posture_is_too_few() {
        let (zero, gain, unit) = (8123.4, 0.97, 5e-7);
        let held = |strain: f64| Held {
            strain,
            counts: [zero + strain / (gain * unit); MAX_GAUGES],
        };
        let (found, factor) = fit(&[held(0.0), held(7e-4), held(-5e-4)], 2, unit).unwrap();
        assert!((found - zero).abs() < 1e-8 && (factor - gain).abs() < 1e-12);
        assert_eq!(fit(&[held(7e-4)], 2, unit), None);
        assert_eq!(fit(&[], 2, unit), None);
    }
}
