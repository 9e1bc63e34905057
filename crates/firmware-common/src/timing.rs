//! Lateness and duration of the ticks.
//!
//! Lateness is by the clock of `embassy-time`, duration by the cycle counter (DWT). The counter runs while the core
//! sleeps only as long as DBG_SLEEP is set in DBGMCU_CR: the HAL sets that bit at the start, and so does a probe. No
//! measurement here depends on it, since a tick does not sleep.

use core_algos::time::Micros;

use crate::clock::CORE_HZ;

const CYCLES_PER_US: u32 = CORE_HZ / 1_000_000;

/// Largest jitter and longest tick, µs, at most 4095 each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// Largest deviation of an interval between two beginnings from the period.
    pub jitter_us: u16,
    /// Longest tick.
    pub longest_us: u16,
}

/// Measures a periodic piece of work.
pub struct Stopwatch {
    period: Micros,
    /// Time of its latest start.
    last: Option<Micros>,
    /// The cycle counter at its latest start.
    began: u32,
    /// Largest deviation of an interval between beginnings from the period, µs.
    jitter: Micros,
    /// Longest piece of work, cycles.
    longest: u32,
}

impl Stopwatch {
    /// For work that begins every `period`, µs.
    pub fn new(period: Micros) -> Self {
        Self {
            period,
            last: None,
            began: 0,
            jitter: 0,
            longest: 0,
        }
    }

    /// The work begins.
    pub fn begin(&mut self, now: Micros, cycles: u32) {
        self.began = cycles;
        if let Some(last) = self.last.replace(now) {
            let deviation = now.wrapping_sub(last).abs_diff(self.period);
            self.jitter = self.jitter.max(deviation);
        }
    }

    /// The work is done.
    pub fn end(&mut self, cycles: u32) {
        let took = cycles.wrapping_sub(self.began);
        self.longest = self.longest.max(took);
    }

    /// Largest jitter and longest work since the last call.
    pub fn take(&mut self) -> Timing {
        const MOST: u16 = 4095;
        let longest = self.longest.div_ceil(CYCLES_PER_US);
        let timing = Timing {
            jitter_us: self.jitter.min(MOST.into()) as u16,
            longest_us: longest.min(MOST.into()) as u16,
        };
        (self.jitter, self.longest) = (0, 0);
        timing
    }
}

/// Comes due once in so many ticks. Ticks are counted, for their local time may stay at the edge of a
/// period and be on either side of it.
pub struct Every {
    ticks: u8,
    since: u8,
}

impl Every {
    /// Due with every `ticks`-th tick.
    pub const fn new(ticks: u8) -> Self {
        Self { ticks, since: 0 }
    }

    /// One more tick; whether it is due.
    pub fn tick(&mut self) -> bool {
        self.since += 1;
        let due = self.since >= self.ticks;
        if due {
            self.since = 0;
        }
        due
    }
}
