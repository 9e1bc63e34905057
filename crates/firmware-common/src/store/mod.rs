//! Parameters in flash, as items that `sequential-storage` appends to dedicated sectors.
//!
//! Loading never writes, whatever the sectors hold. A save writes only changed values, then the manifest, and reads
//! everything back. The next save repairs the effects of a power cut: a sector is erased only if the newest copy of
//! every value is in another sector. If the store is unreadable or two attempts to save fail, the whole store is erased
//! and written again.
//!
//! Reading does not use the marks at the ends of a sector, by which the library finds the sector in use. Each sector
//! is read as if in use, and of several copies of a value the newest counts.

#[cfg(target_os = "none")]
pub mod chip;
#[cfg(not(target_os = "none"))]
pub mod simulated;
mod view;

#[cfg(test)]
mod tests;

use core::ops::Range;
use core_algos::params::stored::{Contents, MANIFEST_BYTES, MANIFEST_KEY};
use core_algos::params::{Disarmed, Settings};
use embedded_storage_async::nor_flash::NorFlash;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{Key, MapConfig, MapStorage, SerializationError};
use view::View;

type Map<K, F> = MapStorage<K, F, Cache<Uncached, Uncached, Uncached, K>>;

/// Key type for reading, which leaves the key byte in the value. With a key of one byte, the library panics when it
/// cuts the key off an item without bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct WithKeyByte;

impl Key for WithKeyByte {
    fn serialize_into(&self, _buffer: &mut [u8]) -> Result<usize, SerializationError> {
        Err(SerializationError::InvalidData)
    }

    fn deserialize_from(_buffer: &[u8]) -> Result<(Self, usize), SerializationError> {
        Ok((Self, 0))
    }
}

/// Bytes of the key and the longest item, rounded up to whole words.
const BUFFER: usize = (1 + MANIFEST_BYTES).next_multiple_of(4);

/// Reason why parameters were not saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SaveError {
    /// The flash reported an error while writing or erasing.
    Flash,
    /// The bytes read back differ from the written bytes.
    Verify,
}

/// The store of a board's parameters.
pub struct Store<F> {
    flash: F,
    range: Range<u32>,
    contents: Contents,
}

impl<F: NorFlash> Store<F> {
    /// A store in the sectors of `range`; `None` unless `range` is at least two whole sectors.
    pub fn new(flash: F, range: Range<u32>) -> Option<Self> {
        let config = MapConfig::try_new(range.clone()).ok()?;
        Some(Self::of(flash, config, range))
    }

    /// A store in a valid range, from which `_checked` was made.
    pub(crate) const fn of(flash: F, _checked: MapConfig<F>, range: Range<u32>) -> Self {
        Self {
            flash,
            range,
            contents: Contents::EMPTY,
        }
    }

    /// Contents of the store at the latest reading.
    pub fn contents(&self) -> &Contents {
        &self.contents
    }

    /// Reads the store. Writes and erases nothing.
    pub async fn load(&mut self) -> &Contents {
        self.contents = self.read(None).await;
        if self.contents.is_empty() && !self.is_blank().await {
            self.contents.set_unreadable();
        }
        &self.contents
    }

    /// Writes the values of `settings` that are not yet stored, on a board whose default settings are `base`; returns
    /// the number of values written.
    pub async fn save(
        &mut self,
        settings: &Settings,
        base: &Settings,
        _off: Disarmed,
    ) -> Result<usize, SaveError> {
        self.load().await;
        let mut values = self.contents.changes(settings, base).count();
        let attempts = if self.contents.is_unreadable() { 0 } else { 2 };
        for _ in 0..attempts {
            // If the library fails, values are missing, which the check below detects.
            if self.repair().await
                && self.write(settings, base).await.is_ok()
                && self.holds(settings, base)
            {
                return Ok(values);
            }
        }
        for sector in self.sectors() {
            self.erase(sector).await?;
        }
        self.load().await;
        values = self.contents.changes(settings, base).count();
        self.write(settings, base).await?;
        match self.holds(settings, base) {
            true => Ok(values),
            false => Err(SaveError::Verify),
        }
    }

    /// True if the last reading found every value and a current manifest.
    fn holds(&self, settings: &Settings, base: &Settings) -> bool {
        let mut missing = self.contents.changes(settings, base);
        missing.next().is_none() && self.contents.manifest().is_none()
    }

    /// Appends changed values, then the manifest, and reads the store again.
    async fn write(&mut self, settings: &Settings, base: &Settings) -> Result<(), SaveError> {
        let before = self.contents;
        for (key, item) in before.changes(settings, base) {
            self.append(key, &item.to_bytes()).await?;
        }
        self.load().await;
        if let Some(manifest) = self.contents.manifest() {
            self.append(MANIFEST_KEY, &manifest.to_bytes()).await?;
            self.load().await;
        }
        Ok(())
    }

