//! Shared modules of the fuzz targets.
//!
//! Input-reading modules of other crates are compiled here by path, because live server and command line would take
//! most of the build time.

#[path = "../../../crates/recording/src/entry.rs"]
pub mod entry;
#[path = "../../../crates/cfmmr/src/experiments/eval/mod.rs"]
pub mod eval;
#[path = "../../../crates/recording/src/log/intact.rs"]
mod intact;
pub mod numbers;
#[path = "../../../crates/recording/src/log/read.rs"]
pub mod read;
pub mod run_link_model;
#[path = "../../../crates/recording/src/schema.rs"]
pub mod schema;
