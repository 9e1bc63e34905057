//! Greater and lesser of two numbers, limits, and the test for finite numbers.
//!
//! `f32::max` and `f32::min` are function calls on a Cortex-M4F, which has no such instruction; a comparison and a
//! move are four instructions. A number that is mostly within its bounds needs one comparison only, of its magnitude
//! ([`bounded`]).

use core::hint::cold_path;

/// The greater of two numbers; `b` if one of them is NaN.
pub fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The lesser of two numbers; `b` if one of them is NaN.
pub fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// `x` limited to ±`bound`, which is not negative; cheap where `x` lies within. NaN becomes ±`bound`.
pub fn bounded(x: f32, bound: f32) -> f32 {
    if x.abs() <= bound {
        x
    } else {
        cold_path();
        bound.copysign(x)
    }
}

/// True if all values are finite. Takes two instructions a value on a Cortex-M4F; `f32::is_finite` next to other
/// comparisons takes more than twenty.
pub fn all_finite<const N: usize>(values: [f32; N]) -> bool {
    // 0·x is zero if x is finite, otherwise NaN.
    values.iter().fold(0.0, |sum, value| sum + 0.0 * value) == 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounded_limits_both_signs_infinity_and_nan() {
        for (x, limited) in [(0.5, 0.5), (-2.0, -2.0), (2.5, 2.0), (-9.0, -2.0)] {
            assert_eq!(bounded(x, 2.0), limited);
        }
        assert_eq!(bounded(f32::NEG_INFINITY, 2.0), -2.0);
        assert_eq!(bounded(f32::NAN, 2.0).abs(), 2.0);
    }

    #[test]
    fn all_finite_rejects_a_single_nan_or_infinity() {
        assert!(all_finite([f32::MAX, f32::MIN, -0.0, 1e-45]));
        for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for place in 0..3 {
                let mut values = [f32::MAX; 3];
                values[place] = odd;
                assert!(!all_finite(values));
            }
        }
        assert!(all_finite([]));
    }

    #[test]
    fn greater_and_lesser_order_numbers_and_return_b_beside_nan() {
        assert_eq!((greater(1.0, 2.0), greater(2.0, 1.0)), (2.0, 2.0));
        assert_eq!((lesser(1.0, 2.0), lesser(2.0, 1.0)), (1.0, 1.0));
        assert_eq!((greater(f32::NAN, 1.0), lesser(f32::NAN, 1.0)), (1.0, 1.0));
        assert!(greater(1.0, f32::NAN).is_nan() && lesser(1.0, f32::NAN).is_nan());
    }
}
