//! Conditions that the lead node watches, and its requests to the supervisor.
//!
//! # Requirements
//!
//! A condition counts after its time in [`crate::safety::condition`] and ends when its cause does. *Powered* is any
//! state with motors on. Each axle and each pair by itself is enough.
//!
//! | cause | condition | beyond | while | reason |
//! |---|---|---|---|---|
//! | an axle's heartbeat too old | `NeighbourLost` | 50 ms | always | the axle may be off |
//! | no estimate, as an axle's reports are too old or the axle has just restarted | `NeighbourLost` | 50 ms, at once | powered | nothing to drive by |
//! | an axle stops for a reason | `NeighbourFault` | at once | powered | axles stop together |
//! | an axle that does not arm | `NeighbourFault` | 300 ms after arming | powered | it would be dragged along |
//! | an axle's posture late | `MessageLost` | 20 ms | powered | two epochs are enough for the bus |
//! | no posture of the beam was used | `BeamLost` | 100 ms | a fusion that uses the beam | the estimate gets worse |
//! | bend of the frame by the beam or, without the beam, by the estimate | `FrameBent` | steering of 0.7 rad | always | the strip yields |
//! | wrench of a frame that is bent by more than 0.05 rad | `WrenchHigh` | 25 N, 6 N m | a wrench no older than 50 ms | a blocked wheel |
//! | estimate not finite, or estimate of a user's estimator not sound | `NotANumber` | at once | always | control cannot be trusted |
//! | posture of the beam refused | `EstimateInconsistent` | at once | *active* | a wheel or gauge is wrong, or wheels climb |
//! | estimate too uncertain | `EstimateVague` | 5 m, 0.5 rad | always | reported to the user |
//! | task done, but the 95 % ellipse too large or a sensor inconsistent | `ReachedUncertain` | tolerance of the task | done | the goal may be missed |
//! | constants far from their calibration | `WheelsInconsistent`, `GaugesInconsistent`, `GyrosInconsistent` | see [`InconsistentSensor`] | always | reported to the user |
//! | running mean of the beam's NIS | `BeamInconsistent` | 3.0 | always | reported to the user |
//! | no speed command, or host lost | `CommanderSilent` | 200 ms, at once | driven by hand; always | nobody steers |
//! | task without success; output of a user's controller not finite: `GaveUp` | `GaveUp`, `NoProgress` | at once | until the next task | the user decides |
//! | far from path or trajectory | `PathLost` | largest deviation | on a path | the robot drives elsewhere |
//!
//! Requests; a robot *rests* without a task or once it has been held for too long:
//!
//! | state | and | request |
//! |---|---|---|
//! | *boot* | | `Ready` |
//! | *idle* | a task | `Arm` |
//! | *armed*, *active* | rests | `Disarm` |
//! | *armed* | a task that is not over, all axles at rest (0.02 m/s, 0.1 rad/s), beam not refused | `Start` |
//! | *active* | task done; or failed, and the commanded speed is zero | `Finish` |
//! | *fault* | task `Clear` | `Clear` |

use super::fused::Fused;
use super::pair::Pair;
use super::track::AxleTrack;
use super::{ARMING, BEAM_PATIENCE, LATE, LeadNode, NIS_LIMIT, STILL, Task};
use crate::fusion::Estimate;
use crate::fusion::joint::InconsistentSensor;
use crate::math::matrix::is_finite;
use crate::math::trig::sqrt;
use crate::math::{RelativeHeading, Twist};
use crate::safety::{Condition, Conditions, OperatingState, Permit, StateRequest};
use crate::time::Micros;
use crate::topology::Node;

/// Relative heading up to which the wrench of the strip is not used.
const STRAIGHT: RelativeHeading = RelativeHeading(0.05);

/// Conditions in which the estimate of a pair of axles may be wrong.
const INCONSISTENT: Conditions = Conditions::NONE
    .with(Condition::WheelsInconsistent, true)
    .with(Condition::GaugesInconsistent, true)
    .with(Condition::GyrosInconsistent, true)
    .with(Condition::BeamInconsistent, true);

impl LeadNode {
    /// Handles the loss of the commanding host: a robot that drives stops, and its task is not done.
    pub fn on_host_lost(&mut self) {
        if !matches!(self.state.task, Task::Idle | Task::Stop | Task::Clear)
            && !self.state.is_over()
        {
            self.command(Task::Stop);
            self.state.lost = true;
        }
    }

    /// Request of the task to the supervisor.
    pub(super) fn request(&self, fused: Option<&Fused>) -> Option<StateRequest> {
        let state = &self.state;
        let resting = state.released || matches!(state.task, Task::Idle | Task::Clear);
        match state.supervisor.operating() {
            OperatingState::Boot => Some(StateRequest::Ready),
            OperatingState::Idle if !resting => Some(StateRequest::Arm),
            OperatingState::Armed | OperatingState::Active if resting => Some(StateRequest::Disarm),
            OperatingState::Armed if !state.is_over() && self.still(fused) => {
                Some(StateRequest::Start)
            }
            OperatingState::Active if state.done => Some(StateRequest::Finish),
            OperatingState::Active if state.failed.is_some() && state.governor.motion.v == 0.0 => {
                Some(StateRequest::Finish)
            }
            OperatingState::Fault if state.task == Task::Clear => Some(StateRequest::Clear),
            _ => None,
        }
    }

