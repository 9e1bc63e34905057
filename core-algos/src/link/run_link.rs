//! A driving board's side of the link: identity, orders for the lead node, reports, and the request for a session.
//!
//! | request | reaction | after | until | reason |
//! |---|---|---|---|---|
//! | [`Request::Hello`] of any version | identity sent; the next number is new; the front board takes orders | at once | reset | host or board may have restarted |
//! | number of the last request | last answer again, nothing carried out | at once | another number or a hello | the answer was lost |
//! | any, while an order is carried out | no answer | at once | [`RunLink::done`], which answers the order | the host repeats its request |
//! | [`Request::Relay`] to another board, on the front board | forwarded each time; one reply of the latest destination returned | reply of the destination | the reply | the destination recognizes repetitions |
//! | [`Request::Relay`] with an empty payload | refused: malformed | at once | | there is nothing to forward |
//! | [`Request::Relay`] otherwise | refused: other board | at once | | identifiers on the bus do not name the relaying board, so there is only one |
//! | [`Request::Order`] before a hello, on the front board | refused: no session; takes no lease | at once | a hello | the order was meant for the board before its restart |
//! | order, [`Request::Keep`], [`Request::Release`] on another board | refused: other board | at once | | the lead node is on the front board |
//! | order, keep, release, record on the front board, without the lease or with an old number | refused: leased, old order | at once | [`Lease`] | one host commands |
//! | [`Order::SetPose`] while the nodes drive | refused: armed, and the lease renewed | at once | motors off or braking | the posture would jump under the controller |
//! | [`Request::Record`] or [`Request::Rig`] unless the motors are off | refused: armed; takes no lease | at once | motors off | nodes and motors are restarted |
//! | [`Request::Send`] without a frame, with an invalid frame or a frame of a node | refused: malformed | at once | | a host sends only as the service tool |
//! | [`Request::Watch`], [`Request::Stack`], [`Request::Crash`], [`Request::Configuration`] | carried out in every motor state | at once | | reading is always safe |
//! | requests of a session | refused: no session | at once | | the board drives by itself |
//! | undecodable request | refused: malformed | at once | | another version |
//!
//! A [`Demand`] is an action that the caller must perform. Requests behind a demand in the same bytes get no answer,
//! and the host repeats them.

use super::framing::{Decoder, SerialFrame};
use super::lease::{Denied, Lease};
use super::order::Order;
use super::protocol::{
    self, CONFIG_CHUNK, CrashRecord, MAX_CONFIG, MAX_TELEMETRY, PROTOCOL, Refusal, Reply, Request,
    Spread, StackUse, Telemetry,
};
use super::sim_link::Identity;
use crate::bus::{self, CanFrame, layout};
use crate::control::path::PathError;
use crate::node::robot::RobotConfig;
use crate::time::Micros;
use crate::topology::{Node, Role};

/// Limit of the size of the recorded events in a report, bytes. A part of the lead node's output in the report reduces
/// this limit.
pub const REPORT_ENTRIES: usize = 232;
/// Time between reports to a host that watches, ms.
pub const REPORT_MS: u64 = 2;
/// Bytes of the lead node's output in one report: two reports hold the largest output.
const REPORT_CHUNK: usize = MAX_TELEMETRY / 2;

/// Action that a request demands of the caller.
#[derive(Clone, Debug, PartialEq)]
#[must_use]
pub enum Demand {
    /// Carry out the order with this sequence number and report the result by [`RunLink::done`].
    Order(u16, Order),
    /// Reset into a session.
    Session,
    /// Send a frame to another board over the bus and pass the reply to [`RunLink::relayed`].
    Relay(Role, SerialFrame),
    /// Send a frame on the bus.
    Send(CanFrame),
    /// Pass recorded events and outputs of the lead node to the run link and call [`RunLink::report`] every
    /// [`REPORT_MS`].
    Watch,
    /// Restart the nodes.
    Record,
}

/// Motor state of a board, or of the robot on a board without motors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum MotorState {
    /// Off.
    #[default]
    Off,
    /// Shorted by their drivers until the wheels stand still.
    Braking,
    /// Driven with the torque that the nodes command.
    Driven,
}

/// State of a board, shared by the run links of its ports.
#[derive(Clone, Copy, Debug, Default)]
pub struct Station {
    /// Time of the board, µs.
    pub now: Micros,
    /// State of the board's motors, or of the robot's motors on a board without motors.
    pub motors: MotorState,
    /// Host that commands the robot.
    pub lease: Lease,
}

