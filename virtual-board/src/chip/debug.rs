//! Debug unit and device signature.
//!
//! Source: reference manual RM0090, chapters 38 and 39. The identity is that of revision Y, on which
//! prefetch may be used (the errata sheet forbids it on revision A).

use super::Peripheral;
use super::map::IDENTITY;
use super::register::{Register, merge, narrow, word};
use super::shared::Shared;

/// Device 0x413, revision Y.
const IDCODE: u32 = 0x100f_6413;
/// Size of the flash, KiB.
const FLASH_KIB: u32 = 1024;

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    word(0x00, "IDCODE", !0), word(0x04, "CR", 0xe7), word(0x08, "APB1_FZ", 0x06e0_1dff), word(0x0c, "APB2_FZ", 0x0007_0003),
    narrow(IDENTITY, "ID1", !0), narrow(IDENTITY + 4, "ID2", !0), narrow(IDENTITY + 8, "ID3", !0),
    narrow(IDENTITY + 16, "FLASH_SIZE", !0),
];

/// DBGMCU, unique identifier, size of the flash.
#[derive(Default)]
pub(crate) struct Debug {
    settings: [u32; 3],
}

impl Peripheral for Debug {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            0x00 => IDCODE,
            0x04..=0x0c => self.settings[offset as usize / 4 - 1],
            // A lot and wafer that no chip has.
            IDENTITY => 0x0042_0017,
            _ if offset == IDENTITY + 4 => 0x3436_5102,
            _ if offset == IDENTITY + 8 => 0x3034_3832,
            // The half above the one that holds the size.
            _ => FLASH_KIB << 16,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, _shared: &mut Shared) {
        if let 0x04..=0x0c = offset {
            let register = &mut self.settings[offset as usize / 4 - 1];
            *register = merge(*register, value, mask);
        }
    }
}
