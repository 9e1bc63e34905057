use super::*;
use crate::bus::Message;
use crate::fusion::Estimate;
use crate::math::matrix::diagonal;
use crate::math::{Steering, Wrench};
use crate::node::robot::RobotConfig;
use crate::node::testing::{axle_report, beat, supervisor_in};
use crate::safety::{Class, Condition};
use crate::time::{LEAD_PHASE, Stamped};
use crate::topology::{AxleId, FrameId};

mod chain;
mod drives;
mod own;

/// Posture and uptime of both axles.
type Axles = [(Posture, u8); 2];

/// Reports of both axles at the beginning of an epoch, and the lead node's step.
fn epoch(node: &mut LeadNode, number: u64, axles: Axles) -> Output {
    epoch_to(node, number, axles, &mut Outbox::new())
}

fn epoch_to(node: &mut LeadNode, number: u64, axles: Axles, outbox: &mut Outbox) -> Output {
    epoch_with(node, number, axles, outbox, &mut Own::default())
}

fn epoch_with(
    node: &mut LeadNode,
    number: u64,
    axles: Axles,
    outbox: &mut Outbox,
    own: &mut Own<'_>,
) -> Output {
    let now = number * EPOCH;
    for axle in [AxleId(0), AxleId(1)] {
        let (posture, uptime) = axles[axle.index()];
        for message in axle_report(axle, now, posture, uptime, None) {
            node.receive(now, &message);
        }
    }
    node.step_with(now + LEAD_PHASE, outbox, own)
}

/// Messages of the beam in an epoch.
fn beam(now: Micros, posture: Posture) -> [Message; 2] {
    let sequence = sequence(now);
    [
        Message::BeamUncertainty {
            frame: FrameId(0),
            sequence,
            covariance: diagonal([1e-9, 1e-9, 1e-8]),
        },
        Message::BeamPosture {
            frame: FrameId(0),
            sequence,
            posture,
            gauges: 5,
        },
    ]
}

fn node() -> LeadNode {
    node_of(&RobotConfig::default())
}

fn node_of(config: &RobotConfig) -> LeadNode {
    let mut node = LeadNode::new(config.build_lead().unwrap());
    let relative = Posture::new(0.37, 0.0, 0.0);
    node.initialize(&Placement {
        center: Estimate::with_sigmas(Posture::ORIGIN, [1e-3; 3]),
        relative: Estimate::with_sigmas(relative, [1e-3; 3]),
        floor_drift: 0.01,
    });
    node
}

#[test]
fn restart_of_an_axle_is_not_taken_for_motion() {
    let mut node = node();
    let at = |x: f32| Posture::new(x, 0.0, 0.0);
    for number in 0..100 {
        let x = 0.002 * number as f32;
        epoch(&mut node, number, [(at(x), number as u8); 2]);
    }
    let front = at(0.2);
    let mut last = Output::default();
    // The rear axle is silent for a while and then back at its origin; there is no beam.
    for number in 130..200 {
        let axles = [(front, number as u8), (at(0.0), number as u8 - 130)];
        let output = epoch(&mut node, number, axles);
        // No estimate until the axle's filter has settled and the wait for the beam is over.
        assert_eq!(output.fused == robot::Output::default(), number < 180);
        last = output;
    }
    let [front, rear] = [last.fused.front.posture, last.fused.rear.posture];
    assert!((front.x - 0.385).abs() < 5e-3, "{front:?}");
    assert!((rear.x - 0.015).abs() < 5e-3, "{rear:?}");
    let sigma = |estimate: &Estimate| estimate.covariance[2][2].max(0.0);
    assert!(sigma(&last.fused.rear) > 100.0 * sigma(&last.fused.front));
    // Afterwards the axle moves by its reports.
    let axles = [(at(0.21), 200), (at(0.01), 70)];
    let output = epoch(&mut node, 200, axles);
    assert!((output.fused.rear.posture.x - rear.x - 0.01).abs() < 1e-4);
}

