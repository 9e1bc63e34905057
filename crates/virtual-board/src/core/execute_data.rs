//! Less frequent data processing: logic, shifts, comparisons, long multiplication, division.

use super::Core;
use super::exception::{Done, Trap};
use super::instruction::{Alu, Insn, Op, RRX, Shift, Test};
use super::scb::ccr;

impl Insn {
    /// Carry flag after a modified constant; `old` is the flag before.
    #[inline(always)]
    pub(super) fn carry(self, old: bool) -> bool {
        match self.x() {
            0 => old,
            x => x == 2,
        }
    }
}

/// Shift by 0 to 255, with carry.
fn shift(kind: Shift, value: u32, by: u32, carry: bool) -> (u32, bool) {
    if by == 0 {
        return (value, carry);
    }
    let wide = u64::from(value);
    match kind {
        Shift::Lsl => match by {
            1..=32 => ((wide << by) as u32, wide << by >> 32 & 1 != 0),
            _ => (0, false),
        },
        Shift::Lsr => match by {
            1..=32 => ((wide >> by) as u32, wide >> (by - 1) & 1 != 0),
            _ => (0, false),
        },
        Shift::Asr => {
            let (signed, by) = (i64::from(value as i32), by.min(32));
            ((signed >> by) as u32, signed >> (by - 1) & 1 != 0)
        }
        Shift::Ror => {
            let result = value.rotate_right(by & 31);
            (result, result >> 31 != 0)
        }
    }
}

/// Shift by an encoded constant, with carry.
fn shift_constant(kind: u8, value: u32, by: u32, carry: bool) -> (u32, bool) {
    if kind == RRX {
        return (value >> 1 | u32::from(carry) << 31, value & 1 != 0);
    }
    shift(Shift::of(u32::from(kind)), value, by, carry)
}

/// Cycles of a division: 2 to 12, about one for each four bits of the quotient.
fn division_cycles(dividend: u32, divisor: u32) -> u64 {
    if divisor == 0 || dividend < divisor {
        return 2;
    }
    let bits = divisor.leading_zeros() - dividend.leading_zeros();
    (u64::from(bits) / 4 + 3).min(12)
}

impl Core {
    /// TST, TEQ, CMP, CMN; `carry` comes from the second operand.
    #[inline]
    pub(super) fn test(&mut self, test: Test, a: u32, b: u32, carry: bool) {
        match test {
            Test::Tst => {
                self.set_nz(a & b);
                self.c = carry;
            }
            Test::Teq => {
                self.set_nz(a ^ b);
                self.c = carry;
            }
            Test::Cmp => {
                self.sub_flags(a, b);
            }
            Test::Cmn => {
                self.add_flags(a, b, false);
            }
        }
    }

    /// ALU operation without flags.
    #[inline(never)]
    pub(super) fn alu(&self, alu: Alu, a: u32, b: u32) -> u32 {
        let carry = u32::from(self.c);
        match alu {
            Alu::And => a & b,
            Alu::Bic => a & !b,
            Alu::Orr => a | b,
            Alu::Orn => a | !b,
            Alu::Eor => a ^ b,
            Alu::Add => a.wrapping_add(b),
            Alu::Adc => a.wrapping_add(b).wrapping_add(carry),
            Alu::Sbc => a.wrapping_add(!b).wrapping_add(carry),
            Alu::Sub => a.wrapping_sub(b),
            Alu::Rsb => b.wrapping_sub(a),
            Alu::Mov => b,
            Alu::Mvn => !b,
        }
    }

    /// ALU operation with flags; `carry` comes from the second operand.
    #[inline]
    fn alu_flags(&mut self, alu: Alu, a: u32, b: u32, carry: bool) -> u32 {
        match alu {
            Alu::Add => self.add_flags(a, b, false),
            Alu::Adc => self.add_flags(a, b, self.c),
            Alu::Sbc => self.add_flags(a, !b, self.c),
            Alu::Sub => self.sub_flags(a, b),
            Alu::Rsb => self.sub_flags(b, a),
            _ => {
                let value = self.alu(alu, a, b);
                self.set_nz(value);
                self.c = carry;
                value
            }
        }
    }

    #[inline(never)]
    pub(super) fn alu_register(&mut self, alu: Alu, insn: &Insn) {
        let (n, m) = (self.reg(insn.n()), self.reg(insn.m()));
        self.set(insn.d(), self.alu(alu, n, m));
    }

    #[inline(never)]
    pub(super) fn alu_register_flags(&mut self, alu: Alu, insn: &Insn) {
        let (n, m) = (self.reg(insn.n()), self.reg(insn.m()));
        let value = self.alu_flags(alu, n, m, self.c);
        self.set(insn.d(), value);
    }

    /// Shift by a constant, with flags.
    #[inline]
    pub(super) fn shift_flags(&mut self, kind: Shift, insn: &Insn) {
        let (value, carry) = shift(kind, self.reg(insn.m()), insn.imm, self.c);
        self.set_nz(value);
        self.c = carry;
        self.set(insn.d(), value);
    }

