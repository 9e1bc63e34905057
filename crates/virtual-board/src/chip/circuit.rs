//! What is soldered around the chip, as the chip meets it.

use super::net::Net;
use super::pin::{Drive, Pin};
use crate::time::Time;
use std::any::Any;

/// Everything around one chip: sensors, drivers, switches, supply.
///
/// The chip calls it at exact times; between two calls nothing of it may change what the chip sees,
/// but by [`Self::advance`] at the time that [`Self::next`] announced.
pub trait Circuit: Any + Copied + Send {
    /// The chip drives this pin in another way now.
    fn pin(&mut self, pin: Pin, drive: Drive, at: Time) {
        let _ = (pin, drive, at);
    }

    /// Nets of the bare board that carries the chip. A program or circuit that uses one otherwise is a finding.
    fn nets(&self) -> &'static [Net] {
        &[]
    }

    /// Voltage at an analogue input at the instant at which the converter's sampling ends, V: half the
    /// supply where nothing is soldered to the input.
    fn voltage(&mut self, pin: Pin, at: Time) -> f64 {
        let _ = (pin, at);
        1.65
    }

    /// Exchanges a word over SPI1 that ends at `at`; the answer is all ones where nothing is selected.
    fn spi(&mut self, word: u16, bits: u32, at: Time) -> u16 {
        let _ = (word, at);
        ((1u32 << bits) - 1) as u16
    }

    /// A byte was sent by USART3; its stop bit ends at `at`.
    fn serial(&mut self, byte: u8, at: Time) {
        let _ = (byte, at);
    }

    /// When something changes by itself next.
    fn next(&self) -> Time {
        Time::NEVER
    }

    /// Does what is due at `at`.
    fn advance(&mut self, at: Time, inputs: &mut Inputs) {
        let _ = (at, inputs);
    }

    /// Supply of the chip (VDD and VDDA), V. Below 1.7 V it is off.
    fn supply(&mut self, at: Time) -> f64 {
        let _ = at;
        3.3
    }
}

/// A copy of a circuit of unknown type; every type that is [`Clone`] has it.
pub trait Copied {
    /// The copy.
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

/// Nothing is soldered to the chip; analogue inputs are at half the supply.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bare;

impl Circuit for Bare {}

/// What changes at the chip's inputs.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    /// Pins and how they are driven from outside now.
    pub pins: Vec<(Pin, Drive)>,
    /// Bytes whose stop bit ends now at USART3.
    pub serial: Vec<u8>,
    /// Whether the crystal works, when that changes.
    pub crystal: Option<bool>,
    /// Whether the supply has changed.
    pub supply: bool,
}
