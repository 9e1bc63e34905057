//! Areas and sectors of the flash, and how long operations take.

use crate::core::Width;
use crate::time::Time;

/// Length of the main memory.
pub(super) const LENGTH: usize = 1 << 20;
/// First address of the main memory.
pub(super) const BASE: u32 = super::super::FLASH;
/// First address and length of the boot loader's memory.
const SYSTEM: u32 = 0x1fff_0000;
const SYSTEM_LENGTH: u32 = 30 << 10;
/// First address of the area that is programmed once, its length, and that of the lock bytes.
const ONCE: u32 = 0x1fff_7800;
pub(super) const ONCE_LENGTH: usize = 528;
pub(super) const ONCE_LOCKS: usize = 16;
/// Option bytes as the program can read them, and their length.
const OPTIONS: u32 = 0x1fff_c000;
const OPTIONS_LENGTH: u32 = 16;
/// How many sectors there are.
pub(super) const SECTORS: u32 = 12;

/// A place in the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    Main(usize),
    /// The boot loader's memory.
    System,
    Once(usize),
    Options(u32),
}

impl Place {
    /// The place at an address.
    pub fn of(address: u32) -> Option<Self> {
        let within = |first: u32, length: u32| {
            let at = address.wrapping_sub(first);
            (at < length).then_some(at)
        };
        if let Some(at) = main(address) {
            return Some(Self::Main(at));
        }
        if within(SYSTEM, SYSTEM_LENGTH).is_some() {
            return Some(Self::System);
        }
        if let Some(at) = within(ONCE, ONCE_LENGTH as u32) {
            return Some(Self::Once(at as usize));
        }
        within(OPTIONS, OPTIONS_LENGTH).map(Self::Options)
    }
}

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

/// The sector that a place is in.
pub(super) fn sector_of(at: usize) -> u32 {
    match at >> 14 {
        k @ 0..=3 => k as u32,
        4..=7 => 4,
        _ => (at >> 17) as u32 + 4,
    }
}

/// Programming a byte, half or word, typically.
pub(super) const PROGRAM: Time = Time::from_micros(16);

const fn millis(millis: u64) -> Time {
    Time::from_micros(1000 * millis)
}

/// Typical times to erase a sector of 16, 64 and 128 KiB, and all, by the parallelism PSIZE.
const ERASE: [[Time; 4]; 3] = [
    [millis(400), millis(1200), millis(2000), millis(16_000)],
    [millis(300), millis(700), millis(1300), millis(11_000)],
    [millis(250), millis(550), millis(1000), millis(8_000)],
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

    /// Time to erase everything.
    pub fn all(self) -> Time {
        ERASE[self.0.min(2) as usize][3]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sectors_follow_each_other_and_their_places_lead_back() {
        let mut next = 0;
        for number in 0..SECTORS {
            let (first, last) = sector(number).expect("a sector");
            assert_eq!(first, next);
            assert_eq!([first, last].map(sector_of), [number; 2]);
            next = last + 1;
        }
        assert_eq!((next, sector(SECTORS)), (LENGTH, None));
        // RM0090, table of the sectors.
        assert_eq!(sector(4), Some((0x1_0000, 0x1_ffff)));
        assert_eq!(sector(11), Some((0xe_0000, 0xf_ffff)));
    }

    #[test]
    fn areas_are_where_the_manual_says() {
        for (address, place) in [
            (0x0800_0000, Some(Place::Main(0))),
            (0x0000_0004, Some(Place::Main(4))),
            (0x0810_0000, None),
            (0x1fff_0000, Some(Place::System)),
            (0x1fff_77ff, Some(Place::System)),
            (0x1fff_7800, Some(Place::Once(0))),
            (0x1fff_7a0f, Some(Place::Once(527))),
            (0x1fff_7a10, None),
            (0x1fff_c008, Some(Place::Options(8))),
            (0x1fff_c010, None),
        ] {
            assert_eq!(Place::of(address), place, "{address:#x}");
        }
    }
}
