//! The calibration in the last two sectors of the flash (128 KiB each).
//!
//! Each save appends; a sector is erased only when both are full, after some thousand saves. Writing
//! holds the core for a millisecond and an erase for up to two seconds, so saves happen only while
//! the motors are off, and an erase is followed by a restart of the board: samples were lost.

use core_algos::beam::calibration;
use core_algos::beam::procedure::STORED_BYTES;
use embassy_embedded_hal::adapter::BlockingAsync;
use embassy_stm32::Peri;
use embassy_stm32::flash::{Bank1Region3, Blocking, Flash};
use embassy_stm32::peripherals::FLASH;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};

type Region = BlockingAsync<Bank1Region3<'static, Blocking>>;

/// Sectors 10 and 11, from the beginning of the region of large sectors, which is sector 5.
const RANGE: core::ops::Range<u32> = 5 * 128 * 1024..7 * 128 * 1024;
/// Key of the calibration.
const CALIBRATION: u8 = 1;

/// The store.
pub struct Store {
    map: MapStorage<u8, Region, Cache<Uncached, Uncached, Uncached, u8>>,
    buffer: [u8; 128],
}

impl Store {
    /// On the chip's flash.
    pub fn new(flash: Peri<'static, FLASH>) -> Self {
        let region = Flash::new_blocking(flash)
            .into_blocking_regions()
            .bank1_region3;
        Self {
            map: MapStorage::new(
                BlockingAsync::new(region),
                const { MapConfig::new(RANGE) },
                Cache::new_uncached(),
            ),
            buffer: [0; 128],
        }
    }

    /// `config` with the stored zeros and gains; `None` if nothing sound is stored.
    pub async fn load(&mut self, config: &calibration::Config) -> Option<calibration::Config> {
        let stored = self
            .map
            .fetch_item::<&[u8]>(&mut self.buffer, &CALIBRATION)
            .await;
        match stored {
            Ok(Some(bytes)) => config.with_bytes(bytes),
            _ => None,
        }
    }

    /// Stores the zeros and gains; whether that worked.
    pub async fn save(&mut self, config: &calibration::Config) -> bool {
        let bytes: [u8; STORED_BYTES] = config.to_bytes();
        let saved = self
            .map
            .store_item(&mut self.buffer, &CALIBRATION, &bytes.as_slice())
            .await;
        saved.is_ok() && self.load(config).await.as_ref() == Some(config)
    }
}
