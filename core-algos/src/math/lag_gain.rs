//! Gain of a first-order lag over a step.

use super::trig::exp;

/// Up to here the series is good to one rounding.
const SERIES_LIMIT: f32 = 0.5;

/// `1 − e^(−x)` for x ≥ 0, to 3e-7 of itself: a power series for the short steps of a filter,
/// which loses nothing by cancellation and costs a fifth of an exponential. NaN gives NaN.
#[inline]
pub fn lag_gain(x: f32) -> f32 {
    if x.abs() <= SERIES_LIMIT {
        x * (1.0
            - x * (1.0 / 2.0
                - x * (1.0 / 6.0
                    - x * (1.0 / 24.0
                        - x * (1.0 / 120.0 - x * (1.0 / 720.0 - x * (1.0 / 5040.0)))))))
    } else {
        1.0 - exp(-x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_that_of_f64() {
        for i in 0..40_000 {
            let x = 1e-4 * i as f32;
            let exact = -f64::from(-x).exp_m1();
            let error = (f64::from(lag_gain(x)) - exact).abs();
            assert!(error <= 3e-7 * exact, "{x}: {error:e}");
        }
        assert!(lag_gain(f32::NAN).is_nan());
    }
}