/// After the filter of the restarted axle has settled, its posture follows from the other axle and the beam.
#[test]
fn restarted_axle_is_found_by_the_beam_once_its_filter_has_settled() {
    let straight = Posture::new(0.37, 0.0, 0.0);
    let bent = Posture::new(0.33, 0.14, 0.8);
    for restarted in [0, 1] {
        let mut node = node();
        let mut step = |number: u64, frame, restart: u64| {
            for message in beam(number * EPOCH, frame) {
                node.receive(number * EPOCH, &message);
            }
            let mut uptimes = [number; 2];
            uptimes[restarted] -= restart;
            let axles = uptimes.map(|uptime| (Posture::ORIGIN, uptime as u8));
            let output = epoch(&mut node, number, axles);
            (output.fused, node.pairs[0].nis)
        };
        let mut before = step(0, straight, 0);
        for number in 1..100 {
            before = step(number, straight, 0);
        }
        // The axle restarts, and meanwhile the frame was bent.
        for number in 130..140 {
            let (fused, _) = step(number, bent, 130);
            assert_eq!(fused, robot::Output::default(), "{number}");
        }
        let (fused, nis) = step(140, bent, 130);
        let other = |fused: &robot::Output| match restarted {
            0 => fused.rear.posture,
            _ => fused.front.posture,
        };
        let moved = other(&fused).relative_to(other(&before.0));
        assert!(moved.x.hypot(moved.y) < 1e-5, "{moved:?}");
        assert!(moved.phi.abs() < 1e-5, "{moved:?}");
        let found = fused.front.posture.relative_to(fused.rear.posture);
        let off = found.relative_to(bent);
        assert!(off.x.hypot(off.y) < 1e-4, "{found:?}");
        assert!(off.phi.abs() < 1e-4, "{found:?}");
        // The jump of the frame is no innovation of the filter.
        assert_eq!(nis, before.1);
    }
}

/// Without the beam, a restarted axle is assumed to have moved like the other axle.
#[test]
fn restarted_axle_moves_like_its_neighbour() {
    for restarted in [0, 1] {
        let mut node = node();
        let mut step = |number: u64, x: f32, restart: u64| {
            let mut axles = [(Posture::new(x, 0.0, 0.0), number as u8); 2];
            if restart > 0 {
                axles[restarted] = (Posture::ORIGIN, (number - restart) as u8);
            }
            let fused = epoch(&mut node, number, axles).fused;
            [fused.front.posture, fused.rear.posture][restarted]
        };
        step(0, 0.0, 0);
        let before = step(1, 0.0, 0);
        let after = step(150, 0.2, 100);
        assert!((after.x - before.x - 0.2).abs() < 2e-3, "{after:?}");
    }
}

/// A late measurement is advanced in the coordinates of the rear axle, which has turned by 45° since the measurement.
#[test]
fn covariance_of_a_late_measurement_turns_with_the_rear_axle() {
    let mut node = node();
    let turned = Posture::new(0.0, 0.0, core::f32::consts::FRAC_PI_4);
    epoch(&mut node, 1, [(Posture::ORIGIN, 1); 2]);
    let [_, posture] = beam(EPOCH, Posture::new(0.37, 0.0, 0.0));
    let covariance = Message::BeamUncertainty {
        frame: FrameId(0),
        sequence: sequence(EPOCH),
        covariance: diagonal([1e-9, 3e-9, 1e-8]),
    };
    for message in [covariance, posture] {
        node.receive(2 * EPOCH, &message);
    }
    epoch(&mut node, 2, [(Posture::ORIGIN, 2), (turned, 2)]);
    let tracks = [&node.tracks[0], &node.tracks[1]];
    node.pairs[0].used = None;
    let measurement = node.pairs[0].measurement(2 * EPOCH, tracks).unwrap();
    let turned = measurement.value.covariance;
    // Variances a and b along the old axes, turned by 45°: covariance (b − a)/2, variances (a + b)/2.
    for (value, expected) in [
        (turned[0][1], 1e-9),
        (turned[0][0], 2e-9),
        (turned[1][1], 2e-9),
        (turned[2][2], 1e-8),
    ] {
        assert!((value - expected).abs() < 1e-13, "{turned:?}");
    }
}

