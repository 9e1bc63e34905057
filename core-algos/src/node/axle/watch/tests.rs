use super::super::{Config, FrameProperties, Stop};
use super::*;
use crate::control::cascade::AxleReference;
use crate::math::{Posture, Steering};
use crate::node::testing::{Cause, assert_watched, beat, supervisor_in};
use crate::time::Stamped;
use crate::topology::{AxleId, Side, Topology, Wheels};

const FRAME: FrameProperties = FrameProperties {
    bending_stiffness_n_m2: 0.833,
    length_m: 0.37,
    rigid_end_m: 0.0,
};
const NOW: Micros = 1_000_000;

/// A node, its samples, and its time.
#[derive(Clone)]
struct Watched {
    node: AxleNode,
    samples: Samples,
}

impl Watched {
    fn conditions(&self) -> Conditions {
        self.node.watch(NOW, &self.samples)
    }

    fn receive_heartbeat(&mut self, node: Node, ago: Micros, state: OperatingState, reason: u8) {
        let time = NOW - ago;
        let message = beat(node, time, state, reason);
        self.node.state.peers.receive(time, &message);
    }

    fn age(&mut self, reference: Micros) {
        let value = AxleReference::default();
        self.node.state.reference = Some(Stamped::new(value, NOW - reference));
    }

    fn mode(&mut self, mode: LeadMode, ago: Micros) {
        self.node.state.mode = Some(Stamped::new(mode, NOW - ago));
    }

    fn error(&mut self, x: f32, y: f32, phi: f32) {
        self.node.state.output.error = Posture::new(x, y, phi);
    }

    fn wheels(&mut self, left: f32, right: f32) {
        for (wheel, speed) in self.node.state.wheels.iter_mut().zip([left, right]) {
            wheel.speed_rad_s = speed;
        }
    }

    /// Sets a wheel's torque to this share of the largest torque, and sets the wheel's speed.
    fn pushes(&mut self, wheel: usize, share: f32, speed_rad_s: f32) {
        let most = Config::default().controller.max_torque_nm;
        self.node.state.output.torque_nm[Side::BOTH[wheel]] = share * most;
        self.node.state.wheels[wheel].speed_rad_s = speed_rad_s;
    }
}

/// A node that drives without conditions.
fn driving() -> Watched {
    in_state(AxleId(0), OperatingState::Active)
}

fn in_state(axle: AxleId, state: OperatingState) -> Watched {
    let node = Config::default()
        .build(axle, Topology::PAIR, FRAME)
        .unwrap();
    let samples = Samples {
        encoder: Wheels::both(Some(0)),
        gyro_rad_s: Some(0.0),
        acceleration_m_s2: Some(0.0),
        conditions: Conditions::NONE,
    };
    let mut watched = Watched { node, samples };
    watched.node.state.supervisor = supervisor_in(state);
    watched.node.state.output.active = true;
    watched.node.state.paused = true;
    for node in [Node::axle(0), Node::axle(1), Node::Lead] {
        watched.receive_heartbeat(node, 0, OperatingState::Active, 0);
    }
    watched.age(0);
    watched.mode(LeadMode::Active, 0);
    watched
}

