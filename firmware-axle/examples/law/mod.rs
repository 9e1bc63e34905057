//! A kinematic controller: the law in polar coordinates.

use core_algos::control::controller::{ControllerOutput, KinematicController, Memory};
use core_algos::control::regulator::Input;
use core_algos::math::trig::{atan2, hypot, wrap_angle};

/// Law in polar coordinates. The robot stops within 1 cm of the goal, or within 10 cm if the goal lies behind.
pub struct Polar;

impl KinematicController for Polar {
    fn step(&self, memory: &mut Memory, input: &Input) -> ControllerOutput {
        let ahead = input.goal.relative_to(input.posture);
        let distance = hypot(ahead.x, ahead.y);
        // Memory: 1 once the robot has arrived.
        if distance < 0.01 || (distance < 0.1 && ahead.x < 0.0) {
            memory[0] = 1.0;
        }
        if memory[0] == 1.0 {
            let done = input.speed_m_s.abs() < 1e-3;
            return ControllerOutput {
                done,
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
