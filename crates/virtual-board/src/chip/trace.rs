//! Changes of pins, kept for a probe that shows them.

use super::Chip;
use super::pin::Pin;
use crate::time::Time;

/// A pin has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PinChange {
    /// When.
    pub at: Time,
    /// Which.
    pub pin: Pin,
    /// Its level; none if nobody drives it or it is analogue.
    pub level: Option<bool>,
}

impl Chip {
    /// Keeps the changes of pins from now on, for [`Self::take_pins`]; off by default.
    pub fn trace_pins(&mut self) {
        self.traced.get_or_insert_default();
    }

    /// The changes of pins since the last call, in the order of time.
    pub fn take_pins(&mut self) -> Vec<PinChange> {
        self.traced.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// The level of a pin; none if nobody drives it or it is analogue.
    pub fn pin_level(&self, pin: Pin) -> Option<bool> {
        let gpio = &self.units.gpio;
        let digital = !gpio.floats(pin) && !gpio.is_analogue(pin);
        digital.then(|| gpio.level(pin))
    }

    /// Keeps a change, if that is wanted.
    pub(super) fn trace(&mut self, pin: Pin) {
        if self.traced.is_none() {
            return;
        }
        let (at, level) = (self.shared.time(), self.pin_level(pin));
        if let Some(traced) = &mut self.traced {
            traced.push(PinChange { at, pin, level });
        }
    }
}
