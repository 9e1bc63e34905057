//! Bit fields, saturation, packing and the DSP extension.

use super::Core;
use super::instruction::{Dsp, Insn};

/// Saturates to a signed number of `bits`; true if the value changed.
fn saturate_signed(value: i64, bits: u32) -> (u32, bool) {
    let limit = 1i64 << (bits - 1);
    let result = value.clamp(-limit, limit - 1);
    (result as u32, result != value)
}

/// Saturates to an unsigned number of `bits`; true if the value changed.
fn saturate_unsigned(value: i64, bits: u32) -> (u32, bool) {
    let result = value.clamp(0, (1 << bits) - 1);
    (result as u32, result != value)
}

/// A halfword as a signed number; `upper` is 0 for the lower halfword, 1 for the upper halfword.
fn half(value: u32, upper: u32) -> i64 {
    i64::from((value >> (16 * upper)) as i16)
}

impl Core {
    /// Sets Q after an overflow.
    fn note_overflow(&mut self, overflow: bool) {
        self.q |= overflow;
    }

    /// Stores a 32-bit sum unsaturated; sets Q if it overflows.
    fn set_with_overflow(&mut self, insn: &Insn, value: i64) {
        self.note_overflow(value != i64::from(value as i32));
        self.set(insn.d(), value as u32);
    }

    /// 64-bit accumulator: low word in d, high word in x.
    fn long(&self, insn: &Insn) -> i64 {
        (u64::from(self.reg(insn.x())) << 32 | u64::from(self.reg(insn.d()))) as i64
    }

    fn accumulator(&self, insn: &Insn) -> i64 {
        i64::from(self.reg(insn.x()) as i32)
    }

    /// Sum of the two products of halfwords, or difference if bit 1 of `imm` is set; bit 0 exchanges the halfwords of
    /// m.
    fn dual(&self, insn: &Insn) -> i64 {
        let (n, m) = (self.reg(insn.n()), self.reg(insn.m()));
        let m = m.rotate_right(16 * (insn.imm & 1));
        let (low, high) = (half(n, 0) * half(m, 0), half(n, 1) * half(m, 1));
        if insn.imm & 2 != 0 {
            low - high
        } else {
            low + high
        }
    }

    fn half_product(&self, insn: &Insn) -> i64 {
        half(self.reg(insn.n()), insn.imm >> 1 & 1) * half(self.reg(insn.m()), insn.imm & 1)
    }

    fn wide_product(&self, insn: &Insn) -> i64 {
        let factor = half(self.reg(insn.m()), insn.imm & 1);
        (i64::from(self.reg(insn.n()) as i32) * factor) >> 16
    }

    /// Upper word of accumulator ± product, rounded if bit 0 of `imm` is set.
    fn upper_product(&self, insn: &Insn, accumulator: i64, sign: i64) -> u32 {
        let product = i64::from(self.reg(insn.n()) as i32) * i64::from(self.reg(insn.m()) as i32);
        let rounding = if insn.imm & 1 != 0 { 0x8000_0000 } else { 0 };
        let sum = (accumulator << 32)
            .wrapping_add(product.wrapping_mul(sign))
            .wrapping_add(rounding);
        (sum >> 32) as u32
    }

