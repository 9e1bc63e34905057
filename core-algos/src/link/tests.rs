//! Endpoint, protocol and framing together, as a host sees them.

use super::endpoint::{Endpoint, Identity};
use super::framing::{Decoder, MAX_FRAME, SerialFrame, crc32c};
use super::lease::Stamp;
use super::order::Order;
use super::protocol::{
    self, CONFIG_CHUNK, MAX_CONFIG, PROTOCOL, Packed, Place, Refusal, Reply, Request, StackUse,
    Telemetry,
};
use crate::beam::MAX_GAUGES;
use crate::bus;
use crate::control::path::{PathError, PathPoint};
use crate::fusion::Estimate;
use crate::fusion::testing::Random;
use crate::math::Posture;
use crate::node::Outbox;
use crate::node::axle;
use crate::node::board::{Board, Samples};
use crate::node::lead::Task;
use crate::node::robot::RobotConfig;
use crate::params::{COUNT, Contents, Settings, Source, TABLE, fingerprint};
use crate::safety::Conditions;
use crate::time::{EPOCH, LEAD_PHASE, TICK};
use crate::topology::Role;
use core::sync::atomic::{AtomicU16, Ordering};
use std::sync::LazyLock;

/// Stack use that the board reports.
pub(super) const STACK: StackUse = StackUse {
    used_bytes: 17_001,
    budget_bytes: 17_000,
    size_bytes: 90_000,
};

/// Configuration of the nodes of boards that drive.
pub(super) static CONFIG: LazyLock<RobotConfig> = LazyLock::new(RobotConfig::default);

/// A host that speaks to an endpoint without loss.
struct Host {
    board: Endpoint,
    number: u8,
    /// Contents of the board's store, and its number of writes; a broken store is not written.
    store: Contents,
    saves: u32,
    broken: bool,
}

impl Host {
    fn new(role: Role) -> Self {
        Self {
            board: board(role, &Contents::EMPTY),
            number: 0,
            store: Contents::EMPTY,
            saves: 0,
            broken: false,
        }
    }

    /// Switches the board off and on again.
    fn reset(&mut self, role: Role) {
        self.board = board(role, &self.store);
    }

    /// Writes the store, if the board asks for that.
    fn serve(&mut self, send: &mut impl FnMut(&[u8])) {
        let Some(save) = self.board.save() else {
            return;
        };
        if self.broken {
            return self.board.saved(None, send);
        }
        self.saves += 1;
        let before = self.store;
        let mut values = 0;
        for (key, item) in before.changes(&save.settings, &save.base) {
            self.store.take(key, &item.to_bytes());
            values += 1;
        }
        if let Some(manifest) = self.store.manifest() {
            self.store.take(0, &manifest.to_bytes());
        }
        self.board.saved(Some((values, &self.store)), send);
    }

    /// The answer's payload to raw bytes.
    fn send(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut sent = Vec::new();
        let mut take = |answer: &[u8]| sent.extend_from_slice(answer);
        self.board.receive(bytes, &mut take);
        self.serve(&mut take);
        payloads(&sent).pop().unwrap_or_default()
    }

    /// The answer's payload to a request with the next number.
    fn ask(&mut self, request: &Request) -> Vec<u8> {
        self.number = self.number.wrapping_add(1);
        self.send(protocol::encode(self.number, request).unwrap().bytes())
    }

    fn expect(&mut self, request: &Request, reply: Reply) {
        let payload = self.ask(request);
        assert_eq!(protocol::decode(&payload), Some((self.number, reply)));
    }

    fn refused(&mut self, request: &Request, refusal: Refusal) {
        self.expect(request, Reply::Refused(refusal));
    }

    /// Says hello in a version of the protocol; gives the role in the answer.
    fn greet(&mut self, version: u16) -> Role {
        let request = Request::Hello {
            protocol: version,
            nonce: 9,
        };
        let payload = self.ask(&request);
        let Some((
            _,
            Reply::Hello {
                protocol,
                nonce,
                role,
                build,
                ..
            },
        )) = protocol::decode(&payload)
        else {
            panic!("{payload:?}");
        };
        assert_eq!((protocol, nonce, build), (PROTOCOL, 9, "test build"));
        role
    }

