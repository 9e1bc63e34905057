//! Lateness and duration of the ticks.
//!
//! Lateness is measured with the clock of `embassy-time`, duration with the cycle counter (DWT). The counter runs in
//! sleep only while DBG_SLEEP is set in DBGMCU_CR, by the HAL at the start or by a probe. The measurements do not
//! depend on that bit, because a tick does not sleep.

use core_algos::time::Micros;

use crate::clock::CORE_HZ;

const CYCLES_PER_US: u32 = CORE_HZ / 1_000_000;

/// Largest jitter and longest tick, µs, at most 4095 each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// Largest deviation of the time between two starts from the period, µs.
    pub jitter_us: u16,
    /// Longest duration of a tick, µs.
    pub longest_us: u16,
}

/// Measures jitter and duration of a periodic job.
pub struct Stopwatch {
    period: Micros,
    /// Time of the latest start, µs.
    last: Option<Micros>,
    /// Cycle counter at the latest start.
    began: u32,
    /// Largest deviation of the time between two starts from the period, µs.
    jitter: Micros,
    /// Longest duration of the job, core cycles.
    longest: u32,
}

impl Stopwatch {
    /// Creates a stopwatch for a job that starts every `period`, µs.
    pub fn new(period: Micros) -> Self {
        Self {
            period,
            last: None,
            began: 0,
            jitter: 0,
            longest: 0,
        }
    }

    /// Marks the start of the job.
    pub fn begin(&mut self, now: Micros, cycles: u32) {
        self.began = cycles;
        if let Some(last) = self.last.replace(now) {
            let deviation = now.wrapping_sub(last).abs_diff(self.period);
            self.jitter = self.jitter.max(deviation);
        }
    }

    /// Marks the end of the job.
    pub fn end(&mut self, cycles: u32) {
        let took = cycles.wrapping_sub(self.began);
        self.longest = self.longest.max(took);
    }

    /// Largest jitter and longest duration since the last call.
    pub fn take(&mut self) -> Timing {
        const MAX_US: u16 = 4095;
        let longest = self.longest.div_ceil(CYCLES_PER_US);
        let timing = Timing {
            jitter_us: self.jitter.min(MAX_US.into()) as u16,
            longest_us: longest.min(MAX_US.into()) as u16,
        };
        (self.jitter, self.longest) = (0, 0);
        timing
    }
}

/// Divider of ticks. It counts ticks instead of comparing times: the local time of a tick may jitter around a
/// period's boundary.
pub struct Every {
    ticks: u8,
    since: u8,
}

impl Every {
    /// A divider that is due with every `ticks`-th tick.
    pub const fn new(ticks: u8) -> Self {
        Self { ticks, since: 0 }
    }

    /// Counts a tick; true if due.
    pub fn tick(&mut self) -> bool {
        self.since += 1;
        let due = self.since >= self.ticks;
        if due {
            self.since = 0;
        }
        due
    }
}
