//! Tests of simulation link, protocol and framing together, from the host's side.

use super::framing::{Decoder, MAX_FRAME, SerialFrame, crc32c};
use super::lease::Stamp;
use super::order::Order;
use super::protocol::{
    self, CONFIG_CHUNK, MAX_CONFIG, PROTOCOL, Packed, Placement, Refusal, Reply, Request, StackUse,
    Telemetry,
};
use super::sim_link::{Identity, SimLink};
use crate::bus;
use crate::fusion::Estimate;
use crate::fusion::testing::Random;
use crate::math::Posture;
use crate::node::Outbox;
use crate::node::axle;
use crate::node::board::{Board, Samples};
use crate::node::lead::Task;
use crate::node::robot::RobotConfig;
use crate::params::Contents;
use crate::safety::Conditions;
use crate::time::{EPOCH, LEAD_PHASE, TICK};
use crate::topology::Wheels;
use crate::topology::{Role, Topology};
use core::sync::atomic::{AtomicU16, Ordering};
use std::sync::LazyLock;

/// Stack use that the board reports.
pub(super) const STACK: StackUse = StackUse {
    used_bytes: 17_001,
    budget_bytes: 17_000,
    size_bytes: 90_000,
};

/// Configuration of the nodes of driving boards.
pub(super) static CONFIG: LazyLock<RobotConfig> = LazyLock::new(RobotConfig::default);

/// Host on a lossless link to a session board.
pub(super) struct Host {
    pub(super) board: SimLink,
    pub(super) number: u8,
    /// Contents of the board's store, and its number of writes; a broken store is not written.
    pub(super) store: Contents,
    pub(super) saves: u32,
    pub(super) broken: bool,
}

impl Host {
    pub(super) fn new(role: Role) -> Self {
        Self {
            board: board(role, &Contents::EMPTY),
            number: 0,
            store: Contents::EMPTY,
            saves: 0,
            broken: false,
        }
    }

    /// Switches the board off and on again.
    pub(super) fn reset(&mut self, role: Role) {
        self.board = board(role, &self.store);
    }