#[test]
fn wrench_and_speed_are_those_last_received() {
    let mut node = node();
    let wrench = Wrench {
        force_x: 1.0,
        force_y: 2.0,
        moment_root: 3.0,
        moment_end: 4.0,
    };
    let (frame, sequence) = (FrameId(0), sequence(EPOCH));
    let message = Message::BeamWrench {
        frame,
        sequence,
        wrench,
    };
    node.receive(EPOCH, &message);
    let expected = Some(Stamped::new(wrench, EPOCH));
    assert_eq!(node.pairs[0].wrench, expected);
    let [_, mut motion] = axle_report(AxleId(1), EPOCH, Posture::ORIGIN, 1, None);
    if let Message::AxleMotion {
        velocity_m_s,
        yaw_rate_rad_s,
        ..
    } = &mut motion
    {
        (*velocity_m_s, *yaw_rate_rad_s) = (0.125, -0.25);
    }
    node.receive(EPOCH, &motion);
    let twist = node.tracks[1].report.twist;
    assert_eq!((twist.v, twist.omega), (0.125, -0.25));
}

#[test]
fn posture_and_motion_in_either_order_give_an_estimate() {
    for swapped in [false, true] {
        let mut node = node();
        for axle in [AxleId(0), AxleId(1)] {
            let mut messages = axle_report(axle, EPOCH, Posture::ORIGIN, 1, None);
            if swapped {
                messages.reverse();
            }
            for message in &messages {
                node.receive(EPOCH, message);
            }
        }
        assert!(node.fuse(EPOCH, &mut Own::default()).is_some(), "{swapped}");
    }
}

#[test]
fn covariance_of_an_axle_counts_once_per_epoch() {
    let mut node = node();
    let covariance = diagonal([1e-9, 2e-9, 3e-9]);
    epoch(&mut node, 1, [(Posture::ORIGIN, 1); 2]);
    let message = Message::AxleUncertainty {
        axle: AxleId(1),
        sequence: sequence(4 * EPOCH),
        covariance,
    };
    node.receive(4 * EPOCH, &message);
    for axle in [AxleId(0), AxleId(1)] {
        for message in axle_report(axle, 4 * EPOCH, Posture::ORIGIN, 4, None) {
            node.receive(4 * EPOCH, &message);
        }
    }
    let [front, rear] = &mut node.tracks[..] else {
        panic!("two axles");
    };
    let covariances = [front, rear].map(|track| match track.advance(4 * EPOCH) {
        track::Advance::Moved(increment) => increment.covariance,
        other => panic!("{other:?}"),
    });
    let expected = [diagonal([0.0; 3]), diagonal([3e-9, 6e-9, 9e-9])];
    for (covariance, expected) in covariances.iter().flatten().zip(expected.iter().flatten()) {
        for (value, expected) in covariance.iter().zip(expected) {
            assert!((value - expected).abs() < 1e-14, "{covariances:?}");
        }
    }
}

#[test]
fn measurement_of_the_frame_is_used_once() {
    let mut node = node();
    for number in 1..=3 {
        for message in beam(number * EPOCH, Posture::new(0.37, 0.0, 0.0)) {
            node.receive(number * EPOCH, &message);
        }
        let measurement = |node: &LeadNode| {
            let tracks = [&node.tracks[0], &node.tracks[1]];
            node.pairs[0].measurement(number * EPOCH, tracks)
        };
        assert!(measurement(&node).is_some(), "{number}");
        epoch(&mut node, number, [(Posture::ORIGIN, number as u8); 2]);
        assert_eq!(measurement(&node), None, "{number}");
    }
}

