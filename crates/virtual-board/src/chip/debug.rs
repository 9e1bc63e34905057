//! Debug unit and device signature.
//!
//! Source: reference manual RM0090, chapters 38 and 39. The identity is that of revision Y, on which prefetch is
//! allowed (the errata sheet forbids prefetch on revision A). A system reset does not change the debug unit. The
//! watchdogs and TIM1 to TIM5 can be frozen while a debugger halts the core. A request to freeze another peripheral, or
//! for trace pins, is a finding.

use super::Peripheral;
use super::chip_variation::Random;
use super::map::IDENTITY;
use super::register::{Register, merge, narrow, word};
use super::shared::Shared;
use crate::finding::FindingKind;

/// Device 0x413, revision Y.
const IDCODE: u32 = 0x100f_6413;
/// Size of the flash, KiB.
const FLASH_KIB: u32 = 1024;
/// Bits of APB1_FZ that freeze the real-time clock (not modelled), window watchdog and independent watchdog.
const FREEZE_RTC: u32 = 1 << 10;
const FREEZE_WWDG: u32 = 1 << 11;
const FREEZE_IWDG: u32 = 1 << 12;
/// Bits that freeze timers: in APB1_FZ TIM2 to TIM5, in APB2_FZ TIM1.
const FREEZE_TIMERS: u32 = 0xf;
const FREEZE_TIM1: u32 = 1;
/// Bits of CR that assign the trace pins.
const TRACE: u32 = 0xe0;

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    word(0x00, "IDCODE", !0), word(0x04, "CR", 0xe7), word(0x08, "APB1_FZ", 0x06e0_1dff), word(0x0c, "APB2_FZ", 0x0007_0003),
    narrow(IDENTITY, "ID1", !0), narrow(IDENTITY + 4, "ID2", !0), narrow(IDENTITY + 8, "ID3", !0),
    narrow(IDENTITY + 16, "FLASH_SIZE", !0),
];

/// DBGMCU, unique identifier, size of the flash.
#[derive(Clone, Default)]
pub(crate) struct Debug {
    settings: [u32; 3],
}

impl Debug {
    /// True if a halted core stops the independent watchdog.
    pub fn stops_watchdog(&self) -> bool {
        self.settings[1] & FREEZE_IWDG != 0
    }

    /// True if a halted core stops the window watchdog.
    pub fn stops_window_watchdog(&self) -> bool {
        self.settings[1] & FREEZE_WWDG != 0
    }

    /// True if a halted core stops the timer; 0 is TIM1.
    pub fn stops_timer(&self, timer: usize) -> bool {
        match timer {
            0 => self.settings[2] & FREEZE_TIM1 != 0,
            _ => self.settings[1] & FREEZE_TIMERS & 1 << (timer - 1) != 0,
        }
    }

    /// Position on the wafer, wafer number and lot number; the lot number is in ASCII.
    fn identity(shared: &Shared) -> [u32; 3] {
        let mut random = Random::new(shared.variation.seed);
        let mut draw = |below: u64| (random.next() >> 16) % below;
        let place = draw(100) << 16 | draw(100);
        let wafer = 1 + draw(25);
        let mut lot = || u64::from(b'0') + draw(10);
        let lot: [u64; 7] = std::array::from_fn(|_| lot());
        let word = |bytes: [u64; 4]| bytes.iter().rev().fold(0, |word, byte| word << 8 | byte);
        [
            place as u32,
            word([wafer, lot[0], lot[1], lot[2]]) as u32,
            word([lot[3], lot[4], lot[5], lot[6]]) as u32,
        ]
    }
}

impl Peripheral for Debug {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        if let Some(offset) = offset.checked_sub(IDENTITY) {
            return match offset {
                0..=8 => Self::identity(shared)[offset as usize / 4],
                // The flash size is in the upper halfword.
                _ => FLASH_KIB << 16,
            };
        }
        match offset {
            0x00 => IDCODE,
            _ => self.settings[offset as usize / 4 - 1],
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        if !(0x04..=0x0c).contains(&offset) {
            return shared.note(FindingKind::Forbidden, "the device signature is read only");
        }
        let register = &mut self.settings[offset as usize / 4 - 1];
        let old = std::mem::replace(register, merge(*register, value, mask));
        let unknown = match offset {
            0x04 => TRACE,
            0x08 => !(FREEZE_RTC | FREEZE_WWDG | FREEZE_IWDG | FREEZE_TIMERS),
            _ => !FREEZE_TIM1,
        };
        if *register & !old & unknown != 0 {
            let text = "DBGMCU: trace pins, stopping peripherals of a halted core";
            shared.note(FindingKind::NotModelled, text);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    #[test]
    fn identity_is_device_0x413_with_1024_kib_flash() {
        let (mut debug, mut shared) = (Debug::default(), shared());
        assert_eq!(debug.read(0, &mut shared) & 0xfff, 0x413);
        // The flash size register is the halfword at 0x1fff_7a22, the upper half of this word.
        let size = debug.read(IDENTITY + 0x10, &mut shared) >> 16;
        assert_eq!(size, 1024);
    }

    #[test]
    fn identities_differ_by_seed_and_hold_a_lot_in_ascii() {
        let (mut debug, mut shared) = (Debug::default(), shared());
        let mut read = |seed: u64| {
            shared.variation.seed = seed;
            [0, 4, 8].map(|at| debug.read(IDENTITY + at, &mut shared))
        };
        let mut identities: Vec<_> = (0..200).map(&mut read).collect();
        assert_eq!(read(7), identities[7]);
        for id in &identities {
            let lot = id[1].to_le_bytes()[1..]
                .iter()
                .chain(&id[2].to_le_bytes())
                .copied()
                .collect::<Vec<_>>();
            assert!(lot.iter().all(u8::is_ascii_digit), "{lot:?}");
        }
        identities.sort_unstable();
        identities.dedup();
        assert_eq!(identities.len(), 200);
    }

    #[test]
    fn freezing_anything_but_watchdogs_and_timers_is_a_finding() {
        let (mut debug, mut shared) = (Debug::default(), shared());
        debug.write(0x08, FREEZE_IWDG, !0, &mut shared);
        debug.write(0x04, 7, !0, &mut shared);
        assert!(debug.stops_watchdog() && shared.findings.list().is_empty());
        debug.write(0x08, 1 << 2, !0, &mut shared);
        debug.write(0x0c, 1, !0, &mut shared);
        let stopped = [0, 1, 2, 3, 4].map(|timer| debug.stops_timer(timer));
        assert_eq!(stopped, [true, false, false, true, false]);
        assert!(shared.findings.list().is_empty());
        debug.write(0x0c, 2, !0, &mut shared);
        assert_eq!(shared.findings.list()[0].kind, FindingKind::NotModelled);
    }
}
