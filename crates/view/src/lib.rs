//! Pictures of runs: figures and report pages. Start with [`figures`].

#[cfg(test)]
#[macro_use]
#[path = "../../../core-algos/src/properties.rs"]
mod properties;

pub mod figures;
pub mod page;
pub mod plot;
pub mod style;
