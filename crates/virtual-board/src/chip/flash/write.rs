//! Effects of writes to the registers of the flash.

use super::options::{OPTLOCK, OPTSTRT, Protection};
use super::*;

impl Flash {
    /// A key; whether the lock is open now.
    pub(super) fn key(
        &mut self,
        which: usize,
        value: u32,
        keys: [u32; 2],
        shared: &mut Shared,
    ) -> bool {
        let given = &mut self.keys[which];
        match *given {
            Keys::None if value == keys[0] => *given = Keys::First,
            Keys::First if value == keys[1] => {
                *given = Keys::None;
                return true;
            }
            _ => {
                *given = Keys::Broken;
                shared.bus_error = true;
                let text = "flash: a wrong key, locked until the next reset";
                shared.note(Kind::Forbidden, text);
            }
        }
        false
    }

    /// The bus holds a write to a control register while an operation runs.
    fn wait(&mut self, shared: &mut Shared) {
        if self.operation.is_some() {
            shared.held_until = shared.base.cycle_of(self.busy_until);
            shared.now = shared.now.max(shared.held_until);
            self.finish(shared);
        }
    }

    pub(super) fn write_cr(&mut self, value: u32, shared: &mut Shared) {
        self.wait(shared);
        if self.cr & LOCK != 0 {
            return shared.note(Kind::Forbidden, "FLASH_CR written while locked");
        }
        self.cr = value & !STRT;
        if value & STRT != 0 {
            match value & (SER | MER) {
                SER => self.erase_sector(shared),
                MER => self.erase_all(shared),
                _ => {
                    let text = "FLASH_CR: STRT without one of SER and MER".to_owned();
                    self.refuse(PGSERR, text, shared);
                }
            }
        }
        self.line(shared);
    }

    pub(super) fn write_acr(&mut self, mut value: u32, shared: &mut Shared) {
        for (reset, on, name) in [(ICRST, ICEN, "instruction"), (DCRST, DCEN, "data")] {
            if value & reset != 0 && self.acr & on != 0 {
                let text = format!("FLASH_ACR: the {name} cache is reset while it is on");
                shared.note(Kind::Forbidden, text);
                value &= !reset;
            }
        }
        self.acr = value & 0x1f07;
        self.accelerator.set(value);
    }

    pub(super) fn write_optcr(&mut self, value: u32, shared: &mut Shared) {
        self.wait(shared);
        if self.optcr & OPTLOCK != 0 {
            return shared.note(Kind::Forbidden, "FLASH_OPTCR written while locked");
        }
        if self.options.protection() == Protection::Forever {
            let text = "FLASH_OPTCR written at read protection level 2";
            return shared.note(Kind::Forbidden, text);
        }
        self.optcr = value & !OPTSTRT;
        if value & OPTSTRT != 0 {
            let mut takes = self.parallelism().sector(0);
            if self.options.unprotects(value) {
                takes = takes + self.parallelism().all();
            }
            self.begin(Operation::Options(value), takes, shared);
        }
    }
}