    /// Writes the store if a write is pending.
    pub(super) fn serve(&mut self, send: &mut impl FnMut(&[u8])) {
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

    /// Payload of the answer to raw bytes.
    pub(super) fn send(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut sent = Vec::new();
        let mut take = |answer: &[u8]| sent.extend_from_slice(answer);
        self.board.receive(bytes, &mut take);
        self.serve(&mut take);
        payloads(&sent).pop().unwrap_or_default()
    }

    /// Payload of the answer to a request with the next number.
    pub(super) fn request(&mut self, request: &Request) -> Vec<u8> {
        self.number = self.number.wrapping_add(1);
        self.send(protocol::encode(self.number, request).unwrap().bytes())
    }

    pub(super) fn expect(&mut self, request: &Request, reply: Reply) {
        let payload = self.request(request);
        assert_eq!(protocol::decode(&payload), Some((self.number, reply)));
    }

    pub(super) fn refused(&mut self, request: &Request, refusal: Refusal) {
        self.expect(request, Reply::Refused(refusal));
    }

    /// Sends a hello of this protocol version; returns the role in the reply.
    pub(super) fn send_hello(&mut self, version: u16) -> Role {
        let request = Request::Hello {
            protocol: version,
            nonce: 9,
        };
        let payload = self.request(&request);
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

    pub(super) fn hello(&mut self) {
        self.send_hello(PROTOCOL);
    }

    /// Sends the configuration; returns its checksum.
    pub(super) fn configure(&mut self, config: &RobotConfig) -> u32 {
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

    pub(super) fn started(role: Role, config: &RobotConfig, place: Option<Placement>) -> Self {
        let mut host = Self::new(role);
        host.hello();
        let hash = host.configure(config);
        host.expect(&start(hash, 0, place), Reply::Done);
        host
    }
}

pub(super) fn board(role: Role, contents: &Contents) -> SimLink {
    let build = "test build";
    let mut board = SimLink::new(Identity { build, role }, || STACK);
    board.load(contents);
    board
}

pub(super) fn placement() -> Placement {
    Placement {
        center: Estimate::with_sigmas(Posture::new(-1.0, -1.0, 0.2), [1e-3; 3]),
        relative: Estimate::with_sigmas(Posture::new(0.37, 0.0, 0.0), [1e-3; 3]),
        floor_drift: 0.01,
    }
}

/// Samples of an axle: at rest for 200 ms, as the lead node requires before it drives, then moving.
pub(super) fn axle_samples(tick: u32) -> axle::Samples {
    let moving = tick.saturating_sub(200);
    axle::Samples {
        encoder: [Some(moving as i32 / 7), Some(moving as i32 / 5)].into(),
        gyro_rad_s: Some(0.001 * moving as f32),
        acceleration_m_s2: None,
        conditions: Conditions::NONE,
    }
}

pub(super) fn axle(tick: u32, bus: &[u8]) -> Request<'_> {
    let samples = axle_samples(tick);
    Request::Axle { tick, samples, bus }
}

/// True if a payload is the reply to samples of an axle.
pub(super) fn is_axle_reply(payload: &[u8]) -> bool {
    let reply = protocol::decode::<Reply>(payload);
    matches!(reply, Some((_, Reply::Axle { .. })))
}

pub(super) fn start(hash: u32, tick: u32, place: Option<Placement>) -> Request<'static> {
    Request::Start { hash, tick, place }
}

pub(super) fn stamp(owner: u16, sequence: u16) -> Stamp {
    Stamp { owner, sequence }
}

/// Frames that a front board receives: its own frames, and copies of its reports under the rear axle's identifiers.
pub(super) fn echo(frames: impl IntoIterator<Item = bus::CanFrame>) -> Vec<bus::CanFrame> {
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

/// Encoded reply, for a comparison of every bit.
fn bits(sent: &impl serde::Serialize) -> Vec<u8> {
    let mut room = [0; 512];
    postcard::to_slice(sent, &mut room).unwrap().to_vec()
}

#[test]
fn front_board_behind_link_matches_direct_nodes_bit_for_bit() {
    let config = RobotConfig::default();
    let mut host = Host::started(Role::LEAD, &config, Some(placement()));
    let mut board = Board::new(&config, Role::LEAD).unwrap();
    let lead = board.lead().unwrap();
    lead.initialize(&placement());
    let goal = Posture::ORIGIN;
    let command = Task::regulate(goal);

    let (mut outbox, mut waiting) = (Outbox::new(), Vec::<bus::CanFrame>::new());
    let (mut received, mut wanted, mut outputs, mut driven) = (Vec::new(), Vec::new(), 0, 0);
    for tick in 0..400u32 {
        let now = u64::from(tick) * TICK;
        // The task begins after the start, because an axle that starts while the robot is driven stays off.
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
        let payload = host.request(&axle(tick, packed.bytes()));
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
        driven += u32::from(output.torque_nm != Wheels::both(0.0));
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
    let mut host = Host::started(Role::axle(1), &RobotConfig::default(), None);
    for tick in 0..300 {
        let request = axle(tick, &[]);
        let first = host.request(&request);
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
    let mut host = Host::started(Role::axle(1), &RobotConfig::default(), None);
    let request = axle(0, &[]);
    let frame = protocol::encode(200, &request).unwrap();
    for cut in 1..frame.bytes().len() {
        assert!(host.send(&frame.bytes()[..cut]).is_empty());
        // The 0 at the beginning of the repetition ends the truncated frame.
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
fn either_side_may_restart() {
    let config = RobotConfig::default();
    let mut host = Host::started(Role::axle(1), &config, None);
    for k in 0..20 {
        host.request(&axle(k, &[]));
    }
    // A restarted board refuses requests until a hello.
    host.reset(Role::axle(1));
    host.refused(&axle(20, &[]), Refusal::NoSession);
    host.hello();
    host.refused(&axle(20, &[]), Refusal::NotStarted);
    let hash = host.configure(&config);
    host.expect(&start(hash, 20, None), Reply::Done);
    assert!(is_axle_reply(&host.request(&axle(20, &[]))));
    // A restarted host: after a hello, a used number is a new request.
    let last = host.number;
    host.number = last - 1;
    host.hello();
    host.number = last - 1;
    host.refused(&axle(21, &[]), Refusal::NotStarted);
}

#[test]
fn stack_use_is_reported_in_a_session() {
    let mut host = Host::new(Role::beam(0));
    host.refused(&Request::Stack, Refusal::NoSession);
    host.hello();
    host.expect(&Request::Stack, Reply::Stack(STACK));
    assert!(STACK.is_beyond() && !StackUse::unknown().is_beyond());
    let mut within = STACK;
    within.used_bytes = STACK.budget_bytes;
    assert!(!within.is_beyond());
}

/// Random whole number below `end`.
pub(super) fn below(random: &mut Random, end: usize) -> usize {
    (random.uniform() * end as f64) as usize
}

fn random_bytes(random: &mut Random, length: usize) -> Vec<u8> {
    (0..length).map(|_| below(random, 256) as u8).collect()
}

/// Damages bytes in one to four random ways.
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

/// Streams are damaged or random. Every frame that the decoder accepts must be one that was sent. A wrong frame passes
/// the checksum with a probability of 2⁻³²: 2.3·10⁻⁴ in all, so none is expected. To show that wrong frames do reach
/// the checksum, the test counts those that match its last byte: a share of 2⁻⁸.
#[test]
fn million_damaged_streams_pass_no_wrong_frame() {
    const STREAMS: u32 = 1_000_000;
    let mut random = Random::new(11);
    let mut host = Host::started(Role::LEAD, &RobotConfig::default(), Some(placement()));
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
            // A plausible first length code makes the stuffing of some streams valid.
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
        // The board receives the same bytes.
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
    // The tolerance is five standard deviations of a count.
    assert!((f64::from(last_byte) - expected).abs() < 5.0 * expected.sqrt());
    let counters = decoder.counters();
    assert!(counters.received > 1000 && counters.damaged > STREAMS / 2);
    // The board still answers.
    host.number = 77;
    host.hello();
}

/// Requests of random content in frames with correct checksums.
#[test]
fn random_request_is_always_answered() {
    let mut random = Random::new(12);
    for role in Topology::PAIR.boards() {
        let mut host = Host::started(role, &RobotConfig::default(), Some(placement()));
        let mut answered = 0;
        for round in 0..60_000 {
            let length = 2 + below(&mut random, 60);
            let mut payload = random_bytes(&mut random, length);
            payload[1] = match round % 8 {
                // Hellos are rare: a hello discards the nodes.
                0 => below(&mut random, 15) as u8,
                _ => 3 + below(&mut random, 12) as u8,
            };
            let answer = host.send(SerialFrame::new(&payload).unwrap().bytes());
            answered += u32::from(protocol::decode::<Reply>(&answer).is_some());
            if round % 500 == 0 {
                host = Host::started(role, &RobotConfig::default(), Some(placement()));
            }
        }
        assert_eq!(answered, 60_000);
    }
}

/// Request with this order and the host's next sequence number.
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
fn session_ends_only_when_the_host_leaves() {
    let mut host = Host::new(Role::axle(1));
    host.hello();
    host.expect(&Request::Rig, Reply::Done);
    assert!(!host.board.has_ended());
    host.expect(&Request::EndSession, Reply::Done);
    assert!(host.board.has_ended());
}
