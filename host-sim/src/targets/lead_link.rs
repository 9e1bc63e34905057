//! The front board of a robot that drives, at its serial port: orders for the lead node, its output, and the bus frames.
//!
//! The link has no clock and no port: whoever has both calls [`LeadLink::take`] with the bytes that came and
//! [`LeadLink::to_send`] for those to send.

use super::remote::{complete, refused};
use super::{Fault, HostCommand, Room};
use crate::base::error::Error;
use core_algos::bus::CanFrame;
use core_algos::link::framing::{Decoder, SerialFrame};
use core_algos::link::lease::TERM;
use core_algos::link::protocol::{
    self, PROTOCOL, Packed, Place, Refusal, Reply, Request, Telemetry,
};
use core_algos::link::{Order, Stamp};
use core_algos::node::lead::Task;
use core_algos::time::Micros;
use core_algos::topology::Role;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU16, Ordering::Relaxed};

/// Time after which a request is repeated, µs.
const REPEAT: Micros = 250_000;
/// Times that a request is sent before the board counts as silent.
const ATTEMPTS: u32 = 20;
/// Time between renewals of the lease, µs.
const RENEW: Micros = TERM / 4;
/// Subjects of requests that are treated differently: see [`HostCommand::subject`].
const SPEED: &str = "speed";
const LEASE: &str = "lease";
/// Output of the lead node whose room is that after an order: two outputs may be on their way when it is carried out.
const FRESH: u32 = 3;

/// A request that waits for its answer.
struct Pending {
    number: u8,
    what: &'static str,
    frame: SerialFrame,
    sent: Option<Micros>,
    attempts: u32,
}

/// The link.
#[derive(Default)]
pub struct LeadLink {
    decoder: Decoder,
    number: u8,
    waiting: VecDeque<Pending>,
    parts: Vec<u8>,
    latest: Option<Telemetry>,
    /// Outputs since the latest answer to an order.
    outputs: u32,
    frames: Vec<CanFrame>,
    /// Reports since the start.
    reports: u64,
    /// Requests that the board has answered.
    answered: u32,
    lost: u16,
    build: String,
    /// Number of this host for its lease, and number of its latest order.
    owner: u16,
    sequence: Arc<AtomicU16>,
    /// Set while this host has the lease: the time of the latest order or renewal that was sent, µs.
    kept: Option<Option<Micros>>,
    leased: bool,
}

impl LeadLink {
    /// A link of a host that draws this number for its lease.
    pub fn of_owner(owner: u16) -> Self {
        Self {
            owner,
            ..Self::default()
        }
    }

    /// A link to a board that stands at a place. Whatever was asked before is forgotten.
    pub fn open(&mut self, place: Place) {
        let (number, owner, sequence) = (self.number, self.owner, self.sequence.clone());
        *self = Self {
            number,
            owner,
            sequence,
            ..Self::default()
        };
        self.watch();
        self.command(&HostCommand::Place(place));
    }

    /// Has the board send a frame of a service tool on the bus.
    pub fn send(&mut self, frame: &CanFrame) {
        let mut bus = Packed::new();
        bus.push(frame);
        self.ask("bus frame", &Request::Send { bus: bus.bytes() });
    }

    /// Asks the board who it is, and watches it.
    pub fn watch(&mut self) {
        let hello = Request::Hello {
            protocol: PROTOCOL,
            nonce: self.number.into(),
        };
        self.ask("hello", &hello);
        self.ask("watch", &Request::Watch);
    }

    /// The port was opened again. An order that waits goes first: the board knows the last one by its number, and carries
    /// it out once.
    pub fn rejoin(&mut self) {
        for pending in &mut self.waiting {
            (pending.sent, pending.attempts) = (None, 0);
        }
        self.watch();
    }

    /// Puts an order at the end of the queue. A speed that the board has not confirmed is replaced: the latest one counts.
    pub fn command(&mut self, command: &HostCommand) {
        let what = command.subject();
        let late = self.waiting.back().map(|pending| pending.what);
        if what == SPEED && late == Some(SPEED) {
            self.waiting.pop_back();
        }
        for order in command.orders() {
            let stamp = self.stamp();
            self.ask(what, &Request::Order { stamp, order });
        }
        self.outputs = 0;
    }

