//! CAN controller CAN1 (bxCAN).

use super::Peripheral;
use super::register::Register;
use super::shared::{Shared, Source};

/// The controller.
#[derive(Default)]
pub(crate) struct Can {}

impl Can {
    /// The program resets the controller by its clock unit.
    pub fn reset(&mut self, shared: &mut Shared) {
        let _ = shared;
    }
}

impl Peripheral for Can {
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
