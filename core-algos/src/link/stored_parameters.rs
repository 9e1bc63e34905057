//! Parameters that a board behind a link keeps: stored values, and values that a host has set since.
//!
//! A session does not use them: its nodes run with the configuration that the host sends. The caller reads and writes
//! the store.
//!
//! | event | values | source and "saved" of a value | reason |
//! |---|---|---|---|
//! | start of a board | values of the store, by [`Contents::resolve`]; all defaults if no node can be built with them | source by the store; saved | |
//! | value set | the value, if in range; unchanged otherwise | source unchanged; saved if the bits equal those after a reset | |
//! | place set | the value; the role of the board changes with the next reset | as of any value | |
//! | parameters saved | unchanged | source by the store; saved if the store holds the value | the store is read back |
//! | no such index | refused: index | | |

use super::protocol::{Refusal, Reply};
use crate::config::ConfigError;
use crate::params::{
    BoardKind, COUNT, Contents, Disarmed, Parameter, Settings, StoreReport, TABLE, fingerprint,
};

/// Contents to write to a store.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Save {
    /// Parameters to store.
    pub settings: Settings,
    /// Parameters of the board with an empty store.
    pub base: Settings,
    /// Proof that the motors are off.
    pub off: Disarmed,
}

/// Reason for which a parameter was not set, or the parameters were not saved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StoreError {
    /// No parameter has this index.
    Index,
    /// The value is out of range, or no node can be built with the values.
    Value(ConfigError),
}

/// Parameters of one board: present values, and the values in its store.
#[derive(Clone, Debug)]
pub struct StoredParameters {
    kind: BoardKind,
    /// Values that the parameters would have after a reset.
    stored: Settings,
    report: StoreReport,
    settings: Settings,
}

impl StoredParameters {
    /// Parameters of a board with an empty store.
    pub fn new(kind: BoardKind) -> Self {
        let base = Settings::of(kind);
        let (stored, report) = Contents::EMPTY.resolve(&base, |_| Ok(()));
        Self {
            kind,
            stored,
            report,
            settings: stored,
        }
    }

    /// Loads the contents of the store after a start.
    pub fn load(&mut self, contents: &Contents) {
        self.saved(contents);
        self.settings = self.stored;
    }

    /// Updates source and "saved" from the contents read back after a write.
    #[inline(never)]
    pub fn saved(&mut self, contents: &Contents) {
        let base = Settings::of(self.kind);
        let check = |settings: &Settings| settings.check_role(self.kind).map(|_| ());
        (self.stored, self.report) = contents.resolve(&base, check);
    }

    /// Kind of the board.
    pub fn kind(&self) -> BoardKind {
        self.kind
    }

    /// Current values.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Number of parameters, hash of their table, and usability of the store.
    pub fn summary(&self) -> Reply<'static> {
        Reply::Parameters {
            table: fingerprint(),
            count: COUNT as u8,
            unusable: self.report.unusable.is_some(),
        }
    }

    /// Value, source and "saved" of the parameter at this index of the table.
    pub fn get(&self, index: u8) -> Result<Reply<'static>, Refusal<'static>> {
        let parameter = parameter(index).map_err(|_| Refusal::Index { count: COUNT as u8 })?;
        let value = parameter.get(&self.settings);
        let source = self.report.sources.get(usize::from(index)).copied();
        Ok(Reply::Parameter {
            value,
            source: source.unwrap_or_default(),
            saved: value.to_bits() == parameter.get(&self.stored).to_bits(),
        })
    }

    /// Sets a parameter; changes nothing on an error.
    pub fn set(&mut self, index: u8, value: f32, _off: Disarmed) -> Result<(), StoreError> {
        let set = parameter(index)?.set(&mut self.settings, value);
        set.map_err(StoreError::Value)
    }

    /// Checks that the nodes can be built from the combination of values.
    pub fn check(&self) -> Result<(), StoreError> {
        let checked = self.settings.check_role(self.kind);
        checked.map(|_| ()).map_err(StoreError::Value)
    }

    /// Contents to write; requires a successful [`Self::check`].
    pub fn save(&self, off: Disarmed) -> Save {
        Save {
            settings: self.settings,
            base: Settings::of(self.kind),
            off,
        }
    }
}

fn parameter(index: u8) -> Result<&'static Parameter, StoreError> {
    TABLE.get(usize::from(index)).ok_or(StoreError::Index)
}

#[cfg(test)]
mod tests;
