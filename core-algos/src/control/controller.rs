//! Interface of a kinematic controller that replaces the [`Regulator`](super::regulator::Regulator).
//!
//! As with the regulator, the governor shapes the output within the limits of speed, acceleration and steering, and
//! the cascade turns the result into references of the axles.

use super::regulator::Input;
use core::fmt;

/// Memory of a controller between steps, zero at the beginning of a task.
pub type Memory = [f32; 8];

/// Motion commanded by a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControllerOutput {
    /// Velocity of O, m/s.
    pub v: f32,
    /// Curvature of the path of O, 1/m.
    pub kappa: f32,
    /// True if the goal is reached and the robot at rest.
    pub done: bool,
}

/// Kinematic controller that drives O to a goal posture.
pub trait KinematicController: Sync {
    /// Motion for the next epoch of 10 ms.
    fn step(&self, memory: &mut Memory, input: &Input) -> ControllerOutput;
}

/// The user's own controller; `None` for the regulator.
#[derive(Clone, Copy, Default)]
pub struct CustomController(pub Option<&'static dyn KinematicController>);

impl PartialEq for CustomController {
    fn eq(&self, other: &Self) -> bool {
        match (self.0, other.0) {
            (Some(one), Some(other)) => core::ptr::addr_eq(one, other),
            (None, None) => true,
            _ => false,
        }
    }
}

impl fmt::Debug for CustomController {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.map_or("regulator", |_| "own controller"))
    }
}
