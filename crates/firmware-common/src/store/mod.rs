//! Parameters in flash: items appended to sectors of their own, by `sequential-storage`.
//!
//! Loading reads and never writes: whatever the sectors hold, it stays as it is. A save writes only
//! what has changed, the manifest last, and reads everything back. What a power cut left is tidied
//! at the next save: a sector is erased only if every newest copy is in another one. Only when two
//! attempts have not brought the values into the store is all of it erased and written anew.
//!
//! The reading does not trust the marks at the ends of a sector, by which the library tells which
//! sector is in use: each one is read as if it were, and of several copies the newest counts.

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

/// The key of an item that is being read, left with its value: the library would cut it off an item
/// of no bytes, and panic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Uncut;

impl Key for Uncut {
    fn serialize_into(&self, _buffer: &mut [u8]) -> Result<usize, SerializationError> {
        Err(SerializationError::InvalidData)
    }

    fn deserialize_from(_buffer: &[u8]) -> Result<(Self, usize), SerializationError> {
        Ok((Self, 0))
    }
}

/// Key and longest item, in whole words.
const BUFFER: usize = (1 + MANIFEST_BYTES).next_multiple_of(4);

/// Why parameters were not saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SaveError {
    /// The flash refused to be written or erased.
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
    /// A store in the sectors of `range`; `None` unless they are at least two whole ones.
    pub fn new(flash: F, range: Range<u32>) -> Option<Self> {
        let config = MapConfig::try_new(range.clone()).ok()?;
        Some(Self::of(flash, config, range))
    }

    /// The same of a range that was checked before; `_checked` was made from it.
    pub(crate) const fn of(flash: F, _checked: MapConfig<F>, range: Range<u32>) -> Self {
        Self {
            flash,
            range,
            contents: Contents::EMPTY,
        }
    }

    /// Content at the latest reading.
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

    /// Writes what is not yet stored of `settings`, on a board whose own settings are `base`; gives
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
            // A library that cannot go on leaves the values out, which the check below notices.
            if self.tidy().await
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

    /// True if the last reading found every value and the manifest.
    fn holds(&self, settings: &Settings, base: &Settings) -> bool {
        let mut missing = self.contents.changes(settings, base);
        missing.next().is_none() && self.contents.manifest().is_none()
    }

    /// Appends what has changed, then the manifest, and reads everything again.
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

    /// Makes the sectors what the library expects after a power cut; `false` if it cannot be done
    /// without losing a value.
    async fn tidy(&mut self) -> bool {
        for sector in self.sectors() {
            let (begun, blank) = self.state(&sector).await;
            let spoiled = !begun && !blank;
            if spoiled && !self.is_needed(&sector).await && self.erase(sector).await.is_err() {
                return false;
            }
        }
        for sector in self.sectors() {
            // The sector after the one in use is empty, unless copying or erasing it was cut short.
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

    /// True if only this sector has the newest copy of a value.
    async fn is_needed(&mut self, sector: &Range<u32>) -> bool {
        self.read(Some(sector)).await != self.read(None).await
    }

    /// State of a sector for the library: in use or full; and blank.
    async fn state(&mut self, sector: &Range<u32>) -> (bool, bool) {
        let begun = view::is_marked(&mut self.flash, sector.start).await;
        (begun, self.are_blank(sector.clone()).await)
    }

    /// True if no sector has bytes between the marks at its ends.
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

    /// All there is, apart from one sector.
    async fn read(&mut self, without: Option<&Range<u32>>) -> Contents {
        let mut contents = Contents::EMPTY;
        for sector in self.sectors() {
            if Some(&sector) != without {
                self.read_sector(sector, &mut contents).await;
            }
        }
        contents
    }

    /// Takes in every sound item of a sector.
    async fn read_sector(&mut self, sector: Range<u32>, contents: &mut Contents) {
        let view = View::new(&mut self.flash, sector);
        let Some(mut map) = map::<Uncut, _>(view, self.range.clone()) else {
            return;
        };
        let mut buffer = [0; BUFFER];
        let Ok(mut items) = map.fetch_all_items(&mut buffer).await else {
            return;
        };
        // An item that cannot be read ends the sector; the manifest tells what was lost with it.
        while let Ok(Some((Uncut, item))) = items.next::<&[u8]>(&mut buffer).await {
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

    /// The flash.
    pub fn flash(&self) -> &F {
        &self.flash
    }

    /// Gives the flash back.
    pub fn into_flash(self) -> F {
        self.flash
    }
}

fn map<K: Key, F: NorFlash>(flash: F, range: Range<u32>) -> Option<Map<K, F>> {
    let config = MapConfig::try_new(range).ok()?;
    Some(MapStorage::new(flash, config, Cache::new_uncached()))
}
