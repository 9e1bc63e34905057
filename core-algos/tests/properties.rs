//! Invariants of the nodes and filters for any input: NaN and infinity, messages of any content, a clock that stands
//! still or runs back.
//!
//! Single algorithms have such tests beside their code; here all run together.

#![allow(
    clippy::disallowed_methods,
    reason = "a test compares with another implementation"
)]

#[path = "../src/properties.rs"]
#[allow(unused_macros)]
mod properties;
#[path = "../src/fusion/testing.rs"]
#[allow(dead_code)]
mod testing;

use core_algos::beam::MAX_GAUGES;
use core_algos::bus::{self, LeadMode, Message};
use core_algos::control::path::{PathPoint, TrajectoryPoint};
use core_algos::fusion::Estimate;
use core_algos::fusion::ekf::{self, Measurements};
use core_algos::math::matrix::Mat3;
use core_algos::math::{Posture, Wrench};
use core_algos::node::board::{Board, Samples};
use core_algos::node::lead::Task;
use core_algos::node::robot::{ConfiguredPlacement, RobotConfig};
use core_algos::node::{Outbox, axle};
use core_algos::time::{EPOCH, LEAD_PHASE, Micros, TICK};
use core_algos::topology::{AxleId, FrameId, Role, Topology, Wheels};
use proptest::prelude::*;

/// Numbers, some of them NaN or infinite.
fn number() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => -2.0f32..2.0,
        1 => Just(f32::NAN),
        1 => Just(f32::INFINITY),
        1 => Just(f32::NEG_INFINITY),
        1 => prop_oneof![Just(f32::MAX), Just(f32::MIN), Just(1e-40f32), Just(0.0f32)],
        1 => any::<u32>().prop_map(f32::from_bits),
    ]
}

/// Measurement of a broken sensor: within ±20, NaN or infinite.
fn measured() -> impl Strategy<Value = f32> {
    number().prop_map(|x| match x.is_finite() {
        true => x.clamp(-20.0, 20.0),
        false => x,
    })
}

fn numbers<const N: usize>() -> impl Strategy<Value = [f32; N]> {
    prop::collection::vec(number(), N).prop_map(|v| v.try_into().unwrap())
}

/// Messages of any content.
fn message() -> impl Strategy<Value = Message> {
    let axle = prop_oneof![Just(AxleId(0)), Just(AxleId(1))];
    let mode = prop::sample::select(&[LeadMode::Idle, LeadMode::Active, LeadMode::Hold]);
    (0..8u8, numbers::<9>(), any::<u8>(), any::<u8>(), axle, mode).prop_map(
        |(kind, n, sequence, byte, axle, mode)| {
            let posture = Posture::new(n[0], n[1], n[2]);
            let covariance: Mat3 = [[n[0], n[1], n[2]], [n[3], n[4], n[5]], [n[6], n[7], n[8]]];
            match kind {
                0 => Message::LeadStatus {
                    sequence,
                    mode,
                    steering_rad: n[0],
                    velocity_m_s: n[1],
                },
                1 => Message::ReferencePosture {
                    axle,
                    sequence,
                    posture,
                },
                2 => Message::ReferenceMotion {
                    axle,
                    sequence,
                    velocity_m_s: n[0],
                    yaw_rate_rad_s: n[1],
                    acceleration_m_s2: n[2],
                    yaw_acceleration_rad_s2: n[3],
                },
                3 => Message::AxlePosture {
                    axle,
                    sequence,
                    posture,
                },
                4 => Message::AxleMotion {
                    axle,
                    sequence,
                    velocity_m_s: n[0],
                    yaw_rate_rad_s: n[1],
                    refused: byte,
                    gyro_samples: byte & 0x7f,
                    gyro_zeroed: byte & 1 == 1,
                    uptime: byte,
                },
                5 => Message::AxleUncertainty {
                    axle,
                    sequence,
                    covariance,
                },
                6 => Message::BeamPosture {
                    frame: FrameId(0),
                    sequence,
                    posture,
                    gauges: byte % 6,
                },
                _ => Message::BeamWrench {
                    frame: FrameId(0),
                    sequence,
                    wrench: Wrench {
                        force_x: n[0],
                        force_y: n[1],
                        moment_root: n[2],
                        moment_end: n[3],
                    },
                },
            }
        },
    )
}

#[derive(Clone, Debug)]
struct Tick {
    /// Time since the last tick, µs: usually one tick; 0 for a clock that stands still, negative if the clock runs
    /// back.
    passed: i64,
    encoder: [Option<i32>; 2],
    inertial: [Option<f32>; 2],
    counts: [i32; MAX_GAUGES],
    received: Vec<Message>,
    task: Option<Task>,
}

