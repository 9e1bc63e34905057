use super::*;
use crate::node::testing::{beat, lead_status, reference_posture};
use crate::safety::{Condition, OperatingState};
use crate::time::TICK;
use crate::topology::Side;
use core::f64::consts::TAU;

const FRAME: FrameProperties = FrameProperties {
    bending_stiffness_n_m2: 0.833,
    length_m: 0.37,
    rigid_end_m: 0.0,
};

fn node(axle: AxleId) -> AxleNode {
    let mut node = Config::default()
        .build(axle, Topology::PAIR, FRAME)
        .unwrap();
    lead(&mut node, 0, LeadMode::Idle);
    node
}

/// An axle ignores the messages of frames that are not at this axle.
#[test]
fn frames_of_other_axles_are_ignored() {
    let robot = Topology::new(3).unwrap();
    let build = |axle| Config::default().build(AxleId(axle), robot, FRAME).unwrap();
    for (axle, own) in [(0, [true, false]), (1, [true, true]), (2, [false, true])] {
        for (frame, own) in robot.frames().zip(own) {
            let (mut node, before) = (build(axle), build(axle));
            let posture = Posture::new(0.36, 0.02, 0.1);
            let message = Message::BeamPosture {
                frame,
                sequence: 0,
                posture,
                gauges: 5,
            };
            node.receive(0, &message);
            assert_eq!(node != before, own, "axle {axle}, {frame:?}");
        }
    }
}

/// Samples of wheels turned by these angles (rad).
fn turned(angles: [f64; 2]) -> Samples {
    let per_turn = f64::from(Config::default().wheel.counts_per_revolution);
    Samples {
        encoder: angles
            .map(|angle| Some((angle / TAU * per_turn).floor() as i32))
            .into(),
        ..Samples::default()
    }
}

fn reference(node: &mut AxleNode, now: Micros, v: f32, posture: Posture) {
    let other = match node.axle() {
        AxleId(0) => Node::axle(1),
        _ => Node::axle(0),
    };
    for message in [
        beat(other, now, OperatingState::Active, 0),
        lead_status(now, LeadMode::Active, v),
        reference_posture(node.axle(), now, posture),
        Message::ReferenceMotion {
            axle: node.axle(),
            sequence: sequence(now),
            velocity_m_s: v,
            yaw_rate_rad_s: 0.0,
            acceleration_m_s2: 0.0,
            yaw_acceleration_rad_s2: 0.0,
        },
    ] {
        node.receive(now, &message);
    }
}

/// Time of a tick; a tick that begins an epoch gives the node its reference.
fn referred(node: &mut AxleNode, tick: u64, v: f32, posture: Posture) -> Micros {
    let now = tick * TICK;
    if is_epoch_start(now) {
        reference(node, now, v, posture);
    }
    now
}

fn step(node: &mut AxleNode, now: Micros, samples: &Samples) -> Output {
    node.step(now, samples, &mut Outbox::new())
}

/// Wheels at rest.
fn still() -> Samples {
    turned([0.0; 2])
}

fn operating(node: &AxleNode) -> OperatingState {
    node.supervision().operating()
}

#[test]
fn references_of_the_other_axle_are_ignored() {
    let mut node = node(AxleId(0));
    let (before, axle) = (*node.state(), AxleId(1));
    let motion = Message::ReferenceMotion {
        axle,
        sequence: sequence(EPOCH),
        velocity_m_s: 0.1,
        yaw_rate_rad_s: 0.0,
        acceleration_m_s2: 0.0,
        yaw_acceleration_rad_s2: 0.0,
    };
    for message in [reference_posture(axle, EPOCH, Posture::ORIGIN), motion] {
        node.receive(EPOCH, &message);
        assert!(*node.state() == before);
    }
}

#[test]
fn odometry_follows_an_arc() {
    let mut node = node(AxleId(1));
    for tick in 0..=4500u64 {
        // Speed rises for one second, then stays.
        let t = tick as f64 * 1e-3;
        let rotation = if t < 1.0 { 0.5 * t * t } else { t - 0.5 };
        step(
            &mut node,
            tick * TICK,
            &turned([3.0 * rotation, 4.0 * rotation]),
        );
    }
    // Wheels at 0.219 and 0.292 m/s that are 0.324 m apart drive an arc of radius 1.134 m.
    let (v, omega) = (0.2555f64, 0.073 / 0.324);
    let phi = omega * 4.0;
    let expected = [v / omega * phi.sin(), v / omega * (1.0 - phi.cos()), phi];
    let found: [f32; 3] = node.state.filter.posture().into();
    for (k, most) in [2e-3, 2e-3, 4e-3].into_iter().enumerate() {
        let error = f64::from(found[k]) - expected[k];
        assert!(error.abs() < most, "{found:?} {expected:?}");
    }
}

