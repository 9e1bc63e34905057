//! Stored form of the parameters, and selection of the values used after a start.
//!
//! Each parameter is one item: version, generation, value. The generation rises with every item written, so it
//! identifies the newest of several copies. A save writes one more item last, the manifest, which lists the newest
//! generation of each parameter. An item that is missing or older than listed was damaged. An item newer than the
//! manifest was saved before a power failure prevented the next manifest. The store protects single items against
//! flipped bits.

use super::table::{COUNT, MAX_ID, Parameter, TABLE};
use super::{Settings, find};
use crate::config::ConfigError;
use crate::safety::{Condition, Conditions};

/// Length of an encoded item, bytes.
pub const ITEM_BYTES: usize = 9;
/// Length of the encoded manifest, bytes.
pub const MANIFEST_BYTES: usize = 5 + MAX_ID as usize;
/// Key of the manifest.
pub const MANIFEST_KEY: u8 = 0;
const MANIFEST_VERSION: u8 = 1;

/// A stored value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Item {
    /// Version of the parameter's meaning.
    pub version: u8,
    /// Generation; rises with every item written.
    pub generation: u32,
    /// Value of the parameter.
    pub value: f32,
}

impl Item {
    /// Encoded item.
    pub fn to_bytes(&self) -> [u8; ITEM_BYTES] {
        let mut bytes = [self.version; ITEM_BYTES];
        let (generation, value) = (self.generation.to_le_bytes(), self.value.to_le_bytes());
        let rest = generation.into_iter().chain(value);
        for (slot, byte) in bytes.iter_mut().skip(1).zip(rest) {
            *slot = byte;
        }
        bytes
    }

    /// Decodes an item; `None` if the length is wrong.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (&version, rest) = bytes.split_first()?;
        let (generation, value) = rest.split_first_chunk()?;
        Some(Self {
            version,
            generation: u32::from_le_bytes(*generation),
            value: f32::from_le_bytes(value.try_into().ok()?),
        })
    }
}

/// Newest generation of each parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Manifest {
    /// Generation of the manifest.
    pub generation: u32,
    /// Low byte of the newest generation, by identifier from 1; never 0 if a value is stored, 0 otherwise.
    newest: [u8; MAX_ID as usize],
}

impl Manifest {
    /// Encoded manifest.
    pub fn to_bytes(&self) -> [u8; MANIFEST_BYTES] {
        let mut bytes = [MANIFEST_VERSION; MANIFEST_BYTES];
        let rest = self.generation.to_le_bytes().into_iter().chain(self.newest);
        for (slot, byte) in bytes.iter_mut().skip(1).zip(rest) {
            *slot = byte;
        }
        bytes
    }

    /// Decodes a manifest; `None` if it is too long, has no generation or is of another version. A manifest of a
    /// program with fewer identifiers is shorter: nothing was stored for the missing identifiers.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let rest = bytes.strip_prefix(&[MANIFEST_VERSION])?;
        let (generation, listed) = rest.split_first_chunk()?;
        let mut newest = [0; MAX_ID as usize];
        newest.get_mut(..listed.len())?.copy_from_slice(listed);
        Some(Self {
            generation: u32::from_le_bytes(*generation),
            newest,
        })
    }

    fn newest(&self, parameter: &Parameter) -> Option<u8> {
        let at = usize::from(parameter.id).checked_sub(1)?;
        self.newest.get(at).copied().filter(|&newest| newest != 0)
    }
}

/// Source of the value of a parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Source {
    /// The default: nothing was ever stored.
    #[default]
    Default,
    /// The store of the board.
    Stored,
    /// The default: the stored value is lost, or only an older copy is left.
    Damaged,
    /// The default: the stored value has another meaning.
    OtherVersion,
    /// The default: the stored value is out of range.
    OutOfRange,
}

impl Source {
    /// True if the source must be reported to the user.
    pub const fn is_notice(self) -> bool {
        !matches!(self, Self::Default | Self::Stored)
    }
}

/// Result of reading the parameters after a start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoreReport {
    /// Source of each parameter, in the order of the table.
    pub sources: [Source; COUNT],
    /// True if the manifest of the last save is missing, or a store that is not blank has no readable item: values may
    /// be lost.
    pub unverified: bool,
    /// Error for which the stored values were rejected as a set; the defaults are used.
    pub unusable: Option<ConfigError>,
}

impl Default for StoreReport {
    /// Report of an empty store.
    fn default() -> Self {
        Self {
            sources: [Source::Default; COUNT],
            unverified: false,
            unusable: None,
        }
    }
}

impl StoreReport {
    /// Number of parameters that have their default although a value was stored.
    pub fn defaults(&self) -> usize {
        match self.unusable {
            Some(_) => self.stored(),
            None => self
                .sources
                .iter()
                .filter(|source| source.is_notice())
                .count(),
        }
    }

    /// Number of usable stored values. If the set is unusable, none of them is used.
    pub fn stored(&self) -> usize {
        self.sources
            .iter()
            .filter(|&&source| source == Source::Stored)
            .count()
    }

    /// First parameter that must be reported to the user; `None` if there is none.
    pub fn first(&self) -> Option<&'static Parameter> {
        if let Some(error) = self.unusable {
            return find(error.field);
        }
        let mut found = TABLE.iter().zip(self.sources);
        Some(found.find(|(_, source)| source.is_notice())?.0)
    }

    /// Conditions of the store that the node reports.
    pub fn conditions(&self) -> Conditions {
        let notice = self.defaults() > 0 || self.unverified || self.unusable.is_some();
        Conditions::NONE.with(Condition::ParameterDefault, notice)
    }
}

