//! Conditions that the axle node watches, and its requests to the supervisor.
//!
//! # Requirements
//!
//! A condition counts after its time in [`crate::safety::condition`] and ends when its cause does. *Driving* is the
//! state *active*, *powered* any state with motors on. Each side of the axle by itself is enough.
//!
//! | cause | condition | beyond | while | reason |
//! |---|---|---|---|---|
//! | lead node's mode or this axle's reference too old, axle not released | `CommandTimeout` | 60 ms | driving | nobody steers |
//! | reference late | `MessageLost` | 30 ms | driving | three epochs are enough for node and bus |
//! | other axle's heartbeat too old | `NeighbourLost` | 50 ms | always | the other axle may be off |
//! | other axle or lead node stops for a reason | `NeighbourFault` | at once | powered | axles stop together |
//! | output or estimate not finite | `NotANumber` | at once | always | control cannot be trusted |
//! | encoder missing, or counts that jump | `EncoderFault` | at once | always | the wheel may run away undetected |
//! | far from the reference | `TrackingLost` | 0.08 m, 0.35 rad | driving | something holds or pushes the axle |
//! | twice as far from the ramp of a stop | `StopNotFollowed` | 0.16 m, 0.7 rad | stop, before the release | a motor stays on |
//! | a wheel that turns | `StopNotFollowed` | 5 rad/s | stop, during the release | a motor stays on |
//! | a wheel at standstill under high torque | `MotorStall` | from 0.6 of the torque, up to 0.2 rad/s | always | blocked |
//! | difference of the yaw rates by gyro and wheels | `WheelSlip` | 0.8 rad/s | always | a lifted wheel |
//! | a measurement refused since the last report | `MeasurementRefused` | at once | always | reported to the user |
//! | torque limited | `TorqueLimited` | at once | always | reported to the user |
//!
//! Requests by the lead node's mode, if no older than 60 ms; no request before the first mode:
//!
//! | state | mode | request |
//! |---|---|---|
//! | *boot* | any | `Ready` |
//! | *idle* | active or hold, with a reference, after a mode without driving | `Arm` |
//! | *armed* | active or hold | `Start` |
//! | *armed* | any other, or none | `Disarm` |
//! | *active* | idle or clear | `Disarm` |
//! | *fault* | clear | `Clear` |

use super::{AxleNode, LATE, LET_GO_RAD_S, Samples};
use crate::bus::LeadMode;
use crate::control::wheel_observer;
use crate::safety::{Condition, Conditions, OperatingState, Permit, StateRequest};
use crate::time::Micros;
use crate::topology::{Node, Side};

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
        let operating = state.supervisor.operating();
        let powered = operating.permit() != Permit::Off;
        let active = operating == OperatingState::Active;
        let astray =
            |times: f32| state.output.active && !self.limits.near(state.output.error, times);
        // A released axle may move, but must not be driven.
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
        let mut encoder_fault = false;
        for (wheel, side) in state.wheels.iter().zip(Side::BOTH) {
            let pushes = state.output.torque_nm[side].abs() >= self.stall_torque;
            stalled |= pushes && wheel.speed_rad_s.abs() <= self.limits.stall_rad_s;
            encoder_fault |= samples.encoder[side].is_none() || wheel.jumped;
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
        // A lead node that releases the axle sends no more references; this is no fault.
        let dismissed = state
            .mode
            .is_some_and(|mode| matches!(mode.value, LeadMode::Idle | LeadMode::Clear));
        let (lost, failed) = state
            .peers
            .others(Node::Axle(self.axle), self.topology, now);
        let failed = failed || state.peers.failed(Node::Lead, now);
        samples
            .conditions
            .with(
                Condition::CommandTimeout,
                active && !dismissed && self.reference(now).is_none(),
            )
            .with(Condition::NeighbourLost, lost)
            .with(Condition::NeighbourFault, powered && failed)
            .with(Condition::NotANumber, state.output.invalid || unsound)
            .with(Condition::EncoderFault, encoder_fault)
            .with(Condition::TrackingLost, active && astray(1.0))
            .with(Condition::StopNotFollowed, unstopped)
            .with(Condition::MotorStall, stalled)
            .with(Condition::WheelSlip, slips)
            .with(Condition::MeasurementRefused, state.refused > 0)
            .with(Condition::TorqueLimited, state.output.limited)
            .with(Condition::MessageLost, active && late)
    }
}

#[cfg(test)]
mod tests;
