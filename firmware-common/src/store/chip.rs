//! The store on the chip: sectors 1 to 3 of the flash, 16 KiB each, which `memory.x` keeps free.
//!
//! A write holds the core for tens of microseconds a word, an erase for up to half a second.

use super::Store;
use core_algos::node::board::Role;
use core_algos::params::{Report, Settings};
use defmt::{info, warn};
use embassy_embedded_hal::adapter::BlockingAsync;
use embassy_stm32::Peri;
use embassy_stm32::flash::{Bank1Region1, Blocking, Flash};
use embassy_stm32::peripherals::FLASH;
use sequential_storage::map::MapConfig;

/// The region of the 16 KiB sectors.
pub type Region = BlockingAsync<Bank1Region1<'static, Blocking>>;

/// Within the region; sector 0 holds the vectors.
const RANGE: core::ops::Range<u32> = 16 * 1024..64 * 1024;

/// The store.
pub fn open(flash: Peri<'static, FLASH>) -> Store<Region> {
    let region = Flash::new_blocking(flash)
        .into_blocking_regions()
        .bank1_region1;
    Store::of(
        BlockingAsync::new(region),
        const { MapConfig::new(RANGE) },
        RANGE,
    )
}

/// The board's parameters.
pub struct Parameters {
    store: Store<Region>,
    /// The board's settings when nothing is stored.
    pub base: Settings,
    /// How the store was found at the start.
    pub report: Report,
}

impl Parameters {
    /// Loads them: the settings to run with, and where later ones can be saved. Values that are lost
    /// or cannot be used have their defaults; the report and the log say so.
    pub async fn load(flash: Peri<'static, FLASH>, base: Settings, role: Role) -> (Settings, Self) {
        let mut store = open(flash);
        let contents = store.load().await;
        let (settings, report) = contents.settle(&base, |settings| settings.check(role));
        log(&report);
        let parameters = Self {
            store,
            base,
            report,
        };
        (settings, parameters)
    }

    /// Saves `settings`; whether that worked.
    pub async fn save(&mut self, settings: &Settings, off: core_algos::params::Disarmed) -> bool {
        match self.store.save(settings, &self.base, off).await {
            Ok(_) => true,
            Err(error) => {
                warn!("parameters not saved: {}", defmt::Debug2Format(&error));
                false
            }
        }
    }
}

fn log(report: &Report) {
    info!("{} parameters from the store", report.stored());
    if let Some(error) = report.unusable {
        warn!(
            "parameters: {} = {}: all defaults are used",
            error.field, error.value
        );
    } else if let Some(parameter) = report.first() {
        warn!(
            "parameters: {} and {} in all have their default",
            parameter.name,
            report.defaults()
        );
    } else if report.unverified {
        warn!("parameters: whether any was lost is not known");
    }
}
