//! Zeros and gains of the strain gauges, from counts with the strip held straight and on formers of known curvature.

use core_algos::beam::MAX_GAUGES;
use host_sim::base::statistics::square;

/// Mean counts of the gauges at a known strain.
#[derive(Clone, Copy, Debug)]
pub struct CalibrationPoint {
    /// Strain of the outer fibre.
    pub strain: f64,
    /// Mean converter counts of each gauge.
    pub counts: [f64; MAX_GAUGES],
}

/// Zero (counts) and gain (true strain over measured strain) of a gauge, by least squares; `None` if all strains are
/// equal.
pub fn fit(points: &[CalibrationPoint], gauge: usize, strain_per_count: f64) -> Option<(f64, f64)> {
    let count = points.len() as f64;
    let mean =
        |value: &dyn Fn(&CalibrationPoint) -> f64| points.iter().map(value).sum::<f64>() / count;
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
    fn zero_and_gain_need_two_strains() {
        let (zero, gain, unit) = (8123.4, 0.97, 5e-7);
        let point = |strain: f64| CalibrationPoint {
            strain,
            counts: [zero + strain / (gain * unit); MAX_GAUGES],
        };
        let (found, factor) = fit(&[point(0.0), point(7e-4), point(-5e-4)], 2, unit).unwrap();
        assert!((found - zero).abs() < 1e-8 && (factor - gain).abs() < 1e-12);
        assert_eq!(fit(&[point(7e-4)], 2, unit), None);
        assert_eq!(fit(&[], 2, unit), None);
    }
}
