//! Comparison of single-precision numbers, and conversion from and to integers, fixed point and half precision.

use super::fpscr::{AHP, IOC, IXC};
use super::{
    Exact, Format, INFINITY, NEAREST, SINGLE, Value, quiet, round, signalling, split, unpack, zero,
};

/// Flags N, Z, C, V of a comparison. `signal`: a quiet NaN is also invalid.
#[inline]
pub fn compare(a: u32, b: u32, signal: bool, status: &mut u32) -> u32 {
    // Most operands are numbers that no setting of FPSCR affects.
    let regular = |bits: u32| bits << 1 == 0 || super::ordinary(bits);
    if regular(a) && regular(b) {
        return order(f32::from_bits(a), f32::from_bits(b));
    }
    compare_exact(a, b, signal, status)
}

/// Flags of a comparison without NaN.
#[inline]
fn order(a: f32, b: f32) -> u32 {
    if a == b {
        0b0110
    } else if a < b {
        0b1000
    } else {
        0b0010
    }
}

fn compare_exact(a: u32, b: u32, signal: bool, status: &mut u32) -> u32 {
    let (x, y) = (unpack(a, status), unpack(b, status));
    let nan = |v| match v {
        Value::Nan(bits) => Some(signalling(bits)),
        _ => None,
    };
    if let (Some(first), second) | (second, Some(first)) = (nan(x), nan(y)) {
        if signal || first || second == Some(true) {
            *status |= IOC;
        }
        return 0b0011;
    }
    let flushed = |v, bits| match v {
        Value::Zero(_) => 0.0,
        _ => f32::from_bits(bits),
    };
    order(flushed(x, a), flushed(y, b))
}

/// Rounding mode selected in the status register.
pub(in crate::core) const fn mode(status: u32) -> u32 {
    status >> 22 & 3
}

/// Rounding towards zero.
pub(in crate::core) const TOWARDS_ZERO: u32 = 3;

/// Format of an integer or a fixed-point number.
#[derive(Clone, Copy)]
pub struct Fixed {
    /// Number of fraction bits.
    pub fraction: u32,
    /// Total number of bits.
    pub bits: u32,
    /// True if the format has no negative numbers.
    pub unsigned: bool,
}

/// Converts to a fixed-point number of 32 bits or fewer, saturated (FPToFixed); `mode` as in the status register.
pub fn to_fixed(a: u32, fixed: Fixed, mode: u32, status: &mut u32) -> u32 {
    let value = match unpack(a, status) {
        Value::Nan(_) => {
            *status |= IOC;
            return 0;
        }
        Value::Zero(_) => return 0,
        Value::Infinity(negative) => return saturate(negative, fixed, status),
        Value::Finite(v) => v,
    };
    let shift = value.exponent + fixed.fraction as i32;
    // The magnitude is at least 2⁴¹: the result saturates.
    if shift > 40 {
        return saturate(value.negative, fixed, status);
    }
    let (whole, rest) = if shift >= 0 {
        ((value.mantissa << shift) as i128, 0)
    } else {
        let (whole, rest) = split(value.mantissa, shift);
        (i128::from(whole), rest)
    };
    let up = match mode {
        NEAREST => rest > 2 || (rest == 2 && whole & 1 != 0),
        1 => rest != 0 && !value.negative,
        2 => rest != 0 && value.negative,
        _ => false,
    };
    let whole = whole + i128::from(up);
    let result = if value.negative { -whole } else { whole };
    let (min, max) = range(fixed);
    if result < min || result > max {
        return saturate(value.negative, fixed, status);
    }
    if rest != 0 {
        *status |= IXC;
    }
    result as u32
}

fn range(fixed: Fixed) -> (i128, i128) {
    if fixed.unsigned {
        (0, (1 << fixed.bits) - 1)
    } else {
        (-(1 << (fixed.bits - 1)), (1 << (fixed.bits - 1)) - 1)
    }
}

fn saturate(negative: bool, fixed: Fixed, status: &mut u32) -> u32 {
    *status |= IOC;
    let (min, max) = range(fixed);
    (if negative { min } else { max }) as u32
}

/// Converts from a fixed-point number, already extended to 64 bits (FixedToFP).
pub fn from_fixed(value: i64, fraction: u32, mode: u32, status: &mut u32) -> u32 {
    if value == 0 {
        return 0;
    }
    let exact = Exact {
        negative: value < 0,
        mantissa: u128::from(value.unsigned_abs()),
        exponent: -(fraction as i32),
    };
    round(exact, SINGLE, mode, status)
}

/// Converts from half precision.
pub fn from_half(half: u16, status: &mut u32) -> u32 {
    let half = u32::from(half);
    let (negative, exponent, fraction) = (half >> 15 != 0, half >> 10 & 31, half & 0x3ff);
    let sign = zero(negative);
    match (exponent, fraction) {
        (0, 0) => sign,
        (31, 0) if *status & AHP == 0 => sign | INFINITY,
        (31, _) if *status & AHP == 0 => quiet(sign | INFINITY | fraction << 13, status),
        (0, _) => sign | (fraction as f32 / 16_777_216.0).to_bits(),
        _ => sign | (exponent + 112) << 23 | fraction << 13,
    }
}

/// Converts to half precision.
pub fn to_half(a: u32, status: &mut u32) -> u16 {
    let alternative = *status & AHP != 0;
    let format = Format {
        exponent: 5,
        fraction: 10,
        alternative,
    };
    let sign = (a >> 16 & 0x8000) as u16;
    match unpack(a, status) {
        Value::Zero(_) => sign,
        Value::Infinity(_) if alternative => {
            *status |= IOC;
            sign | 0x7fff
        }
        Value::Infinity(_) => sign | 0x7c00,
        Value::Nan(bits) => {
            if alternative {
                *status |= IOC;
                return sign;
            }
            let nan = quiet(bits, status);
            (nan >> 16 & 0x8000 | 0x7e00 | nan >> 13 & 0x1ff) as u16
        }
        Value::Finite(v) => round(v, format, mode(*status), status) as u16,
    }
}
