//! Exceptions: entry, return, faults and their escalation (ARMv7-M Architecture Reference Manual, B1.5).

use super::nvic::exception as number;
use super::scb::{ccr, cfsr, hfsr, scr};
use super::{Core, NO_LINE, Sleep, Stop, System, Transfer, timing};
use crate::finding::FindingKind;

/// Result of an instruction, or the trap that stopped it.
pub(super) type Done<T = ()> = Result<T, Trap>;

/// Reason why an instruction did not complete.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Trap {
    /// No exception: the instruction in flash must be decoded first.
    Undecoded,
    Undefined,
    Unpredictable,
    NoCoprocessor,
    Unaligned,
    DivideByZero,
    /// Bus error of a load or store at `trap_value`.
    DataBus,
    DataMpu,
    /// Error while saving floating-point registers lazily.
    LazyBus,
    LazyMpu,
    FetchBus,
    FetchMpu,
    SupervisorCall,
    Breakpoint,
    /// Branch to the exception return value in `trap_value`.
    ExceptionReturn,
}

/// Phase of an exception in which a fault occurred.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Stage {
    Stacking,
    Unstacking,
}

impl Core {
    /// Current execution priority: an exception is taken only if its priority is higher, that is, its number lower.
    pub(super) fn execution_priority(&self) -> i32 {
        self.masked_priority(self.primask)
    }

    /// Execution priority if PRIMASK were `primask`.
    pub(super) fn masked_priority(&self, primask: bool) -> i32 {
        let mut priority = self.nvic.active_priority();
        if self.basepri != 0 {
            priority = priority.min(self.nvic.group_of(i32::from(self.basepri)));
        }
        if primask {
            priority = priority.min(0);
        }
        if self.faultmask {
            priority = priority.min(-1);
        }
        priority
    }

    /// Handles the trap of an instruction at `pc`; `it` is the IT state of that instruction.
    pub(super) fn trap(&mut self, system: &mut impl System, trap: Trap, it: u8) {
        let address = self.trap_value;
        let (exception, status) = match trap {
            Trap::Undecoded => return,
            Trap::ExceptionReturn => return self.exception_return(system, address),
            Trap::SupervisorCall => {
                self.pc = self.pc.wrapping_add(2);
                return self.raise(system, number::SVCALL);
            }
            Trap::Breakpoint => {
                self.it = it;
                return self.breakpoint(system);
            }
            Trap::Unpredictable => {
                let text = format!("unpredictable instruction {}", self.encoding(system));
                system.note(FindingKind::NotModelled, self.pc, self.cycles, text);
                (number::USAGE_FAULT, cfsr::UNDEFINSTR)
            }
            Trap::Undefined => (number::USAGE_FAULT, cfsr::UNDEFINSTR),
            Trap::NoCoprocessor => (number::USAGE_FAULT, cfsr::NOCP),
            Trap::Unaligned => (number::USAGE_FAULT, cfsr::UNALIGNED),
            Trap::DivideByZero => (number::USAGE_FAULT, cfsr::DIVBYZERO),
            Trap::DataBus => {
                self.scb.bfar = address;
                (number::BUS_FAULT, cfsr::PRECISERR | cfsr::BFARVALID)
            }
            Trap::DataMpu => {
                self.scb.mmfar = address;
                (number::MEM_MANAGE, cfsr::DACCVIOL | cfsr::MMARVALID)
            }
            Trap::LazyBus => (number::BUS_FAULT, cfsr::LSPERR),
            Trap::LazyMpu => {
                self.scb.mmfar = address;
                (number::MEM_MANAGE, cfsr::MLSPERR | cfsr::MMARVALID)
            }
            Trap::FetchBus => (number::BUS_FAULT, cfsr::IBUSERR),
            Trap::FetchMpu => (number::MEM_MANAGE, cfsr::IACCVIOL),
        };
        self.it = it;
        self.scb.cfsr |= status;
        self.raise(system, exception);
    }

