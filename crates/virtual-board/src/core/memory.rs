//! Loads and stores: what the page of the address allows goes straight to the chip; private
//! peripherals, bit-band aliases, protected or unaligned places take another look.

use super::exception::Trap;
use super::mpu::{Access, Mode};
use super::scb::ccr;
use super::{Core, NO_LINE, System, Width, fetch};

/// The private peripheral bus, but DBGMCU, which is the chip's.
fn is_private(address: u32) -> bool {
    address >> 20 == 0xe00 && address & 0xf_f000 != 0x4_2000
}

/// Word and bit that an address in a bit-band alias stands for.
fn bit_band(address: u32) -> Option<(u32, u32)> {
    if !matches!(address >> 24, 0x22 | 0x23 | 0x42 | 0x43) {
        return None;
    }
    let offset = address & 0x1ff_ffff;
    let base = address & 0xf000_0000;
    Some((base | offset >> 7 << 2, offset >> 2 & 31))
}

impl Core {
    /// A load.
    #[inline(always)]
    pub(super) fn load<S: System>(
        &mut self,
        system: &mut S,
        address: u32,
        width: Width,
        pc: u32,
    ) -> Result<u32, Trap> {
        let aligned = address & (width.bytes() - 1) == 0;
        if aligned && self.plain[(address >> 24) as usize] {
            return match system.read(address, width, pc, &mut self.cycles) {
                Ok(value) => Ok(value),
                Err(_) => self.data_bus_error(address),
            };
        }
        self.load_checked(system, address, width, pc)
    }

    /// A store.
    #[inline(always)]
    pub(super) fn store<S: System>(
        &mut self,
        system: &mut S,
        address: u32,
        width: Width,
        value: u32,
        pc: u32,
    ) -> Result<(), Trap> {
        let aligned = address & (width.bytes() - 1) == 0;
        if aligned && self.plain[(address >> 24) as usize] {
            return match system.write(address, width, value, pc, &mut self.cycles) {
                Ok(()) => Ok(()),
                Err(_) => self.data_bus_error(address).map(drop),
            };
        }
        self.store_checked(system, address, width, value, pc)
    }

    /// A bus fault, unless handlers of faults are to ignore them.
    #[cold]
    fn data_bus_error(&mut self, address: u32) -> Result<u32, Trap> {
        if self.scb.ccr & ccr::BFHFNMIGN != 0 && self.execution_priority() < 0 {
            return Ok(0);
        }
        self.trap_value = address;
        Err(Trap::DataBus)
    }

    #[inline(never)]
    fn load_checked<S: System>(
        &mut self,
        system: &mut S,
        address: u32,
        width: Width,
        pc: u32,
    ) -> Result<u32, Trap> {
        if address & (width.bytes() - 1) != 0 {
            return self.load_unaligned(system, address, width, pc);
        }
        self.watch(address, width, pc, false);
        if is_private(address) {
            let value = self.private_load(system, address, width, pc);
            return value.or_else(|_| self.data_bus_error(address));
        }
        if !self.mpu.allows_data(address, Access::Read, self.view) {
            self.trap_value = address;
            return Err(Trap::DataMpu);
        }
        let value = match bit_band(address) {
            Some((word, bit)) => system
                .read(word, Width::Word, pc, &mut self.cycles)
                .map(|value| value >> bit & 1),
            None => system.read(address, width, pc, &mut self.cycles),
        };
        value.or_else(|_| self.data_bus_error(address))
    }

