//! Floating point against the host's arithmetic, against exact arithmetic in double precision, and
//! against the rules of the manual for NaN, zero and flags.

use super::*;
use crate::core::float::{self, fpscr::*};

/// A sequence of singles, special ones among them; exponents of neighbours are near each other.
struct Numbers(u64);

impl Numbers {
    fn bits(&mut self) -> u32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 32) as u32
    }

    /// Any pattern, NaN included.
    fn any(&mut self) -> u32 {
        const SPECIAL: [u32; 12] = [
            0,
            1,
            0x007f_ffff,
            0x0080_0000,
            0x0080_0001,
            0x3f80_0000,
            0x7f7f_ffff,
            0x7f80_0000,
            0x7fc0_1234,
            0x7f80_0001,
            0x4b80_0000,
            0x3400_0000,
        ];
        let draw = self.bits();
        match draw % 8 {
            0 => SPECIAL[(draw >> 8) as usize % 12] | draw & 1 << 31,
            1 => self.bits() & 0x81ff_ffff,
            2 | 3 => self.bits(),
            _ => self.bits() & 0x807f_ffff | (120 + (draw >> 8) % 16) << 23,
        }
    }

    /// An ordinary number.
    fn ordinary(&mut self) -> f32 {
        let exponent = 110 + self.bits() % 30;
        f32::from_bits(self.bits() & 0x807f_ffff | exponent << 23)
    }
}

const MODES: [u32; 4] = [0, 1, 2, 3];
const ROUNDS: usize = 300_000;

fn same(ours: u32, host: f32, what: &str, operands: [u32; 3]) {
    let equal = ours == host.to_bits() || (f32::from_bits(ours).is_nan() && host.is_nan());
    assert!(
        equal,
        "{what} {operands:x?}: {ours:#x}, host {:#x}",
        host.to_bits()
    );
}

#[test]
fn rounding_to_nearest_agrees_with_the_host_by_both_ways() {
    let mut numbers = Numbers(1);
    for _ in 0..ROUNDS {
        let (a, b, c) = (numbers.any(), numbers.any(), numbers.any());
        let (x, y, z) = (f32::from_bits(a), f32::from_bits(b), f32::from_bits(c));
        // Without the inexact flag everything goes through integers.
        for status in [0, IXC] {
            let s = &mut status.clone();
            same(float::add(a, b, s), x + y, "add", [a, b, c]);
            same(float::sub(a, b, s), x - y, "sub", [a, b, c]);
            same(float::mul(a, b, s), x * y, "mul", [a, b, c]);
            same(float::div(a, b, s), x / y, "div", [a, b, c]);
            same(float::sqrt(a, s), x.sqrt(), "sqrt", [a, b, c]);
            same(float::fma(c, a, b, s), x.mul_add(y, z), "fma", [a, b, c]);
        }
    }
}

#[test]
fn both_ways_raise_the_same_flags() {
    let mut numbers = Numbers(2);
    for _ in 0..ROUNDS {
        let (a, b, c) = (numbers.any(), numbers.any(), numbers.any());
        type Operation = fn(u32, u32, u32, &mut u32) -> u32;
        let operations: [Operation; 4] = [
            |a, b, _, s| float::add(a, b, s),
            |a, b, _, s| float::mul(a, b, s),
            |a, b, _, s| float::div(a, b, s),
            |a, b, c, s| float::fma(c, a, b, s),
        ];
        for operation in operations {
            let (mut exact, mut fast) = (0, IXC);
            assert_eq!(
                operation(a, b, c, &mut exact),
                operation(a, b, c, &mut fast)
            );
            assert_eq!(exact | IXC, fast, "{a:x} {b:x} {c:x}");
        }
    }
}

