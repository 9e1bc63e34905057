//! The tasks of a board report here, and the independent watchdog is fed only while all of them do.
//!
//! A task gets a [`CheckIn`] and reports with it each time round its loop. [`TaskWatchdog::run`] is a task of its own
//! that does nothing else; which task has been silent for too long is decided by
//! [`core_algos::safety::task_deadlines`].
//!
//! The task runs in the thread, the lowest level: what holds up any level holds up this task too, so a level that is
//! starved needs no report of its own. No other task of the thread feeds: the log may wait for ever or be left out.

use core::sync::atomic::{AtomicU32, Ordering};

use core_algos::safety::task_deadlines::TaskDeadlines;
use embassy_time::{Duration, Instant, Timer};

use crate::watchdog::Feeder;

/// Time between two checks: well below the shortest time of the watchdog, 0.34 s.
const CHECK_EVERY: Duration = Duration::from_millis(100);

/// A task's way to report that it goes on.
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
    feeder: Feeder,
}

impl<const N: usize> TaskWatchdog<N> {
    /// Tasks by name, each with the longest time between two reports, µs; a [`CheckIn`] for each, in order.
    pub fn new(
        counts: &'static [AtomicU32; N],
        tasks: [(&'static str, u64); N],
        feeder: Feeder,
    ) -> (Self, [CheckIn; N]) {
        let task_watchdog = Self {
            names: tasks.map(|(name, _)| name),
            counts,
            deadlines: TaskDeadlines::new(
                tasks.map(|(_, within)| within),
                Instant::now().as_micros(),
            ),
            feeder,
        };
        (task_watchdog, counts.each_ref().map(CheckIn))
    }

    /// Checks for ever.
    pub async fn run(mut self) -> ! {
        loop {
            Timer::after(CHECK_EVERY).await;
            self.check();
        }
    }

    /// Feeds the watchdog if every task has reported in time; logs the name of one that has not.
    fn check(&mut self) {
        let now = Instant::now().as_micros();
        let counts = self.counts.each_ref();
        let reports = counts.map(|count| count.load(Ordering::Relaxed));
        if self.deadlines.complete(now, reports) {
            return self.feeder.feed();
        }
        let late = self.deadlines.late(now);
        let late = late.and_then(|task| self.names.get(task).copied());
        defmt::error!(
            "{} does not report: the watchdog is not fed",
            late.unwrap_or("unknown")
        );
    }
}
