//! What has time: the log, the store, the watchdog.

use core_algos::params::Settings;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::watch;
use firmware_common::store::chip::Parameters;
use firmware_common::watchdog::Watchdog;
use firmware_common::{can, fault, stack};

use super::tick::{Report, Saving};

/// Where reports come from.
pub type Reports = watch::Receiver<'static, CriticalSectionRawMutex, Report, 1>;

/// Runs for ever. The watchdog is fed with each report of the tick, of which there are ten a second:
/// a tick that stops lets it reset the board.
pub async fn run(
    mut reports: Reports,
    mut parameters: Parameters,
    mut settings: Settings,
    saving: &'static Saving,
    mut watchdog: Watchdog,
) -> ! {
    let mut count = 0u8;
    loop {
        let report = reports.changed().await;
        watchdog.feed();
        if let Some((calibration, off)) = saving.wanted.try_take() {
            settings.robot.beam.calibration = calibration;
            watchdog.lengthen();
            let saved = parameters.save(&settings, off).await;
            watchdog.shorten();
            defmt::info!("calibration saved: {}", saved);
            saving.done.signal(saved);
        }
        count += 1;
        if count < 10 {
            continue;
        }
        count = 0;
        let (jitter, worst) = report.timing_us;
        defmt::info!(
            "tick jitter {} us, longest {} us, missed {}; in step {}, gauges {}, excitation {}, {} C",
            jitter,
            worst,
            report.missed,
            report.in_step,
            report.gauges,
            report.excitation,
            report.temperature_c
        );
        let (used, size) = stack::high_water();
        defmt::info!(
            "bus off {}, {}; stack {} of {} bytes; {}",
            can::is_off(),
            can::counters(),
            used,
            size,
            fault::counts()
        );
    }
}
