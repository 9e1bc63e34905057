//! Errors, statistics, tables and output files: what every other room may use.
//!
//! Imports nothing of this crate. Start with [`error`].

pub mod error;
pub mod input;
pub mod interrupt;
pub mod numbers;
pub mod output;
pub mod progress;
pub mod spelling;
pub mod statistics;
pub mod table;
pub mod terminal;
pub mod thinned;
pub mod toml_file;
