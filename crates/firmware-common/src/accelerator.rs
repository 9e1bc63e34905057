//! The flash accelerator: at 168 MHz the flash answers after five wait states, which prefetch and
//! caches hide from most fetches and loads.
//!
//! | what | when it is on |
//! |---|---|
//! | instruction cache, 64 lines of 128 bits | always |
//! | data cache, 8 lines of 128 bits | always |
//! | prefetch of the next 128 bits | except on chips of revision A, where it does not work (errata sheet ES0182) |
//!
//! Prefetch reads the flash during ADC conversions, which adds noise (AN4073). Later chips of the family can mask
//! prefetch (ADCDC1 of PWR_CR), the STM32F405 cannot. Prefetch stays on: without prefetch the beam board's longest
//! tick is 0.10 to 0.13 ms longer and exceeds its limit.
//!
//! A cache may be reset only while it is off (RM0090, 3.5). A write to the flash updates the data cache, an erase
//! does not: call [`flush`] after each erase.

use embassy_stm32::pac::{DBGMCU, FLASH};

/// Device number of the chip in DBGMCU_IDCODE.
const DEVICE: u16 = 0x413;
/// Revision A of the chip in DBGMCU_IDCODE.
const REVISION_A: u16 = 0x1000;

/// Switches on both caches, and prefetch where the chip supports it.
pub(crate) fn enable() {
    let chip = DBGMCU.idcode().read();
    // Chips of revision A also report another device number.
    let prefetch = chip.dev_id() == DEVICE && chip.rev_id() != REVISION_A;
    flush();
    FLASH.acr().modify(|w| {
        w.set_prften(prefetch);
        w.set_icen(true);
        w.set_dcen(true);
    });
}

/// Empties both caches, whose contents may have been erased in the flash.
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
