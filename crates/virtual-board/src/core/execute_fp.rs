//! Floating-point instructions.

use super::exception::{Done, Trap};
use super::float::{self, Fixed, fpscr};
use super::instruction::{Float, Insn, Op};
use super::{Core, System, Transfer, timing};

impl Core {
    #[inline(always)]
    pub(super) fn single_reg(&self, number: u8) -> u32 {
        self.s[usize::from(number & 31)]
    }

    #[inline(always)]
    pub(super) fn set_single_reg(&mut self, number: u8, bits: u32) {
        self.s[usize::from(number & 31)] = bits;
    }

    /// Checks access to the floating-point unit, then waits until the unit is free.
    #[inline(always)]
    pub(super) fn begin_fp(&mut self, system: &mut impl System, insn: &Insn) -> Done {
        if !self.fp_ready {
            self.prepare_fp(system)?;
        }
        // The cycles of the instruction itself are already counted.
        self.cycles = self.cycles.max(self.fp_busy + u64::from(insn.cycles));
        Ok(())
    }

    /// d = operation(n, m).
    #[inline(always)]
    pub(super) fn binary(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        operation: impl Fn(u32, u32, &mut u32) -> u32,
    ) -> Done {
        self.begin_fp(system, insn)?;
        let (n, m) = (self.single_reg(insn.n()), self.single_reg(insn.m()));
        let value = operation(n, m, &mut self.fpscr);
        self.set_single_reg(insn.d(), value);
        Ok(())
    }

    /// d = operation(d, n, m).
    #[inline(always)]
    pub(super) fn ternary(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        operation: impl Fn(u32, u32, u32, &mut u32) -> u32,
    ) -> Done {
        self.begin_fp(system, insn)?;
        let (n, m) = (self.single_reg(insn.n()), self.single_reg(insn.m()));
        let value = operation(self.single_reg(insn.d()), n, m, &mut self.fpscr);
        self.set_single_reg(insn.d(), value);
        Ok(())
    }

    /// Marks the unit busy with a division; integer instructions continue.
    fn occupy(&mut self) {
        self.fp_busy = self.cycles + timing::FP_DIVISION - 1;
    }

    #[inline(never)]
    pub(super) fn divide_single(&mut self, system: &mut impl System, insn: &Insn) -> Done {
        self.binary(system, insn, float::div)?;
        self.occupy();
        Ok(())
    }

    /// VMLS rounds the product; VFMS does not.
    #[inline(never)]
    pub(super) fn subtract_product(&mut self, system: &mut impl System, insn: &Insn) -> Done {
        if insn.op == Op::Vfms {
            return self.ternary(system, insn, |d, n, m, status| {
                float::fma(d, n ^ float::SIGN, m, status)
            });
        }
        self.ternary(system, insn, |d, n, m, status| {
            let product = float::mul(n, m, status);
            float::add(d, product ^ float::SIGN, status)
        })
    }

    /// d = operation(m), which raises no exception flags.
    #[inline(always)]
    pub(super) fn unary(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        operation: impl Fn(u32) -> u32,
    ) -> Done {
        self.begin_fp(system, insn)?;
        self.set_single_reg(insn.d(), operation(self.single_reg(insn.m())));
        Ok(())
    }

    /// Compares d with m or zero; sets the flags of FPSCR.
    #[inline(always)]
    pub(super) fn compare_singles(&mut self, system: &mut impl System, insn: &Insn) -> Done {
        self.begin_fp(system, insn)?;
        let d = self.single_reg(insn.d());
        let m = if insn.imm & 2 != 0 {
            0
        } else {
            self.single_reg(insn.m())
        };
        let flags = float::compare(d, m, insn.imm & 1 != 0, &mut self.fpscr);
        self.fpscr = self.fpscr & !fpscr::NZCV | flags << 28;
        Ok(())
    }

    /// Copies the flags of FPSCR to the flags of the core.
    #[inline(always)]
    pub(super) fn take_fp_flags(&mut self, system: &mut impl System, insn: &Insn) -> Done {
        self.begin_fp(system, insn)?;
        self.set_nzcv(self.fpscr);
        Ok(())
    }

    #[inline(always)]
    pub(super) fn move_to_core(&mut self, system: &mut impl System, insn: &Insn) -> Done {
        self.begin_fp(system, insn)?;
        self.set(insn.d(), self.single_reg(insn.n()));
        Ok(())
    }

    #[inline(always)]
    pub(super) fn move_from_core(&mut self, system: &mut impl System, insn: &Insn) -> Done {
        self.begin_fp(system, insn)?;
        self.set_single_reg(insn.n(), self.reg(insn.d()));
        Ok(())
    }

    /// Address of VLDR and VSTR, checked for alignment to words.
    #[inline(always)]
    fn single_address(&self, insn: &Insn) -> Done<u32> {
        let address = self.offset_or_literal(insn);
        Self::must_align(address)?;
        Ok(address)
    }

    #[inline(always)]
    pub(super) fn load_single(&mut self, system: &mut impl System, insn: &Insn, pc: u32) -> Done {
        self.begin_fp(system, insn)?;
        let address = self.single_address(insn)?;
        let value = self.load(system, Transfer::word(address, pc))?;
        self.set_single_reg(insn.d(), value);
        Ok(())
    }

    #[inline(always)]
    pub(super) fn store_single(&mut self, system: &mut impl System, insn: &Insn, pc: u32) -> Done {
        self.begin_fp(system, insn)?;
        let address = self.single_address(insn)?;
        let value = self.single_reg(insn.d());
        self.store(system, Transfer::word(address, pc), value)
    }

