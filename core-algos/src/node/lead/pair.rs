//! A pair of neighbouring axles and the frame between them: measurements of the frame, and the estimate of the pair.
//!
//! Frame i joins axles i and i + 1. Each pair has a fusion of its own, and an inner axle is in two pairs. See
//! [`Fused`](super::fused::Fused) for the estimate of the whole robot.

use super::track::{Advance, AxleTrack, Recent};
use super::{NIS_MOST, NIS_SHARE, Own};
use crate::control::train::spacing::Link;
use crate::fusion::Estimate;
use crate::fusion::ekf::Verdict;
use crate::fusion::estimator::EstimatorOutput;
use crate::fusion::robot::{self, Load, PairAxle, RobotFusion};
use crate::math::matrix::{Mat3, propagate};
use crate::math::trig::{sin_cos, wrap_angle};
use crate::math::{Posture, RelativeHeading, Wrench};
use crate::time::{EPOCH, Micros, Stamped};

/// Age in epochs up to which a measurement of the frame is used.
const BEAM_EPOCHS: Micros = 3;

/// The two axles of each pair of neighbouring axles, front first, from a list of all axles.
pub(super) fn neighbours<T>(axles: &[T]) -> impl Iterator<Item = [&T; 2]> {
    axles.array_windows().map(|[front, rear]| [front, rear])
}

/// Bend of a frame: its moments on the axles over EI/L, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bend {
    /// Mean of both moments: the relative heading of the axles.
    pub(super) mean: f32,
    /// Half the moment on the front axle less half that on the rear axle.
    pub(super) uneven: f32,
    /// Force on the front axle, to its left, over EI/L, rad/m; that on the rear axle is opposite.
    pub(super) shear: f32,
}

impl Bend {
    /// A straight frame, or none.
    pub(super) const NONE: Self = Self {
        mean: 0.0,
        uneven: 0.0,
        shear: 0.0,
    };

    /// Bend of a frame whose front axle is at `relative` from its rear axle.
    pub(super) fn new(frame: &Link, relative: Posture) -> Self {
        let uneven = frame.uneven_bend(relative);
        Self {
            mean: relative.phi,
            uneven,
            // Balance of the moments about an axle.
            shear: 2.0 * uneven / frame.straight(),
        }
    }

    /// Loads of the front and the rear axle besides pure bending of this frame, with the frames ahead and behind.
    pub(super) fn loads(&self, ahead: &Self, behind: &Self) -> [Load; 2] {
        // The moment of a frame on its front axle is opposite to its moment on its rear axle.
        [
            Load {
                unloaded: RelativeHeading(ahead.mean - ahead.uneven - self.uneven),
                aside: self.shear - ahead.shear,
            },
            Load {
                unloaded: RelativeHeading(behind.mean + behind.uneven + self.uneven),
                aside: behind.shear - self.shear,
            },
        ]
    }
}

/// Beam messages and fused estimate of a pair of neighbouring axles.
#[derive(Clone, Debug, PartialEq)]
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
    /// Bend of the frame at the latest estimate.
    pub(super) bend: Bend,
    /// Midpoint of the pair at the latest estimate; `None` before it.
    pub(super) middle: Option<Posture>,
    /// Correction of the midpoint by the latest estimate: the change that odometry did not report (m, m, rad).
    pub(super) corrected: [f32; 3],
}

impl Pair {
    /// A pair without messages and without estimate.
    pub(super) const EMPTY: Self = Self {
        posture: None,
        uncertainty: None,
        measured: Recent::EMPTY,
        used: None,
        fusion: None,
        nis: 0.0,
        wrench: None,
        bend: Bend::NONE,
        middle: None,
        corrected: [0.0; 3],
    };