    fn hello(&mut self) {
        self.greet(PROTOCOL);
    }

    /// Sends the parameters; gives their check sum.
    fn configure(&mut self, config: &RobotConfig) -> u32 {
        let mut room = [0; MAX_CONFIG];
        let bytes = postcard::to_slice(config, &mut room).unwrap();
        for (k, part) in bytes.chunks(CONFIG_CHUNK).enumerate() {
            let offset = k * CONFIG_CHUNK;
            let request = Request::Configure {
                total: bytes.len() as u16,
                offset: offset as u16,
                bytes: part,
            };
            let hash = crc32c(&bytes[..offset + part.len()]);
            self.expect(&request, Reply::Configured { hash });
        }
        crc32c(bytes)
    }

    fn started(role: Role, config: &RobotConfig, place: Option<Place>) -> Self {
        let mut host = Self::new(role);
        host.hello();
        let hash = host.configure(config);
        host.expect(&start(hash, 0, place), Reply::Done);
        host
    }
}

fn board(role: Role, contents: &Contents) -> Endpoint {
    let build = "test build";
    let mut board = Endpoint::new(Identity { build, role }, || STACK);
    board.load(contents);
    board
}

pub(super) fn place() -> Place {
    Place {
        center: Estimate::with_sigmas(Posture::new(-1.0, -1.0, 0.2), [1e-3; 3]),
        relative: Estimate::with_sigmas(Posture::new(0.37, 0.0, 0.0), [1e-3; 3]),
        floor_drift: 0.01,
    }
}

/// An axle at rest, as the lead node wants it before it drives, and then on the move.
fn axle_samples(tick: u32) -> axle::Samples {
    let moving = tick.saturating_sub(200);
    axle::Samples {
        encoder: [Some(moving as i32 / 7), Some(moving as i32 / 5)],
        gyro_rad_s: Some(0.001 * moving as f32),
        acceleration_m_s2: None,
        conditions: Conditions::NONE,
    }
}

fn axle(tick: u32, bus: &[u8]) -> Request<'_> {
    let samples = axle_samples(tick);
    Request::Axle { tick, samples, bus }
}

/// True if a payload is the reply to samples of an axle.
fn is_axle_reply(payload: &[u8]) -> bool {
    let reply = protocol::decode::<Reply>(payload);
    matches!(reply, Some((_, Reply::Axle { .. })))
}

fn start(hash: u32, tick: u32, place: Option<Place>) -> Request<'static> {
    Request::Start { hash, tick, place }
}

pub(super) fn stamp(owner: u16, sequence: u16) -> Stamp {
    Stamp { owner, sequence }
}

/// Echo of a front board's frames by the bus: each frame, and its reports as if from the other axle too.
fn echo(frames: impl IntoIterator<Item = bus::CanFrame>) -> Vec<bus::CanFrame> {
    let mut echo = Vec::new();
    for frame in frames {
        echo.push(frame);
        if (0x100..0x200).contains(&frame.id) || frame.id == 0x041 {
            let id = frame.id + 1;
            echo.push(bus::CanFrame { id, ..frame });
        }
    }
    echo
}

/// All bits of what a front board does.
fn bits(sent: &impl serde::Serialize) -> Vec<u8> {
    let mut room = [0; 512];
    postcard::to_slice(sent, &mut room).unwrap().to_vec()
}

