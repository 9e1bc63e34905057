//! Simulated flash in memory, with a power cut at a given step.

use core::future::Future;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};

/// Random numbers (splitmix64).
#[derive(Clone, Debug)]
pub struct Random(pub u64);

impl Random {
    /// The next 64 bits.
    pub fn draw(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Random integer from 0 to `end` − 1.
    pub fn below(&mut self, end: usize) -> usize {
        (self.draw() % end as u64) as usize
    }
}

/// Content of an interrupted word or sector after a power cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Torn {
    /// The word or sector keeps its former content.
    Untouched,
    /// Some bits have their new value.
    Bits,
    /// Only the first part of the sector is erased; a word is written.
    Front,
    /// Only the last part of the sector is erased; a word is written.
    Back,
}

impl Torn {
    /// All outcomes of a power cut.
    pub const ALL: [Self; 4] = [Self::Untouched, Self::Bits, Self::Front, Self::Back];
}

/// Sectors of `SECTOR` bytes, written word by word as on the chip: a write clears bits, an erase sets them.
#[derive(Clone, Debug)]
pub struct Flash<const SECTOR: usize> {
    /// Bytes of the flash.
    pub bytes: Vec<u8>,
    /// Number of words written and sectors erased.
    pub steps: u64,
    /// Number of sectors erased.
    pub erases: u64,
    /// Step at which the power fails, and the outcome of that step.
    pub cut: Option<(u64, Torn)>,
    /// True if the power failed during an erase.
    pub cut_in_erase: bool,
    random: Random,
}

impl<const SECTOR: usize> Flash<SECTOR> {
    /// Creates a flash of blank sectors; `seed` is for the random bits of interrupted steps.
    pub fn new(sectors: usize, seed: u64) -> Self {
        Self {
            bytes: vec![0xff; sectors * SECTOR],
            steps: 0,
            erases: 0,
            cut: None,
            cut_in_erase: false,
            random: Random(seed),
        }
    }

    /// Address range of the whole flash.
    pub fn range(&self) -> core::ops::Range<u32> {
        0..self.bytes.len() as u32
    }

    /// Counts a step. Returns the outcome of the step if the power fails in it; an error if the power has failed
    /// before.
    fn step(&mut self) -> Result<Option<Torn>, NorFlashErrorKind> {
        let step = self.steps;
        self.steps += 1;
        match self.cut {
            Some((at, _)) if step > at => Err(NorFlashErrorKind::Other),
            Some((at, torn)) if step == at => Ok(Some(torn)),
            _ => Ok(None),
        }
    }
}

impl<const SECTOR: usize> ErrorType for Flash<SECTOR> {
    type Error = NorFlashErrorKind;
}

impl<const SECTOR: usize> ReadNorFlash for Flash<SECTOR> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let start = offset as usize;
        let from = self.bytes.get(start..start + bytes.len());
        bytes.copy_from_slice(from.ok_or(NorFlashErrorKind::OutOfBounds)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const SECTOR: usize> NorFlash for Flash<SECTOR> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        for start in (from as usize..to as usize).step_by(SECTOR) {
            let torn = self.step()?;
            self.erases += 1;
            self.cut_in_erase |= torn.is_some();
            let part = 1 + self.random.below(SECTOR - 1);
            let random = &mut self.random;
            let sector = self
                .bytes
                .get_mut(start..start + SECTOR)
                .ok_or(NorFlashErrorKind::OutOfBounds)?;
            match torn {
                None => sector.fill(0xff),
                Some(Torn::Untouched) => {}
                Some(Torn::Bits) => sector
                    .iter_mut()
                    .for_each(|byte| *byte |= random.draw() as u8),
                Some(Torn::Front) => sector[..part].fill(0xff),
                Some(Torn::Back) => sector[part..].fill(0xff),
            }
            if torn.is_some() {
                return Err(NorFlashErrorKind::Other);
            }
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        if !offset.is_multiple_of(4) || !bytes.len().is_multiple_of(4) {
            return Err(NorFlashErrorKind::NotAligned);
        }
        for (start, word) in (offset as usize..).step_by(4).zip(bytes.chunks(4)) {
            let torn = self.step()?;
            let random = &mut self.random;
            let slots = self
                .bytes
                .get_mut(start..start + 4)
                .ok_or(NorFlashErrorKind::OutOfBounds)?;
            for (slot, &byte) in slots.iter_mut().zip(word) {
                *slot &= match torn {
                    Some(Torn::Untouched) => 0xff,
                    Some(Torn::Bits) => byte | random.draw() as u8,
                    _ => byte,
                };
            }
            if torn.is_some() {
                return Err(NorFlashErrorKind::Other);
            }
        }
        Ok(())
    }
}

/// Runs a future that never waits.
pub fn run<T>(future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    match future
        .as_mut()
        .poll(&mut Context::from_waker(Waker::noop()))
    {
        Poll::Ready(value) => value,
        Poll::Pending => unreachable!("a flash in memory never waits"),
    }
}
