use super::*;
use crate::beam::MAX_GAUGES;
use crate::control::path::{PathError, PathPoint};
use crate::link::Order;
use crate::link::tests::{Host, axle, axle_samples, board, is_axle_reply, order, placement, start};
use crate::node::lead::Task;
use crate::safety::{Conditions, OperatingState};
use crate::topology::Node;

#[test]
fn invalid_request_is_refused_with_its_reason() {
    let config = RobotConfig::default();
    let beam = Request::Beam {
        tick: 0,
        samples: [0; MAX_GAUGES].into(),
    };

    let mut host = Host::new(Role::LEAD);
    host.refused(&axle(0, &[]), Refusal::NoSession);
    assert_eq!(host.send_hello(PROTOCOL + 1), Role::LEAD);
    host.refused(&axle(0, &[]), Refusal::NoSession);
    host.hello();
    let unknown = [
        SerialFrame::new(&[200, 99]).unwrap(),
        SerialFrame::new(&[201]).unwrap(),
    ];
    for (number, frame) in (200..).zip(unknown) {
        let payload = host.send(frame.bytes());
        let malformed = Reply::Refused(Refusal::Malformed);
        assert_eq!(protocol::decode(&payload), Some((number, malformed)));
    }
    host.refused(&axle(0, &[]), Refusal::NotStarted);
    let role = Role::LEAD;
    host.refused(&beam, Refusal::OtherBoard { role });

    // The configuration is refused if parts are out of order, its checksum is wrong, it is undecodable or out of range.
    let configure = |total, offset, bytes| Request::Configure {
        total,
        offset,
        bytes,
    };
    let (ones, junk) = ([1; 100], [200; 100]);
    let part = |total, offset| configure(total, offset, &ones);
    host.refused(&part(300, 100), Refusal::Part { received: 0 });
    let hash = crc32c(&ones);
    host.expect(&part(300, 0), Reply::Configured { hash });
    host.refused(&part(300, 200), Refusal::Part { received: 100 });
    host.refused(&part(400, 100), Refusal::Part { received: 100 });
    host.refused(&part(99, 0), Refusal::Part { received: 0 });
    let hash = host.configure(&config);
    host.refused(&start(hash ^ 1, 0, None), Refusal::Hash { found: hash });
    host.request(&configure(100, 0, &junk));
    host.refused(&start(crc32c(&junk), 0, None), Refusal::Undecodable);
    let mut wrong = config;
    wrong.geometry.wheel_radius_m = f32::NAN;
    let hash = host.configure(&wrong);
    let text = &wrong.build().unwrap_err().to_string();
    host.refused(&start(hash, 0, None), Refusal::Parameter { text });
    assert!(text.contains("wheel_radius_m"));
    host.refused(&axle(0, &[]), Refusal::NotStarted);

    let mut host = Host::started(Role::LEAD, &config, None);
    host.refused(&axle(1, &[]), Refusal::Tick { expected: 0 });
    host.request(&axle(0, &[]));
    host.refused(&axle(0, &[]), Refusal::Tick { expected: 1 });
    let mut points = [None; protocol::POINTS];
    points[..2].fill(Some(PathPoint::default()));
    let refusal = Refusal::Point(PathError::NotAdvancing);
    host.refused(&order(Order::Path { points, end: true }), refusal);

    let stop = order(Order::Task(Task::Stop));
    for (role, request) in [(Role::axle(1), stop), (Role::beam(0), axle(0, &[]))] {
        let mut host = Host::started(role, &config, None);
        host.refused(&request, Refusal::OtherBoard { role });
    }
    let payload = Host::started(Role::beam(0), &config, None).request(&beam);
    let reply = protocol::decode::<Reply>(&payload);
    assert!(matches!(reply, Some((_, Reply::Beam { .. }))), "{reply:?}");
}

