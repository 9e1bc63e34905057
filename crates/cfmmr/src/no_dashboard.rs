//! Replaces [`dashboard`](self) in a build without the feature `full`.

use core_algos::topology::Topology;
use host_sim::base::error::Error;
use host_sim::run::keyboard::Keyboard;
use host_sim::run::robot::{Observer, Record, Robot};
use output::terminal::left_out;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Dashboard of a build without the feature `full`: a type without values.
pub enum Dashboard {}

impl Dashboard {
    /// Fails: this build has no dashboard.
    pub fn open(
        _title: impl Into<String>,
        _robot: Topology,
        _goal: [f64; 3],
        _keyboard: Keyboard,
        _interrupt: Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        Err(left_out("--dashboard"))
    }
}

impl Observer for Dashboard {
    fn epoch(&mut self, _robot: &dyn Robot, _record: &Record) -> Result<(), Error> {
        match *self {}
    }
}

/// Fails: this build has no dashboard.
pub fn check() -> Result<(), Error> {
    Err(left_out("--dashboard"))
}