/// Causes of the requirements table while the axle drives. Limits: 60, 30 and 50 ms; 0.08 m and 0.35 rad; 0.6 of the
/// torque at 0.2 rad/s; 0.8 rad/s, less the yaw rate of the pushed wheels.
const WHILE_DRIVING: &[Cause<Watched>] = {
    use Condition::{
        CommandTimeout, EncoderFault, MeasurementRefused, MessageLost, MotorStall, NeighbourFault,
        NeighbourLost, NotANumber, SupplyLow, TorqueLimited, TrackingLost, WheelSlip,
    };
    &[
        (
            &[CommandTimeout],
            |w| w.mode(LeadMode::Active, 60_001),
            |w| w.mode(LeadMode::Active, 60_000),
        ),
        (&[MessageLost], |w| w.age(30_001), |w| w.age(30_000)),
        (&[MessageLost], |w| w.age(60_000), |w| w.age(30_000)),
        (
            &[NeighbourLost],
            |w| w.receive_heartbeat(Node::axle(1), 50_001, OperatingState::Active, 0),
            |w| w.receive_heartbeat(Node::axle(1), 50_000, OperatingState::Active, 0),
        ),
        (
            &[NeighbourFault],
            |w| w.receive_heartbeat(Node::Lead, 0, OperatingState::Fault, 0x80),
            |w| w.receive_heartbeat(Node::Lead, 0, OperatingState::Active, 0x80),
        ),
        (
            &[NeighbourFault],
            |w| w.receive_heartbeat(Node::Lead, 0, OperatingState::SafeStop, 0x80),
            |w| w.receive_heartbeat(Node::Lead, 50_001, OperatingState::SafeStop, 0x80),
        ),
        (
            &[NotANumber],
            |w| w.node.state.output.invalid = true,
            |_| {},
        ),
        (
            &[NotANumber],
            |w| w.node.state.filter.shift([f32::NAN, 0.0]),
            |_| {},
        ),
        (
            &[EncoderFault],
            |w| w.samples.encoder.left = None,
            |w| w.samples.encoder.left = Some(7),
        ),
        (
            &[EncoderFault],
            |w| w.samples.encoder.right = None,
            |w| w.samples.encoder.right = Some(7),
        ),
        (
            &[EncoderFault],
            |w| w.node.state.wheels[0].jumped = true,
            |_| {},
        ),
        (
            &[EncoderFault],
            |w| w.node.state.wheels[1].jumped = true,
            |_| {},
        ),
        (
            &[TrackingLost],
            |w| w.error(0.0801, 0.0, 0.0),
            |w| w.error(0.0799, 0.0, 0.0),
        ),
        (
            &[TrackingLost],
            |w| w.error(0.0, -0.0801, 0.0),
            |w| w.error(0.0, -0.0799, 0.0),
        ),
        (
            &[TrackingLost],
            |w| w.error(0.0, 0.0, 0.351),
            |w| w.error(0.0, 0.0, 0.349),
        ),
        (
            &[TrackingLost],
            |w| w.error(f32::NAN, 0.0, 0.0),
            |w| w.error(0.08, 0.08, 0.35),
        ),
        (
            &[MotorStall],
            |w| w.pushes(0, 0.6, 0.2),
            |w| w.pushes(0, 0.599, 0.2),
        ),
        (
            &[MotorStall],
            |w| w.pushes(1, 0.61, 0.0),
            |w| w.pushes(1, 0.61, 0.201),
        ),
        (
            &[MotorStall],
            |w| w.pushes(0, -0.61, -0.2),
            |w| w.pushes(0, -0.61, -0.201),
        ),
        (
            &[WheelSlip],
            |w| w.samples.gyro_rad_s = Some(0.9),
            |w| w.samples.gyro_rad_s = Some(0.7),
        ),
        (
            &[WheelSlip],
            |w| w.samples.gyro_rad_s = Some(-0.9),
            |w| w.samples.gyro_rad_s = None,
        ),
        (
            &[MeasurementRefused],
            |w| w.node.state.refused = 1,
            |w| w.node.state.refused = 0,
        ),
        (
            &[TorqueLimited],
            |w| w.node.state.output.limited = true,
            |_| {},
        ),
        (
            &[SupplyLow],
            |w| w.samples.conditions.set(SupplyLow, true),
            |_| {},
        ),
    ]
};

#[test]
fn each_cause_brings_its_condition_alone_and_among_all_others() {
    assert_watched(&driving(), WHILE_DRIVING, Watched::conditions);
}