    #[inline(never)]
    pub(super) fn execute_rare_float(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        op: Float,
        pc: u32,
    ) -> Done {
        self.begin_fp(system, insn)?;
        let (d, n, m) = (
            self.single_reg(insn.d()),
            self.single_reg(insn.n()),
            self.single_reg(insn.m()),
        );
        let (sign, status) = (float::SIGN, &mut self.fpscr);
        let value = match op {
            Float::Nmul => float::mul(n, m, status) ^ sign,
            Float::Nmla => {
                let product = float::mul(n, m, status) ^ sign;
                float::add(d ^ sign, product, status)
            }
            Float::Nmls => {
                let product = float::mul(n, m, status);
                float::add(d ^ sign, product, status)
            }
            Float::Fnma => float::fma(d ^ sign, n ^ sign, m, status),
            Float::Fnms => float::fma(d ^ sign, n, m, status),
            Float::Sqrt => {
                let root = float::sqrt(m, status);
                self.occupy();
                root
            }
            Float::FromHalf => float::from_half((m >> (16 * insn.imm)) as u16, status),
            Float::ToHalf => {
                let half = u32::from(float::to_half(m, status));
                let shift = 16 * insn.imm;
                d & !(0xffff << shift) | half << shift
            }
            Float::ToInteger | Float::FromInteger | Float::ToFixed | Float::FromFixed => {
                self.convert(insn, op)
            }
            _ => return self.move_float(system, insn, op, pc),
        };
        self.set_single_reg(insn.d(), value);
        Ok(())
    }

    fn convert(&mut self, insn: &Insn, op: Float) -> u32 {
        let (d, m, status) = (
            self.single_reg(insn.d()),
            self.single_reg(insn.m()),
            &mut self.fpscr,
        );
        let unsigned = insn.imm & 1 != 0;
        let integer = Fixed {
            fraction: 0,
            bits: 32,
            unsigned,
        };
        let fixed = Fixed {
            fraction: insn.imm,
            bits: if insn.x() & 2 != 0 { 32 } else { 16 },
            unsigned: insn.x() & 1 != 0,
        };
        match op {
            Float::ToInteger => {
                let mode = if insn.imm & 2 != 0 {
                    float::mode(*status)
                } else {
                    float::TOWARDS_ZERO
                };
                float::to_fixed(m, integer, mode, status)
            }
            Float::FromInteger => {
                let value = if unsigned {
                    i64::from(m)
                } else {
                    i64::from(m as i32)
                };
                float::from_fixed(value, 0, float::mode(*status), status)
            }
            Float::ToFixed => {
                let value = float::to_fixed(d, fixed, float::TOWARDS_ZERO, status);
                // A 16-bit result is extended to the whole register.
                match (fixed.bits, fixed.unsigned) {
                    (16, false) => value as i16 as u32,
                    _ => value,
                }
            }
            _ => {
                let value = match (fixed.bits, fixed.unsigned) {
                    (16, true) => i64::from(d as u16),
                    (16, false) => i64::from(d as i16),
                    (_, true) => i64::from(d),
                    (_, false) => i64::from(d as i32),
                };
                float::from_fixed(value, fixed.fraction, 0, status)
            }
        }
    }

    fn move_float(&mut self, system: &mut impl System, insn: &Insn, op: Float, pc: u32) -> Done {
        match op {
            Float::MovTwo => {
                let second = insn.m() + 1;
                if insn.x() != 0 {
                    self.set(insn.d(), self.single_reg(insn.m()));
                    self.set(insn.n(), self.single_reg(second));
                } else {
                    self.set_single_reg(insn.m(), self.reg(insn.d()));
                    self.set_single_reg(second, self.reg(insn.n()));
                }
            }
            Float::ReadStatus => self.set(insn.d(), self.fpscr),
            Float::WriteStatus => self.fpscr = self.reg(insn.d()) & fpscr::WRITABLE,
            Float::LoadMultiple | Float::StoreMultiple => {
                return self.multiple_float(system, insn, op, pc);
            }
            Float::LoadDouble | Float::StoreDouble => {
                let address = self.offset_or_literal(insn);
                let load = op == Float::LoadDouble;
                return self.singles(system, insn.d(), 2, (address, load), pc);
            }
            _ => return Err(Trap::Undefined),
        }
        Ok(())
    }

    fn multiple_float(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        op: Float,
        pc: u32,
    ) -> Done {
        let (address, moved) = self.multiple(insn, insn.imm);
        let load = op == Float::LoadMultiple;
        self.singles(system, insn.d(), insn.imm as u8, (address, load), pc)?;
        if insn.x() & 1 != 0 {
            self.write_back(insn.n(), moved);
        }
        Ok(())
    }

    /// Loads or stores consecutive single-precision registers.
    fn singles(
        &mut self,
        system: &mut impl System,
        first: u8,
        count: u8,
        (mut address, load): (u32, bool),
        pc: u32,
    ) -> Done {
        Self::must_align(address)?;
        for register in first..first + count {
            if load {
                let word = self.load_word(system, Transfer::word(address, pc))?;
                self.set_single_reg(register, word);
            } else {
                let word = self.single_reg(register);
                self.store_word(system, Transfer::word(address, pc), word)?;
            }
            address = address.wrapping_add(4);
        }
        Ok(())
    }
}
