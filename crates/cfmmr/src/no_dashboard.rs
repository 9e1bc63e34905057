//! In place of [`dashboard`](self) in a build without it.

use core_algos::topology::Topology;
use host_sim::base::error::Error;
use host_sim::run::keyboard::Keyboard;
use host_sim::run::robot::{Observer, Record, Robot};
use output::terminal::left_out;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Dashboard that does not exist.
pub enum Dashboard {}

impl Dashboard {
    /// Refuses.
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

/// Refuses.
pub fn check() -> Result<(), Error> {
    Err(left_out("--dashboard"))
}
