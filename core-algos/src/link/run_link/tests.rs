//! Tests of a driving board from the host's side of the link.

use super::*;
use crate::beam::MAX_GAUGES;
use crate::bus::Message;
use crate::fusion::testing::Random;
use crate::link::framing::Counters;
use crate::link::protocol::{POINTS, Packed};
use crate::link::tests::{CONFIG, STACK, below, damage, order, payloads, placement, stamp};
use crate::math::Posture;
use crate::node::lead::Task;
use crate::node::{axle, beam};
use crate::safety::Conditions;
use crate::time::TICK;
use crate::topology::{FrameId, Topology, Wheels};

mod report;

const MOTORS: [MotorState; 3] = [MotorState::Off, MotorState::Braking, MotorState::Driven];

fn crash() -> CrashRecord {
    CrashRecord {
        counts: [1, 2, 3, 4],
        message: heapless::String::try_from("panicked at tick.rs:120").unwrap(),
    }
}

/// Run link with its board state and latest demand.
struct Driving {
    run_link: RunLink,
    station: Station,
    demand: Option<Demand>,
}

impl Driving {
    fn new(role: Role) -> Self {
        let identity = Identity {
            build: "test build",
            role,
        };
        Self {
            run_link: RunLink::new(identity, &CONFIG, || STACK, crash),
            station: Station::default(),
            demand: None,
        }
    }

    /// Order demanded by the latest request.
    fn order(&self) -> Option<Order> {
        match self.demand {
            Some(Demand::Order(_, order)) => Some(order),
            _ => None,
        }
    }

    /// Board after a hello.
    fn after_hello(role: Role) -> Self {
        let mut board = Self::new(role);
        let (protocol, nonce) = (PROTOCOL, 1);
        board.request(200, &Request::Hello { protocol, nonce }, MotorState::Driven);
        board
    }

    /// Payloads of the answers to a request.
    fn request(&mut self, number: u8, request: &Request, motors: MotorState) -> Vec<Vec<u8>> {
        let frame = protocol::encode(number, request).unwrap();
        let mut sent = Vec::new();
        let mut send = |answer: &[u8]| sent.extend_from_slice(answer);
        self.station.motors = motors;
        self.demand = self
            .run_link
            .receive(frame.bytes(), &mut self.station, &mut send);
        payloads(&sent)
    }

    fn expect(&mut self, number: u8, request: &Request, motors: MotorState, reply: Reply) {
        assert_answered(&self.request(number, request, motors), number, reply);
    }

    fn done(&mut self, done: Result<(), PathError>) -> Vec<Vec<u8>> {
        let mut sent = Vec::new();
        self.run_link
            .done(done, &mut |answer| sent.extend_from_slice(answer));
        payloads(&sent)
    }
}

fn assert_answered(answers: &[Vec<u8>], number: u8, reply: Reply) {
    assert_eq!(answers.len(), 1);
    assert_eq!(protocol::decode(&answers[0]), Some((number, reply)));
}

#[test]
fn requests_behind_a_demand_in_the_same_bytes_get_no_answer() {
    let mut board = Driving::after_hello(Role::axle(1));
    board.station.motors = MotorState::Off;
    let requests = [Request::Record(stamp(7, 1)), Request::Watch, Request::Stack];
    let mut bytes = Vec::new();
    for (number, request) in (1..).zip(&requests) {
        bytes.extend_from_slice(protocol::encode(number, request).unwrap().bytes());
    }
    let mut sent = Vec::new();
    let mut send = |answer: &[u8]| sent.extend_from_slice(answer);
    let run_link = &mut board.run_link;
    let demand = run_link.receive(&bytes, &mut board.station, &mut send);
    assert_eq!(demand, Some(Demand::Record));
    assert_answered(&payloads(&sent), 1, Reply::Done);
}

#[test]
fn configuration_of_driving_board_is_read_in_parts() {
    let mut board = Driving::new(Role::axle(1));
    let mut read = Vec::new();
    for number in 1.. {
        let offset = read.len() as u16;
        let answers = board.request(
            number,
            &Request::Configuration { offset },
            MotorState::Driven,
        );
        let Some((_, Reply::Configuration { total, bytes })) = protocol::decode(&answers[0]) else {
            panic!("{answers:?}");
        };
        read.extend_from_slice(bytes);
        if read.len() == usize::from(total) {
            break;
        }
    }
    assert_eq!(postcard::from_bytes(&read), Ok(*CONFIG));
    let beyond = Request::Configuration { offset: u16::MAX };
    let total = read.len() as u16;
    let none = Reply::Configuration { total, bytes: &[] };
    board.expect(99, &beyond, MotorState::Driven, none);
}

