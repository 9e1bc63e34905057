//! The circuit around the chip, as seen from its pins.

use super::net::Net;
use super::pin::{Drive, Pin};
use crate::time::Time;
use std::any::Any;

/// Everything around one chip: sensors, drivers, switches, supply.
///
/// The chip calls the circuit at exact times. Between two calls the circuit's outputs stay constant, except at the time
/// announced by [`Self::next`], when [`Self::advance`] is called.
pub trait Circuit: Any + Copied + Send {
    /// The chip changes how it drives this pin.
    fn pin(&mut self, pin: Pin, drive: Drive, at: Time) {
        let _ = (pin, drive, at);
    }

    /// Nets of the bare board that carries the chip. Any other use of a net by the program or the circuit is a finding.
    fn nets(&self) -> &'static [Net] {
        &[]
    }

    /// Voltage at an analogue input at the end of the converter's sampling time, V. Default: 1.65, half of a 3.3 V
    /// supply.
    fn voltage(&mut self, pin: Pin, at: Time) -> f64 {
        let _ = (pin, at);
        1.65
    }

    /// Exchanges a word over SPI1 that ends at `at`; the answer is all ones if no device is selected.
    fn spi(&mut self, word: u16, bits: u32, at: Time) -> u16 {
        let _ = (word, at);
        ((1u32 << bits) - 1) as u16
    }

    /// USART3 has sent a byte, whose stop bit ends at `at`.
    fn serial(&mut self, byte: u8, at: Time) {
        let _ = (byte, at);
    }

    /// Time of the circuit's next event; [`Time::NEVER`] if none is due.
    fn next(&self) -> Time {
        Time::NEVER
    }

    /// Handles the event due at `at`.
    fn advance(&mut self, at: Time, inputs: &mut Inputs) {
        let _ = (at, inputs);
    }

    /// Supply of the chip (VDD and VDDA), V. Below 1.7 V the chip is off.
    fn supply(&mut self, at: Time) -> f64 {
        let _ = at;
        3.3
    }
}

/// Clone of a circuit of unknown type; implemented for every circuit that is [`Clone`].
pub trait Copied {
    /// Clones the circuit with its state.
    fn copied(&self) -> Box<dyn Circuit>;
}

impl<T: Circuit + Clone> Copied for T {
    fn copied(&self) -> Box<dyn Circuit> {
        Box::new(self.clone())
    }
}

impl Clone for Box<dyn Circuit> {
    fn clone(&self) -> Self {
        (**self).copied()
    }
}

/// A chip with nothing connected; analogue inputs are at half the supply.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bare;

impl Circuit for Bare {}

/// Changes at the chip's inputs that the circuit makes at one time.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    /// Pins, each with its new external drive.
    pub pins: Vec<(Pin, Drive)>,
    /// Bytes received by USART3 whose stop bit ends now.
    pub serial: Vec<u8>,
    /// True if the crystal works; `None` if unchanged.
    pub crystal: Option<bool>,
    /// True if the supply has changed.
    pub supply: bool,
}
