//! Execution of instructions: the frequent ones here, the others by group.

use super::decode16::INVERT;
use super::exception::{Done, Trap};
use super::float;
use super::instruction::{Dsp, Insn, Op, Shift, Special};
use super::timing::REFILL_REGISTER;
use super::{Core, System, Transfer, Width};

#[inline(always)]
const fn half(address: u32, pc: u32) -> Transfer {
    let width = Width::Half;
    Transfer { address, width, pc }
}

#[inline(always)]
const fn byte(address: u32, pc: u32) -> Transfer {
    let width = Width::Byte;
    Transfer { address, width, pc }
}

impl Insn {
    /// True for BKPT, which executes whatever its condition.
    pub(super) fn is_breakpoint(self) -> bool {
        matches!(self.op, Op::Special(Special::Bkpt))
    }
}

impl Core {
    #[inline(always)]
    pub(super) fn reg(&self, number: u8) -> u32 {
        self.r[usize::from(number & 15)]
    }

    /// Sets a register that is neither the stack pointer nor the program counter.
    #[inline(always)]
    pub(super) fn set(&mut self, number: u8, value: u32) {
        self.r[usize::from(number & 15)] = value;
    }

    #[inline(always)]
    pub(super) fn set_nz(&mut self, value: u32) {
        self.n = value;
        self.z = value;
    }

    /// True if a condition holds. Computed without branches, because conditions are hard to predict.
    #[inline(always)]
    pub(super) fn condition(&self, condition: u8) -> bool {
        let (n, z) = (self.negative(), self.z == 0);
        let less = n != self.v;
        let holds = u32::from(z)
            | u32::from(self.c) << 1
            | u32::from(n) << 2
            | u32::from(self.v) << 3
            | u32::from(self.c & !z) << 4
            | u32::from(!less) << 5
            | u32::from(!(less | z)) << 6
            | 1 << 7;
        // "Always" is the last condition and has no inverse.
        let inverse = condition & 1 & u8::from(condition >> 1 != 7);
        holds >> (condition >> 1 & 7) & 1 != u32::from(inverse)
    }

    #[inline(always)]
    fn negative(&self) -> bool {
        (self.n as i32) < 0
    }

    #[inline(always)]
    fn higher(&self) -> bool {
        self.c && self.z != 0
    }

    #[inline(always)]
    fn not_less(&self) -> bool {
        self.negative() == self.v
    }

    #[inline(always)]
    fn greater(&self) -> bool {
        self.z != 0 && self.negative() == self.v
    }

    /// a + b + carry, with flags.
    #[inline(always)]
    pub(super) fn add_flags(&mut self, a: u32, b: u32, carry: bool) -> u32 {
        let (sum, first) = a.overflowing_add(b);
        let (sum, second) = sum.overflowing_add(u32::from(carry));
        self.set_nz(sum);
        self.c = first | second;
        self.v = ((a ^ sum) & (b ^ sum)) >> 31 != 0;
        sum
    }

    /// a − b, with flags.
    #[inline(always)]
    pub(super) fn sub_flags(&mut self, a: u32, b: u32) -> u32 {
        let difference = a.wrapping_sub(b);
        self.set_nz(difference);
        self.c = a >= b;
        self.v = ((a ^ b) & (a ^ difference)) >> 31 != 0;
        difference
    }

    /// Base register plus a constant.
    #[inline(always)]
    pub(super) fn offset(&self, insn: &Insn) -> u32 {
        self.offset_by(insn, insn.imm)
    }

    #[inline(always)]
    fn offset_by(&self, insn: &Insn, by: u32) -> u32 {
        self.reg(insn.n()).wrapping_add(by)
    }

    /// Base register plus a shifted register.
    #[inline(always)]
    pub(super) fn index(&self, insn: &Insn) -> u32 {
        self.offset_by(insn, self.reg(insn.m()) << (insn.imm & 31))
    }

