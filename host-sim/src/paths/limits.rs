//! Limits of the frame for paths, and errors of paths.

use super::{MAX_COORDINATE_M, MAX_LENGTH_M};
use std::f64::consts::PI;
use std::fmt;

/// Place on a path, named in errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPosition {
    /// Arc length, m.
    pub s: f64,
    /// Position along x, m.
    pub x: f64,
    /// Position along y, m.
    pub y: f64,
    /// Nearest waypoint, counted from 1, and its line in the file; `None` for a path without waypoints.
    pub waypoint: Option<(usize, Option<u64>)>,
}

impl fmt::Display for PathPosition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "s = {:.3} m, x = {:.3} m, y = {:.3} m",
            self.s, self.x, self.y
        )?;
        match self.waypoint {
            Some((number, Some(line))) => write!(f, " (near waypoint {number}, line {line})"),
            Some((number, None)) => write!(f, " (near waypoint {number})"),
            None => Ok(()),
        }
    }
}

/// Error of a path.
#[derive(Clone, Debug, PartialEq)]
pub enum PathError {
    /// A parameter of a shape outside its range.
    Parameter {
        /// Name of the parameter.
        name: &'static str,
        /// Refused value.
        value: f64,
        /// Allowed values, in words.
        allowed: &'static str,
    },
    /// A row of a CSV file that is not a waypoint.
    Row {
        /// Line in the file, from 1.
        line: u64,
        /// Reason for the refusal.
        problem: String,
    },
    /// A waypoint that cannot be used.
    Waypoint {
        /// Number of the waypoint, from 1.
        number: usize,
        /// Line of the waypoint in the file, from 1; `None` for a waypoint from no file.
        line: Option<u64>,
        /// Reason for the refusal.
        problem: String,
    },
    /// Fewer than two waypoints; holds their number.
    TooFew(usize),
    /// Length of a path beyond [`MAX_LENGTH_M`], m.
    TooLong(f64),
    /// Curvature beyond the limit of the frame.
    Curvature {
        /// Place of the largest curvature.
        place: PathPosition,
        /// Largest curvature of the path, 1/m.
        value: f64,
        /// Limit of the curvature, 1/m.
        bound: f64,
    },
    /// Change of curvature beyond the steering rate of the frame, even at the least speed.
    SteeringRate {
        /// Place of the largest change.
        place: PathPosition,
        /// Largest |dψ/ds| of the path, rad/m.
        value: f64,
        /// Limit of |dψ/ds|, rad/m.
        bound: f64,
    },
    /// A path that the robot cannot begin from its posture.
    Start(StartFault),
}

/// Reason why a robot cannot begin a path.
#[derive(Clone, Debug, PartialEq)]
pub enum StartFault {
    /// Distance of the robot from the start, and the largest allowed distance, m.
    Distance(f64, f64),
    /// Length of the path behind the robot, and the largest allowed length, m.
    Passed(f64, f64),
    /// Heading of the robot minus heading of the path, rad.
    Turn(f64),
}

impl fmt::Display for PathError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parameter {
                name,
                value,
                allowed,
            } => write!(f, "{name} = {value}: must be {allowed}"),
            Self::Start(StartFault::Distance(distance, most)) => write!(
                f,
                "begins {distance:.2} m from the robot: must be at most {most:.2} m \
                 (robot.lead.course.max_deviation_m)"
            ),
            Self::Start(StartFault::Passed(s, most)) => write!(
                f,
                "the robot is {s:.2} m past the start of the path: must be at most {most:.2} m"
            ),
            Self::Start(StartFault::Turn(turn)) => write!(
                f,
                "the heading of the robot differs from the start of the path by {:.0}°: must be at most 90°",
                turn.abs().to_degrees()
            ),
            Self::Row { line, problem } => write!(f, "line {line}: {problem}"),
            Self::Waypoint {
                number,
                line: Some(line),
                problem,
            } => write!(f, "line {line}, waypoint {number}: {problem}"),
            Self::Waypoint {
                number,
                line: None,
                problem,
            } => write!(f, "waypoint {number}: {problem}"),
            Self::TooFew(count) => {
                write!(f, "{count} waypoint(s): a path needs at least 2")
            }
            Self::TooLong(length) => write!(
                f,
                "the path is {length:.0} m long: must be at most {MAX_LENGTH_M} m"
            ),
            Self::Curvature {
                place,
                value,
                bound,
            } => write!(
                f,
                "curvature {value:.3} 1/m at {place}: the frame allows at most {bound:.3} 1/m"
            ),
            Self::SteeringRate {
                place,
                value,
                bound,
            } => write!(
                f,
                "steering changes by {value:.2} rad/m at {place}: at the lowest speed the frame \
                 allows at most {bound:.2} rad/m"
            ),
        }
    }
}

impl std::error::Error for PathError {}

/// Limits of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Flexible length of the frame (L), m.
    pub frame_length_m: f64,
    /// Rigid length at each end of the frame, m.
    pub rigid_end_m: f64,
    /// Largest allowed steering angle |ψ|, rad.
    pub max_steering_rad: f64,
    /// Largest allowed steering rate |ψ̇|, rad/s.
    pub max_steering_rate_rad_s: f64,
    /// Least speed to which the robot slows down for steering, m/s.
    pub min_speed_m_s: f64,
}

impl Default for Bounds {
    fn default() -> Self {
        Self {
            frame_length_m: 0.37,
            rigid_end_m: 0.0,
            max_steering_rad: 0.5,
            max_steering_rate_rad_s: 1.0,
            min_speed_m_s: 0.05,
        }
    }
}

impl Bounds {
    /// Curvature of the path (1/m) at a steering angle (rad): paper eq. 5, and rigid ends.
    fn curvature(&self, psi: f64) -> f64 {
        let (s, c) = libm::sincos(psi);
        let sinc = if psi.abs() < 1e-6 { 1.0 } else { s / psi };
        2.0 * s / c / (self.frame_length_m * sinc + 2.0 * self.rigid_end_m * c)
    }

    /// Largest curvature that the frame allows, 1/m.
    pub fn max_curvature(&self) -> f64 {
        self.curvature(self.max_steering_rad)
    }

    /// Steering angle for a curvature (1/m), rad; grows monotonically with the curvature.
    pub fn steering(&self, kappa: f64) -> f64 {
        let bend = kappa.abs();
        let length = self.frame_length_m + 2.0 * self.rigid_end_m;
        // ψ ≤ ½ κ (L + 2a) < π/2, and the curvature grows with ψ between.
        let (mut low, mut high) = (0.0, (0.5 * bend * length).min(0.5 * PI));
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if self.curvature(middle) <= bend {
                low = middle;
            } else {
                high = middle;
            }
        }
        (0.5 * (low + high)).copysign(kappa)
    }
}

/// Refuses a value that is not greater than 0 and at most [`MAX_COORDINATE_M`].
pub(super) fn positive(name: &'static str, value: f64) -> Result<f64, PathError> {
    if value > 0.0 && value <= MAX_COORDINATE_M {
        Ok(value)
    } else {
        Err(PathError::Parameter {
            name,
            value,
            allowed: "a number greater than 0 and at most 1000",
        })
    }
}
