//! Registers for a debugger, and counters of the core.

use super::Core;
use crate::time::Cycles;

impl Core {
    /// Cycles since the first power-on; not cleared by a reset.
    pub fn cycles(&self) -> Cycles {
        self.cycles
    }

    /// Lets cycles pass in which the core does nothing, for example while reset is held.
    pub fn add_cycles(&mut self, cycles: Cycles) {
        self.cycles += cycles;
        self.check_needed = true;
    }

    /// Number of instructions executed.
    pub fn instructions(&self) -> u64 {
        self.instructions
    }

    /// Cycles in which the core was asleep since the first power-on.
    pub fn asleep(&self) -> Cycles {
        self.asleep
    }

    /// Number of times that an exception was entered.
    pub fn taken(&self, exception: u16) -> u64 {
        self.taken.get(usize::from(exception)).copied().unwrap_or(0)
    }

    /// Lowest value of the main stack pointer so far.
    pub fn lowest_msp(&self) -> u32 {
        self.lowest_msp
    }

    /// Value of a register: 13 is the present stack pointer, 14 the link register, 15 the program counter.
    pub fn register(&self, number: usize) -> u32 {
        match number {
            15 => self.pc,
            _ => self.r[number & 15],
        }
    }

    /// Sets a register. The stack pointer is rounded down to a multiple of 4; bit 0 of the program counter is ignored.
    pub fn set_register(&mut self, number: usize, value: u32) {
        match number {
            15 => {
                self.pc = value & !1;
                self.line = super::NO_LINE;
            }
            13 => self.r[13] = value & !3,
            _ => self.r[number & 15] = value,
        }
    }

    /// Address of the next instruction.
    pub fn pc(&self) -> u32 {
        self.pc
    }

    /// Value of a single-precision register, as bits.
    pub fn single(&self, number: usize) -> u32 {
        self.s[number & 31]
    }

    /// Sets a single-precision register.
    pub fn set_single(&mut self, number: usize, bits: u32) {
        self.s[number & 31] = bits;
    }

    /// Floating-point status and control register.
    pub fn fpscr(&self) -> u32 {
        self.fpscr
    }

    /// Sets the floating-point status and control register; bits that are not implemented are ignored.
    pub fn set_fpscr(&mut self, value: u32) {
        self.fpscr = value & super::float::fpscr::WRITABLE;
    }

    /// Main stack pointer.
    pub fn msp(&self) -> u32 {
        if self.process_stack {
            self.other_sp
        } else {
            self.r[13]
        }
    }

    /// Process stack pointer.
    pub fn psp(&self) -> u32 {
        if self.process_stack {
            self.r[13]
        } else {
            self.other_sp
        }
    }

    pub(super) fn set_msp(&mut self, value: u32) {
        if self.process_stack {
            self.other_sp = value & !3;
            self.lowest_msp = self.lowest_msp.min(value & !3);
        } else {
            self.set_sp(value);
        }
    }

    pub(super) fn set_psp(&mut self, value: u32) {
        if self.process_stack {
            self.r[13] = value & !3;
        } else {
            self.other_sp = value & !3;
        }
    }

    /// Sets the present stack pointer.
    #[inline(always)]
    pub(super) fn set_sp(&mut self, value: u32) {
        self.r[13] = value & !3;
        self.note_stack();
    }

    /// Updates the lowest main stack pointer.
    #[inline(always)]
    pub(super) fn note_stack(&mut self) {
        if self.r[13] < self.lowest_msp && !self.process_stack {
            self.lowest_msp = self.r[13];
        }
    }

    pub(super) fn control(&self) -> u32 {
        u32::from(self.user_thread)
            | u32::from(self.process_stack) << 1
            | u32::from(self.fp_active) << 2
    }

    /// Number of the active exception; 0 in thread mode.
    pub fn exception(&self) -> u16 {
        self.ipsr
    }

    /// Program status register: flags, exception and execution state.
    pub fn xpsr(&self) -> u32 {
        let it = u32::from(self.it);
        self.apsr()
            | (it & 3) << 25
            | u32::from(self.thumb) << 24
            | (it >> 2) << 10
            | u32::from(self.ipsr)
    }

    /// Sets flags, IT state and Thumb bit; the exception number is unchanged.
    pub fn set_xpsr(&mut self, value: u32) {
        self.set_apsr(value);
        self.it = it_state(value);
        self.thumb = value >> 24 & 1 != 0;
    }

    pub(super) fn apsr(&self) -> u32 {
        self.n & 1 << 31
            | u32::from(self.z == 0) << 30
            | u32::from(self.c) << 29
            | u32::from(self.v) << 28
            | u32::from(self.q) << 27
            | self.ge << 16
    }

    pub(super) fn set_nzcv(&mut self, value: u32) {
        self.n = value;
        self.z = !value & 1 << 30;
        self.c = value >> 29 & 1 != 0;
        self.v = value >> 28 & 1 != 0;
    }

    pub(super) fn set_apsr(&mut self, value: u32) {
        self.set_nzcv(value);
        self.q = value >> 27 & 1 != 0;
        self.ge = value >> 16 & 15;
    }
}

/// IT state in a program status register. The state of an interrupted LDM counts as none.
pub(super) fn it_state(psr: u32) -> u8 {
    let it = (psr >> 25 & 3 | psr >> 8 & 0xfc) as u8;
    if it & 15 == 0 { 0 } else { it }
}
