//! The elementary functions every algorithm uses.
//!
//! One module, so that a host and a Cortex-M4F compute the same bits: sine and cosine are one
//! `f32` polynomial pair of our own (`libm` computes them in `f64`, which costs fifty times as
//! much without a double-precision unit); the rest is `libm`, plain Rust on both sides. A product
//! is never contracted with a sum.

use core::f32::consts::{FRAC_2_PI, PI, TAU};

/// Adding and then subtracting 1.5 · 2^23 rounds to the nearest integer.
const ROUND: f32 = 12_582_912.0;
/// π/2 in three parts. The first two have 10 and 11 significant bits, so that `n` times them is
/// exact for |n| < 2^13 (Cody and Waite).
const HALF_PI_HIGH: f32 = 1.570_312_5;
const HALF_PI_MIDDLE: f32 = 4.837_513e-4;
const HALF_PI_LOW: f32 = 7.549_79e-8;
/// Beyond this the three-part reduction is no longer exact.
const REDUCTION_LIMIT: f32 = 8192.0;

/// Sine and cosine of `x` (radians).
///
/// Absolute error at most 1e-7 for |x| ≤ 8192; beyond, `x` is first reduced modulo the `f32`
/// nearest 2π. NaN and infinity give NaN.
#[inline]
pub fn sin_cos(x: f32) -> (f32, f32) {
    let x = if x.abs() <= REDUCTION_LIMIT {
        x
    } else {
        x % TAU
    };
    let n = (x * FRAC_2_PI + ROUND) - ROUND;
    let y = ((x - n * HALF_PI_HIGH) - n * HALF_PI_MIDDLE) - n * HALF_PI_LOW;
    let y2 = y * y;
    let sin = y + y * y2 * (-1.666_665_5e-1 + y2 * (8.332_161e-3 + y2 * -1.951_529_6e-4));
    let cos =
        1.0 - 0.5 * y2 + y2 * y2 * (4.166_664_6e-2 + y2 * (-1.388_731_6e-3 + y2 * 2.443_315_7e-5));
    match n as i32 & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// Sine of `x` (radians); see [`sin_cos`].
#[inline]
pub fn sin(x: f32) -> f32 {
    sin_cos(x).0
}

/// Cosine of `x` (radians); see [`sin_cos`].
#[inline]
pub fn cos(x: f32) -> f32 {
    sin_cos(x).1
}

/// Angle of the vector `(x, y)` in (−π, π]; `atan2(0, 0)` is 0. NaN gives NaN.
#[inline]
pub fn atan2(y: f32, x: f32) -> f32 {
    libm::atan2f(y, x)
}

/// Square root, correctly rounded; NaN below zero.
#[inline]
pub fn sqrt(x: f32) -> f32 {
    libm::sqrtf(x)
}

/// Length of the vector `(x, y)`. No guard against overflow: meant for lengths in metres.
#[inline]
pub fn hypot(x: f32, y: f32) -> f32 {
    sqrt(x * x + y * y)
}

/// Hyperbolic tangent.
#[inline]
pub fn tanh(x: f32) -> f32 {
    libm::tanhf(x)
}

/// `e^x`.
#[inline]
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}

/// Natural logarithm.
#[inline]
pub fn ln(x: f32) -> f32 {
    libm::logf(x)
}

/// `sin(x)/x`, 1 at zero.
#[inline]
pub fn sinc(x: f32) -> f32 {
    if x.abs() < 1e-2 {
        let x2 = x * x;
        1.0 - x2 / 6.0 * (1.0 - x2 / 20.0)
    } else {
        sin(x) / x
    }
}

/// `angle` (radians) brought into [−π, π].
///
/// Exact to one rounding for a few turns; NaN and infinity give NaN.
#[inline]
pub fn wrap_angle(angle: f32) -> f32 {
    if angle.abs() <= PI {
        return angle;
    }
    let reduced = angle % TAU;
    if reduced > PI {
        reduced - TAU
    } else if reduced < -PI {
        reduced + TAU
    } else {
        reduced
    }
}

/// `x` limited to `[low, high]`. Unlike `f32::clamp` it cannot panic; NaN gives `low`.
#[inline]
pub fn clamp(x: f32, low: f32, high: f32) -> f32 {
    x.max(low).min(high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn sin_cos_is_within_1e_7_of_f64() {
        let mut worst = 0.0f64;
        for i in -400_000..=400_000i32 {
            let x = i as f32 * 0.020_47;
            let (s, c) = sin_cos(x);
            let (rs, rc) = (x as f64).sin_cos();
            worst = worst.max((s as f64 - rs).abs()).max((c as f64 - rc).abs());
        }
        assert!(worst < 1e-7, "{worst:e}");
    }

    #[test]
    fn non_finite_input_gives_nan() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let (s, c) = sin_cos(bad);
            assert!(s.is_nan() && c.is_nan());
            assert!(wrap_angle(bad).is_nan());
        }
    }

    #[test]
    fn sinc_joins_its_two_branches() {
        for i in -2000..2000 {
            let x = i as f32 * 1e-5;
            let exact = if x == 0.0 {
                1.0
            } else {
                (x as f64).sin() / x as f64
            };
            assert!((sinc(x) as f64 - exact).abs() < 2e-7);
        }
    }

    proptest! {
        #[test]
        fn wrapped_angle_is_the_same_direction(angle in -1000.0f32..1000.0) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped.abs() <= PI);
            let (s, c) = (angle as f64).sin_cos();
            let (ws, wc) = (wrapped as f64).sin_cos();
            prop_assert!((s - ws).abs() < 1e-4 && (c - wc).abs() < 1e-4);
        }

        #[test]
        fn clamp_never_leaves_its_bounds(x in proptest::num::f32::ANY) {
            let y = clamp(x, -2.0, 3.0);
            prop_assert!((-2.0..=3.0).contains(&y));
        }
    }
}