#[test]
fn long_silence_of_the_bus_is_not_taken_for_a_restart() {
    let mut node = node();
    let at = |x: f32| Posture::new(x, 0.0, 0.0);
    epoch(&mut node, 0, [(at(0.0), 0); 2]);
    let before = epoch(&mut node, 1, [(at(0.0), 1); 2]);
    let after = epoch(&mut node, 101, [(at(0.25), 101); 2]);
    let moved = after.fused.robot.posture.x - before.fused.robot.posture.x;
    assert!((moved - 0.25).abs() < 1e-4, "{moved}");
}

/// The bias estimate of a gyro is reset when the axle zeroes this gyro, and only then.
#[test]
fn zeroing_a_gyro_resets_its_bias_estimate_alone() {
    use crate::fusion::constants::GYRO_BIAS;
    let mut node = node();
    let rate = 4e-4;
    // The frame stays straight, but the front gyro measures a turn of its axle.
    let mut known = |number: u64, zeroed: [bool; 2]| {
        let now = number * EPOCH;
        let sequence = sequence(now);
        for axle in [AxleId(0), AxleId(1)] {
            let front = if axle == AxleId(0) { 1.0 } else { 0.0 };
            let turned = front * rate * 0.01 * number as f32;
            let posture = Posture::new(0.0, 0.0, turned);
            let (uptime, zeroed) = (number.min(255) as u8, Some(zeroed[axle.index()]));
            for message in axle_report(axle, now, posture, uptime, zeroed) {
                node.receive(now, &message);
            }
            let covariance = diagonal([1e-12; 3]);
            let uncertainty = Message::AxleUncertainty {
                axle,
                sequence,
                covariance,
            };
            node.receive(now, &uncertainty);
        }
        for message in beam(now, Posture::new(0.37, 0.0, 0.0)) {
            node.receive(now, &message);
        }
        node.step(now + LEAD_PHASE, &mut Outbox::new());
        let joint = node.fusion().unwrap().joint().unwrap();
        [0, 1].map(|axle| {
            let k = GYRO_BIAS + axle;
            (joint.constants()[k], joint.constant_sigmas()[k])
        })
    };
    let mut before = known(0, [false; 2]);
    let prior = before.map(|(_, sigma)| sigma);
    for number in 1..1000 {
        before = known(number, [false; 2]);
    }
    // A true turn would have moved the axle aside, so the reading is bias.
    assert!((before[0].0 / rate + 1.0).abs() < 0.1, "{before:?}");
    // Without learning, the standard deviation would be that of a walk over 10 s.
    let walked = crate::fusion::joint::Config::default().gyro_bias_walk_rad_s_per_sqrt_s;
    let unknown = (prior[0] * prior[0] + 10.0 * walked * walked).sqrt();
    let learnt = before.iter().all(|(_, sigma)| *sigma < 0.6 * unknown);
    assert!(learnt, "{before:?}");
    let after = known(1000, [true, false]);
    assert!(after[0].0.abs() < 0.05 * rate, "{after:?}");
    assert!((after[0].1 / prior[0] - 1.0).abs() < 0.02, "{after:?}");
    assert!((after[1].1 / before[1].1 - 1.0).abs() < 0.02, "{after:?}");
    assert!((0.0..NIS_LIMIT).contains(&node.pairs[0].nis));
}

