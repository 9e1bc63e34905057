//! Ticks in step with the clock.

use core_algos::time::TICK;
use std::thread;
use std::time::{Duration, Instant};

/// Lets no tick begin before its time.
#[derive(Clone, Debug)]
pub struct RealTimeLimiter {
    start: Instant,
    ticks: u32,
    late: u32,
    worst: Duration,
}

impl RealTimeLimiter {
    /// Time begins now.
    pub fn new() -> Self {
        Self {
            start: Instant::now(),
            ticks: 0,
            late: 0,
            worst: Duration::ZERO,
        }
    }

    /// Waits for the time of the next tick.
    pub fn wait(&mut self) {
        let tick = Duration::from_micros(TICK);
        let due = tick * self.ticks;
        self.ticks += 1;
        let passed = self.start.elapsed();
        match due.checked_sub(passed) {
            Some(left) => thread::sleep(left),
            None => {
                let late = passed - due;
                self.late += u32::from(late > tick);
                self.worst = self.worst.max(late);
            }
        }
    }

    /// Ticks that began more than a tick late.
    pub fn late(&self) -> u32 {
        self.late
    }

    /// The most a tick was late.
    pub fn worst(&self) -> Duration {
        self.worst
    }
}

impl Default for RealTimeLimiter {
    fn default() -> Self {
        Self::new()
    }
}
