//! Pictures of runs: figures and report pages. Start with [`figures`].

#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "a test compares with another implementation"
    )
)]

#[cfg(test)]
#[macro_use]
#[path = "../../../core-algos/src/properties.rs"]
mod properties;

pub mod figures;
pub mod page;
pub mod plot;
pub mod style;
