//! Messages of other nodes, for tests.

use crate::bus::{LeadMode, Message};
use crate::math::Posture;
use crate::safety::supervisor;
use crate::safety::{Condition, Conditions, OperatingState, StateRequest};
use crate::time::{Micros, sequence};
use crate::topology::{AxleId, Node};

/// A heartbeat without notices.
pub(crate) fn beat(node: Node, now: Micros, state: OperatingState, reason: u8) -> Message {
    Message::NodeStatus {
        node,
        sequence: sequence(now),
        state,
        reason,
        notices: Conditions::NONE,
    }
}

/// Status of a lead node whose frame is straight.
pub(crate) fn lead_status(now: Micros, mode: LeadMode, velocity_m_s: f32) -> Message {
    Message::LeadStatus {
        sequence: sequence(now),
        mode,
        steering_rad: 0.0,
        velocity_m_s,
    }
}

/// Reference posture of an axle.
pub(crate) fn reference_posture(axle: AxleId, now: Micros, posture: Posture) -> Message {
    Message::ReferencePosture {
        axle,
        sequence: sequence(now),
        posture,
    }
}

/// Report of an axle that has been up for `uptime` epochs. `gyro_zeroed` is `None` for an axle without a gyro.
pub(crate) fn axle_report(
    axle: AxleId,
    now: Micros,
    posture: Posture,
    uptime: u8,
    gyro_zeroed: Option<bool>,
) -> [Message; 2] {
    let sequence = sequence(now);
    [
        Message::AxlePosture {
            axle,
            sequence,
            posture,
        },
        Message::AxleMotion {
            axle,
            sequence,
            velocity_m_s: 0.0,
            yaw_rate_rad_s: 0.0,
            refused: 0,
            gyro_samples: if gyro_zeroed.is_some() { 10 } else { 0 },
            gyro_zeroed: gyro_zeroed.unwrap_or(false),
            uptime,
        },
    ]
}

/// A supervisor in this state, without a present condition.
pub(crate) fn supervisor_in(state: OperatingState) -> supervisor::State {
    use StateRequest::{Arm, Disarm, Ready, Start};
    let supervisor = supervisor::Config::default().build().expect("the default");
    let mut at = supervisor::State::default();
    let requests: &[StateRequest] = match state {
        OperatingState::Boot | OperatingState::Fault => &[],
        OperatingState::Idle => &[Ready],
        OperatingState::Armed => &[Ready, Arm],
        OperatingState::Active => &[Ready, Arm, Start],
        OperatingState::SafeStop => &[Ready, Arm, Start, Disarm],
    };
    let fault = Conditions::NONE.with(Condition::DriverFault, state == OperatingState::Fault);
    let mut step = |request, conditions| {
        let input = supervisor::Input {
            conditions,
            request,
            ..supervisor::Input::default()
        };
        supervisor.step(&mut at, 0, &input);
    };
    step(None, fault);
    requests
        .iter()
        .for_each(|request| step(Some(*request), Conditions::NONE));
    assert_eq!(at.operating(), state);
    at
}

/// Conditions of a cause, a change beyond the limit of the cause, and a change just within the limit.
pub(crate) type Cause<T> = (&'static [Condition], fn(&mut T), fn(&mut T));

/// Asserts that each cause beyond its limit sets its conditions and that just within the limit it sets none, alone
/// and with every other cause. `sound` has no condition.
pub(crate) fn assert_watched<T: Clone>(
    sound: &T,
    causes: &[Cause<T>],
    watch: impl Fn(&T) -> Conditions,
) {
    let set = |conditions: &[Condition]| {
        let mut set = Conditions::NONE;
        conditions.iter().for_each(|it| set.set(*it, true));
        set
    };
    let after = |changes: &[fn(&mut T)]| {
        let mut changed = sound.clone();
        changes.iter().for_each(|change| change(&mut changed));
        watch(&changed)
    };
    assert_eq!(after(&[]), Conditions::NONE, "sound");
    for (k, (conditions, beyond, within)) in causes.iter().enumerate() {
        assert_eq!(
            after(&[*beyond]),
            set(conditions),
            "cause {k}: {conditions:?}"
        );
        assert_eq!(
            after(&[*within]),
            Conditions::NONE,
            "within {k}: {conditions:?}"
        );
        // With all other causes, this cause adds its conditions only beyond its limit.
        let others = causes.iter().filter(|(other, ..)| other != conditions);
        let mut changes: Vec<fn(&mut T)> = others.clone().map(|(_, beyond, _)| *beyond).collect();
        let expected = others.fold(Conditions::NONE, |all, (other, ..)| all.union(set(other)));
        changes.push(*within);
        assert_eq!(after(&changes), expected, "all but {k}: {conditions:?}");
        changes.pop();
        changes.push(*beyond);
        let all = expected.union(set(conditions));
        assert_eq!(after(&changes), all, "all with {k}: {conditions:?}");
    }
}