/// Frame of a message, as a host packs it.
fn packed(message: &Message) -> (CanFrame, Packed) {
    let frame = bus::encode(message).unwrap();
    let mut packed = Packed::new();
    assert!(packed.push(&frame));
    (frame, packed)
}

/// Reply and demand for each request, board and motor state. An order is answered when done.
#[test]
#[expect(clippy::too_many_lines, reason = "a table")]
fn request_is_granted_or_refused_by_role_and_motor_state() {
    let calibrate = bus::field::Calibrate::Zero(0.0);
    let (service, of_service) = packed(&Message::BeamCalibration {
        frame: FrameId(0),
        sequence: 7,
        calibrate,
    });
    let mut short = Packed::new();
    assert!(short.push(&CanFrame {
        length: 1,
        ..service
    }));
    let (_, forged) = packed(&Message::LeadStatus {
        sequence: 7,
        mode: bus::LeadMode::Active,
        steering_rad: 0.0,
        velocity_m_s: 0.1,
    });
    let (first, conditions) = (stamp(7, 1), Conditions::NONE);
    let (done, refused) = (Some(Reply::Done), |why| Some(Reply::Refused(why)));
    let [armed, malformed, none] =
        [Refusal::Armed, Refusal::Malformed, Refusal::NoSession].map(refused);
    let (stand, stop) = (Order::SetPose(placement()), Order::Task(Task::Stop));
    let crash = Some(Reply::Crash {
        counts: [1, 2, 3, 4],
        message: "panicked at tick.rs:120",
    });
    let order = |order| Request::Order {
        stamp: first,
        order,
    };
    let send = |packed| Request::Send { bus: packed };
    let axle = axle::Samples {
        encoder: Wheels::both(None),
        gyro_rad_s: None,
        acceleration_m_s2: None,
        conditions,
    };
    let beam: beam::Samples = [0; MAX_GAUGES].into();
    let (tick, total, offset) = (0, 0, 0);
    // Columns: request; replies with motors off, braking and driven; true if only the front board takes the request;
    // demand.
    let mut rows = vec![
        (
            Request::Rig,
            [done, armed, armed],
            false,
            Some(Demand::Session),
        ),
        (
            Request::Record(first),
            [done, armed, armed],
            false,
            Some(Demand::Record),
        ),
        (
            order(stand),
            [None, None, armed],
            true,
            Some(Demand::Order(1, stand)),
        ),
        (order(stop), [None; 3], true, Some(Demand::Order(1, stop))),
        (Request::Keep(first), [done; 3], true, None),
        (Request::Release(first), [done; 3], true, None),
        (Request::Watch, [done; 3], false, Some(Demand::Watch)),
        (
            send(of_service.bytes()),
            [done; 3],
            false,
            Some(Demand::Send(service)),
        ),
        (send(forged.bytes()), [malformed; 3], false, None),
        (send(short.bytes()), [malformed; 3], false, None),
        (send(&[]), [malformed; 3], false, None),
        (Request::Stack, [Some(Reply::Stack(STACK)); 3], false, None),
        (Request::Crash, [crash; 3], false, None),
    ];
    rows.extend(
        [
            Request::EndSession,
            Request::Configure {
                total,
                offset,
                bytes: &[],
            },
            Request::Start {
                hash: 0,
                tick,
                place: None,
            },
            Request::Axle {
                tick,
                samples: axle,
                bus: &[],
            },
            Request::Beam {
                tick,
                samples: beam,
            },
            Request::Resume { tick },
            Request::Parameters,
            Request::Parameter { index: 0 },
            Request::SetParameter {
                index: 0,
                value: 1.0,
            },
            Request::SaveParameters,
        ]
        .map(|request| (request, [none; 3], false, None)),
    );
    for ((request, replies, only_front, demand), role) in rows
        .iter()
        .flat_map(|row| Topology::PAIR.boards().map(move |role| (row, role)))
    {
        for (i, motors) in MOTORS.into_iter().enumerate() {
            let mut board = Driving::after_hello(role);
            let other = refused(Refusal::OtherBoard { role });
            let foreign = *only_front && role != Role::LEAD;
            let expected = if foreign { other } else { replies[i] };
            let answers = board.request(1, request, motors);
            let granted = expected.is_none() || expected == done;
            let demanded = demand.clone().filter(|_| granted);
            assert_eq!(board.demand, demanded, "{request:?} {role:?} {motors:?}");
            let reply = match expected {
                Some(reply) => {
                    assert_answered(&answers, 1, reply);
                    reply
                }
                None => {
                    assert!(answers.is_empty(), "{request:?} {role:?} {motors:?}");
                    assert_answered(&board.done(Ok(())), 1, Reply::Done);
                    Reply::Done
                }
            };
            // A repetition gets the same answer in every motor state.
            for motors in MOTORS {
                board.expect(1, request, motors, reply);
                assert_eq!(board.demand, None, "{request:?} {role:?} {motors:?}");
            }
        }
    }
}