#[test]
fn a_front_board_behind_frames_does_what_it_does_without() {
    let config = RobotConfig::default();
    let mut host = Host::started(Role::Front, &config, Some(place()));
    let mut board = Board::new(&config, Role::Front).unwrap();
    let lead = board.lead().unwrap();
    lead.initialize(&place());
    let goal = Posture::ORIGIN;
    let command = Task::regulate(goal);

    let (mut outbox, mut waiting) = (Outbox::new(), Vec::<bus::CanFrame>::new());
    let (mut received, mut wanted, mut outputs, mut driven) = (Vec::new(), Vec::new(), 0, 0);
    for tick in 0..400u32 {
        let now = u64::from(tick) * TICK;
        // A board that comes up while the robot is driven would stay off.
        if tick == 100 {
            board.lead().unwrap().command(command);
            host.expect(&order(Order::Task(command)), Reply::Done);
        }
        let mut packed = Packed::new();
        for frame in &waiting {
            assert!(packed.push(frame));
            board.receive(now, &bus::decode(frame).unwrap());
        }
        outbox.clear();
        let output = board.step(now, &Samples::Axle(axle_samples(tick)), &mut outbox);
        let frames: Vec<_> = outbox.iter().map(|m| bus::encode(m).unwrap()).collect();
        waiting = echo(frames.iter().copied());
        let payload = host.ask(&axle(tick, packed.bytes()));
        let Some((_, reply)) = protocol::decode(&payload) else {
            panic!("tick {tick}");
        };
        let Reply::Axle { bus, telemetry, .. } = reply else {
            panic!("{reply:?}");
        };
        let expected = Reply::Axle {
            torque_nm: output.torque_nm,
            active: output.active,
            refused: 0,
            bus,
            telemetry,
        };
        assert_eq!(bits(&reply), bits(&expected));
        driven += u32::from(output.torque_nm != [0.0; 2]);
        assert_eq!(protocol::unpack(bus).collect::<Vec<_>>(), frames);
        if now % EPOCH == LEAD_PHASE {
            received.clear();
            let lead = board.lead().unwrap().path_task();
            wanted = bits(&Telemetry {
                output: output.lead.unwrap(),
                tick: (now / TICK) as u32,
                path_room: lead.path_room() as u16,
                trajectory_room: lead.trajectory_room() as u16,
            });
        }
        received.extend_from_slice(telemetry);
        if now % EPOCH == EPOCH - TICK {
            let (length, bytes) = received.split_first_chunk().unwrap();
            assert_eq!(usize::from(u16::from_le_bytes(*length)), bytes.len());
            assert_eq!(bytes, wanted);
            outputs += 1;
        }
    }
    assert_eq!(outputs, 40);
    assert!(driven > 100, "{driven}");
    assert_eq!(host.board.board(), Some(&board));
}

#[test]
fn a_repeated_request_is_answered_and_not_carried_out_again() {
    let mut host = Host::started(Role::Rear, &RobotConfig::default(), None);
    for tick in 0..300 {
        let request = axle(tick, &[]);
        let first = host.ask(&request);
        let after = host.board.board().cloned();
        let frame = protocol::encode(host.number, &request).unwrap();
        for _ in 0..tick % 3 {
            assert_eq!(host.send(frame.repeated()), first);
        }
        assert_eq!(host.board.board().cloned(), after);
    }
}

#[test]
fn a_damaged_request_gets_no_answer_and_its_repetition_does() {
    let mut host = Host::started(Role::Rear, &RobotConfig::default(), None);
    let request = axle(0, &[]);
    let frame = protocol::encode(200, &request).unwrap();
    for cut in 1..frame.bytes().len() {
        assert!(host.send(&frame.bytes()[..cut]).is_empty());
        // What is left of the frame and the beginning of the repetition are one damaged frame.
        if cut % 2 == 0 {
            let reply = host.send(frame.repeated());
            assert!(reply[0] == 200 && is_axle_reply(&reply));
        } else {
            host.send(&[0]);
        }
    }
    assert!(host.board.counters().damaged > 10);
}

#[test]
fn either_side_may_start_again() {
    let config = RobotConfig::default();
    let mut host = Host::started(Role::Rear, &config, None);
    for k in 0..20 {
        host.ask(&axle(k, &[]));
    }
    // The board: whatever the host goes on to say, it is told to say hello.
    host.reset(Role::Rear);
    host.refused(&axle(20, &[]), Refusal::NoSession);
    host.hello();
    host.refused(&axle(20, &[]), Refusal::NotStarted);
    let hash = host.configure(&config);
    host.expect(&start(hash, 20, None), Reply::Done);
    assert!(is_axle_reply(&host.ask(&axle(20, &[]))));
    // The host: the same numbers mean new requests after a hello.
    let last = host.number;
    host.number = last - 1;
    host.hello();
    host.number = last - 1;
    host.refused(&axle(21, &[]), Refusal::NotStarted);
}

