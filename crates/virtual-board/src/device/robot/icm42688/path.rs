//! The signal path of gyroscope or accelerometer: from the true value to counts.

use super::super::filter::{LowPass, Memory};
use crate::device::{later, span_s};
use crate::noise::Noise;
use crate::time::Time;

/// Lowest rate of the filter steps, Hz. At a lower output data rate, a sample is the result of several steps.
const MIN_RATE_HZ: f64 = 8000.0;

/// True values of three axes, with slopes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Truth {
    pub at: Time,
    pub value: [f64; 3],
    pub slope: [f64; 3],
}

/// Sensor errors of three axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Errors {
    /// White noise density, unit of the quantity per √Hz.
    pub density: f64,
    pub bias: [f64; 3],
    pub scale: [f64; 3],
}

/// Settings of a signal path, decoded from the registers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Settings {
    pub rate_hz: f64,
    /// Value of one count, in the unit of the quantity.
    pub unit: f64,
    pub anti_alias_hz: f64,
    pub corner_hz: f64,
    pub order: u32,
}

/// Adaptive full-scale range: the output stalls while the sensor changes its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Adaptive {
    /// Value at which the range changes, in the unit of the quantity.
    pub threshold: f64,
    /// Time for which the output stalls.
    pub stall: Time,
}

/// Fraction of the threshold below which the range changes back (assumed).
const HYSTERESIS: f64 = 0.9;

#[derive(Clone, Debug)]
pub(super) struct Path {
    adaptive: Option<Adaptive>,
    /// True if the wider range is active.
    wide: bool,
    stalled_until: Time,
    pub truth: Truth,
    errors: Errors,
    noise: Noise,
    clock_error: f64,
    settings: Settings,
    /// Time of the first sample; `None` while the path is off.
    first: Option<Time>,
    /// Filter steps since the first sample, and filter steps per sample.
    steps: u64,
    steps_per_sample: u64,
    period_ps: f64,
    sigma: f64,
    filters: [LowPass; 2],
    memory: [[Memory; 2]; 3],
}

impl Path {
    pub fn new(errors: Errors, settings: Settings, clock_error: f64, seed: u64) -> Self {
        let mut path = Self {
            adaptive: None,
            wide: false,
            stalled_until: Time(0),
            truth: Truth::default(),
            errors,
            noise: Noise::new(seed),
            clock_error,
            settings,
            first: None,
            steps: 0,
            steps_per_sample: 1,
            period_ps: 0.0,
            sigma: 0.0,
            filters: Default::default(),
            memory: Default::default(),
        };
        path.set_up();
        path
    }

    fn set_up(&mut self) {
        let Settings {
            rate_hz,
            anti_alias_hz,
            corner_hz,
            order,
            ..
        } = self.settings;
        self.steps_per_sample = (MIN_RATE_HZ / rate_hz).ceil().max(1.0) as u64;
        let step_hz = rate_hz * self.steps_per_sample as f64;
        self.period_ps = 1e12 / (step_hz * (1.0 + self.clock_error));
        self.sigma = self.errors.density * (step_hz / 2.0).sqrt();
        self.filters = [
            LowPass::new(2, anti_alias_hz, step_hz),
            LowPass::new(order, corner_hz, step_hz),
        ];
        for (axis, memory) in self.memory.iter_mut().enumerate() {
            *memory = self
                .filters
                .each_ref()
                .map(|f| f.settled(self.truth.value[axis]));
        }
    }

    /// Applies new settings; a running path continues with the new settings.
    pub fn set(&mut self, settings: Settings, at: Time) {
        if settings == self.settings {
            return;
        }
        let same_path = Settings {
            unit: self.settings.unit,
            ..settings
        } == self.settings;
        self.settings = settings;
        if !same_path {
            self.set_up();
            if self.first.is_some_and(|first| first <= at) {
                let period = self.period_ps * self.steps_per_sample as f64;
                self.first = Some(later(at, period * 1e-12));
            }
            self.steps = 0;
        }
    }

    /// Switches the adaptive range on or off.
    pub fn adapt(&mut self, adaptive: Option<Adaptive>) {
        self.adaptive = adaptive;
    }

    /// True if the output is stalled at a sample; updates the range.
    fn is_stalled(&mut self, sample: [f64; 3], at: Time) -> bool {
        let Some(Adaptive { threshold, stall }) = self.adaptive else {
            return false;
        };
        let largest = sample
            .iter()
            .fold(0.0, |largest: f64, x| largest.max(x.abs()));
        let bound = threshold * if self.wide { HYSTERESIS } else { 1.0 };
        if (largest > bound) != self.wide {
            self.wide = !self.wide;
            self.stalled_until = at + stall;
        }
        at < self.stalled_until
    }

    /// Switches the path on, with the time of the first sample, or off.
    pub fn switch(&mut self, first: Option<Time>) {
        self.first = first;
        self.steps = 0;
        self.set_up();
    }

    pub fn is_on(&self) -> bool {
        self.first.is_some()
    }

    fn time_of(&self, step: u64) -> Time {
        match self.first {
            Some(first) => first + Time((step as f64 * self.period_ps) as u64),
            None => Time::NEVER,
        }
    }

    /// Advances to a time; returns the latest new sample, `None` without a new sample.
    pub fn advance(&mut self, to: Time) -> Option<[i16; 3]> {
        let mut latest = None;
        loop {
            let at = self.time_of(self.steps);
            if at > to || at == Time::NEVER {
                return latest;
            }
            let sample = self.step(at);
            let is_due = self.steps.is_multiple_of(self.steps_per_sample);
            if is_due && !self.is_stalled(sample, at) {
                latest = Some(sample.map(|x| self.quantised(x)));
            }
            self.steps += 1;
        }
    }

    fn step(&mut self, at: Time) -> [f64; 3] {
        let span = span_s(self.truth.at, at);
        let mut sample = [0.0; 3];
        for (axis, out) in sample.iter_mut().enumerate() {
            let truth = self.truth.value[axis] + span * self.truth.slope[axis];
            let Errors { bias, scale, .. } = self.errors;
            let mut x = truth * (1.0 + scale[axis]) + bias[axis] + self.sigma * self.noise.normal();
            for (filter, memory) in self.filters.iter().zip(&mut self.memory[axis]) {
                x = filter.step(memory, x);
            }
            *out = x;
        }
        sample
    }

    /// Value in counts; −32768 is reserved for no sample.
    fn quantised(&self, value: f64) -> i16 {
        (value / self.settings.unit)
            .round()
            .clamp(-32_766.0, 32_767.0) as i16
    }
}
