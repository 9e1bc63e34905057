//! What may be broken inside a chip, or upset for a moment: for trials of what a program does then.

use super::Chip;

/// Faults injected into a chip; none by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InjectedFaults {
    /// The DMA controllers serve no request, as if their bus were never free: a converter that goes on
    /// loses samples.
    pub dma_waits: bool,
    /// The next transfer of a DMA stream meets a bus error; it is over then.
    pub dma_error: bool,
    /// So many triggers of the converter come to nothing.
    pub triggers_lost: u32,
}

impl Chip {
    /// What is broken inside, to be changed.
    pub fn injected_faults(&mut self) -> &mut InjectedFaults {
        &mut self.injected_faults
    }
}

impl InjectedFaults {
    /// Whether a trigger of the converter is lost.
    pub(super) fn loses_trigger(&mut self) -> bool {
        let lost = self.triggers_lost > 0;
        self.triggers_lost = self.triggers_lost.saturating_sub(1);
        lost
    }
}
