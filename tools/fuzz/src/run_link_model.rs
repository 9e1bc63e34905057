//! Model of the requests that a driving board accepts by docs/serial.md: lease, sequence, motors, repetition.

use core_algos::bus::{self, CanFrame};
use core_algos::control::path::PathError;
use core_algos::link::framing::{Counters, SerialFrame};
use core_algos::link::protocol::{self, CrashRecord, PROTOCOL, Refusal, Reply, Request, StackUse};
use core_algos::link::{Demand, MotorState, Order, Stamp};
use core_algos::node::robot::RobotConfig;
use core_algos::topology::Role;

/// Frame that travels to the board.
#[derive(Clone, Debug)]
pub enum Frame {
    /// Frame with this payload.
    Whole(Vec<u8>),
    /// Frame damaged in transit.
    Damaged,
}

/// Expected bytes from the board, and the action that the link demands of the board.
#[derive(Debug, PartialEq)]
pub struct Outcome {
    sent: Vec<u8>,
    demand: Option<Demand>,
    /// Sequence and bytes of an order; compared as bytes, because an order may contain NaN.
    order: Option<(u16, Vec<u8>)>,
}

impl Outcome {
    pub fn new(sent: Vec<u8>, demand: Option<Demand>) -> Self {
        match demand {
            Some(Demand::Order(sequence, order)) => {
                let mut room = [0; 300];
                let content = postcard::to_slice(&order, &mut room).unwrap().to_vec();
                Self {
                    sent,
                    demand: None,
                    order: Some((sequence, content)),
                }
            }
            demand => Self {
                sent,
                demand,
                order: None,
            },
        }
    }
}

/// Host that holds the lease. `latest`, its latest order, stays known after the end of the lease.
#[derive(Default)]
struct Commander {
    latest: Option<Stamp>,
    /// End of the lease, µs; `None` after a release or a reported lapse.
    ends: Option<u64>,
}

impl Commander {
    /// Length of the lease after an order, µs.
    const TERM: u64 = 1_000_000;

    fn admit(&mut self, now: u64, stamp: Stamp) -> Option<Refusal<'static>> {
        let ours = self
            .latest
            .is_some_and(|latest| latest.owner == stamp.owner);
        if let (true, Some(latest)) = (ours, self.latest) {
            let ahead =
                (u32::from(stamp.sequence) + 0x1_0000 - u32::from(latest.sequence)) & 0xffff;
            if !(1..0x8000).contains(&ahead) {
                return Some(Refusal::OldOrder);
            }
        } else if self.ends.is_some_and(|end| now <= end) {
            return Some(Refusal::Leased);
        }
        self.latest = Some(stamp);
        self.ends = Some(now + Self::TERM);
        None
    }
}

/// State of the board for one host.
#[derive(Default)]
struct Port {
    hello_received: bool,
    pending: Option<u8>,
    /// Number and payload of the latest reply, sent again for a repeated request.
    answered: Option<(u8, Vec<u8>)>,
    relaying: Option<Role>,
    counters: Counters,
}

/// Model of the run links at the serial port and on the bus, with shared state.
pub struct RunLinks {
    role: Role,
    configuration: Vec<u8>,
    commander: Commander,
    ports: [Port; 2],
}

/// Expected reaction to a request.
enum Due {
    Reply(Vec<u8>),
    /// Reply to a hello, which is not stored for a repetition of the request.
    Greeting(Vec<u8>),
    /// Stored reply, sent again because the request was repeated.
    Repetition(Vec<u8>),
    /// Reply at once, and action of the board.
    Act(Vec<u8>, Demand),
    /// Action of the board; the reply follows when the action ends.
    Later(Demand),
}

impl RunLinks {
    pub fn new(role: Role, config: &RobotConfig) -> Self {
        let mut room = [0; protocol::MAX_CONFIG];
        Self {
            role,
            configuration: postcard::to_slice(config, &mut room).unwrap().to_vec(),
            commander: Commander::default(),
            ports: Default::default(),
        }
    }

