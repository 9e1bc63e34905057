//! What instructions do: the frequent ones here, the rest by group.

use super::exception::Trap;
use super::execute_memory::sizes;
use super::float;
use super::instruction::{Dsp, Insn, Op, Special, Test};
use super::{Core, System, timing};

impl Insn {
    /// BKPT, which no condition skips.
    pub(super) fn is_breakpoint(&self) -> bool {
        self.op == Op::Special(Special::Bkpt)
    }
}

impl Core {
    /// A register.
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

    /// Whether a condition holds.
    #[inline]
    pub(super) fn condition(&self, condition: u8) -> bool {
        let holds = match condition >> 1 & 7 {
            0 => self.z == 0,
            1 => self.c,
            2 => self.negative(),
            3 => self.v,
            4 => self.higher(),
            5 => self.negative() == self.v,
            6 => self.greater(),
            _ => return true,
        };
        holds != (condition & 1 != 0)
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

    /// A branch within the program.
    #[inline(always)]
    fn branch_if(&mut self, taken: bool, insn: &Insn, pc: u32) -> u32 {
        if taken {
            self.cycles += u64::from(insn.x);
            insn.imm
        } else {
            pc.wrapping_add(u32::from(insn.size))
        }
    }

    /// A branch to a value that may change the state or return from an exception (BXWritePC).
    #[inline(always)]
    pub(super) fn branch_exchange(&mut self, value: u32, refill: u64) -> Result<u32, Trap> {
        if value >= 0xf000_0000 && self.ipsr != 0 {
            self.trap_value = value;
            return Err(Trap::ExceptionReturn);
        }
        self.cycles += refill;
        if value & 1 == 0 {
            self.thumb = false;
            self.attend = true;
        }
        Ok(value & !1)
    }

    /// Executes an instruction; gives the address of the next one.
    #[inline(always)]
    pub(super) fn execute<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
    ) -> Result<u32, Trap> {
        let next = pc.wrapping_add(u32::from(insn.size));
        match insn.op {
            Op::MovImm => self.set(insn.d, insn.imm),
            Op::MovImmS => {
                self.set_nz(insn.imm);
                self.set(insn.d, insn.imm);
            }
            Op::MovReg => self.set(insn.d, self.reg(insn.m)),
            Op::MovRegS => {
                let value = self.reg(insn.m);
                self.set_nz(value);
                self.set(insn.d, value);
            }
            Op::MovTop => self.set(insn.d, self.reg(insn.d) & 0xffff | insn.imm),
            Op::AddImm => self.set(insn.d, self.reg(insn.n).wrapping_add(insn.imm)),
            Op::AddImmS => {
                let value = self.add_flags(self.reg(insn.n), insn.imm, false);
                self.set(insn.d, value);
            }
            Op::SubImmS => {
                let value = self.sub_flags(self.reg(insn.n), insn.imm);
                self.set(insn.d, value);
            }
            Op::AddReg => self.set(insn.d, self.reg(insn.n).wrapping_add(self.reg(insn.m))),
            Op::AddRegS => {
                let value = self.add_flags(self.reg(insn.n), self.reg(insn.m), false);
                self.set(insn.d, value);
            }
            Op::SubReg => self.set(insn.d, self.reg(insn.n).wrapping_sub(self.reg(insn.m))),
            Op::SubRegS => {
                let value = self.sub_flags(self.reg(insn.n), self.reg(insn.m));
                self.set(insn.d, value);
            }
            Op::AddLsl => {
                let shifted = self.reg(insn.m) << (insn.imm & 31);
                self.set(insn.d, self.reg(insn.n).wrapping_add(shifted));
            }
            Op::LslImm => self.set(insn.d, self.reg(insn.m) << (insn.imm & 31)),
            Op::LsrImm => self.set(insn.d, self.reg(insn.m).checked_shr(insn.imm).unwrap_or(0)),
            Op::AsrImm => {
                let value = (self.reg(insn.m) as i32) >> insn.imm.min(31);
                self.set(insn.d, value as u32);
            }
            Op::CmpImm => {
                self.sub_flags(self.reg(insn.n), insn.imm);
            }
            Op::CmpReg => {
                self.sub_flags(self.reg(insn.n), self.reg(insn.m));
            }
            Op::TstImm => self.test(Test::Tst, self.reg(insn.n), insn.imm, insn.carry(self.c)),
            Op::SpImm => self.set_sp(self.reg(insn.n).wrapping_add(insn.imm)),
            Op::Mul => {
                let value = self.reg(insn.n).wrapping_mul(self.reg(insn.m));
                self.set(insn.d, value);
            }
            Op::Mla => {
                let product = self.reg(insn.n).wrapping_mul(self.reg(insn.m));
                self.set(insn.d, self.reg(insn.x).wrapping_add(product));
            }
            Op::Uxtb => self.set(insn.d, self.reg(insn.m) & 0xff),
            Op::Uxth => self.set(insn.d, self.reg(insn.m) & 0xffff),
            Op::Ubfx => {
                let value = self.reg(insn.n) >> (insn.x & 31);
                self.set(insn.d, value & (u32::MAX >> ((32 - insn.imm) & 31)));
            }
            _ => return self.execute_branch(system, insn, pc, next),
        }
        Ok(next)
    }

