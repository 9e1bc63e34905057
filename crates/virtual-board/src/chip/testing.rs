//! Shared parts of the tests of peripherals.

use super::Peripheral;
use super::circuit::{Bare, Circuit};
use super::effect::{Effect, Request};
use super::interrupt::Interrupt;
use super::map::Unit;
use super::shared::Shared;
use crate::finding::FindingKind;
use crate::time::{Cycles, NEVER};
use std::any::Any;

/// Shared state after a reset, with no circuit around the chip.
pub(crate) fn shared() -> Shared {
    Shared::new(Box::new(Bare), 0)
}

/// A peripheral under test, accessed through its registers.
pub(crate) struct PeripheralBench<P> {
    pub part: P,
    pub shared: Shared,
    unit: Unit,
}

impl<P: Peripheral> PeripheralBench<P> {
    /// A peripheral in a chip with `circuit`, at 168 MHz with APB dividers 4 and 2.
    pub fn around(circuit: impl Circuit, unit: Unit, part: P) -> Self {
        let mut shared = Shared::new(Box::new(circuit), 0);
        shared.base.set_frequency(0, 168_000_000);
        shared.clocks.hclk_hz = 168_000_000;
        (shared.clocks.apb1, shared.clocks.apb2) = (4, 2);
        Self { part, shared, unit }
    }

    pub fn read(&mut self, offset: u32) -> u32 {
        self.part.read(offset, &mut self.shared)
    }

    pub fn write(&mut self, values: &[(u32, u32)]) {
        for &(offset, value) in values {
            self.part.write(offset, value, !0, &mut self.shared);
        }
    }

    /// Handles the peripheral's events up to and including cycle `until`.
    pub fn run(&mut self, until: Cycles) {
        while self.shared.arrive(self.unit, until) {
            self.part.event(&mut self.shared);
        }
    }

    /// Circuit around the chip.
    pub fn circuit<T: Circuit>(&mut self) -> &mut T {
        let any: &mut dyn Any = self.shared.circuit();
        any.downcast_mut().expect("the circuit of the bench")
    }

    /// DMA requests since the last call.
    pub fn requests(&mut self) -> Vec<Request> {
        let effects = self.shared.effects.drain(..);
        let requests = effects.filter_map(|effect| match effect {
            Effect::Dma(request) => Some(request),
            _ => None,
        });
        requests.collect()
    }
}

impl Shared {
    /// Advances to the next event of a peripheral, at most to `end`. True if the event is due by `end`.
    pub fn arrive(&mut self, unit: Unit, end: Cycles) -> bool {
        let due = self.due(unit);
        self.now = due.min(end);
        if due <= end {
            self.schedule(unit, NEVER);
        }
        due <= end
    }

    pub fn kinds(&self) -> Vec<FindingKind> {
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