/// 40 m are four spans of positions on the bus. The sum of the reported motion is the distance driven, and a
/// reference 1 cm ahead stays 1 cm ahead, also across the ends of a span.
#[test]
fn long_drive_is_reported_to_ten_micrometres_across_position_spans() {
    use crate::bus::{decode, encode, field::wrap_position};
    let (mut node, mut outbox) = (node(AxleId(1)), Outbox::new());
    let (mut sum, mut last, mut spans, mut own) = (0.0f64, 0.0, 0, 0.0f64);
    for tick in 0..=100_000u64 {
        let now = tick * TICK;
        // 0.4 m/s after the first second, along the axle's heading of zero.
        let t = tick as f64 * 1e-3;
        let angle = 0.4 / 0.073 * if t < 1.0 { 0.5 * t * t } else { t - 0.5 };
        outbox.clear();
        let output = node.step(now, &turned([angle; 2]), &mut outbox);
        if tick > 2000 {
            assert!((output.error.x.abs() - 0.01).abs() < 1e-3, "{output:?}");
            assert_ne!(output.torque_nm, Wheels::both(0.0));
        }
        let mut messages = outbox.iter();
        let Some(report) = messages.find(|m| matches!(m, Message::AxlePosture { .. })) else {
            continue;
        };
        let Ok(Message::AxlePosture { posture, .. }) = decode(&encode(report).unwrap()) else {
            panic!("{report:?}");
        };
        sum += f64::from(wrap_position(posture.x - last));
        last = posture.x;
        let [x, ..] = node.state.filter.precise_posture();
        spans += i32::from(x < own - 5.0);
        own = x;
        let gone = own + f64::from(spans) * 10.485_76;
        assert!((sum - gone).abs() < 1e-5, "{sum} {gone}");
        reference(&mut node, now, 0.4, Posture::new(last + 0.01, 0.0, 0.0));
    }
    assert_eq!(spans, 4);
    assert!((sum - 39.8).abs() < 1e-2, "{sum}");
}

#[test]
fn reports_once_an_epoch() {
    let mut node = node(AxleId(0));
    let mut reports = 0;
    for tick in 0..100u64 {
        let mut outbox = Outbox::new();
        node.step(tick * TICK, &still(), &mut outbox);
        let count = outbox.iter().count();
        assert_eq!(count, if tick % 10 == 0 { 4 } else { 0 });
        reports += count;
    }
    assert_eq!(reports, 40);
}

#[test]
fn implausible_reference_is_ignored_or_gives_zero_torque() {
    let samples = still();
    let far = Posture::new(0.5, 0.0, 0.0);
    for (v, posture) in [
        (0.6, Posture::ORIGIN),
        (f32::NAN, Posture::ORIGIN),
        (0.1, far),
    ] {
        let mut node = node(AxleId(0));
        step(&mut node, 0, &samples);
        reference(&mut node, 20 * TICK, 0.1, Posture::ORIGIN);
        let before = step(&mut node, 21 * TICK, &samples);
        assert!(before.active && before.torque_nm.left > 0.0);
        reference(&mut node, 30 * TICK, v, posture);
        let after = step(&mut node, 31 * TICK, &samples);
        match posture == far {
            true => assert_eq!(after.torque_nm, Wheels::both(0.0)),
            // The previous reference is still in use.
            false => assert!(after.active && after.torque_nm.left < 2.0, "{after:?}"),
        }
        reference(&mut node, 40 * TICK, 0.1, Posture::ORIGIN);
        let good = step(&mut node, 41 * TICK, &samples);
        assert!(good.active && good.torque_nm.left > 0.0, "{good:?}");
    }
}

#[test]
fn drives_toward_its_reference_and_stops_without_one() {
    let mut node = node(AxleId(0));
    let samples = still();
    assert!(!step(&mut node, 0, &samples).active, "no reference yet");
    reference(&mut node, 20 * TICK, 0.1, Posture::ORIGIN);
    let output = step(&mut node, 21 * TICK, &samples);
    assert!(output.active && output.torque_nm.left > 0.0 && output.torque_nm.right > 0.0);
    // The axle brakes 60 ms after the epoch of the last reference, and stays off. The other axle is sound throughout.
    let well = beat(Node::axle(1), 50 * TICK, OperatingState::Active, 0);
    node.receive(50 * TICK, &well);
    assert!(step(&mut node, 20 * TICK + 60_000, &samples).active);
    assert_eq!(operating(&node), OperatingState::Active);
    step(&mut node, 20 * TICK + 61_000, &samples);
    assert_eq!(operating(&node), OperatingState::SafeStop);
    assert_eq!(node.supervision().first(), Some(Condition::CommandTimeout));
    for tick in 82..1110 {
        step(&mut node, tick * TICK, &samples);
    }
    assert_eq!(operating(&node), OperatingState::Fault);
    reference(&mut node, 1110 * TICK, 0.1, Posture::ORIGIN);
    let off = step(&mut node, 1111 * TICK, &samples);
    assert_eq!(off, Output::default(), "latched");
    node.restart();
    assert_eq!(*node.state(), State::default());
}

