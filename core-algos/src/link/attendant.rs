//! A board that drives, at its link: it says who it is, takes orders for the lead node, and a request for a session
//! with a rig.

use super::endpoint::Identity;
use super::framing::{Decoder, SerialFrame};
use super::order::Order;
use super::protocol::{self, PROTOCOL, Refusal, Reply, Request, StackUse};
use crate::control::path::PathError;
use crate::topology::Role;

/// Action that a request demands of the board.
#[derive(Clone, Copy, Debug, PartialEq)]
#[must_use]
pub enum Demand {
    /// To carry out an order, and to answer it with [`Attendant::done`].
    Order(Order),
    /// To reset into a session.
    Session,
}

/// A board that drives.
#[derive(Clone, Debug)]
pub struct Attendant {
    decoder: Decoder,
    identity: Identity,
    stack: fn() -> StackUse,
    /// Number of the last request, and what was answered.
    last: Option<u8>,
    answer: SerialFrame,
    /// Number of an order that is being carried out.
    pending: Option<u8>,
}

impl Attendant {
    /// A board that has just been started; `stack` measures its stack.
    pub fn new(identity: Identity, stack: fn() -> StackUse) -> Self {
        Self {
            decoder: Decoder::new(),
            identity,
            stack,
            last: None,
            answer: SerialFrame::default(),
            pending: None,
        }
    }

    /// Takes bytes that arrived and gives each answer to `send`, whole. A board that is `armed` refuses a session.
    /// While an order is carried out, other requests stay without an answer, and the host repeats them.
    pub fn receive(
        &mut self,
        bytes: &[u8],
        armed: bool,
        send: &mut impl FnMut(&[u8]),
    ) -> Option<Demand> {
        let mut demand = None;
        for &byte in bytes {
            let counters = self.decoder.counters();
            let Some(payload) = self.decoder.take_byte(byte) else {
                continue;
            };
            let Some(&number) = payload.first().filter(|_| self.pending.is_none()) else {
                continue;
            };
            let request = protocol::decode::<Request>(payload).map(|(_, request)| request);
            let order = request.as_ref().and_then(Order::of);
            let reply = match (request, order) {
                // Never taken for a repetition.
                (Some(Request::Hello { nonce, .. }), _) => Reply::Hello {
                    protocol: PROTOCOL,
                    nonce,
                    role: self.identity.role,
                    build: self.identity.short_build(),
                    counters,
                    session: false,
                },
                _ if self.last == Some(number) => {
                    send(self.answer.repeated());
                    continue;
                }
                (_, Some(order)) if self.identity.role == Role::Front => {
                    self.pending = Some(number);
                    demand = Some(Demand::Order(order));
                    continue;
                }
                (_, Some(_)) => Reply::Refused(Refusal::OtherBoard {
                    role: self.identity.role,
                }),
                (Some(Request::Stack), _) => Reply::Stack((self.stack)()),
                (Some(Request::Rig), _) if armed => Reply::Refused(Refusal::Armed),
                (Some(Request::Rig), _) => {
                    demand = Some(Demand::Session);
                    Reply::Done
                }
                (Some(_), _) => Reply::Refused(Refusal::NoSession),
                (None, _) => Reply::Refused(Refusal::Malformed),
            };
            let again = matches!(reply, Reply::Hello { .. });
            let frame = protocol::encode(number, &reply);
            self.respond(number, frame, send);
            if again {
                self.last = None;
            }
        }
        demand
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
