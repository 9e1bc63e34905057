//! Single-precision arithmetic of FPv4-SP (ARMv7-M Architecture Reference Manual, A2.5).
//!
//! Each operation takes operands as bits and the status register, returns bits and adds the cumulative exception flags.
//! All rounding modes, flush to zero, default NaN and NaN propagation are implemented. Results are exact.
//!
//! Each operation has a fast and an exact version. The fast version uses the host's arithmetic if the result is certain
//! to be the same: rounding to nearest, no flush to zero, no default NaN, inexact flag already set, and a result that
//! is an exact zero or far enough from zero and infinity that no other flag can be set. The exact version uses
//! integers.

/// Bits of the status and control register.
pub mod fpscr {
    /// Negative, zero, carry, overflow.
    pub const NZCV: u32 = 0xf000_0000;
    /// Alternative half precision.
    pub const AHP: u32 = 1 << 26;
    /// Default NaN.
    pub const DN: u32 = 1 << 25;
    /// Flush to zero.
    pub const FZ: u32 = 1 << 24;
    /// Rounding mode.
    pub const RMODE: u32 = 3 << 22;
    /// An input was flushed to zero.
    pub const IDC: u32 = 1 << 7;
    /// Inexact.
    pub const IXC: u32 = 1 << 4;
    /// Underflow.
    pub const UFC: u32 = 1 << 3;
    /// Overflow.
    pub const OFC: u32 = 1 << 2;
    /// Division by zero.
    pub const DZC: u32 = 1 << 1;
    /// Invalid operation.
    pub const IOC: u32 = 1;
    /// Implemented bits.
    pub const WRITABLE: u32 = NZCV | AHP | DN | FZ | RMODE | IDC | 0x1f;
}

use std::cmp::Ordering;

use fpscr::{DN, DZC, FZ, IDC, IOC, IXC, OFC, RMODE, UFC};

mod convert;

pub use convert::{Fixed, compare, from_fixed, from_half, to_fixed, to_half};
pub(super) use convert::{TOWARDS_ZERO, mode};

pub(super) const SIGN: u32 = 1 << 31;
const INFINITY: u32 = 0x7f80_0000;
const DEFAULT_NAN: u32 = 0x7fc0_0000;
const QUIET: u32 = 1 << 22;

/// True if this status permits the host's arithmetic, see the documentation of the module.
#[inline(always)]
fn plain(status: u32) -> bool {
    status & (DN | FZ | RMODE | IXC) == IXC
}

/// True if the value is not near zero, infinite or NaN: biased exponent 2 to 254.
#[inline(always)]
fn ordinary(bits: u32) -> bool {
    ((bits >> 23 & 0xff).wrapping_sub(2)) < 253
}

/// True if [`ordinary`] or zero. Both permit the host's sum, because a sum that is zero is always exact.
#[inline(always)]
fn ordinary_sum(bits: u32) -> bool {
    ordinary(bits) || bits << 1 == 0
}

/// An unpacked number.
#[derive(Clone, Copy)]
enum Value {
    Zero(bool),
    Infinity(bool),
    /// The bits of a NaN.
    Nan(u32),
    Finite(Exact),
}

/// ± mantissa · 2^exponent. The lowest bit of the mantissa may be sticky: it then stands for all lower bits.
#[derive(Clone, Copy)]
pub(super) struct Exact {
    pub(super) negative: bool,
    pub(super) mantissa: u128,
    pub(super) exponent: i32,
}

/// Format of a result: numbers of exponent and fraction bits.
#[derive(Clone, Copy)]
pub(super) struct Format {
    pub(super) exponent: u32,
    pub(super) fraction: u32,
    /// True if the format has no infinity and no NaN: the largest exponent is that of numbers (alternative half
    /// precision).
    pub(super) alternative: bool,
}

pub(super) const SINGLE: Format = Format {
    exponent: 8,
    fraction: 23,
    alternative: false,
};

const fn zero(negative: bool) -> u32 {
    (negative as u32) << 31
}

const fn infinity(negative: bool) -> u32 {
    zero(negative) | INFINITY
}

/// Unpacks a single-precision number; with flush to zero a denormal becomes zero.
fn unpack(bits: u32, status: &mut u32) -> Value {
    let (negative, exponent, fraction) = (bits >> 31 != 0, bits >> 23 & 0xff, bits & 0x7f_ffff);
    match (exponent, fraction) {
        (0, 0) => Value::Zero(negative),
        (0, _) if *status & FZ != 0 => {
            *status |= IDC;
            Value::Zero(negative)
        }
        (0, _) => Value::Finite(Exact {
            negative,
            mantissa: u128::from(fraction),
            exponent: -149,
        }),
        (255, 0) => Value::Infinity(negative),
        (255, _) => Value::Nan(bits),
        _ => Value::Finite(Exact {
            negative,
            mantissa: u128::from(fraction | 0x80_0000),
            exponent: exponent as i32 - 150,
        }),
    }
}

