//! Messages of the lead node: its status, and the references of the axles.

use super::fused::Fused;
use super::{LeadNode, Output, RELAXED_RAD, Task};
use crate::bus::{LeadMode, Message};
use crate::control::cascade::AxleReference;
use crate::control::governor;
use crate::math::Twist;
use crate::node::Outbox;
use crate::safety::{Permit, supervisor};
use crate::time::{Micros, epoch_start, seconds, sequence};

impl LeadNode {
    /// A step without a permit to drive: the motion comes to rest, and the status is sent.
    pub(super) fn idle(
        &mut self,
        now: Micros,
        fused: Option<&Fused>,
        supervision: supervisor::Output,
        outbox: &mut Outbox,
    ) -> Output {
        self.with.governor.stop(&mut self.state.governor);
        self.train.forget_curve();
        if let (Permit::Off, Some(fused)) = (supervision.permit, fused) {
            self.restart_governor_if_relaxed(fused);
        }
        let motion = self.state.governor.motion;
        let mode = match self.state.task {
            Task::Clear => LeadMode::Clear,
            _ => LeadMode::Idle,
        };
        outbox.push(Message::LeadStatus {
            sequence: sequence(now),
            mode,
            steering_rad: motion.psi.0,
            velocity_m_s: motion.v,
        });
        let mut output = Output {
            mode,
            motion,
            supervision,
            ..Output::default()
        };
        if let Some(fused) = fused {
            (output.fused, output.inner) = (fused.estimates, fused.inner);
        }
        output
    }

    /// Sends the status and the references of the axles.
    pub(super) fn send_references(
        &self,
        now: Micros,
        mode: LeadMode,
        references: &[AxleReference],
        fused: &Fused,
        outbox: &mut Outbox,
    ) {
        let sequence = sequence(now);
        let motion = &self.state.governor.motion;
        outbox.push(Message::LeadStatus {
            sequence,
            mode,
            steering_rad: motion.psi.0,
            velocity_m_s: motion.v,
        });
        let epoch = epoch_start(now, sequence);
        let known = self.tracks.iter().zip(references);
        for (axle, (track, reference)) in self.with.topology.axles().zip(known) {
            let Some(odometry) = track.odometry else {
                continue;
            };
            // The reference relative to the estimated axle, applied in the axle's own odometric frame.
            let estimate = fused.axle(axle.index());
            let mut relative = reference.posture.relative_to(estimate);
            // The estimate is of the latest epoch that all axles have reported.
            let age = epoch.saturating_sub(odometry.time);
            if age > 0 {
                let Twist { v, omega } = reference.twist;
                relative = relative.advance(v * seconds(age), omega * seconds(age));
            }
            outbox.push(Message::ReferencePosture {
                axle,
                sequence,
                posture: odometry.value.compose(relative),
            });
            outbox.push(Message::ReferenceMotion {
                axle,
                sequence,
                velocity_m_s: reference.twist.v,
                yaw_rate_rad_s: reference.twist.omega,
                acceleration_m_s2: reference.acceleration.v,
                yaw_acceleration_rad_s2: reference.acceleration.omega,
            });
        }
    }

    /// Without power the frame leaves the commanded steering angle: the next drive begins with the estimated angle.
    fn restart_governor_if_relaxed(&mut self, fused: &Fused) {
        let steering = fused.bend(0).steering();
        if !((steering.0 - self.state.governor.motion.psi.0).abs() <= RELAXED_RAD) {
            self.state.governor = governor::State::at_rest(steering);
        }
    }
}
