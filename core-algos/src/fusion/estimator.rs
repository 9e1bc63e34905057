//! Interface of an estimator of the user, whose estimates replace those of the fusion of [`robot`](super::robot).
//!
//! The fusion of [`robot`](super::robot) keeps running beside the estimator. It gives the motion of the frame `odom`,
//! in which the kinematic controller drives, and the checks of the beam's measurements. The estimates of the estimator
//! are used by the task, the cascade, the conditions of the estimate, and the log. `odom` is drawn towards them.
//!
//! # Restart of an axle
//!
//! The odometry of a restarted axle has lost the motion during the restart. In the epoch in which the axle is back,
//! [`Inputs`] hold the motion of the other axle for both axles, with a covariance of 0.1 m and 0.3 rad for the
//! restarted axle, and no measurement of the beam. If the beam has measured in that epoch, [`Estimator::rejoin`] gets
//! this measurement after the step.

use super::Estimate;
use super::robot::{Inputs, PairAxle};
use crate::math::matrix;

/// Largest coordinate (m) and heading (rad) of an estimate that is used.
const FARTHEST: f32 = 1e5;

/// Estimates of the robot in the frame `map`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EstimatorOutput {
    /// Front axle.
    pub front: Estimate,
    /// Rear axle.
    pub rear: Estimate,
    /// Midpoint O, heading from rear to front: [`Chain::midpoint`](super::compound::Chain::midpoint).
    pub robot: Estimate,
}

impl EstimatorOutput {
    /// True if the robot can drive by the estimates: every number is finite, coordinates are within 100 km, and no
    /// variance is negative.
    pub fn is_sound(&self) -> bool {
        [&self.front, &self.rear, &self.robot]
            .into_iter()
            .all(is_sound)
    }
}

fn is_sound(estimate: &Estimate) -> bool {
    let (at, covariance) = (estimate.posture, &estimate.covariance);
    let near = [at.x, at.y, at.phi].iter().all(|it| it.abs() <= FARTHEST);
    let variances = [0, 1, 2].map(|k| covariance[k][k]);
    near && matrix::is_finite(covariance) && variances.iter().all(|variance| *variance >= 0.0)
}

/// Estimator of the postures of both axles and O. Runs once an epoch of 10 ms on the lead node.
pub trait Estimator {
    /// Starts with the robot at rest: posture of O, and the front axle's posture in the rear axle's frame. Called
    /// before the first step, and when the pose of the robot is set.
    fn start(&mut self, center: &Estimate, relative: &Estimate);

    /// Estimates after one epoch. An output that is not [sound](EstimatorOutput::is_sound) counts as no estimate: the
    /// robot stops with the condition [`NotANumber`](crate::safety::Condition::NotANumber).
    fn step(&mut self, inputs: &Inputs) -> EstimatorOutput;

    /// An axle has restarted, and the beam locates it: `known` is the axle that has kept its estimate, `beam` the front
    /// axle's posture in the rear axle's frame. The returned estimates replace those of the latest step; `None` keeps
    /// them.
    fn rejoin(&mut self, _known: PairAxle, _beam: &Estimate) -> Option<EstimatorOutput> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Posture;

    #[test]
    fn estimate_beyond_a_bound_is_not_sound() {
        let good = Estimate::with_sigmas(Posture::new(1.0, 2.0, 3.0), [0.0, 0.1, 0.1]);
        let good = EstimatorOutput {
            front: good,
            rear: good,
            robot: good,
        };
        assert!(good.is_sound());
        let spoil: [fn(&mut Estimate); 7] = [
            |it| it.posture.x = f32::NAN,
            |it| it.posture.y = f32::INFINITY,
            |it| it.posture.phi = f32::NAN,
            |it| it.posture.y = -1.1e5,
            |it| it.covariance[0][2] = f32::INFINITY,
            |it| it.covariance[1][1] = -1e-9,
            |it| it.covariance[2][2] = f32::NAN,
        ];
        for spoil in spoil {
            for part in 0..3 {
                let mut bad = good;
                spoil([&mut bad.front, &mut bad.rear, &mut bad.robot][part]);
                assert!(!bad.is_sound(), "{bad:?}");
            }
        }
    }
}
