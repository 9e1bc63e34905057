//! Control, estimation and node state machines of a compliant-framed wheeled modular mobile robot
//! (CFMMR) of two to five axles.
//!
//! # Contract
//!
//! - `no_std`, no allocation, no clock, no global state, no `unsafe`: samples and time come in as
//!   values, commands go out as values.
//! - **Validate once, then run infallibly.** Every algorithm has a `Config` in SI units. Its `build()` rejects an
//!   invalid parameter with the parameter's name and allowed range ([`config::ConfigError`]). The object it builds
//!   has `step`-like methods that never fail, never panic, and treat NaN and infinity as absent input.
//! - Arithmetic is `f32`, in a few places `f64`, which a Cortex-M4F computes in software. All transcendental
//!   functions come from [`math::trig`]. Results on a host and on a Cortex-M4F are therefore bit-identical.
//!
//! # Conventions
//!
//! SI units, radians, counter-clockwise positive. A posture is `(x, y, phi)`; body frame x
//! forward, y left. Axle 1 is the front, axle 2 the rear; the root of the robot's frame is at the rear axle and
//! its tip at the front axle, so the beam (the relative position sensor) measures the front axle's posture in the rear
//! axle's coordinates. Wheels are ordered (left, right).
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "a test compares with another implementation"
    )
)]

#[cfg(test)]
#[macro_use]
mod properties;

#[macro_use]
mod enumeration;

pub mod acquisition;
pub mod beam;
pub mod bus;
pub mod config;
pub mod control;
pub mod drive;
pub mod fusion;
#[cfg(feature = "link")]
pub mod link;
pub mod math;
pub mod node;
pub mod params;
pub mod safety;
pub mod time;
pub mod topology;
