//! Runs the boards' code against a simulated robot. The library writes no files, starts no threads and opens no serial
//! ports.
//!
//! A [`Simulation`](run::simulation::Simulation) is one robot: plant, sensors, bus and boards in lockstep at 1 kHz. A
//! [`Rig`](run::rig::Rig) is the robot without the plant. A [`Scenario`](scenario::Scenario) holds everything that a
//! simulation depends on, apart from the seed.
//!
//! A binding owns a `Scenario` and a `Simulation`, which implements [`Robot`](run::robot::Robot), and reads its
//! [`Record`](run::robot::Record)s; `bindings/web` is an example.
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
//! Each module imports only modules of earlier rows:
//!
//! | module | holds |
//! |---|---|
//! | [`base`] | errors, statistics, TOML and numbers from text |
//! | [`paths`] | paths and trajectories |
//! | [`bus`] | simulated CAN bus |
//! | [`world`] | true robot: distributions, draws, sensors, faults |
//! | [`scenario`] | mission, the robot's parameters, scenario files |
//! | [`targets`] | interface of a board; boards in this process |
//! | [`run`] | one trial, the rig, tasks, recovery |

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
