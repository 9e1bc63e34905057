//! Reading of logs, without the writing.

#[path = "../../../host-sim/src/recording/entry.rs"]
pub mod entry;
#[path = "../../../host-sim/src/recording/intact.rs"]
mod intact;
#[path = "../../../host-sim/src/recording/read.rs"]
pub mod read;
#[path = "../../../host-sim/src/recording/schema.rs"]
pub mod schema;
