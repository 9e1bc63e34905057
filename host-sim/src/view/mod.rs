//! Pictures of runs: figures, report pages, the dashboard on the terminal.
//!
//! Imports the rooms below it, down from [`recording`](crate::recording). Start with [`figures`].

pub mod dashboard;
pub mod figures;
pub mod page;
pub mod plot;
pub mod style;
