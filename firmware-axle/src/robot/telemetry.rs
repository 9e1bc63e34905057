//! The log: health once a second, faults at once.

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::watch;
use firmware_common::board;
use firmware_common::clock::CORE_HZ;
use firmware_common::timing::Every;

use super::tick::AxleReport;

/// Receiver of the tick's reports.
pub type Reports = watch::Receiver<'static, CriticalSectionRawMutex, AxleReport, 1>;

/// Logs new faults at once and every tenth report; the tick sends ten reports a second.
#[embassy_executor::task]
pub async fn run(mut reports: Reports) -> ! {
    let mut known = None;
    let mut second = Every::new(10);
    loop {
        let report = reports.changed().await;
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
        let health = report.health;
        defmt::info!(
            "tick jitter {} us, longest {} us, current loop {} us, missed {}, restarts {}; synchronised {}, inertial {}",
            health.timing.jitter_us,
            health.timing.longest_us,
            feedback.longest_cycles.div_ceil(CORE_HZ / 1_000_000),
            health.missed,
            report.restarts,
            health.in_step,
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
