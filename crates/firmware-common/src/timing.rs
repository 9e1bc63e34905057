//! Lateness and duration of the ticks.
//!
//! Lateness is by the clock of `embassy-time`, duration by the cycle counter (DWT). The counter runs while the core
//! sleeps only as long as DBG_SLEEP is set in DBGMCU_CR: the HAL sets that bit at the start, and so does a probe. No
//! measurement here depends on it, since a tick does not sleep.

use cortex_m::peripheral::{DCB, DWT};
use embassy_time::Instant;

use crate::clock::CORE_HZ;

const CYCLES_PER_US: u32 = CORE_HZ / 1_000_000;

/// Measures a periodic piece of work.
pub struct Stopwatch {
    /// µs.
    period: u32,
    /// Time of its latest start, µs.
    last: Option<u64>,
    began: u32,
    /// Largest deviation of an interval between beginnings from the period, µs.
    jitter: u64,
    /// Longest piece of work, cycles.
    worst: u32,
}

impl Stopwatch {
    /// For work that begins every `period_us`; starts the cycle counter.
    pub fn new(period_us: u32) -> Self {
        // SAFETY: only the cycle counter is touched, and switching it on twice does no harm.
        let mut core = unsafe { cortex_m::Peripherals::steal() };
        DCB::enable_trace(&mut core.DCB);
        core.DWT.enable_cycle_counter();
        Self {
            period: period_us,
            last: None,
            began: 0,
            jitter: 0,
            worst: 0,
        }
    }

    /// The work begins.
    pub fn begin(&mut self) {
        self.began = DWT::cycle_count();
        let now = Instant::now().as_micros();
        if let Some(last) = self.last.replace(now) {
            let deviation = now.wrapping_sub(last).abs_diff(self.period.into());
            self.jitter = self.jitter.max(deviation);
        }
    }

    /// The work is done.
    pub fn end(&mut self) {
        let took = DWT::cycle_count().wrapping_sub(self.began);
        self.worst = self.worst.max(took);
    }

    /// Largest jitter and longest work since the last call, µs, at most 4095 each.
    pub fn take(&mut self) -> (u16, u16) {
        const MOST: u16 = 4095;
        let worst = self.worst.div_ceil(CYCLES_PER_US);
        let taken = (
            self.jitter.min(MOST.into()) as u16,
            worst.min(MOST.into()) as u16,
        );
        (self.jitter, self.worst) = (0, 0);
        taken
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
