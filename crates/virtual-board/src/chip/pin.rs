//! Pins, who drives them, and what peripherals put on them.

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

    /// Number within the port.
    pub const fn number(self) -> u32 {
        (self.0 % 16) as u32
    }

    /// All pins at their index.
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

/// How one side drives a pin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Drive {
    /// Not at all.
    #[default]
    Open,
    /// Through a resistor to ground.
    PullDown,
    /// Through a resistor to the supply.
    PullUp,
    /// To ground.
    Low,
    /// To the supply.
    High,
}

impl Drive {
    /// Strongly to a level.
    pub const fn to(level: bool) -> Self {
        if level { Self::High } else { Self::Low }
    }

    /// Whether it is more than a resistor.
    pub const fn is_strong(self) -> bool {
        matches!(self, Self::Low | Self::High)
    }
}

/// What a peripheral has on a pin.
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
    /// Number of variants.
    pub(crate) const COUNT: usize = Self::Usart3Tx as usize + 1;

    /// The timer that hears a pin with this signal: 0 for TIM1.
    pub(crate) fn timer(self) -> Option<usize> {
        match self {
            Self::Tim1Ch1 | Self::Tim1Ch2 | Self::Tim1Ch3 | Self::Tim1Ch4 => Some(0),
            Self::Tim1Bkin => Some(0),
            Self::Tim2Ch1 | Self::Tim2Ch2 | Self::Tim2Ch3 | Self::Tim2Ch4 => Some(1),
            Self::Tim3Ch1 | Self::Tim3Ch2 | Self::Tim3Ch3 | Self::Tim3Ch4 => Some(2),
            Self::Tim4Ch1 | Self::Tim4Ch2 | Self::Tim4Ch3 | Self::Tim4Ch4 => Some(3),
            Self::Tim5Ch1 | Self::Tim5Ch2 | Self::Tim5Ch3 | Self::Tim5Ch4 => Some(4),
            _ => None,
        }
    }
}

/// Alternate functions of the STM32F405 (its data sheet's table 9), as far as they are modelled.
pub(crate) const ALTERNATE: &[(Pin, u32, Signal)] = &[
    (Pin::new('A', 8), 1, Signal::Tim1Ch1),
    (Pin::new('E', 9), 1, Signal::Tim1Ch1),
    (Pin::new('A', 9), 1, Signal::Tim1Ch2),
    (Pin::new('E', 11), 1, Signal::Tim1Ch2),
    (Pin::new('A', 10), 1, Signal::Tim1Ch3),
    (Pin::new('E', 13), 1, Signal::Tim1Ch3),
    (Pin::new('A', 11), 1, Signal::Tim1Ch4),
    (Pin::new('E', 14), 1, Signal::Tim1Ch4),
    (Pin::new('A', 7), 1, Signal::Tim1Ch1N),
    (Pin::new('B', 13), 1, Signal::Tim1Ch1N),
    (Pin::new('E', 8), 1, Signal::Tim1Ch1N),
    (Pin::new('B', 0), 1, Signal::Tim1Ch2N),
    (Pin::new('B', 14), 1, Signal::Tim1Ch2N),
    (Pin::new('E', 10), 1, Signal::Tim1Ch2N),
    (Pin::new('B', 1), 1, Signal::Tim1Ch3N),
    (Pin::new('B', 15), 1, Signal::Tim1Ch3N),
    (Pin::new('E', 12), 1, Signal::Tim1Ch3N),
    (Pin::new('A', 6), 1, Signal::Tim1Bkin),
    (Pin::new('B', 12), 1, Signal::Tim1Bkin),
    (Pin::new('E', 15), 1, Signal::Tim1Bkin),
    (Pin::new('A', 0), 1, Signal::Tim2Ch1),
    (Pin::new('A', 5), 1, Signal::Tim2Ch1),
    (Pin::new('A', 15), 1, Signal::Tim2Ch1),
    (Pin::new('A', 1), 1, Signal::Tim2Ch2),
    (Pin::new('B', 3), 1, Signal::Tim2Ch2),
    (Pin::new('A', 2), 1, Signal::Tim2Ch3),
    (Pin::new('B', 10), 1, Signal::Tim2Ch3),
    (Pin::new('A', 3), 1, Signal::Tim2Ch4),
    (Pin::new('B', 11), 1, Signal::Tim2Ch4),
    (Pin::new('A', 6), 2, Signal::Tim3Ch1),
    (Pin::new('B', 4), 2, Signal::Tim3Ch1),
    (Pin::new('C', 6), 2, Signal::Tim3Ch1),
    (Pin::new('A', 7), 2, Signal::Tim3Ch2),
    (Pin::new('B', 5), 2, Signal::Tim3Ch2),
    (Pin::new('C', 7), 2, Signal::Tim3Ch2),
    (Pin::new('B', 0), 2, Signal::Tim3Ch3),
    (Pin::new('C', 8), 2, Signal::Tim3Ch3),
    (Pin::new('B', 1), 2, Signal::Tim3Ch4),
    (Pin::new('C', 9), 2, Signal::Tim3Ch4),
    (Pin::new('B', 6), 2, Signal::Tim4Ch1),
    (Pin::new('D', 12), 2, Signal::Tim4Ch1),
    (Pin::new('B', 7), 2, Signal::Tim4Ch2),
    (Pin::new('D', 13), 2, Signal::Tim4Ch2),
    (Pin::new('B', 8), 2, Signal::Tim4Ch3),
    (Pin::new('D', 14), 2, Signal::Tim4Ch3),
    (Pin::new('B', 9), 2, Signal::Tim4Ch4),
    (Pin::new('D', 15), 2, Signal::Tim4Ch4),
    (Pin::new('A', 0), 2, Signal::Tim5Ch1),
    (Pin::new('H', 10), 2, Signal::Tim5Ch1),
    (Pin::new('A', 1), 2, Signal::Tim5Ch2),
    (Pin::new('H', 11), 2, Signal::Tim5Ch2),
    (Pin::new('A', 2), 2, Signal::Tim5Ch3),
    (Pin::new('H', 12), 2, Signal::Tim5Ch3),
    (Pin::new('A', 3), 2, Signal::Tim5Ch4),
    (Pin::new('I', 0), 2, Signal::Tim5Ch4),
    (Pin::new('A', 5), 5, Signal::Spi1Sck),
    (Pin::new('A', 6), 5, Signal::Spi1Miso),
    (Pin::new('A', 7), 5, Signal::Spi1Mosi),
    (Pin::new('B', 3), 5, Signal::Spi1Sck),
    (Pin::new('B', 4), 5, Signal::Spi1Miso),
    (Pin::new('B', 5), 5, Signal::Spi1Mosi),
    (Pin::new('A', 11), 9, Signal::Can1Rx),
    (Pin::new('A', 12), 9, Signal::Can1Tx),
    (Pin::new('B', 8), 9, Signal::Can1Rx),
    (Pin::new('B', 9), 9, Signal::Can1Tx),
    (Pin::new('B', 10), 7, Signal::Usart3Tx),
    (Pin::new('B', 11), 7, Signal::Usart3Rx),
    (Pin::new('C', 10), 7, Signal::Usart3Tx),
    (Pin::new('C', 11), 7, Signal::Usart3Rx),
];
