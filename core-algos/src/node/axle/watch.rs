//! Conditions that the axle node watches, and its requests to the supervisor.

use super::{AxleNode, LATE, LET_GO_RAD_S, Samples};
use crate::bus::LeadMode;
use crate::control::wheel_observer;
use crate::safety::{Condition, Conditions, OperatingState, Permit, StateRequest};
use crate::time::Micros;
use crate::topology::{AxleId, Node};

impl AxleNode {
    /// Request to this axle by the lead node's mode.
    pub(super) fn request(&self, now: Micros) -> Option<StateRequest> {
        let mode = self.state.mode?.fresh(now, self.reference_timeout).copied();
        let driving = matches!(mode, Some(LeadMode::Active | LeadMode::Hold));
        match self.state.supervisor.operating() {
            OperatingState::Boot => Some(StateRequest::Ready),
            // A board that starts while the robot drives stays off until the robot has stopped.
            OperatingState::Idle
                if driving && self.state.paused && self.reference(now).is_some() =>
            {
                Some(StateRequest::Arm)
            }
            OperatingState::Armed if driving => Some(StateRequest::Start),
            OperatingState::Armed => Some(StateRequest::Disarm),
            OperatingState::Active if matches!(mode, Some(LeadMode::Idle | LeadMode::Clear)) => {
                Some(StateRequest::Disarm)
            }
            OperatingState::Fault if mode == Some(LeadMode::Clear) => Some(StateRequest::Clear),
            _ => None,
        }
    }

    /// Conditions present at this tick.
    pub(super) fn watch(&self, now: Micros, samples: &Samples) -> Conditions {
        let state = &self.state;
        let other = match self.axle {
            AxleId::Front => Node::RearAxle,
            AxleId::Rear => Node::FrontAxle,
        };
        let operating = state.supervisor.operating();
        let powered = operating.permit() != Permit::Off;
        let active = operating == OperatingState::Active;
        let astray =
            |times: f32| state.output.active && !self.limits.near(state.output.error, times);
        // An axle that is let go is not to stay, but it is not to be driven either.
        let runs = |wheel: &wheel_observer::State| !(wheel.speed_rad_s.abs() <= LET_GO_RAD_S);
        let unstopped = operating == OperatingState::SafeStop
            && state
                .stop
                .as_ref()
                .is_some_and(|stop| match stop.hold < 1.0 {
                    true => state.wheels.iter().any(runs),
                    false => astray(2.0),
                });
        let mut stalled = false;
        let mut blind = false;
        for i in 0..2 {
            let wheel = &state.wheels[i];
            let pushes = state.output.torque_nm[i].abs() >= self.stall_torque;
            stalled |= pushes && wheel.speed_rad_s.abs() <= self.limits.stall_rad_s;
            blind |= samples.encoder[i].is_none() || wheel.jumped;
        }
        let by_wheels = self.wheel_radius * 0.5 / self.half_track
            * (state.wheels[1].speed_rad_s - state.wheels[0].speed_rad_s);
        let slips = samples
            .gyro_rad_s
            .is_some_and(|rate| (rate - by_wheels).abs() > self.limits.slip_rad_s);
        let unsound = !state.filter.posture().is_finite();
        let late = state
            .reference
            .is_none_or(|reference| reference.age(now) > LATE);
        // A lead node that lets the axle go sends no more references, and that is no fault.
        let dismissed = state
            .mode
            .is_some_and(|mode| matches!(mode.value, LeadMode::Idle | LeadMode::Clear));
        let failed = state.peers.failed(other, now) || state.peers.failed(Node::Lead, now);
        samples
            .conditions
            .with(
                Condition::CommandTimeout,
                active && !dismissed && self.reference(now).is_none(),
            )
            .with(Condition::NeighbourLost, state.peers.lost(other, now))
            .with(Condition::NeighbourFault, powered && failed)
            .with(Condition::NotANumber, state.output.invalid || unsound)
            .with(Condition::EncoderFault, blind)
            .with(Condition::TrackingLost, active && astray(1.0))
            .with(Condition::StopNotFollowed, unstopped)
            .with(Condition::MotorStall, stalled)
            .with(Condition::WheelSlip, slips)
            .with(Condition::MeasurementRefused, state.refused > 0)
            .with(Condition::TorqueLimited, state.output.limited)
            .with(Condition::MessageLost, active && late)
    }
}