#[test]
fn what_does_not_fit_is_refused_with_its_reason() {
    let config = RobotConfig::default();
    let beam = Request::Beam {
        tick: 0,
        samples: [0; MAX_GAUGES].into(),
    };

    let mut host = Host::new(Role::Front);
    host.refused(&axle(0, &[]), Refusal::NoSession);
    assert_eq!(host.greet(PROTOCOL + 1), Role::Front);
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
    let role = Role::Front;
    host.refused(&beam, Refusal::OtherBoard { role });

    // Parameters: out of order, of another sum, not decodable, out of range.
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
    host.ask(&configure(100, 0, &junk));
    host.refused(&start(crc32c(&junk), 0, None), Refusal::Undecodable);
    let mut wrong = config;
    wrong.geometry.wheel_radius_m = f32::NAN;
    let hash = host.configure(&wrong);
    let text = &wrong.build().unwrap_err().to_string();
    host.refused(&start(hash, 0, None), Refusal::Parameter { text });
    assert!(text.contains("wheel_radius_m"));
    host.refused(&axle(0, &[]), Refusal::NotStarted);

    let mut host = Host::started(Role::Front, &config, None);
    host.refused(&axle(1, &[]), Refusal::Tick { expected: 0 });
    host.ask(&axle(0, &[]));
    host.refused(&axle(0, &[]), Refusal::Tick { expected: 1 });
    let mut points = [None; protocol::POINTS];
    points[..2].fill(Some(PathPoint::default()));
    let refusal = Refusal::Point(PathError::NotAdvancing);
    host.refused(&order(Order::Path { points, end: true }), refusal);

    let stop = order(Order::Task(Task::Stop));
    for (role, request) in [(Role::Rear, stop), (Role::Beam, axle(0, &[]))] {
        let mut host = Host::started(role, &config, None);
        host.refused(&request, Refusal::OtherBoard { role });
    }
    let payload = Host::started(Role::Beam, &config, None).ask(&beam);
    let reply = protocol::decode::<Reply>(&payload);
    assert!(matches!(reply, Some((_, Reply::Beam { .. }))), "{reply:?}");
}

#[test]
fn a_board_that_stood_still_goes_on_with_the_tick_it_is_told() {
    let mut host = Host::new(Role::Rear);
    host.hello();
    host.refused(&Request::Resume { tick: 7 }, Refusal::NotStarted);
    let config = RobotConfig::default();
    let mut host = Host::started(Role::Rear, &config, None);
    let mut board = Board::new(&config, Role::Rear).unwrap();
    let mut outbox = Outbox::new();
    for tick in (0..300).chain(600..900) {
        if tick == 600 {
            host.refused(&axle(600, &[]), Refusal::Tick { expected: 300 });
            host.expect(&Request::Resume { tick: 600 }, Reply::Done);
        }
        outbox.clear();
        let samples = Samples::Axle(axle_samples(tick));
        let expected = board.step(u64::from(tick) * TICK, &samples, &mut outbox);
        let payload = host.ask(&axle(tick, &[]));
        let Some((_, Reply::Axle { torque_nm, bus, .. })) = protocol::decode(&payload) else {
            panic!("tick {tick}");
        };
        assert_eq!(torque_nm, expected.torque_nm);
        assert_eq!(protocol::unpack(bus).count(), outbox.iter().count());
    }
    // Time does not go back.
    let expected = 900;
    host.refused(&Request::Resume { tick: 899 }, Refusal::Tick { expected });
}

/// Place of a parameter in the table.
fn index(name: &str) -> u8 {
    TABLE.iter().position(|p| p.name == name).unwrap() as u8
}

fn set(index: u8, value: f32) -> Request<'static> {
    Request::SetParameter { index, value }
}

fn kept(value: f32, source: Source, saved: bool) -> Reply<'static> {
    Reply::Parameter {
        value,
        source,
        saved,
    }
}