    /// True at the first call after the end of a lease.
    pub fn lapses(&mut self, now: u64) -> bool {
        let lapsed = self.commander.ends.is_some_and(|end| now > end);
        if lapsed {
            self.commander.ends = None;
        }
        lapsed
    }

    /// Expected outcome of frames received together. After an action, or during an order, further requests get no
    /// reply; the hosts repeat these requests.
    pub fn receive(
        &mut self,
        port: usize,
        now: u64,
        motors: MotorState,
        frames: &[Frame],
    ) -> Outcome {
        let (mut sent, mut demand) = (Vec::new(), None);
        for frame in frames {
            let counters = self.ports[port].counters;
            let Frame::Whole(payload) = frame else {
                self.ports[port].counters.damaged += 1;
                continue;
            };
            self.ports[port].counters.received += 1;
            if self.ports[port].pending.is_some() || demand.is_some() {
                continue;
            }
            let number = payload[0];
            let due = self.due(port, now, motors, payload, counters);
            let port = &mut self.ports[port];
            match due {
                Due::Greeting(reply) => {
                    (port.answered, port.hello_received) = (None, true);
                    sent.extend(framed(&reply, false));
                }
                Due::Repetition(reply) => sent.extend(framed(&reply, true)),
                Due::Reply(reply) => {
                    sent.extend(framed(&reply, false));
                    port.answered = Some((number, reply));
                }
                Due::Act(reply, act) => {
                    sent.extend(framed(&reply, false));
                    port.answered = Some((number, reply));
                    demand = Some(act);
                }
                Due::Later(act) => {
                    match act {
                        Demand::Relay(to, _) => port.relaying = Some(to),
                        _ => port.pending = Some(number),
                    }
                    demand = Some(act);
                }
            }
        }
        Outcome::new(sent, demand)
    }

    fn due(
        &mut self,
        port: usize,
        now: u64,
        motors: MotorState,
        payload: &[u8],
        counters: Counters,
    ) -> Due {
        let (role, number) = (self.role, payload[0]);
        let reply = |reply: Reply| encoded(number, &reply);
        let refused = |refusal| Due::Reply(reply(Reply::Refused(refusal)));
        let other = || refused(Refusal::OtherBoard { role });
        let request = protocol::decode::<Request>(payload).map(|(_, request)| request);
        if let Some(Request::Hello { nonce, .. }) = request {
            return Due::Greeting(reply(Reply::Hello {
                protocol: PROTOCOL,
                nonce,
                role,
                build: "fuzz",
                counters,
                session: false,
            }));
        }
        if let Some(Request::Relay { role: to, payload }) = request
            && role == Role::LEAD
            && to != role
            && let Some(frame) = SerialFrame::new(payload)
        {
            return Due::Later(Demand::Relay(to, frame));
        }
        if let Some((answered, payload)) = &self.ports[port].answered
            && *answered == number
        {
            return Due::Repetition(payload.clone());
        }
        let done = |act| Due::Act(reply(Reply::Done), act);
        match request {
            None => refused(Refusal::Malformed),
            Some(Request::Relay { payload: [], .. }) => refused(Refusal::Malformed),
            Some(Request::Relay { .. }) => other(),
            Some(Request::Configuration { offset }) => {
                let rest = self.configuration.get(usize::from(offset)..).unwrap_or(&[]);
                Due::Reply(reply(Reply::Configuration {
                    total: self.configuration.len() as u16,
                    bytes: &rest[..rest.len().min(200)],
                }))
            }
            Some(Request::Watch) => done(Demand::Watch),
            Some(Request::Stack) => Due::Reply(reply(Reply::Stack(StackUse::unknown()))),
            Some(Request::Crash) => {
                let crash = CrashRecord::default();
                Due::Reply(reply(Reply::Crash {
                    counts: crash.counts,
                    message: &crash.message,
                }))
            }
            Some(Request::Send { bus }) => match service_frame(bus) {
                Some(frame) => done(Demand::Send(frame)),
                None => refused(Refusal::Malformed),
            },
            Some(Request::Rig | Request::Record(_)) if motors != MotorState::Off => {
                refused(Refusal::Armed)
            }
            Some(Request::Rig) => done(Demand::Session),
            Some(Request::Record(_)) if role != Role::LEAD => done(Demand::Record),
            Some(Request::Keep(_) | Request::Release(_) | Request::Order { .. })
                if role != Role::LEAD =>
            {
                other()
            }
            Some(Request::Order { .. }) if !self.ports[port].hello_received => {
                refused(Refusal::NoSession)
            }
            Some(request) => self.commanded(number, now, motors, &request),
        }
    }