/// Neither a mode nor references alone keep an axle driving: 60 ms after the latest mode or reference it brakes.
#[test]
fn axle_brakes_without_mode_or_without_references() {
    for without_mode in [false, true] {
        let mut node = node(AxleId(0));
        for tick in 0..=151u64 {
            let kept = node.state;
            let now = referred(&mut node, tick, 0.0, Posture::ORIGIN);
            match (tick < 100, without_mode) {
                (true, _) => {}
                (false, true) => node.state.mode = kept.mode,
                (false, false) => node.state.reference = kept.reference,
            }
            step(&mut node, now, &still());
            let active = operating(&node) == OperatingState::Active;
            assert!(tick < 20 || active == (tick <= 150), "{tick}");
        }
        assert_eq!(node.supervision().first(), Some(Condition::CommandTimeout));
    }
}

#[test]
fn load_measured_by_the_beam_holds_for_its_timeout() {
    let mut node = node(AxleId(1));
    let (old, now, timeout) = (40 * EPOCH, 43 * EPOCH, node.wrench_timeout);
    for (wrench, posture) in [(old, now), (now, old)] {
        let (sequences, wrench) = ([wrench, posture, now].map(sequence), Wrench::ZERO);
        let posture = Posture::ORIGIN;
        for message in [
            Message::BeamWrench {
                frame: FrameId(0),
                sequence: sequences[0],
                wrench,
            },
            Message::BeamPosture {
                frame: FrameId(0),
                sequence: sequences[1],
                posture,
                gauges: 5,
            },
            // No gauge is valid.
            Message::BeamPosture {
                frame: FrameId(0),
                sequence: sequences[2],
                posture,
                gauges: 0,
            },
        ] {
            node.receive(now, &message);
        }
        assert!(node.beam_load(old + timeout).is_some());
        assert_eq!(node.beam_load(old + timeout + 1), None);
    }
}

/// Each refused measurement counts once, until the count is reported.
#[test]
fn refused_measurements_are_counted() {
    let mut settled = node(AxleId(0));
    (1..=55).for_each(|tick| {
        step(&mut settled, tick * TICK, &still());
    });
    let refused = |samples: &Samples| {
        let mut node = settled;
        node.state.refused = 0;
        step(&mut node, 56 * TICK, samples);
        (
            node.state.refused,
            node.state.wheels.map(|wheel| wheel.jumped),
        )
    };
    let with = |gyro_rad_s, acceleration_m_s2| Samples {
        gyro_rad_s,
        acceleration_m_s2,
        ..still()
    };
    let nan = Some(f32::NAN);
    for (samples, count) in [
        (still(), 0),
        (with(nan, None), 1),
        (with(None, nan), 1),
        (with(nan, nan), 2),
        (with(Some(30.0), None), 1),
    ] {
        assert_eq!(refused(&samples).0, count, "{samples:?}");
    }
    let mut reported = settled;
    step(&mut reported, 56 * TICK, &with(nan, nan));
    (57..=60).for_each(|tick| {
        step(&mut reported, tick * TICK, &still());
    });
    assert_eq!(reported.state.refused, 0, "reported at 60 ms");
    // A wheel is too fast for its filter, then the count of a wheel jumps.
    for side in 0..2 {
        let mut occurred = [false; 2];
        for counts in (0..4000).step_by(20) {
            let mut samples = still();
            samples.encoder[Side::BOTH[side]] = Some(counts);
            let (count, jumped) = refused(&samples);
            assert!(count <= 1 && !jumped[1 - side], "{counts} {count}");
            assert!(count == 1 || !jumped[side], "{counts}");
            occurred[usize::from(jumped[side])] |= count == 1;
        }
        assert_eq!(occurred, [true; 2], "{side}");
    }
}

#[test]
fn stop_bounds_torque_by_a_share_of_the_held_torque() {
    let ramp = node(AxleId(0)).ramp;
    let mut stop = Stop {
        ramp: ramp.begin(Posture::ORIGIN, 0.0, Steering::STRAIGHT, 0.37),
        hold: 1.0,
        held_nm: 0.0,
    };
    for (hold, expected) in [(1.0, [1.0, -2.0]), (0.25, [0.25, -0.5]), (0.0, [0.0; 2])] {
        stop.hold = hold;
        let mut torque_nm = [1.0, -2.0].into();
        stop.bound_release(&mut torque_nm);
        assert_eq!(torque_nm.list(), expected);
    }
    // The bound uses the larger of the two torques, both at the start of the release and at each tick.
    stop.hold = 1.0;
    stop.bound_release(&mut [0.5, -4.0].into());
    stop.hold = 0.5;
    for (torque_nm, expected) in [([1.0, -8.0], [0.25, -2.0]), ([4.0, 0.0], [2.0, 0.0])] {
        let mut torque_nm = torque_nm.into();
        stop.bound_release(&mut torque_nm);
        assert_eq!(torque_nm.list(), expected);
    }
}

