//! Integral nonlinearity (INL) of the converter.
//!
//! A converter by successive approximation compares with the sum of weights, one a bit, and each weight is a little
//! off. So the error of a count is the sum of the errors of its bits, without offset and gain: zero at both ends, and
//! largest where the highest bits change. The data sheet (DS8626, accuracy of the converter) gives 1.5 counts
//! typically and 3 at most.

use crate::noise::Noise;

/// Bits with a weight of their own; those below are too small to matter.
const BITS: u32 = 7;
/// Bits of a count.
const WIDTH: u32 = 12;

/// Error of each count.
#[derive(Clone, Debug, PartialEq)]
pub struct Nonlinearity {
    /// By the highest [`BITS`] bits of the count.
    errors: Vec<f64>,
}

impl Nonlinearity {
    /// A curve by chance whose largest magnitude is `peak` counts.
    pub fn new(peak: f64, seed: u64) -> Self {
        let mut noise = Noise::new(seed);
        // A weight is made of as many equal parts as it is large.
        let weights: Vec<f64> = (0..BITS)
            .map(|bit| f64::from(1u32 << bit).sqrt() * noise.normal())
            .collect();
        let codes = 1usize << BITS;
        let sum = |code: usize| -> f64 {
            let set = (0..BITS as usize).filter(|bit| code >> bit & 1 != 0);
            set.map(|bit| weights[bit]).sum()
        };
        let gain = sum(codes - 1) / (codes - 1) as f64;
        let mut errors: Vec<f64> = (0..codes)
            .map(|code| sum(code) - gain * code as f64)
            .collect();
        let largest = errors.iter().fold(0.0, |most: f64, e| most.max(e.abs()));
        let scale = if largest > 0.0 { peak / largest } else { 0.0 };
        errors.iter_mut().for_each(|error| *error *= scale);
        Self { errors }
    }

    /// Error at a share of full scale, counts.
    pub fn at(&self, ratio: f64) -> f64 {
        let code = (ratio.clamp(0.0, 1.0) * f64::from(1u32 << WIDTH)) as usize >> (WIDTH - BITS);
        self.errors[code.min(self.errors.len() - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_is_zero_at_both_ends_has_its_peak_and_steps_at_the_middle() {
        let mut steps = 0.0;
        for seed in 0..200 {
            let curve = Nonlinearity::new(1.5, seed);
            assert!(curve.at(0.0).abs() < 1e-12 && curve.at(1.0).abs() < 1e-12);
            let all = (0..4096).map(|code| curve.at((f64::from(code) + 0.5) / 4096.0));
            let largest = all.fold(0.0, |most: f64, e| most.max(e.abs()));
            assert!((largest - 1.5).abs() < 1e-12, "{largest}");
            steps += (curve.at(0.5001) - curve.at(0.4999)).abs() / 200.0;
        }
        // The highest bit's weight against all the others.
        assert!((0.8..3.0).contains(&steps), "{steps}");
    }

    #[test]
    fn no_peak_is_no_error_and_seeds_differ() {
        assert_eq!(Nonlinearity::new(0.0, 3).at(0.3), 0.0);
        assert_ne!(Nonlinearity::new(1.0, 3), Nonlinearity::new(1.0, 4));
    }
}
