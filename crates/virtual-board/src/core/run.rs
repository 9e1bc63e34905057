//! Main loop: update the chip, take exceptions, execute until the next check is needed, sleep.

use super::exception::Trap;
use super::instruction::{Insn, Op};
use super::nvic::exception as number;
use super::scb::{cfsr, scr};
use super::{Core, Sleep, Stop, System, fetch};
use crate::finding::FindingKind;
use crate::time::Cycles;

impl Core {
    /// Runs until a cycle, or until an event stops the core. The last instruction may end a few cycles later.
    pub fn run(&mut self, system: &mut impl System, until: Cycles) -> Stop {
        loop {
            let due = self.advance_system(system, until);
            if let Some(stop) = self.stop.take() {
                return stop;
            }
            if self.cycles >= until || system.must_stop() {
                return Stop::Until;
            }
            self.wake();
            self.take_pending(system);
            if self.stop.is_some() {
                continue;
            }
            if std::mem::take(&mut self.deep_sleep) {
                system.note(
                    FindingKind::NotModelled,
                    self.pc,
                    self.cycles,
                    "deep sleep".into(),
                );
            }
            if self.sleep != Sleep::Awake {
                self.pass(due.min(until));
                continue;
            }
            if !self.thumb {
                self.scb.cfsr |= cfsr::INVSTATE;
                self.raise(system, number::USAGE_FAULT);
                continue;
            }
            let trap = if self.profile.is_some() || self.debug.per_instruction() {
                self.execute_until_limit::<true>(system)
            } else {
                self.execute_until_limit::<false>(system)
            };
            if let Some((trap, it)) = trap {
                self.check_needed = true;
                self.trap(system, trap, it);
            }
            if self.debug.step {
                self.stop.get_or_insert(Stop::Step);
            }
        }
    }

    /// Executes one instruction or takes one exception; a sleep ends at `until` at the latest.
    pub fn step(&mut self, system: &mut impl System, until: Cycles) -> Stop {
        self.debug.step = true;
        let stop = self.run(system, until);
        self.debug.step = false;
        stop
    }

    /// Runs the chip until a cycle while the core is halted, as by a debugger.
    pub fn stand_still(&mut self, system: &mut impl System, until: Cycles) {
        while self.cycles < until {
            let due = self.advance_system(system, until);
            self.cycles = due.clamp(self.cycles + 1, until);
        }
        self.advance_system(system, until);
        self.check_needed = true;
    }

    /// Lets the chip handle its events and updates exceptions; returns the cycle of the next event.
    fn advance_system(&mut self, system: &mut impl System, until: Cycles) -> Cycles {
        self.check_needed = false;
        self.until = until;
        if self.systick.advance(self.cycles) {
            self.nvic.pend(number::SYSTICK, self.cycles);
        }
        let until = until.min(self.systick.deadline());
        let due = system.advance(self.cycles, until);
        if let Some((first, last)) = system.take_changed_code() {
            self.invalidate_code(first, last);
        }
        self.nvic.set_lines(system.lines(), self.cycles);
        if system.take_nmi() {
            self.nvic.pend(number::NMI, self.cycles);
        }
        if std::mem::take(&mut self.nvic.arrived) && self.scb.scr & scr::SEVONPEND != 0 {
            self.event = true;
        }
        due.min(until)
    }

    /// Ends sleep on a wake-up condition; a taken exception also ends sleep.
    fn wake(&mut self) {
        let awake = match self.sleep {
            Sleep::Awake | Sleep::LockedUp => return,
            // An exception masked only by PRIMASK wakes the core and is not taken.
            Sleep::Interrupt => self.nvic.first().is_some_and(|(_, priority)| {
                self.nvic.group_of(priority) < self.masked_priority(false)
            }),
            Sleep::Event => std::mem::take(&mut self.event),
        };
        if awake {
            self.sleep = Sleep::Awake;
        }
    }

    /// Lets time pass in sleep.
    fn pass(&mut self, until: Cycles) {
        let until = until.max(self.cycles + 1);
        self.asleep += until - self.cycles;
        self.cycles = until;
    }

    /// Executes instructions until the next check is needed. Returns a trap with the IT state of its instruction;
    /// `None` without a trap.
    fn execute_until_limit<const PROBE: bool>(
        &mut self,
        system: &mut impl System,
    ) -> Option<(Trap, u8)> {
        loop {
            // The table is taken out of the core, so that instructions are borrowed without a copy.
            let decoded = std::mem::take(&mut self.decoded);
            let end = self.execute_decoded::<PROBE>(system, &decoded);
            self.decoded = decoded;
            let Some((Trap::Undecoded, it)) = end else {
                return end;
            };
            if let Err(trap) = self.decode_flash(system, self.pc) {
                return Some((trap, it));
            }
        }
    }

    /// Not inlined, so that the loop keeps its values in registers of the host.
    #[inline(never)]
    fn execute_decoded<const PROBE: bool>(
        &mut self,
        system: &mut impl System,
        decoded: &[Insn],
    ) -> Option<(Trap, u8)> {
        let mut pc = self.pc;
        let mut count = 0;
        let mut it = 0;
        let mut other;
        let trap = loop {
            if self.cycles >= system.limit() || self.check_needed {
                break None;
            }
            if PROBE && count > 0 && self.debug.step {
                break None;
            }
            let before = self.cycles;
            it = self.it;
            let index = (pc.wrapping_sub(fetch::FLASH) >> 1) as usize;
            let mut insn = match decoded.get(index) {
                Some(insn) => insn,
                None => match self.fetch_elsewhere(system, pc) {
                    Ok(insn) => {
                        other = insn;
                        &other
                    }
                    Err(trap) => break Some(trap),
                },
            };
            let next = pc.wrapping_add(u32::from(insn.size));
            let last = next.wrapping_sub(2);
            if last >> 4 != self.line
                && let Err(trap) = self.enter_line(system, pc, last)
            {
                break Some(trap);
            }
            if (PROBE || it != 0) && matches!(insn.op, Op::Empty) {
                if PROBE {
                    self.account(u32::MAX, before);
                }
                break Some(Trap::Undecoded);
            }
            // Must stay behind the test for undecoded instructions: such an instruction comes here twice, and
            // `stops_at` must be called once.
            if PROBE && !self.debug.step && self.debug.stops_at(pc) {
                self.stop = Some(Stop::Breakpoint(pc));
                break None;
            }
            if it != 0 {
                self.it = advance_it(it);
                if !self.condition(it >> 4) && !insn.is_breakpoint() {
                    self.cycles += 1;
                    count += 1;
                    pc = next;
                    continue;
                }
                other = insn.in_block();
                insn = &other;
            }
            self.cycles += u64::from(insn.cycles);
            match self.execute(system, insn, pc, next) {
                Ok(next) => {
                    if PROBE {
                        self.account(pc, before);
                    }
                    count += 1;
                    pc = next;
                }
                Err(trap) => {
                    count += u64::from(trap != Trap::Undecoded);
                    break Some(trap);
                }
            }
        };
        self.pc = pc;
        self.instructions = self.instructions.wrapping_add(count);
        trap.map(|trap| (trap, it))
    }

    #[inline(never)]
    fn account(&mut self, pc: u32, before: Cycles) {
        let cycles = self.cycles - before;
        if let Some(profile) = &mut self.profile {
            profile.instruction(pc, cycles);
        }
    }
}

/// Next state of an IT block (ITAdvance).
fn advance_it(it: u8) -> u8 {
    if it & 7 == 0 {
        0
    } else {
        it & 0xe0 | it << 1 & 0x1f
    }
}