/// A board that gets its frames in several requests acts like a board that gets them in one.
#[test]
fn frames_sent_ahead_precede_those_of_the_tick() {
    let config = RobotConfig::default();
    let role = Role::axle(1);
    let mut host = Host::new(role);
    host.hello();
    fn ahead(tick: u32, bus: &[u8]) -> Request<'_> {
        Request::Frames { tick, bus }
    }
    host.refused(&ahead(0, &[]), Refusal::NotStarted);
    let beam = Role::beam(0);
    let other = Refusal::OtherBoard { role: beam };
    Host::started(beam, &config, None).refused(&ahead(0, &[]), other);
    let heartbeat = |node, sequence| {
        let message = bus::Message::NodeStatus {
            node,
            sequence,
            state: OperatingState::Idle,
            reason: 0,
            notices: Conditions::NONE,
        };
        bus::encode(&message).unwrap()
    };
    let packed = |frames: &[bus::CanFrame]| {
        let mut packed = Packed::new();
        assert!(frames.iter().all(|frame| packed.push(frame)));
        packed
    };
    let invalid = bus::CanFrame {
        id: 0x7ff,
        length: 8,
        data: [0; 8],
    };
    let [mut whole, mut parts] = [(); 2].map(|()| Host::started(role, &config, None));
    parts.refused(&ahead(1, &[]), Refusal::Tick { expected: 0 });
    for tick in 0..200 {
        let frames = [Node::axle(0), Node::Lead].map(|node| heartbeat(node, tick as u8));
        let [first, last] = frames;
        let all = packed(&[first, invalid, last]);
        let expected = whole.request(&axle(tick, all.bytes()));
        let [begin, rest] = [packed(&[first, invalid]), packed(&[last])];
        parts.expect(&ahead(tick, begin.bytes()), Reply::Done);
        let found = parts.request(&axle(tick, rest.bytes()));
        assert!(matches!(
            protocol::decode(&found),
            Some((_, Reply::Axle { refused: 1, .. }))
        ));
        assert_eq!(found[1..], expected[1..], "{tick}");
        assert_eq!(parts.board.board(), whole.board.board());
    }
}

#[test]
fn board_resumes_at_the_given_tick() {
    let mut host = Host::new(Role::axle(1));
    host.hello();
    host.refused(&Request::Resume { tick: 7 }, Refusal::NotStarted);
    let config = RobotConfig::default();
    let mut host = Host::started(Role::axle(1), &config, None);
    let mut board = Board::new(&config, Role::axle(1)).unwrap();
    let mut outbox = Outbox::new();
    for tick in (0..300).chain(600..900) {
        if tick == 600 {
            host.refused(&axle(600, &[]), Refusal::Tick { expected: 300 });
            host.expect(&Request::Resume { tick: 600 }, Reply::Done);
        }
        outbox.clear();
        let samples = Samples::Axle(axle_samples(tick));
        let expected = board.step(u64::from(tick) * TICK, &samples, &mut outbox);
        let payload = host.request(&axle(tick, &[]));
        let Some((_, Reply::Axle { torque_nm, bus, .. })) = protocol::decode(&payload) else {
            panic!("tick {tick}");
        };
        assert_eq!(torque_nm, expected.torque_nm);
        assert_eq!(protocol::unpack(bus).count(), outbox.iter().count());
    }
    // A tick before the expected one is refused.
    let expected = 900;
    host.refused(&Request::Resume { tick: 899 }, Refusal::Tick { expected });
}

#[test]
fn build_is_cut_between_characters_to_64_bytes() {
    let sixty_three = "123456789 123456789 123456789 123456789 123456789 123456789 123";
    let role = Role::axle(1);
    for (rest, kept) in [("", 63), ("4", 64), ("45", 64), ("µ", 63), ("4µ", 64)] {
        let text = std::format!("{sixty_three}{rest}").leak();
        let identity = Identity { build: text, role };
        assert_eq!(identity.short_build(), &text[..kept], "{rest}");
    }
}

#[test]
fn hello_closes_or_opens_the_session_and_discards_nodes_configuration_and_leave() {
    let config = RobotConfig::default();
    for version in [PROTOCOL, PROTOCOL - 1, PROTOCOL + 1] {
        let mut host = Host::started(Role::axle(1), &config, None);
        host.expect(&Request::EndSession, Reply::Done);
        let received = host.board.counters().received;
        let hello = Request::Hello {
            protocol: version,
            nonce: 5,
        };
        let reply = Reply::Hello {
            protocol: PROTOCOL,
            nonce: 5,
            role: Role::axle(1),
            build: "test build",
            counters: Counters {
                received: received + 1,
                damaged: 0,
            },
            session: true,
        };
        host.expect(&hello, reply);
        assert!(!host.board.has_ended() && host.board.board().is_none());
        if version != PROTOCOL {
            host.refused(&Request::Stack, Refusal::NoSession);
            host.hello();
        }
        let found = crc32c(&[]);
        for hash in [found ^ 1, found] {
            let refusal = match hash == found {
                false => Refusal::Hash { found },
                true => Refusal::Undecodable,
            };
            host.refused(&start(hash, 0, None), refusal);
        }
        host.refused(&axle(0, &[]), Refusal::NotStarted);
    }
}