/// The limits are coordinates of 100 km, standard deviations of 1 km (or rad), and a floor drift of 1.
#[test]
fn start_place_is_sound_within_its_ranges() {
    let sound = RobotConfig::default().placement(Posture::ORIGIN, &Default::default());
    assert!(sound.is_sound());
    for relative in [false, true] {
        let changed = |change: &dyn Fn(&mut Estimate)| {
            let mut placement = sound;
            change(if relative {
                &mut placement.relative
            } else {
                &mut placement.center
            });
            placement.is_sound()
        };
        for (value, expected) in [
            (1e5, true),
            (-1e5, true),
            (1.001e5, false),
            (-1.001e5, false),
            (f32::NAN, false),
            (f32::INFINITY, false),
        ] {
            assert_eq!(changed(&|it| it.posture.x = value), expected, "{value}");
            assert_eq!(changed(&|it| it.posture.y = value), expected, "{value}");
            assert_eq!(changed(&|it| it.posture.phi = value), expected, "{value}");
        }
        for i in 0..3 {
            for (value, expected) in [
                (0.0, true),
                (1e6, true),
                (1.001e6, false),
                (-1e-9, false),
                (f32::NAN, false),
            ] {
                assert_eq!(
                    changed(&|it| it.covariance[i][i] = value),
                    expected,
                    "{value}"
                );
            }
            for (value, expected) in [(-1e6, true), (-1.001e6, false), (f32::NAN, false)] {
                let j = (i + 1) % 3;
                assert_eq!(
                    changed(&|it| it.covariance[i][j] = value),
                    expected,
                    "{value}"
                );
            }
        }
    }
    for (drift, expected) in [
        (0.0, true),
        (1.0, true),
        (1.01, false),
        (-0.01, false),
        (f32::NAN, false),
    ] {
        let placement = Placement {
            floor_drift: drift,
            ..sound
        };
        assert_eq!(placement.is_sound(), expected, "{drift}");
    }
}

/// The estimate is at the latest epoch that all axles have reported.
#[test]
fn estimate_waits_for_an_axle_that_is_late_by_an_epoch() {
    for late in [AxleId(0), AxleId(1)] {
        let mut node = node();
        for number in 1..=5 {
            let now = number * EPOCH;
            for axle in [AxleId(0), AxleId(1)] {
                if axle == late && number == 5 {
                    continue;
                }
                let at = Posture::new(0.001 * number as f32, 0.0, 0.0);
                for message in axle_report(axle, now, at, number as u8, None) {
                    node.receive(now, &message);
                }
            }
            node.step(now + LEAD_PHASE, &mut Outbox::new());
        }
        for track in &node.tracks[..2] {
            assert_eq!(track.odometry.unwrap().time, 4 * EPOCH, "{late:?}");
        }
        // An advance to the same epoch is no motion.
        let again = node.tracks[0].advance(4 * EPOCH);
        assert_eq!(again, track::Advance::Unknown);
        let mut report = node.tracks[0].report;
        report.uptime = Some(Stamped::new(0, 9 * EPOCH));
        report.posture = Some(Stamped::new(Posture::ORIGIN, 9 * EPOCH));
        report.complete();
        assert_eq!(
            report.past.at(4 * EPOCH),
            None,
            "of another odometric frame"
        );
        assert!(report.past.at(9 * EPOCH).is_some());
    }
}

#[test]
fn reports_older_than_the_timeout_give_no_estimate() {
    let mut node = node();
    epoch(&mut node, 1, [(Posture::ORIGIN, 1); 2]);
    let last = EPOCH + node.with.report_timeout;
    assert!(node.clone().fuse(last, &mut Own::default()).is_some());
    assert!(node.fuse(last + 1, &mut Own::default()).is_none());
}

/// A stop, or a drive without commands, is done at less than 4 mm/s.
#[test]
fn a_stop_is_done_below_the_speed_of_rest() {
    let by_hand = Task::Drive {
        speed_m_s: 0.0,
        curvature: 0.0,
    };
    for task in [Task::Stop, by_hand] {
        for (v, done) in [
            (4e-3, false),
            (3.9e-3, true),
            (-3.9e-3, true),
            (-4e-3, false),
        ] {
            let mut node = node();
            node.command(task);
            node.state.silent = DEAD_MAN;
            node.state.governor.motion.v = v;
            let decision = node.decide(0, &Transform::from(Posture::ORIGIN), &mut Own::default());
            assert_eq!(decision.done, done, "{task:?} {v}");
        }
    }
}

