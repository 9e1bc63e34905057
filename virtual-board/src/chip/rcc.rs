//! Reset and clock control.

use super::Peripheral;
use super::register::Register;
use super::shared::{Shared, Source};

/// Oscillators, PLL, clocks of buses and peripherals, causes of resets.
#[derive(Default)]
pub(crate) struct Rcc {}

/// Why the chip was reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power came on.
    PowerOn,
    /// The supply sagged below the brown-out level.
    BrownOut,
    /// The reset pin.
    Pin,
    /// The program.
    Software,
    /// The independent watchdog.
    Watchdog,
}

/// What a reset leaves as it is.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Kept {}

impl Rcc {
    /// What is kept over a reset.
    pub fn kept(&self, cause: Cause) -> Kept {
        let _ = cause;
        Kept {}
    }

    /// After a reset.
    pub fn begin(&mut self, kept: Kept, cause: Cause) {
        let _ = (kept, cause);
    }

    /// Whether a bit of an enable register is set.
    pub fn is_enabled(&self, register: u32, bit: u32) -> bool {
        let _ = (register, bit);
        true
    }

    /// The crystal works or fails.
    pub fn crystal(&mut self, works: bool, shared: &mut Shared) {
        let _ = (works, shared);
    }
}

impl Peripheral for Rcc {
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
