//! Sine and cosine of angles that need no reduction: a third of the general ones' instructions.

use super::trig;
use core::hint::cold_path;

/// Largest |angle|, rad, for which [`sin_cos`] holds.
pub const LIMIT: f32 = 1.6;

/// Sine and cosine of `x` (radians) for |x| ≤ [`LIMIT`], absolute error at most 2.5e-7. Beyond, they
/// are polynomials that leave the circle. NaN gives NaN.
///
/// Minimax polynomials on that range (error 6e-9 and 6.4e-8 before rounding).
#[inline(always)]
pub fn sin_cos(x: f32) -> (f32, f32) {
    let y = x * x;
    let sin = x + x
        * (y * (-1.666_665_6e-1 + y * (8.332_981e-3 + y * (-1.980_401_6e-4 + y * 2.594_376e-6))));
    let cos =
        1.0 + y * (-4.999_992e-1 + y * (4.166_368e-2 + y * (-1.385_346_2e-3 + y * 2.313_598e-5)));
    (sin, cos)
}

/// Largest |angle|, rad, for which [`sin_cos_of_heading`] does without the general functions.
const HEADING_LIMIT: f32 = 3.2;

/// Sine and cosine of any `x` (radians), absolute error at most 5e-7 for |x| ≤ 8192; from those of
/// its half where it lies within a turn, as headings do, at two thirds of the general functions' cost.
/// NaN gives NaN.
#[inline(always)]
pub fn sin_cos_of_heading(x: f32) -> (f32, f32) {
    if x.abs() <= HEADING_LIMIT {
        let (s, c) = sin_cos(0.5 * x);
        (2.0 * s * c, c * c - s * s)
    } else {
        cold_path();
        trig::sin_cos(x)
    }
}

/// Of `square` = x² with |x| ≤ 1.5: cos x, and `sinc'(x)/x` for sinc x = sin x/x, whose closed form
/// loses all digits near zero. The rest follows from both without a loss: `sinc = cos x − x² slope`,
/// `sin = x sinc`, `sinc'' = −sinc − 2 slope`. Absolute error at most 2e-7 and 1e-7.
///
/// Minimax polynomials on that range (error 3.4e-8 and 4.9e-8 before rounding).
#[inline(always)]
pub fn cos_and_sinc_slope(square: f32) -> (f32, f32) {
    let y = square;
    let cos = 1.0
        + y * (-4.999_995_2e-1 + y * (4.166_46e-2 + y * (-1.386_113_9e-3 + y * 2.332_569_6e-5)));
    let slope = -3.333_332_8e-1 + y * (3.333_264e-2 + y * (-1.188_93e-3 + y * 2.094_135_6e-5));
    (cos, slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn those_of_headings_are_those_of_f64() {
        let mut worst = 0.0f64;
        for i in -400_000..=400_000 {
            let x = i as f32 * 1e-5;
            let ((s, c), (rs, rc)) = (sin_cos_of_heading(x), f64::from(x).sin_cos());
            worst = worst.max((f64::from(s) - rs).abs());
            worst = worst.max((f64::from(c) - rc).abs());
        }
        println!("{worst:e}");
        assert!(worst < 5e-7, "{worst:e}");
        assert!((sin_cos_of_heading(8000.0).0 - 8000.0f64.sin() as f32).abs() < 1e-6);
        assert!(sin_cos_of_heading(f32::NAN).0.is_nan());
    }

    #[test]
    fn all_of_sinc_follows_from_its_slope_and_the_cosine() {
        for i in -150_000..=150_000 {
            let x = i as f32 * 1e-5;
            let (cos, slope) = cos_and_sinc_slope(x * x);
            let sinc = cos - x * x * slope;
            let exact = f64::from(x);
            let (s, c) = exact.sin_cos();
            assert!((f64::from(cos) - c).abs() < 2e-7, "{x}");
            assert!((f64::from(x * sinc) - s).abs() < 3e-7, "{x}");
            // The closed form is good for nothing near zero: there the series' first terms are.
            let p = exact * exact;
            let expected = if p > 0.01 {
                (c - s / exact) / p
            } else {
                -1.0 / 3.0 + p / 30.0 - p * p / 840.0
            };
            assert!((f64::from(slope) - expected).abs() < 1e-7, "{x}");
        }
        assert_eq!(cos_and_sinc_slope(0.0).0, 1.0);
    }

    #[test]
    fn they_are_those_of_f64() {
        let mut worst = 0.0f64;
        for i in -160_000..=160_000 {
            let x = i as f32 * 1e-5;
            let ((s, c), (rs, rc)) = (sin_cos(x), f64::from(x).sin_cos());
            worst = worst.max((f64::from(s) - rs).abs());
            worst = worst.max((f64::from(c) - rc).abs());
        }
        println!("{worst:e}");
        assert!(worst < 2.5e-7, "{worst:e}");
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        assert!(sin_cos(f32::NAN).0.is_nan());
    }
}