    /// Expected reaction to a request that needs the lease of the front board.
    fn commanded(&mut self, number: u8, now: u64, motors: MotorState, request: &Request) -> Due {
        let reply = |reply: Reply| encoded(number, &reply);
        let refused = |refusal| Due::Reply(reply(Reply::Refused(refusal)));
        let (Request::Keep(stamp)
        | Request::Release(stamp)
        | Request::Record(stamp)
        | Request::Order { stamp, .. }) = request
        else {
            return refused(Refusal::NoSession);
        };
        if let Some(refusal) = self.commander.admit(now, *stamp) {
            return refused(refusal);
        }
        match request {
            Request::Record(_) => Due::Act(reply(Reply::Done), Demand::Record),
            Request::Release(_) => {
                self.commander.ends = None;
                Due::Reply(reply(Reply::Done))
            }
            Request::Order { order, .. } => match order {
                Order::SetPose(_) if motors == MotorState::Driven => refused(Refusal::Armed),
                order => Due::Later(Demand::Order(stamp.sequence, *order)),
            },
            _ => Due::Reply(reply(Reply::Done)),
        }
    }

    /// Expected bytes at the end of an order.
    pub fn done(&mut self, port: usize, result: Result<(), PathError>) -> Vec<u8> {
        let port = &mut self.ports[port];
        let Some(number) = port.pending.take() else {
            return Vec::new();
        };
        let reply = encoded(
            number,
            &match result {
                Ok(()) => Reply::Done,
                Err(error) => Reply::Refused(Refusal::Point(error)),
            },
        );
        let bytes = framed(&reply, false);
        port.answered = Some((number, reply));
        bytes
    }

    /// Expected bytes to the host after a reply of another board: one reply per relayed request.
    pub fn relayed(&mut self, port: usize, from: Role, payload: &[u8]) -> Vec<u8> {
        let port = &mut self.ports[port];
        // Number, variant and length precede the payload.
        let head = if payload.len() < 0x80 { 3 } else { 4 };
        if port.relaying != Some(from) || payload.is_empty() || payload.len() + head > 248 {
            return Vec::new();
        }
        port.relaying = None;
        framed(&encoded(payload[0], &Reply::Relayed { payload }), false)
    }
}

fn encoded(number: u8, reply: &Reply) -> Vec<u8> {
    let mut room = [0; 300];
    postcard::to_slice(&(number, reply), &mut room)
        .unwrap()
        .to_vec()
}

fn framed(payload: &[u8], repeated: bool) -> Vec<u8> {
    let frame = SerialFrame::new(payload).expect("a reply fits a frame");
    match repeated {
        true => frame.repeated().to_vec(),
        false => frame.bytes().to_vec(),
    }
}

/// First packed frame, if a service tool may send the frame.
fn service_frame(packed: &[u8]) -> Option<CanFrame> {
    const CALIBRATION: u16 = 0x600;
    let frame = protocol::unpack(packed).next()?;
    (frame.id == CALIBRATION && bus::decode(&frame).is_ok()).then_some(frame)
}
