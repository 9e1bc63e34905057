//! What all peripherals of a chip share: the moment, the clocks, interrupt lines, the schedule.

use super::chip_variation::ChipVariation;
use super::circuit::Circuit;
use super::effect::{Clocks, Effect};
use super::interrupt::Interrupt;
use super::map::Unit;
use super::pin::Pin;
use super::schedule::Schedule;
use crate::finding::{Findings, Kind};
use crate::time::{Cycles, Time, Timebase};
use std::collections::VecDeque;

/// A voltage that the converter takes at an instant.
#[derive(Clone, Copy, Debug)]
struct Sample {
    pin: Pin,
    at: Cycles,
    /// Once it was taken.
    volts: Option<f64>,
}

/// What all peripherals share.
#[derive(Clone)]
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
    circuit: Box<dyn Circuit>,
    sample: Option<Sample>,
    /// What differs from one chip to the next.
    pub variation: ChipVariation,
    /// Period of the crystal divided for the real-time clock, while both are on.
    pub divided_crystal: Option<Time>,
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
    pub fn new(circuit: Box<dyn Circuit>, fast_ppb: i64) -> Self {
        Self {
            now: 0,
            pc: 0,
            clocks: Clocks::RESET,
            base: Timebase::new(Clocks::RESET.hclk_hz, fast_ppb),
            lines: 0,
            limit: 0,
            findings: Findings::default(),
            circuit,
            sample: None,
            variation: ChipVariation::default(),
            divided_crystal: None,
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

    /// Circuit around the chip, which is called in the order of time: a voltage that was to be taken
    /// before now is taken first.
    pub fn world(&mut self) -> &mut dyn Circuit {
        if self.sample.is_some_and(|sample| sample.at < self.now) {
            self.take_sample();
        }
        &mut *self.circuit
    }

    #[cfg(test)]
    pub fn replace_world(&mut self, circuit: Box<dyn Circuit>) {
        self.circuit = circuit;
    }

    /// A voltage is to be taken at an instant to come: not by an event of its own, but before the
    /// circuit hear of anything later.
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
            sample.volts = Some(self.circuit.voltage(sample.pin, at));
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

    /// Notes features without a model that the program switches on: bits and names.
    pub fn note_not_modelled(&mut self, switched_on: u32, features: &[(u32, &str)]) {
        for &(bit, name) in features {
            if switched_on & bit != 0 {
                self.note(Kind::NotModelled, name);
            }
        }
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

    /// Has a peripheral called at this cycle; [`NEVER`] takes it off the schedule.
    pub fn schedule(&mut self, unit: Unit, at: Cycles) {
        self.schedule.set(unit, at);
        self.limit = 0;
    }

    /// Cycle at which a peripheral is due.
    pub fn due(&self, unit: Unit) -> Cycles {
        self.schedule.due(unit)
    }

    /// The next that is due, and when.
    pub fn next(&self) -> (Unit, Cycles) {
        self.schedule.next()
    }

    /// Tells the other parts.
    pub fn effect(&mut self, effect: Effect) {
        self.effects.push_back(effect);
    }
}