#[test]
fn request_that_cannot_be_decoded_is_malformed() {
    let mut board = Driving::new(Role::axle(1));
    for (number, payload) in [(7, &[7, 99][..]), (8, &[8])] {
        let frame = SerialFrame::new(payload).unwrap();
        let mut sent = Vec::new();
        let mut send = |answer: &[u8]| sent.extend_from_slice(answer);
        let demand = board
            .run_link
            .receive(frame.bytes(), &mut board.station, &mut send);
        assert_eq!(demand, None);
        let malformed = Reply::Refused(Refusal::Malformed);
        assert_answered(&payloads(&sent), number, malformed);
    }
}

/// After a hello, no request number counts as a repetition.
#[test]
fn hello_is_answered_in_every_state_and_version_and_clears_the_last_number() {
    for (role, motors, version) in Topology::PAIR
        .boards()
        .flat_map(|role| MOTORS.map(|motors| (role, motors)))
        .flat_map(|(role, motors)| [0, PROTOCOL, PROTOCOL + 1].map(|it| (role, motors, it)))
    {
        let mut board = Driving::new(role);
        board.expect(3, &Request::Stack, motors, Reply::Stack(STACK));
        for nonce in [77, 78] {
            let hello = Request::Hello {
                protocol: version,
                nonce,
            };
            let received = board.run_link.decoder.counters().received;
            let reply = Reply::Hello {
                protocol: PROTOCOL,
                nonce,
                role,
                build: "test build",
                counters: Counters {
                    received,
                    damaged: 0,
                },
                session: false,
            };
            board.expect(3, &hello, motors, reply);
            assert_eq!(board.demand, None);
        }
        let other = Request::Watch;
        board.expect(3, &other, motors, Reply::Done);
        assert_eq!(board.demand, Some(Demand::Watch));
    }
}

/// An order before the hello was meant for the board before its restart, and takes no lease.
#[test]
fn front_board_takes_orders_only_after_the_first_hello() {
    let stop = |owner| Request::Order {
        stamp: stamp(owner, 1),
        order: Order::Task(Task::Stop),
    };
    let mut board = Driving::new(Role::LEAD);
    let no_session = Reply::Refused(Refusal::NoSession);
    board.expect(1, &stop(1), MotorState::Off, no_session);
    assert_eq!(board.demand, None);
    board.expect(2, &Request::Keep(stamp(2, 1)), MotorState::Off, Reply::Done);
    board.expect(3, &stop(2), MotorState::Off, no_session);
    board.expect(
        4,
        &Request::Release(stamp(2, 2)),
        MotorState::Off,
        Reply::Done,
    );
    let (protocol, nonce) = (PROTOCOL + 1, 1);
    board.request(5, &Request::Hello { protocol, nonce }, MotorState::Off);
    assert!(board.request(6, &stop(1), MotorState::Off).is_empty());
    assert!(board.order().is_some());
    // The rear board refuses by role, also before a hello.
    let role = Role::axle(1);
    let other = Reply::Refused(Refusal::OtherBoard { role });
    Driving::new(role).expect(1, &stop(1), MotorState::Off, other);
}

#[test]
fn requests_in_the_same_bytes_are_answered_in_order() {
    let mut board = Driving::after_hello(Role::LEAD);
    let frames = [Request::Stack, Request::Watch].map(|it| protocol::encode(9, &it));
    let [stack, watch] = frames.map(Option::unwrap);
    let hello = Request::Hello {
        protocol: PROTOCOL,
        nonce: 1,
    };
    let hello = protocol::encode(9, &hello).unwrap();
    let lot = [stack.bytes(), hello.bytes(), watch.bytes()].concat();
    let mut sent = Vec::new();
    let mut send = |answer: &[u8]| sent.extend_from_slice(answer);
    let demand = board.run_link.receive(&lot, &mut board.station, &mut send);
    assert_eq!(demand, Some(Demand::Watch));
    let answers = payloads(&sent);
    assert_answered(&answers[..1], 9, Reply::Stack(STACK));
    assert_answered(&answers[2..], 9, Reply::Done);
    // The answer to a repetition begins with a 0, in case the first one was cut short.
    let answer = sent.split_off(sent.len() - board.run_link.answer.bytes().len());
    let mut again = Vec::new();
    let mut send = |answer: &[u8]| again.extend_from_slice(answer);
    let demand = board
        .run_link
        .receive(watch.bytes(), &mut board.station, &mut send);
    assert_eq!((demand, again), (None, [&[0], &answer[..]].concat()));
}