/// Posture and covariance may arrive in either order; one message alone makes no measurement.
#[test]
fn posture_and_covariance_of_one_epoch_make_a_measurement() {
    let posture = Posture::new(0.37, 0.0, 0.1);
    for swapped in [false, true] {
        let mut node = node();
        for (now, complete) in [(5 * EPOCH, true), (6 * EPOCH, false)] {
            let mut messages = beam(now, posture);
            if swapped {
                messages.reverse();
            }
            for message in &messages[..if complete { 2 } else { 1 }] {
                node.receive(now, message);
            }
            assert_eq!(
                node.pairs[0].measured.at(now).is_some(),
                complete,
                "{swapped}"
            );
        }
    }
}

#[test]
fn fault_of_an_axle_or_the_lead_node_makes_the_robot_faulted() {
    for sender in [Node::axle(0), Node::axle(1), Node::beam(0)] {
        let mut node = node();
        let reason = Condition::SupplyLow.code();
        node.receive(0, &beat(sender, 0, OperatingState::Fault, reason));
        let faulted = node.activity(0) == Activity::Faulted;
        assert_eq!(faulted, sender != Node::beam(0), "{sender:?}");
    }
    let mut node = node();
    node.state.supervisor = supervisor_in(OperatingState::Fault);
    assert_eq!(node.activity(0), Activity::Faulted);
}

/// Without a drive the status releases the axles and contains the commanded motion.
#[test]
fn lead_node_without_a_drive_sends_its_status_each_epoch() {
    for (task, expected) in [(Task::Idle, LeadMode::Idle), (Task::Clear, LeadMode::Clear)] {
        let mut node = node();
        node.command(task);
        node.state.governor.motion.v = 0.1;
        let mut outbox = Outbox::new();
        let output = epoch_to(&mut node, 1, [(Posture::ORIGIN, 1); 2], &mut outbox);
        let status = outbox.iter().find_map(|message| match *message {
            Message::LeadStatus {
                mode, velocity_m_s, ..
            } => Some((mode, velocity_m_s)),
            _ => None,
        });
        // The governor brakes for an epoch of 10 ms.
        let mut braked = node.state.governor;
        braked.motion.v = 0.1;
        node.with.governor.stop(&mut braked);
        assert_eq!(output.motion.v, braked.motion.v);
        assert_eq!(status, Some((expected, output.motion.v)));
        assert!(output.motion.v < 0.1);
    }
}

/// Without power the frame straightens: the next drive begins with its estimated bend.
#[test]
fn a_drive_begins_with_the_bend_of_the_frame() {
    // The relative heading is 0.2 rad, a steering of 0.1 rad. Up to 0.05 rad of difference count as error of the
    // estimate.
    let config = RobotConfig::default();
    let mut placement = config.placement(Posture::ORIGIN, &Default::default());
    placement.relative.posture.phi = 0.2;
    for (commanded, begins) in [
        (0.3, 0.1),
        (-0.1, 0.1),
        (0.14, 0.14),
        (0.06, 0.06),
        (0.16, 0.1),
        (0.04, 0.1),
    ] {
        let mut node = node();
        node.initialize(&placement);
        node.state.governor.motion.psi = Steering(commanded);
        let output = epoch(&mut node, 1, [(Posture::ORIGIN, 1); 2]);
        assert!((output.motion.psi.0 - begins).abs() < 2e-3, "{commanded}");
    }
}