/// Whether `result` is `exact` rounded as the mode says, neither nearer ones left out.
fn is_rounded(result: f32, exact: f64, mode: u32) -> bool {
    let r = f64::from(result);
    let (below, above) = (f64::from(result.next_down()), f64::from(result.next_up()));
    match mode {
        0 => {
            (r - exact).abs() <= (below - exact).abs() && (r - exact).abs() <= (above - exact).abs()
        }
        1 => r >= exact && below < exact,
        2 => r <= exact && above > exact,
        _ if exact >= 0.0 => r <= exact && above > exact,
        _ => r >= exact && below < exact,
    }
}

#[test]
fn directed_rounding_lies_on_the_right_side_and_inexact_is_told() {
    let mut numbers = Numbers(3);
    for _ in 0..ROUNDS {
        let (x, y) = (numbers.ordinary(), numbers.ordinary());
        let (a, b) = (x.to_bits(), y.to_bits());
        // Exact in double precision: 48 bits, and exponents at most 30 apart with 24 bits.
        let product = f64::from(x) * f64::from(y);
        let sum = f64::from(x) + f64::from(y);
        for mode in MODES {
            let mut status = mode << 22;
            let result = f32::from_bits(float::mul(a, b, &mut status));
            assert!(
                is_rounded(result, product, mode),
                "{x} * {y} = {result} ({mode})"
            );
            assert_eq!(status & IXC != 0, f64::from(result) != product);
            let mut status = mode << 22;
            let result = f32::from_bits(float::add(a, b, &mut status));
            if sum != 0.0 {
                let exact =
                    f64::from(x) == sum - f64::from(y) && f64::from(y) == sum - f64::from(x);
                assert!(
                    !exact || is_rounded(result, sum, mode),
                    "{x} + {y} = {result} ({mode})"
                );
            }
            // The quotient times the divisor lies on the side of the dividend that it must.
            let mut status = mode << 22;
            let quotient = f32::from_bits(float::div(a, b, &mut status));
            let back = f64::from(quotient) * f64::from(y);
            let over = (back - f64::from(x)) * f64::from(y).signum();
            match mode {
                1 => assert!(over >= 0.0),
                2 => assert!(over <= 0.0),
                3 => assert!(back.abs() <= f64::from(x).abs()),
                _ => {}
            }
            assert_eq!(status & IXC != 0, over != 0.0);
            let mut status = mode << 22;
            let root = f32::from_bits(float::sqrt(a & !(1 << 31), &mut status));
            let square = f64::from(root) * f64::from(root);
            let over = square - f64::from(x.abs());
            match mode {
                1 => assert!(over >= 0.0),
                2 | 3 => assert!(over <= 0.0),
                _ => {}
            }
            assert_eq!(status & IXC != 0, over != 0.0);
        }
    }
}

