//! Delay of samples, and random walk of biases and offsets.

use super::SAMPLE_PERIOD_S;
use crate::world::random::normal;
use rand_pcg::Pcg64;

/// Longest allowed delay from the instant of sampling to the board, ms.
pub const MAX_DELAY_MS: u32 = 31;

/// Number of samples between two steps of a random walk: drift is slow against a tick.
const DRIFT_INTERVAL_SAMPLES: u32 = 100;
const RING: usize = MAX_DELAY_MS as usize + 1;

/// Delays samples by a fixed number of milliseconds.
#[derive(Clone, Debug)]
pub struct Delay<T> {
    ring: [T; RING],
    next: usize,
    delay: usize,
    filled: bool,
}

impl<T: Copy + Default> Delay<T> {
    /// Delay line of `delay_ms`, at most [`MAX_DELAY_MS`].
    pub fn new(delay_ms: u32) -> Self {
        Self {
            ring: [T::default(); RING],
            next: 0,
            delay: delay_ms.min(MAX_DELAY_MS) as usize,
            filled: false,
        }
    }

    /// Stores the newest sample and returns the delayed sample. Before time zero the first sample applies.
    pub fn pass(&mut self, sample: T) -> T {
        if !self.filled {
            self.ring = [sample; RING];
            self.filled = true;
        }
        self.ring[self.next] = sample;
        let due = self.ring[(self.next + RING - self.delay) % RING];
        self.next = (self.next + 1) % RING;
        due
    }
}

/// Value that changes by a random walk.
#[derive(Clone, Debug)]
pub struct Drift {
    value: f64,
    step_sigma: f64,
    countdown: u32,
}

impl Drift {
    /// Random walk of `walk` units/√s from `start`.
    pub fn new(start: f64, walk: f64) -> Self {
        Self {
            value: start,
            step_sigma: walk * (f64::from(DRIFT_INTERVAL_SAMPLES) * SAMPLE_PERIOD_S).sqrt(),
            countdown: DRIFT_INTERVAL_SAMPLES,
        }
    }

    /// Adds `by` to the value.
    pub fn shift(&mut self, by: f64) {
        self.value += by;
    }

    /// Value at the next sample.
    pub fn next(&mut self, random: &mut Pcg64) -> f64 {
        let value = self.value;
        self.countdown -= 1;
        if self.countdown == 0 {
            self.countdown = DRIFT_INTERVAL_SAMPLES;
            self.value += normal(random, self.step_sigma);
        }
        value
    }
}
