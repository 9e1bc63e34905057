//! The tasks of a board report here, and the watchdog is fed only while all of them do.
//!
//! A task gets a [`CheckIn`] and reports with it each time round its loop. [`TaskWatchdog`] belongs to the
//! task that feeds; which task has been silent for too long is decided by
//! [`core_algos::safety::task_deadlines`].

use core::sync::atomic::{AtomicU32, Ordering};

use core_algos::safety::task_deadlines::TaskDeadlines;
use embassy_time::Instant;

use crate::watchdog::Watchdog;

/// A task's way to say that it goes on.
pub struct CheckIn(&'static AtomicU32);

impl CheckIn {
    /// The task has come round once more.
    pub fn report(&mut self) {
        // One writer, so no update is lost.
        let count = self.0.load(Ordering::Relaxed).wrapping_add(1);
        self.0.store(count, Ordering::Relaxed);
    }
}

/// All tasks of a board, and the watchdog that waits for them.
pub struct TaskWatchdog<const N: usize> {
    names: [&'static str; N],
    counts: &'static [AtomicU32; N],
    deadlines: TaskDeadlines<N>,
    watchdog: Watchdog,
}

impl<const N: usize> TaskWatchdog<N> {
    /// Tasks by name, each with the longest time between two reports, µs; a [`CheckIn`] for each, in order.
    /// The start is over: `watchdog` is shortened.
    pub fn start(
        counts: &'static [AtomicU32; N],
        tasks: [(&'static str, u64); N],
        mut watchdog: Watchdog,
    ) -> (Self, [CheckIn; N]) {
        watchdog.shorten();
        let task_watchdog = Self {
            names: tasks.map(|(name, _)| name),
            counts,
            deadlines: TaskDeadlines::new(
                tasks.map(|(_, within)| within),
                Instant::now().as_micros(),
            ),
            watchdog,
        };
        (task_watchdog, counts.each_ref().map(CheckIn))
    }

    /// Feeds the watchdog if every task has reported in time; logs the name of one that has not.
    pub fn check(&mut self) {
        let now = Instant::now().as_micros();
        let counts = self.counts.each_ref();
        let reports = counts.map(|count| count.load(Ordering::Relaxed));
        if self.deadlines.complete(now, reports) {
            return self.watchdog.feed();
        }
        let late = self.deadlines.late(now);
        let late = late.and_then(|task| self.names.get(task).copied());
        defmt::error!(
            "{} does not report: the watchdog is not fed",
            late.unwrap_or("unknown")
        );
    }

    /// The watchdog, for work that holds the whole core.
    pub fn watchdog(&mut self) -> &mut Watchdog {
        &mut self.watchdog
    }
}