impl Station {
    /// Checks role, motor state and lease for an order, record, keep or release; admits any other request.
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
                order: Order::SetPose(_),
                ..
            } if self.motors == MotorState::Driven => Err(Refusal::Armed),
            _ => Ok(()),
        }
    }
}

/// Functions that read stack use and crash record of the board.
type Sources = (fn() -> StackUse, fn() -> CrashRecord);

/// Reply to a request other than an order, and the demanded action. The reply borrows from `crash`.
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

/// First packed frame, if it is a valid message of the service tool.
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
    // `room` suffices for the largest configuration.
    let encoded = postcard::to_slice(config, room).map_or(&[][..], |used| used);
    let rest = encoded.get(usize::from(offset)..).unwrap_or_default();
    Reply::Configuration {
        total: encoded.len() as u16,
        bytes: rest.get(..CONFIG_CHUNK).unwrap_or(rest),
    }
}

/// A driving board's side of the link.
#[derive(Clone, Debug)]
pub struct RunLink {
    decoder: Decoder,
    identity: Identity,
    stack: fn() -> StackUse,
    crash: fn() -> CrashRecord,
    /// Number of the last request; `answer` is its reply.
    last: Option<u8>,
    answer: SerialFrame,
    /// Request number of an order that is being carried out.
    pending: Option<u8>,
    /// True after the first hello since the start.
    hello_received: bool,
    /// Destination of a relayed request whose reply is awaited.
    relaying: Option<Role>,
    telemetry: Spread,
    /// Configuration of the board's nodes.
    config: &'static RobotConfig,
    reports: u16,
}

impl RunLink {
    /// Board after a start. `config` is the configuration of its nodes, `stack` measures stack use, `crash` reads the
    /// crash record.
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
            hello_received: false,
            relaying: None,
            telemetry: Spread::default(),
            config,
            reports: 0,
        }
    }

    /// Takes received bytes, passes each complete answer to `send` and returns the first demanded action. Requests that
    /// follow a demand, or arrive during an order, get no answer, and the host repeats them.
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
                // A hello is never a repetition.
                Some(Request::Hello { nonce, .. }) => Reply::Hello {
                    protocol: PROTOCOL,
                    nonce,
                    role,
                    build: self.identity.short_build(),
                    counters,
                    session: false,
                },
                // A repetition is forwarded too, because the destination recognizes repetitions.
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
                        // An order before the first hello was meant for the board before its restart.
                        Some(Request::Order { .. })
                            if !self.hello_received && role == Role::LEAD =>
                        {
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
                (self.last, self.hello_received) = (None, true);
            }
        }
        demand
    }

    /// Sends the reply of another board to the host, if this reply is awaited.
    pub fn relayed(&mut self, from: Role, payload: &[u8], send: &mut impl FnMut(&[u8])) {
        if self.relaying == Some(from)
            && let Some(&number) = payload.first()
            && let Some(frame) = protocol::encode(number, &Reply::Relayed { payload })
        {
            self.relaying = None;
            send(frame.bytes());
        }
    }

    /// True if the last output of the lead node was sent completely.
    pub fn wants_telemetry(&self) -> bool {
        self.telemetry.left() == 0
    }

    /// Sets the next output of the lead node to send.
    pub fn send_telemetry(&mut self, telemetry: &Telemetry) {
        self.telemetry.fill(telemetry);
    }

    /// Room for recorded events in the next report beside the next part of the lead node's output, bytes.
    pub fn room(&self) -> usize {
        // Beside a part of the output, its length field may take one byte more than that of an empty part.
        match self.telemetry.left().min(REPORT_CHUNK) {
            0 => REPORT_ENTRIES,
            part => REPORT_ENTRIES - 1 - part,
        }
    }

    /// Sends `entries` and the next part of the lead node's output; sends nothing if both are empty.
    pub fn report(&mut self, lost: u16, entries: &[u8], send: &mut impl FnMut(&[u8])) {
        let offset = self.telemetry.sent() as u16;
        // Events collected before an output arrived may leave no room for a part of the output.
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
        // The size of a report is bounded, so it always fits a frame.
        if let Some(frame) = protocol::encode(0, &report) {
            send(frame.bytes());
        }
    }

    /// Answers the pending order with the result `done`; without a pending order, does nothing.
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

    /// Sends and stores an answer. Every reply fits a frame; an empty answer would make the host repeat its request.
    fn respond(&mut self, number: u8, answer: Option<SerialFrame>, send: &mut impl FnMut(&[u8])) {
        self.answer = answer.unwrap_or_default();
        self.last = Some(number);
        send(self.answer.bytes());
    }
}

#[cfg(test)]
mod tests;
