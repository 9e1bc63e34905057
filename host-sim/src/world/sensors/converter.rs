//! Nonlinearity of the bridges' converter in an oversampled reading.

use core_algos::acquisition::oversampling::SCANS;
use virtual_board::chip::Nonlinearity;

/// Full range of the chip's converter, counts.
const RANGE: f64 = 4096.0;
/// Number of intervals of the error curve, each interpolated linearly.
const PLACES: usize = 1024;
/// Half width of the noise kernel, standard deviations, and kernel steps per standard deviation.
const REACH: f64 = 3.0;
const STEPS: f64 = 8.0;

/// Mean error of a reading: the error of one conversion averaged over the noise of the conversions, which spans several
/// counts.
#[derive(Clone, Debug)]
pub struct ConverterError(Vec<f64>);

impl ConverterError {
    /// Error of a converter with the given largest nonlinearity and seed of its curve. `reading_noise` is the noise of
    /// a reading, rms, as a share of the range. `None` for an ideal converter.
    pub fn new(nonlinearity_counts: f64, reading_noise: f64, seed: u32) -> Option<Self> {
        if nonlinearity_counts == 0.0 {
            return None;
        }
        let curve = Nonlinearity::new(nonlinearity_counts, seed.into());
        let noise = reading_noise * (SCANS as f64).sqrt();
        let steps = (REACH * STEPS) as i32;
        let kernel: Vec<_> = (-steps..=steps)
            .map(|step| {
                let deviation = f64::from(step) / STEPS;
                (deviation * noise, libm::exp(-0.5 * deviation * deviation))
            })
            .collect();
        let weight: f64 = kernel.iter().map(|(_, weight)| weight).sum();
        let mean = |place: usize| {
            let ratio = place as f64 / PLACES as f64;
            let errors = kernel
                .iter()
                .map(|(by, weight)| weight * curve.at(ratio + by));
            errors.sum::<f64>() / (weight * RANGE)
        };
        Some(Self((0..=PLACES).map(mean).collect()))
    }

    /// Error of a reading at a share of the converter's range, in shares of the range.
    pub fn at(&self, ratio: f64) -> f64 {
        let place = ratio.clamp(0.0, 1.0) * PLACES as f64;
        let below = (place as usize).min(PLACES - 1);
        let part = place - below as f64;
        self.0[below] + part * (self.0[below + 1] - self.0[below])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::random::{Stream, generator, normal};

    /// Reference: the mean of 200 000 noisy conversions.
    #[test]
    fn error_of_a_reading_is_the_mean_of_noisy_conversions() {
        // Noise of 0.7 µε in a bridge with gauge factor 2.1 and gain 60.
        let reading_noise = 0.7e-6 * 2.1 * 60.0;
        let error = ConverterError::new(1.5, reading_noise, 5).unwrap();
        let curve = Nonlinearity::new(1.5, 5);
        let mut random = generator(1, 0, Stream::Other(0));
        let noise = reading_noise * 96f64.sqrt();
        let mut largest = 0.0f64;
        for ratio in [0.41, 0.47, 0.497, 0.5, 0.503, 0.58] {
            let count = 200_000;
            let mean: f64 = (0..count)
                .map(|_| {
                    let measured = ratio + normal(&mut random, noise);
                    (4096.0 * measured + curve.at(measured) + 0.5).floor() / 4096.0 - ratio
                })
                .sum::<f64>()
                / f64::from(count);
            let found = error.at(ratio);
            assert!(
                (found - mean).abs() < 0.05 / 4096.0,
                "{ratio}: {found} {mean}"
            );
            largest = largest.max(found.abs());
        }
        assert!(largest > 0.3 / 4096.0, "{largest}");
    }

    #[test]
    fn ideal_converter_has_no_error() {
        assert!(ConverterError::new(0.0, 1e-4, 5).is_none());
    }
}
