//! Every command of `cfmmr` with a kinematic controller and an estimator of the user, for example `posture --trials 5`.
//!
//! The controller is the law in polar coordinates of Aicardi et al. (1995);
//! `firmware-axle/examples/own_controller.rs` is a board image with the same law. The estimator moves each axle by its
//! odometry and blends the beam in.

#[path = "../../../firmware-axle/examples/law/mod.rs"]
mod law;

use core_algos::fusion::Estimate;
use core_algos::fusion::compound::Chain;
use core_algos::fusion::estimator::{Estimator, EstimatorOutput};
use core_algos::fusion::robot::{Inputs, PairAxle};
use core_algos::math::Posture;
use core_algos::math::trig::{sin_cos, sqrt};
use host_sim::scenario::own::Own;
use std::process::ExitCode;

/// Share of the difference between beam and odometry that is corrected in an epoch.
const GAIN: f32 = 0.05;
/// Growth of the standard deviations with the distance: m/m, m/m, rad/m.
const GROWTH: [f32; 3] = [0.01, 0.01, 0.01];

/// Complementary blend of odometry and beam.
#[derive(Default)]
struct Blend {
    front: Posture,
    rear: Posture,
    /// Standard deviations at the start: m, m, rad.
    placed: [f32; 3],
    /// Driven distance of O, m.
    distance: f32,
}

impl Blend {
    fn output(&self) -> EstimatorOutput {
        let sigmas = [0, 1, 2].map(|k| self.placed[k] + GROWTH[k] * self.distance);
        let robot = Chain::midpoint(self.front, self.rear).posture;
        let [front, rear, robot] =
            [self.front, self.rear, robot].map(|at| Estimate::with_sigmas(at, sigmas));
        EstimatorOutput { front, rear, robot }
    }
}

/// Posture shifted by `share` of a difference along the axes of the heading `along`.
fn shifted(at: Posture, along: f32, [x, y, turn]: [f32; 3], share: f32) -> Posture {
    let (sin, cos) = sin_cos(along);
    Posture::new(
        at.x + share * (cos * x - sin * y),
        at.y + share * (sin * x + cos * y),
        at.phi + share * turn,
    )
}

impl Estimator for Blend {
    fn start(&mut self, center: &Estimate, relative: &Estimate) {
        *self = Self {
            front: Chain::front_from_midpoint(center.posture, relative.posture).posture,
            rear: Chain::rear_from_midpoint(center.posture, relative.posture).posture,
            placed: [0, 1, 2].map(|k| sqrt(center.covariance[k][k])),
            distance: 0.0,
        };
    }

    fn step(&mut self, inputs: &Inputs) -> EstimatorOutput {
        let (Some(front), Some(rear)) = (inputs.front, inputs.rear) else {
            // The next increment contains the motion of this epoch.
            self.front = self.front.compose(inputs.front.unwrap_or_default().posture);
            self.rear = self.rear.compose(inputs.rear.unwrap_or_default().posture);
            return self.output();
        };
        self.front = self.front.compose(front.posture);
        self.rear = self.rear.compose(rear.posture);
        self.distance += 0.5 * (front.posture.x + rear.posture.x).abs();
        if let Some(beam) = inputs.beam {
            // Each axle takes half of the correction.
            let off = beam.posture.minus(self.front.relative_to(self.rear));
            let along = self.rear.phi;
            self.front = shifted(self.front, along, off, 0.5 * GAIN);
            self.rear = shifted(self.rear, along, off, -0.5 * GAIN);
        }
        self.output()
    }

    fn rejoin(&mut self, known: PairAxle, beam: &Estimate) -> Option<EstimatorOutput> {
        match known {
            PairAxle::Front => {
                self.rear = Chain::rear_from_front(self.front, beam.posture).posture;
            }
            PairAxle::Rear => {
                self.front = Chain::front_from_rear(self.rear, beam.posture).posture;
            }
        }
        Some(self.output())
    }
}

fn main() -> ExitCode {
    let own = Own::default()
        .with_controller(law::Polar::default)
        .with_estimator(Blend::default);
    cfmmr::main_with(own)
}