/// Contents found in a store: the newest copy of each item.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contents {
    items: [Option<Item>; COUNT],
    manifest: Option<Manifest>,
    /// The largest generation found.
    newest: u32,
    /// True if the store is not blank and has no readable item.
    unreadable: bool,
}

impl Default for Contents {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl Contents {
    /// An empty store.
    pub const EMPTY: Self = Self {
        items: [None; COUNT],
        manifest: None,
        newest: 0,
        unreadable: false,
    };

    /// True if no item was found.
    pub fn is_empty(&self) -> bool {
        self.newest == 0
    }

    /// True if the store is not blank and has no readable item.
    pub fn is_unreadable(&self) -> bool {
        self.unreadable
    }

    /// Marks a store that is not blank and has no readable item.
    pub fn set_unreadable(&mut self) {
        self.unreadable = true;
    }

    /// Adds an item read from the store, in any order. Unknown keys and invalid bytes are ignored.
    pub fn take(&mut self, key: u8, bytes: &[u8]) {
        let generation = if key == MANIFEST_KEY {
            let Some(manifest) = Manifest::from_bytes(bytes) else {
                return;
            };
            if self
                .manifest
                .is_none_or(|old| manifest.generation > old.generation)
            {
                self.manifest = Some(manifest);
            }
            manifest.generation
        } else {
            let place = TABLE.iter().position(|parameter| parameter.id == key);
            let slot = place.and_then(|i| self.items.get_mut(i));
            let (Some(slot), Some(item)) = (slot, Item::from_bytes(bytes)) else {
                return;
            };
            if slot.is_none_or(|old| item.generation > old.generation) {
                *slot = Some(item);
            }
            item.generation
        };
        self.newest = self.newest.max(generation);
    }

    /// Settings of a board after a start: `base` with the usable stored values. If `check` refuses the result, `base`
    /// is used unchanged.
    pub fn resolve(
        &self,
        base: &Settings,
        check: impl Fn(&Settings) -> Result<(), ConfigError>,
    ) -> (Settings, StoreReport) {
        let mut settings = *base;
        let mut sources = [Source::Default; COUNT];
        for ((parameter, item), source) in TABLE.iter().zip(&self.items).zip(&mut sources) {
            *source = self.source(parameter, item.as_ref());
            if let (Source::Stored, Some(item)) = (*source, item)
                && parameter.set(&mut settings, item.value).is_err()
            {
                *source = Source::OutOfRange;
            }
        }
        let listed = self.manifest.map_or(0, |manifest| manifest.generation);
        let unverified = self.newest > listed || self.unreadable;
        let unusable = check(&settings).err();
        let report = StoreReport {
            sources,
            unverified,
            unusable,
        };
        (if unusable.is_some() { *base } else { settings }, report)
    }

    fn source(&self, parameter: &Parameter, item: Option<&Item>) -> Source {
        let expected = self
            .manifest
            .and_then(|manifest| manifest.newest(parameter));
        let saved_later = |item: &Item| {
            self.manifest
                .is_none_or(|manifest| item.generation > manifest.generation)
        };
        match (item, expected) {
            (None, None) => Source::Default,
            (None, Some(_)) => Source::Damaged,
            (Some(item), _) if item.version != parameter.version => Source::OtherVersion,
            (Some(item), Some(newest)) if item.generation as u8 != newest && !saved_later(item) => {
                Source::Damaged
            }
            (Some(_), _) => Source::Stored,
        }
    }

    /// Items that a save of `settings` must write, with their keys. `base` are the board's settings with an empty
    /// store.
    pub fn changes<'a>(
        &'a self,
        settings: &'a Settings,
        base: &'a Settings,
    ) -> impl Iterator<Item = (u8, Item)> + 'a {
        let mut generation = self.newest;
        TABLE
            .iter()
            .zip(&self.items)
            .filter_map(move |(parameter, item)| {
                let value = parameter.get(settings);
                let same = |other: f32| other.to_bits() == value.to_bits();
                let unchanged = match self.source(parameter, item.as_ref()) {
                    Source::Default => same(parameter.get(base)),
                    Source::Stored => item.is_some_and(|item| same(item.value)),
                    _ => false,
                };
                if unchanged {
                    return None;
                }
                generation = following(generation);
                let item = Item {
                    version: parameter.version,
                    generation,
                    value,
                };
                Some((parameter.id, item))
            })
    }

    /// Manifest to write; `None` if the stored one is current.
    pub fn manifest(&self) -> Option<Manifest> {
        let mut newest = [0; MAX_ID as usize];
        for (parameter, item) in TABLE.iter().zip(&self.items) {
            let slot = newest.get_mut(usize::from(parameter.id).wrapping_sub(1));
            if let (Some(slot), Some(item)) = (slot, item) {
                *slot = item.generation as u8;
            }
        }
        // Low bytes may be equal by chance, so a current manifest is also the newest item.
        let latest = self
            .manifest
            .filter(|manifest| manifest.generation == self.newest);
        let current = latest.is_some_and(|manifest| manifest.newest == newest);
        (!current && !self.is_empty()).then_some(Manifest {
            generation: following(self.newest),
            newest,
        })
    }
}

/// The generation after `generation`; its low byte is never 0.
const fn following(generation: u32) -> u32 {
    match generation.wrapping_add(1) {
        next if next & 0xff == 0 => next.wrapping_add(1),
        next => next,
    }
}

#[cfg(test)]
mod tests;
