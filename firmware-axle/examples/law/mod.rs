//! A kinematic controller: the law in polar coordinates.

use core_algos::control::controller::{ControllerOutput, KinematicController};
use core_algos::control::regulator::Input;
use core_algos::math::trig::{atan2, hypot, wrap_angle};

/// Law in polar coordinates. The robot stops within 1 cm of the goal, or within 10 cm if the goal lies behind.
#[derive(Default)]
pub struct Polar {
    /// True once the robot has arrived.
    arrived: bool,
}

impl KinematicController for Polar {
    fn begin(&mut self) {
        self.arrived = false;
    }

    fn step(&mut self, input: &Input) -> ControllerOutput {
        let ahead = input.goal.relative_to(input.posture);
        let distance = hypot(ahead.x, ahead.y);
        self.arrived |= distance < 0.01 || (distance < 0.1 && ahead.x < 0.0);
        if self.arrived {
            return ControllerOutput {
                done: true,
                ..ControllerOutput::default()
            };
        }
        let bearing = atan2(ahead.y, ahead.x);
        let heading = wrap_angle(ahead.phi - bearing);
        let v = 0.2_f32.min(0.5 * distance + 0.02);
        // Turn towards the goal, and away from its heading, so that the robot arrives along it.
        let turn = 4.0 * bearing - 2.0 * heading;
        ControllerOutput {
            v,
            kappa: (turn / distance).clamp(-2.5, 2.5),
            done: false,
        }
    }
}
