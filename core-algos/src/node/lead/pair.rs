//! A pair of neighbouring axles and the frame between them: measurements of the frame, and the estimate of the pair.
//!
//! Frame i joins axles i and i + 1. The pattern `[pair]` marks code that needs a decision for several pairs, such as
//! the robot's posture; it compiles for one pair only.

use super::track::{Advance, AxleTrack, Recent};
use super::{AXLES, NIS_MOST, NIS_SHARE, Own, PAIRS};
use crate::fusion::Estimate;
use crate::fusion::ekf::Verdict;
use crate::fusion::estimator::EstimatorOutput;
use crate::fusion::robot::{self, PairAxle, RobotFusion};
use crate::math::matrix::{Mat3, propagate};
use crate::math::trig::sin_cos;
use crate::math::{Posture, Wrench};
use crate::time::{EPOCH, Micros, Stamped};

/// Age in epochs up to which a measurement of the frame is used.
const BEAM_EPOCHS: Micros = 3;

/// The two axles of a pair of neighbouring axles, front first, from a list of all axles.
pub(super) const fn neighbours<T>(axles: &[T; AXLES], pair: usize) -> [&T; 2] {
    [&axles[pair], &axles[pair + 1]]
}

/// Beam messages and fused estimate of a pair of neighbouring axles.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Pair {
    /// Latest posture of the frame's tip, as seen from its root.
    pub(super) posture: Option<Stamped<Posture>>,
    /// Latest covariance, possibly of another epoch.
    pub(super) uncertainty: Option<Stamped<Mat3>>,
    /// Measurements of the frame, by their epochs.
    pub(super) measured: Recent<Estimate>,
    /// Epoch of the latest measurement that was passed to the fusion, even if rejected, and the time of the passing.
    pub(super) used: Option<Stamped<Micros>>,
    /// Estimate of both axles; `None` before the start.
    pub(super) fusion: Option<robot::State>,
    /// Running mean of the normalised innovation squared (NIS) of the frame's measurements.
    pub(super) nis: f32,
    /// Latest wrench of the frame.
    pub(super) wrench: Option<Stamped<Wrench>>,
}

impl Pair {
    /// Combines posture and covariance of one epoch into a measurement.
    pub(super) fn complete(&mut self) {
        if let (Some(posture), Some(covariance)) = (self.posture, self.uncertainty)
            && posture.time == covariance.time
        {
            let measured = Estimate::new(posture.value, covariance.value);
            self.measured.put(Stamped::new(measured, posture.time));
        }
    }

    /// The latest measurement of the frame that the fusion has not received, with its own epoch, advanced by odometry
    /// to `epoch`; `None` if no such measurement is recent enough.
    pub(super) fn measurement(
        &self,
        epoch: Micros,
        axles: [&AxleTrack; 2],
    ) -> Option<Stamped<Estimate>> {
        let used = self.used.map_or(0, |used| used.time);
        // Usual case: a measurement of this epoch, without the copies below.
        if let (Some(measured), true) = (self.measured.at(epoch), epoch > used) {
            return Some(Stamped::new(measured, epoch));
        }
        let mut ages = (1..=BEAM_EPOCHS).map(|age| epoch.saturating_sub(age * EPOCH));
        let (time, measured) = ages.find_map(|time| Some((time, self.measured.at(time)?)))?;
        if time <= used {
            return None;
        }
        let [front, rear] = axles.map(|axle| axle.moved(time, epoch));
        let (front, rear) = (front?, rear?);
        let posture = measured.posture.compose(front).relative_to(rear);
        let (sin, cos) = sin_cos(rear.phi);
        let turn = [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]];
        let covariance = propagate(&turn, &measured.covariance);
        Some(Stamped::new(Estimate::new(posture, covariance), time))
    }

    /// Advances the estimate by the motion of the axles and a measurement of the frame. `restarted` is true for an
    /// axle whose odometry restarted. The estimates of a user's estimator replace those of the fusion.
    pub(super) fn step(
        &mut self,
        with: &RobotFusion,
        now: Micros,
        [front, rear]: [&Advance; 2],
        restarted: [bool; 2],
        beam: Option<Stamped<Estimate>>,
        own: &mut Own<'_>,
    ) -> robot::Output {
        let Some(fusion) = &mut self.fusion else {
            return robot::Output::default();
        };
        let known = match restarted {
            [false, true] => Some(PairAxle::Front),
            [true, false] => Some(PairAxle::Rear),
            _ => None,
        };
        let lost = restarted != [false; 2];
        let inputs = robot::Inputs {
            front: front.increment(rear),
            rear: rear.increment(front),
            // The frame may have bent by more than an update of the estimate can follow.
            beam: beam.map(|beam| beam.value).filter(|_| !lost),
        };
        if let Some(beam) = beam {
            self.used = Some(Stamped::new(now, beam.time));
        }
        let output = with.step(fusion, &inputs);
        let tested = matches!(output.beam.verdict, Verdict::Used | Verdict::Gated);
        if tested && fusion.joint().is_some() {
            self.nis += NIS_SHARE * (output.beam.nis.min(NIS_MOST) - self.nis);
        }
        let located = known.zip(beam).filter(|_| with.uses_beam());
        let output = match located {
            Some((axle, beam)) => with.rejoin(fusion, axle, &output, &beam.value),
            None => output,
        };
        let Some(estimator) = own.estimator.as_deref_mut() else {
            return output;
        };
        let stepped = estimator.step(&inputs);
        let found = located.and_then(|(axle, beam)| estimator.rejoin(axle, &beam.value));
        let EstimatorOutput { front, rear, robot } = found.unwrap_or(stepped);
        robot::Output {
            front,
            rear,
            robot,
            ..output
        }
    }
}

/// Fused estimates of an epoch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Fused {
    /// Output of the fusion for each pair of neighbouring axles, front first.
    pub(super) pairs: [robot::Output; PAIRS],
}

impl Fused {
    /// Estimate of the robot's posture: midpoint O and its heading.
    pub(super) fn robot(&self) -> &Estimate {
        let [pair] = &self.pairs;
        &pair.robot
    }

    /// Postures of the axles, front first: each from the pair behind the axle, the last one from the pair ahead.
    pub(super) fn axles(&self) -> [Posture; AXLES] {
        let last = &self.pairs[PAIRS - 1];
        core::array::from_fn(|axle| match self.pairs.get(axle) {
            Some(pair) => pair.front.posture,
            None => last.rear.posture,
        })
    }

    /// True if a filter rejected the measurement of its frame.
    pub(super) fn is_refused(&self) -> bool {
        let mut pairs = self.pairs.iter();
        pairs.any(|pair| pair.beam.verdict == Verdict::Gated)
    }

    /// True if the robot can drive by the estimates of a user's estimator.
    pub(super) fn is_sound(&self) -> bool {
        let mut pairs = self.pairs.iter().map(|pair| EstimatorOutput {
            front: pair.front,
            rear: pair.rear,
            robot: pair.robot,
        });
        pairs.all(|pair| pair.is_sound())
    }

    /// The estimates in the output of the lead node.
    pub(super) fn output(&self) -> robot::Output {
        let [pair] = self.pairs;
        pair
    }
}