#[test]
fn nan_zero_and_flags_follow_the_manual() {
    const INF: u32 = 0x7f80_0000;
    const QNAN: u32 = 0x7fc0_0001;
    const SNAN: u32 = 0xff80_0002;
    const ONE: u32 = 0x3f80_0000;
    const BIG: u32 = 0x7f7f_ffff;
    const TINY: u32 = 0x0080_0000;
    const DEFAULT: u32 = 0x7fc0_0000;
    type Operation = fn(u32, u32, &mut u32) -> u32;
    /// An operation, its operands, the status before, and the result with the flags it raises.
    struct Row(Operation, [u32; 2], u32, [u32; 2]);
    let table = [
        Row(float::add, [QNAN, SNAN], 0, [SNAN | 1 << 22, IOC]),
        Row(float::add, [QNAN, ONE], 0, [QNAN, 0]),
        Row(float::add, [ONE, QNAN], DN, [DEFAULT, 0]),
        Row(float::mul, [SNAN, QNAN], DN, [DEFAULT, IOC]),
        Row(float::add, [INF, INF | 1 << 31], 0, [DEFAULT, IOC]),
        Row(float::mul, [INF, 0], 0, [DEFAULT, IOC]),
        Row(float::div, [0, 0], 0, [DEFAULT, IOC]),
        Row(float::div, [ONE, 1 << 31], 0, [INF | 1 << 31, DZC]),
        Row(float::mul, [BIG, BIG], 0, [INF, OFC | IXC]),
        Row(float::mul, [BIG, BIG], 3 << 22, [BIG, OFC | IXC]),
        Row(float::mul, [BIG, BIG], 2 << 22, [BIG, OFC | IXC]),
        Row(float::mul, [BIG, BIG], 1 << 22, [INF, OFC | IXC]),
        Row(float::mul, [TINY, TINY], 0, [0, UFC | IXC]),
        Row(float::mul, [TINY, TINY], 1 << 22, [1, UFC | IXC]),
        Row(float::mul, [TINY, 0x3f00_0000], 0, [0x0040_0000, 0]),
        Row(float::mul, [TINY, 0x3f00_0000], FZ, [0, UFC]),
        Row(float::add, [1, TINY], FZ, [TINY, IDC]),
        Row(float::add, [ONE, ONE | 1 << 31], 0, [0, 0]),
        Row(float::sub, [ONE, ONE], 2 << 22, [1 << 31, 0]),
        Row(float::sub, [ONE, SNAN], 0, [SNAN | 1 << 22, IOC]),
    ];
    for (k, Row(operation, [a, b], before, expected)) in table.into_iter().enumerate() {
        let mut status = before;
        let result = operation(a, b, &mut status);
        assert_eq!(
            [result, status],
            [expected[0], before | expected[1]],
            "row {k}"
        );
    }
    // A quiet NaN that is added to infinity times zero is invalid all the same.
    let mut status = 0;
    assert_eq!(float::fma(QNAN, INF, 0, &mut status), DEFAULT);
    assert_eq!(status, IOC);
}

#[test]
fn tininess_is_found_before_rounding() {
    // (1 - 2^-24) * 2^-126: rounds up to the smallest normal number, and is an underflow.
    let mut status = 0;
    let result = float::mul(0x0080_0000, 0x3f7f_ffff, &mut status);
    assert_eq!((result, status), (0x0080_0000, UFC | IXC));
}

#[test]
fn comparisons_order_all_but_nan() {
    let mut numbers = Numbers(4);
    for _ in 0..ROUNDS {
        let (a, b) = (numbers.any(), numbers.any());
        let (x, y) = (f32::from_bits(a), f32::from_bits(b));
        let expected = match x.partial_cmp(&y) {
            Some(std::cmp::Ordering::Less) => 0b1000,
            Some(std::cmp::Ordering::Equal) => 0b0110,
            Some(std::cmp::Ordering::Greater) => 0b0010,
            None => 0b0011,
        };
        let (mut quiet, mut signalling) = (0, 0);
        assert_eq!(float::compare(a, b, false, &mut quiet), expected);
        assert_eq!(float::compare(a, b, true, &mut signalling), expected);
        assert_eq!(signalling & IOC != 0, expected == 0b0011);
        let is_signalling = |bits: u32| f32::from_bits(bits).is_nan() && bits & 1 << 22 == 0;
        assert_eq!(quiet & IOC != 0, is_signalling(a) || is_signalling(b));
    }
}

#[test]
fn integers_convert_as_the_language_does_it() {
    let mut numbers = Numbers(5);
    let fixed = |unsigned| float::Fixed {
        fraction: 0,
        bits: 32,
        unsigned,
    };
    for _ in 0..ROUNDS {
        let a = numbers.any();
        let x = f32::from_bits(a);
        let mut status = 0;
        let to_integer = |mode| float::to_fixed(a, fixed(false), mode, &mut 0);
        let truncated = float::to_fixed(a, fixed(false), 3, &mut status);
        assert_eq!(truncated, x as i32 as u32);
        let outside = x.is_nan() || x.trunc() < -2_147_483_648.0 || x >= 2_147_483_648.0;
        assert_eq!(status & IOC != 0, outside, "{x}");
        assert_eq!(status & IXC != 0, !outside && x.trunc() != x, "{x}");
        assert_eq!(float::to_fixed(a, fixed(true), 3, &mut status), x as u32);
        let rounded = [x.round_ties_even(), x.ceil(), x.floor()];
        assert_eq!([0, 1, 2].map(to_integer), rounded.map(|x| x as i32 as u32));
        let word = numbers.bits() >> (a % 32);
        let signed = f32::from_bits(float::from_fixed(i64::from(word as i32), 0, 0, &mut status));
        assert_eq!(signed, word as i32 as f32);
        let unsigned = f32::from_bits(float::from_fixed(i64::from(word), 0, 0, &mut status));
        assert_eq!(unsigned, word as f32);
        let scaled = float::from_fixed(i64::from(word as i32), 9, 0, &mut status);
        assert_eq!(f32::from_bits(scaled), word as i32 as f32 / 512.0);
    }
}

