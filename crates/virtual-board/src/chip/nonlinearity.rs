//! Integral nonlinearity (INL) of the converter.
//!
//! A successive-approximation converter compares the input with a sum of weights, one for each bit, and each weight has
//! a small error. The error of a count is therefore the sum of the errors of its set bits, after offset and gain are
//! removed. The error is zero at both ends and largest where the highest bits change. The data sheet (DS8626, accuracy
//! of the converter) states 1.5 counts typically and 3 at most.

use crate::noise::Noise;

/// Number of highest bits whose weights have an error; the errors of the lower bits are negligible.
const BITS: u32 = 7;
/// Bits of a count.
const WIDTH: u32 = 12;

/// Curve of the converter's error over its counts.
#[derive(Clone, Debug, PartialEq)]
pub struct Nonlinearity {
    /// Errors indexed by the highest [`BITS`] bits of the count, counts.
    errors: Vec<f64>,
}

impl Nonlinearity {
    /// A random curve whose largest magnitude is `peak` counts.
    pub fn new(peak: f64, seed: u64) -> Self {
        let mut noise = Noise::new(seed);
        // The weight of bit k consists of n = 2ᵏ equal elements, so its error grows with √n.
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
        let largest = errors.iter().fold(0.0, |max: f64, e| max.max(e.abs()));
        let scale = if largest > 0.0 { peak / largest } else { 0.0 };
        errors.iter_mut().for_each(|error| *error *= scale);
        Self { errors }
    }

    /// Error at `ratio` of full scale, counts.
    pub fn at(&self, ratio: f64) -> f64 {
        let code = (ratio.clamp(0.0, 1.0) * f64::from(1u32 << WIDTH)) as usize >> (WIDTH - BITS);
        self.errors[code.min(self.errors.len() - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_is_zero_at_both_ends_reaches_its_peak_and_steps_at_mid_scale() {
        let mut steps = 0.0;
        for seed in 0..200 {
            let curve = Nonlinearity::new(1.5, seed);
            assert!(curve.at(0.0).abs() < 1e-12 && curve.at(1.0).abs() < 1e-12);
            let all = (0..4096).map(|code| curve.at((f64::from(code) + 0.5) / 4096.0));
            let largest = all.fold(0.0, |max: f64, e| max.max(e.abs()));
            assert!((largest - 1.5).abs() < 1e-12, "{largest}");
            steps += (curve.at(0.5001) - curve.at(0.4999)).abs() / 200.0;
        }
        // At mid-scale the highest bit replaces all lower bits.
        assert!((0.8..3.0).contains(&steps), "{steps}");
    }

    #[test]
    fn zero_peak_gives_zero_error_and_seeds_give_different_curves() {
        assert_eq!(Nonlinearity::new(0.0, 3).at(0.3), 0.0);
        assert_ne!(Nonlinearity::new(1.0, 3), Nonlinearity::new(1.0, 4));
    }
}
