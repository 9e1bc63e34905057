//! Tasks that the independent watchdog waits for.

use firmware_common::{can, task_watchdog};

/// Tasks that must report for the watchdog to be fed, and the longest time between two reports, µs.
pub const TASKS: [(&str, u64); 3] = [
    ("current loop", 10_000),
    ("tick", 10_000),
    ("bus", can::REPORTS_WITHIN),
];

/// Watchdog of these tasks.
pub type TaskWatchdog = task_watchdog::TaskWatchdog<{ TASKS.len() }>;

/// Checks the tasks for ever.
#[embassy_executor::task]
pub async fn run(task_watchdog: TaskWatchdog) -> ! {
    task_watchdog.run().await
}
