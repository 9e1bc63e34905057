//! What has time: the log, the store, the watchdog.

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::watch;
use firmware_common::store::chip::Parameters;
use firmware_common::timing::Every;
use firmware_common::{board, can, task_watchdog};

use super::tick::{Report, Saving};

/// Source of the reports.
pub type Reports = watch::Receiver<'static, CriticalSectionRawMutex, Report, 1>;

/// Tasks that must report for the watchdog to be fed, and how often, µs. The background itself feeds
/// it: were it starved, nobody would.
pub const TASKS: [(&str, u64); 2] = [("tick", 10_000), ("bus", can::REPORTS_WITHIN)];

/// Who reports.
pub type TaskWatchdog = task_watchdog::TaskWatchdog<{ TASKS.len() }>;

/// Runs for ever. The watchdog is looked after with each report of the tick, of which there are ten a
/// second.
#[embassy_executor::task]
pub async fn run(
    mut reports: Reports,
    parameters: &'static mut Parameters,
    saving: &'static Saving,
    mut task_watchdog: TaskWatchdog,
) -> ! {
    let mut second = Every::new(10);
    loop {
        let report = reports.changed().await;
        task_watchdog.check();
        if let Some((calibration, off)) = saving.wanted.try_take() {
            parameters.settings.robot.beam.calibration = calibration;
            task_watchdog.watchdog().lengthen();
            let saved = parameters.save(off);
            task_watchdog.watchdog().shorten();
            defmt::info!("calibration saved: {}", saved);
            saving.done.signal(saved);
        }
        if !second.tick() {
            continue;
        }
        let (jitter, worst) = report.timing_us;
        defmt::info!(
            "tick jitter {} us, longest {} us, missed {}, conversions lost {}; in step {}, gauges {}, excitation {}, {} C",
            jitter,
            worst,
            report.missed,
            report.lost,
            report.in_step,
            report.gauges,
            report.excitation,
            report.temperature_c
        );
        if let Some(noise) = report.noise {
            defmt::info!("noise of the bridges at rest over 10 s: {} counts", noise);
        }
        board::log();
    }
}