/// On a middle axle the moments of two frames with the same bend cancel; those of opposite bends add up. A frame that
/// is not at the axle does not count.
#[test]
fn load_of_a_middle_axle_is_that_of_both_frames() {
    let robot = Topology::new(4).unwrap();
    let moment = |bends: [f32; 3]| {
        let mut node = Config::default().build(AxleId(1), robot, FRAME).unwrap();
        for (frame, bend) in robot.frames().zip(bends) {
            assert_eq!(node.beam_load(EPOCH), None, "a frame is missing");
            let (psi, sequence) = (Steering(bend), sequence(EPOCH));
            let wrench = Wrench::pure_bending(0.833, 0.37, psi);
            let posture = Posture::new(0.36, 0.0, 2.0 * bend);
            let of_frame = [
                Message::BeamWrench {
                    frame,
                    sequence,
                    wrench,
                },
                Message::BeamPosture {
                    frame,
                    sequence,
                    posture,
                    gauges: 5,
                },
            ];
            for message in of_frame {
                node.receive(EPOCH, &message);
            }
            if frame == FrameId(1) {
                break;
            }
        }
        node.beam_load(EPOCH).unwrap().moment
    };
    let whole = 0.833 * 0.4 / 0.37;
    for (bends, expected) in [
        ([0.2, 0.2, 0.0], 0.0),
        ([0.2, -0.2, 0.0], 2.0 * whole),
        ([0.0, 0.2, 0.0], -whole),
    ] {
        let found = moment(bends);
        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
    }
    // A middle axle needs the heartbeat of every other axle.
    let mut node = Config::default().build(AxleId(1), robot, FRAME).unwrap();
    let lost = |node: &AxleNode| {
        let conditions = node.watch(EPOCH, &Samples::default());
        conditions.contains(Condition::NeighbourLost)
    };
    for axle in [0, 2, 3] {
        assert!(lost(&node), "{axle}");
        node.receive(
            EPOCH,
            &beat(Node::axle(axle), EPOCH, OperatingState::Idle, 0),
        );
    }
    assert!(!lost(&node));
}

/// Reference: mechanics with constant accelerations for 20 ms, wheels 0.324 m apart, and the moment EI·2ψ/L of a bent
/// frame.
#[test]
fn reference_twist_and_load_follow_from_mechanics() {
    let near = |found: f32, expected: f32| assert!((found - expected).abs() < 2e-6, "{found}");
    let [mut rear, mut front] = [AxleId(1), AxleId(0)].map(node);
    reference(&mut rear, 4 * EPOCH, 0.2, Posture::ORIGIN);
    let now = &mut rear.state.reference.as_mut().unwrap().value;
    (now.twist, now.acceleration) = (Twist::new(0.2, 0.5), Twist::new(0.4, -1.0));
    let later = rear.reference(4 * EPOCH + 20_000).unwrap();
    near(later.posture.x, 0.2 * 0.02 + 0.2 * 0.02 * 0.02);
    near(later.posture.phi, 0.5 * 0.02 - 0.5 * 0.02 * 0.02);
    near(later.twist.v, 0.208);
    near(later.twist.omega, 0.48);
    near(rear.twist([0.1, 0.3]).v, 0.2);
    near(rear.twist([0.1, 0.3]).omega, 0.2 / 0.324);
    (front.state.steering, rear.state.steering) = (Steering(0.2), Steering(0.2));
    let moments = [front, rear].map(|node| node.reference_load(0).moment);
    near(moments[0].abs(), 0.833 * 0.4 / 0.37);
    near(moments[0] + moments[1], 0.0);
}

/// The midpoint stops over v²/(2a), an axle over this distance divided by cos ψ.
#[test]
fn a_stop_brakes_on_the_path_of_a_bent_frame() {
    let mut node = node(AxleId(0));
    (node.state.velocity, node.state.steering) = (0.2, Steering(0.3));
    node.state.followed = Some(AxleReference::default());
    let mut reference = AxleReference::default();
    let ticks = (1..2000).find(|tick| {
        reference = node.brake();
        // The axle slows down for 0.2 s and rests for 0.1 s; then the hold fades over 0.75 s.
        let hold = (1.0 - (0.001 * f64::from(*tick) - 0.3) / 0.75).clamp(0.0, 1.0);
        let found = node.state.stop.unwrap().hold;
        assert!((f64::from(found) - hold).abs() < 2e-3, "{tick}: {found}");
        node.state.halted
    });
    assert!((1049..=1052).contains(&ticks.unwrap()), "{ticks:?}");
    let (distance, turned) = (0.02 / 0.3f32.cos(), 0.6 / (0.37 * 0.3f32.cos()) * 0.02);
    let at = reference.posture;
    assert!((at.x.hypot(at.y) / distance - 1.0).abs() < 1e-3, "{at:?}");
    assert!((at.phi / turned - 1.0).abs() < 1e-3, "{at:?}");
}

/// In x and y the axle is near an end of the position span, and its reference lies beyond that end.
#[test]
fn reference_across_the_end_of_the_position_span_is_near() {
    let mut node = node(AxleId(0));
    node.state.filter.shift([5.24, -5.24]);
    let reference = AxleReference {
        posture: Posture::new(5.25 - 10.485_76, 10.485_76 - 5.26, 0.0),
        ..AxleReference::default()
    };
    let error = node.control(0, [0.0; 2], reference).0.error;
    assert!((error.x.abs() - 0.01).abs() < 1e-4 && (error.y / error.x + 2.0).abs() < 1e-2);
}

