//! Elementary functions for all algorithms.
//!
//! One module, so that a host and a Cortex-M4F compute the same bits. Sine, cosine, arc tangent and hyperbolic
//! tangent are `f32` polynomials or quotients of polynomials (`libm` takes 2 to 50 times the instructions). The
//! square root is the processor's, correctly rounded everywhere. Exponential and logarithm are `libm`, plain Rust on
//! both sides. A product is never contracted with a sum.

use core::f32::consts::{FRAC_2_PI, FRAC_PI_2, PI, TAU};

/// Adding and then subtracting 1.5 · 2^23 rounds to the nearest integer. The lowest bits of the sum are this integer.
const ROUND: f32 = 12_582_912.0;
/// π/2 in three parts. The first two have 10 and 11 significant bits, so that `n` times them is
/// exact for |n| < 2^13 (Cody and Waite).
const HALF_PI_HIGH: f32 = 1.570_312_5;
const HALF_PI_MIDDLE: f32 = 4.837_513e-4;
const HALF_PI_LOW: f32 = 7.549_79e-8;
/// Largest |x| for which the three-part reduction is exact.
const REDUCTION_LIMIT: f32 = 8192.0;
/// Sign bit of an `f32`.
const SIGN: u32 = 1 << 31;

/// Positive `size` with the sign of `sign`.
fn with_sign(size: f32, sign: f32) -> f32 {
    f32::from_bits(size.to_bits() | sign.to_bits() & SIGN)
}

/// Sine and cosine of `x` (radians).
///
/// Absolute error at most 1e-7 for |x| ≤ 8192; beyond, `x` is first reduced modulo the `f32`
/// nearest 2π. NaN and infinity give NaN.
#[inline]
pub fn sin_cos(x: f32) -> (f32, f32) {
    if x.abs() <= REDUCTION_LIMIT {
        sin_cos_near(x)
    } else {
        sin_cos_far(x)
    }
}

#[cold]
#[inline(never)]
fn sin_cos_far(x: f32) -> (f32, f32) {
    sin_cos_near(x % TAU)
}

/// Sine and cosine for |x| ≤ 8192 or NaN.
fn sin_cos_near(x: f32) -> (f32, f32) {
    let rounded = x * FRAC_2_PI + ROUND;
    let n = rounded - ROUND;
    let quarters = rounded.to_bits();
    let y = ((x - n * HALF_PI_HIGH) - n * HALF_PI_MIDDLE) - n * HALF_PI_LOW;
    let y2 = y * y;
    // Half a turn changes both signs.
    let sign = f32::from_bits(1.0f32.to_bits() | (quarters & 2) << 30);
    let y = y * sign;
    let sin = y + y * y2 * (-1.666_665_5e-1 + y2 * (8.332_161e-3 + y2 * -1.951_529_6e-4));
    let cos = sign
        + sign * y2 * (-0.5 + y2 * (4.166_664_6e-2 + y2 * (-1.388_731_6e-3 + y2 * 2.443_315_7e-5)));
    if quarters & 1 == 0 {
        (sin, cos)
    } else {
        (cos, -sin)
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

/// Arc tangent of a number within [−1, 1]; absolute error at most 2e-7.
fn atan_unit(x: f32) -> f32 {
    let z = x * x;
    x * (ATAN[0]
        + z * (ATAN[1]
            + z * (ATAN[2]
                + z * (ATAN[3] + z * (ATAN[4] + z * (ATAN[5] + z * (ATAN[6] + z * ATAN[7])))))))
}

/// Polynomial of the arc tangent, minimax on [0, 1], error 3.8e-8.
const ATAN: [f32; 8] = [
    9.999_993_4e-1,
    -3.332_986_1e-1,
    1.994_656_6e-1,
    -1.390_862_9e-1,
    9.642_196e-2,
    -5.591_23e-2,
    2.186_294e-2,
    -4.054_56e-3,
];

/// Angle of the vector `(x, y)` in [−π, π], with the sign of `y`; `atan2(0, 0)` is 0 whatever the
/// signs.
///
/// Absolute error at most 5e-7 for any finite vector. NaN gives NaN, and so do two infinities.
#[inline]
pub fn atan2(y: f32, x: f32) -> f32 {
    if y.abs() <= x.abs() {
        let angle = atan_unit(y / x);
        if x > 0.0 {
            angle
        } else if x < 0.0 {
            angle + with_sign(PI, y)
        } else {
            0.0
        }
    } else {
        with_sign(FRAC_PI_2, y) - atan_unit(x / y)
    }
}

/// Square root, correctly rounded; NaN below zero.
pub fn sqrt(x: f32) -> f32 {
    square_root::sqrt(x)
}

/// Length of the vector `(x, y)`. No guard against overflow: meant for lengths in metres.
#[inline]
pub fn hypot(x: f32, y: f32) -> f32 {
    sqrt(x * x + y * y)
}

/// Beyond this |x|, tanh x is ±1 within 2.8e-7.
const TANH_LIMIT: f32 = 7.9;
/// tanh x = x A(x²)/B(x²): A, and B without its leading coefficient 1; minimax up to [`TANH_LIMIT`], error 1.3e-7.
const TANH_ABOVE: [f32; 4] = [4_043_941.5, 522_797.4, 11_945.103, 46.369_97];
const TANH_BELOW: [f32; 4] = [4_043_942.8, 1_870_771.9, 96_351.05, 966.956_24];

/// Hyperbolic tangent.
///
/// Absolute error at most 5e-7 everywhere (a result may exceed 1 by as much); relative error at most 1e-6. NaN gives
/// NaN, ±∞ gives ±1.
#[inline]
pub fn tanh(x: f32) -> f32 {
    if x.abs() < TANH_LIMIT {
        let z = x * x;
        x * (TANH_ABOVE[0] + z * (TANH_ABOVE[1] + z * (TANH_ABOVE[2] + z * TANH_ABOVE[3])))
            / (TANH_BELOW[0] + z * (TANH_BELOW[1] + z * (TANH_BELOW[2] + z * (TANH_BELOW[3] + z))))
    } else if x.is_nan() {
        x
    } else {
        with_sign(1.0, x)
    }
}

/// `e^x`.
#[inline]
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}

/// `1 − e^(−x)`: step response of a first-order lag after x time constants. Relative error at most 3e-7 for x ≥ 0.
/// NaN gives NaN.
#[inline]
pub fn lag_gain(x: f32) -> f32 {
    -libm::expm1f(-x)
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
    // Up to three half turns, one addition is enough, and exact.
    let near = angle - with_sign(TAU, angle);
    if near.abs() <= PI {
        return near;
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

/// [`wrap_angle`] in `f64`.
#[inline]
pub fn wrap_angle_f64(angle: f64) -> f64 {
    use core::f64::consts::{PI, TAU};
    if angle.abs() <= PI {
        angle
    } else {
        angle - TAU * libm::round(angle / TAU)
    }
}

/// `x` limited to `[low, high]`. Unlike `f32::clamp` it cannot panic; NaN gives `low`.
#[inline]
pub fn clamp(x: f32, low: f32, high: f32) -> f32 {
    // Comparisons are used, because a Cortex-M4F has no instruction for `max` and `min`.
    if !(x >= low) {
        low
    } else if x > high {
        high
    } else {
        x
    }
}

#[cfg(test)]
mod tests;
