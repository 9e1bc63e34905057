//! Serial link of a board: random bytes, and random content in frames with right checksums.
#![no_main]

use cfmmr_fuzz::numbers::Bytes;
use core_algos::bus;
use core_algos::link::framing::{MAX_FRAME, SerialFrame, crc32c};
use core_algos::link::protocol::{
    self, CONFIG_CHUNK, MAX_CONFIG, MAX_TELEMETRY, PROTOCOL, Reply, Request, StackUse,
};
use core_algos::link::{Identity, SimLink};
use core_algos::node::robot::RobotConfig;
use core_algos::topology::{Role, Wheels};
use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;

/// Links of boards whose nodes are started.
static STARTED: LazyLock<[SimLink; 3]> = LazyLock::new(|| Role::PAIR.map(started));

fn identity(role: Role) -> Identity {
    Identity {
        build: "fuzz",
        role,
    }
}

fn started(role: Role) -> SimLink {
    let mut room = [0; MAX_CONFIG];
    let config = postcard::to_slice(&RobotConfig::default(), &mut room).unwrap();
    let hello = Request::Hello {
        protocol: PROTOCOL,
        nonce: 1,
    };
    let mut requests = vec![hello];
    for (i, bytes) in config.chunks(CONFIG_CHUNK).enumerate() {
        let (total, offset) = (config.len() as u16, (i * CONFIG_CHUNK) as u16);
        requests.push(Request::Configure {
            total,
            offset,
            bytes,
        });
    }
    requests.push(Request::Start {
        hash: crc32c(config),
        tick: 0,
        place: None,
    });
    let mut board = SimLink::new(identity(role), StackUse::unknown);
    for (number, request) in (0..).zip(&requests) {
        board.receive(
            protocol::encode(number, request).unwrap().bytes(),
            &mut |_| {},
        );
    }
    assert!(board.board().is_some());
    board
}

fuzz_target!(|data: &[u8]| {
    let mut bytes = Bytes(data);
    let kind = bytes.byte();
    let role = Role::PAIR[usize::from(kind) % 3];
    let mut board = match kind & 0x80 {
        0 => SimLink::new(identity(role), StackUse::unknown),
        _ => STARTED[usize::from(kind) % 3].clone(),
    };
    if kind & 0x40 == 0 {
        let ends = bytes.0.iter().filter(|&&byte| byte == 0).count();
        let before = board.counters();
        let mut answers = 0;
        for byte in bytes.0 {
            let mut send = |answer: &[u8]| {
                answers += 1;
                check(answer, role);
            };
            board.receive(&[*byte], &mut send);
            fail_to_save(&mut board, &mut send);
        }
        let counters = board.counters();
        let (received, damaged) = (
            counters.received - before.received,
            counters.damaged - before.damaged,
        );
        assert!(answers == received as usize && (received + damaged) as usize <= ends);
        return;
    }
    while !bytes.is_empty() {
        let length = usize::from(bytes.byte());
        let payload = bytes.take(length);
        let Some(frame) = SerialFrame::new(payload) else {
            continue;
        };
        let first = answer(&mut board, frame.bytes(), role);
        assert_eq!(
            first.first(),
            payload.first(),
            "an answer bears its request's number"
        );
        // A repeated request gives an equal reply and no action; a hello is never a repetition.
        if !matches!(protocol::decode(payload), Some((_, Request::Hello { .. }))) {
            assert_eq!(answer(&mut board, frame.repeated(), role), first);
        }
    }
});

/// Payload of the only answer to a frame.
fn answer(board: &mut SimLink, frame: &[u8], role: Role) -> Vec<u8> {
    let mut payloads = Vec::new();
    let mut send = |answer: &[u8]| payloads.push(check(answer, role));
    board.receive(frame, &mut send);
    fail_to_save(board, &mut send);
    assert_eq!(payloads.len(), 1, "one answer to one request");
    payloads.remove(0)
}

/// Lets a pending save fail, as a store that cannot be written does.
fn fail_to_save(board: &mut SimLink, send: &mut impl FnMut(&[u8])) {
    if let Some(save) = board.save() {
        assert!(save.settings.check_role(board.stored().kind()).is_ok());
        board.saved(None, send);
    }
}

/// Checks that an answer is one whole frame with valid content; returns the payload.
fn check(answer: &[u8], role: Role) -> Vec<u8> {
    assert!(answer.len() <= MAX_FRAME && answer.last() == Some(&0));
    let mut decoder = core_algos::link::framing::Decoder::new();
    let mut payload = None;
    for &byte in answer {
        if let Some(found) = decoder.take_byte(byte) {
            assert!(payload.replace(found.to_vec()).is_none(), "one frame");
        }
    }
    let payload = payload.expect("a whole frame");
    let (_, reply) = protocol::decode::<Reply>(&payload).expect("a reply");
    let frames = match reply {
        Reply::Axle {
            torque_nm,
            active,
            bus,
            telemetry,
            ..
        } => {
            assert_ne!(role, Role::beam(0));
            let limit = RobotConfig::default().axle.controller.max_torque_nm;
            assert!(
                torque_nm.list().iter().all(|torque| torque.abs() <= limit),
                "{torque_nm:?}"
            );
            assert!(active || torque_nm == Wheels::both(0.0));
            assert!(telemetry.len() <= MAX_TELEMETRY);
            bus
        }
        Reply::Beam { bus, .. } => {
            assert_eq!(role, Role::beam(0));
            bus
        }
        _ => &[],
    };
    for frame in protocol::unpack(frames) {
        bus::decode(&frame).expect("what a board sends, others can read");
    }
    payload
}