#[test]
fn a_reference_beyond_its_timeout_is_late_as_well() {
    let expected = Conditions::only(Condition::CommandTimeout).with(Condition::MessageLost, true);
    let spoils: [fn(&mut Watched); 2] = [|w| w.age(60_001), |w| w.node.state.reference = None];
    for spoil in spoils {
        let mut watched = driving();
        spoil(&mut watched);
        assert_eq!(watched.conditions(), expected);
        // A lead node that releases the axle sends no references.
        for mode in [LeadMode::Idle, LeadMode::Clear] {
            watched.mode(mode, 0);
            let late = Conditions::only(Condition::MessageLost);
            assert_eq!(watched.conditions(), late, "{mode:?}");
        }
        watched.mode(LeadMode::Hold, 0);
        assert_eq!(watched.conditions(), expected);
    }
}

/// Each axle watches the other one and not itself.
#[test]
fn neighbour_conditions_come_from_the_other_axle() {
    for (axle, own, other) in [
        (AxleId(0), Node::axle(0), Node::axle(1)),
        (AxleId(1), Node::axle(1), Node::axle(0)),
    ] {
        let sound = in_state(axle, OperatingState::Active);
        for (node, lost, fault) in [(own, false, false), (other, true, true)] {
            let mut silent = sound.clone();
            silent.receive_heartbeat(node, 50_001, OperatingState::Active, 0);
            let found = silent.conditions();
            assert_eq!(found, Conditions::NONE.with(Condition::NeighbourLost, lost));
            let mut stopped = sound.clone();
            stopped.receive_heartbeat(node, 0, OperatingState::SafeStop, 0x80);
            let found = stopped.conditions();
            assert_eq!(
                found,
                Conditions::NONE.with(Condition::NeighbourFault, fault)
            );
        }
    }
}

/// Conditions of driving occur in the state *active* only, conditions of power in each state with motors on.
#[test]
fn driving_and_powered_conditions_occur_in_their_states_alone() {
    use OperatingState::{Active, Armed, Boot, Fault, Idle, SafeStop};
    for state in OperatingState::ALL {
        let found = |spoil: fn(&mut Watched), condition| {
            let mut watched = in_state(AxleId(0), state);
            spoil(&mut watched);
            watched.conditions().contains(condition)
        };
        let driving = state == Active;
        assert_eq!(found(|w| w.age(60_001), Condition::CommandTimeout), driving);
        assert_eq!(found(|w| w.age(60_001), Condition::MessageLost), driving);
        assert_eq!(
            found(|w| w.error(1.0, 0.0, 0.0), Condition::TrackingLost),
            driving
        );
        let inactive = |w: &mut Watched| {
            w.error(1.0, 0.0, 0.0);
            w.node.state.output.active = false;
        };
        assert!(!found(inactive, Condition::TrackingLost));
        let powered = matches!(state, Armed | Active | SafeStop);
        assert_eq!(!powered, matches!(state, Boot | Idle | Fault));
        let fault = |w: &mut Watched| w.receive_heartbeat(Node::axle(1), 0, Fault, 0x80);
        assert_eq!(
            found(fault, Condition::NeighbourFault),
            powered,
            "{state:?}"
        );
        assert!(found(
            |w| w.samples.encoder.left = None,
            Condition::EncoderFault
        ));
        let silent = |w: &mut Watched| w.receive_heartbeat(Node::axle(1), 50_001, Active, 0);
        assert!(found(silent, Condition::NeighbourLost));
    }
}

