//! Exception frames: saving and restoring registers around exceptions; floating-point registers at once or lazily
//! (ARMv7-M Architecture Reference Manual, B1.5.6 to B1.5.8).

use super::exception::{Done, Trap};
use super::nvic::exception as number;
use super::registers::it_state;
use super::scb::{ccr, fpccr};
use super::{Core, System, Transfer, mpu, timing};

/// Length of a frame without and with floating-point registers, bytes.
const BASIC: u32 = 0x20;
const EXTENDED: u32 = 0x68;
/// Control bits of FPSCR that a new context gets from FPDSCR.
const FP_DEFAULTS: u32 = 0x07c0_0000;
/// Bit of EXC_RETURN: the frame has no floating-point registers.
const BASIC_FRAME: u32 = 0x10;

impl Core {
    /// Saves registers on the present stack. Returns EXC_RETURN and the result of the stores; the stack pointer moves
    /// in any case.
    pub(super) fn push_frame(&mut self, system: &mut impl System) -> (u32, Done) {
        let fp = self.fp_active;
        let size = if fp { EXTENDED } else { BASIC };
        let align = fp || self.scb.ccr & ccr::STKALIGN != 0;
        let old = self.r[13];
        let pad = u32::from(align && old & 4 != 0);
        let frame = old.wrapping_sub(size) & !(u32::from(align) << 2);
        let psr = self.xpsr() | pad << 9;
        let words = [
            self.r[0], self.r[1], self.r[2], self.r[3], self.r[12], self.r[14], self.pc, psr,
        ];
        let thread = self.ipsr == 0;
        let value = 0xffff_ffe1
            | if fp { 0 } else { BASIC_FRAME }
            | if thread { 8 } else { 0 }
            | u32::from(self.process_stack) << 2;
        self.set_sp(frame);
        let mut result = Ok(());
        for (k, word) in (0..).zip(words) {
            self.cycles += 1;
            result = result.and(self.store_word(system, self.on_stack(frame, k), word));
        }
        if fp {
            let address = frame.wrapping_add(BASIC);
            if self.scb.fpccr & fpccr::LSPEN == 0 {
                result = result.and(self.save_singles(system, address));
            } else {
                self.leave_unsaved(address);
            }
        }
        (value, result)
    }

    /// Access to word `k` of a frame.
    fn on_stack(&self, frame: u32, k: u32) -> Transfer {
        Transfer::word(frame.wrapping_add(4 * k), self.pc)
    }

    /// Saves S0 to S15 and FPSCR.
    fn save_singles(&mut self, system: &mut impl System, address: u32) -> Done {
        self.cycles += timing::FP_CONTEXT;
        for k in 0..16 {
            let word = self.s[k as usize & 31];
            self.store_word(system, self.on_stack(address, k), word)?;
        }
        self.store_word(system, self.on_stack(address, 16), self.fpscr)
    }

    /// Reserves the space for lazy saving of the floating-point registers (UpdateFPCCR).
    fn leave_unsaved(&mut self, address: u32) {
        let current = self.execution_priority();
        let above = |exception| self.nvic.group_of(self.nvic.priority(exception)) < current;
        let ready = |exception| self.nvic.is_enabled(exception) && above(exception);
        let bit = |condition: bool, bit: u32| if condition { bit } else { 0 };
        let state = fpccr::LSPACT
            | bit(!self.privileged(), fpccr::USER)
            | bit(self.ipsr == 0, fpccr::THREAD)
            | bit(above(number::HARD_FAULT), fpccr::HFRDY)
            | bit(ready(number::BUS_FAULT), fpccr::BFRDY)
            | bit(ready(number::MEM_MANAGE), fpccr::MMRDY);
        self.scb.fpccr = self.scb.fpccr & !fpccr::STATE | state;
        self.scb.fpcar = address & !7;
        self.fp_ready = false;
    }

