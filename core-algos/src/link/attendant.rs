//! A board that drives, at its link: it says who it is, takes orders for the lead node, and a request for a session
//! with a rig.
//!
//! | request | reaction | after | until | reason |
//! |---|---|---|---|---|
//! | [`Request::Hello`] of any version | board named; no number is a repetition; the front board takes orders | at once | reset | host or board may have been restarted |
//! | number of the last request | last answer again, nothing carried out | at once | another number or a hello | the answer was lost |
//! | any, while an order is carried out | no answer | at once | [`Attendant::done`], which answers the order | the host repeats its request |
//! | [`Request::Relay`] to another board, on the front board | handed on each time; one reply of the latest such board returned | its reply | the reply | the other board knows repetitions |
//! | [`Request::Relay`] of no request | refused: malformed | at once | | there is nothing to hand on |
//! | [`Request::Relay`] otherwise | refused: other board | at once | | the identifiers do not name the relay |
//! | [`Request::Order`] before a hello, on the front board | refused: no session; takes no lease | at once | a hello | meant for the board before its restart |
//! | order, [`Request::Keep`], [`Request::Release`] on another board | refused: other board | at once | | the lead node is on the front board |
//! | order, keep, release, record on the front board, without the lease or with an old number | refused: leased, old order | at once | [`Lease`] | one host commands |
//! | [`Order::Place`] while the nodes drive | refused: armed, and the lease renewed | at once | motors off or braking | the posture would jump under the controller |
//! | [`Request::Record`] or [`Request::Rig`] unless the motors are off | refused: armed; takes no lease | at once | motors off | nodes and motors begin anew |
//! | [`Request::Send`] of no frame, a damaged one or one of a node | refused: malformed | at once | | a host speaks for the service tool only |
//! | [`Request::Watch`], [`Request::Stack`], [`Request::Crash`], [`Request::Configuration`] | carried out, whatever the motors are | at once | | reading is always safe |
//! | requests of a session | refused: no session | at once | | the board drives by itself |
//! | what cannot be decoded | refused: malformed | at once | | another version |
//!
//! A request behind a demand in the same bytes gets no answer. Its host repeats it.

use super::endpoint::Identity;
use super::framing::{Decoder, SerialFrame};
use super::lease::{Denied, Lease};
use super::order::Order;
use super::protocol::{
    self, CONFIG_CHUNK, CrashRecord, MAX_CONFIG, MAX_TELEMETRY, PROTOCOL, Refusal, Reply, Request,
    Spread, StackUse, Telemetry,
};
use crate::bus::{self, CanFrame, layout};
use crate::control::path::PathError;
use crate::node::robot::RobotConfig;
use crate::time::Micros;
use crate::topology::{Node, Role};

/// Bytes of entries in a report, at most; a part of the lead node's output takes its share.
pub const REPORT_ENTRIES: usize = 232;
/// Time between reports to a host that watches, ms.
pub const REPORT_MS: u64 = 2;
/// Bytes of the lead node's output in a report: all of it in two.
const REPORT_CHUNK: usize = MAX_TELEMETRY / 2;

/// Action that a request demands of the board.
#[derive(Clone, Debug, PartialEq)]
#[must_use]
pub enum Demand {
    /// To carry out the order of this number, and to answer it with [`Attendant::done`].
    Order(u16, Order),
    /// To reset into a session.
    Session,
    /// To send a frame to another board over the bus, and to hand its reply to [`Attendant::relayed`].
    Relay(Role, SerialFrame),
    /// To send a frame on the bus.
    Send(CanFrame),
    /// To hand over entries and outputs of the lead node from here on, with [`Attendant::report`] every
    /// [`REPORT_MS`].
    Watch,
    /// To let the nodes begin anew.
    Record,
}

/// State of the motors of a board, or of the robot as a board without motors knows it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum MotorState {
    /// Off.
    #[default]
    Off,
    /// Shorted by their drivers until the wheels stand still.
    Braking,
    /// Given a torque by the nodes.
    Driven,
}

/// State of a board that its attendants share.
#[derive(Clone, Copy, Debug, Default)]
pub struct Station {
    /// Time of the board, µs.
    pub now: Micros,
    /// Its motors.
    pub motors: MotorState,
    /// Host that commands the robot.
    pub lease: Lease,
}

impl Station {
    /// Admits a request to the lead node, if the lead node is on this board.
    fn admit(&mut self, role: Role, request: &Request) -> Result<(), Refusal<'static>> {
        let (Request::Order { stamp, .. }
        | Request::Record(stamp)
        | Request::Keep(stamp)
        | Request::Release(stamp)) = request
        else {
            return Ok(());
        };
        let begins = matches!(request, Request::Record(_));
        if begins && self.motors != MotorState::Off {
            return Err(Refusal::Armed);
        }
        match role {
            Role::LEAD => {}
            _ if begins => return Ok(()),
            _ => return Err(Refusal::OtherBoard { role }),
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
            } if self.motors == MotorState::Driven => Err(Refusal::Armed),
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
        Some(Request::Record(_)) => (Reply::Done, Some(Demand::Record)),
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
        Some(Request::Rig) if station.motors != MotorState::Off => {
            (Reply::Refused(Refusal::Armed), None)
        }
        Some(Request::Rig) => (Reply::Done, Some(Demand::Session)),
        Some(_) => (Reply::Refused(Refusal::NoSession), None),
        None => (Reply::Refused(Refusal::Malformed), None),
    }
}