/// Limits: 0.16 m and 0.7 rad from the ramp, and wheels at 5 rad/s during the release.
#[test]
fn stop_that_is_not_followed_is_reported_during_the_stop() {
    let stopping = |hold: f32, spoil: &dyn Fn(&mut Watched)| {
        let mut watched = in_state(AxleId(1), OperatingState::SafeStop);
        let ramp = watched.node.ramp;
        watched.node.state.stop = Some(Stop {
            ramp: ramp.begin(Posture::ORIGIN, 0.0, Steering::STRAIGHT, 0.37),
            hold,
            held_nm: 0.0,
        });
        spoil(&mut watched);
        watched
    };
    let unstopped = Condition::StopNotFollowed;
    for (hold, by_error, by_speed) in [(1.0, true, false), (0.999, false, true), (0.0, false, true)]
    {
        for (x, phi, far) in [(0.159, 0.69, false), (-0.161, 0.0, true), (0.0, 0.71, true)] {
            let watched = stopping(hold, &|w| w.error(x, 0.0, phi));
            let found = watched.conditions().contains(unstopped);
            assert_eq!(found, far && by_error, "{hold} {x} {phi}");
        }
        for (left, right, runs) in [
            (5.0, -5.0, false),
            (5.01, 0.0, true),
            (0.0, -5.01, true),
            (f32::NAN, 0.0, true),
        ] {
            let watched = stopping(hold, &|w| w.wheels(left, right));
            let found = watched.conditions().contains(unstopped);
            assert_eq!(found, runs && by_speed, "{hold} {left} {right}");
        }
        // The condition does not occur in another state, or before the stop has begun.
        let mut other = stopping(hold, &|w| {
            w.error(0.2, 0.0, 0.0);
            w.wheels(9.0, 9.0);
        });
        assert!(other.conditions().contains(unstopped));
        let stop = other.node.state.stop.take();
        assert!(!other.conditions().contains(unstopped));
        other.node.state.stop = stop;
        for state in OperatingState::ALL {
            other.node.state.supervisor = supervisor_in(state);
            let found = other.conditions().contains(unstopped);
            assert_eq!(found, state == OperatingState::SafeStop, "{state:?}");
        }
    }
}

/// Wheels with a radius of 0.073 m at 1 and 2 rad/s, 0.324 m apart: their yaw rate is the difference times radius
/// over track.
#[test]
fn slip_is_the_difference_of_the_yaw_rates_by_gyro_and_wheels() {
    let mut watched = driving();
    watched.samples.gyro_rad_s = Some(0.8);
    assert_eq!(watched.conditions(), Conditions::NONE);
    watched.wheels(1.0, 2.0);
    for (rate, slips) in [(0.79, false), (0.81, true), (-0.79, false), (-0.81, true)] {
        watched.samples.gyro_rad_s = Some(0.073 / 0.324 + rate);
        let found = watched.conditions().contains(Condition::WheelSlip);
        assert_eq!(found, slips, "{rate}");
    }
}

/// Compares all combinations of state, mode, age of the mode, pause and reference.
#[test]
fn requests_match_the_table() {
    use LeadMode::{Active, Clear, Hold, Idle};
    let modes = [None, Some(Idle), Some(Active), Some(Hold), Some(Clear)];
    let mut tried = 0;
    for state in OperatingState::ALL {
        for mode in modes {
            for (ago, paused, reference) in [
                (60_000, true, 60_000),
                (60_001, true, 0),
                (0, false, 0),
                (0, true, 60_001),
            ] {
                let mut watched = in_state(AxleId(1), state);
                watched.node.state.mode = mode.map(|mode| Stamped::new(mode, NOW - ago));
                watched.node.state.paused = paused;
                watched.age(reference);
                let arrived = mode.is_some();
                let mode = mode.filter(|_| ago <= 60_000);
                let drives = matches!(mode, Some(Active | Hold));
                let expected = match state {
                    _ if !arrived => None,
                    OperatingState::Boot => Some(StateRequest::Ready),
                    OperatingState::Idle => {
                        (drives && paused && reference <= 60_000).then_some(StateRequest::Arm)
                    }
                    OperatingState::Armed if drives => Some(StateRequest::Start),
                    OperatingState::Armed => Some(StateRequest::Disarm),
                    OperatingState::Active => {
                        matches!(mode, Some(Idle | Clear)).then_some(StateRequest::Disarm)
                    }
                    OperatingState::SafeStop => None,
                    OperatingState::Fault => (mode == Some(Clear)).then_some(StateRequest::Clear),
                };
                let found = watched.node.request(NOW);
                assert_eq!(
                    found, expected,
                    "{state:?} {mode:?} {ago} {paused} {reference}"
                );
                tried += 1;
            }
        }
    }
    assert_eq!(tried, 6 * 5 * 4);
}
