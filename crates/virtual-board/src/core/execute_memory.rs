//! Loads and stores.

use super::exception::Trap;
use super::instruction::{Insn, Mode, Op, Size};
use super::{Core, System, Width, timing};

/// Widths as constants, so that each hot load and store is compiled for its own.
pub(super) mod sizes {
    pub(crate) const WORD: u8 = 4;
    pub(crate) const HALF: u8 = 2;
    pub(crate) const BYTE: u8 = 1;
}

const fn width(size: u8) -> Width {
    match size {
        sizes::WORD => Width::Word,
        sizes::HALF => Width::Half,
        _ => Width::Byte,
    }
}

impl Size {
    const fn width(self) -> Width {
        match self {
            Self::Word => Width::Word,
            Self::Half | Self::SignedHalf => Width::Half,
            Self::Byte | Self::SignedByte => Width::Byte,
        }
    }

    const fn extend(self, value: u32) -> u32 {
        match self {
            Self::SignedHalf => value as i16 as u32,
            Self::SignedByte => value as i8 as u32,
            _ => value,
        }
    }
}

impl Core {
    #[inline(always)]
    pub(super) fn load_into<S: System, const SIZE: u8>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        address: u32,
        pc: u32,
    ) -> Result<(), Trap> {
        let value = self.load(system, address, width(SIZE), pc)?;
        self.set(insn.d(), value);
        Ok(())
    }

    #[inline(always)]
    pub(super) fn store_from<S: System, const SIZE: u8>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        address: u32,
        pc: u32,
    ) -> Result<(), Trap> {
        let value = self.reg(insn.d());
        let value = match SIZE {
            sizes::WORD => value,
            sizes::HALF => value & 0xffff,
            _ => value & 0xff,
        };
        self.store(system, address, width(SIZE), value, pc)
    }

    /// A load that is compiled once.
    #[inline(never)]
    pub(super) fn load_word<S: System>(
        &mut self,
        system: &mut S,
        address: u32,
        pc: u32,
    ) -> Result<u32, Trap> {
        self.load(system, address, Width::Word, pc)
    }

    /// A store that is compiled once.
    #[inline(never)]
    pub(super) fn store_word_at<S: System>(
        &mut self,
        system: &mut S,
        address: u32,
        value: u32,
        pc: u32,
    ) -> Result<(), Trap> {
        self.store(system, address, Width::Word, value, pc)
    }

    /// Instructions that need words in their place: a usage fault whatever CCR says.
    #[inline(always)]
    fn must_align(address: u32) -> Result<(), Trap> {
        if address & 3 != 0 {
            return Err(Trap::Unaligned);
        }
        Ok(())
    }

    /// The base register gets its new value; a lower main stack pointer is noted.
    #[inline(always)]
    fn write_back(&mut self, n: u8, value: u32) {
        if n == 13 {
            self.set_sp(value);
        } else {
            self.set(n, value);
        }
    }

    /// Address of a load or store by constant, and the base register's new value.
    fn indexed(&self, insn: &Insn, pre: bool) -> (u32, u32) {
        let base = self.reg(insn.n());
        let moved = base.wrapping_add(insn.imm);
        (if pre { moved } else { base }, moved)
    }

    #[inline(never)]
    pub(super) fn execute_load<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
    ) -> Result<(), Trap> {
        let (offset, by_register) = (self.offset(insn), self.index(insn));
        let (address, size) = match insn.op {
            Op::LdrsbImm => (offset, Size::SignedByte),
            Op::LdrshImm => (offset, Size::SignedHalf),
            Op::LdrsbReg => (by_register, Size::SignedByte),
            Op::LdrshReg => (by_register, Size::SignedHalf),
            Op::LdrhReg => (by_register, Size::Half),
            Op::LoadLit(size) => (insn.imm, size),
            Op::LoadPre(size) => (offset, size),
            Op::LoadPost(size) => (self.reg(insn.n()), size),
            Op::LoadUser(size) => {
                let value =
                    self.unprivileged(|core| core.load(system, offset, size.width(), pc))?;
                self.set(insn.d(), size.extend(value));
                return Ok(());
            }
            _ => return Err(Trap::Undefined),
        };
        let value = self.load(system, address, size.width(), pc)?;
        if matches!(insn.op, Op::LoadPre(_) | Op::LoadPost(_)) {
            self.write_back(insn.n(), offset);
        }
        self.set(insn.d(), size.extend(value));
        Ok(())
    }

    #[inline(never)]
    pub(super) fn execute_store<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
    ) -> Result<(), Trap> {
        let (base, moved) = (self.reg(insn.n()), self.offset(insn));
        let (address, size) = match insn.op {
            Op::StrbReg => (self.index(insn), Size::Byte),
            Op::StrhReg => (self.index(insn), Size::Half),
            Op::StorePre(size) | Op::StoreUser(size) => (moved, size),
            Op::StorePost(size) => (base, size),
            _ => return Err(Trap::Undefined),
        };
        let width = size.width();
        let value = match width {
            Width::Word => self.reg(insn.d()),
            Width::Half => self.reg(insn.d()) & 0xffff,
            Width::Byte => self.reg(insn.d()) & 0xff,
        };
        if let Op::StoreUser(_) = insn.op {
            return self.unprivileged(|core| core.store(system, address, width, value, pc));
        }
        self.store(system, address, width, value, pc)?;
        if let Op::StorePre(_) | Op::StorePost(_) = insn.op {
            self.write_back(insn.n(), moved);
        }
        Ok(())
    }

    /// LDRD and STRD.
    #[inline(never)]
    pub(super) fn move_double<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
    ) -> Result<(), Trap> {
        if insn.op == Op::Ldrd {
            self.load_double(system, insn, pc)
        } else {
            self.store_double(system, insn, pc)
        }
    }

    #[inline]
    fn load_double<S: System>(&mut self, system: &mut S, insn: &Insn, pc: u32) -> Result<(), Trap> {
        let (address, moved) = if insn.n() == 15 {
            (insn.imm, 0)
        } else {
            self.indexed(insn, insn.x() & 1 != 0)
        };
        Self::must_align(address)?;
        let low = self.load_word(system, address, pc)?;
        let high = self.load_word(system, address.wrapping_add(4), pc)?;
        if insn.x() & 2 != 0 {
            self.write_back(insn.n(), moved);
        }
        self.set(insn.d(), low);
        self.set(insn.m(), high);
        Ok(())
    }

    #[inline]
    fn store_double<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
    ) -> Result<(), Trap> {
        let (address, moved) = self.indexed(insn, insn.x() & 1 != 0);
        Self::must_align(address)?;
        self.store_word_at(system, address, self.reg(insn.d()), pc)?;
        self.store_word_at(system, address.wrapping_add(4), self.reg(insn.m()), pc)?;
        if insn.x() & 2 != 0 {
            self.write_back(insn.n(), moved);
        }
        Ok(())
    }

    #[inline(never)]
    pub(super) fn load_multiple<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Result<u32, Trap> {
        let bytes = 4 * insn.imm.count_ones();
        let base = self.reg(insn.n());
        let lower = base.wrapping_sub(bytes);
        let (mut address, moved) = if insn.x() & 2 != 0 {
            (lower, lower)
        } else {
            (base, base.wrapping_add(bytes))
        };
        Self::must_align(address)?;
        // Nothing changes if one of the loads fails.
        let mut words = [0; 16];
        let mut rest = insn.imm & 0xffff;
        while rest != 0 {
            let register = rest.trailing_zeros() as usize & 15;
            rest &= rest - 1;
            words[register] = self.load(system, address, Width::Word, pc)?;
            address = address.wrapping_add(4);
        }
        if insn.x() & 1 != 0 {
            self.write_back(insn.n(), moved);
        }
        let mut rest = insn.imm & 0x7fff;
        while rest != 0 {
            let register = rest.trailing_zeros() as usize & 15;
            rest &= rest - 1;
            self.r[register] = words[register];
        }
        if insn.imm & 0x8000 != 0 {
            return self.branch_exchange(words[15], timing::REFILL_LOADED);
        }
        Ok(next)
    }

    #[inline(never)]
    pub(super) fn store_multiple<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
    ) -> Result<(), Trap> {
        let bytes = 4 * insn.imm.count_ones();
        let base = self.reg(insn.n());
        let lower = base.wrapping_sub(bytes);
        let (address, moved) = if insn.x() & 2 != 0 {
            (lower, lower)
        } else {
            (base, base.wrapping_add(bytes))
        };
        self.store_list(system, insn.imm, address, pc)?;
        if insn.x() & 1 != 0 {
            self.write_back(insn.n(), moved);
        }
        Ok(())
    }

    #[inline(always)]
    fn store_list<S: System>(
        &mut self,
        system: &mut S,
        list: u32,
        address: u32,
        pc: u32,
    ) -> Result<(), Trap> {
        Self::must_align(address)?;
        let (mut rest, mut address) = (list & 0x7fff, address);
        while rest != 0 {
            let register = rest.trailing_zeros() as usize & 15;
            rest &= rest - 1;
            self.store(system, address, Width::Word, self.r[register], pc)?;
            address = address.wrapping_add(4);
        }
        Ok(())
    }

    #[inline(never)]
    pub(super) fn push<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
    ) -> Result<(), Trap> {
        let address = self.r[13].wrapping_sub(4 * insn.imm.count_ones());
        self.store_list(system, insn.imm, address, pc)?;
        self.set_sp(address);
        Ok(())
    }

    #[inline(never)]
    pub(super) fn pop<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Result<u32, Trap> {
        let old = self.r;
        let mut address = self.r[13];
        Self::must_align(address)?;
        let mut rest = insn.imm & 0x7fff;
        while rest != 0 {
            let register = rest.trailing_zeros() as usize & 15;
            rest &= rest - 1;
            match self.load(system, address, Width::Word, pc) {
                Ok(word) => self.r[register] = word,
                Err(trap) => {
                    self.r = old;
                    return Err(trap);
                }
            }
            address = address.wrapping_add(4);
        }
        if insn.op != Op::PopPc {
            self.r[13] = address;
            return Ok(next);
        }
        match self.load(system, address, Width::Word, pc) {
            Ok(target) => {
                self.r[13] = address.wrapping_add(4);
                self.branch_exchange(target, timing::REFILL_LOADED)
            }
            Err(trap) => {
                self.r = old;
                Err(trap)
            }
        }
    }

    #[inline(never)]
    pub(super) fn execute_exclusive<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
    ) -> Result<(), Trap> {
        let address = self.reg(insn.n()).wrapping_add(insn.imm);
        let (Op::Ldrex(size) | Op::Strex(size)) = insn.op else {
            return Err(Trap::Undefined);
        };
        let width = size.width();
        if address & (width.bytes() - 1) != 0 {
            return Err(Trap::Unaligned);
        }
        if let Op::Ldrex(_) = insn.op {
            let value = self.load(system, address, width, pc)?;
            self.exclusive = true;
            self.set(insn.d(), value);
            return Ok(());
        }
        if !self.exclusive {
            self.set(insn.d(), 1);
            return Ok(());
        }
        let value = self.reg(insn.m());
        let value = match width {
            Width::Word => value,
            Width::Half => value & 0xffff,
            Width::Byte => value & 0xff,
        };
        self.store(system, address, width, value, pc)?;
        self.exclusive = false;
        self.set(insn.d(), 0);
        Ok(())
    }

    /// Loads to the stack pointer or the program counter, tables of branches, moves to the program
    /// counter.
    #[inline(never)]
    pub(super) fn execute_jump<S: System>(
        &mut self,
        system: &mut S,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Result<u32, Trap> {
        match insn.op {
            Op::MovPc | Op::AddPc => {
                self.cycles += timing::REFILL_REGISTER;
                return Ok(self.reg(insn.m()).wrapping_add(insn.imm) & !1);
            }
            Op::Table => {
                let base = if insn.n() == 15 {
                    insn.imm
                } else {
                    self.reg(insn.n())
                };
                let (half, index) = (insn.x() != 0, self.reg(insn.m()));
                let address = base.wrapping_add(index << u32::from(half));
                let width = if half { Width::Half } else { Width::Byte };
                let offset = self.load(system, address, width, pc)?;
                self.cycles += timing::REFILL_LOADED;
                return Ok(pc.wrapping_add(4).wrapping_add(2 * offset));
            }
            _ => {}
        }
        let Op::LoadTo(mode) = insn.op else {
            return Err(Trap::Undefined);
        };
        let (base, offset) = (
            self.reg(insn.n()),
            self.reg(insn.n()).wrapping_add(insn.imm),
        );
        let address = match mode {
            Mode::Offset | Mode::Pre => offset,
            Mode::Post => base,
            Mode::Register => base.wrapping_add(self.reg(insn.m()) << (insn.imm & 31)),
            Mode::Literal => insn.imm,
        };
        if insn.d() == 15 {
            Self::must_align(address)?;
        }
        let value = self.load_word(system, address, pc)?;
        if matches!(mode, Mode::Pre | Mode::Post) {
            self.write_back(insn.n(), offset);
        }
        if insn.d() == 13 {
            self.set_sp(value);
            return Ok(next);
        }
        self.branch_exchange(value, timing::REFILL_LOADED)
    }
}
