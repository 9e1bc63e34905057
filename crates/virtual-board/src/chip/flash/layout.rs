//! Sectors of the flash, and how long operations take.

use crate::core::Width;
use crate::time::Time;

/// Length of the main memory.
pub(super) const LENGTH: usize = 1 << 20;
/// First address of the main memory.
pub(super) const BASE: u32 = super::super::FLASH;
/// How many sectors there are.
pub(super) const SECTORS: u32 = 12;

/// The place in the main memory at an address.
#[inline]
pub(super) fn main(address: u32) -> Option<usize> {
    let at = address.wrapping_sub(BASE) as usize;
    if at < LENGTH {
        return Some(at);
    }
    // With the boot pin low the flash is seen at 0 too.
    ((address as usize) < LENGTH).then_some(address as usize)
}

/// First and last byte of a sector.
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

/// Programming a byte, half or word, typically.
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

/// What an operation is done with: PSIZE.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Parallelism(pub u32);

impl Parallelism {
    /// The access that it programs with; eight bytes are beyond the core.
    pub fn is(self, width: Width) -> bool {
        self.0 == width.bytes().trailing_zeros()
    }

    /// Whether the supply suffices (RM0090, table of program and erase parallelism); eight bytes need
    /// a higher voltage at a pin.
    pub fn is_allowed(self, volts: f64) -> bool {
        match self.0 {
            0 => volts >= 1.7,
            1 => volts >= 2.1,
            2 => volts >= 2.7,
            _ => false,
        }
    }

    /// Time to erase a sector.
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
    fn sectors_follow_each_other() {
        let mut next = 0;
        for number in 0..SECTORS {
            let (first, last) = sector(number).expect("a sector");
            assert_eq!(first, next);
            next = last + 1;
        }
        assert_eq!((next, sector(SECTORS)), (LENGTH, None));
        // RM0090, table of the sectors.
        assert_eq!(sector(4), Some((0x1_0000, 0x1_ffff)));
        assert_eq!(sector(11), Some((0xe_0000, 0xf_ffff)));
    }
}