    #[inline(never)]
    pub(super) fn execute_dsp(&mut self, insn: &Insn, op: Dsp) {
        let (n, m) = (self.reg(insn.n()), self.reg(insn.m()));
        let (low, width) = (u32::from(insn.x()), insn.imm);
        match op {
            Dsp::Bfi | Dsp::Bfc => {
                let mask = u32::MAX >> ((32 - width) & 31) << (low & 31);
                let source = if op == Dsp::Bfi { n << (low & 31) } else { 0 };
                self.set(insn.d(), self.reg(insn.d()) & !mask | source & mask);
            }
            Dsp::Rbit => self.set(insn.d(), m.reverse_bits()),
            Dsp::Rev16 => self.set(insn.d(), m.swap_bytes().rotate_right(16)),
            Dsp::Revsh => self.set(insn.d(), (m as u16).swap_bytes() as i16 as u32),
            Dsp::Extend => self.extend(insn),
            Dsp::Pkh => {
                let value = if insn.imm == 0 {
                    n & 0xffff | (m << (low & 31)) & 0xffff_0000
                } else {
                    n & 0xffff_0000 | ((i64::from(m as i32) >> low) as u32) & 0xffff
                };
                self.set(insn.d(), value);
            }
            Dsp::Ssat | Dsp::Usat => {
                let value = if width & 0x100 != 0 {
                    (n as i32) >> (low & 31)
                } else {
                    (n << (low & 31)) as i32
                };
                let bits = width & 0xff;
                let (value, overflow) = if op == Dsp::Ssat {
                    saturate_signed(i64::from(value), bits)
                } else {
                    saturate_unsigned(i64::from(value), bits)
                };
                self.note_overflow(overflow);
                self.set(insn.d(), value);
            }
            Dsp::Ssat16 | Dsp::Usat16 => {
                let one = |upper| {
                    if op == Dsp::Ssat16 {
                        saturate_signed(half(n, upper), width)
                    } else {
                        saturate_unsigned(half(n, upper), width)
                    }
                };
                let ((low, first), (high, second)) = (one(0), one(1));
                self.note_overflow(first || second);
                self.set(insn.d(), high << 16 | low & 0xffff);
            }
            Dsp::Usad => {
                let mut sum = if insn.imm != 0 { self.reg(insn.x()) } else { 0 };
                for k in 0..4 {
                    let (a, b) = ((n >> (8 * k)) as u8, (m >> (8 * k)) as u8);
                    sum = sum.wrapping_add(u32::from(a.abs_diff(b)));
                }
                self.set(insn.d(), sum);
            }
            _ => self.execute_products(insn, op),
        }
    }

    fn execute_products(&mut self, insn: &Insn, op: Dsp) {
        match op {
            Dsp::SmulHalf => self.set(insn.d(), self.half_product(insn) as u32),
            Dsp::SmlaHalf => {
                let value = self.half_product(insn) + self.accumulator(insn);
                self.set_with_overflow(insn, value);
            }
            Dsp::SmulWide => self.set(insn.d(), self.wide_product(insn) as u32),
            Dsp::SmlaWide => {
                let value = self.wide_product(insn) + self.accumulator(insn);
                self.set_with_overflow(insn, value);
            }
            Dsp::SmulDual => {
                let value = self.dual(insn);
                self.set_with_overflow(insn, value);
            }
            Dsp::SmlaDual => {
                let value = self.dual(insn) + self.accumulator(insn);
                self.set_with_overflow(insn, value);
            }
            Dsp::SmlalDual => {
                let value = self.long(insn).wrapping_add(self.dual(insn));
                self.set_long(insn, value as u64);
            }
            Dsp::SmlalHalf => {
                let value = self.long(insn).wrapping_add(self.half_product(insn));
                self.set_long(insn, value as u64);
            }
            Dsp::Smmul => self.set(insn.d(), self.upper_product(insn, 0, 1)),
            Dsp::Smmla => {
                let value = self.upper_product(insn, self.accumulator(insn), 1);
                self.set(insn.d(), value);
            }
            Dsp::Smmls => {
                let value = self.upper_product(insn, self.accumulator(insn), -1);
                self.set(insn.d(), value);
            }
            Dsp::Umaal => {
                let product = u64::from(self.reg(insn.n())) * u64::from(self.reg(insn.m()));
                let value = product + u64::from(self.reg(insn.x())) + u64::from(self.reg(insn.d()));
                self.set_long(insn, value);
            }
            _ => {}
        }
    }

