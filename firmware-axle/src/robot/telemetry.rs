//! The log: health once a second, faults at once; feeds the watchdog while every task reports.

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::watch;
use firmware_common::clock::CORE_HZ;
use firmware_common::timing::Every;
use firmware_common::{board, can, task_watchdog};

use super::tick::Report;

/// Source of the reports.
pub type Reports = watch::Receiver<'static, CriticalSectionRawMutex, Report, 1>;

/// Tasks that must report for the watchdog to be fed, and how often, µs. The log itself feeds it: were
/// it starved, nobody would.
pub const TASKS: [(&str, u64); 3] = [
    ("current loop", 10_000),
    ("tick", 10_000),
    ("bus", can::REPORTS_WITHIN),
];

/// Who reports.
pub type TaskWatchdog = task_watchdog::TaskWatchdog<{ TASKS.len() }>;

/// Logs for ever. The watchdog is looked after with each report of the tick, of which there are ten a
/// second.
#[embassy_executor::task]
pub async fn run(mut reports: Reports, mut task_watchdog: TaskWatchdog) -> ! {
    let mut known = None;
    let mut second = Every::new(10);
    loop {
        let report = reports.changed().await;
        task_watchdog.check();
        let feedback = report.feedback;
        if feedback.fault != known {
            known = feedback.fault;
            if let Some(condition) = known {
                let entry = condition.entry();
                defmt::error!(
                    "motors off: {:#04x} {}: {}; {}",
                    entry.code,
                    entry.name,
                    entry.meaning,
                    entry.remedy
                );
            }
        }
        if !second.tick() {
            continue;
        }
        let (jitter, worst) = report.timing_us;
        defmt::info!(
            "tick jitter {} us, longest {} us, current loop {} us, missed {}, restarts {}; in step {}, inertial {}",
            jitter,
            worst,
            feedback.longest_cycles.div_ceil(CORE_HZ / 1_000_000),
            report.missed,
            report.restarts,
            report.in_step,
            report.inertial
        );
        defmt::info!(
            "motors on {}, ready {}, {} A, windings {} C, drivers {} C, supply {} V",
            feedback.on,
            feedback.ready,
            feedback.current_a,
            report.winding_c,
            feedback.temperature_c,
            feedback.supply_v
        );
        board::log();
    }
}