    /// Prepares the first floating-point instruction of a context: checks access, saves the registers of another
    /// context, starts a new context (ExecuteFPCheck).
    #[cold]
    #[inline(never)]
    pub(super) fn prepare_fp(&mut self, system: &mut impl System) -> Done {
        if !self.fp_allowed() {
            return Err(Trap::NoCoprocessor);
        }
        if self.scb.fpccr & fpccr::LSPACT != 0 {
            self.save_lazily(system)?;
        }
        if self.scb.fpccr & fpccr::ASPEN != 0 && !self.fp_active {
            self.fpscr = self.fpscr & !FP_DEFAULTS | self.scb.fpdscr & FP_DEFAULTS;
            self.fp_active = true;
        }
        self.fp_ready = true;
        Ok(())
    }

    /// True if CPACR allows floating point in the present mode.
    fn fp_allowed(&self) -> bool {
        match self.scb.cpacr >> 20 & 3 {
            3 => true,
            1 => self.privileged(),
            _ => false,
        }
    }

    fn save_lazily(&mut self, system: &mut impl System) -> Done {
        let view = self.view;
        if self.scb.fpccr & fpccr::USER != 0 {
            self.set_view(mpu::Mode::Unprivileged);
        }
        let address = self.scb.fpcar;
        let result = self.save_singles(system, address);
        self.set_view(view);
        result.map_err(|trap| match trap {
            Trap::DataMpu => Trap::LazyMpu,
            _ => Trap::LazyBus,
        })?;
        self.scb.fpccr &= !fpccr::LSPACT;
        Ok(())
    }

    /// Restores registers according to EXC_RETURN. False if the restored exception number does not match the mode.
    pub(super) fn pop_frame(&mut self, system: &mut impl System, value: u32) -> Done<bool> {
        let (thread, process) = (value & 8 != 0, value & 4 != 0);
        let extended = value & BASIC_FRAME == 0;
        let frame = if process { self.other_sp } else { self.r[13] };
        let view = self.view;
        if thread && self.user_thread {
            self.set_view(mpu::Mode::Unprivileged);
        }
        let words = self.load_frame(system, frame, extended);
        self.set_view(view);
        let words = words?;
        self.r[..4].copy_from_slice(&words[..4]);
        let [.., r12, lr, pc, psr] = words;
        (self.r[12], self.r[14], self.pc) = (r12, lr, pc & !1);
        let size = if extended { EXTENDED } else { BASIC };
        let align = extended || self.scb.ccr & ccr::STKALIGN != 0;
        let pad = u32::from(align) & psr >> 9;
        let sp = frame.wrapping_add(size) | pad << 2;
        if process {
            self.other_sp = sp;
            std::mem::swap(&mut self.r[13], &mut self.other_sp);
        } else {
            self.r[13] = sp;
        }
        self.process_stack = process;
        self.fp_active = extended;
        self.fp_ready = false;
        self.set_apsr(psr);
        self.it = it_state(psr);
        self.thumb = psr >> 24 & 1 != 0;
        let exception = (psr & 0x1ff) as u16;
        self.ipsr = if thread { 0 } else { exception };
        self.update_view(false);
        Ok(thread == (exception == 0))
    }

    /// Loads a frame; floating-point registers are restored directly.
    fn load_frame(
        &mut self,
        system: &mut impl System,
        frame: u32,
        extended: bool,
    ) -> Done<[u32; 8]> {
        self.cycles += timing::RETURN;
        let mut words = [0; 8];
        for (k, word) in (0..).zip(&mut words) {
            *word = self.load_word(system, self.on_stack(frame, k))?;
        }
        if !extended {
            return Ok(words);
        }
        if self.scb.fpccr & fpccr::LSPACT != 0 {
            // The floating-point registers were not used and are still valid.
            self.scb.fpccr &= !fpccr::LSPACT;
            return Ok(words);
        }
        self.cycles += timing::FP_CONTEXT;
        for k in 0..16 {
            self.s[k as usize & 31] =
                self.load_word(system, self.on_stack(frame, BASIC / 4 + k))?;
        }
        let status = self.load_word(system, self.on_stack(frame, BASIC / 4 + 16))?;
        self.fpscr = status & super::float::fpscr::WRITABLE;
        Ok(words)
    }

    /// True in handler mode, and in thread mode unless CONTROL.nPRIV is set.
    pub(super) fn privileged(&self) -> bool {
        self.ipsr != 0 || !self.user_thread
    }
}
