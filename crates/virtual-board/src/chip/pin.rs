//! Pins, their drivers, and the peripheral signals routed to them.

use std::fmt;

/// A pin of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pin(u8);

/// Ports of the chip, A to I.
pub const PORTS: usize = 9;

impl Pin {
    /// Pin `number` (0 to 15) of the port with this letter (A to I).
    pub const fn new(port: char, number: u8) -> Self {
        let port = port as u8 - b'A';
        assert!((port as usize) < PORTS && number < 16);
        Self(port * 16 + number)
    }

    /// Number of the port: 0 for A.
    pub const fn port(self) -> usize {
        (self.0 / 16) as usize
    }

    /// Number of the pin within its port, 0 to 15.
    pub const fn number(self) -> u32 {
        (self.0 % 16) as u32
    }

    /// Index of the pin among the pins of all ports.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// The pin with this index.
    pub(crate) const fn at(index: u8) -> Self {
        Self(index)
    }

    pub(crate) const fn of(port: usize, number: u32) -> Self {
        Self((port as u8) * 16 + number as u8)
    }
}

impl fmt::Display for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "P{}{}", char::from(b'A' + self.0 / 16), self.0 % 16)
    }
}

/// Drive of a pin from one side, chip or circuit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Drive {
    /// No drive.
    #[default]
    Open,
    /// Resistor to ground.
    PullDown,
    /// Resistor to the supply.
    PullUp,
    /// Output at ground.
    Low,
    /// Output at the supply.
    High,
}

impl Drive {
    /// Output drive to a level.
    pub const fn to(level: bool) -> Self {
        if level { Self::High } else { Self::Low }
    }

    /// True if an output drives, not a resistor.
    pub const fn is_strong(self) -> bool {
        matches!(self, Self::Low | Self::High)
    }
}

/// Peripheral signal that can be routed to a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs, reason = "the manual's names")]
pub enum Signal {
    Tim1Ch1,
    Tim1Ch2,
    Tim1Ch3,
    Tim1Ch4,
    Tim1Ch1N,
    Tim1Ch2N,
    Tim1Ch3N,
    Tim1Bkin,
    Tim2Ch1,
    Tim2Ch2,
    Tim2Ch3,
    Tim2Ch4,
    Tim3Ch1,
    Tim3Ch2,
    Tim3Ch3,
    Tim3Ch4,
    Tim4Ch1,
    Tim4Ch2,
    Tim4Ch3,
    Tim4Ch4,
    Tim5Ch1,
    Tim5Ch2,
    Tim5Ch3,
    Tim5Ch4,
    Spi1Sck,
    Spi1Miso,
    Spi1Mosi,
    Can1Rx,
    Can1Tx,
    Usart3Rx,
    Usart3Tx,
}

impl Signal {
    /// Number of signals.
    pub(crate) const COUNT: usize = Self::Usart3Tx as usize + 1;

    /// Channels of TIM1 to TIM5.
    pub(crate) const CHANNELS: [[Self; 4]; 5] = {
        use Signal::*;
        [
            [Tim1Ch1, Tim1Ch2, Tim1Ch3, Tim1Ch4],
            [Tim2Ch1, Tim2Ch2, Tim2Ch3, Tim2Ch4],
            [Tim3Ch1, Tim3Ch2, Tim3Ch3, Tim3Ch4],
            [Tim4Ch1, Tim4Ch2, Tim4Ch3, Tim4Ch4],
            [Tim5Ch1, Tim5Ch2, Tim5Ch3, Tim5Ch4],
        ]
    };

    /// Timer whose input or channel this signal is, 0 for TIM1; `None` for a signal of another peripheral.
    pub(crate) fn timer(self) -> Option<usize> {
        let of = |channels: &[Self; 4]| channels.contains(&self);
        match self {
            Self::Tim1Bkin => Some(0),
            _ => Self::CHANNELS.iter().position(of),
        }
    }
}

/// Pins of a port.
const fn port(letter: char) -> [Pin; 16] {
    let mut pins = [Pin::new(letter, 0); 16];
    let mut number = 0;
    while number < 16 {
        pins[number] = Pin::new(letter, number as u8);
        number += 1;
    }
    pins
}

const A: [Pin; 16] = port('A');
const B: [Pin; 16] = port('B');
const C: [Pin; 16] = port('C');
const D: [Pin; 16] = port('D');
const E: [Pin; 16] = port('E');
const H: [Pin; 16] = port('H');
const I: [Pin; 16] = port('I');

/// Modelled alternate functions of the STM32F405 (data sheet, table 9): signal, function number, pins.
pub(crate) const ALTERNATE: &[(Signal, u32, &[Pin])] = {
    use Signal::*;
    &[
        (Tim1Ch1, 1, &[A[8], E[9]]),
        (Tim1Ch2, 1, &[A[9], E[11]]),
        (Tim1Ch3, 1, &[A[10], E[13]]),
        (Tim1Ch4, 1, &[A[11], E[14]]),
        (Tim1Ch1N, 1, &[A[7], B[13], E[8]]),
        (Tim1Ch2N, 1, &[B[0], B[14], E[10]]),
        (Tim1Ch3N, 1, &[B[1], B[15], E[12]]),
        (Tim1Bkin, 1, &[A[6], B[12], E[15]]),
        (Tim2Ch1, 1, &[A[0], A[5], A[15]]),
        (Tim2Ch2, 1, &[A[1], B[3]]),
        (Tim2Ch3, 1, &[A[2], B[10]]),
        (Tim2Ch4, 1, &[A[3], B[11]]),
        (Tim3Ch1, 2, &[A[6], B[4], C[6]]),
        (Tim3Ch2, 2, &[A[7], B[5], C[7]]),
        (Tim3Ch3, 2, &[B[0], C[8]]),
        (Tim3Ch4, 2, &[B[1], C[9]]),
        (Tim4Ch1, 2, &[B[6], D[12]]),
        (Tim4Ch2, 2, &[B[7], D[13]]),
        (Tim4Ch3, 2, &[B[8], D[14]]),
        (Tim4Ch4, 2, &[B[9], D[15]]),
        (Tim5Ch1, 2, &[A[0], H[10]]),
        (Tim5Ch2, 2, &[A[1], H[11]]),
        (Tim5Ch3, 2, &[A[2], H[12]]),
        (Tim5Ch4, 2, &[A[3], I[0]]),
        (Spi1Sck, 5, &[A[5], B[3]]),
        (Spi1Miso, 5, &[A[6], B[4]]),
        (Spi1Mosi, 5, &[A[7], B[5]]),
        (Can1Rx, 9, &[A[11], B[8]]),
        (Can1Tx, 9, &[A[12], B[9]]),
        (Usart3Rx, 7, &[B[11], C[11]]),
        (Usart3Tx, 7, &[B[10], C[10]]),
    ]
};
