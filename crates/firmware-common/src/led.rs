//! LED of the board, PC12, lit when low.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::peripherals::PC12;

/// LED of the board.
pub struct Led(Output<'static>);

impl Led {
    /// Takes the pin of the LED and switches the LED off.
    pub fn new(pin: Peri<'static, PC12>) -> Self {
        Self(Output::new(pin, Level::High, Speed::Low))
    }

    /// Switches the LED on or off.
    pub fn set(&mut self, lit: bool) {
        self.0.set_level(if lit { Level::Low } else { Level::High });
    }
}