    #[inline(always)]
    fn minus(&self, insn: &Insn) -> u32 {
        self.reg(insn.n()).wrapping_sub(self.reg(insn.m()))
    }

    #[inline(always)]
    fn product(&self, insn: &Insn) -> u32 {
        self.reg(insn.n()).wrapping_mul(self.reg(insn.m()))
    }

    #[inline(always)]
    fn product_sum(&self, insn: &Insn) -> u32 {
        self.product(insn).wrapping_add(self.reg(insn.x()))
    }

    #[inline(always)]
    fn logical_right(&self, insn: &Insn) -> u32 {
        self.reg(insn.m()).checked_shr(insn.imm).unwrap_or(0)
    }

    #[inline(always)]
    fn arithmetic_right(&self, insn: &Insn) -> u32 {
        ((self.reg(insn.m()) as i32) >> insn.imm.min(31)) as u32
    }

    /// UBFX: `imm` bits from bit `x` on.
    #[inline(always)]
    fn bit_field(&self, insn: &Insn) -> u32 {
        self.reg(insn.n()) >> (insn.x() & 31) & (u32::MAX >> ((32 - insn.imm) & 31))
    }

    #[inline(always)]
    fn set_with_nz(&mut self, insn: &Insn, value: u32) {
        self.set_nz(value);
        self.set(insn.d(), value);
    }

    #[inline(always)]
    fn add_s(&mut self, insn: &Insn, b: u32) {
        let value = self.add_flags(self.reg(insn.n()), b, false);
        self.set(insn.d(), value);
    }

    #[inline(always)]
    fn sub_s(&mut self, insn: &Insn, b: u32) {
        let value = self.sub_flags(self.reg(insn.n()), b);
        self.set(insn.d(), value);
    }

    #[inline(always)]
    fn compare(&mut self, insn: &Insn, b: u32) {
        self.sub_flags(self.reg(insn.n()), b);
    }

    /// Address after a conditional branch: the branch's target or `next`.
    #[inline(always)]
    fn branch_if(&mut self, condition: bool, insn: &Insn, next: u32) -> Done<u32> {
        let x = insn.x();
        if condition != (x & INVERT as u8 != 0) {
            self.cycles += u64::from(x & 15);
            Ok(insn.imm)
        } else {
            Ok(next)
        }
    }

    /// Branch to `value`, which may leave Thumb state or request an exception return (BXWritePC). Refilling the
    /// pipeline takes `refill` cycles.
    #[inline(always)]
    pub(super) fn branch_exchange(&mut self, value: u32, refill: u64) -> Done<u32> {
        if value >= 0xf000_0000 && self.ipsr != 0 {
            self.trap_value = value;
            return Err(Trap::ExceptionReturn);
        }
        self.cycles += refill;
        if value & 1 == 0 {
            self.thumb = false;
            self.check_needed = true;
        }
        Ok(value & !1)
    }