    /// True if the axles are at rest and no measurement of the beam was rejected.
    fn still(&self, fused: Option<&Fused>) -> bool {
        let at_rest = |track: &AxleTrack| {
            let Twist { v, omega } = track.report.twist;
            v.abs() <= STILL.v && omega.abs() <= STILL.omega
        };
        self.tracks.iter().all(at_rest) && fused.is_some_and(|fused| !fused.is_refused())
    }

    /// True if the 95 % ellipse around an estimate lies within the tolerance of the goal or target. False for a vague
    /// estimate, which is beyond the range of the linearised filter.
    fn is_certain(&self, robot: &Estimate) -> bool {
        let state = &self.state;
        let [position, heading] = robot.half_axes_95();
        let at = robot.posture;
        let [x, y, turn] = at.minus(state.aim.unwrap_or(at));
        let off = sqrt(x * x + y * y);
        let errors = [off + position, turn.abs() + heading];
        !self.with.limits.is_vague(robot) && state.task.within().holds(errors)
    }

    /// Conditions present at this step; `fused` is `None` without the axles' reports.
    pub(super) fn watch(&self, now: Micros, fused: Option<&Fused>) -> Conditions {
        let state = &self.state;
        let operating = state.supervisor.operating();
        let powered = operating.permit() != Permit::Off;
        let topology = self.with.topology;
        let (lost, stopped) = state.peers.others(Node::Lead, topology, now);
        let mut axles = topology.axles().map(Node::Axle);
        let unarmed = state.armed > ARMING && axles.any(|node| state.peers.rests(node, now));
        let reports = self.tracks.iter().map(|track| track.report.whole);
        let late = powered
            && reports
                .flatten()
                .any(|(posture, _)| posture.age(now) > LATE);
        let mut pairs = Conditions::NONE;
        for (i, pair) in self.pairs.iter().enumerate() {
            let bend = fused.map(|fused| fused.bend(i));
            pairs = pairs.union(self.watch_pair(now, pair, bend));
        }
        let robot = fused.map(Fused::robot);
        let unsound =
            robot.is_some_and(|robot| !(robot.posture.is_finite() && is_finite(&robot.covariance)));
        let vague = robot.is_some_and(|robot| self.with.limits.is_vague(robot));
        // Wheels may slip while a swinging frame is brought to rest, before the drive.
        let driving = operating == OperatingState::Active;
        let refused = driving && fused.is_some_and(Fused::is_refused);
        let uncertain = state.done
            && (!pairs.both(INCONSISTENT).is_empty()
                || robot.is_some_and(|robot| !self.is_certain(robot)));
        let failed = state.failed;
        pairs
            .with(
                Condition::NeighbourLost,
                lost || (powered && fused.is_none()),
            )
            .with(Condition::NeighbourFault, powered && (stopped || unarmed))
            .with(Condition::MessageLost, late)
            .with(Condition::NotANumber, unsound || state.unsound)
            .with(Condition::EstimateInconsistent, refused)
            .with(Condition::EstimateVague, vague)
            .with(Condition::ReachedUncertain, uncertain)
            .with(Condition::CommanderSilent, state.is_silent())
            // With `NotANumber`, of class cut, the robot could not brake.
            .with(
                Condition::GaveUp,
                matches!(failed, Some(Condition::GaveUp | Condition::NotANumber)),
            )
            .with(Condition::NoProgress, failed == Some(Condition::NoProgress))
            .with(Condition::PathLost, self.path_task.is_lost())
    }

    /// Conditions of a pair of neighbouring axles, with their estimated relative heading `bend`.
    // Not inlined: in the loop over the pairs its values would pass over the stack.
    #[inline(never)]
    fn watch_pair(&self, now: Micros, pair: &Pair, bend: Option<RelativeHeading>) -> Conditions {
        let fresh = |time: Micros| now.saturating_sub(time) <= self.with.report_timeout;
        let beam = pair.posture.filter(|posture| fresh(posture.time));
        // The bend is that of the beam's measurement, or of the axles' estimates if there is no measurement.
        let heading = beam
            .map(|posture| RelativeHeading(posture.value.phi))
            .or(bend);
        // The fit of a straight strip has a second minimum, buckled, to which drift of the gauges' zeros may lead.
        let curved = heading.is_some_and(|heading| !(heading.0.abs() <= STRAIGHT.0));
        // A measurement too late to be used counts as missing.
        let missed = match pair.fusion {
            None => beam.is_none(),
            Some(_) => pair
                .used
                .is_none_or(|used| now.saturating_sub(used.value) > BEAM_PATIENCE),
        };
        let strained = curved
            && pair.wrench.is_some_and(|wrench| {
                fresh(wrench.time) && self.with.limits.exceeded_by(&wrench.value)
            });
        let bent = heading
            .is_some_and(|heading| !(heading.steering().0.abs() <= self.with.limits.bend_rad));
        let inconsistent = pair
            .fusion
            .as_ref()
            .and_then(|fusion| self.with.fusion.inconsistent_sensor(fusion));
        Conditions::NONE
            .with(Condition::BeamLost, self.with.fusion.uses_beam() && missed)
            .with(Condition::FrameBent, bent)
            .with(Condition::WrenchHigh, strained)
            .with(
                Condition::WheelsInconsistent,
                inconsistent == Some(InconsistentSensor::Wheels),
            )
            .with(
                Condition::GaugesInconsistent,
                inconsistent == Some(InconsistentSensor::Gauges),
            )
            .with(
                Condition::GyrosInconsistent,
                inconsistent == Some(InconsistentSensor::Gyros),
            )
            .with(Condition::BeamInconsistent, !(pair.nis <= NIS_LIMIT))
    }
}

#[cfg(test)]
mod tests;
