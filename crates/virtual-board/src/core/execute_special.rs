//! Instructions that change the state of the core.

use super::Core;
use super::Sleep;
use super::exception::{Done, Trap};
use super::instruction::{Insn, Special};
use super::scb::scr;

/// Numbers of the special registers.
const MSP: u32 = 8;
const PSP: u32 = 9;
const PRIMASK: u32 = 16;
const BASEPRI: u32 = 17;
const BASEPRI_MAX: u32 = 18;
const FAULTMASK: u32 = 19;
const CONTROL: u32 = 20;

impl Core {
    #[inline(never)]
    pub(super) fn execute_special(&mut self, insn: &Insn, op: Special) -> Done {
        match op {
            Special::Nop | Special::Yield | Special::Barrier => {}
            // Executed in `execute_rest`, which has access to the system.
            Special::Dsb => {}
            Special::Wfe if self.event => self.event = false,
            Special::Wfe => self.fall_asleep(Sleep::Event),
            Special::Wfi => self.fall_asleep(Sleep::Interrupt),
            Special::Sev => self.event = true,
            Special::Clrex => self.exclusive = false,
            Special::Svc => return Err(Trap::SupervisorCall),
            Special::Bkpt => return Err(Trap::Breakpoint),
            Special::Mrs => self.set(insn.d(), self.read_special(insn.imm)),
            Special::Msr => self.write_special(insn.imm, self.reg(insn.n()), insn.x()),
            Special::Cps => self.change_masks(insn),
        }
        Ok(())
    }

    fn fall_asleep(&mut self, sleep: Sleep) {
        self.sleep = sleep;
        self.check_needed = true;
        self.deep_sleep = self.scb.scr & scr::SLEEPDEEP != 0;
    }

    fn read_special(&self, number: u32) -> u32 {
        match number {
            0..=7 => {
                let flags = if number & 4 == 0 { self.apsr() } else { 0 };
                let exception = if number & 1 != 0 {
                    u32::from(self.ipsr)
                } else {
                    0
                };
                flags | exception
            }
            CONTROL => self.control(),
            _ if !self.privileged() => 0,
            MSP => self.msp(),
            PSP => self.psp(),
            PRIMASK => u32::from(self.primask),
            BASEPRI | BASEPRI_MAX => u32::from(self.basepri),
            FAULTMASK => u32::from(self.faultmask),
            _ => 0,
        }
    }

    fn write_special(&mut self, number: u32, value: u32, mask: u8) {
        if number < 4 {
            if mask & 2 != 0 {
                self.set_nzcv(value);
                self.q = value >> 27 & 1 != 0;
            }
            if mask & 1 != 0 {
                self.ge = value >> 16 & 15;
            }
            return;
        }
        if !self.privileged() {
            return;
        }
        let priority = value as u8 & 0xf0;
        match number {
            MSP => self.set_msp(value),
            PSP => self.set_psp(value),
            PRIMASK => self.primask = value & 1 != 0,
            BASEPRI => self.basepri = priority,
            BASEPRI_MAX if priority == 0 => {}
            BASEPRI_MAX if self.basepri != 0 => self.basepri = self.basepri.min(priority),
            BASEPRI_MAX => self.basepri = priority,
            FAULTMASK => self.set_faultmask(value & 1 != 0),
            CONTROL => self.set_control(value),
            _ => {}
        }
        self.check_needed |= self.nvic.waiting();
    }

    fn set_faultmask(&mut self, on: bool) {
        if !on || self.execution_priority() > -1 {
            self.faultmask = on;
            self.update_view(false);
        }
    }

    fn set_control(&mut self, value: u32) {
        self.user_thread = value & 1 != 0;
        self.fp_active = value & 4 != 0;
        self.fp_ready = false;
        if self.ipsr == 0 && (value & 2 != 0) != self.process_stack {
            std::mem::swap(&mut self.r[13], &mut self.other_sp);
            self.process_stack = !self.process_stack;
            self.note_stack();
        }
        self.update_view(false);
    }

    fn change_masks(&mut self, insn: &Insn) {
        if !self.privileged() {
            return;
        }
        let on = insn.x() & 1 != 0;
        if insn.imm & 2 != 0 {
            self.primask = on;
        }
        if insn.imm & 1 != 0 {
            self.set_faultmask(on);
        }
        self.check_needed |= !on && self.nvic.waiting();
    }
}
