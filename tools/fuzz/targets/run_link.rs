//! Link of a driving board, compared with a model. Several hosts send requests at the port and over the bus, some of
//! them repeated, stale or damaged, while time passes and motor states change.
#![no_main]

use cfmmr_fuzz::numbers::Bytes;
use cfmmr_fuzz::run_link_model::{Frame, Outcome, RunLinks};
use core_algos::bus::field::Calibrate;
use core_algos::bus::{self, Message};
use core_algos::control::path::PathError;
use core_algos::link::framing::{Decoder, SerialFrame};
use core_algos::link::protocol::{
    self, CrashRecord, PROTOCOL, Packed, Placement, Request, StackUse,
};
use core_algos::link::run_link::Station;
use core_algos::link::{Identity, MotorState, Order, RunLink, Stamp};
use core_algos::math::Posture;
use core_algos::node::lead::Task;
use core_algos::node::robot::{ConfiguredPlacement, RobotConfig};
use core_algos::topology::{FrameId, Role};
use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;

static CONFIG: LazyLock<RobotConfig> = LazyLock::new(RobotConfig::default);

/// Time steps, µs: zero, a tick, the length of the lease and its neighbours, and long steps.
const STEPS: [u64; 8] = [
    0,
    1_000,
    999_999,
    1_000_000,
    1_000_001,
    500_000,
    60_000_000,
    1 << 40,
];

/// Run links and state of a board, and the model with which they are compared.
struct BoardBench {
    run_links: [RunLink; 2],
    station: Station,
    model: RunLinks,
    /// Latest request of each host, for repetitions.
    latest: [Vec<u8>; 2],
    numbers: [u8; 2],
    sequences: [u16; 3],
}

impl BoardBench {
    fn new(role: Role) -> Self {
        let identity = Identity {
            build: "fuzz",
            role,
        };
        let run_link = || RunLink::new(identity, &CONFIG, StackUse::unknown, CrashRecord::default);
        Self {
            run_links: [run_link(), run_link()],
            station: Station::default(),
            model: RunLinks::new(role, &CONFIG),
            latest: [Vec::new(), Vec::new()],
            numbers: [0; 2],
            sequences: [0, u16::MAX - 3, 0x7ffe],
        }
    }

    /// Advances the time and checks that a lease lapses exactly if the lease of the model lapses.
    fn wait(&mut self, step: u64) {
        self.station.now += step;
        let lapsed = self.station.lease.take_lapsed(self.station.now);
        assert_eq!(
            lapsed,
            self.model.lapses(self.station.now),
            "lapse of the lease"
        );
    }

    fn receive(&mut self, port: usize, bytes: &[u8], frames: &[Frame]) {
        let mut sent = Vec::new();
        let demand = self.run_links[port].receive(bytes, &mut self.station, &mut |reply| {
            sent.extend_from_slice(reply);
        });
        let (now, motors) = (self.station.now, self.station.motors);
        let expected = self.model.receive(port, now, motors, frames);
        assert_eq!(Outcome::new(sent, demand), expected, "{frames:?}");
    }

    /// Sends one or two requests in one piece; some are repeated or damaged.
    fn requests(&mut self, bytes: &mut Bytes) {
        let head = bytes.byte();
        let (port, count) = (usize::from(head & 1), 1 + usize::from(head >> 1 & 3) / 2);
        let (mut stream, mut frames) = (Vec::new(), Vec::new());
        for _ in 0..count {
            let kind = bytes.byte();
            if kind & 3 != 0 || self.latest[port].is_empty() {
                self.latest[port] = self.payload(port, bytes);
            }
            let payload = self.latest[port].clone();
            let Some(frame) = SerialFrame::new(&payload) else {
                return;
            };
            let mut frame = match kind & 4 {
                0 => frame.bytes().to_vec(),
                _ => frame.repeated().to_vec(),
            };
            if kind >= 0xe0 {
                damage(&mut frame, bytes);
            }
            frames.push(match payload_of(&frame) {
                Some(found) => {
                    let request = protocol::decode::<Request>(&found);
                    assert!(found == payload || request.is_none(), "damage that passes");
                    Frame::Whole(found)
                }
                None => Frame::Damaged,
            });
            stream.extend(frame);
        }
        self.receive(port, &stream, &frames);
    }

    /// Payload with a number and a request, or with a number and arbitrary bytes.
    fn payload(&mut self, port: usize, bytes: &mut Bytes) -> Vec<u8> {
        let number = &mut self.numbers[port];
        *number = match bytes.byte() {
            fresh @ 0..=239 => number.wrapping_add(1 + fresh / 200),
            any => any,
        };
        let number = *number;
        let kind = bytes.byte();
        let inner = [number, bytes.byte() % 24, bytes.byte()];
        let service = |message: &Message| {
            let mut packed = Packed::new();
            assert!(packed.push(&bus::encode(message).unwrap()));
            packed
        };
        let packed = service(&match kind & 0x20 {
            0 => Message::BeamCalibration {
                frame: FrameId(0),
                sequence: kind,
                calibrate: Calibrate::Zero(0.0),
            },
            _ => Message::TimeSync {
                epoch: 7,
                last_delay_us: None,
            },
        });
        let request = match kind % 16 {
            0..=2 => Request::Order {
                stamp: self.stamp(bytes),
                order: order(bytes),
            },
            3 => Request::Keep(self.stamp(bytes)),
            4 => Request::Release(self.stamp(bytes)),
            5 => Request::Record(self.stamp(bytes)),
            6 => Request::Rig,
            7 => Request::Watch,
            8 => Request::Hello {
                protocol: PROTOCOL.wrapping_add(u16::from(kind >> 7)),
                nonce: u32::from(kind),
            },
            9 => [Request::Stack, Request::Crash][usize::from(kind >> 7)],
            10 => Request::Configuration {
                offset: u16::from_le_bytes(bytes.array()) % 3000,
            },
            11 => Request::Send {
                bus: match kind & 0x40 {
                    0 => packed.bytes(),
                    _ => &inner,
                },
            },
            12 => Request::Relay {
                role: Role::PAIR[usize::from(kind >> 6) % 3],
                payload: &inner[..usize::from(kind >> 4 & 3)],
            },
            13 => [
                Request::EndSession,
                Request::SaveParameters,
                Request::Parameters,
                Request::Resume { tick: 1 },
            ][usize::from(kind >> 6)],
            _ => {
                let length = usize::from(bytes.byte() % 80);
                return [&[number], bytes.take(length)].concat();
            }
        };
        let mut room = [0; 300];
        let used = postcard::to_slice(&(number, request), &mut room).unwrap();
        used.to_vec()
    }