#[test]
fn parameters_are_kept_from_set_to_reset_and_from_save_for_good() {
    let radius = index("robot.geometry.wheel_radius_m");
    let get = Request::Parameter { index: radius };
    let set = |value| set(radius, value);
    let mut host = Host::new(Role::Rear);
    host.refused(&get, Refusal::NoSession);
    host.refused(&Request::SaveParameters, Refusal::NoSession);
    host.hello();
    let summary = Reply::Parameters {
        table: fingerprint(),
        count: COUNT as u8,
        unusable: false,
    };
    host.expect(&Request::Parameters, summary);
    host.expect(&get, kept(0.073, Source::Default, true));
    host.expect(&set(0.0735), Reply::Done);
    host.expect(&get, kept(0.0735, Source::Default, false));
    // Another session finds it, a reset does not.
    host.hello();
    host.expect(&get, kept(0.0735, Source::Default, false));
    host.reset(Role::Rear);
    host.hello();
    host.expect(&get, kept(0.073, Source::Default, true));
    host.expect(&set(0.0735), Reply::Done);
    host.expect(&Request::SaveParameters, Reply::Saved { values: 1 });
    host.expect(&get, kept(0.0735, Source::Stored, true));
    host.expect(&Request::SaveParameters, Reply::Saved { values: 0 });
    // A request that is repeated is answered again and not carried out again.
    let frame = protocol::encode(host.number, &Request::SaveParameters).unwrap();
    let answer = host.send(frame.repeated());
    let reply = Reply::Saved { values: 0 };
    assert_eq!(protocol::decode(&answer), Some((host.number, reply)));
    assert_eq!(host.saves, 2);
    host.reset(Role::Rear);
    host.hello();
    host.expect(&get, kept(0.0735, Source::Stored, true));
    // What the host sends counts for the nodes, whatever is kept.
    let started = Host::started(Role::Rear, &RobotConfig::default(), None);
    let hash = host.configure(&RobotConfig::default());
    host.expect(&start(hash, 0, None), Reply::Done);
    assert_eq!(host.board.board(), started.board.board());
    host.broken = true;
    host.expect(&set(0.074), Reply::Done);
    host.refused(&Request::SaveParameters, Refusal::NotSaved);
    host.expect(&get, kept(0.074, Source::Stored, false));
}

#[test]
fn parameters_out_of_range_or_of_no_node_are_refused_by_name() {
    let mut host = Host::new(Role::Beam);
    host.hello();
    let count = COUNT as u8;
    for request in [Request::Parameter { index: count }, set(255, 1.0)] {
        host.refused(&request, Refusal::Index { count });
    }
    for (i, parameter) in TABLE.iter().enumerate() {
        let value = parameter.get(&Settings::of(Role::Beam));
        let (_, high) = parameter.range;
        for bad in [f32::NAN, f32::NEG_INFINITY, 1.01 * high + 1.0] {
            let index = i as u8;
            let text = &parameter.validate(bad).unwrap_err().to_string();
            assert!(text.contains(parameter.name));
            let refusal = Refusal::Parameter { text };
            host.refused(&set(index, bad), refusal);
            let get = Request::Parameter { index };
            host.expect(&get, kept(value, Source::Default, true));
        }
    }
    // In range, but behind the gauge after it.
    let gauge = index("robot.beam.strip.gauges_m[0]");
    host.expect(&set(gauge, 0.2), Reply::Done);
    let payload = host.ask(&Request::SaveParameters);
    let Some((_, Reply::Refused(Refusal::Parameter { text }))) = protocol::decode(&payload) else {
        panic!("saved");
    };
    assert!(text.contains("gauges_m"), "{text}");
    assert_eq!(host.saves, 0);
}