/// Result of an invalid operation.
fn invalid(status: &mut u32) -> u32 {
    *status |= IOC;
    DEFAULT_NAN
}

const fn signalling(bits: u32) -> bool {
    bits & QUIET == 0
}

fn quiet(bits: u32, status: &mut u32) -> u32 {
    if signalling(bits) {
        *status |= IOC;
    }
    if *status & DN != 0 {
        DEFAULT_NAN
    } else {
        bits | QUIET
    }
}

/// NaN result for NaN operands: the first signalling NaN, else the first NaN; `None` if no operand is NaN.
fn propagate(values: &[Value], status: &mut u32) -> Option<u32> {
    let nans = || {
        values.iter().filter_map(|value| match value {
            Value::Nan(bits) => Some(*bits),
            _ => None,
        })
    };
    let first = nans().find(|&bits| signalling(bits)).or(nans().next())?;
    Some(quiet(first, status))
}

/// Shifts right; the lowest bit of the result is sticky.
fn shift_right(mantissa: u128, by: u32) -> u128 {
    if by == 0 {
        return mantissa;
    }
    if by >= 128 {
        return u128::from(mantissa != 0);
    }
    mantissa >> by | u128::from(mantissa << (128 - by) != 0)
}

/// Mode 0: round to nearest, ties to even.
const NEAREST: u32 = 0;

/// Rounds an exact value other than zero to a format (FPRound).
pub(super) fn round(value: Exact, format: Format, mode: u32, status: &mut u32) -> u32 {
    let Exact {
        negative,
        mantissa,
        exponent,
    } = value;
    let fraction = format.fraction as i32;
    let min_exponent = 2 - (1 << (format.exponent - 1));
    let top = exponent + 127 - mantissa.leading_zeros() as i32;
    let sign = u32::from(negative) << (format.exponent + format.fraction);
    let single = format.exponent == 8;
    if single && *status & FZ != 0 && top < min_exponent {
        *status |= UFC;
        return sign;
    }
    let shift = exponent - (top.max(min_exponent) - fraction);
    let (whole, error) = split(mantissa, shift);
    let mut biased = if top < min_exponent {
        0
    } else {
        top - min_exponent + 1
    };
    if biased == 0 && error != 0 {
        *status |= UFC;
    }
    let up = match mode {
        NEAREST => error > 2 || (error == 2 && whole & 1 != 0),
        1 => error != 0 && !negative,
        2 => error != 0 && negative,
        _ => false,
    };
    let mut whole = whole + u32::from(up);
    if biased == 0 && whole == 1 << fraction {
        biased = 1;
    }
    if whole == 2 << fraction {
        biased += 1;
        whole >>= 1;
    }
    let limit = (1 << format.exponent) - i32::from(!format.alternative);
    if biased >= limit {
        return overflow(sign, negative, format, mode, status);
    }
    if error != 0 {
        *status |= IXC;
    }
    let hidden = if biased == 0 { 0 } else { 1 << fraction };
    sign | (((biased as u32) << fraction) + (whole - hidden))
}

/// Mantissa shifted left by `shift` (right if negative), and a code of the remainder: 0 none, 1 below one half, 2 one
/// half, 3 above one half.
fn split(mantissa: u128, shift: i32) -> (u32, u32) {
    if shift >= 0 {
        return ((mantissa << shift) as u32, 0);
    }
    let by = shift.unsigned_abs();
    if by > 128 {
        return (0, u32::from(mantissa != 0));
    }
    let whole = if by == 128 { 0 } else { mantissa >> by };
    let rest = if by == 128 {
        mantissa
    } else {
        mantissa - (whole << by)
    };
    let rest = match rest.cmp(&(1 << (by - 1))) {
        _ if rest == 0 => 0,
        Ordering::Less => 1,
        Ordering::Equal => 2,
        Ordering::Greater => 3,
    };
    (whole as u32, rest)
}

fn overflow(sign: u32, negative: bool, format: Format, mode: u32, status: &mut u32) -> u32 {
    if format.alternative {
        *status |= IOC;
        return sign | 0x7fff;
    }
    *status |= OFC | IXC;
    let infinite = match mode {
        NEAREST => true,
        1 => !negative,
        2 => negative,
        _ => false,
    };
    let infinity = ((1 << format.exponent) - 1) << format.fraction;
    sign | (infinity - u32::from(!infinite))
}

fn round_single(value: Exact, status: &mut u32) -> u32 {
    round(value, SINGLE, *status >> 22 & 3, status)
}

