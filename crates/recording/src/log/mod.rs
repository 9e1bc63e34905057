//! Log of a run as an MCAP file or for live viewers, and its reading.

mod file;
mod gate;
mod intact;
mod live;
pub mod read;
pub mod recover;
pub mod replay;
mod sink;
mod standard;

pub(crate) use file::Mcap;
pub use mcap::MAGIC;

use crate::{About, Destinations};
use host_sim::base::error::Error;
use output::files;
use sink::Sink;

/// Checks that the log file can be written.
pub(crate) fn check(to: &Destinations) -> Result<(), Error> {
    match &to.log {
        Some(path) => Ok(files::try_file(path)?),
        None => Ok(()),
    }
}

/// Opens the log file and the live server; `None` if neither is demanded by `to`.
pub(crate) fn open(to: &Destinations, about: &About) -> Result<Option<Mcap>, Error> {
    let mut sink = to.log.as_deref().map(Sink::to_file).transpose()?;
    if let Some(address) = to.live {
        sink.get_or_insert_with(Sink::without_file)
            .serve(address, &to.live_origin)?;
    }
    sink.map(|sink| Mcap::new(sink, about)).transpose()
}