fn tick() -> impl Strategy<Value = Tick> {
    let passed = prop_oneof![
        20 => Just(TICK as i64),
        1 => Just(0),
        1 => -50_000i64..50_000,
        1 => -5_000_000i64..5_000_000,
    ];
    let encoder =
        prop_oneof![6 => Just(Some(0)), 1 => Just(None), 1 => any::<i32>().prop_map(Some)];
    let counts = prop_oneof![4 => 2000i32..2100, 1 => any::<i32>()];
    let task = prop_oneof![
        20 => Just(None),
        1 => Just(Some(Task::Stop)),
        1 => Just(Some(Task::follow())),
        1 => Just(Some(Task::track())),
        1 => numbers::<3>().prop_map(|g| Some(Task::regulate(g.into()))),
    ];
    (
        passed,
        [encoder.clone(), encoder],
        [prop::option::of(number()), prop::option::of(number())],
        prop::collection::vec(counts, MAX_GAUGES),
        prop::collection::vec(message(), 0..3),
        task,
    )
        .prop_map(|(passed, encoder, inertial, counts, received, task)| Tick {
            passed,
            encoder,
            inertial,
            counts: counts.try_into().unwrap(),
            received,
            task,
        })
}

fn finite(posture: Posture) -> bool {
    posture.x.is_finite() && posture.y.is_finite() && posture.phi.is_finite()
}

/// Runs every board on the same ticks and checks the outputs.
fn drive(ticks: &[Tick]) -> Result<(), TestCaseError> {
    let config = RobotConfig::default();
    let torque = config.axle.controller.max_torque_nm;
    let (speed, steering) = (config.limits.max_speed_m_s, config.limits.max_steering_rad);
    for role in Topology::PAIR.boards() {
        let mut board = Board::new(&config, role).unwrap();
        if let Some(lead) = board.lead() {
            lead.initialize(&config.placement(Posture::ORIGIN, &ConfiguredPlacement::default()));
        }
        let (mut now, mut outbox): (Micros, _) = (20_000_000, Outbox::new());
        for tick in ticks {
            now = now.saturating_add_signed(tick.passed);
            // The lead node works at one phase of an epoch, so ticks with an even interval are moved to that phase.
            let at = match tick.passed % 2 {
                0 => now / EPOCH * EPOCH + LEAD_PHASE,
                _ => now,
            };
            if let (Some(lead), Some(task)) = (board.lead(), tick.task) {
                let n = tick.inertial.map(|n| n.unwrap_or(0.1));
                let (posture, [kappa, s]) = (Posture::new(n[0], n[1], 0.0), n);
                let point = PathPoint { posture, kappa, s };
                // Rejected or not, a pushed point must not do harm.
                let _ = lead.path_task().push_path_point(point);
                let [time_s, v] = n;
                let timed = TrajectoryPoint { time_s, v, point };
                let _ = lead.path_task().push_trajectory_point(timed);
                lead.command(task);
            }
            for message in &tick.received {
                board.receive(at, message);
            }
            let samples = match role {
                Role::Beam(_) => Samples::Beam(tick.counts.into()),
                _ => Samples::Axle(axle::Samples {
                    encoder: tick.encoder.into(),
                    gyro_rad_s: tick.inertial[0],
                    acceleration_m_s2: tick.inertial[1],
                    ..axle::Samples::default()
                }),
            };
            outbox.clear();
            let output = board.step(at, &samples, &mut outbox);
            for wheel in output.torque_nm.list() {
                prop_assert!(wheel.abs() <= torque, "{role:?} {output:?}");
            }
            prop_assert!(output.active || output.torque_nm == Wheels::both(0.0));
            for message in outbox.iter() {
                // Encoding may refuse a value out of range, but never NaN or infinity, which must not get this far.
                if let Err(error) = bus::encode(message) {
                    prop_assert!(error.value.is_finite(), "{role:?} {message:?}");
                }
            }
            if let Some(lead) = output.lead {
                let motion = lead.motion;
                prop_assert!(motion.v.abs() <= speed * 1.0001, "{motion:?}");
                prop_assert!(motion.psi.0.abs() <= steering, "{motion:?}");
                prop_assert!(motion.psi_rate.is_finite());
                prop_assert!(finite(lead.fused.robot.posture), "{:?}", lead.fused);
            }
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..properties::config(256) })]

    #[test]
    fn no_input_drives_an_output_beyond_its_limits(ticks in prop::collection::vec(tick(), 1..120)) {
        drive(&ticks)?;
    }

    /// The axle filter under any measurements within the range of its sensors; its gates accept contradictions that
    /// persist. NaN and infinity count as absent, and the covariance stays positive definite.
    #[test]
    fn axle_filter_stays_finite_and_positive_definite(
        steps in prop::collection::vec(prop::array::uniform4(prop::option::of(measured())), 1..400),
    ) {
        let filter = ekf::Config::default().build().unwrap();
        let known = Estimate::with_sigmas(Posture::ORIGIN, [1e-3; 3]);
        let mut state = ekf::State::at_rest(&known, [1e-2; 4]);
        for [left_m_s, right_m_s, gyro_rad_s, acceleration_m_s2] in steps {
            let measurements = Measurements { left_m_s, right_m_s, gyro_rad_s, acceleration_m_s2 };
            filter.step(&mut state, &measurements);
            prop_assert!(state.is_finite());
            let p = state.covariance().wide_matrix();
            prop_assert!(testing::is_definite(&p), "{p:?}");
            let heading = state.posture().phi;
            prop_assert!(heading.abs() <= std::f32::consts::PI + 1e-6, "{heading}");
        }
    }
}
