//! Power control: voltage scaling, voltage detector, brown-out.

use super::Peripheral;
use super::register::Register;
use super::shared::{Shared, Source};

/// Power control.
#[derive(Default)]
pub(crate) struct Pwr {}

impl Pwr {
    /// The supply is another, V.
    pub fn supply(&mut self, volts: f64, shared: &mut Shared) {
        let _ = (volts, shared);
    }
}

impl Peripheral for Pwr {
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
