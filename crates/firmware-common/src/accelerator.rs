//! The flash accelerator: at 168 MHz the flash answers after five wait states, which prefetch and
//! caches hide from most fetches and loads.
//!
//! | what | when it is on |
//! |---|---|
//! | instruction cache, 64 lines of 128 bits | always |
//! | data cache, 8 lines of 128 bits | always |
//! | prefetch of the next 128 bits | but on chips of revision A, by whose errata sheet (ES0182) it does not work |
//!
//! Prefetch reads the flash while the converters work, which adds noise (AN4073). The later chips of the family can
//! mask it (ADCDC1 of PWR_CR), the STM32F405 cannot. Without prefetch the beam board's longest tick is 0.10 to 0.13 ms
//! longer, beyond its limit, so prefetch stays on.
//!
//! A cache may be reset only while it is off (RM0090, 3.5). A write to the flash updates the data
//! cache, an erase does not: [`flush`] follows it.

use embassy_stm32::pac::{DBGMCU, FLASH};

/// The chip by DBGMCU_IDCODE.
const DEVICE: u16 = 0x413;
/// Revision A by the same register.
const REVISION_A: u16 = 0x1000;

/// Switches on what the chip has.
pub(crate) fn enable() {
    let chip = DBGMCU.idcode().read();
    // Revision A also names itself another device.
    let prefetch = chip.dev_id() == DEVICE && chip.rev_id() != REVISION_A;
    flush();
    FLASH.acr().modify(|w| {
        w.set_prften(prefetch);
        w.set_icen(true);
        w.set_dcen(true);
    });
}

/// Empties both caches: what they hold may have been erased.
pub(crate) fn flush() {
    critical_section::with(|_| {
        let before = FLASH.acr().read();
        FLASH.acr().modify(|w| {
            w.set_icen(false);
            w.set_dcen(false);
        });
        FLASH.acr().modify(|w| {
            w.set_icrst(true);
            w.set_dcrst(true);
        });
        FLASH.acr().modify(|w| {
            w.set_icrst(false);
            w.set_dcrst(false);
        });
        FLASH.acr().write_value(before);
    });
}
