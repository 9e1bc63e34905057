//! A board that drives, at its link: it says who it is, takes orders for the lead node, and a request for a session
//! with a rig.

use super::endpoint::Identity;
use super::framing::{Decoder, SerialFrame};
use super::lease::{Denied, Lease};
use super::order::Order;
use super::protocol::{
    self, CrashRecord, MAX_TELEMETRY, PROTOCOL, Packed, Refusal, Reply, Request, Spread, StackUse,
    Telemetry,
};
use crate::bus::{self, CanFrame, layout};
use crate::control::path::PathError;
use crate::time::Micros;
use crate::topology::{Node, Role};

/// Time between reports to a host that watches, ms: about four bus frames.
pub const REPORT_MS: u64 = 2;
/// Bus frames of a report, at most.
pub const REPORT_FRAMES: usize = 9;
/// Bytes of the lead node's output in a report: all of it in two.
const REPORT_CHUNK: usize = MAX_TELEMETRY / 2;

/// Action that a request demands of the board.
#[derive(Clone, Debug, PartialEq)]
#[must_use]
pub enum Demand {
    /// To carry out an order, and to answer it with [`Attendant::done`].
    Order(Order),
    /// To reset into a session.
    Session,
    /// To send a frame to another board over the bus, and to hand its reply to [`Attendant::relayed`].
    Relay(Role, SerialFrame),
    /// To send a frame on the bus.
    Send(CanFrame),
    /// To hand over bus frames and outputs of the lead node from here on, with [`Attendant::report`] every
    /// [`REPORT_MS`].
    Watch,
}

/// State of a board that its attendants share.
#[derive(Clone, Copy, Debug, Default)]
pub struct Station {
    /// Time of the board, µs.
    pub now: Micros,
    /// True while its motors may be on.
    pub armed: bool,
    /// Host that commands the robot.
    pub lease: Lease,
}

impl Station {
    /// Admits a request to the lead node, if the lead node is on this board.
    fn admit(&mut self, role: Role, request: &Request) -> Result<(), Refusal<'static>> {
        let (Request::Order { stamp, .. } | Request::Keep(stamp) | Request::Release(stamp)) =
            request
        else {
            return Ok(());
        };
        if role != Role::Front {
            return Err(Refusal::OtherBoard { role });
        }
        self.lease
            .admit(self.now, *stamp)
            .map_err(|denied| match denied {
                Denied::Leased => Refusal::Leased,
                Denied::OldOrder => Refusal::OldOrder,
            })?;
        match request {
            Request::Order {
                order: Order::Place(_),
                ..
            } if self.armed => Err(Refusal::Armed),
            _ => Ok(()),
        }
    }
}

/// Stack use and crash record of the board.
type Sources = (fn() -> StackUse, fn() -> CrashRecord);

/// Reply to a request that is no order, and the action that it demands. `crash` holds what the reply refers to.
fn answer<'a>(
    request: Option<Request>,
    station: &mut Station,
    (stack, record): Sources,
    crash: &'a mut CrashRecord,
) -> (Reply<'a>, Option<Demand>) {
    match request {
        Some(Request::Watch) => (Reply::Done, Some(Demand::Watch)),
        Some(Request::Send { bus }) => match service(bus) {
            Some(frame) => (Reply::Done, Some(Demand::Send(frame))),
            None => (Reply::Refused(Refusal::Malformed), None),
        },
        Some(Request::Crash) => {
            *crash = record();
            let reply = Reply::Crash {
                counts: crash.counts,
                message: &crash.message,
            };
            (reply, None)
        }
        Some(Request::Stack) => (Reply::Stack(stack()), None),
        Some(Request::Keep(_)) => (Reply::Done, None),
        Some(Request::Release(_)) => {
            station.lease.release();
            (Reply::Done, None)
        }
        Some(Request::Rig) if station.armed => (Reply::Refused(Refusal::Armed), None),
        Some(Request::Rig) => (Reply::Done, Some(Demand::Session)),
        Some(_) => (Reply::Refused(Refusal::NoSession), None),
        None => (Reply::Refused(Refusal::Malformed), None),
    }
}

/// The frame, if it is one that a service tool may send.
fn service(packed: &[u8]) -> Option<CanFrame> {
    let frame = protocol::unpack(packed).next()?;
    let sender = layout::find(frame.id)?.sender;
    (sender == Node::Service && bus::decode(&frame).is_ok()).then_some(frame)
}

/// A board that drives.
#[derive(Clone, Debug)]
pub struct Attendant {
    decoder: Decoder,
    identity: Identity,
    stack: fn() -> StackUse,
    crash: fn() -> CrashRecord,
    /// Number of the last request, and what was answered.
    last: Option<u8>,
    answer: SerialFrame,
    /// Number of an order that is being carried out.
    pending: Option<u8>,
    /// True if a host has said hello since the start.
    greeted: bool,
    /// Another board whose reply is due.
    relaying: Option<Role>,
    telemetry: Spread,
}