    /// SXTH and similar: rotates, extends, adds.
    fn extend(&mut self, insn: &Insn) {
        let value = self.reg(insn.m()).rotate_right(insn.imm);
        let n = if insn.n() == 15 {
            0
        } else {
            self.reg(insn.n())
        };
        let halves = |low: u32, high: u32| {
            let low = n.wrapping_add(low) & 0xffff;
            let high = (n >> 16).wrapping_add(high) << 16;
            high | low
        };
        let result = match insn.x() {
            0 => n.wrapping_add(value as i16 as u32),
            1 => n.wrapping_add(value & 0xffff),
            2 => halves(value as i8 as u32, (value >> 16) as i8 as u32),
            3 => halves(value & 0xff, value >> 16 & 0xff),
            4 => n.wrapping_add(value as i8 as u32),
            _ => n.wrapping_add(value & 0xff),
        };
        self.set(insn.d(), result);
    }

    #[inline(never)]
    pub(super) fn execute_parallel(&mut self, insn: &Insn, op: Dsp) {
        let (n, m) = (self.reg(insn.n()), self.reg(insn.m()));
        let value = match op {
            Dsp::Sel => {
                let mut mask = 0;
                for k in 0..4 {
                    mask |= (0xff * (self.ge >> k & 1)) << (8 * k);
                }
                n & mask | m & !mask
            }
            Dsp::Saturating => self.saturating(insn.x(), n, m),
            _ => self.parallel(insn, n, m),
        };
        self.set(insn.d(), value);
    }

    /// QADD, QDADD, QSUB, QDSUB: m ± n; n is doubled if bit 0 of `kind` is set.
    fn saturating(&mut self, kind: u8, n: u32, m: u32) -> u32 {
        let (mut n, m) = (i64::from(n as i32), i64::from(m as i32));
        if kind & 1 != 0 {
            let (doubled, overflow) = saturate_signed(2 * n, 32);
            n = i64::from(doubled as i32);
            self.note_overflow(overflow);
        }
        let sum = if kind & 2 != 0 { m - n } else { m + n };
        let (value, overflow) = saturate_signed(sum, 32);
        self.note_overflow(overflow);
        value
    }

    /// Parallel additions and subtractions of halfwords or bytes.
    fn parallel(&mut self, insn: &Insn, n: u32, m: u32) -> u32 {
        let bytes = insn.x() & 3 == 0;
        let (lanes, bits) = if bytes { (4, 8) } else { (2, 16) };
        let unsigned = insn.imm & 4 != 0;
        let kind = insn.imm & 3;
        let mask = (1 << bits) - 1;
        let lane = |value: u32, k: u32| {
            let part = value >> (bits * k) & mask;
            if unsigned {
                part as i32
            } else {
                (part << (32 - bits)) as i32 >> (32 - bits)
            }
        };
        let (mut result, mut ge) = (0, 0);
        for k in 0..lanes {
            // Value of x: 0 and 1 add, 4 and 5 subtract. 2 and 6 exchange the halfwords of m, then add in one half and
            // subtract in the other half.
            let (other, subtract) = match insn.x() {
                2 => (1 - k, k == 0),
                6 => (1 - k, k == 1),
                x => (k, x & 4 != 0),
            };
            let (a, b) = (lane(n, k), lane(m, other));
            let sum = if subtract { a - b } else { a + b };
            let whole = match (kind, unsigned) {
                (1, false) => saturate_signed(i64::from(sum), bits).0,
                (1, true) => saturate_unsigned(i64::from(sum), bits).0,
                (2, _) => (sum >> 1) as u32,
                _ => sum as u32,
            };
            result |= (whole & mask) << (bits * k);
            // GE is set by the carry of an unsigned sum, and otherwise by a result that is not negative.
            let greater = if unsigned && !subtract {
                sum > mask as i32
            } else {
                sum >= 0
            };
            if greater {
                ge |= if bytes { 1 << k } else { 3 << (2 * k) };
            }
        }
        if kind == 0 {
            self.ge = ge;
        }
        result
    }
}