#[test]
fn parameters_are_neither_set_nor_saved_while_motors_may_be_on() {
    let set = set(0, 0.08);
    let mut host = Host::started(Role::Front, &RobotConfig::default(), Some(place()));
    host.expect(&set, Reply::Done);
    let mut waiting = Vec::<bus::CanFrame>::new();
    let mut drives = false;
    for tick in 0..400u32 {
        if tick == 100 {
            let goal = Posture::ORIGIN;
            host.expect(&order(Order::Task(Task::regulate(goal))), Reply::Done);
        }
        let mut packed = Packed::new();
        for frame in &waiting {
            packed.push(frame);
        }
        let payload = host.ask(&axle(tick, packed.bytes()));
        let Some((_, Reply::Axle { active, bus, .. })) = protocol::decode(&payload) else {
            panic!("tick {tick}");
        };
        drives = active;
        waiting = echo(protocol::unpack(bus));
    }
    assert!(drives, "the motors are on");
    host.refused(&set, Refusal::Armed);
    host.refused(&Request::SaveParameters, Refusal::Armed);
    assert_eq!(host.saves, 0);
    // The nodes end with the session.
    host.hello();
    host.expect(&Request::SaveParameters, Reply::Saved { values: 1 });
    // A beam board behind a link cannot know.
    let mut host = Host::started(Role::Beam, &RobotConfig::default(), None);
    host.refused(&set, Refusal::Armed);
    host.hello();
    host.expect(&set, Reply::Done);
}

#[test]
fn the_stack_is_told_in_a_session() {
    let mut host = Host::new(Role::Beam);
    host.refused(&Request::Stack, Refusal::NoSession);
    host.hello();
    host.expect(&Request::Stack, Reply::Stack(STACK));
    assert!(STACK.is_beyond() && !StackUse::unknown().is_beyond());
    let mut within = STACK;
    within.used_bytes = STACK.budget_bytes;
    assert!(!within.is_beyond());
}

#[test]
fn bus_frames_that_cannot_be_decoded_are_counted() {
    let mut host = Host::started(Role::Rear, &RobotConfig::default(), None);
    let mut packed = Packed::new();
    packed.push(&bus::CanFrame {
        id: 0x7ff,
        length: 8,
        data: [0; 8],
    });
    let payload = host.ask(&axle(0, packed.bytes()));
    let reply = protocol::decode::<Reply>(&payload);
    assert!(matches!(reply, Some((_, Reply::Axle { refused: 1, .. }))));
}

/// Whole numbers below `end`.
pub(super) fn below(random: &mut Random, end: usize) -> usize {
    (random.uniform() * end as f64) as usize
}

fn random_bytes(random: &mut Random, length: usize) -> Vec<u8> {
    (0..length).map(|_| below(random, 256) as u8).collect()
}

/// A few of the things that happen to bytes.
pub(super) fn damage(random: &mut Random, bytes: &mut Vec<u8>) {
    for _ in 0..1 + below(random, 4) {
        let place = below(random, bytes.len());
        match below(random, 8) {
            0 => drop(bytes.remove(place)),
            1 => bytes.insert(place, below(random, 256) as u8),
            2 => bytes.truncate(place.max(1)),
            3 => bytes[place] = 0,
            4 => bytes[place..].reverse(),
            5 => bytes[place] = below(random, 256) as u8,
            _ => bytes[place] ^= 1 << below(random, 8),
        }
        if bytes.is_empty() {
            bytes.push(1);
        }
    }
}

