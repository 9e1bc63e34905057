//! The code of the boards against a simulated robot, without files, threads, pictures or serial ports.
//!
//! A [`Simulation`](run::simulation::Simulation) is one robot: the plant, its sensors, the bus and the boards in lockstep
//! at 1 kHz. A [`Scenario`](scenario::Scenario) holds everything that a simulation depends on, apart from the seed.
//!
//! ```
//! use host_sim::run::regulate::regulate_on;
//! use host_sim::run::simulation::Simulation;
//! use host_sim::scenario::Scenario;
//!
//! # fn main() -> Result<(), host_sim::base::error::Error> {
//! let scenario = Scenario::in_world(Some("ideal"))?;
//! let mut robot = Simulation::new(&scenario, 1, 0)?;
//! let outcome = regulate_on(&mut robot, &scenario, |_record| ())?;
//! let [x, y, _] = outcome.midpoint;
//! assert!(x.hypot(y) < 0.05);
//! # Ok(())
//! # }
//! ```
//!
//! Layers, from the bottom up; each imports only layers above it in this table:
//!
//! | module | holds |
//! |---|---|
//! | [`base`] | errors, statistics, TOML and numbers from text |
//! | [`paths`] | paths and trajectories |
//! | [`bus`] | simulated CAN bus |
//! | [`world`] | true robot: distributions, draws, sensors, faults |
//! | [`scenario`] | mission, the robot's parameters, scenario files |
//! | [`targets`] | interface of a board; boards in this process |
//! | [`run`] | one trial, tasks, recovery |

#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "a test compares with another implementation"
    )
)]

#[cfg(test)]
#[macro_use]
#[path = "../../core-algos/src/properties.rs"]
mod properties;

pub mod base;
pub mod bus;
pub mod paths;
pub mod run;
pub mod scenario;
pub mod targets;
pub mod world;

pub use plant;