    /// True if an order was refused because another host has the lease.
    pub fn is_leased(&self) -> bool {
        self.leased
    }

    /// Takes the lease before the first order.
    pub fn take_lease(&mut self) {
        let stamp = self.stamp();
        self.ask("command", &Request::Keep(stamp));
    }

    /// Ends the lease.
    pub fn release(&mut self) {
        let stamp = self.stamp();
        self.ask("release", &Request::Release(stamp));
        self.kept = None;
    }

    /// The stamp of the next order.
    fn stamp(&mut self) -> Stamp {
        self.kept.get_or_insert(None);
        next_stamp(self.owner, &self.sequence)
    }

    /// Frames that switch the motors off whatever is under way, each newer than all orders before it.
    pub fn motors_off(&self) -> impl FnMut() -> SerialFrame + Send + 'static {
        let (owner, sequence) = (self.owner, self.sequence.clone());
        move || {
            let stamp = next_stamp(owner, &sequence);
            let order = Order::Task(Task::Idle);
            // Its number is that of no request of the link.
            protocol::encode(0, &Request::Order { stamp, order }).unwrap_or_default()
        }
    }

    fn ask(&mut self, what: &'static str, request: &Request) {
        // Number 0 is that of reports.
        self.number = self.number % u8::MAX + 1;
        self.waiting.push_back(Pending {
            number: self.number,
            what,
            // Every request of this link is bounded to fit.
            frame: protocol::encode(self.number, request).unwrap_or_default(),
            sent: None,
            attempts: 0,
        });
    }

    /// True if the board has answered all that it was asked, renewals of the lease apart.
    pub fn is_settled(&self) -> bool {
        self.waiting.iter().all(|pending| pending.what == LEASE)
    }

    /// True if the latest output of the lead node is younger than all orders.
    pub fn is_fresh(&self) -> bool {
        self.latest.is_some() && self.outputs >= FRESH
    }

    /// Points that the lead node has room for; none before it has told.
    pub fn room(&self) -> Room {
        match &self.latest {
            Some(latest) if self.is_settled() && self.outputs >= FRESH => Room {
                path: latest.path_room.into(),
                trajectory: latest.trajectory_room.into(),
            },
            _ => Room {
                path: 0,
                trajectory: 0,
            },
        }
    }

    /// Latest output of the lead node, once one has come.
    pub fn latest(&self) -> Option<&Telemetry> {
        self.latest.as_ref()
    }

    /// Bus frames that came since the last call, in the order of the front board.
    pub fn take_frames(&mut self) -> Vec<CanFrame> {
        std::mem::take(&mut self.frames)
    }

    /// Reports that came. A board that was restarted answers and reports nothing.
    pub fn reports(&self) -> u64 {
        self.reports
    }

    /// Bus frames that the board had no room for.
    pub fn lost(&self) -> u16 {
        self.lost
    }

    /// Damaged frames at the port.
    pub fn damaged(&self) -> u32 {
        self.decoder.counters().damaged
    }

    /// Build of the board's image, once it has answered.
    pub fn build(&self) -> &str {
        &self.build
    }

    /// Bytes to send at `now`; an error if the board does not answer.
    pub fn to_send(&mut self, now: Micros) -> Result<Option<&[u8]>, Error> {
        if let Some(kept) = &mut self.kept {
            let due = now.saturating_sub(*kept.get_or_insert(now)) >= RENEW;
            if !self.waiting.is_empty() {
                *kept = Some(now);
            } else if due {
                *kept = Some(now);
                let stamp = self.stamp();
                self.ask(LEASE, &Request::Keep(stamp));
            }
        }
        let Some(pending) = self.waiting.front_mut() else {
            return Ok(None);
        };
        if let Some(sent) = pending.sent
            && now.saturating_sub(sent) < REPEAT
        {
            return Ok(None);
        }
        if pending.attempts == ATTEMPTS {
            return Err(Error::Failure(format!(
                "front board: {}: no answer at its serial port in {} s",
                pending.what,
                Micros::from(ATTEMPTS) * REPEAT / 1_000_000
            )));
        }
        (pending.sent, pending.attempts) = (Some(now), pending.attempts + 1);
        Ok(Some(pending.frame.repeated()))
    }

    /// Takes bytes that came; gives whether an output of the lead node is complete.
    pub fn take(&mut self, bytes: &[u8]) -> Result<bool, Error> {
        let mut complete = false;
        for &byte in bytes {
            let Some(payload) = self.decoder.take_byte(byte) else {
                continue;
            };
            let Some((number, reply)) = protocol::decode::<Reply>(payload) else {
                continue;
            };
            if let Reply::Report {
                lost,
                bus,
                offset,
                telemetry,
            } = reply
            {
                self.lost = lost;
                self.reports += 1;
                self.frames.extend(protocol::unpack(bus));
                let part = (usize::from(offset), telemetry);
                complete |= Self::join(&mut self.parts, part, &mut self.latest);
                self.outputs += u32::from(complete);
                continue;
            }
            let pending = self.waiting.front();
            if let Some((what, repeated)) = pending
                .filter(|it| it.number == number)
                .map(|pending| (pending.what, pending.attempts > 1))
            {
                self.waiting.pop_front();
                if what != LEASE {
                    self.outputs = 0;
                }
                match reply {
                    Reply::Done => {}
                    // It was carried out, and its answer was lost.
                    Reply::Refused(Refusal::OldOrder) if repeated => {}
                    Reply::Hello {
                        protocol,
                        role,
                        build,
                        counters,
                        session,
                        ..
                    } => {
                        self.build = build.to_owned();
                        greeted(protocol, role, build)?;
                        if session {
                            return Err(Error::Failure(
                                "front board: it is in a session of another program, which ends after 60 s of \
                                 silence"
                                    .to_owned(),
                            ));
                        }
                        // The board counts from its start.
                        if counters.received < self.answered {
                            return Err(Error::Failure(
                                "front board: it was restarted, and its place and its task are lost: start the run again"
                                    .to_owned(),
                            ));
                        }
                    }
                    other => {
                        self.leased |= matches!(other, Reply::Refused(Refusal::Leased));
                        return Err(failure(what, other));
                    }
                }
                self.answered = self.answered.saturating_add(1);
            }
        }
        Ok(complete)
    }

    /// Appends a part of an output; a part that does not follow is dropped with those before it.
    fn join(
        parts: &mut Vec<u8>,
        (offset, part): (usize, &[u8]),
        latest: &mut Option<Telemetry>,
    ) -> bool {
        if offset == 0 {
            parts.clear();
        }
        if part.is_empty() || offset != parts.len() {
            return false;
        }
        parts.extend_from_slice(part);
        let found = complete(parts);
        let done = found.is_some();
        *latest = found.or(*latest);
        done
    }
}

/// The stamp of the next order.
fn next_stamp(owner: u16, sequence: &AtomicU16) -> Stamp {
    let sequence = sequence.fetch_add(1, Relaxed).wrapping_add(1);
    Stamp { owner, sequence }
}

fn greeted(protocol: u16, role: Role, build: &str) -> Result<(), Error> {
    if protocol != PROTOCOL {
        return Err(Error::input(format!(
            "front board: its image ({build}) has protocol version {protocol}, this program version {PROTOCOL}: \
             flash the image of this version"
        )));
    }
    if role != Role::Front {
        return Err(Error::input(format!(
            "--on serial:front: this port leads to the {} board: check ports and strap",
            role.name()
        )));
    }
    Ok(())
}

fn failure(what: &str, reply: Reply) -> Error {
    match refused(Role::Front, what, reply) {
        Fault::Fatal(error) => error,
        Fault::Silent(why) => Error::Failure(format!("front board: {what}: {why}")),
        Fault::Restarted => Error::Failure(format!("front board: {what}: it was restarted")),
    }
}