    /// Encoding of the instruction at the program counter, in hexadecimal.
    fn encoding(&self, system: &mut impl System) -> String {
        match (system.fetch(self.pc), system.fetch(self.pc.wrapping_add(2))) {
            (Ok(first), Ok(second)) if super::decode32::is_wide(first) => {
                format!("{first:04x} {second:04x}")
            }
            (Ok(first), _) => format!("{first:04x}"),
            _ => String::new(),
        }
    }

    /// Executes BKPT: stops for a debugger; without a debugger, takes a hard fault.
    fn breakpoint(&mut self, system: &mut impl System) {
        if self.debug.attached {
            self.stop = Some(Stop::Breakpoint(self.pc));
            return;
        }
        self.scb.dfsr |= 2;
        self.scb.hfsr |= hfsr::DEBUGEVT;
        if self.execution_priority() <= -1 {
            return self.lock_up(system, "breakpoint without debugger in a fault handler");
        }
        self.nvic.pend(number::HARD_FAULT, self.cycles);
        self.enter(system, number::HARD_FAULT);
    }

    /// Takes an exception caused by the program itself, at once. An exception that is disabled or whose priority is too
    /// low becomes a hard fault; if no hard fault can be taken, the core locks up.
    pub(super) fn raise(&mut self, system: &mut impl System, exception: u16) {
        let exception = match self.escalated(exception) {
            Some(exception) => exception,
            None => return self.lock_up(system, "fault while no fault can be taken"),
        };
        self.nvic.pend(exception, self.cycles);
        self.enter(system, exception);
    }

    /// Exception after escalation: the same exception or the hard fault; `None` for lock-up.
    fn escalated(&mut self, exception: u16) -> Option<u16> {
        let current = self.execution_priority();
        let priority = self.nvic.group_of(self.nvic.priority(exception));
        if self.nvic.is_enabled(exception) && priority < current {
            return Some(exception);
        }
        if current <= -1 {
            return None;
        }
        self.scb.hfsr |= hfsr::FORCED;
        Some(number::HARD_FAULT)
    }

    /// Locks the core up: the core executes nothing until a reset or a non-maskable interrupt.
    pub(super) fn lock_up(&mut self, system: &mut impl System, why: &str) {
        let status = format!("CFSR {:#010x}, HFSR {:#010x}", self.scb.cfsr, self.scb.hfsr);
        let text = format!("lock-up: {why} ({status})");
        system.note(FindingKind::Fault, self.pc, self.cycles, text);
        self.sleep = Sleep::LockedUp;
        self.stop = Some(Stop::LockUp);
        self.check_needed = true;
    }

    /// Takes the pending exception of highest priority if it can pre-empt the present execution.
    pub(super) fn take_pending(&mut self, system: &mut impl System) {
        let Some((exception, priority)) = self.nvic.first() else {
            return;
        };
        let priority = self.nvic.group_of(priority);
        if priority >= self.execution_priority() {
            return;
        }
        if self.sleep == Sleep::LockedUp && exception != number::NMI {
            return;
        }
        self.enter(system, exception);
    }

    /// Stacks registers and takes a pending exception; its return address is the program counter.
    fn enter(&mut self, system: &mut impl System, exception: u16) {
        let begin = self.cycles;
        let (value, stacked) = self.push_frame(system);
        let mut exception = exception;
        if let Err(trap) = stacked {
            match self.derived(exception, trap, Stage::Stacking) {
                Some(other) => exception = other,
                None => return self.lock_up(system, "the stack cannot be written"),
            }
        } else {
            // Late arrival: an exception that became pending during stacking may be taken first.
            system.advance(self.cycles, self.until.min(self.systick.deadline()));
            self.refresh(system);
            if let Some((other, priority)) = self.nvic.first()
                && self.nvic.group_of(priority) < self.nvic.group_of(self.nvic.priority(exception))
            {
                exception = other;
            }
        }
        self.cycles += timing::ENTRY - timing::STACKING;
        self.take(system, exception, value, begin);
    }

