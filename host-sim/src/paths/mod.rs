//! Paths and trajectories for following and tracking, in `f64`: built-in shapes, splines through
//! waypoints, and the time law that turns a path into a trajectory.
//!
//! A path is sampled at equal steps of arc length. [`Path::check`] compares a path with the limits of the frame and
//! names the place of the largest excess.

use crate::base::error::Error;
use crate::base::input;
use crate::base::spelling;

mod curve;
mod limits;
mod spline;
mod trajectory;

#[cfg(test)]
mod tests;
pub use curve::{Path, Sample};
pub use limits::{Bounds, PathError, PathPosition, StartFault};
pub use spline::{Waypoint, waypoints};
pub use trajectory::{TimeLimits, TimedSample, Trajectory};

/// Distance between samples of a path, m.
pub const SPACING_M: f64 = 0.01;
/// Largest allowed coordinate, m: up to this value the robot's single precision resolves a tenth of a millimetre.
pub const MAX_COORDINATE_M: f64 = 1000.0;
/// Largest allowed length of a path, m.
pub const MAX_LENGTH_M: f64 = 5000.0;
/// Least allowed distance between waypoints, m.
pub const MIN_SEPARATION_M: f64 = 1e-3;
/// Names of the built-in paths.
pub const NAMES: [&str; 3] = ["line", "circle", "figure-eight"];

/// A built-in path of a given size (length of the line, radius of the circle, half width of the figure eight, m), or
/// the path through the waypoints of a CSV file. `called` is the user's name of the size in errors.
pub fn named(name: &str, (called, size): (&str, Option<f64>)) -> Result<Path, Error> {
    let built_in = match name {
        "line" => Path::line(size.unwrap_or(3.0)),
        "circle" => Path::circle(size.unwrap_or(1.0)),
        "figure-eight" => Path::figure_eight(size.unwrap_or(1.5)),
        _ if size.is_some() => {
            return Err(Error::input(format!(
                "{called}: no effect on waypoints; only for line, circle and figure-eight"
            )));
        }
        file => {
            let bytes = input::bytes(file.as_ref(), input::MAX_WAYPOINTS_BYTES).map_err(|error| {
                let hint = spelling::hint(file, NAMES);
                Error::input(format!(
                    "{error}: must be line, circle, figure-eight, or a CSV file with the columns x,y in metres{hint}"
                ))
            })?;
            return Path::from_csv(&bytes).map_err(|error| Error::input(error.to_string()));
        }
    };
    built_in.map_err(|error| Error::input(format!("{called}: {error}")))
}
