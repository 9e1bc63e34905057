//! Read-only view of one flash sector, as if it were the sector in use and all others were blank.

use core::ops::Range;
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

/// Byte of a mark at either end of a sector; a blank byte is not a mark.
const MARK: u8 = 0;
const BLANK: u8 = 0xff;

/// Error of a [`View`].
#[derive(Clone, Copy, Debug)]
pub struct ViewError(NorFlashErrorKind);

impl NorFlashError for ViewError {
    fn kind(&self) -> NorFlashErrorKind {
        self.0
    }
}

/// Read-only view of one sector of a flash.
pub struct View<'a, F> {
    flash: &'a mut F,
    sector: Range<u32>,
}

impl<'a, F: NorFlash> View<'a, F> {
    /// Creates a view of one sector.
    pub fn new(flash: &'a mut F, sector: Range<u32>) -> Self {
        Self { flash, sector }
    }

    /// Byte that the view shows instead of the flash's byte; `None` if the view shows the flash's byte.
    fn replaced(&self, address: u32) -> Option<u8> {
        let word = F::WRITE_SIZE.max(F::READ_SIZE) as u32;
        let Range { start, end } = self.sector;
        match address {
            _ if address < start || address >= end - word => Some(BLANK),
            _ if address < start + word => Some(MARK),
            _ => None,
        }
    }
}

impl<F: NorFlash> ErrorType for View<'_, F> {
    type Error = ViewError;
}

impl<F: NorFlash> ReadNorFlash for View<'_, F> {
    const READ_SIZE: usize = F::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), ViewError> {
        let read = self.flash.read(offset, bytes).await;
        read.map_err(|error| ViewError(error.kind()))?;
        for (address, byte) in (offset..).zip(bytes) {
            *byte = self.replaced(address).unwrap_or(*byte);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl<F: NorFlash> NorFlash for View<'_, F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    async fn erase(&mut self, _from: u32, _to: u32) -> Result<(), ViewError> {
        Err(ViewError(NorFlashErrorKind::Other))
    }

    async fn write(&mut self, _offset: u32, _bytes: &[u8]) -> Result<(), ViewError> {
        Err(ViewError(NorFlashErrorKind::Other))
    }
}

/// True if the library accepts the byte at `address` as a mark: at least half of its bits are zero.
pub async fn is_marked<F: NorFlash>(flash: &mut F, address: u32) -> bool {
    let mut bytes = [BLANK; 32];
    let Some(bytes) = bytes.get_mut(..F::READ_SIZE) else {
        return false;
    };
    let read = flash.read(address, bytes).await;
    let zeros: u32 = bytes.iter().map(|byte| byte.count_zeros()).sum();
    read.is_ok() && zeros >= 4
}
