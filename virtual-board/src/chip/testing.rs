//! What tests of peripherals share.

use super::pin::{Drive, Pin};
use super::shared::Shared;
use super::surroundings::Surroundings;
use crate::time::Time;

/// Nothing is soldered to the chip.
pub(crate) struct Nothing;

impl Surroundings for Nothing {
    fn pin(&mut self, _pin: Pin, _drive: Drive, _at: Time) {}

    fn voltage(&mut self, _pin: Pin, _at: Time) -> f64 {
        0.0
    }

    fn spi(&mut self, _word: u16, _bits: u32, _at: Time) -> u16 {
        !0
    }
}

/// What peripherals share, after a reset and with nothing around.
pub(crate) fn shared() -> Shared {
    Shared::new(Box::new(Nothing), 0)
}