    #[inline(never)]
    pub(super) fn execute_data(&mut self, insn: &Insn) -> Done {
        let (n, m) = (self.reg(insn.n()), self.reg(insn.m()));
        match insn.op {
            Op::AluImmS(alu) => {
                let value = self.alu_flags(alu, n, insn.imm, insn.carry(self.c));
                self.set(insn.d(), value);
            }
            Op::AluShift(alu) => {
                let (b, _) = shift_constant(insn.x(), m, insn.imm, self.c);
                self.set(insn.d(), self.alu(alu, n, b));
            }
            Op::AluShiftS(alu) => {
                let (b, carry) = shift_constant(insn.x(), m, insn.imm, self.c);
                let value = self.alu_flags(alu, n, b, carry);
                self.set(insn.d(), value);
            }
            Op::AsrImmS => self.shift_flags(Shift::Asr, insn),
            Op::ShiftReg(kind) => {
                let (value, _) = shift(kind, n, m & 0xff, self.c);
                self.set(insn.d(), value);
            }
            Op::ShiftRegS(kind) => {
                let (value, carry) = shift(kind, n, m & 0xff, self.c);
                self.set_nz(value);
                self.c = carry;
                self.set(insn.d(), value);
            }
            Op::TestReg(test) => self.test(test, n, m, self.c),
            Op::TstImm => self.test(Test::Tst, n, insn.imm, insn.carry(self.c)),
            Op::TestImm(test) => self.test(test, n, insn.imm, insn.carry(self.c)),
            Op::TestShift(test) => {
                let (b, carry) = shift_constant(insn.x(), m, insn.imm, self.c);
                self.test(test, n, b, carry);
            }
            Op::SpShift(alu) => {
                let b = m << (insn.imm & 31);
                let value = if insn.x() & 0x80 != 0 {
                    self.alu_flags(alu, n, b, self.c)
                } else {
                    self.alu(alu, n, b)
                };
                self.set_sp(value);
            }
            Op::SpMov => self.set_sp(m),
            _ => return self.execute_multiply(insn),
        }
        Ok(())
    }

    fn execute_multiply(&mut self, insn: &Insn) -> Done {
        let (n, m) = (self.reg(insn.n()), self.reg(insn.m()));
        let accumulator = u64::from(self.reg(insn.x())) << 32 | u64::from(self.reg(insn.d()));
        let unsigned = u64::from(n) * u64::from(m);
        let signed = (i64::from(n as i32) * i64::from(m as i32)) as u64;
        match insn.op {
            Op::MulS => {
                self.set_nz(unsigned as u32);
                self.set(insn.d(), unsigned as u32);
            }
            Op::Mls => {
                let value = self.reg(insn.x()).wrapping_sub(unsigned as u32);
                self.set(insn.d(), value);
            }
            Op::Umull => self.set_long(insn, unsigned),
            Op::Smull => self.set_long(insn, signed),
            Op::Umlal => self.set_long(insn, accumulator.wrapping_add(unsigned)),
            Op::Smlal => self.set_long(insn, accumulator.wrapping_add(signed)),
            Op::Udiv => {
                self.cycles += division_cycles(n, m) - 2;
                let value = n.checked_div(m).map_or_else(|| self.divide_by_zero(), Ok)?;
                self.set(insn.d(), value);
            }
            Op::Sdiv => {
                let (a, b) = (n as i32, m as i32);
                self.cycles += division_cycles(a.unsigned_abs(), b.unsigned_abs()) - 2;
                let value = if b == 0 {
                    self.divide_by_zero()?
                } else {
                    a.wrapping_div(b) as u32
                };
                self.set(insn.d(), value);
            }
            Op::Sbfx => {
                let up = to_top(insn);
                let value = ((n << up) as i32) >> ((32 - insn.imm) & 31);
                self.set(insn.d(), value as u32);
            }
            Op::Clz => self.set(insn.d(), m.leading_zeros()),
            Op::Rev => self.set(insn.d(), m.swap_bytes()),
            Op::Sxtb => self.set(insn.d(), m as i8 as u32),
            Op::Sxth => self.set(insn.d(), m as i16 as u32),
            _ => return Err(Trap::Undefined),
        }
        Ok(())
    }

    /// Result of a division by zero: 0, or a usage fault if enabled.
    fn divide_by_zero(&self) -> Done<u32> {
        if self.scb.ccr & ccr::DIV_0_TRP != 0 {
            Err(Trap::DivideByZero)
        } else {
            Ok(0)
        }
    }

    /// Stores a 64-bit result: low word in d, high word in x.
    pub(super) fn set_long(&mut self, insn: &Insn, value: u64) {
        self.set(insn.d(), value as u32);
        self.set(insn.x(), (value >> 32) as u32);
    }
}

/// Left shift that moves the highest bit of a bit field to bit 31.
fn to_top(insn: &Insn) -> u32 {
    (32 - u32::from(insn.x()) - insn.imm) & 31
}
