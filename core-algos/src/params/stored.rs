//! Stored form of the parameters, and what of it is used after a start.
//!
//! Each parameter is an item of its own: version, generation, value. Generations rise by every item
//! written, so of several copies of an item the newest is known wherever it is found. One more item,
//! the manifest, is written last in a save and says which generation of each parameter it was: an
//! item that is gone or older than its manifest was damaged, one that is newer was saved when the
//! power failed before the manifest was. Guarding single items against flipped bits is the store's
//! business.

use super::table::{COUNT, MAX_ID, Parameter, TABLE};
use super::{Settings, find};
use crate::config::ConfigError;
use crate::safety::{Condition, Conditions};

/// Bytes of an item.
pub const ITEM_BYTES: usize = 9;
/// Bytes of the manifest.
pub const MANIFEST_BYTES: usize = 5 + MAX_ID as usize;
/// Key of the manifest.
pub const MANIFEST_KEY: u8 = 0;
/// Version of the manifest.
const MANIFEST_VERSION: u8 = 1;

/// A stored value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Item {
    /// Version of its meaning.
    pub version: u8,
    /// Generation: number of items written before.
    pub generation: u32,
    /// The value.
    pub value: f32,
}

impl Item {
    /// Its bytes.
    pub fn to_bytes(&self) -> [u8; ITEM_BYTES] {
        let mut bytes = [self.version; ITEM_BYTES];
        let (generation, value) = (self.generation.to_le_bytes(), self.value.to_le_bytes());
        let rest = generation.into_iter().chain(value);
        for (slot, byte) in bytes.iter_mut().skip(1).zip(rest) {
            *slot = byte;
        }
        bytes
    }

    /// The item of some bytes; `None` if they are too few or too many.
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
    /// Generation.
    pub generation: u32,
    /// By identifier, from 1: the low byte of the generation, which is never 0; 0 if none is stored.
    newest: [u8; MAX_ID as usize],
}

impl Manifest {
    /// Its bytes.
    pub fn to_bytes(&self) -> [u8; MANIFEST_BYTES] {
        let mut bytes = [MANIFEST_VERSION; MANIFEST_BYTES];
        let rest = self.generation.to_le_bytes().into_iter().chain(self.newest);
        for (slot, byte) in bytes.iter_mut().skip(1).zip(rest) {
            *slot = byte;
        }
        bytes
    }

    /// The manifest of some bytes; `None` if they are too many or of another version. A manifest of a
    /// time with fewer identifiers is shorter: of the others nothing was stored.
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
    /// Nothing was ever stored.
    #[default]
    Default,
    /// The store.
    Stored,
    /// The default: what was stored is gone, or only an older copy is left.
    Damaged,
    /// The default: what is stored has another meaning.
    OtherVersion,
    /// The default: what is stored is out of range.
    OutOfRange,
}

impl Source {
    /// True if the user must be told.
    pub const fn is_notice(self) -> bool {
        !matches!(self, Self::Default | Self::Stored)
    }
}

/// Result of reading the parameters after a start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// By parameter, in the order of the table.
    pub sources: [Source; COUNT],
    /// The manifest of the last save is not there, or a store with bytes has no readable item: values may be lost.
    pub unverified: bool,
    /// The stored values are each in range and together make no working node; the defaults are used.
    pub unusable: Option<ConfigError>,
}

impl Default for Report {
    /// Nothing is stored.
    fn default() -> Self {
        Self {
            sources: [Source::Default; COUNT],
            unverified: false,
            unusable: None,
        }
    }
}

impl Report {
    /// Number of parameters that have their default although something was stored.
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

    /// Number of values from the store.
    pub fn stored(&self) -> usize {
        self.sources
            .iter()
            .filter(|&&source| source == Source::Stored)
            .count()
    }

    /// The first parameter that the user must be told of.
    pub fn first(&self) -> Option<&'static Parameter> {
        if let Some(error) = self.unusable {
            return find(error.field);
        }
        let mut found = TABLE.iter().zip(self.sources);
        Some(found.find(|(_, source)| source.is_notice())?.0)
    }

    /// Conditions for the node.
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
    /// Bytes were found, and no item among them.
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

    /// True if bytes were found, and no item among them.
    pub fn is_unreadable(&self) -> bool {
        self.unreadable
    }

    /// Notes that a store without an item is not blank.
    pub fn set_unreadable(&mut self) {
        self.unreadable = true;
    }

    /// Takes in an item as it was found, in any order. What this version does not know is left alone.
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

    /// Settings of a board after a start: `base` with the stored values that can be used. `check`
    /// builds the nodes; if that fails, `base` is used as it is.
    pub fn settle(
        &self,
        base: &Settings,
        check: impl Fn(&Settings) -> Result<(), ConfigError>,
    ) -> (Settings, Report) {
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
        let report = Report {
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

    /// The items that a save of `settings` must write, with their keys; on a board whose own
    /// settings are `base`.
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

    /// The manifest of what is in the store; `None` if the one in it says the same.
    pub fn manifest(&self) -> Option<Manifest> {
        let mut newest = [0; MAX_ID as usize];
        for (parameter, item) in TABLE.iter().zip(&self.items) {
            let slot = newest.get_mut(usize::from(parameter.id).wrapping_sub(1));
            if let (Some(slot), Some(item)) = (slot, item) {
                *slot = item.generation as u8;
            }
        }
        // A low byte may be the same by chance, so the manifest must be the latest item too.
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

/// The generation after another; its low byte is never 0.
const fn following(generation: u32) -> u32 {
    match generation.wrapping_add(1) {
        next if next & 0xff == 0 => next.wrapping_add(1),
        next => next,
    }
}

#[cfg(test)]
mod tests;
