//! Background task: the log and the store.

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::watch;
use firmware_common::board;
use firmware_common::store::chip::Parameters;
use firmware_common::timing::Every;
use firmware_common::watchdog::Extension;

use super::tick::{BeamReport, Saving};

/// Receiver of the tick's reports.
pub type Reports = watch::Receiver<'static, CriticalSectionRawMutex, BeamReport, 1>;

/// Saves a calibration on request and logs every tenth report; the tick sends ten reports a second.
#[embassy_executor::task]
pub async fn run(
    mut reports: Reports,
    parameters: &'static mut Parameters,
    saving: &'static Saving,
    mut extension: Extension,
) -> ! {
    let mut second = Every::new(10);
    loop {
        let report = reports.changed().await;
        if let Some((calibration, off)) = saving.wanted.try_take() {
            parameters.settings.robot.beam.calibration = calibration;
            let saved = extension.during(|| parameters.save(off));
            defmt::info!("calibration saved: {}", saved);
            saving.done.signal(saved);
        }
        if !second.tick() {
            continue;
        }
        let health = report.health;
        defmt::info!(
            "tick jitter {} us, longest {} us, missed {}, conversions lost {}; synchronised {}, gauges {}, excitation {}, {} C",
            health.timing.jitter_us,
            health.timing.longest_us,
            health.missed,
            report.lost,
            health.in_step,
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