/// One wheel crosses half of its gap of 0.3 mm; the heading of a gyro is not affected.
#[test]
fn backlash_counts_in_the_share_of_the_heading_by_the_wheels() {
    let variance = |gyro_samples, ticks| {
        let mut node = node(AxleId(0));
        (0..ticks).for_each(|_| node.state.backlash[0].step(0.1));
        node.state.gyro_samples = gyro_samples;
        let mut outbox = Outbox::new();
        node.report(0, &mut outbox);
        let covariance = outbox.iter().find_map(|message| match message {
            Message::AxleUncertainty { covariance, .. } => Some(covariance[2][2]),
            _ => None,
        });
        covariance.unwrap()
    };
    let gap = 0.5 * (3e-4f32 / 0.324).powi(2);
    for (gyro_samples, share) in [(0, 1.0), (5, 0.25), (10, 0.0)] {
        let added = variance(gyro_samples, 100) - variance(gyro_samples, 0);
        let error = added / gap - share;
        assert!(error.abs() < 1e-3, "{gyro_samples}: {added:e}");
    }
}

/// With four axles the covariance comes every fifth epoch and is the mean of five, so that all of the variance of the
/// backlash is reported.
#[test]
fn covariance_of_four_axles_is_the_mean_of_five_epochs() {
    let robot = Topology::new(4).unwrap();
    let total = |robot: Topology, epochs_each: f32| {
        let mut node = Config::default().build(AxleId(0), robot, FRAME).unwrap();
        let (mut sum, mut count) = (0.0, 0);
        for epoch in 1..=50u64 {
            // One wheel crosses its gap in one of five epochs.
            if epoch % 5 == 2 {
                (0..100).for_each(|_| node.state.backlash[0].step(0.1));
            }
            let mut outbox = Outbox::new();
            node.report(epoch * EPOCH, &mut outbox);
            for message in outbox.iter() {
                if let Message::AxleUncertainty { covariance, .. } = message {
                    sum += epochs_each * covariance[2][2];
                    count += 1;
                }
            }
        }
        (sum, count)
    };
    let ((each, fifty), (mean, ten)) = (total(Topology::PAIR, 1.0), total(robot, 5.0));
    assert_eq!((fifty, ten), (50, 10));
    assert!(
        each > 0.0 && (mean / each - 1.0).abs() < 1e-3,
        "{mean:e} {each:e}"
    );
}

fn lead(node: &mut AxleNode, now: Micros, mode: LeadMode) {
    node.receive(now, &lead_status(now, mode, 0.0));
}

/// If the lead node becomes idle, the axle brakes, is released and becomes idle, without a fault.
#[test]
fn released_axle_comes_to_rest_without_a_fault() {
    let mut node = node(AxleId(0));
    let samples = still();
    let mut braked = 0;
    for tick in 20..1500u64 {
        let now = referred(&mut node, tick, 0.0, Posture::ORIGIN);
        if tick >= 100 {
            lead(&mut node, now, LeadMode::Idle);
        }
        let output = step(&mut node, now, &samples);
        let state = operating(&node);
        braked += u32::from(state == OperatingState::SafeStop && output.active);
        assert_eq!(node.supervision().first(), None, "{tick}");
        let active = state == OperatingState::Active;
        assert_eq!(active, (20..100).contains(&tick), "{tick}");
    }
    // Deceleration 0.1 s, rest 0.1 s, release 0.75 s.
    assert!((900..1100).contains(&braked), "{braked}");
    assert_eq!(operating(&node), OperatingState::Idle);
}

/// A board that starts during a drive must not join the drive.
#[test]
fn an_axle_that_starts_while_the_robot_drives_waits_for_it_to_stop() {
    for pause in [LeadMode::Idle, LeadMode::Clear] {
        let mut node = node(AxleId(1));
        node.state = State::default();
        for tick in 0..200u64 {
            let now = referred(&mut node, tick, 0.1, Posture::ORIGIN);
            if tick == 100 {
                lead(&mut node, now, pause);
            }
            let output = step(&mut node, now, &still());
            assert_eq!(output.active, tick >= 110, "{tick}");
        }
    }
}

/// The second stop takes as long as the first.
#[test]
fn each_stop_has_its_whole_ramp() {
    let mut node = node(AxleId(0));
    let mut tick = 20;
    let mut stops = [0; 2];
    // The first stop is requested, the second comes from a condition.
    for (braked, pressed) in stops.iter_mut().zip([false, true]) {
        let end = tick + 1500;
        while tick < end {
            let now = referred(&mut node, tick, 0.0, Posture::ORIGIN);
            let mut samples = still();
            if tick + 1400 >= end {
                samples.conditions.set(Condition::EmergencyStop, pressed);
                if !pressed {
                    lead(&mut node, now, LeadMode::Idle);
                }
            }
            step(&mut node, now, &samples);
            *braked += u32::from(operating(&node) == OperatingState::SafeStop);
            tick += 1;
        }
        let expected = [OperatingState::Idle, OperatingState::Fault][usize::from(pressed)];
        assert_eq!(operating(&node), expected);
    }
    assert!(
        stops[0] > 900 && stops[0].abs_diff(stops[1]) <= 1,
        "{stops:?}"
    );
}

