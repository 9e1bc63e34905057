//! Ports: modes, levels, alternate functions.

use super::Peripheral;
use super::pin::{Drive, Pin, Signal};
use super::register::Register;
use super::shared::{Shared, Source};

/// All ports.
#[derive(Default)]
pub(crate) struct Gpio {}

impl Gpio {
    /// The world drives a pin in another way.
    pub fn external(&mut self, pin: Pin, drive: Drive, shared: &mut Shared) {
        let _ = (pin, drive, shared);
    }

    /// A peripheral drives its output in another way.
    pub fn output(&mut self, signal: Signal, drive: Drive, shared: &mut Shared) {
        let _ = (signal, drive, shared);
    }

    /// The peripheral's input that listens to a pin.
    pub fn signal_at(&self, pin: Pin) -> Option<Signal> {
        let _ = pin;
        None
    }

    /// The pin that a peripheral's signal is on.
    pub fn pin_of(&self, signal: Signal) -> Option<Pin> {
        let _ = signal;
        None
    }

    /// Level of a pin.
    pub fn level(&self, pin: Pin) -> bool {
        let _ = pin;
        false
    }
}

impl Peripheral for Gpio {
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
