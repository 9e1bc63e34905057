//! Errors of a final posture against its goal.

use serde::Serialize;

/// Largest distance (m) and heading error (rad) at which campaigns count a run as near its goal: 3 cm and 3°.
pub const NEAR: [f64; 2] = [0.03, 3.0 * std::f64::consts::PI / 180.0];

/// True final errors of one trial.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FinalError {
    /// Distance of O from the goal, m.
    pub e_m: f64,
    /// Heading of O minus heading of the goal, rad.
    pub heading_rad: f64,
    /// Line of sight to the goal minus the goal's heading, rad.
    pub theta_rad: f64,
    /// Line of sight to the goal minus the robot's heading, rad.
    pub alpha_rad: f64,
}

impl FinalError {
    /// The errors of a posture against a goal.
    pub fn of(posture: [f64; 3], goal: [f64; 3]) -> Self {
        let (dx, dy) = (goal[0] - posture[0], goal[1] - posture[1]);
        let sight = libm::atan2(dy, dx);
        Self {
            e_m: libm::hypot(dx, dy),
            heading_rad: wrap(posture[2] - goal[2]),
            theta_rad: wrap(sight - goal[2]),
            alpha_rad: wrap(sight - posture[2]),
        }
    }

    /// True if distance and heading error are within [`NEAR`].
    pub fn is_near(&self) -> bool {
        self.e_m <= NEAR[0] && self.heading_rad.abs() <= NEAR[1]
    }
}

/// The angle wrapped to ±π, rad.
pub fn wrap(angle: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    angle - turn * (angle / turn).round()
}
