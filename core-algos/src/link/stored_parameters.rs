//! Parameters that a board behind a link keeps: what its store held, and what a host has set since.
//!
//! They are the board's own and take no part in a session: its nodes run with the configuration that
//! the host sends. Reading and writing the store is left to whoever has one.
//!
//! | event | values | source and "saved" of a value | reason |
//! |---|---|---|---|
//! | start of a board | values of the store, by [`Contents::settle`]; all defaults if no node can be built with them | source by the store; saved | |
//! | value set | the value, if in range; else as before | source as before; saved if its bits are those that a reset would give | |
//! | saved | as they are | source by the store; saved if the store took the value | the store is read back |
//! | no such index | refused: index | | |

use super::protocol::{Refusal, Reply};
use crate::config::ConfigError;
use crate::params::{COUNT, Contents, Disarmed, Parameter, Report, Settings, TABLE, fingerprint};
use crate::topology::Role;

/// Contents to write to a store.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Save {
    /// The parameters.
    pub settings: Settings,
    /// Those of the board when nothing is stored.
    pub base: Settings,
    /// The motors are off.
    pub off: Disarmed,
}

/// Why a parameter was not set, or the parameters not saved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StoreError {
    /// There is no such parameter.
    Index,
    /// Out of range, or no node can be built with it.
    Value(ConfigError),
}

/// The parameters of one board.
#[derive(Clone, Debug)]
pub struct StoredParameters {
    role: Role,
    /// As they would be after a reset.
    stored: Settings,
    report: Report,
    /// As they are.
    settings: Settings,
}

impl StoredParameters {
    /// Those of a board whose store holds nothing.
    pub fn new(role: Role) -> Self {
        let base = Settings::of(role);
        let (stored, report) = Contents::EMPTY.settle(&base, |_| Ok(()));
        Self {
            role,
            stored,
            report,
            settings: stored,
        }
    }

    /// Takes in what the store holds after a start.
    pub fn load(&mut self, contents: &Contents) {
        self.saved(contents);
        self.settings = self.stored;
    }

    /// Takes in what the store holds after it was written.
    #[inline(never)]
    pub fn saved(&mut self, contents: &Contents) {
        let base = Settings::of(self.role);
        (self.stored, self.report) = contents.settle(&base, |settings| settings.check(self.role));
    }

    /// Of which board.
    pub fn role(&self) -> Role {
        self.role
    }

    /// As they are.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Number of parameters, and the version of their table.
    pub fn summary(&self) -> Reply<'static> {
        Reply::Parameters {
            table: fingerprint(),
            count: COUNT as u8,
            unusable: self.report.unusable.is_some(),
        }
    }

    /// The parameter at a place in the table.
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

    /// Gives one another value, or changes nothing.
    pub fn set(&mut self, index: u8, value: f32, _off: Disarmed) -> Result<(), StoreError> {
        let set = parameter(index)?.set(&mut self.settings, value);
        set.map_err(StoreError::Value)
    }

    /// Checks that a node can be built from the values, each of which is in range by itself.
    pub fn check(&self) -> Result<(), StoreError> {
        let checked = self.settings.check(self.role);
        checked.map_err(StoreError::Value)
    }

    /// Contents to write, once checked.
    pub fn save(&self, off: Disarmed) -> Save {
        Save {
            settings: self.settings,
            base: Settings::of(self.role),
            off,
        }
    }
}

fn parameter(index: u8) -> Result<&'static Parameter, StoreError> {
    TABLE.get(usize::from(index)).ok_or(StoreError::Index)
}

#[cfg(test)]
mod tests;
