//! The instrumented frame: from strains to the relative posture of the axles (paper eq. 11–15).
//!
//! [`calibration`] turns bridge counts into strains. The posture of the front axle in the rear axle's coordinates is
//! computed from the strains by [`polynomial`], as in the paper, or by [`elastica`], with the mechanics of the strip.
//! [`health`] excludes failed gauges. [`RelativePositionSensor`] runs the whole chain: one call a sample, one call a
//! posture.
//!
//! # Contract
//!
//! `Config::build` validates; every call on a built object is infallible: it never panics, its cost
//! is bounded, and a posture that could not be computed is `None`, never NaN.
//!
//! # Conventions
//!
//! Root at the rear axle, tip at the front axle; the posture is the front axle's in the rear
//! axle's coordinates, rigid ends included. Strain > 0 ⇔ curvature > 0 ⇔ the strip bends left seen from
//! the root; curvature = strain / half thickness (paper eq. 13). Gauge positions are measured from
//! the root of the flexible length.

pub mod calibration;
pub mod elastica;
pub mod health;
pub mod polynomial;
pub mod procedure;
pub mod sensor;
pub mod strip;

#[cfg(test)]
mod reference;

pub use elastica::Wrench;
pub use sensor::{Estimate, Method, RelativePositionSensor};
pub use strip::{GaugeMask, MAX_GAUGES, PerGauge, RelativePosture, Strip};
