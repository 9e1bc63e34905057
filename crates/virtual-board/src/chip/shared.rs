//! What all peripherals of a chip share: the moment, the clocks, interrupt lines, the schedule.

use super::interrupt::Interrupt;
use super::part::Part;
use super::pin::{Drive, Pin, Signal};
use super::schedule::Schedule;
use super::surroundings::Surroundings;
use crate::finding::{Findings, Kind};
use crate::time::{Cycles, Time, Timebase};
use std::collections::VecDeque;

/// Who can have something due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub(crate) enum Source {
    /// What is around the chip.
    Surroundings,
    /// Oscillators, PLL.
    Rcc,
    /// End of an operation of the flash.
    Flash,
    /// Independent watchdog.
    Watchdog,
    Tim1,
    Tim2,
    Tim3,
    Tim4,
    Tim5,
    Adc,
    Dma1,
    Dma2,
    Spi1,
    Can1,
    Usart3,
}

impl Source {
    /// How many there are.
    pub const COUNT: usize = Self::Usart3 as usize + 1;

    /// All of them, at their index.
    pub const ALL: [Self; Self::COUNT] = [
        Self::Surroundings,
        Self::Rcc,
        Self::Flash,
        Self::Watchdog,
        Self::Tim1,
        Self::Tim2,
        Self::Tim3,
        Self::Tim4,
        Self::Tim5,
        Self::Adc,
        Self::Dma1,
        Self::Dma2,
        Self::Spi1,
        Self::Can1,
        Self::Usart3,
    ];
}

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
    Exti11,
    Exti15,
}

/// Who asks a DMA controller for a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the manual's names")]
pub enum Request {
    Adc1,
    Spi1Rx,
    Spi1Tx,
    Usart3Rx,
    Usart3Tx,
}

impl Request {
    /// How many there are.
    pub(crate) const COUNT: usize = Self::Usart3Tx as usize + 1;
}

/// What one part of the chip tells the others.
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
    Reset(super::rcc::Cause),
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

/// A voltage that the converter takes at an instant.
#[derive(Clone, Copy, Debug)]
struct Sample {
    pin: Pin,
    at: Cycles,
    /// Once it was taken.
    volts: Option<f64>,
}

/// What all peripherals share.
pub(crate) struct Shared {
    /// The moment of the access or event.
    pub now: Cycles,
    /// The instruction that makes the access; of an event, the latest.
    pub pc: u32,
    /// Clocks in force.
    pub clocks: Clocks,
    /// How cycles lie in time.
    pub base: Timebase,
    /// Levels of the interrupt lines.
    pub lines: u128,
    /// See [`crate::core::System::limit`].
    pub limit: Cycles,
    /// What was found.
    pub findings: Findings,
    surroundings: Box<dyn Surroundings>,
    sample: Option<Sample>,
    /// What differs from one chip to the next.
    pub part: Part,
    /// Supply of the chip, V.
    pub volts: f64,
    /// The access ends in a bus error.
    pub bus_error: bool,
    /// The bus holds the access until this cycle.
    pub held_until: Cycles,
    /// What other parts must be told.
    pub effects: VecDeque<Effect>,
    schedule: Schedule,
}

impl Shared {
    pub fn new(surroundings: Box<dyn Surroundings>, fast_ppb: i64) -> Self {
        Self {
            now: 0,
            pc: 0,
            clocks: Clocks::RESET,
            base: Timebase::new(Clocks::RESET.hclk_hz, fast_ppb),
            lines: 0,
            limit: 0,
            findings: Findings::default(),
            surroundings,
            sample: None,
            part: Part::default(),
            volts: 3.3,
            bus_error: false,
            held_until: 0,
            effects: VecDeque::new(),
            schedule: Schedule::new(),
        }
    }

    /// The time now.
    pub fn time(&self) -> Time {
        self.base.time_of(self.now)
    }

    /// The first cycle that begins so long from now.
    #[cfg(test)]
    pub fn after(&self, span: Time) -> Cycles {
        self.base.cycle_of(self.time() + span)
    }

    /// What is around the chip, which is called in the order of time: a voltage that was to be taken
    /// before now is taken first.
    pub fn world(&mut self) -> &mut dyn Surroundings {
        if self.sample.is_some_and(|sample| sample.at < self.now) {
            self.take_sample();
        }
        &mut *self.surroundings
    }

    #[cfg(test)]
    pub fn replace_world(&mut self, surroundings: Box<dyn Surroundings>) {
        self.surroundings = surroundings;
    }

    /// A voltage is to be taken at an instant to come: not by an event of its own, but before the
    /// surroundings hear of anything later.
    pub fn sample(&mut self, pin: Pin, at: Cycles) {
        self.sample = Some(Sample {
            pin,
            at,
            volts: None,
        });
    }

    /// No voltage is to be taken.
    pub fn cancel_sample(&mut self) {
        self.sample = None;
    }

    /// The voltage that was to be taken, whose instant has come.
    pub fn take_sample(&mut self) -> Option<f64> {
        let sample = self.sample.as_mut()?;
        if sample.volts.is_none() {
            let at = self.base.time_of(sample.at);
            sample.volts = Some(self.surroundings.voltage(sample.pin, at));
        }
        sample.volts
    }

    /// Takes the voltage that was to be taken by a cycle.
    pub fn take_sample_by(&mut self, cycle: Cycles) {
        if self.sample.is_some_and(|sample| sample.at <= cycle) {
            self.take_sample();
        }
    }

    /// Notes what the program does wrong, at the present instruction.
    #[cold]
    pub fn note(&mut self, kind: Kind, text: impl Into<String>) {
        let at = self.time();
        self.findings.note(kind, self.pc, at, text);
    }

    /// Sets the level of an interrupt line.
    pub fn line(&mut self, interrupt: Interrupt, level: bool) {
        let bit = 1 << interrupt as u32;
        let lines = if level {
            self.lines | bit
        } else {
            self.lines & !bit
        };
        if lines != self.lines {
            self.lines = lines;
            self.limit = 0;
        }
    }

    /// Has a source called at this cycle; [`NEVER`] takes it off the schedule.
    pub fn schedule(&mut self, source: Source, at: Cycles) {
        self.schedule.set(source, at);
        self.limit = 0;
    }

    /// When a source is due.
    pub fn due(&self, source: Source) -> Cycles {
        self.schedule.due(source)
    }

    /// The next that is due, and when.
    pub fn next(&self) -> (Source, Cycles) {
        self.schedule.next()
    }

    /// Tells the other parts.
    pub fn effect(&mut self, effect: Effect) {
        self.effects.push_back(effect);
    }
}