    /// Updates interrupt lines and SysTick.
    pub(super) fn refresh(&mut self, system: &mut impl System) {
        if self.systick.advance(self.cycles) {
            self.nvic.pend(number::SYSTICK, self.cycles);
        }
        self.nvic.set_lines(system.lines(), self.cycles);
    }

    /// Handles a fault during stacking or unstacking. Returns the exception to take now; `None` if the core must lock
    /// up. An original exception that is not taken stays pending.
    fn derived(&mut self, original: u16, trap: Trap, stage: Stage) -> Option<u16> {
        let bus = trap == Trap::DataBus;
        self.scb.cfsr |= match (bus, stage) {
            (true, Stage::Stacking) => cfsr::STKERR,
            (true, Stage::Unstacking) => cfsr::UNSTKERR,
            (false, Stage::Stacking) => cfsr::MSTKERR,
            (false, Stage::Unstacking) => cfsr::MUNSTKERR,
        };
        let fault = if bus {
            number::BUS_FAULT
        } else {
            number::MEM_MANAGE
        };
        let fault = self.escalated(fault)?;
        // A fault pre-empts neither itself nor the hard fault: the original handler is entered although its frame could
        // not be stored (DDI 0337E, 5.12.1).
        if stage == Stage::Stacking && (fault == original || original == number::HARD_FAULT) {
            return Some(original);
        }
        let before = self.nvic.group_of(self.nvic.priority(original));
        let mut after = self.nvic.group_of(self.nvic.priority(fault));
        let mut fault = fault;
        if original != 0 && after >= before && fault != number::HARD_FAULT {
            self.scb.hfsr |= hfsr::FORCED;
            fault = number::HARD_FAULT;
            after = -1;
        }
        self.nvic.pend(fault, self.cycles);
        if original == 0 || after < before {
            return Some(fault);
        }
        // Only the non-maskable interrupt reaches this line. The interrupt is taken first.
        (original == number::NMI).then_some(original)
    }

    /// Enters the handler of an exception after stacking.
    fn take(&mut self, system: &mut impl System, exception: u16, value: u32, begin: u64) {
        let mut exception = exception;
        let mut vector = self.vector(system, exception);
        if vector.is_none() && exception != number::HARD_FAULT {
            self.scb.hfsr |= hfsr::VECTTBL;
            exception = number::HARD_FAULT;
            vector = self.vector(system, exception);
        }
        let Some(vector) = vector else {
            self.scb.hfsr |= hfsr::VECTTBL;
            return self.lock_up(system, "the vector of the hard fault cannot be read");
        };
        if self.process_stack {
            std::mem::swap(&mut self.r[13], &mut self.other_sp);
            self.process_stack = false;
        }
        self.r[14] = value;
        self.pc = vector & !1;
        self.thumb = vector & 1 != 0;
        self.ipsr = exception;
        self.it = 0;
        self.fp_active = false;
        self.fp_ready = false;
        self.nvic.unpend(exception);
        self.nvic.active |= 1 << exception;
        self.event = true;
        self.exclusive = false;
        self.sleep = Sleep::Awake;
        self.line = NO_LINE;
        self.update_view(false);
        let index = usize::from(exception & 127);
        self.taken[index] += 1;
        let since = self.nvic.since[index];
        if let Some(profile) = &mut self.profile {
            profile.enter(exception, begin, self.cycles - since.min(self.cycles));
        }
        self.check_needed = true;
        if exception == number::HARD_FAULT {
            self.note_hard_fault(system, value);
        }
    }

