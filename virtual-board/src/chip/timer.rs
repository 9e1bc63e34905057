//! Timers TIM1 to TIM5: counting, compare, pulses with dead time and break, encoders, triggers.

use super::Peripheral;
use super::pin::Signal;
use super::register::Register;
use super::shared::{Shared, Source};

/// A timer.
pub(crate) struct Timer {}

/// Which timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Tim1,
    Tim2,
    Tim3,
    Tim4,
    Tim5,
}

impl Timer {
    /// A timer after a reset.
    pub fn new(kind: Kind) -> Self {
        let _ = kind;
        Self {}
    }

    /// An input has another level.
    pub fn input(&mut self, signal: Signal, level: bool, shared: &mut Shared) {
        let _ = (signal, level, shared);
    }
}

impl Peripheral for Timer {
    fn registers(&self) -> &'static [Register] {
        &[]
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        let _ = (offset, shared);
        0
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        let _ = (offset, value, mask, shared);
    }

    fn event(&mut self, source: Source, shared: &mut Shared) {
        let _ = (source, shared);
    }
}
