//! Faults inside a chip, permanent or transient, to test how a program reacts.

use super::Chip;

/// Faults injected into a chip; none by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InjectedFaults {
    /// True if the DMA controllers serve no request, as if the bus were always busy; a running converter loses samples.
    pub dma_waits: bool,
    /// True if the next transfer of a DMA stream meets a bus error; cleared by that transfer.
    pub dma_error: bool,
    /// Number of converter triggers still to be lost.
    pub triggers_lost: u32,
}

impl Chip {
    /// Injected faults; the caller sets or clears them.
    pub fn injected_faults(&mut self) -> &mut InjectedFaults {
        &mut self.injected_faults
    }
}

impl InjectedFaults {
    /// True if a trigger of the converter is lost; counts `triggers_lost` down.
    pub(super) fn loses_trigger(&mut self) -> bool {
        let lost = self.triggers_lost > 0;
        self.triggers_lost = self.triggers_lost.saturating_sub(1);
        lost
    }
}
