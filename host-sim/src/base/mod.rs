//! Errors, statistics, numbers and TOML from text. Start with [`error`].

pub mod error;
pub mod input;
pub mod numbers;
pub mod spelling;
pub mod statistics;
pub(crate) mod table;
pub mod toml_file;