#[test]
fn start_with_partial_configuration_is_refused_and_discards_the_nodes() {
    let config = RobotConfig::default();
    let mut host = Host::started(Role::axle(1), &config, None);
    let part = Request::Configure {
        total: 300,
        offset: 0,
        bytes: &[1; 100],
    };
    let found = crc32c(&[1; 100]);
    host.expect(&part, Reply::Configured { hash: found });
    assert!(is_axle_reply(&host.request(&axle(0, &[]))));
    host.refused(&start(found, 1, None), Refusal::Hash { found });
    host.refused(&axle(1, &[]), Refusal::NotStarted);
}

#[test]
fn restarted_nodes_send_no_output_of_the_previous_nodes() {
    let config = RobotConfig::default();
    let mut host = Host::started(Role::LEAD, &config, Some(placement()));
    let part = |payload: &[u8]| match protocol::decode(payload) {
        Some((_, Reply::Axle { telemetry, .. })) => telemetry.len(),
        other => panic!("{other:?}"),
    };
    // Tick of the lead node's first output, which is sent in several replies.
    let mut tick = 0;
    while part(&host.request(&axle(tick, &[]))) == 0 {
        tick += 1;
        assert!(tick < 20);
    }
    let hash = host.configure(&config);
    host.expect(&start(hash, tick + 1, Some(placement())), Reply::Done);
    assert_eq!(part(&host.request(&axle(tick + 1, &[]))), 0);
}

#[test]
fn repeated_answer_begins_with_a_0() {
    let mut board = board(Role::axle(1), &Contents::EMPTY);
    let request = protocol::encode(7, &Request::Stack).unwrap();
    let mut answer = |bytes: &[u8]| {
        let mut sent = Vec::new();
        board.receive(bytes, &mut |answer| sent.extend_from_slice(answer));
        sent
    };
    let first = answer(request.bytes());
    assert_eq!(answer(request.bytes()), [&[0], &first[..]].concat());
}

#[test]
fn save_is_pending_once_and_other_requests_get_no_answer_meanwhile() {
    let mut board = board(Role::axle(1), &Contents::EMPTY);
    let send = |board: &mut SimLink, number, request: &Request| {
        let mut sent = Vec::new();
        let frame = protocol::encode(number, request).unwrap();
        board.receive(frame.bytes(), &mut |answer| sent.extend_from_slice(answer));
        sent
    };
    let (protocol, nonce) = (PROTOCOL, 1);
    let hello = Request::Hello { protocol, nonce };
    for (number, values, reported) in [(1, 3, 3), (11, 255, 255), (21, 256, 255), (31, 300, 255)] {
        assert!(!send(&mut board, 0, &hello).is_empty());
        assert_eq!(board.save(), None);
        assert!(send(&mut board, number, &Request::SaveParameters).is_empty());
        assert!(board.save().is_some());
        assert_eq!(board.save(), None);
        for request in [Request::SaveParameters, Request::Stack, hello] {
            assert!(send(&mut board, number + 1, &request).is_empty());
            assert_eq!(board.save(), None);
        }
        let mut sent = Vec::new();
        let mut take = |answer: &[u8]| sent.extend_from_slice(answer);
        board.saved(Some((values, &Contents::EMPTY)), &mut take);
        board.saved(None, &mut take);
        let reply = Reply::Saved { values: reported };
        let expected = protocol::encode(number, &reply).unwrap();
        assert_eq!(sent, expected.bytes());
        assert!(!send(&mut board, number + 1, &Request::Stack).is_empty());
    }
}

#[test]
fn resume_takes_the_next_tick_or_a_later_one() {
    let mut host = Host::started(Role::axle(1), &RobotConfig::default(), None);
    host.request(&axle(0, &[]));
    host.refused(&Request::Resume { tick: 0 }, Refusal::Tick { expected: 1 });
    for tick in [1, 1, 2, 70] {
        host.expect(&Request::Resume { tick }, Reply::Done);
    }
    host.refused(&axle(69, &[]), Refusal::Tick { expected: 70 });
    host.refused(&axle(71, &[]), Refusal::Tick { expected: 70 });
    assert!(is_axle_reply(&host.request(&axle(70, &[]))));
}

#[test]
fn bus_frames_that_cannot_be_decoded_are_counted() {
    let unknown = bus::CanFrame {
        id: 0x7ff,
        length: 8,
        data: [0; 8],
    };
    for count in [0u8, 1, 2, 21] {
        let mut host = Host::started(Role::axle(1), &RobotConfig::default(), None);
        let mut packed = Packed::new();
        for _ in 0..count {
            assert!(packed.push(&unknown));
        }
        let payload = host.request(&axle(0, packed.bytes()));
        let Some((_, Reply::Axle { refused, .. })) = protocol::decode(&payload) else {
            panic!("{payload:?}");
        };
        assert_eq!(refused, count);
    }
}