    #[inline(always)]
    fn execute_branch<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Result<u32, Trap> {
        Ok(match insn.op {
            Op::B => insn.imm,
            Op::Beq => self.branch_if(self.z == 0, insn, pc),
            Op::Bne => self.branch_if(self.z != 0, insn, pc),
            Op::Bcs => self.branch_if(self.c, insn, pc),
            Op::Bcc => self.branch_if(!self.c, insn, pc),
            Op::Bmi => self.branch_if(self.negative(), insn, pc),
            Op::Bpl => self.branch_if(!self.negative(), insn, pc),
            Op::Bvs => self.branch_if(self.v, insn, pc),
            Op::Bvc => self.branch_if(!self.v, insn, pc),
            Op::Bhi => self.branch_if(self.higher(), insn, pc),
            Op::Bls => self.branch_if(!self.higher(), insn, pc),
            Op::Bge => self.branch_if(self.negative() == self.v, insn, pc),
            Op::Blt => self.branch_if(self.negative() != self.v, insn, pc),
            Op::Bgt => self.branch_if(self.greater(), insn, pc),
            Op::Ble => self.branch_if(!self.greater(), insn, pc),
            Op::Cbz => self.branch_if(self.reg(insn.n) == 0, insn, pc),
            Op::Cbnz => self.branch_if(self.reg(insn.n) != 0, insn, pc),
            Op::Bl => {
                self.r[14] = next | 1;
                insn.imm
            }
            Op::Bx => return self.branch_exchange(self.reg(insn.m), timing::REFILL_REGISTER),
            Op::Blx => {
                let target = self.reg(insn.m);
                self.r[14] = next | 1;
                // No exception return by BLX.
                self.cycles += timing::REFILL_REGISTER;
                if target & 1 == 0 {
                    self.thumb = false;
                    self.attend = true;
                }
                target & !1
            }
            Op::It => {
                self.it = insn.imm as u8;
                next
            }
            _ => return self.execute_memory(system, insn, pc, next),
        })
    }

    #[inline(always)]
    fn execute_memory<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Result<u32, Trap> {
        let offset = |core: &Self| core.reg(insn.n).wrapping_add(insn.imm);
        let index = |core: &Self| {
            let index = core.reg(insn.m) << (insn.imm & 31);
            core.reg(insn.n).wrapping_add(index)
        };
        match insn.op {
            Op::LdrImm => self.load_into::<S, { sizes::WORD }>(system, insn, offset(self), pc)?,
            Op::LdrbImm => self.load_into::<S, { sizes::BYTE }>(system, insn, offset(self), pc)?,
            Op::LdrhImm => self.load_into::<S, { sizes::HALF }>(system, insn, offset(self), pc)?,
            Op::LdrReg => self.load_into::<S, { sizes::WORD }>(system, insn, index(self), pc)?,
            Op::LdrbReg => self.load_into::<S, { sizes::BYTE }>(system, insn, index(self), pc)?,
            Op::LdrhReg => self.load_into::<S, { sizes::HALF }>(system, insn, index(self), pc)?,
            Op::LdrLit => self.load_into::<S, { sizes::WORD }>(system, insn, insn.imm, pc)?,
            Op::StrImm => self.store_from::<S, { sizes::WORD }>(system, insn, offset(self), pc)?,
            Op::StrbImm => self.store_from::<S, { sizes::BYTE }>(system, insn, offset(self), pc)?,
            Op::StrhImm => self.store_from::<S, { sizes::HALF }>(system, insn, offset(self), pc)?,
            Op::StrReg => self.store_from::<S, { sizes::WORD }>(system, insn, index(self), pc)?,
            Op::StrbReg => self.store_from::<S, { sizes::BYTE }>(system, insn, index(self), pc)?,
            Op::StrhReg => self.store_from::<S, { sizes::HALF }>(system, insn, index(self), pc)?,
            Op::Ldrd => self.load_double(system, insn, pc)?,
            Op::Strd => self.store_double(system, insn, pc)?,
            Op::Ldm => return self.load_multiple(system, insn, pc, next),
            Op::Stm => self.store_multiple(system, insn, pc)?,
            Op::Push => self.push(system, insn, pc)?,
            Op::Pop | Op::PopPc => return self.pop(system, insn, pc, next),
            _ => return self.execute_float(system, insn, pc, next),
        }
        Ok(next)
    }

