//! Paces the ticks of a run in real time.

use super::keyboard::Keyboard;
use core_algos::time::TICK;
use std::thread;
use std::time::{Duration, Instant};

/// Polling interval of the keys in a paused run.
const PAUSE_POLL_INTERVAL: Duration = Duration::from_millis(10);

/// Delays each tick until its real time.
#[derive(Clone, Debug)]
pub struct RealTimeLimiter {
    due: Instant,
    late: u32,
    worst: Duration,
    keyboard: Keyboard,
}

impl RealTimeLimiter {
    /// Limiter whose time begins now. The keys pause the run and change its speed.
    pub fn new(keyboard: Keyboard) -> Self {
        Self {
            due: Instant::now(),
            late: 0,
            worst: Duration::ZERO,
            keyboard,
        }
    }

    /// Waits for the time of the next tick.
    pub fn wait(&mut self) {
        while self.keyboard.holds() {
            thread::sleep(PAUSE_POLL_INTERVAL);
            self.due = Instant::now();
        }
        let tick = Duration::from_micros(TICK).div_f64(self.keyboard.pace().1);
        let now = Instant::now();
        match self.due.checked_duration_since(now) {
            Some(left) => thread::sleep(left),
            None => {
                let late = now - self.due;
                self.late += u32::from(late > tick);
                self.worst = self.worst.max(late);
            }
        }
        self.due += tick;
    }

    /// Keys that pause the run and change its speed.
    pub fn keyboard(&self) -> &Keyboard {
        &self.keyboard
    }

    /// Number of ticks that began more than one tick late.
    pub fn late(&self) -> u32 {
        self.late
    }

    /// Largest delay of a tick so far.
    pub fn worst(&self) -> Duration {
        self.worst
    }
}