    #[cold]
    fn note_hard_fault(&mut self, system: &mut impl System, value: u32) {
        let frame = if value & 4 != 0 {
            self.other_sp
        } else {
            self.r[13]
        };
        let mut cycle = self.cycles;
        let pc = system
            .read(
                Transfer::word(frame.wrapping_add(24) & !3, self.pc),
                &mut cycle,
            )
            .unwrap_or(self.pc);
        let text = format!(
            "hard fault: CFSR {:#010x}, HFSR {:#010x}, BFAR {:#010x}, MMFAR {:#010x}",
            self.scb.cfsr, self.scb.hfsr, self.scb.bfar, self.scb.mmfar
        );
        system.note(FindingKind::Fault, pc, self.cycles, text);
    }

    fn vector(&mut self, system: &mut impl System, exception: u16) -> Option<u32> {
        let address = self.scb.vtor.wrapping_add(4 * u32::from(exception));
        system
            .read(Transfer::word(address, self.pc), &mut self.cycles)
            .ok()
    }

    /// Returns from an exception: branch to EXC_RETURN in handler mode.
    fn exception_return(&mut self, system: &mut impl System, value: u32) {
        let returning = self.ipsr;
        if value & 0x0fff_ffe0 != 0x0fff_ffe0 {
            let text = format!("exception return with {value:#010x}");
            system.note(FindingKind::NotModelled, self.pc, self.cycles, text);
        }
        let nested = self.nvic.active.count_ones() > 1;
        let base = self.scb.ccr & ccr::NONBASETHRDENA != 0;
        let legal = match value & 15 {
            1 => nested,
            9 | 13 => !nested || base,
            _ => false,
        };
        if !self.nvic.is_active(returning) || !legal {
            self.deactivate(returning);
            return self.refuse_return(system, value);
        }
        self.deactivate(returning);
        self.refresh(system);
        self.event = true;
        self.exclusive = false;
        if let Some((next, priority)) = self.nvic.first()
            && self.nvic.group_of(priority) < self.execution_priority()
        {
            let begin = self.cycles;
            self.cycles += timing::TAIL_CHAIN;
            return self.take(system, next, value, begin);
        }
        match self.pop_frame(system, value) {
            Ok(true) => self.returned(),
            Ok(false) => {
                // The stacked IPSR does not match the mode to return to.
                self.scb.cfsr |= cfsr::INVPC;
                self.raise(system, number::USAGE_FAULT);
            }
            Err(trap) => match self.derived(0, trap, Stage::Unstacking) {
                Some(fault) => self.chain(system, fault, value),
                None => self.lock_up(system, "the stack cannot be read"),
            },
        }
    }

    fn returned(&mut self) {
        self.line = NO_LINE;
        self.check_needed = true;
        if self.ipsr == 0 && self.scb.scr & scr::SLEEPONEXIT != 0 {
            self.sleep = Sleep::Interrupt;
        }
    }

    /// Ends the active state of an exception.
    fn deactivate(&mut self, exception: u16) {
        self.nvic.active &= !(1 << exception);
        if exception != number::NMI {
            self.faultmask = false;
        }
        if let Some(profile) = &mut self.profile {
            profile.leave(exception, self.cycles + timing::RETURN);
        }
    }

    /// Rejects an invalid exception return: a usage fault on the same frame.
    fn refuse_return(&mut self, system: &mut impl System, value: u32) {
        self.scb.cfsr |= cfsr::INVPC;
        let value = 0xf000_0000 | value & 0x0fff_ffff;
        match self.escalated(number::USAGE_FAULT) {
            Some(fault) => {
                self.nvic.pend(fault, self.cycles);
                self.chain(system, fault, value);
            }
            None => self.lock_up(system, "invalid exception return (INVPC)"),
        }
    }

    /// Tail-chains to another exception on the present frame.
    fn chain(&mut self, system: &mut impl System, exception: u16, value: u32) {
        let begin = self.cycles;
        self.cycles += timing::TAIL_CHAIN;
        self.take(system, exception, value, begin);
    }
}
