//! A number as the unevaluated sum of two `f32`: about 47 significant bits without `f64`.
//!
//! For long sums (a position advanced a million times) and for quantities that nearly cancel (the
//! weight of a covariance intersection). The error-free transformations are Knuth's sum and
//! Dekker's product; no fused multiply-add is used, so a host and a board give the same bits.
//! Products are exact while the operands lie between about 1e-15 and 1e17 in size. NaN and
//! infinity propagate.

use core::f32::consts::TAU;
use core::ops::{Add, Div, Mul, Neg, Sub};

/// 2^12 + 1: splits a 24-bit significand into two halves (Dekker, Veltkamp).
const SPLIT: f32 = 4097.0;

/// The sum `high + low`, with `low` at most half a unit in the last place of `high`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TwoFloat {
    /// The `f32` nearest to the number.
    pub high: f32,
    /// Remainder that `high` cannot hold.
    pub low: f32,
}

/// `a + b` exactly.
#[inline]
fn two_sum(a: f32, b: f32) -> TwoFloat {
    let high = a + b;
    let b_part = high - a;
    let low = (a - (high - b_part)) + (b - b_part);
    TwoFloat { high, low }
}

/// `a + b` exactly, for |a| ≥ |b| or a = 0.
#[inline]
fn fast_two_sum(a: f32, b: f32) -> TwoFloat {
    let high = a + b;
    TwoFloat {
        high,
        low: b - (high - a),
    }
}

/// `a b` exactly.
#[inline]
fn two_product(a: f32, b: f32) -> TwoFloat {
    let high = a * b;
    let (ca, cb) = (SPLIT * a, SPLIT * b);
    let (a1, b1) = (ca - (ca - a), cb - (cb - b));
    let (a2, b2) = (a - a1, b - b1);
    let low = ((a1 * b1 - high) + a1 * b2 + a2 * b1) + a2 * b2;
    TwoFloat { high, low }
}

impl TwoFloat {
    /// Zero.
    pub const ZERO: Self = Self::from_f32(0.0);
    /// One.
    pub const ONE: Self = Self::from_f32(1.0);

    /// 2π.
    pub const TAU: Self = Self {
        high: TAU,
        low: -1.748_455_5e-7,
    };

    /// `value`, exactly.
    pub const fn from_f32(value: f32) -> Self {
        Self {
            high: value,
            low: 0.0,
        }
    }

    /// The sum of any two numbers, brought to normal form.
    pub fn from_sum(a: f32, b: f32) -> Self {
        two_sum(a, b)
    }

    /// The nearest `f32`.
    #[inline]
    pub fn value(self) -> f32 {
        self.high + self.low
    }

    /// `self + increment`.
    #[inline]
    pub fn plus(self, increment: f32) -> Self {
        let sum = two_sum(self.high, increment);
        fast_two_sum(sum.high, sum.low + self.low)
    }

    /// `self + increment` for an increment that is small beside the number: in a third of the
    /// operations of [`Self::plus`], and as exact while it is. When the increment is the larger one,
    /// an error of half a unit in its own last place remains.
    #[inline(always)]
    pub fn advanced(self, increment: f32) -> Self {
        fast_two_sum(self.high, increment + self.low)
    }

    /// `self − other` rounded to `f32`.
    #[inline]
    pub fn minus(self, other: Self) -> f32 {
        (self - other).value()
    }

    /// This angle (rad) less one turn if that brings it nearer to zero: keeps an angle that moves
    /// by less than a turn at a time within [−π, π].
    #[inline]
    pub fn wrapped_once(self) -> Self {
        if self.high > core::f32::consts::PI {
            self - Self::TAU
        } else if self.high < -core::f32::consts::PI {
            self + Self::TAU
        } else {
            self
        }
    }

    /// True if both parts are finite.
    pub fn is_finite(self) -> bool {
        self.high.is_finite() && self.low.is_finite()
    }
}