/// Sum of two exact values; the sign of a zero depends on the rounding mode.
fn sum(a: Exact, b: Exact, status: &mut u32) -> u32 {
    let top = |v: &Exact| v.exponent - v.mantissa.leading_zeros() as i32;
    let (large, small) = if top(&a) >= top(&b) { (a, b) } else { (b, a) };
    // The larger operand is shifted up to bit 120, so bits lost from the smaller one are far below the last place.
    let up = large.mantissa.leading_zeros() - 7;
    let (mantissa, exponent) = (large.mantissa << up, large.exponent - up as i32);
    let distance = small.exponent - exponent;
    let other = if distance >= 0 {
        small.mantissa << distance
    } else {
        shift_right(small.mantissa, distance.unsigned_abs())
    };
    let (negative, mantissa) = if large.negative == small.negative {
        (large.negative, mantissa + other)
    } else if mantissa >= other {
        (large.negative, mantissa - other)
    } else {
        (small.negative, other - mantissa)
    };
    if mantissa == 0 {
        return zero(*status & RMODE == 2 << 22);
    }
    let exact = Exact {
        negative,
        mantissa,
        exponent,
    };
    round_single(exact, status)
}

fn add_exact(a: u32, b: u32, status: &mut u32) -> u32 {
    let (a, b) = (unpack(a, status), unpack(b, status));
    if let Some(nan) = propagate(&[a, b], status) {
        return nan;
    }
    add_values(a, b, status)
}

fn add_values(a: Value, b: Value, status: &mut u32) -> u32 {
    match (a, b) {
        (Value::Infinity(s), Value::Infinity(t)) if s != t => invalid(status),
        (Value::Infinity(s), _) | (_, Value::Infinity(s)) => infinity(s),
        (Value::Zero(s), Value::Zero(t)) if s == t => zero(s),
        (Value::Zero(_), Value::Zero(_)) => zero(*status & RMODE == 2 << 22),
        (Value::Finite(v), Value::Zero(_)) | (Value::Zero(_), Value::Finite(v)) => {
            round_single(v, status)
        }
        (Value::Finite(v), Value::Finite(w)) => sum(v, w, status),
        (Value::Nan(bits), _) | (_, Value::Nan(bits)) => bits,
    }
}

/// a + b.
#[inline]
pub fn add(a: u32, b: u32, status: &mut u32) -> u32 {
    if plain(*status) {
        let result = (f32::from_bits(a) + f32::from_bits(b)).to_bits();
        if ordinary_sum(result) {
            return result;
        }
    }
    add_exact(a, b, status)
}

/// a − b.
#[inline]
pub fn sub(a: u32, b: u32, status: &mut u32) -> u32 {
    if plain(*status) {
        let result = (f32::from_bits(a) - f32::from_bits(b)).to_bits();
        if ordinary_sum(result) {
            return result;
        }
    }
    sub_exact(a, b, status)
}

/// a − b; a subtracted NaN keeps its sign.
fn sub_exact(a: u32, b: u32, status: &mut u32) -> u32 {
    let nan = b << 1 > INFINITY << 1;
    add_exact(a, if nan { b } else { b ^ SIGN }, status)
}

fn mul_exact(a: u32, b: u32, status: &mut u32) -> u32 {
    let (a, b) = (unpack(a, status), unpack(b, status));
    if let Some(nan) = propagate(&[a, b], status) {
        return nan;
    }
    match product(a, b) {
        None => invalid(status),
        Some(Value::Zero(s)) => zero(s),
        Some(Value::Infinity(s)) => infinity(s),
        Some(Value::Finite(v)) => round_single(v, status),
        Some(Value::Nan(bits)) => bits,
    }
}

/// Exact product of two values other than NaN; `None` for infinity times zero.
fn product(a: Value, b: Value) -> Option<Value> {
    let negative = |v| match v {
        Value::Zero(s) | Value::Infinity(s) => s,
        Value::Finite(v) => v.negative,
        Value::Nan(_) => false,
    };
    let sign = negative(a) != negative(b);
    match (a, b) {
        (Value::Infinity(_), Value::Zero(_)) | (Value::Zero(_), Value::Infinity(_)) => None,
        (Value::Infinity(_), _) | (_, Value::Infinity(_)) => Some(Value::Infinity(sign)),
        (Value::Finite(v), Value::Finite(w)) => Some(Value::Finite(Exact {
            negative: sign,
            mantissa: v.mantissa * w.mantissa,
            exponent: v.exponent + w.exponent,
        })),
        _ => Some(Value::Zero(sign)),
    }
}

