//! The code the boards run, against a simulated robot.
//!
//! Eleven rooms. A room imports rooms above it in this list only; a test holds the order.
//!
//! | room | holds |
//! |---|---|
//! | [`base`] | errors, statistics, tables, output files |
//! | [`paths`] | paths and trajectories |
//! | [`bus`] | simulated CAN bus, its description |
//! | [`world`] | true robot: distributions, draws, sensors, faults |
//! | [`scenario`] | mission, the robot's parameters, scenario files |
//! | [`targets`] | boards in this process, virtual, on serial ports |
//! | [`run`] | one trial, tasks, recovery, virtual boards |
//! | [`recording`] | logs and their replay |
//! | [`view`] | figures, report pages, dashboard |
//! | [`experiments`] | commands that compute, with their arguments |
//! | [`cli`] | the command line, commands that print |

#[cfg(test)]
#[macro_use]
#[path = "../../core-algos/src/properties.rs"]
mod properties;

pub mod base;
pub mod bus;
pub mod cli;
pub mod experiments;
pub mod paths;
pub mod recording;
pub mod run;
pub mod scenario;
pub mod targets;
pub mod view;
pub mod world;

pub use plant;
