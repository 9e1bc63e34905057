//! Loads and stores.

use super::exception::{Done, Trap};
use super::instruction::{Insn, Mode, Op, Size};
use super::{Core, System, Transfer, Width, timing};

/// Register numbers in a list, in ascending order.
#[inline(always)]
fn registers(mut list: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let register = list.trailing_zeros() as usize & 15;
        let more = list != 0;
        list &= list.wrapping_sub(1);
        more.then_some(register)
    })
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
    /// Loads a value into register d. Always inlined, so that each width has its own code.
    #[inline(always)]
    pub(super) fn load_into(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        at: Transfer,
    ) -> Done {
        let value = self.load(system, at)?;
        self.set(insn.d(), value);
        Ok(())
    }

    #[inline(always)]
    pub(super) fn store_from(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        at: Transfer,
    ) -> Done {
        self.store(system, at, self.reg(insn.d()) & at.width.mask())
    }

    /// A load that is not inlined.
    #[inline(never)]
    pub(super) fn load_word(&mut self, system: &mut impl System, at: Transfer) -> Done<u32> {
        self.load(system, at)
    }

    /// A store that is not inlined.
    #[inline(never)]
    pub(super) fn store_word(
        &mut self,
        system: &mut impl System,
        at: Transfer,
        value: u32,
    ) -> Done {
        self.store(system, at, value)
    }

    /// Checks word alignment for instructions that need it whatever CCR says; an unaligned address is a usage fault.
    #[inline(always)]
    pub(super) fn must_align(address: u32) -> Done {
        if address & 3 != 0 {
            return Err(Trap::Unaligned);
        }
        Ok(())
    }

    /// Writes the new value of the base register; for SP, the lowest main stack pointer is recorded.
    #[inline(always)]
    pub(super) fn write_back(&mut self, n: u8, value: u32) {
        if n == 13 {
            self.set_sp(value);
        } else {
            self.set(n, value);
        }
    }

    /// Lowest address of a load or store of `count` registers, and the new value of the base register.
    pub(super) fn multiple(&self, insn: &Insn, count: u32) -> (u32, u32) {
        let base = self.reg(insn.n());
        if insn.x() & 2 != 0 {
            let lower = base.wrapping_sub(4 * count);
            (lower, lower)
        } else {
            (base, base.wrapping_add(4 * count))
        }
    }

    /// Base register plus a constant; if the base is the program counter, the constant is the address.
    #[inline(always)]
    pub(super) fn offset_or_literal(&self, insn: &Insn) -> u32 {
        if insn.n() == 15 {
            insn.imm
        } else {
            self.offset(insn)
        }
    }

    /// Address of a load or store with a constant offset, and the new value of the base register.
    fn indexed(&self, insn: &Insn, pre: bool) -> (u32, u32) {
        let base = self.reg(insn.n());
        let moved = base.wrapping_add(insn.imm);
        (if pre { moved } else { base }, moved)
    }

    #[inline(never)]
    pub(super) fn execute_load(&mut self, system: &mut impl System, insn: &Insn, pc: u32) -> Done {
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
                let at = Transfer {
                    address: offset,
                    width: size.width(),
                    pc,
                };
                let value = self.unprivileged(|core| core.load(system, at))?;
                self.set(insn.d(), size.extend(value));
                return Ok(());
            }
            _ => return Err(Trap::Undefined),
        };
        let width = size.width();
        let value = self.load(system, Transfer { address, width, pc })?;
        if matches!(insn.op, Op::LoadPre(_) | Op::LoadPost(_)) {
            self.write_back(insn.n(), offset);
        }
        self.set(insn.d(), size.extend(value));
        Ok(())
    }

    #[inline(never)]
    pub(super) fn execute_store(&mut self, system: &mut impl System, insn: &Insn, pc: u32) -> Done {
        let (base, moved) = (self.reg(insn.n()), self.offset(insn));
        let (address, size) = match insn.op {
            Op::StrbReg => (self.index(insn), Size::Byte),
            Op::StrhReg => (self.index(insn), Size::Half),
            Op::StorePre(size) | Op::StoreUser(size) => (moved, size),
            Op::StorePost(size) => (base, size),
            _ => return Err(Trap::Undefined),
        };
        let width = size.width();
        let (at, value) = (
            Transfer { address, width, pc },
            self.reg(insn.d()) & width.mask(),
        );
        if let Op::StoreUser(_) = insn.op {
            return self.unprivileged(|core| core.store(system, at, value));
        }
        self.store(system, at, value)?;
        if let Op::StorePre(_) | Op::StorePost(_) = insn.op {
            self.write_back(insn.n(), moved);
        }
        Ok(())
    }

    /// LDRD and STRD.
    #[inline(never)]
    pub(super) fn move_double(&mut self, system: &mut impl System, insn: &Insn, pc: u32) -> Done {
        if insn.op == Op::Ldrd {
            self.load_double(system, insn, pc)
        } else {
            self.store_double(system, insn, pc)
        }
    }

    #[inline]
    fn load_double(&mut self, system: &mut impl System, insn: &Insn, pc: u32) -> Done {
        let (address, moved) = if insn.n() == 15 {
            (insn.imm, 0)
        } else {
            self.indexed(insn, insn.x() & 1 != 0)
        };
        Self::must_align(address)?;
        let low = self.load_word(system, Transfer::word(address, pc))?;
        let high = self.load_word(system, Transfer::word(address.wrapping_add(4), pc))?;
        if insn.x() & 2 != 0 {
            self.write_back(insn.n(), moved);
        }
        self.set(insn.d(), low);
        self.set(insn.m(), high);
        Ok(())
    }

    #[inline]
    fn store_double(&mut self, system: &mut impl System, insn: &Insn, pc: u32) -> Done {
        let (address, moved) = self.indexed(insn, insn.x() & 1 != 0);
        Self::must_align(address)?;
        let (low, high) = (self.reg(insn.d()), self.reg(insn.m()));
        self.store_word(system, Transfer::word(address, pc), low)?;
        self.store_word(system, Transfer::word(address.wrapping_add(4), pc), high)?;
        if insn.x() & 2 != 0 {
            self.write_back(insn.n(), moved);
        }
        Ok(())
    }

    #[inline(never)]
    pub(super) fn load_multiple(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Done<u32> {
        let (mut address, moved) = self.multiple(insn, insn.imm.count_ones());
        Self::must_align(address)?;
        // No register changes if one of the loads fails.
        let mut words = [0; 16];
        for register in registers(insn.imm & 0xffff) {
            words[register] = self.load(system, Transfer::word(address, pc))?;
            address = address.wrapping_add(4);
        }
        if insn.x() & 1 != 0 {
            self.write_back(insn.n(), moved);
        }
        for register in registers(insn.imm & 0x7fff) {
            self.r[register] = words[register];
        }
        if insn.imm & 0x8000 != 0 {
            return self.branch_exchange(words[15], timing::REFILL_LOADED);
        }
        Ok(next)
    }

    #[inline(never)]
    pub(super) fn store_multiple(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        pc: u32,
    ) -> Done {
        let (address, moved) = self.multiple(insn, insn.imm.count_ones());
        self.store_list(system, insn.imm, address, pc)?;
        if insn.x() & 1 != 0 {
            self.write_back(insn.n(), moved);
        }
        Ok(())
    }

    #[inline(always)]
    fn store_list(
        &mut self,
        system: &mut impl System,
        list: u32,
        mut address: u32,
        pc: u32,
    ) -> Done {
        Self::must_align(address)?;
        for register in registers(list & 0x7fff) {
            self.store(system, Transfer::word(address, pc), self.r[register])?;
            address = address.wrapping_add(4);
        }
        Ok(())
    }

    #[inline(never)]
    pub(super) fn push(&mut self, system: &mut impl System, insn: &Insn, pc: u32) -> Done {
        let address = self.r[13].wrapping_sub(4 * insn.imm.count_ones());
        self.store_list(system, insn.imm, address, pc)?;
        self.set_sp(address);
        Ok(())
    }

    #[inline(never)]
    pub(super) fn pop(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Done<u32> {
        let old = self.r;
        match self.pop_list(system, insn, pc) {
            Ok(Some(target)) => self.branch_exchange(target, timing::REFILL_LOADED),
            Ok(None) => Ok(next),
            Err(trap) => {
                self.r = old;
                Err(trap)
            }
        }
    }

    /// Pops the registers. Returns the new program counter; `None` if the program counter is not in the list.
    #[inline(always)]
    fn pop_list(&mut self, system: &mut impl System, insn: &Insn, pc: u32) -> Done<Option<u32>> {
        let mut at = Transfer::word(self.r[13], pc);
        Self::must_align(at.address)?;
        for register in registers(insn.imm & 0x7fff) {
            self.r[register] = self.load(system, at)?;
            at.address = at.address.wrapping_add(4);
        }
        let mut target = None;
        if insn.op == Op::PopPc {
            target = Some(self.load(system, at)?);
            at.address = at.address.wrapping_add(4);
        }
        self.r[13] = at.address;
        Ok(target)
    }

    #[inline(never)]
    pub(super) fn execute_exclusive(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        pc: u32,
    ) -> Done {
        let address = self.offset(insn);
        let (Op::Ldrex(size) | Op::Strex(size)) = insn.op else {
            return Err(Trap::Undefined);
        };
        let at = Transfer {
            address,
            width: size.width(),
            pc,
        };
        if !at.is_aligned() {
            return Err(Trap::Unaligned);
        }
        if let Op::Ldrex(_) = insn.op {
            self.load_into(system, insn, at)?;
            self.exclusive = true;
            return Ok(());
        }
        if self.exclusive {
            self.store(system, at, self.reg(insn.m()) & at.width.mask())?;
        }
        // Result: 1 if nothing was stored.
        self.set(insn.d(), u32::from(!self.exclusive));
        self.exclusive = false;
        Ok(())
    }

    /// Loads into the stack pointer or the program counter, branch tables, moves to the program counter.
    #[inline(never)]
    pub(super) fn execute_jump(
        &mut self,
        system: &mut impl System,
        insn: &Insn,
        pc: u32,
        next: u32,
    ) -> Done<u32> {
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
                let offset = self.load(system, Transfer { address, width, pc })?;
                self.cycles += timing::REFILL_LOADED;
                return Ok(pc.wrapping_add(4).wrapping_add(2 * offset));
            }
            _ => {}
        }
        let Op::LoadTo(mode) = insn.op else {
            return Err(Trap::Undefined);
        };
        let offset = self.offset(insn);
        let address = match mode {
            Mode::Offset | Mode::Pre => offset,
            Mode::Post => self.reg(insn.n()),
            Mode::Register => self.index(insn),
            Mode::Literal => insn.imm,
        };
        if insn.d() == 15 {
            Self::must_align(address)?;
        }
        let value = self.load_word(system, Transfer::word(address, pc))?;
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
