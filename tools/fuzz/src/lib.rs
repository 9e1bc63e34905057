//! What the targets share.
//!
//! Modules of the program and of the recording that read input are compiled here by their paths: the server of a run and
//! the command line would take most of the time of a build.

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
