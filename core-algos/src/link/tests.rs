//! Endpoint, protocol and framing together, as a host sees them.

use super::attendant::{Attendant, Demand, MotorState, REPORT_ENTRIES, Station};
use super::endpoint::{Endpoint, Identity};
use super::framing::{Counters, Decoder, MAX_FRAME, SerialFrame, crc32c};
use super::lease::Stamp;
use super::order::Order;
use super::protocol::{
    self, CONFIG_CHUNK, CrashRecord, MAX_CONFIG, POINTS, PROTOCOL, Packed, Place, Refusal, Reply,
    Request, StackUse, Telemetry,
};
use super::record::{self, Entry, MAX_ENTRY};
use crate::beam::MAX_GAUGES;
use crate::bus::{self, Message};
use crate::control::path::{PathError, PathPoint};
use crate::control::regulator::Tolerance;
use crate::fusion::Estimate;
use crate::fusion::testing::Random;
use crate::math::Posture;
use crate::node::Outbox;
use crate::node::axle;
use crate::node::board::{Board, Ready, Samples};
use crate::node::lead::{LeadNode, Task};
use crate::node::robot::{RobotConfig, Told};
use crate::params::{COUNT, Contents, Settings, Source, TABLE, fingerprint};
use crate::safety::Conditions;
use crate::time::{EPOCH, LEAD_PHASE, TICK};
use crate::topology::Role;
use core::sync::atomic::{AtomicU16, Ordering};
use std::sync::LazyLock;

/// Stack use that the board reports.
const STACK: StackUse = StackUse {
    used_bytes: 17_001,
    budget_bytes: 17_000,
    size_bytes: 90_000,
};

/// Configuration of the nodes of boards that drive.
static CONFIG: LazyLock<RobotConfig> = LazyLock::new(RobotConfig::default);

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

fn place() -> Place {
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

fn stamp(owner: u16, sequence: u16) -> Stamp {
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
fn below(random: &mut Random, end: usize) -> usize {
    (random.uniform() * end as f64) as usize
}

fn random_bytes(random: &mut Random, length: usize) -> Vec<u8> {
    (0..length).map(|_| below(random, 256) as u8).collect()
}

/// A few of the things that happen to bytes.
fn damage(random: &mut Random, bytes: &mut Vec<u8>) {
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
fn order(order: Order) -> Request<'static> {
    static SEQUENCE: AtomicU16 = AtomicU16::new(0);
    let stamp = stamp(7, SEQUENCE.fetch_add(1, Ordering::Relaxed));
    Request::Order { stamp, order }
}

fn crash() -> CrashRecord {
    CrashRecord {
        counts: [1, 2, 3, 4],
        message: heapless::String::try_from("panicked at tick.rs:120").unwrap(),
    }
}

/// A board that drives, with what it answered.
struct Driving {
    attendant: Attendant,
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
            attendant: Attendant::new(identity, &CONFIG, || STACK, crash),
            station: Station::default(),
            demand: None,
        }
    }

    /// Order that the latest request demands.
    fn order(&self) -> Option<Order> {
        match self.demand {
            Some(Demand::Order(_, order)) => Some(order),
            _ => None,
        }
    }

    /// A board to which a host has said hello.
    fn greeted(role: Role) -> Self {
        let mut board = Self::new(role);
        let (protocol, nonce) = (PROTOCOL, 1);
        board.ask(200, &Request::Hello { protocol, nonce }, MotorState::Driven);
        board
    }

    /// The payloads of its answers to a request.
    fn ask(&mut self, number: u8, request: &Request, motors: MotorState) -> Vec<Vec<u8>> {
        let frame = protocol::encode(number, request).unwrap();
        let mut sent = Vec::new();
        let mut send = |answer: &[u8]| sent.extend_from_slice(answer);
        self.station.motors = motors;
        self.demand = self
            .attendant
            .receive(frame.bytes(), &mut self.station, &mut send);
        payloads(&sent)
    }

    fn expect(&mut self, number: u8, request: &Request, motors: MotorState, reply: Reply) {
        assert_answered(&self.ask(number, request, motors), number, reply);
    }

    fn done(&mut self, done: Result<(), PathError>) -> Vec<Vec<u8>> {
        let mut sent = Vec::new();
        self.attendant
            .done(done, &mut |answer| sent.extend_from_slice(answer));
        payloads(&sent)
    }
}

