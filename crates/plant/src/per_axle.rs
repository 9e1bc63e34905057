//! A quantity of each axle; in files a list of one entry for all axles, or of one entry per axle.

use declare::{Allowed, Checked, ConfigError, require};
use serde::{Deserialize, Serialize};
use std::ops::Index;

/// Largest number of axles of a robot.
pub const MAX_AXLES: usize = 5;

/// A quantity of each axle: one entry for all axles, or one entry per axle, front first.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "Vec<T>", bound(deserialize = "T: Deserialize<'de>"))]
pub struct PerAxle<T>(Vec<T>);

impl<T> PerAxle<T> {
    /// Entries of the list: one for all axles, or one per axle.
    pub fn entries(&self) -> &[T] {
        &self.0
    }

    /// Mutable entries of the list.
    pub fn entries_mut(&mut self) -> &mut [T] {
        &mut self.0
    }

    /// Expands the list to one entry for each of `axles` axles. The error names `field` and the number of entries.
    pub(super) fn spread(&mut self, field: &'static str, axles: usize) -> Result<(), ConfigError>
    where
        T: Clone,
    {
        if let [entry] = self.0.as_slice() {
            self.0 = vec![entry.clone(); axles];
        }
        let count = self.0.len();
        let allowed = Allowed::Condition("1 for all axles, or 1 per axle");
        require(count == axles, field, count as f32, allowed).map(|_| ())
    }
}

impl<T, const N: usize> From<[T; N]> for PerAxle<T> {
    fn from(entries: [T; N]) -> Self {
        const { assert!(0 < N && N <= MAX_AXLES) };
        Self(entries.into())
    }
}

impl<T> TryFrom<Vec<T>> for PerAxle<T> {
    type Error = String;

    fn try_from(entries: Vec<T>) -> Result<Self, String> {
        match entries.len() {
            1..=MAX_AXLES => Ok(Self(entries)),
            count => Err(format!(
                "{count} entries: must have 1 for all axles, or 1 per axle (at most {MAX_AXLES})"
            )),
        }
    }
}

impl<T: PartialEq> PartialEq for PerAxle<T> {
    /// True if both lists give equal values for every number of axles that both fit.
    fn eq(&self, other: &Self) -> bool {
        match (self.entries(), other.entries()) {
            ([one], all) | (all, [one]) => all.iter().all(|entry| entry == one),
            (one, other) => one == other,
        }
    }
}

impl<T> Index<usize> for PerAxle<T> {
    type Output = T;

    fn index(&self, axle: usize) -> &T {
        match self.0.as_slice() {
            [entry] => entry,
            entries => &entries[axle],
        }
    }
}

impl<T: Checked> Checked for PerAxle<T> {
    const WHOLE: bool = T::WHOLE;

    fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError> {
        self.0.as_slice().check(field, allowed)
    }
}
