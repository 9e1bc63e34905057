//! The flash: bytes, wait states, accelerator, erasing and programming.

use super::Peripheral;
use super::register::Register;
use super::shared::{Shared, Source};
use crate::core::{BusError, Width};
use crate::time::Cycles;

/// The flash and its interface.
pub(crate) struct Flash {
    bytes: Vec<u8>,
}

impl Default for Flash {
    fn default() -> Self {
        Self {
            bytes: vec![0xff; 1 << 20],
        }
    }
}

impl Flash {
    /// The interface after a reset; the bytes stay.
    pub fn reset(&mut self) {}

    /// Its bytes.
    pub fn bytes_mut(&mut self) -> &mut Vec<u8> {
        &mut self.bytes
    }

    /// What stands at an address of the flash, or its alias at 0, system memory or option bytes; none
    /// elsewhere.
    pub fn peek(&self, address: u32, width: Width) -> Option<u32> {
        let at = (address & !0x0800_0000) as usize;
        (at + 4 <= self.bytes.len()).then(|| super::get(&self.bytes, at, width))
    }

    /// The same as a load by the program, with what it takes.
    #[inline]
    pub fn read(
        &mut self,
        address: u32,
        width: Width,
        pc: u32,
        cycle: &mut Cycles,
        shared: &mut Shared,
    ) -> Option<Result<u32, BusError>> {
        let _ = (pc, cycle, shared);
        self.peek(address, width).map(Ok)
    }

    /// A store to an address of the flash; none elsewhere.
    pub fn program(
        &mut self,
        address: u32,
        width: Width,
        value: u32,
        cycle: &mut Cycles,
        shared: &mut Shared,
    ) -> Option<Result<(), BusError>> {
        let _ = (value, cycle, shared);
        self.peek(address, width).map(|_| Err(BusError))
    }

    /// The program enters a line of 16 bytes.
    #[inline]
    pub fn enter_line(&mut self, address: u32, cycle: &mut Cycles) {
        let _ = (address, cycle);
    }

    /// Addresses whose bytes changed since the last call, first and last.
    pub fn take_changed(&mut self) -> Option<(u32, u32)> {
        None
    }
}

impl Peripheral for Flash {
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