/// The frame, if it is one that a service tool may send.
fn service(packed: &[u8]) -> Option<CanFrame> {
    let frame = protocol::unpack(packed).next()?;
    let sender = layout::sender(frame.id)?;
    (sender == Node::Service && bus::decode(&frame).is_ok()).then_some(frame)
}

/// True if the board `role` relays this request to the board `to`.
fn relays(role: Role, to: Role, payload: &[u8]) -> bool {
    role == Role::LEAD && to != role && !payload.is_empty()
}

/// The part of an encoded configuration that begins at `offset`.
fn configuration<'a>(config: &RobotConfig, offset: u16, room: &'a mut [u8]) -> Reply<'a> {
    // Its largest size is known to fit.
    let encoded = postcard::to_slice(config, room).map_or(&[][..], |used| used);
    let rest = encoded.get(usize::from(offset)..).unwrap_or_default();
    Reply::Configuration {
        total: encoded.len() as u16,
        bytes: rest.get(..CONFIG_CHUNK).unwrap_or(rest),
    }
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
    /// Configuration of the board's nodes.
    config: &'static RobotConfig,
    reports: u16,
}

impl Attendant {
    /// A board that has just been started, with nodes of this configuration; `stack` measures its stack, `crash` reads
    /// its crash record.
    pub fn new(
        identity: Identity,
        config: &'static RobotConfig,
        stack: fn() -> StackUse,
        crash: fn() -> CrashRecord,
    ) -> Self {
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
            config,
            reports: 0,
        }
    }

    /// Takes bytes that arrived and gives each answer to `send`, whole. A board refuses a session and a record until
    /// its motors are off, and a new place while its nodes drive.
    /// While an order is carried out, other requests stay without an answer, and the host repeats them. So do requests
    /// that arrive in one piece with a request that demands an action: each action is given to the caller.
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
            let free = self.pending.is_none() && demand.is_none();
            let Some(&number) = payload.first().filter(|_| free) else {
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
                Some(Request::Relay { role: to, payload }) if relays(role, to, payload) => {
                    self.relaying = Some(to);
                    demand = SerialFrame::new(payload).map(|frame| Demand::Relay(to, frame));
                    continue;
                }
                _ if self.last == Some(number) => {
                    send(self.answer.repeated());
                    continue;
                }
                Some(Request::Relay { payload: [], .. }) => Reply::Refused(Refusal::Malformed),
                Some(Request::Relay { .. }) => Reply::Refused(Refusal::OtherBoard { role }),
                Some(Request::Configuration { offset }) => {
                    let mut room = [0; MAX_CONFIG];
                    let reply = configuration(self.config, offset, &mut room);
                    self.respond(number, protocol::encode(number, &reply), send);
                    continue;
                }
                request => {
                    let admitted = match request {
                        // Meant for the board before its restart.
                        Some(Request::Order { .. }) if !self.greeted && role == Role::LEAD => {
                            Err(Refusal::NoSession)
                        }
                        Some(request) => station.admit(role, &request),
                        None => Ok(()),
                    };
                    match (admitted, request) {
                        (Err(refusal), _) => Reply::Refused(refusal),
                        (Ok(()), Some(Request::Order { stamp, order })) => {
                            self.pending = Some(number);
                            demand = Some(Demand::Order(stamp.sequence, order));
                            continue;
                        }
                        (Ok(()), request) => {
                            let reports = (self.stack, self.crash);
                            let (reply, wanted) = answer(request, station, reports, &mut crash);
                            demand = wanted;
                            reply
                        }
                    }
                }
            };
            let again = matches!(reply, Reply::Hello { .. });
            self.respond(number, protocol::encode(number, &reply), send);
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
        self.telemetry.left() == 0
    }

    /// Takes in the next output of the lead node.
    pub fn tell(&mut self, telemetry: &Telemetry) {
        self.telemetry.fill(telemetry);
    }

    /// Bytes of entries that the next report has room for, beside the next part of the lead node's output.
    pub fn room(&self) -> usize {
        // The length of a part may take a byte more.
        match self.telemetry.left().min(REPORT_CHUNK) {
            0 => REPORT_ENTRIES,
            part => REPORT_ENTRIES - 1 - part,
        }
    }

    /// Sends the host these entries and the next part of the lead node's output, unless there is nothing to send.
    pub fn report(&mut self, lost: u16, entries: &[u8], send: &mut impl FnMut(&[u8])) {
        let offset = self.telemetry.sent() as u16;
        // Entries without a part were taken before the output came.
        let telemetry = match entries.len() <= self.room() {
            true => self.telemetry.next(REPORT_CHUNK),
            false => &[],
        };
        if telemetry.is_empty() && entries.is_empty() {
            return;
        }
        let report = Reply::Report {
            sequence: self.reports,
            lost,
            entries,
            offset,
            telemetry,
        };
        self.reports = self.reports.wrapping_add(1);
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

#[cfg(test)]
mod tests;
