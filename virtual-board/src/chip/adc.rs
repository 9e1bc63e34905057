//! Analogue converter ADC1.

use super::Peripheral;
use super::register::Register;
use super::shared::{Shared, Source, Trigger};

/// The converter.
#[derive(Default)]
pub(crate) struct Adc {}

impl Adc {
    /// A trigger fired.
    pub fn trigger(&mut self, trigger: Trigger, shared: &mut Shared) {
        let _ = (trigger, shared);
    }
}

impl Peripheral for Adc {
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