/// The limit is 0.5 m/s at the faster wheel, 0.162 m from the middle.
#[test]
fn references_beyond_the_wheel_speed_limit_are_rejected() {
    let limits = Limits::default();
    for (v, omega, allowed) in [
        (0.5, 0.0, true),
        (-0.5, 0.0, true),
        (0.5001, 0.0, false),
        (0.3, 1.2, true),
        (0.3, 1.3, false),
        (-0.3, -1.3, false),
        (0.3, -1.3, false),
        (f32::NAN, 0.0, false),
        (0.0, f32::NAN, false),
    ] {
        let found = limits.allow(Twist::new(v, omega), 0.162);
        assert_eq!(found, allowed, "{v} {omega}");
    }
    // Rest times in ticks: 0.1 s with still wheels, 60 s with motors off. A stop must end within 2 s.
    let node = node(AxleId(0));
    assert_eq!((node.rest.hold, node.rest.settle / 10), (100, 5_999));
    let mut config = Config::default();
    config.stop.release_s = 1.75;
    assert_eq!(
        config
            .build(AxleId(0), Topology::PAIR, FRAME)
            .unwrap_err()
            .field,
        "release_s"
    );
}

/// Each case has one cause, in the samples or in the reference, while the axle drives.
#[test]
fn stops_for_every_reason_and_drives_again_once_cleared() {
    let by_driver = |condition| {
        let mut samples = still();
        samples.conditions = Conditions::only(condition);
        (condition, samples)
    };
    let mut slipping = still();
    slipping.gyro_rad_s = Some(3.0);
    let cases = [
        (Condition::EncoderFault, Samples::default()),
        (Condition::WheelSlip, slipping),
        by_driver(Condition::OverCurrent),
        by_driver(Condition::EmergencyStop),
        (Condition::TrackingLost, still()),
    ];
    for (condition, samples) in cases {
        let mut node = node(AxleId(1));
        let ahead = match condition {
            Condition::TrackingLost => 0.2,
            _ => 0.0,
        };
        for tick in 0..2000u64 {
            let now = tick * TICK;
            if is_epoch_start(now) && tick < 600 {
                reference(&mut node, now, 0.0, Posture::new(ahead, 0.0, 0.0));
            }
            let bad = (100..600).contains(&tick);
            let given = if bad { samples } else { still() };
            step(&mut node, now, &given);
            assert!(tick != 20 || operating(&node) == OperatingState::Active);
        }
        assert_eq!(node.supervision().first(), Some(condition));
        assert_eq!(operating(&node), OperatingState::Fault);
        for tick in 2000..2100u64 {
            let now = referred(&mut node, tick, 0.0, Posture::ORIGIN);
            let mode = match tick {
                ..2030 => LeadMode::Clear,
                _ => LeadMode::Active,
            };
            lead(&mut node, now, mode);
            step(&mut node, now, &still());
        }
        assert_eq!(operating(&node), OperatingState::Active, "{condition:?}");
    }
}

#[test]
fn a_neighbour_that_stops_or_falls_silent_stops_this_axle() {
    for (silent, expected) in [
        (true, Condition::NeighbourLost),
        (false, Condition::NeighbourFault),
    ] {
        let mut node = node(AxleId(0));
        let samples = still();
        for tick in 0..300u64 {
            let peers = node.state.peers;
            let now = referred(&mut node, tick, 0.0, Posture::ORIGIN);
            if tick >= 100 && silent {
                node.state.peers = peers;
            } else if tick >= 100 {
                let reason = Condition::SupplyLow.code();
                let stop = beat(Node::axle(1), now, OperatingState::SafeStop, reason);
                node.receive(now, &stop);
            }
            step(&mut node, now, &samples);
            assert!(tick != 99 || operating(&node) == OperatingState::Active);
        }
        assert_eq!(node.supervision().first(), Some(expected));
    }
}

/// A posture and a motion 256 epochs apart have equal sequence numbers, but make no reference either.
#[test]
fn halves_of_different_epochs_make_no_reference() {
    let axle = AxleId(0);
    for now in [5 * EPOCH, 256 * EPOCH] {
        let motion = Message::ReferenceMotion {
            axle,
            sequence: sequence(now),
            velocity_m_s: 0.2,
            yaw_rate_rad_s: 0.0,
            acceleration_m_s2: 0.0,
            yaw_acceleration_rad_s2: 0.0,
        };
        let posture = reference_posture(axle, now, Posture::new(1.0, 0.0, 0.0));
        for half in [motion, posture] {
            let mut node = node(axle);
            reference(&mut node, 0, 0.1, Posture::ORIGIN);
            node.receive(now, &half);
            let kept = node.state.reference.unwrap();
            assert_eq!((kept.time, kept.value.twist.v), (0, 0.1), "{half:?}");
        }
    }
}