    /// Combines posture and covariance into a measurement. The covariance comes every `epochs` epochs: with 1 it must be
    /// of the posture's epoch, otherwise it may be older, also if one is lost.
    pub(super) fn complete(&mut self, epochs: u8) {
        let oldest = (2 * Micros::from(epochs) - 1) * EPOCH;
        if let (Some(posture), Some(covariance)) = (self.posture, self.uncertainty)
            && (posture.time == covariance.time
                || epochs > 1
                    && posture.time > covariance.time
                    && posture.time - covariance.time <= oldest)
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

    /// Advances the estimate by the reports of an epoch. The estimates of a user's estimator replace those of the
    /// fusion.
    pub(super) fn step(
        &mut self,
        with: &RobotFusion,
        now: Micros,
        reports: &PairReports<'_>,
        own: &mut Own<'_>,
    ) -> robot::Output {
        let &PairReports {
            motion: [front, rear],
            restarted,
            beam,
            loads,
        } = reports;
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
            loads,
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
        let (_, moved) = fusion.moved();
        let middle = output.robot.posture;
        let [x, y, turn] = middle.minus(self.middle.unwrap_or(middle));
        self.corrected = [x - moved.x, y - moved.y, wrap_angle(turn - moved.phi)];
        self.middle = Some(middle);
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

/// Reports of an epoch for one pair of neighbouring axles.
pub(super) struct PairReports<'a> {
    /// Motion of the two axles, front first.
    pub(super) motion: [&'a Advance; 2],
    /// True for an axle whose odometry restarted.
    pub(super) restarted: [bool; 2],
    /// Measurement of the frame.
    pub(super) beam: Option<Stamped<Estimate>>,
    /// Loads of the front and the rear axle besides pure bending of their frame.
    pub(super) loads: [Load; 2],
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Epochs since the latest covariance for which postures become measurements.
    fn used(epochs: u8) -> Vec<Micros> {
        let mut pair = Pair::EMPTY;
        let epoch = |k: Micros| 1_000_000 + k * EPOCH;
        let covariance = [[1e-6; 3]; 3];
        pair.uncertainty = Some(Stamped::new(covariance, epoch(0)));
        let ages = (0..20).filter(|age| {
            pair.posture = Some(Stamped::new(Posture::ORIGIN, epoch(*age)));
            pair.complete(epochs);
            let measured = pair.measured.at(epoch(*age));
            measured.is_some_and(|measured| measured.covariance == covariance)
        });
        ages.collect()
    }

    /// The sums of the wrenches of the frames on both sides of an axle.
    #[test]
    fn loads_of_a_pair_are_those_of_the_frames_on_its_axles() {
        let frame = Link {
            length_m: 0.37,
            rigid_end_m: 0.02,
        };
        let shapes = [(0.03, 0.1), (-0.02, -0.25), (0.04, 0.3)];
        let shapes = shapes.map(|(y, phi)| Posture::new(0.405, y, phi));
        let bends = shapes.map(|shape| Bend::new(&frame, shape));
        let wrenches = shapes.map(|shape| Wrench::cubic(0.37, 0.37, 0.02, shape));
        let on_front = |k: usize| wrenches[k].on_front(shapes[k], 0.02);
        let on_rear = |k: usize| wrenches[k].on_rear(0.02);
        let [ahead, own, behind] = bends;
        let front = on_front(1).plus(on_rear(0));
        let rear = on_rear(1).plus(on_front(2));
        let loads = own.loads(&ahead, &behind);
        for (load, wrench, sign) in [(loads[0], front, -1.0), (loads[1], rear, 1.0)] {
            let turning = sign * (own.mean - load.unloaded.0);
            let [a, b] = [turning, wrench.moment];
            assert!((a - b).abs() < 0.05 * b.abs(), "{a} {b}");
            let [a, b] = [load.aside, wrench.lateral];
            assert!((a - b).abs() < 0.1 * b.abs(), "{a} {b}");
        }
        // On a circle the frames of an inner axle cancel, and no axle is pushed aside.
        let arc = Bend::new(&frame, Posture::new(0.40, 0.4 * 0.1f32.tan(), 0.2));
        let [front, rear] = arc.loads(&arc, &Bend::NONE);
        assert!((front.unloaded.0 - arc.mean).abs() < 1e-6, "{front:?}");
        assert!(
            front.aside.abs() < 1e-5 && rear.aside.abs() < 1e-5,
            "{rear:?}"
        );
    }

    /// A covariance every fifth epoch serves nine more, so that one may be lost; each epoch's own serves that epoch.
    #[test]
    fn covariance_serves_until_the_second_next_one_is_due() {
        assert_eq!(used(1), [0]);
        assert_eq!(used(5), (0..10).collect::<Vec<_>>());
    }
}