fn payloads(bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut decoder = Decoder::new();
    let payloads = bytes
        .iter()
        .filter_map(|&byte| decoder.take_byte(byte).map(<[u8]>::to_vec));
    payloads.collect()
}

fn assert_answered(answers: &[Vec<u8>], number: u8, reply: Reply) {
    assert_eq!(answers.len(), 1);
    assert_eq!(protocol::decode(&answers[0]), Some((number, reply)));
}

/// The host reads the configuration of a board that drives in parts; it may be asked for the last one again.
#[test]
fn configuration_of_a_board_that_drives_is_read_in_parts() {
    let mut board = Driving::new(Role::Rear);
    let mut read = Vec::new();
    for number in 1.. {
        let offset = read.len() as u16;
        let answers = board.ask(
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

/// Nodes begin anew with the motors off; those of the front board for the host that holds the lease.
#[test]
fn record_begins_with_motors_off_and_on_the_front_board_by_lease() {
    for role in Role::ALL {
        let mut board = Driving::greeted(role);
        let begin = |owner| Request::Record(stamp(owner, 1));
        let refused = Reply::Refused(Refusal::Armed);
        board.expect(1, &begin(7), MotorState::Driven, refused);
        board.expect(4, &begin(7), MotorState::Braking, refused);
        board.expect(2, &begin(7), MotorState::Off, Reply::Done);
        assert_eq!(board.demand, Some(Demand::Record));
        let other = match role {
            Role::Front => Reply::Refused(Refusal::Leased),
            _ => Reply::Done,
        };
        board.expect(3, &begin(8), MotorState::Off, other);
    }
}

#[test]
fn a_board_that_drives_says_who_it_is_and_goes_into_a_session_with_its_motors_off() {
    let mut board = Driving::new(Role::Rear);
    let hello = Request::Hello {
        protocol: PROTOCOL + 1,
        nonce: 77,
    };
    // Of another version as well: the host is told what this one is.
    let reply = Reply::Hello {
        protocol: PROTOCOL,
        nonce: 77,
        role: Role::Rear,
        build: "test build",
        counters: Counters::default(),
        session: false,
    };
    board.expect(3, &hello, MotorState::Driven, reply);
    let refused = |refusal| Reply::Refused(refusal);
    board.expect(
        4,
        &Request::Rig,
        MotorState::Driven,
        refused(Refusal::Armed),
    );
    assert_eq!(board.demand, None);
    // Nothing of a session is done outside of one.
    for (number, other) in [(5, Request::SaveParameters), (6, Request::Leave)] {
        let answers = board.ask(number, &other, MotorState::Off);
        assert_answered(&answers, number, refused(Refusal::NoSession));
        assert_eq!(board.demand, None);
    }
    board.expect(7, &Request::Stack, MotorState::Driven, Reply::Stack(STACK));
    let record = Reply::Crash {
        counts: [1, 2, 3, 4],
        message: "panicked at tick.rs:120",
    };
    board.expect(10, &Request::Crash, MotorState::Driven, record);
    let other = refused(Refusal::OtherBoard { role: Role::Rear });
    let stop = order(Order::Task(Task::Stop));
    board.expect(8, &stop, MotorState::Driven, other);
    board.expect(9, &Request::Rig, MotorState::Off, Reply::Done);
    assert_eq!(board.demand, Some(Demand::Session));
}

/// A request for another board is handed on as often as it comes, and one reply of that board is handed back.
#[test]
fn request_for_another_board_is_relayed_and_its_reply_returned() {
    let mut board = Driving::new(Role::Front);
    let mut room = [[0; 32]; 2];
    let [request, reply] = &mut room;
    let inner = postcard::to_slice(&(9u8, Request::Stack), request).unwrap();
    let role = Role::Beam;
    let relay = Request::Relay {
        role,
        payload: inner,
    };
    for _ in 0..2 {
        assert!(board.ask(9, &relay, MotorState::Driven).is_empty());
        let frame = SerialFrame::new(inner).unwrap();
        assert_eq!(board.demand, Some(Demand::Relay(role, frame)));
    }
    let reply = postcard::to_slice(&(9u8, Reply::Stack(STACK)), reply).unwrap();
    let mut relayed = |from| {
        let mut sent = Vec::new();
        let mut send = |bytes: &[u8]| sent.extend_from_slice(bytes);
        board.attendant.relayed(from, reply, &mut send);
        payloads(&sent)
    };
    assert!(relayed(Role::Rear).is_empty());
    assert_answered(&relayed(role), 9, Reply::Relayed { payload: reply });
    assert!(relayed(role).is_empty());
    // The identifiers on the bus do not name the relay: there is one.
    let mut rear = Driving::new(Role::Rear);
    let other = Refusal::OtherBoard { role: Role::Rear };
    rear.expect(9, &relay, MotorState::Driven, Reply::Refused(other));
    assert_eq!(rear.demand, None);
}

#[test]
fn relay_without_a_request_is_malformed() {
    let mut board = Driving::new(Role::Front);
    let (role, payload) = (Role::Beam, &[][..]);
    let malformed = Reply::Refused(Refusal::Malformed);
    let relay = Request::Relay { role, payload };
    board.expect(9, &relay, MotorState::Driven, malformed);
    assert_eq!(board.demand, None);
}

/// The caller takes one action for each piece of bytes. The second request is repeated by its host.
#[test]
fn request_in_one_piece_with_an_action_waits_for_its_repetition() {
    let mut board = Driving::new(Role::Rear);
    let begin = protocol::encode(1, &Request::Record(stamp(7, 1))).unwrap();
    let watch = protocol::encode(2, &Request::Watch).unwrap();
    let mut sent = Vec::new();
    let both = [begin.bytes(), watch.bytes()].concat();
    let demand = board
        .attendant
        .receive(&both, &mut board.station, &mut |reply| {
            sent.extend_from_slice(reply);
        });
    assert_eq!(demand, Some(Demand::Record));
    assert_answered(&payloads(&sent), 1, Reply::Done);
    board.expect(2, &Request::Watch, MotorState::Off, Reply::Done);
    assert_eq!(board.demand, Some(Demand::Watch));
}

/// A host may speak for the service tool, and for no node.
#[test]
fn messages_of_nodes_are_not_sent_for_a_host() {
    let calibrate = bus::field::Calibrate::Zero(0.0);
    let sequence = 7;
    let allowed = Message::BeamCalibration {
        sequence,
        calibrate,
    };
    let mode = bus::LeadMode::Active;
    let forged = Message::LeadStatus {
        sequence,
        mode,
        steering_rad: 0.0,
        velocity_m_s: 0.1,
    };
    let mut board = Driving::new(Role::Front);
    for (number, message, sent) in [(1, allowed, true), (2, forged, false)] {
        let frame = bus::encode(&message).unwrap();
        let mut packed = Packed::new();
        assert!(packed.push(&frame));
        let bus = packed.bytes();
        let reply = match sent {
            true => Reply::Done,
            false => Reply::Refused(Refusal::Malformed),
        };
        board.expect(number, &Request::Send { bus }, MotorState::Driven, reply);
        assert_eq!(board.demand, sent.then_some(Demand::Send(frame)));
    }
    let nothing = board.ask(3, &Request::Send { bus: &[] }, MotorState::Driven);
    assert_answered(&nothing, 3, Reply::Refused(Refusal::Malformed));
}

/// Repeated requests are answered again and carried out once; an order is answered when it is done.
#[test]
fn an_order_is_carried_out_once_and_answered_when_it_is_done() {
    let mut board = Driving::greeted(Role::Front);
    let goal = Posture::new(1.0, -0.5, 0.25);
    let drive = Order::Task(Task::regulate(goal));
    let request = order(drive);
    assert!(board.ask(1, &request, MotorState::Driven).is_empty());
    assert_eq!(board.order(), Some(drive));
    // The host is impatient.
    assert!(board.ask(1, &request, MotorState::Driven).is_empty());
    assert_eq!(board.demand, None);
    assert_answered(&board.done(Ok(())), 1, Reply::Done);
    board.expect(1, &request, MotorState::Driven, Reply::Done);
    assert_eq!(board.demand, None);

    let stand = Order::Place(place());
    let armed = Reply::Refused(Refusal::Armed);
    board.expect(3, &order(stand), MotorState::Driven, armed);
    assert_eq!(board.demand, None);
    assert!(board.ask(5, &order(stand), MotorState::Braking).is_empty());
    assert_eq!(board.order(), Some(stand));
    assert_answered(&board.done(Ok(())), 5, Reply::Done);
    assert!(board.ask(4, &order(stand), MotorState::Off).is_empty());
    assert_eq!(board.order(), Some(stand));
    assert_answered(&board.done(Ok(())), 4, Reply::Done);

    let points = [None; POINTS];
    let path = order(Order::Path { points, end: true });
    assert!(board.ask(2, &path, MotorState::Driven).is_empty());
    let full = Reply::Refused(Refusal::Point(PathError::Full));
    assert_answered(&board.done(Err(PathError::Full)), 2, full);
    board.expect(2, &path, MotorState::Driven, full);
}

/// A frame of another host, or one that was late, does not reach the lead node.
#[test]
fn order_without_the_lease_or_with_an_old_sequence_is_refused() {
    let mut board = Driving::new(Role::Front);
    let unknown = order(Order::Task(Task::Stop));
    let no_session = Reply::Refused(Refusal::NoSession);
    board.expect(1, &unknown, MotorState::Driven, no_session);
    let mut board = Driving::greeted(Role::Front);
    let stop = Order::Task(Task::Stop);
    let of = |owner, sequence| Request::Order {
        stamp: stamp(owner, sequence),
        order: stop,
    };
    let refused = Reply::Refused;
    assert!(board.ask(1, &of(1, 10), MotorState::Driven).is_empty());
    assert_eq!(board.order(), Some(stop));
    assert_answered(&board.done(Ok(())), 1, Reply::Done);
    for (number, request, refusal) in [
        (2, of(2, 11), Refusal::Leased),
        (3, of(1, 10), Refusal::OldOrder),
        (4, Request::Keep(stamp(2, 11)), Refusal::Leased),
        (5, Request::Release(stamp(2, 12)), Refusal::Leased),
    ] {
        board.expect(number, &request, MotorState::Driven, refused(refusal));
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
    assert!(board.ask(9, &of(2, 1), MotorState::Driven).is_empty());
    assert_eq!(board.order(), Some(stop));
}

/// Frames of two hosts reach a board that drives: in order, late, of the other host, or damaged. The lead node gets those of
/// the host with the lease, undamaged and once.
#[test]
fn late_foreign_and_damaged_orders_do_not_reach_the_lead_node() {
    const FRAMES: u32 = 1_000_000;
    let mut random = Random::new(17);
    let mut board = Driving::greeted(Role::Front);
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
            .attendant
            .receive(&bytes, &mut board.station, &mut |_| {});
        if demand.is_none() {
            assert_ne!(kind, 0);
            continue;
        }
        // Damage at the zeros around a frame does no harm.
        assert!(kind < 2, "{stamp:?}");
        assert_eq!(demand, Some(Demand::Order(next, order)));
        board.done(Ok(()));
        (sequence, carried) = (next, carried + 1);
    }
    assert!(sent > FRAMES / 5 && carried >= sent, "{sent} {carried}");
}

#[test]
fn orders_reach_the_lead_node() {
    let drive = |speed_m_s, curvature| Task::Drive {
        speed_m_s,
        curvature,
    };
    let config = RobotConfig::default();
    let mut nodes = Ready::new(&config, Role::Front).unwrap().begin();
    let lead = nodes.lead().unwrap();
    let place = config.put_down(Posture::new(2.0, 1.0, 0.5), &Told::default());
    Order::Place(place).carry_out(lead).unwrap();
    let mut other = lead.clone();
    other.initialize(&place);
    assert_eq!(lead.fusion(), other.fusion());
    // Points within the curvature that the frame bends to are taken, others refused with the reason.
    let bound = lead.cascade().max_curvature();
    for (kappa, expected) in [
        (bound, Ok(())),
        (-bound, Ok(())),
        (1.01 * bound, Err(PathError::TooTight)),
        (-1.01 * bound, Err(PathError::TooTight)),
        (f32::NAN, Err(PathError::NotFinite)),
    ] {
        let mut points = [None; POINTS];
        let (posture, s) = (Posture::ORIGIN, 0.0);
        points[0] = Some(PathPoint { posture, kappa, s });
        lead.restart();
        for order in [
            Order::Path { points, end: true },
            Order::Task(drive(0.1, kappa)),
        ] {
            assert_eq!(order.carry_out(lead), expected, "{order:?}");
        }
    }
    let goal = Posture::new(0.0, f32::INFINITY, 0.0);
    let within = Tolerance {
        position_m: f32::NAN,
        ..Tolerance::default()
    };
    for task in [
        Task::regulate(goal),
        drive(f32::NAN, 0.0),
        Task::Follow { within },
        Task::Track { within },
    ] {
        let refused = Order::Task(task).carry_out(lead);
        assert_eq!(refused, Err(PathError::NotFinite), "{task:?}");
    }
}

#[test]
fn posture_that_no_estimate_can_begin_at_is_refused() {
    let config = RobotConfig::default();
    let mut nodes = Ready::new(&config, Role::Front).unwrap().begin();
    let lead = nodes.lead().unwrap();
    let place = config.put_down(Posture::ORIGIN, &Told::default());
    let changed = |change: fn(&mut Place)| {
        let mut place = place;
        change(&mut place);
        place
    };
    for place in [
        changed(|place| place.center.posture.x = f32::NAN),
        changed(|place| place.center.posture.y = 1e6),
        changed(|place| place.relative.covariance[1][1] = 1e7),
        changed(|place| place.floor_drift = -0.1),
        changed(|place| place.relative.posture.phi = f32::INFINITY),
        changed(|place| place.relative.covariance[0][1] = f32::NAN),
        changed(|place| place.center.covariance[2][2] = -1.0),
        changed(|place| place.floor_drift = f32::NAN),
    ] {
        let refused = Order::Place(place).carry_out(lead);
        assert_eq!(refused, Err(PathError::NotFinite), "{place:?}");
        assert!(lead.fusion().is_none());
    }
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

/// Bus frames and every output of the lead node reach a host that watches, and one only.
#[test]
fn a_host_that_watches_gets_bus_frames_and_outputs() {
    let identity = Identity {
        build: "test",
        role: Role::Front,
    };
    let mut board = Attendant::new(identity, &CONFIG, StackUse::unknown, crash);
    let mut sent = Vec::new();
    let lead = RobotConfig::default().completed().build_lead();
    let mut lead = LeadNode::new(lead.unwrap());
    let telemetry = Telemetry::of(4_000, lead.step(4_000, &mut Outbox::new()), &mut lead);
    assert!(board.wants_telemetry());
    let watch = protocol::encode(9, &Request::Watch).unwrap();
    let mut send = |bytes: &[u8]| sent.extend_from_slice(bytes);
    let demand = board.receive(watch.bytes(), &mut Station::default(), &mut send);
    assert_eq!(demand, Some(Demand::Watch));
    board.tell(&telemetry);
    assert!(!board.wants_telemetry());
    let (epoch, last_delay_us) = (77, None);
    let sync = Message::TimeSync {
        epoch,
        last_delay_us,
    };
    let frame = bus::encode(&sync).unwrap();
    let mut room = [0; MAX_ENTRY];
    let entry = Entry::of(&frame).encode(&mut room).unwrap();
    let count = board.room() / entry.len();
    let few = entry.repeat(count);
    let longest = [0; REPORT_ENTRIES];
    // Entries without a part of the output leave no room for it, and the report without anything in it is not sent.
    for entries in [&few, &longest[..], &few, &[]] {
        board.report(3, entries, &mut send);
    }
    assert!(board.wants_telemetry());
    let (mut frames, mut parts, mut replies) = (0, Vec::new(), 0);
    for payload in payloads(&sent) {
        replies += 1;
        match protocol::decode::<Reply>(&payload).unwrap() {
            (9, Reply::Done) => {}
            (
                0,
                Reply::Report {
                    sequence,
                    lost: 3,
                    entries,
                    offset,
                    telemetry,
                },
            ) => {
                assert_eq!(u32::from(sequence) + 2, replies);
                assert_eq!(usize::from(offset), parts.len());
                assert_eq!(telemetry.is_empty(), entries == longest);
                parts.extend_from_slice(telemetry);
                let found = record::entries(entries).filter_map(|entry| entry?.frame());
                frames += found.filter(|it| *it == frame).count();
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!((replies, frames), (4, 2 * count));
    let (length, bytes) = parts.split_first_chunk().unwrap();
    assert_eq!(usize::from(u16::from_le_bytes(*length)), bytes.len());
    assert_eq!(postcard::from_bytes(bytes), Ok(telemetry));
}
