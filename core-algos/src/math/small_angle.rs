//! Sine and cosine of angles that need no reduction: a third of the general ones' instructions.

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

#[cfg(test)]
mod tests {
    use super::*;

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
