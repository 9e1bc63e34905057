use super::*;
use crate::bus::layout::MESSAGES;
use crate::control::path::{PathPoint, TrajectoryPoint};
use crate::node::robot::RobotConfig;
use crate::safety::{Condition, Conditions};
use crate::topology::{Topology, Wheels};
use proptest::prelude::*;

/// The encoded message.
fn payload<T: Serialize>(message: &T) -> Vec<u8> {
    let mut room = [0; MAX_PAYLOAD];
    postcard::to_slice(&(7u8, message), &mut room)
        .unwrap()
        .to_vec()
}

#[test]
fn encode_longest_messages_fits_frame() {
    let far = PathPoint {
        kappa: f32::MAX,
        ..PathPoint::default()
    };
    let stamp = Stamp {
        owner: u16::MAX,
        sequence: u16::MAX,
    };
    let order = |order| Request::Order { stamp, order };
    let path = order(Order::Path {
        points: [Some(far); POINTS],
        end: true,
    });
    let trajectory = order(Order::Trajectory {
        points: [Some(TrajectoryPoint::default()); POINTS],
        end: true,
    });
    let configure = Request::Configure {
        total: u16::MAX,
        offset: u16::MAX,
        bytes: &[255; CONFIG_CHUNK],
    };
    let full = [255; 10 * MAX_BUS_FRAMES];
    let axle = Request::Axle {
        tick: u32::MAX,
        samples: axle::Samples {
            encoder: Wheels::both(Some(i32::MIN)),
            gyro_rad_s: Some(1.0),
            acceleration_m_s2: Some(1.0),
            conditions: Condition::ALL
                .into_iter()
                .fold(Conditions::NONE, |all, one| {
                    all.union(Conditions::only(one))
                }),
        },
        bus: &full,
    };
    let beam = Request::Beam {
        tick: u32::MAX,
        samples: [i32::MIN; crate::beam::MAX_GAUGES].into(),
    };
    let frames = Request::Frames {
        tick: u32::MAX,
        bus: &full,
    };
    for request in [path, trajectory, configure, axle, beam, frames] {
        assert!(encode(255, &request).is_some(), "{request:?}");
    }
    for sent in [10 * MAX_SENT_FRAMES, 0] {
        let reply = Reply::Axle {
            torque_nm: Wheels::both(1.0),
            active: true,
            refused: 255,
            bus: &full[..sent],
            telemetry: &[255; MAX_PAYLOAD][..MAX_PAYLOAD - TICK_REPLY_HEAD - sent],
        };
        assert!(encode(255, &reply).is_some());
    }
}

#[test]
fn telemetry_largest_lead_output_fits_epoch() {
    let output = lead::Output {
        target: Some(Default::default()),
        inner: [Some(Default::default()); lead::MAX_INNER],
        fused: crate::fusion::robot::Output {
            ipec: Some(crate::fusion::ipec::Correction::default()),
            omega: Some([0.5; 2]),
            ..Default::default()
        },
        supervision: crate::safety::supervisor::Output {
            reason: Some(Condition::Restarted),
            ..Default::default()
        },
        ..Default::default()
    };
    let telemetry = Telemetry {
        output,
        tick: u32::MAX,
        path_room: u16::MAX,
        trajectory_room: u16::MAX,
    };
    let mut room = [0; 2 * MAX_TELEMETRY];
    let used = postcard::to_slice(&telemetry, &mut room).unwrap();
    assert!(used.len() <= MAX_TELEMETRY - 2, "{}", used.len());
}

/// The lead node's step of a robot with five axles, with 13 frames, is two ticks before the end of the epoch.
#[test]
fn largest_output_is_sent_before_the_epoch_ends() {
    for axles in 2..=crate::topology::MAX_AXLES {
        let robot = Topology::new(axles).unwrap();
        let mut spread = Spread::default();
        spread.bytes.resize_default(MAX_TELEMETRY).unwrap();
        let step = lead::step_phase(robot);
        for now in (step..EPOCH).step_by(TICK as usize) {
            let frames = if now == step { 3 + 2 * axles } else { 0 };
            let room = MAX_PAYLOAD - TICK_REPLY_HEAD - 10 * frames;
            let chunk = spread.chunk(now).min(room);
            assert!(axles > 2 || chunk == TELEMETRY_CHUNK);
            spread.next(chunk);
        }
        assert_eq!(spread.left(), 0, "{axles}");
    }
}

