//! The flash of an emulated board: a file of the host, by semihosting, with the sectors of the chip.
//!
//! The emulated machine has no flash controller, so the chip's driver has nothing to talk to. The
//! store itself is that of a real board. As on the chip, a write only clears bits and an erase sets
//! those of a whole sector.

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use semihosting::fs::{File, OpenOptions};
use semihosting::io::{Read, Seek, SeekFrom, Write};

use super::options::Options;
use crate::store::Store;

/// Bytes of a sector.
const SECTOR: u32 = 16 * 1024;
/// Bytes of the file: three sectors.
const SIZE: u32 = 3 * SECTOR;

/// The file; without one the flash is blank and cannot be written.
pub struct Flash(Option<File>);

/// The store in the file that `flash=` names; `None` if it is not of the right size.
pub fn open(options: &Options) -> Option<Store<Flash>> {
    let file = match options.path("flash") {
        Some(path) => {
            let mut how = OpenOptions::new();
            let file = how.read(true).write(true).open(path.as_c_str()).ok()?;
            if file.metadata().ok()?.len() != u64::from(SIZE) {
                return None;
            }
            Some(file)
        }
        None => None,
    };
    Store::new(Flash(file), 0..SIZE)
}

impl Flash {
    fn at(&mut self, offset: u32, length: usize) -> Result<&mut File, NorFlashErrorKind> {
        let end = u64::from(offset) + length as u64;
        if end > u64::from(SIZE) {
            return Err(NorFlashErrorKind::OutOfBounds);
        }
        let file = self.0.as_mut().ok_or(NorFlashErrorKind::Other)?;
        let sought = file.seek(SeekFrom::Start(offset.into()));
        sought.map(|_| file).map_err(|_| NorFlashErrorKind::Other)
    }
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        if self.0.is_none() {
            bytes.fill(0xff);
            return Ok(());
        }
        let read = self.at(offset, bytes.len())?.read_exact(bytes);
        read.map_err(|_| NorFlashErrorKind::Other)
    }

    fn capacity(&self) -> usize {
        SIZE as usize
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR as usize;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        let blank = [0xff; 256];
        for start in (from..to).step_by(blank.len()) {
            let written = self.at(start, blank.len())?.write_all(&blank);
            written.map_err(|_| NorFlashErrorKind::Other)?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        if !offset.is_multiple_of(4) || !bytes.len().is_multiple_of(4) {
            return Err(NorFlashErrorKind::NotAligned);
        }
        for (start, word) in (offset..).step_by(4).zip(bytes.chunks(4)) {
            let mut cells = [0; 4];
            self.read(start, &mut cells).await?;
            for (cell, byte) in cells.iter_mut().zip(word) {
                *cell &= byte;
            }
            let written = self.at(start, cells.len())?.write_all(&cells);
            written.map_err(|_| NorFlashErrorKind::Other)?;
        }
        Ok(())
    }
}
