//! Figures and report pages of runs: [`figures`] draws, [`page`] writes the report page.

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

pub mod animation;
pub mod figures;
pub mod page;
pub mod plot;
pub mod style;
