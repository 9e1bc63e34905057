//! Fused estimates of an epoch: each pair of neighbouring axles, and from the pairs the whole robot.
//!
//! Each pair has a filter of its own, so the two estimates of an inner axle differ. The *chain* joins the pairs by
//! their relative postures, which the beams measure to a millimetre. In each epoch it moves so that its pairs have the
//! mean of the motions that the filters estimate, each seen from its pair. O is the mean of the midpoints of the pairs,
//! and its heading is the direction from the last axle to the first.
//!
//! The mean of the postures themselves would not do: the headings of two filters drift apart, and then the mean of two
//! motions along their headings is none along the heading of the chain. The estimate of a bent chain would slide
//! sideways by 2 cm/s, and the controller would push the axles against each other.
//!
//! The covariance of the robot is the mean of the pairs' covariances. For errors of any correlation, the covariance of
//! a mean is at most the mean of the covariances; so the estimate never claims too much.
//!
//! With two axles the only pair is the robot.

use crate::control::train;
use crate::fusion::Estimate;
use crate::fusion::ekf::Verdict;
use crate::fusion::joint::BeamUpdate;
use crate::fusion::robot;
use crate::math::matrix::{add, propagate, scale};
use crate::math::trig::{sin_cos, wrap_angle};
use crate::math::{Posture, RelativeHeading};
use crate::topology::{MAX_AXLES, MAX_FRAMES, Topology};

/// Number of axles between the first and the last.
pub const MAX_INNER: usize = MAX_AXLES - 2;

/// Fused estimates of an epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fused {
    topology: Topology,
    /// First axle, last axle, O, and the beam of [`worst_beam`].
    pub(super) estimates: robot::Output,
    /// Postures of the axles between the first and the last, front first.
    pub(super) inner: [Option<Posture>; MAX_INNER],
}

impl Fused {
    /// The estimates of the pairs, joined. `anchors`: the frames of the pairs' filters, as seen from `map`; they move so
    /// that each pair lies in the chain.
    pub(super) fn new(
        topology: Topology,
        pairs: &[robot::Output; MAX_FRAMES],
        anchors: &mut [Posture; MAX_FRAMES],
    ) -> Self {
        let mut fused = Self {
            topology,
            estimates: pairs[0],
            inner: [None; MAX_INNER],
        };
        if topology.frame_count() > 1 {
            fused.join(pairs, anchors);
        }
        fused
    }

    /// Estimates of a robot of two axles.
    #[cfg(test)]
    pub(super) fn of_pair(pair: robot::Output) -> Self {
        let anchors = &mut [Posture::ORIGIN; MAX_FRAMES];
        Self::new(Topology::PAIR, &[pair; MAX_FRAMES], anchors)
    }

    /// Joins several pairs.
    fn join(&mut self, pairs: &[robot::Output; MAX_FRAMES], anchors: &mut [Posture; MAX_FRAMES]) {
        let frames = self.topology.frame_count();
        let share = 1.0 / frames as f32;
        let mut axles = [Posture::ORIGIN; MAX_AXLES];
        axles[0] = anchors[0].compose(pairs[0].front.posture);
        let (mut off, mut covariance) = ([0.0; 3], [[0.0; 3]; 3]);
        let mut ends = [pairs[0].front.covariance; 2];
        let mut beam = &pairs[0].beam;
        // At first the chain begins at the front axle of the first pair.
        for (k, (pair, anchor)) in pairs.iter().zip(&*anchors).enumerate().take(frames) {
            let front = axles[k];
            let rear = front.compose(pair.rear.posture.relative_to(pair.front.posture));
            axles[k + 1] = rear;
            let at = anchor.compose(pair.robot.posture);
            off[0] += share * (at.x - 0.5 * (front.x + rear.x));
            off[1] += share * (at.y - 0.5 * (front.y + rear.y));
            off[2] += share * wrap_angle(anchor.phi + pair.front.posture.phi - front.phi);
            let (sin, cos) = sin_cos(anchor.phi);
            let turn = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]];
            let own = propagate(&turn, &pair.robot.covariance);
            covariance = add(&covariance, &scale(&own, share));
            if k == 0 {
                ends[0] = propagate(&turn, &pair.front.covariance);
            }
            ends[1] = propagate(&turn, &pair.rear.covariance);
            beam = worst_beam(beam, &pair.beam);
        }
        let own = axles.get_mut(..=frames).unwrap_or_default();
        let Posture { x, y, .. } = train::midpoint(own);
        let (sin, cos) = sin_cos(off[2]);
        for axle in &mut *own {
            let (dx, dy) = (axle.x - x, axle.y - y);
            *axle = Posture::new(
                x + off[0] + cos * dx - sin * dy,
                y + off[1] + sin * dx + cos * dy,
                wrap_angle(axle.phi + off[2]),
            );
        }
        for ((anchor, pair), axle) in anchors.iter_mut().zip(pairs).zip(&*own).take(frames) {
            *anchor = axle.compose(Posture::ORIGIN.relative_to(pair.front.posture));
        }
        let [first, .., rear] = own else { return };
        self.estimates = robot::Output {
            front: Estimate::new(*first, ends[0]),
            rear: Estimate::new(*rear, ends[1]),
            robot: Estimate::new(train::midpoint(own), covariance),
            beam: *beam,
            ipec: None,
            omega: None,
        };
        let between = own.get(1..frames).unwrap_or_default();
        self.inner
            .iter_mut()
            .zip(between)
            .for_each(|(to, from)| *to = Some(*from));
    }

    /// Estimate of the robot's posture: midpoint O and its heading.
    pub(super) fn robot(&self) -> &Estimate {
        &self.estimates.robot
    }

    /// Posture of an axle, by its index; beyond the last axle, the origin.
    pub(super) fn axle(&self, index: usize) -> Posture {
        match index {
            0 => self.estimates.front.posture,
            last if last == self.topology.frame_count() => self.estimates.rear.posture,
            _ => self
                .inner
                .get(index - 1)
                .copied()
                .flatten()
                .unwrap_or_default(),
        }
    }

    /// Relative heading of the two axles of a frame, by the frame's index.
    pub(super) fn bend(&self, frame: usize) -> RelativeHeading {
        RelativeHeading(wrap_angle(self.axle(frame).phi - self.axle(frame + 1).phi))
    }

    /// True if a filter rejected the measurement of its frame.
    pub(super) fn is_refused(&self) -> bool {
        self.estimates.beam.verdict == Verdict::Gated
    }
}

/// The worse of two updates: a rejected one, or that with the larger NIS.
fn worst_beam<'a>(a: &'a BeamUpdate, b: &'a BeamUpdate) -> &'a BeamUpdate {
    let rejected = |it: &BeamUpdate| it.verdict == Verdict::Gated;
    match (rejected(a), rejected(b)) {
        (true, false) => a,
        (false, true) => b,
        _ if b.nis > a.nis => b,
        _ => a,
    }
}