/// A million damaged and random streams. What the decoder lets through must be a frame that was
/// sent. The check sum lets 2⁻³² of what reaches it pass, 2.3·10⁻⁴ in all: none is expected. How
/// many of them have the right last byte of the sum, 2⁻⁸ if sums are as good as random, shows that
/// the streams do try it.
#[test]
fn a_million_damaged_streams_pass_no_wrong_frame_and_do_no_harm() {
    const STREAMS: u32 = 1_000_000;
    let mut random = Random::new(11);
    let mut host = Host::started(Role::Front, &RobotConfig::default(), Some(place()));
    let mut originals: Vec<Vec<u8>> = Vec::new();
    let frames: Vec<SerialFrame> = (0..16)
        .map(|k| {
            let mut packed = Packed::new();
            for id in 0..k {
                packed.push(&bus::CanFrame {
                    id: 0x100 + id as u16,
                    length: 8,
                    data: [k as u8; 8],
                });
            }
            let request = Request::Axle {
                tick: k,
                samples: axle_samples(k * 1000),
                bus: packed.bytes(),
            };
            let mut room = [0; 248];
            let payload = postcard::to_slice(&(k as u8, request), &mut room).unwrap();
            originals.push(payload.to_vec());
            SerialFrame::new(payload).unwrap()
        })
        .collect();
    let (mut wrong, mut tried, mut last_byte) = (0, 0u32, 0u32);
    let mut decoder = Decoder::new();
    for stream in 0..STREAMS {
        let mut bytes;
        if stream % 4 == 0 {
            let length = 1 + below(&mut random, MAX_FRAME);
            bytes = random_bytes(&mut random, length);
            // A first byte that is a plausible length code: the stuffing is right for some.
            bytes[0] = bytes[0].min(length as u8);
        } else {
            bytes = frames[below(&mut random, 16)].bytes().to_vec();
            damage(&mut random, &mut bytes);
        }
        bytes.push(0);
        for &byte in &bytes {
            if let Some(payload) = decoder.take_byte(byte) {
                wrong += u32::from(!originals.iter().any(|original| original == payload));
            }
        }
        for part in bytes.split(|byte| *byte == 0) {
            let mut stuffed = part.to_vec();
            if let Ok(length) = cobs::decode_in_place(&mut stuffed)
                && let Some((payload, [_, _, _, last])) = stuffed[..length].split_last_chunk()
                && !originals.iter().any(|original| original == payload)
            {
                tried += 1;
                last_byte += u32::from(crc32c(payload).to_le_bytes()[3] == *last);
            }
        }
        // The endpoint takes the same bytes, and what is undamaged in them, as its own.
        if stream % 8 == 0 {
            host.send(&bytes);
        }
    }
    println!(
        "{STREAMS} streams: {tried} wrong frames reached the check sum, {last_byte} had its last byte, {wrong} passed"
    );
    assert_eq!(wrong, 0);
    assert!(tried > STREAMS / 5, "{tried}");
    let expected = f64::from(tried) / 256.0;
    // Five standard deviations of a count.
    assert!((f64::from(last_byte) - expected).abs() < 5.0 * expected.sqrt());
    let counters = decoder.counters();
    assert!(counters.received > 1000 && counters.damaged > STREAMS / 2);
    // The board still answers.
    host.number = 77;
    host.hello();
}

/// Requests of random content in frames whose check sums are right.
#[test]
fn no_request_does_harm_whatever_it_holds() {
    let mut random = Random::new(12);
    for role in Role::ALL {
        let mut host = Host::started(role, &RobotConfig::default(), Some(place()));
        let mut answered = 0;
        for round in 0..60_000 {
            let length = 2 + below(&mut random, 60);
            let mut payload = random_bytes(&mut random, length);
            payload[1] = match round % 8 {
                // A hello now and then, or a start, would leave little to try.
                0 => below(&mut random, 15) as u8,
                _ => 3 + below(&mut random, 12) as u8,
            };
            let answer = host.send(SerialFrame::new(&payload).unwrap().bytes());
            answered += u32::from(protocol::decode::<Reply>(&answer).is_some());
            if round % 500 == 0 {
                host = Host::started(role, &RobotConfig::default(), Some(place()));
            }
        }
        assert_eq!(answered, 60_000);
    }
}

/// The order in a request, as the next one of a host.
pub(super) fn order(order: Order) -> Request<'static> {
    static SEQUENCE: AtomicU16 = AtomicU16::new(0);
    let stamp = stamp(7, SEQUENCE.fetch_add(1, Ordering::Relaxed));
    Request::Order { stamp, order }
}

pub(super) fn payloads(bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut decoder = Decoder::new();
    let payloads = bytes
        .iter()
        .filter_map(|&byte| decoder.take_byte(byte).map(<[u8]>::to_vec));
    payloads.collect()
}

#[test]
fn a_session_ends_when_the_host_leaves_and_not_before() {
    let mut host = Host::new(Role::Rear);
    host.hello();
    host.expect(&Request::Rig, Reply::Done);
    assert!(!host.board.has_left());
    host.expect(&Request::Leave, Reply::Done);
    assert!(host.board.has_left());
}
