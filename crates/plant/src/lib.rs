//! Simulated robot: two to five axles, a compliant frame between neighbours, tyres and motors, in `f64`.
//!
//! [`PlantConfig`] holds the physical constants, [`Plant`] is the robot, stepped at a fixed rate
//! with wheel torques. The parts: [`frame`] (the strip between two axles), tyres, wheels and
//! motors, and the integrator. [`elastica`] solves the same strip by another method; the tests
//! compare the two.
//!
//! Coordinates: global; or of an axle, x forward, y left. Axles and frames are numbered from 0 at the front;
//! the left wheel is first. A frame has its tip at the axle ahead and its root at the axle behind.
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
mod per_axle;
pub mod reference;
mod sincos;
mod state;
mod wheel;

pub use config::{Brush, Creep, PlantConfig, TICK_S, Tyre};
pub use frame::Station;
pub use integrator::{Outline, Plant};
pub use per_axle::{MAX_AXLES, PerAxle};
pub use state::{AxleState, Health, Wrench};
