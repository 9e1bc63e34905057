//! Effects of writes to the registers of the flash.

use super::*;

impl Flash {
    /// Handles a key that the program writes; true if the key completes the unlock sequence.
    pub(super) fn key(&mut self, value: u32, shared: &mut Shared) -> bool {
        let given = &mut self.keys;
        match *given {
            Keys::None if value == 0x4567_0123 => *given = Keys::First,
            Keys::First if value == 0xcdef_89ab => {
                *given = Keys::None;
                return true;
            }
            _ => {
                *given = Keys::Broken;
                shared.bus_error = true;
                let text = "flash: wrong key; locked until the next reset";
                shared.note(FindingKind::Forbidden, text);
            }
        }
        false
    }

    /// Stalls a write to a control register while an operation runs.
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
            return shared.note(FindingKind::Forbidden, "FLASH_CR written while locked");
        }
        self.cr = value & !STRT;
        if value & STRT != 0 {
            match value & (SER | MER) {
                SER => self.erase_sector(shared),
                MER => shared.note(FindingKind::NotModelled, "FLASH: mass erase (MER)"),
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
                shared.note(FindingKind::Forbidden, text);
                value &= !reset;
            }
        }
        self.acr = value & 0x1f07;
        self.accelerator.set(value);
    }
}