    #[inline(always)]
    fn execute_float<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Result<u32, Trap> {
        match insn.op {
            Op::Vldr | Op::Vstr => self.load_store_single(system, insn, pc)?,
            Op::VmovToCore => {
                self.begin_fp(system)?;
                self.set(insn.d, self.single_reg(insn.n));
            }
            Op::VmovFromCore => {
                self.begin_fp(system)?;
                self.set_single_reg(insn.n, self.reg(insn.d));
            }
            Op::VmovReg => {
                self.begin_fp(system)?;
                self.set_single_reg(insn.d, self.single_reg(insn.m));
            }
            Op::VmovImm => {
                self.begin_fp(system)?;
                self.set_single_reg(insn.d, insn.imm);
            }
            Op::Vabs => {
                self.begin_fp(system)?;
                self.set_single_reg(insn.d, self.single_reg(insn.m) & !float::SIGN);
            }
            Op::Vneg => {
                self.begin_fp(system)?;
                self.set_single_reg(insn.d, self.single_reg(insn.m) ^ float::SIGN);
            }
            Op::Vadd => self.binary(system, insn, float::add)?,
            Op::Vsub => self.binary(system, insn, float::sub)?,
            Op::Vmul => self.binary(system, insn, float::mul)?,
            Op::Vfma => self.ternary(system, insn, float::fma)?,
            Op::Vmla => self.ternary(system, insn, |d, n, m, status| {
                let product = float::mul(n, m, status);
                float::add(d, product, status)
            })?,
            Op::Empty => {
                // It was no instruction; decoded, it is the next one.
                self.instructions = self.instructions.wrapping_sub(1);
                self.decode_flash(system, pc)?;
                return Ok(pc);
            }
            _ => return self.execute_rest(system, insn, pc, next),
        }
        Ok(next)
    }

    /// The groups that are not inlined.
    #[inline(always)]
    fn execute_rest<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Result<u32, Trap> {
        match insn.op {
            Op::Undefined => return Err(Trap::Undefined),
            Op::Unpredictable => return Err(Trap::Unpredictable),
            Op::NoCoprocessor => return Err(Trap::NoCoprocessor),
            Op::Vdiv => self.divide_single(system, insn)?,
            Op::Vmls | Op::Vfms => self.subtract_product(system, insn)?,
            Op::Float(op) => self.execute_rare_float(system, insn, op, pc)?,
            Op::Special(op) => self.execute_special(insn, op)?,
            Op::Dsp(op @ (Dsp::Parallel | Dsp::Saturating | Dsp::Sel)) => {
                self.execute_parallel(insn, op);
            }
            Op::Dsp(op) => self.execute_dsp(insn, op),
            Op::LdrsbImm
            | Op::LdrshImm
            | Op::LdrsbReg
            | Op::LdrshReg
            | Op::LoadLit(_)
            | Op::LoadPre(_)
            | Op::LoadPost(_)
            | Op::LoadUser(_) => self.execute_load(system, insn, pc)?,
            Op::StorePre(_) | Op::StorePost(_) | Op::StoreUser(_) => {
                self.execute_store(system, insn, pc)?;
            }
            Op::Ldrex(_) | Op::Strex(_) => self.execute_exclusive(system, insn, pc)?,
            Op::LoadTo(_) | Op::Table | Op::MovPc | Op::AddPc => {
                return self.execute_jump(system, insn, pc, next);
            }
            _ => self.execute_data(insn)?,
        }
        Ok(next)
    }
}
