//! Supply of the chip: while the voltage is too low for the core's clock, the board waits or restarts.
//!
//! The brown-out level of the option bytes has the same effect in hardware. The image does not write it: a power cut
//! during the write erases the option bytes, which means read protection level 1 (RM0090, 3.9.3). A debug probe
//! removes that protection only by erasing the program and the parameters. The flasher sets the level
//! (docs/wiring.md), and the log shows the level in force.

use embassy_stm32::interrupt as handler;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::{EXTI, FLASH, PWR, RCC};

use crate::fault;

/// Level 5 of the voltage detector: low below 2.84 V, high above 2.93 V (typical). 168 MHz need 2.7 V.
const LEVEL: u8 = 5;
/// External interrupt line of the detector.
const LINE: usize = 16;

/// Waits for the supply, with the core on the internal oscillator.
pub(crate) fn wait() {
    RCC.apb1enr().modify(|w| w.set_pwren(true));
    // The power controller's clock starts a few cycles after it is enabled (ES0182).
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

/// Makes a low supply restart the board. Sets the detector again, which the HAL has reset.
pub(crate) fn watch() {
    EXTI.rtsr(0).modify(|w| w.set_line(LINE, true));
    EXTI.imr(0).modify(|w| w.set_line(LINE, true));
    detect();
    interrupt::PVD.set_priority(Priority::P0);
    // SAFETY: the handler uses no data.
    unsafe { interrupt::PVD.enable() };
}

/// Logs the brown-out level in force.
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