/// A goal counts as reached with certainty if the 95 % ellipse around the estimate lies within the tolerance.
#[test]
fn goal_with_a_wide_95_percent_error_is_uncertain() {
    let mut node = node();
    let fused = epoch(&mut node, 1, [(Posture::ORIGIN, 1); 2]).fused;
    // The tolerances are 10 cm and 0.0873 rad; the 95 % errors are 2.448 and 1.960 standard deviations.
    let cases = [
        ([0.040, 0.01], 0.0, true),
        ([0.042, 0.01], 0.0, false),
        ([0.030, 0.01], 0.02, true),
        ([0.030, 0.01], 0.03, false),
        ([0.010, 0.044], 0.0, true),
        ([0.010, 0.045], 0.0, false),
    ];
    for ([position, heading], off, certain) in cases {
        let mut fused = fused;
        let at = Posture::new(0.0, off, 0.0);
        fused.robot = Estimate::with_sigmas(at, [position, 1e-3, heading]);
        (node.state.aim, node.state.done) = (Some(Posture::ORIGIN), true);
        let conditions = node.watch(EPOCH, Some(&Fused::of_pair(fused)));
        let uncertain = conditions.contains(Condition::ReachedUncertain);
        assert_eq!(uncertain, !certain, "{position} {heading} {off}");
    }
}

/// The default limits are 25 N, 6 N m, 5 m and 0.5 rad.
#[test]
fn wrench_and_uncertainty_beyond_their_limits_are_detected() {
    let limits = Limits::default();
    let wrench = |[force_x, force_y, moment_root, moment_end]: [f32; 4]| Wrench {
        force_x,
        force_y,
        moment_root,
        moment_end,
    };
    assert!(!limits.exceeded_by(&wrench([20.0, -14.0, 5.9, -5.9])));
    assert!(limits.exceeded_by(&wrench([20.0, -16.0, 0.0, 0.0])));
    for (k, value) in [(1, f32::NAN), (2, 6.1), (3, -6.1)] {
        let mut beyond = [0.0; 4];
        beyond[k] = value;
        assert!(limits.exceeded_by(&wrench(beyond)), "{beyond:?}");
    }
    assert!(!limits.exceeded_by(&wrench([25.0, 0.0, 6.0, -6.0])));
    let vague = |sigmas| limits.is_vague(&Estimate::with_sigmas(Posture::ORIGIN, sigmas));
    assert!(!vague([4.9, 4.9, 0.49]) && !vague([5.0, 5.0, 0.5]));
    let mut config = RobotConfig::default();
    config.lead.stop.release_s = 1.75;
    assert_eq!(config.build_lead().unwrap_err().field, "release_s");
    assert!(vague([5.1, 0.1, 0.1]) && vague([0.1, 5.1, 0.1]) && vague([0.1, 0.1, 0.51]));
}

#[test]
fn beam_posture_without_gauges_is_ignored() {
    let mut node = node();
    let before = node.clone();
    let sequence = sequence(EPOCH);
    let message = Message::BeamPosture {
        frame: FrameId(0),
        sequence,
        posture: Posture::ORIGIN,
        gauges: 0,
    };
    node.receive(EPOCH, &message);
    assert!(node == before);
}

/// The robot has axles 0 and 1 and frame 0.
#[test]
fn messages_of_axles_and_frames_of_another_robot_change_nothing() {
    let mut node = node();
    let before = node.clone();
    let (axle, frame) = (AxleId(2), FrameId(1));
    let sequence = sequence(EPOCH);
    let covariance = diagonal([1e-9; 3]);
    let posture = Posture::new(0.37, 0.0, 0.1);
    let reports = axle_report(axle, EPOCH, posture, 1, Some(true));
    let others = [
        Message::AxleUncertainty {
            axle,
            sequence,
            covariance,
        },
        Message::BeamPosture {
            frame,
            sequence,
            posture,
            gauges: 5,
        },
        Message::BeamUncertainty {
            frame,
            sequence,
            covariance,
        },
        Message::BeamWrench {
            frame,
            sequence,
            wrench: Wrench::ZERO,
        },
    ];
    for message in reports.into_iter().chain(others) {
        node.receive(EPOCH, &message);
        assert!(node == before, "{message:?}");
    }
}
