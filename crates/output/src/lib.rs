//! Output of a command: result files, tables, text and progress on the terminal.

#[cfg(test)]
#[macro_use]
#[path = "../../../core-algos/src/properties.rs"]
mod properties;

pub mod files;
pub mod progress;
pub mod table;
pub mod terminal;
