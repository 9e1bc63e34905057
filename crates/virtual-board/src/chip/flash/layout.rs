//! Sectors of the flash, and durations of operations.

use crate::core::Width;
use crate::time::Time;

/// Length of the main memory, bytes.
pub(super) const LENGTH: usize = 1 << 20;
/// First address of the main memory.
pub(super) const BASE: u32 = super::super::FLASH;
pub(super) const SECTORS: u32 = 12;

/// Offset of an address in the main memory; `None` if the address is elsewhere.
#[inline]
pub(super) fn main(address: u32) -> Option<usize> {
    let at = address.wrapping_sub(BASE) as usize;
    if at < LENGTH {
        return Some(at);
    }
    // With the boot pin low, the flash is also mapped at 0.
    ((address as usize) < LENGTH).then_some(address as usize)
}

/// First and last byte of a sector; `None` if there is no such sector.
pub(super) fn sector(number: u32) -> Option<(usize, usize)> {
    let kib = |k: usize| k << 10;
    let (first, length) = match number {
        0..=3 => (kib(16) * number as usize, kib(16)),
        4 => (kib(64), kib(64)),
        5..SECTORS => (kib(128) * (number as usize - 4), kib(128)),
        _ => return None,
    };
    Some((first, first + length - 1))
}

/// Typical time to program a byte, halfword or word.
pub(super) const PROGRAM: Time = Time::from_micros(16);

const fn millis(millis: u64) -> Time {
    Time::from_micros(1000 * millis)
}

/// Typical times to erase a sector of 16, 64 and 128 KiB, by the parallelism PSIZE.
const ERASE: [[Time; 3]; 3] = [
    [millis(400), millis(1200), millis(2000)],
    [millis(300), millis(700), millis(1300)],
    [millis(250), millis(550), millis(1000)],
];

/// Program and erase parallelism: PSIZE.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Parallelism(pub u32);

impl Parallelism {
    /// True if a store of this width matches the parallelism. No store of the core matches 64 bits.
    pub fn is(self, width: Width) -> bool {
        self.0 == width.bytes().trailing_zeros()
    }

    /// True if the supply suffices (RM0090, table of program and erase parallelism); 64 bits need a higher voltage at a
    /// pin.
    pub fn is_allowed(self, volts: f64) -> bool {
        match self.0 {
            0 => volts >= 1.7,
            1 => volts >= 2.1,
            2 => volts >= 2.7,
            _ => false,
        }
    }

    pub fn sector(self, number: u32) -> Time {
        let size = match number {
            0..=3 => 0,
            4 => 1,
            _ => 2,
        };
        ERASE[self.0.min(2) as usize][size]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sectors_are_contiguous_and_fill_the_flash() {
        let mut next = 0;
        for number in 0..SECTORS {
            let (first, last) = sector(number).expect("a sector");
            assert_eq!(first, next);
            next = last + 1;
        }
        assert_eq!((next, sector(SECTORS)), (LENGTH, None));
        // RM0090, table of flash sectors.
        assert_eq!(sector(4), Some((0x1_0000, 0x1_ffff)));
        assert_eq!(sector(11), Some((0xe_0000, 0xf_ffff)));
    }
}
