//! Role of an axle board by a strap: PC13 open is the front axle, to ground the rear one.

use core_algos::topology::AxleId;
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::peripherals::PC13;

/// Reads the strap; it counts at start only.
pub fn axle(pin: Peri<'static, PC13>) -> AxleId {
    let strap = Input::new(pin, Pull::Up);
    // The pull-up of 40 kΩ charges the pin's few picofarads within a microsecond.
    cortex_m::asm::delay(crate::clock::CORE_HZ / 100_000);
    if strap.is_high() {
        AxleId(0)
    } else {
        AxleId(1)
    }
}
