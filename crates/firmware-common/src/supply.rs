//! Supply of the chip: while it is too low for the core's clock, the board waits or restarts.
//!
//! The brown-out level of the option bytes does the same without the program. The image does not write it: power
//! that fails during the write leaves the option bytes erased, which is read protection level 1 (RM0090, 3.9.3): the debug
//! probe removes it only by erasing program and parameters. The flasher sets the level (docs/wiring.md), and the log says which one is in force.

use embassy_stm32::interrupt as handler;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::{EXTI, FLASH, PWR, RCC};

use crate::fault;

/// Level 5 of the voltage detector: below 2.84 V, above 2.93 V (typical). 168 MHz need 2.7 V.
const LEVEL: u8 = 5;
/// Line of the detector among the external interrupts.
const LINE: usize = 16;

/// Waits for the supply, on the internal oscillator that the chip starts with.
pub(crate) fn wait() {
    RCC.apb1enr().modify(|w| w.set_pwren(true));
    // The clock runs some cycles later (ES0182).
    cortex_m::asm::dsb();
    detect();
    while PWR.csr1().read().pvdo() {}
}

fn detect() {
    PWR.cr1().modify(|w| {
        w.set_pls(LEVEL);
        w.set_pvde(true);
    });
}

/// From here on a low supply restarts the board. The HAL has reset the detector.
pub(crate) fn watch() {
    EXTI.rtsr(0).modify(|w| w.set_line(LINE, true));
    EXTI.imr(0).modify(|w| w.set_line(LINE, true));
    detect();
    interrupt::PVD.set_priority(Priority::P0);
    // SAFETY: the handler has no data.
    unsafe { interrupt::PVD.enable() };
}

/// The brown-out level in force, for the log.
pub(crate) fn log() {
    match FLASH.optcr().read().bor_lev() {
        3 => defmt::info!("brown-out level off: set level 3 with the flasher"),
        level => defmt::info!("brown-out level {}", 3 - level),
    }
}

#[handler]
fn PVD() {
    fault::supply_low()
}
