//! Effects of one part of the chip on the others.

use super::cause::Cause;
use super::pin::{Drive, Pin, Signal};

/// Events inside the chip that start conversions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the manual's names")]
pub enum Trigger {
    Tim1Trgo,
    Tim1Cc1,
    Tim1Cc2,
    Tim1Cc3,
    Tim1Cc4,
    Tim2Trgo,
    Tim2Cc1,
    Tim2Cc2,
    Tim2Cc3,
    Tim2Cc4,
    Tim3Trgo,
    Tim3Cc1,
    Tim3Cc2,
    Tim3Cc4,
    Tim4Trgo,
    Tim4Cc1,
    Tim4Cc2,
    Tim4Cc3,
    Tim4Cc4,
    Tim5Trgo,
    Tim5Cc1,
    Tim5Cc2,
    Tim5Cc3,
    Tim5Cc4,
}

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

/// Effects of one part of the chip on the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Effect {
    /// A trigger rises or falls.
    Trigger(Trigger, bool),
    /// One transfer is wanted.
    Dma(Request),
    /// A peripheral begins to use a signal, which must be on a pin.
    Uses(Signal),
    /// A peripheral drives its output in another way.
    Output(Signal, Drive),
    /// A pin has another level now.
    Level(Pin, bool),
    /// The chip drives a pin in another way now.
    Driven(Pin, Drive),
    /// The core's clock runs at another frequency from now on, Hz.
    Frequency(u64),
    /// The crystal failed and the clock security system saw it.
    ClockFailure,
    /// The voltage detector says whether the supply is low.
    VoltageDetector(bool),
    /// The converter has sampled a pin for the first time since it was switched on.
    Sampled(Pin),
    /// The program resets a peripheral by the bit of this enable register that belongs to it.
    ResetUnit(u32, u32),
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