/// a · b.
#[inline]
pub fn mul(a: u32, b: u32, status: &mut u32) -> u32 {
    if plain(*status) {
        let result = (f32::from_bits(a) * f32::from_bits(b)).to_bits();
        // Zero times a number is exact; a zero by underflow is not.
        let nothing = result << 1 == 0 && (a << 1 == 0 || b << 1 == 0);
        if ordinary(result) || nothing {
            return result;
        }
    }
    mul_exact(a, b, status)
}

fn div_exact(a: u32, b: u32, status: &mut u32) -> u32 {
    let (a, b) = (unpack(a, status), unpack(b, status));
    if let Some(nan) = propagate(&[a, b], status) {
        return nan;
    }
    match (a, b) {
        (Value::Infinity(_), Value::Infinity(_)) | (Value::Zero(_), Value::Zero(_)) => {
            invalid(status)
        }
        (Value::Infinity(s), Value::Zero(t)) => infinity(s != t),
        (Value::Infinity(s), Value::Finite(w)) => infinity(s != w.negative),
        (Value::Finite(v), Value::Zero(t)) => {
            *status |= DZC;
            infinity(v.negative != t)
        }
        (Value::Zero(s), Value::Finite(w)) => zero(s != w.negative),
        (Value::Zero(s), Value::Infinity(t)) => zero(s != t),
        (Value::Finite(v), Value::Infinity(t)) => zero(v.negative != t),
        (Value::Finite(v), Value::Finite(w)) => {
            let up = v.mantissa << 64;
            let exact = Exact {
                negative: v.negative != w.negative,
                mantissa: (up / w.mantissa) | u128::from(up % w.mantissa != 0),
                exponent: v.exponent - w.exponent - 64,
            };
            round_single(exact, status)
        }
        (Value::Nan(bits), _) | (_, Value::Nan(bits)) => bits,
    }
}

/// a / b.
#[inline]
pub fn div(a: u32, b: u32, status: &mut u32) -> u32 {
    if plain(*status) {
        let result = (f32::from_bits(a) / f32::from_bits(b)).to_bits();
        if ordinary(result) {
            return result;
        }
    }
    div_exact(a, b, status)
}

/// Square root.
pub fn sqrt(a: u32, status: &mut u32) -> u32 {
    let value = unpack(a, status);
    match value {
        Value::Nan(bits) => quiet(bits, status),
        Value::Zero(s) => zero(s),
        Value::Infinity(false) => INFINITY,
        Value::Infinity(true) => invalid(status),
        Value::Finite(v) if v.negative => invalid(status),
        Value::Finite(v) => {
            if plain(*status) {
                return f32::from_bits(a).sqrt().to_bits();
            }
            // The exponent is made even, and the mantissa long enough for more than 24 bits of root.
            let up = 80 + (v.exponent & 1) as u32;
            let (mantissa, exponent) = (v.mantissa << up, v.exponent - up as i32);
            let root = mantissa.isqrt();
            let exact = Exact {
                negative: false,
                mantissa: root << 1 | u128::from(root * root != mantissa),
                exponent: exponent / 2 - 1,
            };
            round_single(exact, status)
        }
    }
}

/// c + a · b; the product is rounded, too.
#[inline]
pub fn multiply_add(c: u32, a: u32, b: u32, status: &mut u32) -> u32 {
    let product = mul(a, b, status);
    add(c, product, status)
}

/// c + a · b, rounded once.
#[inline]
pub fn fma(c: u32, a: u32, b: u32, status: &mut u32) -> u32 {
    if plain(*status) {
        // The product is exact in double precision. The sum is rounded to odd, so a second rounding to single precision
        // gives the same result as a single rounding.
        let p = f64::from(f32::from_bits(a)) * f64::from(f32::from_bits(b));
        let c = f64::from(f32::from_bits(c));
        let s = p + c;
        let v = s - p;
        let rest = (p - (s - v)) + (c - v);
        let mut bits = s.to_bits();
        if rest != 0.0 && bits & 1 == 0 {
            bits = if (rest > 0.0) == (s > 0.0) {
                bits + 1
            } else {
                bits - 1
            };
        }
        let result = (f64::from_bits(bits) as f32).to_bits();
        if ordinary(result) {
            return result;
        }
    }
    fma_exact(c, a, b, status)
}

fn fma_exact(c: u32, a: u32, b: u32, status: &mut u32) -> u32 {
    let c = unpack(c, status);
    let (a, b) = (unpack(a, status), unpack(b, status));
    if let Value::Nan(bits) = c
        && !signalling(bits)
        && matches!(
            (a, b),
            (Value::Infinity(_), Value::Zero(_)) | (Value::Zero(_), Value::Infinity(_))
        )
    {
        return invalid(status);
    }
    if let Some(nan) = propagate(&[c, a, b], status) {
        return nan;
    }
    let Some(product) = product(a, b) else {
        return invalid(status);
    };
    add_values(c, product, status)
}
