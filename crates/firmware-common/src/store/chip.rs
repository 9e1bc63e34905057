//! Parameter store on the chip: sectors 1 to 3 of the flash, 16 KiB each, which `memory.x` keeps free.
//!
//! A write stops the core for 16 to 100 µs per word, an erase for up to half a second.

use super::Store;
use crate::accelerator;
use core_algos::params::{BoardKind, Contents, Disarmed, Settings, StoreReport};
use core_algos::topology::Role;
use defmt::{info, warn};
use embassy_embedded_hal::adapter::BlockingAsync;
use embassy_futures::block_on;
use embassy_stm32::Peri;
use embassy_stm32::flash::{Bank1Region1, Blocking, Error, Flash};
use embassy_stm32::peripherals::FLASH;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use sequential_storage::map::MapConfig;
use static_cell::StaticCell;

/// The region of the 16 KiB sectors.
pub struct Region(Sectors);

type Sectors = BlockingAsync<Bank1Region1<'static, Blocking>>;

impl ErrorType for Region {
    type Error = Error;
}

impl ReadNorFlash for Region {
    const READ_SIZE: usize = Sectors::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Error> {
        self.0.read(offset, bytes).await
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl NorFlash for Region {
    const WRITE_SIZE: usize = Sectors::WRITE_SIZE;
    const ERASE_SIZE: usize = Sectors::ERASE_SIZE;

    /// Empties the caches after the erase, even after a failed one: the caches may hold the former contents.
    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        let erased = self.0.erase(from, to).await;
        accelerator::flush();
        erased
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        self.0.write(offset, bytes).await
    }
}

/// Addresses of the store in the region; sector 0 holds the vectors.
const RANGE: core::ops::Range<u32> = 16 * 1024..64 * 1024;

fn open(flash: Peri<'static, FLASH>) -> Store<Region> {
    let region = Flash::new_blocking(flash)
        .into_blocking_regions()
        .bank1_region1;
    Store::of(
        Region(BlockingAsync::new(region)),
        const { MapConfig::new(RANGE) },
        RANGE,
    )
}

/// Parameters of the board and their store in flash.
pub struct Parameters {
    store: Store<Region>,
    kind: BoardKind,
    /// Settings that the nodes use.
    pub settings: Settings,
    /// State of the store at the start.
    pub report: StoreReport,
    /// Role of the board, by its kind and its stored place.
    pub role: Role,
}

impl Parameters {
    /// Loads the parameters and finds the role; call it once. Lost and invalid values are replaced by their defaults.
    /// All values are, the place too, if they make no valid node together. The report and the log show that. The core
    /// itself reads the flash, so the call does not wait.
    pub fn load(flash: Peri<'static, FLASH>, kind: BoardKind) -> &'static mut Self {
        let parameters = Self::unread(flash, kind);
        parameters.read();
        parameters.settle();
        log(&parameters.report);
        parameters
    }

    // `load` calls these steps in turn. They are not inlined, so that each step frees its stack for the next.

    #[inline(never)]
    fn unread(flash: Peri<'static, FLASH>, kind: BoardKind) -> &'static mut Self {
        static PARAMETERS: StaticCell<Parameters> = StaticCell::new();
        PARAMETERS.init_with(|| Self {
            store: open(flash),
            kind,
            settings: Settings::of(kind),
            report: StoreReport::default(),
            role: kind.unplaced(),
        })
    }

    #[inline(never)]
    fn read(&mut self) {
        block_on(self.store.load());
    }

    #[inline(never)]
    fn settle(&mut self) {
        let kind = self.kind;
        let contents = self.store.contents();
        let check = |settings: &Settings| settings.check_role(kind).map(|_| ());
        (self.settings, self.report) = contents.resolve(&Settings::of(kind), check);
        self.role = self.settings.role(kind).unwrap_or(kind.unplaced());
    }

    /// Saves the settings; true on success. The core itself writes the flash: only interrupts run meanwhile.
    pub fn save(&mut self, off: Disarmed) -> bool {
        let settings = self.settings;
        self.write(&settings, off).is_some()
    }

    /// Writes settings to the store; returns the number of values written, or `None` on an error.
    #[inline(never)]
    pub(crate) fn write(&mut self, settings: &Settings, off: Disarmed) -> Option<usize> {
        let saved = block_on(self.store.save(settings, &Settings::of(self.kind), off));
        saved
            .inspect_err(|error| warn!("parameters not saved: {}", defmt::Debug2Format(error)))
            .ok()
    }

    /// Contents of the store at the latest reading.
    pub(crate) fn contents(&self) -> &Contents {
        self.store.contents()
    }
}

fn log(report: &StoreReport) {
    info!("{} parameters from the store", report.stored());
    if let Some(error) = report.unusable {
        warn!(
            "parameters: {} = {}: all defaults are used",
            error.field, error.value
        );
    } else if let Some(parameter) = report.first() {
        warn!(
            "parameters: {} and in total {} have their default",
            parameter.name,
            report.defaults()
        );
    } else if report.unverified {
        warn!("parameters: the store is damaged or a save was interrupted: values may be lost");
    }
}
