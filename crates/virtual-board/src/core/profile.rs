//! Where the time goes: cycles by instruction, and by exception how often and how long.

use super::Core;
use super::fetch::FLASH;
use crate::time::Cycles;

/// What an exception took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExceptionProfile {
    /// How often it ended.
    pub count: u64,
    /// Cycles of all of them, without what preempted them.
    pub total: Cycles,
    /// The longest from entry to return, with what preempted it.
    pub longest: Cycles,
    /// The longest without what preempted it.
    pub longest_own: Cycles,
    /// The longest from becoming pending to the first instruction.
    pub longest_latency: Cycles,
}

/// An exception that has not returned yet.
#[derive(Clone, Copy, Debug)]
struct Running {
    exception: u16,
    begin: Cycles,
    /// Cycles of what preempted it.
    others: Cycles,
}

/// Where the time goes.
#[derive(Clone, Debug)]
pub struct Profile {
    /// By halfword of flash.
    flash: Vec<u64>,
    /// Cycles of instructions elsewhere, and of fetching one of the flash for the first time.
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
    /// Cycles of each instruction of the flash that took some, by address.
    pub fn instructions(&self) -> impl Iterator<Item = (u32, Cycles)> {
        let addresses = (FLASH..).step_by(2);
        addresses
            .zip(self.flash.iter().copied())
            .filter(|&(_, cycles)| cycles != 0)
    }

    /// Cycles of instructions outside the flash, and of fetching one in it for the first time: whether
    /// its condition lets it execute is seen later.
    pub fn elsewhere(&self) -> Cycles {
        self.elsewhere
    }

    /// What an exception took.
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
    /// Begins to note where the time goes, or ends it; off by default, and then free.
    pub fn set_profiling(&mut self, on: bool) {
        self.profile = on.then(Box::default);
        self.attend = true;
    }

    /// Where the time went so far.
    pub fn profile(&self) -> Option<&Profile> {
        self.profile.as_deref()
    }
}
