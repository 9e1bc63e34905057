//! Replaces [`log`](self) in a build without logs: a recording has no MCAP file and no live viewers.

use crate::{About, Destinations, Line};
use host_sim::base::error::Error;
use host_sim::run::end::RunEnd;
use host_sim::run::robot::Record;
use output::terminal::left_out;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// Uninhabited type in place of a log.
pub(crate) enum Mcap {}

impl Mcap {
    pub fn plan(&mut self, _goal: [f64; 3], _path: &[[f64; 3]]) {
        match *self {}
    }

    pub fn await_viewer(&self, _interrupt: &AtomicBool) -> Result<(), Error> {
        match *self {}
    }

    pub fn note(&mut self, _line: &Line) {
        match *self {}
    }

    pub fn write_epoch(&mut self, _record: &Record) {
        match *self {}
    }

    pub fn close(&mut self, _end: &RunEnd) -> Result<(), Error> {
        match *self {}
    }

    pub fn path(&self) -> Option<PathBuf> {
        match *self {}
    }
}

/// Rejects destinations that need a log or live viewers.
pub(crate) fn check(to: &Destinations) -> Result<(), Error> {
    match (&to.log, to.live) {
        (Some(_), _) => Err(left_out("--log")),
        (None, Some(_)) => Err(left_out("--live")),
        (None, None) => Ok(()),
    }
}

/// Opens no log; rejects the same destinations as [`check`].
pub(crate) fn open(to: &Destinations, _about: &About) -> Result<Option<Mcap>, Error> {
    check(to).map(|()| None)
}
