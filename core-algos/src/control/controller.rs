//! Interface of a kinematic controller that replaces the [`Regulator`](super::regulator::Regulator).
//!
//! As with the regulator, the governor shapes the output within the limits of speed, acceleration and steering, and
//! the cascade turns the result into references of the axles.

use super::regulator::Input;

/// Motion commanded by a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControllerOutput {
    /// Velocity of O, m/s.
    pub v: f32,
    /// Curvature of the path of O, 1/m.
    pub kappa: f32,
    /// True if the goal is reached: the robot brakes, and the task is done once the robot is at rest.
    pub done: bool,
}

impl ControllerOutput {
    /// True if velocity and curvature are finite.
    pub fn is_finite(&self) -> bool {
        self.v.is_finite() && self.kappa.is_finite()
    }
}

/// Kinematic controller that drives O to a goal posture. The controller owns its memory.
///
/// # Example
///
/// ```
/// use core_algos::control::controller::{ControllerOutput, KinematicController};
/// use core_algos::control::regulator::Input;
///
/// /// Drives straight ahead for two seconds.
/// #[derive(Default)]
/// struct Ahead {
///     epochs: u32,
/// }
///
/// impl KinematicController for Ahead {
///     fn begin(&mut self) {
///         self.epochs = 0;
///     }
///
///     fn step(&mut self, _input: &Input) -> ControllerOutput {
///         self.epochs += 1;
///         ControllerOutput { v: 0.1, kappa: 0.0, done: self.epochs > 200 }
///     }
/// }
/// ```
pub trait KinematicController {
    /// Forgets the memory. Called before the first step, and after each command of a task.
    fn begin(&mut self) {}

    /// Motion for the next epoch of 10 ms. An output that is not finite ends the task without success: the robot
    /// brakes.
    fn step(&mut self, input: &Input) -> ControllerOutput;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn output_is_finite_only_if_both_numbers_are() {
        for bad in [f32::NAN, f32::INFINITY] {
            for (v, kappa, finite) in [(0.1, -2.0, true), (bad, 1.0, false), (0.1, bad, false)] {
                let output = ControllerOutput {
                    v,
                    kappa,
                    done: false,
                };
                assert_eq!(output.is_finite(), finite, "{output:?}");
            }
        }
    }
}