    #[inline(never)]
    fn store_checked<S: System>(
        &mut self,
        system: &mut S,
        address: u32,
        width: Width,
        value: u32,
        pc: u32,
    ) -> Result<(), Trap> {
        if address & (width.bytes() - 1) != 0 {
            return self.store_unaligned(system, address, width, value, pc);
        }
        self.watch(address, width, pc, true);
        if is_private(address) {
            let done = self.private_store(system, address, width, value, pc);
            return done.or_else(|_| self.data_bus_error(address).map(drop));
        }
        if !self.mpu.allows_data(address, Access::Write, self.view) {
            self.trap_value = address;
            return Err(Trap::DataMpu);
        }
        let done = match bit_band(address) {
            Some((word, bit)) => system
                .read(word, Width::Word, pc, &mut self.cycles)
                .and_then(|old| {
                    let new = old & !(1 << bit) | (value & 1) << bit;
                    system.write(word, Width::Word, new, pc, &mut self.cycles)
                }),
            None => system.write(address, width, value, pc, &mut self.cycles),
        };
        done.or_else(|_| self.data_bus_error(address).map(drop))
    }

    /// A byte of an unaligned word costs what the bus needs more: one cycle for two halves, two for
    /// byte, half and byte.
    fn unaligned_cycles(address: u32, width: Width) -> u64 {
        u64::from(width == Width::Word && address & 1 != 0) + 1
    }

    #[cold]
    fn load_unaligned<S: System>(
        &mut self,
        system: &mut S,
        address: u32,
        width: Width,
        pc: u32,
    ) -> Result<u32, Trap> {
        if self.scb.ccr & ccr::UNALIGN_TRP != 0 || is_private(address) {
            return Err(Trap::Unaligned);
        }
        self.cycles += Self::unaligned_cycles(address, width);
        let mut value = 0;
        for k in 0..width.bytes() {
            let byte = self.load_checked(system, address.wrapping_add(k), Width::Byte, pc)?;
            value |= byte << (8 * k);
        }
        Ok(value)
    }

    #[cold]
    fn store_unaligned<S: System>(
        &mut self,
        system: &mut S,
        address: u32,
        width: Width,
        value: u32,
        pc: u32,
    ) -> Result<(), Trap> {
        if self.scb.ccr & ccr::UNALIGN_TRP != 0 || is_private(address) {
            return Err(Trap::Unaligned);
        }
        self.cycles += Self::unaligned_cycles(address, width);
        for k in 0..width.bytes() {
            let byte = value >> (8 * k) & 0xff;
            self.store_checked(system, address.wrapping_add(k), Width::Byte, byte, pc)?;
        }
        Ok(())
    }

    /// Access with the rights of unprivileged code (LDRT, STRT).
    pub(super) fn unprivileged<T>(
        &mut self,
        access: impl FnOnce(&mut Self) -> Result<T, Trap>,
    ) -> Result<T, Trap> {
        let (view, user, ipsr) = (self.view, self.user_thread, self.ipsr);
        if view == Mode::Privileged {
            self.set_view(Mode::Unprivileged);
        }
        (self.user_thread, self.ipsr) = (true, 0);
        let result = access(self);
        (self.user_thread, self.ipsr) = (user, ipsr);
        self.set_view(view);
        result
    }

    /// Protection as mode, masks and registers say now; `force` after registers have changed.
    pub(super) fn update_view(&mut self, force: bool) {
        let fault = self.faultmask || self.nvic.active & 0b1100 != 0;
        let view = if fault && !self.mpu.checks_faults() {
            Mode::Unchecked
        } else if self.privileged() {
            Mode::Privileged
        } else {
            Mode::Unprivileged
        };
        if force {
            self.make_plain(view);
        } else {
            self.set_view(view);
        }
    }

    pub(super) fn set_view(&mut self, view: Mode) {
        if view == self.view {
            return;
        }
        if self.mpu.enabled() {
            self.make_plain(view);
        }
        self.view = view;
    }

    fn make_plain(&mut self, view: Mode) {
        self.view = view;
        self.line = NO_LINE;
        self.flash_executes = self.mpu.page_executes(fetch::FLASH >> 24, view);
        for page in 0..256u32 {
            let special = matches!(page, 0xe0 | 0x22 | 0x23 | 0x42 | 0x43);
            let open = self.mpu.page_is_open(page, view);
            self.plain[page as usize] = !special && open && !self.debug.watches_page(page);
        }
    }
}