#[test]
fn configuration_survives_encoding_and_builds_the_same_robot() {
    let mut config = RobotConfig::default();
    config.geometry.wheel_radius_m = 0.0731;
    config.geometry.rigid_end_m = 0.01;
    config.geometry.frame_length_m = 0.36;
    config.limits.max_steering_rad = 0.45;
    for config in [config, config.completed()] {
        let mut room = [0; MAX_CONFIG];
        let bytes = postcard::to_slice(&config, &mut room).unwrap();
        let back: RobotConfig = postcard::from_bytes(bytes).unwrap();
        assert_eq!(back.build().unwrap(), config.build().unwrap());
    }
}

#[test]
fn message_with_trailing_bytes_is_not_decoded() {
    let mut bytes = payload(&Reply::Done);
    assert_eq!(decode(&bytes), Some((7, Reply::Done)));
    bytes.push(0);
    assert_eq!(decode::<Reply>(&bytes), None);
}

#[test]
fn packed_frames_are_bounded_and_truncated_frame_is_dropped() {
    let frame = bus::CanFrame {
        id: 0x7ff,
        length: 8,
        data: [255; 8],
    };
    let mut packed = Packed::new();
    for _ in 0..MAX_BUS_FRAMES {
        assert!(packed.push(&frame));
    }
    assert!(!packed.push(&frame));
    assert_eq!(unpack(packed.bytes()).count(), MAX_BUS_FRAMES);
    let (_, cut) = packed.bytes().split_last().unwrap().1.split_at(0);
    assert_eq!(unpack(cut).count(), MAX_BUS_FRAMES - 1);
    // Length 15, which no frame has.
    let mut long = [1; 18];
    long[..2].copy_from_slice(&[0, 0xf0]);
    assert_eq!(unpack(&long).count(), 0);
}

properties! {
    #[test]
    fn packed_frames_survive_unpacking(list in prop::collection::vec((0..MESSAGES.len(), any::<[u8; 8]>()), 0..MAX_BUS_FRAMES)) {
        let mut packed = Packed::new();
        let frames: Vec<bus::CanFrame> = list.iter().map(|&(k, mut data)| {
            let length = MESSAGES[k].bytes();
            data[usize::from(length)..].fill(0);
            bus::CanFrame { id: MESSAGES[k].id, length, data }
        }).collect();
        for frame in &frames {
            prop_assert!(packed.push(frame));
        }
        prop_assert_eq!(unpack(packed.bytes()).collect::<Vec<_>>(), frames);
    }

    #[test]
    fn samples_keep_their_bits(bits: [u32; 2], encoder: [Option<i32>; 2]) {
        let samples = axle::Samples {
            encoder: encoder.into(),
            gyro_rad_s: Some(f32::from_bits(bits[0])),
            acceleration_m_s2: Some(f32::from_bits(bits[1])),
            conditions: Conditions::NONE,
        };
        let bytes = payload(&Request::Axle { tick: 5, samples, bus: &[] });
        let Some((7, Request::Axle { samples: back, .. })) = decode(&bytes) else {
            panic!("{bytes:?}");
        };
        prop_assert_eq!(back.encoder.list(), encoder);
        prop_assert_eq!(back.gyro_rad_s.map(f32::to_bits), Some(bits[0]));
        prop_assert_eq!(back.acceleration_m_s2.map(f32::to_bits), Some(bits[1]));
    }
}

/// 20 frames of ten bytes and one of five leave five bytes.
#[test]
fn push_without_room_leaves_packed_frames_unchanged() {
    let frame = |length| bus::CanFrame {
        id: 0x123,
        length,
        data: [7; 8],
    };
    let mut packed = Packed::new();
    assert!(packed.push(&frame(3)));
    assert!((0..20).all(|_| packed.push(&frame(8))));
    let before = packed.bytes().to_vec();
    assert_eq!(before.len(), 205);
    assert!(!packed.push(&frame(8)) && !packed.push(&frame(4)));
    assert_eq!(packed.bytes(), before);
    assert!(packed.push(&frame(3)));
    assert_eq!(unpack(packed.bytes()).count(), 22);
}
