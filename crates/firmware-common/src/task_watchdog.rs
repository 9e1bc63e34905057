//! Software watchdog of the tasks: the independent watchdog is fed only while every task reports.
//!
//! Each task reports with its [`CheckIn`] once per turn of its loop. [`TaskWatchdog::run`] is a separate task that
//! only checks. [`core_algos::safety::task_deadlines`] decides which task has exceeded its deadline.
//!
//! The checking task runs in the thread, the lowest priority. A blocked priority level also blocks the checking task,
//! so a starved level needs no report. No other task of the thread feeds the watchdog: the log may block for ever or
//! be left out.

use core::sync::atomic::{AtomicU32, Ordering};

use core_algos::safety::task_deadlines::TaskDeadlines;
use embassy_time::{Duration, Instant, Timer};

use crate::watchdog::Feeder;

/// Time between two checks, well below the shortest watchdog timeout of 0.34 s.
const CHECK_EVERY: Duration = Duration::from_millis(100);

/// A task's handle to report that it runs.
pub struct CheckIn(&'static AtomicU32);

impl CheckIn {
    /// Reports one turn of the task's loop.
    pub fn report(&mut self) {
        // Load and store may be separate steps: the counter has one writer, so no update is lost.
        let count = self.0.load(Ordering::Relaxed).wrapping_add(1);
        self.0.store(count, Ordering::Relaxed);
    }
}

/// Tasks of a board and the watchdog that they keep fed.
pub struct TaskWatchdog<const N: usize> {
    names: [&'static str; N],
    counts: &'static [AtomicU32; N],
    deadlines: TaskDeadlines<N>,
    feeder: Feeder,
}

impl<const N: usize> TaskWatchdog<N> {
    /// Watches tasks, each given by its name and the longest time between two reports, µs. Returns a [`CheckIn`] for
    /// each task, in order.
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

    /// Checks every 0.1 s, for ever, that all tasks report.
    pub async fn run(mut self) -> ! {
        loop {
            Timer::after(CHECK_EVERY).await;
            self.check();
        }
    }

    /// Feeds the watchdog if every task has reported in time; otherwise logs the name of a late task.
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
