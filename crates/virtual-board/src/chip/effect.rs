//! Effects of one part of the chip on the others.

use super::cause::Cause;
use super::pin::{Drive, Pin, Signal};

/// Who asks a DMA controller for a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the manual's names")]
pub enum Request {
    Adc1,
    Usart3Rx,
    Usart3Tx,
}

impl Request {
    /// Number of variants.
    pub(crate) const COUNT: usize = Self::Usart3Tx as usize + 1;
}

/// Timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Tim1,
    Tim2,
    Tim3,
    Tim4,
    Tim5,
}

/// Effects of one part of the chip on the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Effect {
    /// TRGO of a timer, which can start conversions, rises or falls.
    Trigger {
        /// The timer.
        timer: Kind,
        /// True if it rises.
        rises: bool,
    },
    /// One transfer is wanted.
    Dma(Request),
    /// A peripheral begins to use a signal, which must be on a pin.
    Uses(Signal),
    /// A peripheral drives its output in another way.
    Output(Signal, Drive),
    /// A pin has another level now.
    Level {
        /// The pin.
        pin: Pin,
        /// True if it is high.
        high: bool,
    },
    /// The chip drives a pin in another way now.
    Driven(Pin, Drive),
    /// The core's clock runs at another frequency from now on, Hz.
    Frequency(u64),
    /// The crystal failed and the clock security system saw it.
    ClockFailure,
    /// The voltage detector says whether the supply is low.
    VoltageDetector {
        /// True if the supply is low.
        low: bool,
    },
    /// The converter has sampled a pin for the first time since it was switched on.
    Sampled(Pin),
    /// The program resets a peripheral by the bit of this enable register that belongs to it.
    ResetUnit {
        /// Offset of the enable register.
        register: u32,
        /// The bit.
        bit: u32,
    },
    /// The chip is reset.
    Reset(Cause),
}

/// Frequencies of the buses' clocks as the program set them up, Hz.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clocks {
    /// Core, memories, DMA, GPIO.
    pub hclk_hz: u64,
    /// Cycles of the core in one of APB1.
    pub apb1: u64,
    /// Cycles of the core in one of APB2.
    pub apb2: u64,
    /// Cycles of the core in one of a timer's on APB1.
    pub timer1: u64,
    /// Cycles of the core in one of a timer's on APB2.
    pub timer2: u64,
}

impl Clocks {
    /// As after a reset: the internal oscillator.
    pub const RESET: Self = Self {
        hclk_hz: 16_000_000,
        apb1: 1,
        apb2: 1,
        timer1: 1,
        timer2: 1,
    };
}
