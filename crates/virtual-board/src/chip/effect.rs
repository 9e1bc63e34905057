//! Effects of one part of the chip on the others.

use super::cause::Cause;
use super::pin::{Drive, Pin, Signal};

/// Source of a DMA request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the manual's names")]
pub enum Request {
    Adc1,
    Usart3Rx,
    Usart3Tx,
}

impl Request {
    /// Number of request sources.
    pub(crate) const COUNT: usize = Self::Usart3Tx as usize + 1;
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TimerId {
    Tim1,
    Tim2,
    Tim3,
    Tim4,
    Tim5,
}

/// Effects of one part of the chip on the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Effect {
    /// TRGO of a timer, which can start conversions, changed its level.
    Trigger {
        timer: TimerId,
        /// True for a rising edge.
        rises: bool,
    },
    /// A peripheral requests one DMA transfer.
    Dma(Request),
    /// A peripheral starts to use a signal, which must be routed to a pin.
    Uses(Signal),
    /// A peripheral changes how it drives its output.
    Output(Signal, Drive),
    /// The level of a pin changed.
    Level {
        pin: Pin,
        /// The new level.
        high: bool,
    },
    /// The chip changes how it drives a pin.
    Driven(Pin, Drive),
    /// The core clock changes to this frequency, Hz.
    Frequency(u64),
    /// The clock security system detected a failure of the crystal.
    ClockFailure,
    /// The voltage detector sets its output.
    VoltageDetector {
        /// True if the supply is low.
        low: bool,
    },
    /// The converter sampled this pin for the first time since the converter was switched on.
    Sampled(Pin),
    /// The program resets the peripheral that belongs to this bit of an enable register.
    ResetUnit {
        /// Offset of the enable register.
        register: u32,
        bit: u32,
    },
    /// The chip is reset.
    Reset(Cause),
}

/// Bus clocks as configured by the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clocks {
    /// Frequency of core, memories, DMA and GPIO, Hz.
    pub hclk_hz: u64,
    /// Core cycles in one cycle of APB1.
    pub apb1: u64,
    /// Core cycles in one cycle of APB2.
    pub apb2: u64,
    /// Core cycles in one clock cycle of a timer on APB1.
    pub timer1: u64,
    /// Core cycles in one clock cycle of a timer on APB2.
    pub timer2: u64,
}

impl Clocks {
    /// Clocks after a reset: the internal oscillator.
    pub const RESET: Self = Self {
        hclk_hz: 16_000_000,
        apb1: 1,
        apb2: 1,
        timer1: 1,
        timer2: 1,
    };
}
