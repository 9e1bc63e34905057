//! What tests of peripherals share.

use super::circuit::Bare;
use super::interrupt::Interrupt;
use super::map::Unit;
use super::shared::Shared;
use crate::finding::Kind;
use crate::time::{Cycles, NEVER};

/// What peripherals share, after a reset and with nothing around.
pub(crate) fn shared() -> Shared {
    Shared::new(Box::new(Bare), 0)
}

impl Shared {
    /// Goes to what a peripheral has due up to and including `end`, or to `end`; true if it has.
    pub fn arrive(&mut self, unit: Unit, end: Cycles) -> bool {
        let due = self.due(unit);
        self.now = due.min(end);
        if due <= end {
            self.schedule(unit, NEVER);
        }
        due <= end
    }

    /// Kinds of what was found.
    pub fn kinds(&self) -> Vec<Kind> {
        self.findings
            .list()
            .iter()
            .map(|found| found.kind)
            .collect()
    }

    /// True if an interrupt line is high.
    pub fn is_high(&self, interrupt: Interrupt) -> bool {
        self.lines >> interrupt as u32 & 1 != 0
    }
}
