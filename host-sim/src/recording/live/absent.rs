//! No server: this program was built without one.

use crate::base::error::Error;
use foxglove::{ChannelId, Context, SinkId};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// There is none.
pub enum Server {}

impl Server {
    /// Refuses.
    pub fn start(_: &Arc<Context>, _: SocketAddr) -> Result<Self, Error> {
        super::check()?;
        Err(Error::Failure("--live: no server".to_owned()))
    }

    /// Never called.
    pub fn await_viewer(&self, _: &AtomicBool) -> Result<(), Error> {
        match *self {}
    }

    /// Never called.
    pub fn time(&self, _: u64) {
        match *self {}
    }

    /// Never called.
    pub fn joined(&self) -> Vec<(ChannelId, SinkId)> {
        match *self {}
    }

    /// Never called.
    pub fn stop(self) {
        match self {}
    }
}