    /// Executes an instruction; `next` is the address after the instruction. Returns the address of the instruction to
    /// execute next.
    #[inline(always)]
    pub(super) fn execute(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Done<u32> {
        match insn.op {
            Op::MovImm => self.set(insn.d(), insn.imm),
            Op::MovImmS => self.set_with_nz(insn, insn.imm),
            Op::MovReg => self.set(insn.d(), self.reg(insn.m())),
            Op::MovRegS => self.set_with_nz(insn, self.reg(insn.m())),
            Op::MovTop => self.set(insn.d(), self.reg(insn.d()) & 0xffff | insn.imm),
            Op::AddImm => self.set(insn.d(), self.offset(insn)),
            Op::AddImmS => self.add_s(insn, insn.imm),
            Op::SubImmS => self.sub_s(insn, insn.imm),
            Op::AddReg => self.set(insn.d(), self.offset_by(insn, self.reg(insn.m()))),
            Op::AddRegS => self.add_s(insn, self.reg(insn.m())),
            Op::SubReg => self.set(insn.d(), self.minus(insn)),
            Op::SubRegS => self.sub_s(insn, self.reg(insn.m())),
            Op::AddLsl => self.set(insn.d(), self.index(insn)),
            Op::LslImm => self.set(insn.d(), self.reg(insn.m()) << (insn.imm & 31)),
            Op::LsrImm => self.set(insn.d(), self.logical_right(insn)),
            Op::AsrImm => self.set(insn.d(), self.arithmetic_right(insn)),
            Op::LslImmS => self.shift_flags(Shift::Lsl, insn),
            Op::LsrImmS => self.shift_flags(Shift::Lsr, insn),
            Op::CmpImm => self.compare(insn, insn.imm),
            Op::CmpReg => self.compare(insn, self.reg(insn.m())),
            Op::AluImm(alu) => self.set(insn.d(), self.alu(alu, self.reg(insn.n()), insn.imm)),
            Op::AluReg(alu) => self.alu_register(alu, insn),
            Op::AluRegS(alu) => self.alu_register_flags(alu, insn),
            Op::AluImmS(_) | Op::AluShift(_) | Op::AluShiftS(_) => self.execute_data(insn)?,
            Op::ShiftReg(_) | Op::ShiftRegS(_) | Op::TstImm => self.execute_data(insn)?,
            Op::SpImm => self.set_sp(self.offset(insn)),
            Op::Mul => self.set(insn.d(), self.product(insn)),
            Op::Mla => self.set(insn.d(), self.product_sum(insn)),
            Op::Mask => self.set(insn.d(), self.reg(insn.m()) & insn.imm),
            Op::Ubfx => self.set(insn.d(), self.bit_field(insn)),
            Op::It => self.it = insn.imm as u8,
            Op::B => return Ok(insn.imm),
            Op::BranchZero => return self.branch_if(self.z == 0, insn, next),
            Op::BranchCarry => return self.branch_if(self.c, insn, next),
            Op::BranchNegative => return self.branch_if(self.negative(), insn, next),
            Op::BranchHigher => return self.branch_if(self.higher(), insn, next),
            Op::BranchGreaterEqual => return self.branch_if(self.not_less(), insn, next),
            Op::BranchGreater => return self.branch_if(self.greater(), insn, next),
            Op::BranchRegister => return self.branch_if(self.reg(insn.n()) == 0, insn, next),
            Op::Bl => return Ok(self.link(next, insn.imm)),
            Op::Bx => return self.branch_exchange(self.reg(insn.m()), REFILL_REGISTER),
            Op::LdrImm => self.load_into(system, insn, Transfer::word(self.offset(insn), pc))?,
            Op::LdrbImm => self.load_into(system, insn, byte(self.offset(insn), pc))?,
            Op::LdrhImm => self.load_into(system, insn, half(self.offset(insn), pc))?,
            Op::LdrReg => self.load_into(system, insn, Transfer::word(self.index(insn), pc))?,
            Op::LdrbReg => self.load_into(system, insn, byte(self.index(insn), pc))?,
            Op::LdrLit => self.load_into(system, insn, Transfer::word(insn.imm, pc))?,
            Op::StrImm => self.store_from(system, insn, Transfer::word(self.offset(insn), pc))?,
            Op::StrbImm => self.store_from(system, insn, byte(self.offset(insn), pc))?,
            Op::StrhImm => self.store_from(system, insn, half(self.offset(insn), pc))?,
            Op::StrReg => self.store_from(system, insn, Transfer::word(self.index(insn), pc))?,
            Op::LdrsbImm | Op::LdrshImm | Op::LdrsbReg | Op::LdrshReg | Op::LdrhReg => {
                self.execute_load(system, insn, pc)?
            }
            Op::LoadPre(_) | Op::LoadPost(_) => self.execute_load(system, insn, pc)?,
            Op::StrbReg | Op::StrhReg => self.execute_store(system, insn, pc)?,
            Op::StorePre(_) | Op::StorePost(_) => self.execute_store(system, insn, pc)?,
            Op::Ldrd | Op::Strd => self.move_double(system, insn, pc)?,
            Op::Push => self.push(system, insn, pc)?,
            Op::Pop | Op::PopPc => return self.pop(system, insn, pc, next),
            Op::Vldr => self.load_single(system, insn, pc)?,
            Op::Vstr => self.store_single(system, insn, pc)?,
            Op::VmovReg => self.unary(system, insn, |m| m)?,
            Op::Vadd => self.binary(system, insn, float::add)?,
            Op::Vsub => self.binary(system, insn, float::sub)?,
            Op::Vmul => self.binary(system, insn, float::mul)?,
            Op::Vcmp => self.compare_singles(system, insn)?,
            Op::VmrsFlags => self.take_fp_flags(system, insn)?,
            Op::VmovToCore => self.move_to_core(system, insn)?,
            Op::VmovFromCore => self.move_from_core(system, insn)?,
            Op::Vneg => self.unary(system, insn, |m| m ^ float::SIGN)?,
            Op::Vabs => self.unary(system, insn, |m| m & !float::SIGN)?,
            Op::Vfma => self.ternary(system, insn, float::fma)?,
            Op::Vmla => self.ternary(system, insn, float::multiply_add)?,
            _ => return self.execute_rest(system, insn, pc, next),
        }
        Ok(next)
    }

    /// Executes the instructions that are not inlined.
    #[inline(never)]
    fn execute_rest(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Done<u32> {
        match insn.op {
            Op::Empty => return Err(Trap::Undecoded),
            Op::Undefined => return Err(Trap::Undefined),
            Op::Unpredictable => return Err(Trap::Unpredictable),
            Op::NoCoprocessor => return Err(Trap::NoCoprocessor),
            Op::Blx => return Ok(self.call_register(insn, next)),
            Op::BranchOverflow => return self.branch_if(self.v, insn, next),
            Op::Ldm => return self.load_multiple(system, insn, pc, next),
            Op::Stm => self.store_multiple(system, insn, pc)?,
            Op::VmovImm => self.unary(system, insn, |_| insn.imm)?,
            Op::Vdiv => self.divide_single(system, insn)?,
            Op::Vmls | Op::Vfms => self.subtract_product(system, insn)?,
            Op::Float(op) => self.execute_rare_float(system, insn, op, pc)?,
            Op::Special(Special::Dsb) => system.synchronise(),
            Op::Special(op) => self.execute_special(insn, op)?,
            Op::Dsp(op @ (Dsp::Parallel | Dsp::Saturating | Dsp::Sel)) => {
                self.execute_parallel(insn, op);
            }
            Op::Dsp(op) => self.execute_dsp(insn, op),
            Op::LoadLit(_) | Op::LoadUser(_) => self.execute_load(system, insn, pc)?,
            Op::StoreUser(_) => self.execute_store(system, insn, pc)?,
            Op::Ldrex(_) | Op::Strex(_) => self.execute_exclusive(system, insn, pc)?,
            Op::LoadTo(_) | Op::Table | Op::MovPc | Op::AddPc => {
                return self.execute_jump(system, insn, pc, next);
            }
            _ => self.execute_data(insn)?,
        }
        Ok(next)
    }

    /// BL: sets the return address; returns the target.
    #[inline(always)]
    fn link(&mut self, next: u32, target: u32) -> u32 {
        self.r[14] = next | 1;
        target
    }

    /// BLX by register; never an exception return.
    fn call_register(&mut self, insn: &Insn, next: u32) -> u32 {
        let target = self.reg(insn.m());
        self.cycles += REFILL_REGISTER;
        if target & 1 == 0 {
            self.thumb = false;
            self.check_needed = true;
        }
        self.link(next, target & !1)
    }
}
