//! Simulated robot: two axles, a compliant frame, tyres and motors, in `f64`.
//!
//! [`PlantConfig`] holds the physical constants, [`Plant`] is the robot, stepped at a fixed rate
//! with wheel torques. The parts: [`frame`] (the strip between the axles), tyres, wheels and
//! motors, and the integrator. [`elastica`] solves the same strip by another route; the tests
//! compare the two.
//!
//! Frames: global; axle frames x forward, y left; front axle first, left wheel first. The frame's
//! root is at the rear axle.
//!
//! Deterministic to the bit: no fused operations, elementary functions from `libm` or from here.

#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "a test compares with another implementation"
    )
)]

mod config;
pub mod drive;
mod drivetrain;
pub mod elastica;
pub mod frame;
mod geometry;
mod integrator;
mod lanes;
mod legendre;
mod loads;
pub mod reference;
mod sincos;
mod state;
mod wheel;

pub use config::{Brush, Creep, PlantConfig, TICK_S, Tyre};
pub use frame::Station;
pub use integrator::{Outline, Plant};
pub use state::{AxleState, Health, PlantState, Wrench};