#[test]
fn nan_reference_gives_zero_torque_and_nan_samples_keep_odometry_finite() {
    let mut node = node(AxleId(0));
    reference(&mut node, 0, f32::NAN, Posture::ORIGIN);
    let output = step(&mut node, TICK, &Samples::default());
    assert_eq!(output.torque_nm, Wheels::both(0.0));
    // A gyro that reads NaN is refused and the odometry stays finite.
    for tick in 2..50 {
        let samples = Samples {
            gyro_rad_s: Some(f32::NAN),
            acceleration_m_s2: Some(f32::INFINITY),
            ..still()
        };
        step(&mut node, tick * TICK, &samples);
    }
    assert!(node.state.filter.posture().is_finite());
    // The first sound reading counts again.
    let before = node.state.gyro_samples;
    let samples = Samples {
        gyro_rad_s: Some(0.0),
        ..still()
    };
    step(&mut node, 51 * TICK, &samples);
    assert_eq!(node.state.gyro_samples, before + 1);
}

/// An axle stands on a pitch of 34 mrad from the start, or is tilted to it at once or slowly. Its wheels are still.
#[test]
fn pitched_axle_at_rest_does_not_move() {
    let gravity = (9.81 * f64::sin(0.034)) as f32;
    let tilts: [fn(u64) -> f32; 3] = [
        |_| 1.0,
        |tick| f32::from(u8::from(tick > 1000)),
        |tick| f64::sin(tick as f64 * 1e-3) as f32,
    ];
    for share in tilts {
        let mut node = node(AxleId(0));
        let mut far = 0.0f32;
        for tick in 1..11_000 {
            let samples = Samples {
                gyro_rad_s: Some(0.0),
                acceleration_m_s2: Some(gravity * share(tick)),
                ..still()
            };
            step(&mut node, tick * TICK, &samples);
            far = far.max(node.state.filter.posture().x.abs());
        }
        assert!(far < 5e-4, "{far} m");
    }
}

#[test]
fn accelerating_turn_is_estimated_without_the_delay_of_the_gyro() {
    const QUICKENS_RAD_S2: f64 = 1.0;
    let mut node = node(AxleId(1));
    let config = Config::default();
    let geometry = &config.filter;
    let mut heading = 0.0;
    for tick in 0..1500u64 {
        let now = tick * TICK;
        let seconds = now as f64 * 1e-6;
        let late = seconds - f64::from(DELAY_S);
        heading = 0.5 * QUICKENS_RAD_S2 * seconds * seconds;
        let rolled = 0.5 * f64::from(geometry.track_m) * heading
            / f64::from(config.controller.wheel_radius_m);
        let mut samples = turned([-rolled, rolled]);
        samples.gyro_rad_s = Some((QUICKENS_RAD_S2 * late) as f32);
        step(&mut node, now, &samples);
    }
    let estimated = f64::from(node.state.filter.posture().phi);
    let lag = (heading - estimated) / (QUICKENS_RAD_S2 * 1.5);
    assert!(lag.abs() < 1e-4, "{lag} s");
}

#[test]
fn limits_are_checked_by_name_and_hold_in_each_direction() {
    let limits = Limits::default();
    crate::config::refusal_of(Config::default(), |c| {
        c.build(AxleId(0), Topology::PAIR, FRAME)
    })
    .names(&[
        ("tracking_m", |c| c.limits.tracking_m = 0.0),
        ("tracking_rad", |c| c.limits.tracking_rad = -1.0),
        ("stall_share", |c| c.limits.stall_share = 1.1),
        ("stall_rad_s", |c| c.limits.stall_rad_s = f32::NAN),
        ("slip_rad_s", |c| c.limits.slip_rad_s = 0.0),
        ("wheel_speed_m_s", |c| c.limits.wheel_speed_m_s = f32::NAN),
    ]);
    let bounds = [limits.tracking_m, limits.tracking_m, limits.tracking_rad];
    for times in [1.9, -1.9, 2.1, -2.1f32] {
        for (k, bound) in bounds.into_iter().enumerate() {
            let mut error = [0.0; 3];
            error[k] = times * bound;
            let near = limits.near(Posture::from(error), 2.0);
            assert_eq!(near, times.abs() < 2.0, "{error:?}");
        }
    }
    assert!(!limits.near(Posture::new(f32::NAN, 0.0, 0.0), 2.0));
}