impl Attendant {
    /// A board that has just been started; `stack` measures its stack, `crash` reads its crash record.
    pub fn new(identity: Identity, stack: fn() -> StackUse, crash: fn() -> CrashRecord) -> Self {
        Self {
            decoder: Decoder::new(),
            identity,
            stack,
            crash,
            last: None,
            answer: SerialFrame::default(),
            pending: None,
            greeted: false,
            relaying: None,
            telemetry: Spread::default(),
        }
    }

    /// Takes bytes that arrived and gives each answer to `send`, whole. A board that is armed refuses a session and a
    /// new place.
    /// While an order is carried out, other requests stay without an answer, and the host repeats them.
    pub fn receive(
        &mut self,
        bytes: &[u8],
        station: &mut Station,
        send: &mut impl FnMut(&[u8]),
    ) -> Option<Demand> {
        let mut demand = None;
        let mut crash = CrashRecord::default();
        for &byte in bytes {
            let counters = self.decoder.counters();
            let Some(payload) = self.decoder.take_byte(byte) else {
                continue;
            };
            let Some(&number) = payload.first().filter(|_| self.pending.is_none()) else {
                continue;
            };
            let request = protocol::decode::<Request>(payload).map(|(_, request)| request);
            let role = self.identity.role;
            let reply = match request {
                // Never taken for a repetition.
                Some(Request::Hello { nonce, .. }) => Reply::Hello {
                    protocol: PROTOCOL,
                    nonce,
                    role,
                    build: self.identity.short_build(),
                    counters,
                    session: false,
                },
                // The other board knows a repetition. One board relays: the identifiers do not name it.
                Some(Request::Relay { role: to, payload }) if role == Role::Front && to != role => {
                    self.relaying = Some(to);
                    let frame = SerialFrame::new(payload);
                    demand = frame.map(|frame| Demand::Relay(to, frame));
                    continue;
                }
                _ if self.last == Some(number) => {
                    send(self.answer.repeated());
                    continue;
                }
                Some(Request::Relay { .. }) => Reply::Refused(Refusal::OtherBoard { role }),
                request => {
                    let admitted = match request {
                        // Meant for the board before its restart.
                        Some(Request::Order { .. }) if !self.greeted && role == Role::Front => {
                            Err(Refusal::NoSession)
                        }
                        Some(request) => station.admit(role, &request),
                        None => Ok(()),
                    };
                    match (admitted, request) {
                        (Err(refusal), _) => Reply::Refused(refusal),
                        (Ok(()), Some(Request::Order { order, .. })) => {
                            self.pending = Some(number);
                            demand = Some(Demand::Order(order));
                            continue;
                        }
                        (Ok(()), request) => {
                            let reports = (self.stack, self.crash);
                            let (reply, wanted) = answer(request, station, reports, &mut crash);
                            demand = wanted.or(demand);
                            reply
                        }
                    }
                }
            };
            let again = matches!(reply, Reply::Hello { .. });
            let frame = protocol::encode(number, &reply);
            self.respond(number, frame, send);
            if again {
                (self.last, self.greeted) = (None, true);
            }
        }
        demand
    }

    /// Takes the reply of another board.
    pub fn relayed(&mut self, from: Role, payload: &[u8], send: &mut impl FnMut(&[u8])) {
        if self.relaying == Some(from)
            && let Some(&number) = payload.first()
            && let Some(frame) = protocol::encode(number, &Reply::Relayed { payload })
        {
            self.relaying = None;
            send(frame.bytes());
        }
    }

    /// True if the last output of the lead node was sent to its end.
    pub fn wants_telemetry(&self) -> bool {
        self.telemetry.is_sent()
    }

    /// Takes in the next output of the lead node.
    pub fn tell(&mut self, telemetry: &Telemetry) {
        self.telemetry.fill(telemetry);
    }

    /// Sends the host these bus frames and the next part of the lead node's output, unless there is nothing to send.
    pub fn report(&mut self, lost: u16, bus: &Packed, send: &mut impl FnMut(&[u8])) {
        let offset = self.telemetry.sent() as u16;
        let telemetry = self.telemetry.next(REPORT_CHUNK);
        if telemetry.is_empty() && bus.bytes().is_empty() {
            return;
        }
        let report = Reply::Report {
            lost,
            bus: bus.bytes(),
            offset,
            telemetry,
        };
        // Bounded to fit; an empty frame is not sent.
        if let Some(frame) = protocol::encode(0, &report) {
            send(frame.bytes());
        }
    }

    /// Answers the order that was carried out, or why it was not.
    pub fn done(&mut self, done: Result<(), PathError>, send: &mut impl FnMut(&[u8])) {
        let Some(number) = self.pending.take() else {
            return;
        };
        let reply = match done {
            Ok(()) => Reply::Done,
            Err(error) => Reply::Refused(Refusal::Point(error)),
        };
        self.respond(number, protocol::encode(number, &reply), send);
    }

    /// Every reply is bounded to fit a frame; an empty one would make the host ask again.
    fn respond(&mut self, number: u8, answer: Option<SerialFrame>, send: &mut impl FnMut(&[u8])) {
        self.answer = answer.unwrap_or_default();
        self.last = Some(number);
        send(self.answer.bytes());
    }
}
