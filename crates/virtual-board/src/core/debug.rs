//! Debugger features: breakpoints, watchpoints, single steps.

use super::{Core, Stop, Transfer};
use std::collections::BTreeSet;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Watchpoint {
    address: u32,
    length: u32,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Debug {
    /// True if a debugger is attached: BKPT stops instead of faulting.
    pub(super) attached: bool,
    breakpoints: BTreeSet<u32>,
    watchpoints: Vec<Watchpoint>,
    /// True if the core stops after one instruction.
    pub(super) step: bool,
    /// Breakpoint of the latest stop, which the core passes when it continues; `None` afterwards.
    passing: Option<u32>,
}

impl Debug {
    /// True if each instruction must be checked for a breakpoint or a single step.
    pub(super) fn per_instruction(&self) -> bool {
        self.step || !self.breakpoints.is_empty()
    }

    /// True if accesses to this page of 16 MiB must be checked for a watchpoint.
    pub(super) fn watches_page(&self, page: u32) -> bool {
        self.watchpoints.iter().any(|w| {
            let last = w.address.saturating_add(w.length.saturating_sub(1));
            (w.address >> 24..=last >> 24).contains(&page)
        })
    }

    /// True if the core must stop before this instruction.
    pub(super) fn stops_at(&mut self, pc: u32) -> bool {
        if self.passing.take() == Some(pc) || !self.breakpoints.contains(&pc) {
            return false;
        }
        self.passing = Some(pc);
        true
    }
}

impl Core {
    /// Attaches or detaches a debugger; while attached, BKPT stops the core.
    pub fn attach_debugger(&mut self, attached: bool) {
        self.debug.attached = attached;
    }

    /// Stops the core before the instruction at this address.
    pub fn add_breakpoint(&mut self, address: u32) {
        self.debug.breakpoints.insert(address & !1);
    }

    /// Removes a breakpoint; false if no breakpoint was at this address.
    pub fn remove_breakpoint(&mut self, address: u32) -> bool {
        self.debug.breakpoints.remove(&(address & !1))
    }

    /// Stops the core after an instruction that accesses these addresses.
    pub fn add_watchpoint(&mut self, address: u32, length: u32) {
        self.debug.watchpoints.push(Watchpoint { address, length });
        self.update_view(true);
    }

    /// Stops the core if an access hits a watchpoint.
    pub(super) fn watch(&mut self, at: Transfer, write: bool) {
        let (address, width, pc) = (at.address, at.width, at.pc);
        let hit = self.debug.watchpoints.iter().find(|w| {
            let before = address < w.address.saturating_add(w.length);
            before && address.saturating_add(width.bytes()) > w.address
        });
        if let Some(watchpoint) = hit {
            let address = watchpoint.address;
            self.stop = Some(Stop::Watchpoint { address, pc, write });
            self.check_needed = true;
        }
    }
}
