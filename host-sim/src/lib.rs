//! The code the boards run, against a simulated robot.
//!
//! [`plant`] is the robot in `f64`; [`sensors`] turns its state into the samples a board would
//! read; [`eval`] runs single on-board algorithms on cases from standard input. [`statistics`],
//! [`figures`], [`table`] and [`output`] make results of it.

#[cfg(test)]
#[macro_use]
#[path = "../../core-algos/src/properties.rs"]
mod properties;

pub mod advice;
pub mod calibration;
pub mod campaign;
pub mod cli;
pub mod commands;
pub mod dashboard;
pub mod dbc;
pub mod driving;
pub mod effect;
pub mod error;
pub mod eval;
pub mod faults;
pub mod figures;
pub mod kinematic_model;
pub mod log;
pub mod output;
pub mod overlay;
pub mod pace;
pub mod paths;
pub mod plot;
pub mod progress;
pub mod recording;
pub mod replay;
pub mod report;
pub mod scenario;
pub mod scenario_file;
pub mod sensors;
pub mod shortest_path;
pub mod simulation;
pub mod soak;
pub mod statistics;
pub mod style;
pub mod supervision;
pub mod table;
pub mod targets;
pub mod timing;
pub mod trace;
pub mod virtual_bus;
pub mod virtual_robot;
pub mod world;

pub use plant;