    async fn append(&mut self, key: u8, bytes: &[u8]) -> Result<(), SaveError> {
        let map = map::<u8, _>(&mut self.flash, self.range.clone());
        let mut map = map.ok_or(SaveError::Flash)?;
        let mut buffer = [0; BUFFER];
        let stored = map.store_item(&mut buffer, &key, &bytes).await;
        stored.map_err(|_| SaveError::Flash)
    }

    /// Repairs the sectors after a power cut, so that the library can use them; `false` if an erase failed or would
    /// lose a value.
    async fn repair(&mut self) -> bool {
        for sector in self.sectors() {
            let (begun, blank) = self.state(&sector).await;
            let spoiled = !begun && !blank;
            if spoiled && !self.is_needed(&sector).await && self.erase(sector).await.is_err() {
                return false;
            }
        }
        for sector in self.sectors() {
            // The sector after the one in use is empty, unless a power cut interrupted copying or erasing.
            let next = self.after(&sector);
            let in_use = self.state(&sector).await.0 && !self.is_closed(&sector).await;
            if !in_use || !self.state(&next).await.0 {
                continue;
            }
            let spare = if !self.is_needed(&next).await {
                next
            } else if !self.is_needed(&sector).await {
                sector
            } else {
                return false;
            };
            if self.erase(spare).await.is_err() {
                return false;
            }
        }
        true
    }

    /// True if the newest copy of some value is in this sector only, so that an erase would lose the value.
    async fn is_needed(&mut self, sector: &Range<u32>) -> bool {
        self.read(Some(sector)).await != self.read(None).await
    }

    /// True if the library has begun to use a sector, and true if the sector is blank.
    async fn state(&mut self, sector: &Range<u32>) -> (bool, bool) {
        let begun = view::is_marked(&mut self.flash, sector.start).await;
        (begun, self.are_blank(sector.clone()).await)
    }

    /// True if all sectors are blank between the marks at their ends.
    async fn is_blank(&mut self) -> bool {
        let mark = F::WRITE_SIZE.max(F::READ_SIZE) as u32;
        let mut blank = true;
        for sector in self.sectors() {
            blank &= self.are_blank(sector.start + mark..sector.end - mark).await;
        }
        blank
    }

    async fn are_blank(&mut self, range: Range<u32>) -> bool {
        let mut bytes = [0; 32];
        let mut blank = true;
        for start in range.clone().step_by(bytes.len()) {
            let length = (range.end - start).min(bytes.len() as u32) as usize;
            let Some(bytes) = bytes.get_mut(..length) else {
                return false;
            };
            let read = self.flash.read(start, bytes).await;
            blank &= read.is_ok() && bytes.iter().all(|&byte| byte == 0xff);
        }
        blank
    }

    async fn is_closed(&mut self, sector: &Range<u32>) -> bool {
        view::is_marked(&mut self.flash, sector.end - F::READ_SIZE as u32).await
    }

    async fn erase(&mut self, sector: Range<u32>) -> Result<(), SaveError> {
        let erased = self.flash.erase(sector.start, sector.end).await;
        erased.map_err(|_| SaveError::Flash)
    }

    /// Reads all sectors, except `without`.
    async fn read(&mut self, without: Option<&Range<u32>>) -> Contents {
        let mut contents = Contents::EMPTY;
        for sector in self.sectors() {
            if Some(&sector) != without {
                self.read_sector(sector, &mut contents).await;
            }
        }
        contents
    }

    /// Adds every valid item of a sector to `contents`.
    async fn read_sector(&mut self, sector: Range<u32>, contents: &mut Contents) {
        let view = View::new(&mut self.flash, sector);
        let Some(mut map) = map::<WithKeyByte, _>(view, self.range.clone()) else {
            return;
        };
        let mut buffer = [0; BUFFER];
        let Ok(mut items) = map.fetch_all_items(&mut buffer).await else {
            return;
        };
        // Reading a sector ends at an unreadable item; the manifest shows which values are missing.
        while let Ok(Some((WithKeyByte, item))) = items.next::<&[u8]>(&mut buffer).await {
            if let Some((&key, bytes)) = item.split_first() {
                contents.take(key, bytes);
            }
        }
    }

    fn sectors(&self) -> impl Iterator<Item = Range<u32>> + use<F> {
        let size = F::ERASE_SIZE as u32;
        let starts = self.range.clone().step_by(F::ERASE_SIZE);
        starts.map(move |start| start..start + size)
    }

    fn after(&self, sector: &Range<u32>) -> Range<u32> {
        let size = F::ERASE_SIZE as u32;
        let start = match sector.end < self.range.end {
            true => sector.end,
            false => self.range.start,
        };
        start..start + size
    }

    /// Flash of the store.
    pub fn flash(&self) -> &F {
        &self.flash
    }

    /// Releases the flash of the store.
    pub fn into_flash(self) -> F {
        self.flash
    }
}

fn map<K: Key, F: NorFlash>(flash: F, range: Range<u32>) -> Option<Map<K, F>> {
    let config = MapConfig::try_new(range).ok()?;
    Some(MapStorage::new(flash, config, Cache::new_uncached()))
}