    /// Stamp of one of three hosts: the next sequence number, an earlier or a distant one.
    fn stamp(&mut self, bytes: &mut Bytes) -> Stamp {
        let kind = bytes.byte();
        let host = usize::from(kind) % 3;
        let latest = &mut self.sequences[host];
        let sequence = match kind >> 4 {
            0..=9 => latest.wrapping_add(1),
            10 => *latest,
            11 => latest.wrapping_sub(1),
            12 => latest.wrapping_add(0x7fff),
            13 => latest.wrapping_add(0x8000),
            _ => u16::from_le_bytes(bytes.array()),
        };
        if kind >> 4 < 10 {
            *latest = sequence;
        }
        Stamp {
            owner: 40 + host as u16,
            sequence,
        }
    }

    /// Ends an order and compares the reply with the model; `refused` is true if the tick refused the order.
    fn done(&mut self, port: usize, refused: bool) {
        let result = match refused {
            true => Err(PathError::TooTight),
            false => Ok(()),
        };
        let mut sent = Vec::new();
        self.run_links[port].done(result, &mut |reply| sent.extend_from_slice(reply));
        assert_eq!(sent, self.model.done(port, result), "end of an order");
    }

    /// Passes a reply of another board to the host and compares the bytes with the model.
    fn relayed(&mut self, bytes: &mut Bytes) {
        let head = bytes.byte();
        let (port, from) = (
            usize::from(head & 1),
            Role::PAIR[usize::from(head >> 1) % 3],
        );
        let length = usize::from(bytes.byte());
        let payload = [bytes.take(3), &vec![head; length]].concat();
        let payload = &payload[..payload.len().min(248)];
        let mut sent = Vec::new();
        self.run_links[port].relayed(from, payload, &mut |reply| {
            sent.extend_from_slice(reply);
        });
        assert_eq!(
            sent,
            self.model.relayed(port, from, payload),
            "relayed reply"
        );
    }
}

fn order(bytes: &mut Bytes) -> Order {
    match bytes.byte() % 7 {
        0 => Order::SetPose(placement()),
        1 => Order::Task(Task::Stop),
        2 => Order::Task(Task::Clear),
        3 => Order::Task(Task::Drive {
            speed_m_s: bytes.number() as f32,
            curvature: bytes.number() as f32,
        }),
        4 => Order::Path {
            points: [None; protocol::POINTS],
            end: true,
        },
        5 => Order::Lost,
        _ => Order::Task(Task::regulate(Posture::ORIGIN)),
    }
}

fn placement() -> Placement {
    CONFIG.placement(Posture::ORIGIN, &ConfiguredPlacement::default())
}

/// Changes or removes a byte between the zeros at the ends.
fn damage(frame: &mut Vec<u8>, bytes: &mut Bytes) {
    let first = usize::from(frame[0] == 0);
    let at = first + usize::from(bytes.byte()) % (frame.len() - 1 - first);
    match bytes.byte() {
        0..=63 => drop(frame.remove(at)),
        by => {
            let changed = frame[at] ^ (by % 64 + 1);
            frame[at] = if changed == 0 {
                0xff ^ frame[at]
            } else {
                changed
            };
        }
    }
}

/// Payload of a frame; `None` unless the checksum is right. Damage to the length of the last block may leave the
/// payload unchanged. After four bytes 0xff the checksum ignores zeros; no request begins with these bytes.
fn payload_of(frame: &[u8]) -> Option<Vec<u8>> {
    let mut decoder = Decoder::new();
    let mut payloads = frame
        .iter()
        .filter_map(|&byte| decoder.take_byte(byte).map(<[u8]>::to_vec));
    payloads.next()
}

fuzz_target!(|data: &[u8]| {
    let mut bytes = Bytes(data);
    let mut bench = BoardBench::new(Role::PAIR[usize::from(bytes.byte()) % 3]);
    while !bytes.is_empty() {
        match bytes.byte() {
            0..=31 => {
                let step = STEPS[usize::from(bytes.byte()) % STEPS.len()];
                bench.wait(step);
            }
            kind @ 32..=63 => {
                let states = [MotorState::Off, MotorState::Braking, MotorState::Driven];
                bench.station.motors = states[usize::from(kind) % 3];
            }
            kind @ 64..=111 => bench.done(usize::from(kind & 1), kind & 14 == 14),
            112..=127 => bench.relayed(&mut bytes),
            _ => bench.requests(&mut bytes),
        }
    }
});
