//! Fused estimates of an epoch: each pair of neighbouring axles, and from the pairs the whole robot.
//!
//! Each pair has a filter of its own, so the two estimates of an inner axle differ. The *chain* joins the pairs by
//! their relative postures, which the beams measure to a millimetre, and is placed so that its pairs have the mean
//! position and the mean heading of the estimated pairs. O is the mean of the midpoints of the pairs, and its heading is
//! the direction from the last axle to the first.
//!
//! The covariance of the robot is the mean of the pairs' covariances. For errors of any correlation, the covariance of
//! a mean is at most the mean of the covariances; so the estimate never claims too much.
//!
//! A robot of two axles is its only pair.

use crate::fusion::Estimate;
use crate::fusion::ekf::Verdict;
use crate::fusion::estimator::EstimatorOutput;
use crate::fusion::robot;
use crate::math::Posture;
use crate::math::matrix::{add, scale};
use crate::math::trig::{atan2, sin_cos, wrap_angle};
use crate::topology::{MAX_AXLES, MAX_FRAMES, Topology};

/// Number of axles between the first and the last.
pub const MAX_INNER: usize = MAX_AXLES - 2;

/// Fused estimates of an epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fused {
    topology: Topology,
    /// Output of the fusion for each pair of neighbouring axles, front first.
    pub(super) pairs: [robot::Output; MAX_FRAMES],
    /// The joined pairs; `None` for a robot of two axles.
    chain: Option<Chain>,
}

/// Pairs joined to a whole robot.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Chain {
    /// Midpoint O and its heading.
    robot: Estimate,
    /// Postures of the axles, front first; beyond the last axle, the origin.
    axles: [Posture; MAX_AXLES],
}

impl Chain {
    /// Joins the pairs of `frames` frames.
    fn join(pairs: &[robot::Output; MAX_FRAMES], frames: usize) -> Self {
        let share = 1.0 / frames as f32;
        let mut axles = [Posture::ORIGIN; MAX_AXLES];
        axles[0] = pairs[0].front.posture;
        let (mut off, mut covariance) = ([0.0; 3], [[0.0; 3]; 3]);
        // At first the chain begins at the front axle of the first pair.
        for (k, pair) in pairs.iter().enumerate().take(frames) {
            let front = axles[k];
            let rear = front.compose(pair.rear.posture.relative_to(pair.front.posture));
            axles[k + 1] = rear;
            let at = pair.robot.posture;
            off[0] += share * (at.x - 0.5 * (front.x + rear.x));
            off[1] += share * (at.y - 0.5 * (front.y + rear.y));
            off[2] += share * wrap_angle(pair.front.posture.phi - front.phi);
            covariance = add(&covariance, &scale(&pair.robot.covariance, share));
        }
        let [x, y] = middle_of(&axles, frames);
        let (sin, cos) = sin_cos(off[2]);
        for axle in axles.iter_mut().take(frames + 1) {
            let (dx, dy) = (axle.x - x, axle.y - y);
            *axle = Posture::new(
                x + off[0] + cos * dx - sin * dy,
                y + off[1] + sin * dx + cos * dy,
                wrap_angle(axle.phi + off[2]),
            );
        }
        let robot = Estimate::new(midpoint(&axles, frames), covariance);
        Self { robot, axles }
    }
}

impl Fused {
    /// The estimates of the pairs, joined.
    pub(super) fn new(topology: Topology, pairs: &[robot::Output; MAX_FRAMES]) -> Self {
        let frames = topology.frame_count();
        Self {
            topology,
            pairs: *pairs,
            chain: (frames > 1).then(|| Chain::join(pairs, frames)),
        }
    }

    /// Estimates of a robot of two axles.
    #[cfg(test)]
    pub(super) fn of_pair(pair: robot::Output) -> Self {
        Self::new(Topology::PAIR, &[pair; MAX_FRAMES])
    }

    /// Estimate of the robot's posture: midpoint O and its heading.
    pub(super) fn robot(&self) -> &Estimate {
        match &self.chain {
            Some(chain) => &chain.robot,
            None => &self.pairs[0].robot,
        }
    }

    /// Postures of the axles, front first; beyond the last axle, the origin.
    pub(super) fn axles(&self) -> [Posture; MAX_AXLES] {
        match &self.chain {
            Some(chain) => chain.axles,
            None => {
                let mut axles = [Posture::ORIGIN; MAX_AXLES];
                axles[0] = self.pairs[0].front.posture;
                axles[1] = self.pairs[0].rear.posture;
                axles
            }
        }
    }

    /// Outputs of the pairs that the robot has, front first.
    fn own(&self) -> impl Iterator<Item = &robot::Output> {
        self.pairs.iter().take(self.topology.frame_count())
    }

    /// True if a filter rejected the measurement of its frame.
    pub(super) fn is_refused(&self) -> bool {
        self.own().any(|pair| pair.beam.verdict == Verdict::Gated)
    }

    /// True if the robot can drive by the estimates of a user's estimator.
    pub(super) fn is_sound(&self) -> bool {
        let mut pairs = self.own().map(|pair| EstimatorOutput {
            front: pair.front,
            rear: pair.rear,
            robot: pair.robot,
        });
        pairs.all(|pair| pair.is_sound())
    }

    /// The estimates in the output of the lead node: first axle, last axle, O, and the beam with the largest NIS.
    pub(super) fn output(&self) -> robot::Output {
        let [first, ..] = self.pairs;
        let Some(chain) = &self.chain else {
            return first;
        };
        let last_frame = (self.topology.frame_count() - 1).min(MAX_FRAMES - 1);
        let last = &self.pairs[last_frame];
        let mut beam = first.beam;
        for pair in self.own() {
            if pair.beam.nis > beam.nis {
                beam = pair.beam;
            }
        }
        robot::Output {
            front: Estimate::new(chain.axles[0], first.front.covariance),
            rear: Estimate::new(chain.axles[last_frame + 1], last.rear.covariance),
            robot: chain.robot,
            beam,
            ipec: None,
            omega: None,
        }
    }

    /// Postures of the axles between the first and the last.
    pub(super) fn inner(&self) -> [Option<Posture>; MAX_INNER] {
        let inner = |k: usize| Some(self.chain.as_ref()?.axles[k + 1]);
        let count = self.topology.axle_count() - 2;
        core::array::from_fn(|k| inner(k).filter(|_| k < count))
    }
}

/// Mean of the midpoints of neighbouring axles, m, of the first `frames` frames.
fn middle_of(axles: &[Posture; MAX_AXLES], frames: usize) -> [f32; 2] {
    let share = 0.5 / frames as f32;
    let mut middle = [0.0; 2];
    for (front, rear) in axles.iter().zip(axles.iter().skip(1)).take(frames) {
        middle[0] += share * (front.x + rear.x);
        middle[1] += share * (front.y + rear.y);
    }
    middle
}

/// Posture of O of a chain of axles joined by `frames` frames: mean of the midpoints of neighbouring axles, heading
/// from the last axle to the first.
fn midpoint(axles: &[Posture; MAX_AXLES], frames: usize) -> Posture {
    let [x, y] = middle_of(axles, frames);
    let (first, last) = (axles[0], axles[frames.min(MAX_FRAMES)]);
    Posture::new(x, y, atan2(first.y - last.y, first.x - last.x))
}
