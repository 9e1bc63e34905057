//! Paths and trajectories for following and tracking, in `f64`: built-in shapes, splines through
//! waypoints, and the time law that makes a trajectory of a path.
//!
//! A path is sampled evenly by arc length. [`Path::check`] holds it against what the frame can
//! bend and names the first place that breaks a bound.

mod curve;
mod limits;
mod spline;
mod trajectory;

#[cfg(test)]
mod tests;
pub use curve::{Path, Sample};
pub use limits::{Bounds, PathError, Place};
pub use spline::{Waypoint, waypoints};
pub use trajectory::{TimeLimits, Timed, Trajectory};

/// Distance between samples, m.
pub const SPACING_M: f64 = 0.01;
/// Largest coordinate, m: beyond, single precision on the robot is coarser than a tenth of a
/// millimetre.
pub const MAX_COORDINATE_M: f64 = 1000.0;
/// Longest path, m.
pub const MAX_LENGTH_M: f64 = 5000.0;
/// Waypoints must be this far apart, m.
pub const MIN_SEPARATION_M: f64 = 1e-3;
