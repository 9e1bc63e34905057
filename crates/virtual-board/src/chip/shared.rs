//! State that all peripherals of a chip share: present cycle, clocks, interrupt lines, schedule.

use super::chip_variation::ChipVariation;
use super::circuit::Circuit;
use super::effect::{Clocks, Effect};
use super::interrupt::Interrupt;
use super::map::Unit;
use super::pin::Pin;
use super::schedule::Schedule;
use crate::finding::{FindingKind, Findings};
use crate::time::{Cycles, Time, Timebase};
use std::collections::VecDeque;

/// A voltage that the converter samples at a given cycle.
#[derive(Clone, Copy, Debug)]
struct Sample {
    pin: Pin,
    at: Cycles,
    /// Voltage, V; `None` until sampled.
    volts: Option<f64>,
}

/// State that all peripherals share.
#[derive(Clone)]
pub(crate) struct Shared {
    /// Cycle of the present access or event.
    pub now: Cycles,
    /// Address of the instruction that makes the access; during an event, of the latest instruction with an access.
    pub pc: u32,
    pub clocks: Clocks,
    /// Conversion between cycles and time.
    pub base: Timebase,
    /// Levels of the interrupt lines.
    pub lines: u128,
    /// See [`crate::core::System::limit`].
    pub limit: Cycles,
    pub findings: Findings,
    circuit: Box<dyn Circuit>,
    sample: Option<Sample>,
    /// Properties that differ from chip to chip.
    pub variation: ChipVariation,
    /// Period of the crystal divided for the real-time clock; `None` while crystal or divider is off.
    pub divided_crystal: Option<Time>,
    /// Supply of the chip, V.
    pub volts: f64,
    /// True if the access ends in a bus error.
    pub bus_error: bool,
    /// Cycle until which the bus stalls the access.
    pub held_until: Cycles,
    /// Effects still to be delivered to other parts.
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

    pub fn time(&self) -> Time {
        self.base.time_of(self.now)
    }

    /// First cycle that begins at least `span` after the present time.
    #[cfg(test)]
    pub fn after(&self, span: Time) -> Cycles {
        self.base.cycle_of(self.time() + span)
    }

    /// Circuit around the chip. The circuit is called in the order of time: a pending sample due earlier is taken
    /// first.
    pub fn circuit(&mut self) -> &mut dyn Circuit {
        if self.sample.is_some_and(|sample| sample.at < self.now) {
            self.take_sample();
        }
        &mut *self.circuit
    }

    #[cfg(test)]
    pub fn replace_circuit(&mut self, circuit: Box<dyn Circuit>) {
        self.circuit = circuit;
    }

    /// Plans to sample a voltage at a later cycle. The sample is no event of the schedule: the next call of the circuit
    /// after that cycle takes the sample first.
    pub fn sample(&mut self, pin: Pin, at: Cycles) {
        self.sample = Some(Sample {
            pin,
            at,
            volts: None,
        });
    }

    pub fn cancel_sample(&mut self) {
        self.sample = None;
    }

    /// Voltage of the pending sample, whose cycle has come; `None` without one.
    pub fn take_sample(&mut self) -> Option<f64> {
        let sample = self.sample.as_mut()?;
        if sample.volts.is_none() {
            let at = self.base.time_of(sample.at);
            sample.volts = Some(self.circuit.voltage(sample.pin, at));
        }
        sample.volts
    }

    /// Takes the pending sample if it is due by `cycle`.
    pub fn take_sample_by(&mut self, cycle: Cycles) {
        if self.sample.is_some_and(|sample| sample.at <= cycle) {
            self.take_sample();
        }
    }

    /// Records a finding at the present instruction.
    #[cold]
    pub fn note(&mut self, kind: FindingKind, text: impl Into<String>) {
        let at = self.time();
        self.findings.note(kind, self.pc, at, text);
    }

    /// Records a finding for each feature that is switched on and not modelled; `features` are bits and names.
    pub fn note_not_modelled(&mut self, switched_on: u32, features: &[(u32, &str)]) {
        for &(bit, name) in features {
            if switched_on & bit != 0 {
                self.note(FindingKind::NotModelled, name);
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

    /// Sets the cycle of a unit's next event; `NEVER` removes it from the schedule.
    pub fn schedule(&mut self, unit: Unit, at: Cycles) {
        self.schedule.set(unit, at);
        self.limit = 0;
    }

    /// Cycle of a unit's next event.
    pub fn due(&self, unit: Unit) -> Cycles {
        self.schedule.due(unit)
    }

    /// Unit with the next event, and its cycle.
    pub fn next(&self) -> (Unit, Cycles) {
        self.schedule.next()
    }

    /// Queues an effect on other parts.
    pub fn effect(&mut self, effect: Effect) {
        self.effects.push_back(effect);
    }
}
