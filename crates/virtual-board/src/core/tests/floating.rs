//! Floating point, compared with the host's arithmetic and with the manual's rules for NaN, zero and flags.

use crate::core::float::{self, fpscr::*};

/// Pseudo-random single-precision numbers, including special ones; many have similar exponents.
struct Numbers(u64);

impl Numbers {
    fn bits(&mut self) -> u32 {
        const FACTOR: u64 = 6_364_136_223_846_793_005;
        self.0 = self.0.wrapping_mul(FACTOR).wrapping_add(1);
        (self.0 >> 32) as u32
    }

    /// Any bit pattern, including NaN.
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
}

const ROUNDS: usize = 300_000;

fn same(ours: u32, host: f32, what: &str, operands: [u32; 3]) {
    let bits = host.to_bits();
    let equal = ours == bits || (f32::from_bits(ours).is_nan() && host.is_nan());
    assert!(equal, "{what} {operands:x?}: {ours:#x}, host {bits:#x}");
}

#[test]
fn fast_and_exact_versions_round_to_nearest_as_the_host_does() {
    let mut numbers = Numbers(1);
    for _ in 0..ROUNDS {
        let (a, b, c) = (numbers.any(), numbers.any(), numbers.any());
        let (x, y, z) = (f32::from_bits(a), f32::from_bits(b), f32::from_bits(c));
        // Without the inexact flag, all operations use the exact version.
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
fn fast_and_exact_versions_set_the_same_flags() {
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
            let results = [&mut exact, &mut fast].map(|status| operation(a, b, c, status));
            assert_eq!(results[0], results[1]);
            assert_eq!(exact | IXC, fast, "{a:x} {b:x} {c:x}");
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
    /// Operation, operands, status before, and the result with the flags set by the operation.
    struct FloatRow(Operation, [u32; 2], u32, [u32; 2]);
    let table = [
        FloatRow(float::add, [QNAN, SNAN], 0, [SNAN | 1 << 22, IOC]),
        FloatRow(float::add, [QNAN, ONE], 0, [QNAN, 0]),
        FloatRow(float::add, [ONE, QNAN], DN, [DEFAULT, 0]),
        FloatRow(float::mul, [SNAN, QNAN], DN, [DEFAULT, IOC]),
        FloatRow(float::add, [INF, INF | 1 << 31], 0, [DEFAULT, IOC]),
        FloatRow(float::mul, [INF, 0], 0, [DEFAULT, IOC]),
        FloatRow(float::div, [0, 0], 0, [DEFAULT, IOC]),
        FloatRow(float::div, [ONE, 1 << 31], 0, [INF | 1 << 31, DZC]),
        FloatRow(float::mul, [BIG, BIG], 0, [INF, OFC | IXC]),
        FloatRow(float::mul, [BIG, BIG], 3 << 22, [BIG, OFC | IXC]),
        FloatRow(float::mul, [BIG, BIG], 2 << 22, [BIG, OFC | IXC]),
        FloatRow(float::mul, [BIG, BIG], 1 << 22, [INF, OFC | IXC]),
        FloatRow(float::mul, [TINY, TINY], 0, [0, UFC | IXC]),
        FloatRow(float::mul, [TINY, TINY], 1 << 22, [1, UFC | IXC]),
        FloatRow(float::mul, [TINY, 0x3f00_0000], 0, [0x0040_0000, 0]),
        FloatRow(float::mul, [TINY, 0x3f00_0000], FZ, [0, UFC]),
        FloatRow(float::add, [1, TINY], FZ, [TINY, IDC]),
        FloatRow(float::add, [ONE, ONE | 1 << 31], 0, [0, 0]),
        FloatRow(float::sub, [ONE, ONE], 2 << 22, [1 << 31, 0]),
        FloatRow(float::sub, [ONE, SNAN], 0, [SNAN | 1 << 22, IOC]),
    ];
    for (k, FloatRow(operation, [a, b], before, expected)) in table.into_iter().enumerate() {
        let mut status = before;
        let result = operation(a, b, &mut status);
        let [value, flags] = expected;
        assert_eq!([result, status], [value, before | flags], "row {k}");
    }
    // A quiet NaN added to infinity times zero is invalid.
    let mut status = 0;
    assert_eq!(float::fma(QNAN, INF, 0, &mut status), DEFAULT);
    assert_eq!(status, IOC);
}