#[test]
fn every_half_comes_back_and_halves_are_the_nearest() {
    let value = |half: u16| {
        let (exponent, fraction) = (i32::from(half >> 10 & 31), f64::from(half & 0x3ff));
        let size = if exponent == 0 {
            fraction * 2f64.powi(-24)
        } else {
            (1024.0 + fraction) * 2f64.powi(exponent - 25)
        };
        if half >> 15 != 0 { -size } else { size }
    };
    for half in 0..=u16::MAX {
        let mut status = 0;
        let single = float::from_half(half, &mut status);
        let nan = half & 0x7fff > 0x7c00;
        if !nan && half & 0x7c00 != 0x7c00 {
            assert_eq!(f64::from(f32::from_bits(single)), value(half));
        }
        let back = float::to_half(single, &mut status);
        assert_eq!(back, if nan { half | 0x200 } else { half });
        assert_eq!(status & IXC, 0);
    }
    let mut numbers = Numbers(6);
    for _ in 0..ROUNDS {
        let x = numbers.ordinary() / 16.0;
        let mut status = 0;
        let half = float::to_half(x.to_bits(), &mut status);
        if half & 0x7c00 == 0x7c00 {
            assert!(x.abs() >= 65_520.0 && status & OFC != 0);
            continue;
        }
        let distance = (value(half) - f64::from(x)).abs();
        for other in [half.wrapping_add(1), half.wrapping_sub(1)] {
            if other & 0x7c00 != 0x7c00 {
                assert!(distance <= (value(other) - f64::from(x)).abs(), "{x}");
            }
        }
        assert_eq!(status & IXC != 0, distance != 0.0);
    }
    // The alternative format has numbers where the other has infinity.
    let mut status = AHP;
    assert_eq!(
        f32::from_bits(float::from_half(0x7c00, &mut status)),
        65_536.0
    );
    assert_eq!(float::to_half(0x7f80_0000, &mut status), 0x7fff);
    assert_eq!(status, AHP | IOC);
}

#[test]
fn instructions_move_and_compute() {
    // vmov s1, r0; vmov s2, r1; vadd s3, s1, s2; vfnms s3, s1, s2; vcmp s1, s2; vmrs apsr, fpscr;
    // vmov r2, s3; vcvt.s32.f32 s4, s2; vmov r3, s4; vmov r4, r5, s1, s2; bkpt
    let program = [
        0xee00, 0x0a90, 0xee01, 0x1a10, 0xee70, 0x1a81, 0xeed0, 0x1a81, 0xeef4, 0x0a41, 0xeef1,
        0xfa10, 0xee11, 0x2a90, 0xeebd, 0x2ac1, 0xee12, 0x3a10, 0xec55, 0x4a30, 0xbe00,
    ];
    let (a, b) = (3.5f32, -2.75f32);
    let mut machine = Machine::new(&program).registers(&[(0, a.to_bits()), (1, b.to_bits())]);
    machine.set_private(CPACR, 0x00f0_0000);
    machine.run_to_breakpoint();
    assert_eq!(f32::from_bits(machine.r(2)), a * b - (a + b));
    assert_eq!(machine.r(3) as i32, -2);
    assert_eq!(machine.core.xpsr() >> 28, 0b0010);
    assert_eq!((machine.r(4), machine.r(5)), (a.to_bits(), b.to_bits()));
}
