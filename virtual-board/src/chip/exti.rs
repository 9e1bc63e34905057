//! External interrupts and the choice of their ports.

use super::Peripheral;
use super::register::Register;
use super::shared::{Shared, Source};

/// Edges of pins become interrupts.
#[derive(Default)]
pub(crate) struct Exti {}

impl Exti {
    /// The pin that is chosen for a line has another level.
    pub fn level(&mut self, line: u32, level: bool, shared: &mut Shared) {
        let _ = (line, level, shared);
    }
}

impl Peripheral for Exti {
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

/// System configuration: which port each line listens to.
#[derive(Default)]
pub(crate) struct Syscfg {}

impl Syscfg {
    /// The port that a line listens to.
    pub fn port_of(&self, line: u32) -> usize {
        let _ = line;
        0
    }
}

impl Peripheral for Syscfg {
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
