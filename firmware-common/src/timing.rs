//! How late ticks come and how long they take, in core cycles (DWT).

use cortex_m::peripheral::{DCB, DWT};

use crate::board::CORE_HZ;

const CYCLES_PER_US: u32 = CORE_HZ / 1_000_000;

/// Measures a periodic piece of work.
pub struct Stopwatch {
    period: u32,
    last: Option<u32>,
    began: u32,
    /// Largest deviation of an interval between beginnings from the period, cycles.
    jitter: u32,
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
            period: period_us * CYCLES_PER_US,
            last: None,
            began: 0,
            jitter: 0,
            worst: 0,
        }
    }

    /// The work begins.
    pub fn begin(&mut self) {
        self.began = DWT::cycle_count();
        if let Some(last) = self.last.replace(self.began) {
            let deviation = self.began.wrapping_sub(last).abs_diff(self.period);
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
        let micros = |cycles: u32| cycles.div_ceil(CYCLES_PER_US).min(4095) as u16;
        let taken = (micros(self.jitter), micros(self.worst));
        (self.jitter, self.worst) = (0, 0);
        taken
    }
}