impl Neg for TwoFloat {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        Self {
            high: -self.high,
            low: -self.low,
        }
    }
}

impl Add for TwoFloat {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        let high = two_sum(self.high, other.high);
        let low = two_sum(self.low, other.low);
        let sum = fast_two_sum(high.high, high.low + low.high);
        fast_two_sum(sum.high, sum.low + low.low)
    }
}

impl Sub for TwoFloat {
    type Output = Self;
    #[inline]
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for TwoFloat {
    type Output = Self;
    #[inline]
    fn mul(self, other: Self) -> Self {
        let product = two_product(self.high, other.high);
        fast_two_sum(
            product.high,
            product.low + (self.high * other.low + self.low * other.high),
        )
    }
}

impl Div for TwoFloat {
    type Output = Self;
    /// Division by zero gives NaN or infinity, as for `f32`.
    #[inline]
    fn div(self, other: Self) -> Self {
        let first = self.high / other.high;
        let rest = self - other * Self::from_f32(first);
        let second = rest.high / other.high;
        let rest = rest - other * Self::from_f32(second);
        fast_two_sum(first, second).plus(rest.high / other.high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn exact(x: TwoFloat) -> f64 {
        x.high as f64 + x.low as f64
    }

    fn from_f64(x: f64) -> TwoFloat {
        let high = x as f32;
        TwoFloat::from_sum(high, (x - high as f64) as f32)
    }

    properties! {
        #[test]
        fn operations_keep_45_bits(a in -1e3f64..1e3, b in 1e-3f64..1e3) {
            let (p, q) = (from_f64(a), from_f64(b));
            let (a, b) = (exact(p), exact(q));
            let tolerance = 2.0f64.powi(-45);
            let sum = exact(p + q);
            prop_assert!((sum - (a + b)).abs() <= tolerance * (a.abs() + b));
            prop_assert!((exact(p - q) - (a - b)).abs() <= tolerance * (a.abs() + b));
            prop_assert!((exact(p * q) - a * b).abs() <= tolerance * (a * b).abs() + 1e-18);
            prop_assert!((exact(p / q) - a / b).abs() <= tolerance * (a / b).abs() + 1e-18);
        }
    }

    #[test]
    fn a_million_small_increments_are_not_lost() {
        let (mut compensated, mut plain) = (TwoFloat::from_f32(3.0), 3.0f32);
        for _ in 0..1_000_000 {
            compensated = compensated.plus(1e-5);
            plain += 1e-5;
        }
        let truth = 3.0 + 1e6 * 1e-5f32 as f64;
        assert!((exact(compensated) - truth).abs() < 1e-8);
        assert!((plain as f64 - truth).abs() > 1e-3);
    }

    #[test]
    fn advancing_through_zero_a_million_times_loses_nothing() {
        let (mut sum, mut truth) = (TwoFloat::ZERO, 0.0f64);
        for k in 0..1_000_000 {
            let step = 1e-4 * crate::math::trig::sin(k as f32 * 1e-3);
            sum = sum.advanced(step);
            truth += step as f64;
        }
        assert!((exact(sum) - truth).abs() < 1e-8, "{}", exact(sum) - truth);
    }

    #[test]
    fn wrapping_loses_nothing_over_many_turns() {
        let (mut angle, step) = (TwoFloat::ZERO, 0.01f32);
        for _ in 0..1_000_000 {
            angle = angle.plus(step).wrapped_once();
        }
        let turns = step as f64 * 1e6;
        let (s, c) = (turns - exact(angle)).sin_cos();
        assert!(c > 0.0 && s.abs() < 1e-7, "{s:e}");
    }

    #[test]
    fn nan_propagates() {
        let sum = TwoFloat::from_f32(f32::NAN) + TwoFloat::ONE;
        assert!(sum.value().is_nan());
        assert!((TwoFloat::ONE / TwoFloat::ZERO).value().is_nan());
    }
}