/// A request for another board is forwarded each time, and one reply of that board is returned.
#[test]
fn request_for_another_board_is_relayed_and_its_reply_returned() {
    let mut board = Driving::new(Role::LEAD);
    let mut room = [[0; 32]; 2];
    let [request, reply] = &mut room;
    let inner = postcard::to_slice(&(9u8, Request::Stack), request).unwrap();
    let role = Role::beam(0);
    let relay = Request::Relay {
        role,
        payload: inner,
    };
    for _ in 0..2 {
        assert!(board.request(9, &relay, MotorState::Driven).is_empty());
        let frame = SerialFrame::new(inner).unwrap();
        assert_eq!(board.demand, Some(Demand::Relay(role, frame)));
    }
    let reply = postcard::to_slice(&(9u8, Reply::Stack(STACK)), reply).unwrap();
    let mut relayed = |from| {
        let mut sent = Vec::new();
        let mut send = |bytes: &[u8]| sent.extend_from_slice(bytes);
        board.run_link.relayed(from, reply, &mut send);
        payloads(&sent)
    };
    assert!(relayed(Role::axle(1)).is_empty());
    assert_answered(&relayed(role), 9, Reply::Relayed { payload: reply });
    assert!(relayed(role).is_empty());
    // Identifiers on the bus do not name the relaying board, so only the front board relays. No board relays to itself.
    for (from, to) in Topology::PAIR
        .boards()
        .flat_map(|from| Topology::PAIR.boards().map(move |to| (from, to)))
        .filter(|&(from, to)| from != Role::LEAD || to == from)
    {
        let mut board = Driving::new(from);
        let relay = Request::Relay {
            role: to,
            payload: inner,
        };
        let other = Reply::Refused(Refusal::OtherBoard { role: from });
        board.expect(9, &relay, MotorState::Driven, other);
        assert_eq!(board.demand, None);
    }
}

#[test]
fn repeated_order_is_carried_out_once_and_answered_when_done() {
    let mut board = Driving::after_hello(Role::LEAD);
    let goal = Posture::new(1.0, -0.5, 0.25);
    let drive = Order::Task(Task::regulate(goal));
    let request = order(drive);
    assert!(board.request(1, &request, MotorState::Driven).is_empty());
    assert_eq!(board.order(), Some(drive));
    // The host repeats the order before it is done.
    assert!(board.request(1, &request, MotorState::Driven).is_empty());
    assert_eq!(board.demand, None);
    let hello = Request::Hello {
        protocol: PROTOCOL,
        nonce: 1,
    };
    for (number, other) in [(2, &request), (3, &Request::Watch), (4, &hello)] {
        assert!(board.request(number, other, MotorState::Off).is_empty());
        assert_eq!(board.demand, None);
    }
    assert_answered(&board.done(Ok(())), 1, Reply::Done);
    assert!(board.done(Ok(())).is_empty());
    board.expect(1, &request, MotorState::Driven, Reply::Done);
    assert_eq!(board.demand, None);

    let points = [None; POINTS];
    let path = order(Order::Path { points, end: true });
    assert!(board.request(2, &path, MotorState::Driven).is_empty());
    let full = Reply::Refused(Refusal::Point(PathError::Full));
    assert_answered(&board.done(Err(PathError::Full)), 2, full);
    board.expect(2, &path, MotorState::Driven, full);
}

