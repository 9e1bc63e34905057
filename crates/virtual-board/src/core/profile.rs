//! Profile: cycles for each instruction, counts and durations for each exception.

use super::Core;
use super::fetch::FLASH;
use crate::time::Cycles;

/// Counts and durations of an exception.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExceptionProfile {
    /// Number of returns from the exception.
    pub count: u64,
    /// Cycles of all executions, without pre-empting exceptions.
    pub total: Cycles,
    /// Longest time from entry to return, with pre-empting exceptions, cycles.
    pub longest: Cycles,
    /// Longest execution without pre-empting exceptions, cycles.
    pub longest_own: Cycles,
    /// Longest time from becoming pending to the first instruction, cycles.
    pub longest_latency: Cycles,
}

/// An exception that has not yet returned.
#[derive(Clone, Copy, Debug)]
struct Running {
    exception: u16,
    begin: Cycles,
    /// Cycles of pre-empting exceptions.
    others: Cycles,
}

/// Profile of a run.
#[derive(Clone, Debug)]
pub struct Profile {
    /// Cycles for each halfword of flash.
    flash: Vec<u64>,
    /// Cycles of instructions outside of flash, and of the first fetch of instructions in flash.
    elsewhere: Cycles,
    exceptions: Vec<ExceptionProfile>,
    running: Vec<Running>,
}

impl Default for Profile {
    fn default() -> Self {
        Self {
            flash: Vec::new(),
            elsewhere: 0,
            exceptions: vec![ExceptionProfile::default(); 128],
            running: Vec::new(),
        }
    }
}

impl Profile {
    /// Instructions in flash that took cycles, by address, with their cycles.
    pub fn instructions(&self) -> impl Iterator<Item = (u32, Cycles)> {
        let addresses = (FLASH..).step_by(2);
        addresses
            .zip(self.flash.iter().copied())
            .filter(|&(_, cycles)| cycles != 0)
    }

    /// Cycles of instructions outside of flash, and of the first fetch of each instruction in flash. That fetch is not
    /// counted for its instruction, which an IT block may still skip.
    pub fn elsewhere(&self) -> Cycles {
        self.elsewhere
    }

    /// Counts and durations of an exception.
    pub fn exception(&self, number: u16) -> ExceptionProfile {
        let found = self.exceptions.get(usize::from(number));
        found.copied().unwrap_or_default()
    }

    pub(super) fn instruction(&mut self, pc: u32, cycles: Cycles) {
        let index = (pc.wrapping_sub(FLASH) >> 1) as usize;
        if index >= 1 << 19 {
            self.elsewhere += cycles;
            return;
        }
        if index >= self.flash.len() {
            self.flash.resize((index + 1).next_multiple_of(4096), 0);
        }
        self.flash[index] += cycles;
    }

    pub(super) fn enter(&mut self, exception: u16, begin: Cycles, latency: Cycles) {
        self.running.push(Running {
            exception,
            begin,
            others: 0,
        });
        let entry = &mut self.exceptions[usize::from(exception & 127)];
        entry.longest_latency = entry.longest_latency.max(latency);
    }

    pub(super) fn leave(&mut self, exception: u16, end: Cycles) {
        let Some(running) = self.running.pop() else {
            return;
        };
        if running.exception != exception {
            self.running.clear();
            return;
        }
        let whole = end.saturating_sub(running.begin);
        let own = whole.saturating_sub(running.others);
        if let Some(below) = self.running.last_mut() {
            below.others += whole;
        }
        let entry = &mut self.exceptions[usize::from(exception & 127)];
        entry.count += 1;
        entry.total += own;
        entry.longest = entry.longest.max(whole);
        entry.longest_own = entry.longest_own.max(own);
    }

    pub(super) fn reset(&mut self) {
        self.running.clear();
    }
}

impl Core {
    /// Starts a new profile or ends profiling. Profiling is off by default and then costs no time.
    pub fn set_profiling(&mut self, on: bool) {
        self.profile = on.then(Box::default);
        self.check_needed = true;
    }

    /// Profile so far; `None` if profiling is off.
    pub fn profile(&self) -> Option<&Profile> {
        self.profile.as_deref()
    }
}
