//! SPI1.

use super::Peripheral;
use super::register::Register;
use super::shared::{Shared, Source};

/// The serial interface, as a master.
#[derive(Default)]
pub(crate) struct Spi {}

impl Peripheral for Spi {
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
