//! LED of the board, PC12, lit when low: the operating state of the node ([`core_algos::node::led`]).

use core_algos::bus::Message;
use core_algos::node::led;
use core_algos::time::Micros;
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::peripherals::PC12;

/// The LED.
pub struct Led {
    pin: Output<'static>,
    shown: led::Led,
}

impl Led {
    /// On its pin, dark.
    pub fn new(pin: Peri<'static, PC12>) -> Self {
        Self {
            pin: Output::new(pin, Level::High, Speed::Low),
            shown: led::Led::default(),
        }
    }

    /// A message that the board sends.
    pub fn see(&mut self, message: &Message) {
        self.shown.see(message);
    }

    /// Shows what is due at this time; to be called once a tick.
    pub fn step(&mut self, now: Micros) {
        let lit = self.shown.is_lit((now / 1000) as u32);
        self.pin
            .set_level(if lit { Level::Low } else { Level::High });
    }
}