/// An order of another host or a delayed order does not reach the lead node.
#[test]
fn order_without_the_lease_or_with_an_old_sequence_is_refused() {
    let mut board = Driving::after_hello(Role::LEAD);
    let stop = Order::Task(Task::Stop);
    let of = |owner, sequence| Request::Order {
        stamp: stamp(owner, sequence),
        order: stop,
    };
    let refused = Reply::Refused;
    assert!(board.request(1, &of(1, 10), MotorState::Driven).is_empty());
    assert_eq!(board.order(), Some(stop));
    assert_answered(&board.done(Ok(())), 1, Reply::Done);
    for (number, request, refusal) in [
        (2, of(2, 11), Refusal::Leased),
        (3, of(1, 10), Refusal::OldOrder),
        (4, Request::Keep(stamp(2, 11)), Refusal::Leased),
        (5, Request::Release(stamp(2, 12)), Refusal::Leased),
        (10, Request::Record(stamp(2, 12)), Refusal::Leased),
        (11, Request::Record(stamp(1, 10)), Refusal::OldOrder),
    ] {
        board.expect(number, &request, MotorState::Off, refused(refusal));
        assert_eq!(board.demand, None, "{request:?}");
    }
    // Watching needs no lease.
    board.expect(6, &Request::Watch, MotorState::Driven, Reply::Done);
    let keep = Request::Keep(stamp(1, 11));
    board.expect(7, &keep, MotorState::Driven, Reply::Done);
    let release = Request::Release(stamp(1, 12));
    board.station.now = 900_000;
    board.expect(8, &release, MotorState::Driven, Reply::Done);
    board.station.now = 1_000_001;
    assert!(board.request(9, &of(2, 1), MotorState::Driven).is_empty());
    assert_eq!(board.order(), Some(stop));
    board.done(Ok(()));
    // A `SetPose` refused as armed renews the lease; a `Record` refused as armed does not.
    board.station.now = 2_000_001;
    let stand = Request::Order {
        stamp: stamp(2, 2),
        order: Order::SetPose(placement()),
    };
    board.expect(12, &stand, MotorState::Driven, refused(Refusal::Armed));
    let record = Request::Record(stamp(2, 3));
    for (number, now) in [(13, 3_000_000), (14, 3_000_001)] {
        board.station.now = now;
        board.expect(number, &record, MotorState::Driven, refused(Refusal::Armed));
    }
    let keep = Request::Keep(stamp(1, 1));
    board.expect(15, &keep, MotorState::Driven, refused(Refusal::Leased));
    board.station.now = 3_000_002;
    board.expect(16, &keep, MotorState::Driven, Reply::Done);
    // Boards without the lead node have no lease.
    let mut board = Driving::after_hello(Role::axle(1));
    for owner in [1, 2] {
        let record = Request::Record(stamp(owner, 1));
        board.expect(owner as u8, &record, MotorState::Off, Reply::Done);
    }
}

/// A driving board receives orders of two hosts: in order, delayed, of the host without the lease, or damaged. The lead
/// node receives only undamaged orders of the host with the lease, each once.
#[test]
fn late_foreign_and_damaged_orders_do_not_reach_the_lead_node() {
    const FRAMES: u32 = 1_000_000;
    let mut random = Random::new(17);
    let mut board = Driving::after_hello(Role::LEAD);
    let (mut sequence, mut sent, mut carried) = (0u16, 0, 0);
    for k in 0..FRAMES {
        board.station.now += TICK;
        let goal = Posture::new(k as f32, 0.0, 0.0);
        let order = Order::Task(Task::regulate(goal));
        // The first order takes the lease.
        let kind = below(&mut random, if sent == 0 { 1 } else { 4 });
        let next = sequence.wrapping_add(1);
        let (owner, number) = match kind {
            0 | 1 => (1, next),
            2 => (1, sequence.wrapping_sub(below(&mut random, 1000) as u16)),
            _ => (2, below(&mut random, 65536) as u16),
        };
        let stamp = stamp(owner, number);
        let request = Request::Order { stamp, order };
        let frame = protocol::encode((k % 255) as u8 + 1, &request).unwrap();
        let mut bytes = frame.repeated().to_vec();
        match kind {
            0 => sent += 1,
            1 => {
                damage(&mut random, &mut bytes);
                bytes.push(0);
            }
            _ => {}
        }
        let demand = board
            .run_link
            .receive(&bytes, &mut board.station, &mut |_| {});
        if demand.is_none() {
            assert_ne!(kind, 0);
            continue;
        }
        // Damage to the delimiters may leave the order intact.
        assert!(kind < 2, "{stamp:?}");
        assert_eq!(demand, Some(Demand::Order(next, order)));
        board.done(Ok(()));
        (sequence, carried) = (next, carried + 1);
    }
    assert!(sent > FRAMES / 5 && carried >= sent, "{sent} {carried}");
}

#[test]
fn relay_without_a_request_is_malformed() {
    let mut board = Driving::new(Role::LEAD);
    let (role, payload) = (Role::beam(0), &[][..]);
    let malformed = Reply::Refused(Refusal::Malformed);
    let relay = Request::Relay { role, payload };
    board.expect(9, &relay, MotorState::Driven, malformed);
    assert_eq!(board.demand, None);
}
