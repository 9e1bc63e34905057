//! The program `cfmmr`.
//!
//! | module | holds |
//! |---|---|
//! | [`cli`] | the command line, and commands that print |
//! | [`experiments`] | commands that run or configure a robot |
//! | [`dashboard`] | a run on the terminal |
//!
//! The feature `full` adds logs with replay and live server, the dashboard, page layout on the terminal, and the text
//! of the boards' logs. Without this feature, `--log`, `--live`, `--dashboard` and `replay` name the command to type,
//! and pages are printed as Markdown.

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

pub mod cli;
#[cfg(feature = "full")]
pub mod dashboard;
#[cfg(not(feature = "full"))]
#[path = "no_dashboard.rs"]
pub mod dashboard;
pub mod experiments;
mod thinned;

/// Name and version of the program, with a hash of its sources.
pub const BUILD: &str = env!("BUILD");
