//! DMA controllers.

use super::Peripheral;
use super::register::Register;
use super::shared::{Request, Shared, Source};
use crate::core::Width;

/// A controller.
pub(crate) struct Dma {}

/// Which controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Controller {
    Dma1,
    Dma2,
}

/// One datum to be moved.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Transfer {
    pub stream: usize,
    pub from: u32,
    pub to: u32,
    pub width: Width,
}

impl Dma {
    /// A controller after a reset.
    pub fn new(controller: Controller) -> Self {
        let _ = controller;
        Self {}
    }

    /// A peripheral asks for a transfer: the one to be made, if a stream listens.
    pub fn begin(&mut self, request: Request, shared: &mut Shared) -> Option<Transfer> {
        let _ = (request, shared);
        None
    }

    /// The transfer was made, or met a bus error.
    pub fn end(&mut self, transfer: Transfer, done: bool, shared: &mut Shared) {
        let _ = (transfer, done, shared);
    }
}

impl Peripheral for Dma {
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
