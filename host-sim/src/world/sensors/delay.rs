//! Age of samples, and constants that walk.

use super::SAMPLE_PERIOD_S;
use crate::world::random::normal;
use rand_pcg::Pcg64;

/// Longest delay from the instant of sampling to the board, ms.
pub const MAX_DELAY_MS: u32 = 31;

/// Slow drifts move once in this many samples: they are smooth on the scale of a tick.
const DRIFT_INTERVAL: u32 = 100;
const RING: usize = MAX_DELAY_MS as usize + 1;

/// The last few samples of one kind, so that the board may get one that is some ms old.
#[derive(Clone, Debug)]
pub struct Delay<T> {
    ring: [T; RING],
    next: usize,
    delay: usize,
    filled: bool,
}

impl<T: Copy + Default> Delay<T> {
    /// A delay of so many ms, at most [`MAX_DELAY_MS`].
    pub fn new(delay_ms: u32) -> Self {
        Self {
            ring: [T::default(); RING],
            next: 0,
            delay: delay_ms.min(MAX_DELAY_MS) as usize,
            filled: false,
        }
    }

    /// Takes the newest sample, gives the one that is due; before time zero the first one holds.
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

/// A constant plus a random walk.
#[derive(Clone, Debug)]
pub struct Drift {
    value: f64,
    step_sigma: f64,
    countdown: u32,
}

impl Drift {
    /// A walk of `walk` units/√s from `start`.
    pub fn new(start: f64, walk: f64) -> Self {
        Self {
            value: start,
            step_sigma: walk * (f64::from(DRIFT_INTERVAL) * SAMPLE_PERIOD_S).sqrt(),
            countdown: DRIFT_INTERVAL,
        }
    }

    /// The value of this sample.
    pub fn next(&mut self, random: &mut Pcg64) -> f64 {
        let value = self.value;
        self.countdown -= 1;
        if self.countdown == 0 {
            self.countdown = DRIFT_INTERVAL;
            self.value += normal(random, self.step_sigma);
        }
        value
    }
}
