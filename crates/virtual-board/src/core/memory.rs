//! Loads and stores. Accesses to pages without restrictions go directly to the chip; private peripherals, protected or
//! unaligned addresses need further checks.

use super::exception::{Done, Trap};
use super::mpu::{Access, Mode};
use super::scb::ccr;
use super::{Core, NO_LINE, System, Transfer, Width, fetch};

/// True for the private peripheral bus, except DBGMCU, which belongs to the chip.
fn is_private(address: u32) -> bool {
    address >> 20 == 0xe00 && address & 0xf_f000 != 0x4_2000
}

/// Single-byte accesses that make up an access, numbered from 0.
fn bytes(at: Transfer) -> impl Iterator<Item = (u32, Transfer)> {
    (0..at.width.bytes()).map(move |k| {
        let (address, width) = (at.address.wrapping_add(k), Width::Byte);
        (
            k,
            Transfer {
                address,
                width,
                ..at
            },
        )
    })
}

impl Core {
    #[inline(always)]
    pub(super) fn load(&mut self, system: &mut impl System, at: Transfer) -> Done<u32> {
        if at.is_aligned() && self.plain[(at.address >> 24) as usize] {
            return match system.read(at, &mut self.cycles) {
                Ok(value) => Ok(value),
                Err(_) => self.data_bus_error(at.address),
            };
        }
        self.load_checked(system, at)
    }

    #[inline(always)]
    pub(super) fn store(&mut self, system: &mut impl System, at: Transfer, value: u32) -> Done {
        if at.is_aligned() && self.plain[(at.address >> 24) as usize] {
            return match system.write(at, value, &mut self.cycles) {
                Ok(()) => Ok(()),
                Err(_) => self.data_bus_error(at.address).map(drop),
            };
        }
        self.store_checked(system, at, value)
    }

    /// Bus fault of a data access, ignored if CCR.BFHFNMIGN is set and the priority is negative.
    #[cold]
    fn data_bus_error(&mut self, address: u32) -> Done<u32> {
        if self.scb.ccr & ccr::BFHFNMIGN != 0 && self.execution_priority() < 0 {
            return Ok(0);
        }
        self.trap_value = address;
        Err(Trap::DataBus)
    }

    #[inline(never)]
    fn load_checked(&mut self, system: &mut impl System, at: Transfer) -> Done<u32> {
        let mut value = 0;
        if self.splits(at)? {
            for (k, byte) in bytes(at) {
                value |= self.load_checked(system, byte)? << (8 * k);
            }
            return Ok(value);
        }
        self.watch(at, false);
        let value = if is_private(at.address) {
            self.private_load(system, at)
        } else {
            self.check_data(at.address, Access::Read)?;
            system.read(at, &mut self.cycles)
        };
        value.or_else(|_| self.data_bus_error(at.address))
    }

    #[inline(never)]
    fn store_checked(&mut self, system: &mut impl System, at: Transfer, value: u32) -> Done {
        if self.splits(at)? {
            for (k, byte) in bytes(at) {
                self.store_checked(system, byte, value >> (8 * k) & 0xff)?;
            }
            return Ok(());
        }
        self.watch(at, true);
        let done = if is_private(at.address) {
            self.private_store(system, at, value)
        } else {
            self.check_data(at.address, Access::Write)?;
            system.write(at, value, &mut self.cycles)
        };
        done.or_else(|_| self.data_bus_error(at.address).map(drop))
    }

    fn check_data(&mut self, address: u32, access: Access) -> Done {
        if self.mpu.allows_data(address, access, self.view) {
            return Ok(());
        }
        self.trap_value = address;
        Err(Trap::DataMpu)
    }

    /// True if an access is unaligned and is split into bytes. Adds the cycles of the additional bus accesses: one for
    /// two halfwords, two for byte, halfword and byte.
    #[inline]
    fn splits(&mut self, at: Transfer) -> Done<bool> {
        if at.is_aligned() {
            return Ok(false);
        }
        if self.scb.ccr & ccr::UNALIGN_TRP != 0 || is_private(at.address) {
            return Err(Trap::Unaligned);
        }
        self.cycles += u64::from(at.width == Width::Word && at.address & 1 != 0) + 1;
        Ok(true)
    }

    /// Makes an access with unprivileged rights (LDRT, STRT).
    pub(super) fn unprivileged<T>(&mut self, access: impl FnOnce(&mut Self) -> Done<T>) -> Done<T> {
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

    /// Applies the memory protection to the present mode and masks; `force` after a write to the MPU's registers.
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
            let open = page != 0xe0 && self.mpu.page_is_open(page, view);
            self.plain[page as usize] = open && !self.debug.watches_page(page);
        }
    }
}