/// A blocked axle with a reference of 0.1 m/s.
#[test]
fn force_of_the_ground_grows_while_driving_and_ends_with_the_reference() {
    let mut node = node(AxleId(0));
    let mut ticks = 100..;
    let mut drive = |node: &mut AxleNode, count: usize| {
        for tick in ticks.by_ref().take(count) {
            let now = referred(node, tick, 0.1, Posture::ORIGIN);
            step(node, now, &still());
        }
        node.state().ground_force_n
    };
    drive(&mut node, 10);
    let begun = drive(&mut node, 10);
    // Ḟ = −ω_i K₁ (0.1 m/s + c s F): tends to −1/c at the rate ω_i K₁ c s = 30 1/s.
    let later = drive(&mut node, 40);
    let course = (1.0 / 0.15 + begun) * (-0.04f32 * 30.0).exp() - 1.0 / 0.15;
    assert!(
        (later / course - 1.0).abs() < 0.02,
        "{begun} {later} {course}"
    );
    // The reference is at the axle, so only 200 N s/m of the law push, and the force of the ground.
    let Wheels { left, right } = node.state().output.torque_nm;
    let pushed = left + right;
    let law = 200.0 * 0.1 * (1.0 + 2.0 * 0.01);
    assert!(
        (pushed / 0.073 / (law - later) - 1.0).abs() < 0.05,
        "{pushed}"
    );

    // A stop of at most 1.2 s, then the motors are off.
    lead(&mut node, 160 * TICK, LeadMode::Idle);
    let mut forces = Vec::new();
    for tick in 160..1400 {
        let active = step(&mut node, tick * TICK, &still()).active;
        forces.push((active, node.state().ground_force_n));
    }
    assert!(
        forces
            .iter()
            .all(|(active, force)| *active || *force == 0.0)
    );
    assert!(forces[0].0 && !forces[1239].0, "{forces:?}");
}

#[test]
fn force_of_the_ground_is_zero_while_the_reference_is_far_away() {
    let mut node = node(AxleId(0));
    for (ticks, at, grown) in [(100..150, 0.0, true), (150..151, 0.3, false)] {
        for tick in ticks {
            reference(&mut node, tick * TICK, 0.1, Posture::new(at, 0.0, 0.0));
            step(&mut node, tick * TICK, &still());
        }
        assert_eq!(node.state().ground_force_n < -1.0, grown, "{at}");
    }
    assert_eq!(node.state().ground_force_n, 0.0);
}

/// Node of an inner axle of three, with the frames behind and ahead bent as given at `now`.
fn inner(now: Micros, behind: Posture, ahead: Posture) -> AxleNode {
    let topology = Topology::new(3).unwrap();
    let frame = FrameProperties {
        rigid_end_m: 0.02,
        ..FRAME
    };
    let mut node = Config::default().build(AxleId(1), topology, frame).unwrap();
    for (frame, posture) in [(FrameId(0), ahead), (FrameId(1), behind)] {
        node.receive(
            now,
            &Message::BeamPosture {
                frame,
                sequence: sequence(now),
                posture,
                gauges: 5,
            },
        );
    }
    node
}

/// An inner axle carries the difference of the bends: an S-bend turns it with both moments, an arc with none.
#[test]
fn inner_axle_is_loaded_by_the_measured_bends_of_both_frames() {
    let psi = 0.2f32;
    let chord = 0.37 * psi.sin() / psi;
    let arc = |sign: f32| {
        let start = Posture::new(0.02, 0.0, 0.0);
        let bent = Posture::new(
            chord * psi.cos(),
            sign * chord * psi.sin(),
            sign * 2.0 * psi,
        );
        start.compose(bent).compose(start)
    };
    let load = |behind, ahead| inner(EPOCH, behind, ahead).reference_load(EPOCH + TICK);
    let moment = 0.833 * 2.0 * psi / 0.37;
    let bow = load(arc(1.0), arc(1.0));
    assert!(
        bow.moment.abs() < 1e-4 && bow.lateral.abs() < 1e-3,
        "{bow:?}"
    );
    let wave = load(arc(-1.0), arc(1.0));
    assert!((wave.moment - 2.0 * moment).abs() < 1e-3, "{wave:?}");
    // Frames whose postures are too old count as bent like the path: no moment at an inner axle.
    let mut node = inner(EPOCH, arc(-1.0), arc(1.0));
    node.state.curvature = 1.2;
    let late = node.reference_load(EPOCH + 1_000_000);
    assert!(late.moment.abs() < 1e-5, "{late:?}");
    node.frames.behind = None;
    let late = node.reference_load(EPOCH + 1_000_000);
    assert!((late.moment - 0.833 * 1.2).abs() < 1e-5, "{late:?}");
}

/// Curvature and speed of each axle's own reference, not the steering of the robot, shape its stop.
#[test]
fn inner_axle_stops_on_the_circle_of_its_reference() {
    let mut node = inner(EPOCH, Posture::ORIGIN, Posture::ORIGIN);
    node.state.followed = Some(AxleReference {
        posture: Posture::new(0.5, 0.0, 0.0),
        twist: Twist::new(0.19, -0.38),
        acceleration: Twist::REST,
    });
    (node.state.velocity, node.state.steering) = (0.2, Steering(0.4));
    let mut last = node.brake();
    for _ in 0..400 {
        let now = node.brake();
        assert!((now.twist.omega + 2.0 * now.twist.v).abs() < 1e-6);
        last = now;
    }
    assert_eq!(last.twist, Twist::REST);
    // Half of 0.19 m/s for 0.2 s.
    assert!((last.posture.phi + 2.0 * 0.019).abs() < 1e-4, "{last:?}");
}
