//! Board's side of the link in a session: bytes in, the board's nodes, bytes out.
//!
//! The caller writes the board's store, because a write takes time and hardware. After each [`SimLink::receive`] the
//! caller polls [`SimLink::save`] for a pending write and reports its result by [`SimLink::saved`]. Until then other
//! requests get no answer, and the host repeats them.
//!
//! | request | reaction | refused if | until | reason |
//! |---|---|---|---|---|
//! | hello of this version | session open; nodes, received configuration and end of session discarded; the next number is new | never | a hello of another version, or reset | either side may have restarted |
//! | hello of another version | as above, and the session is closed | never | a hello of this version | |
//! | number of the last request | last answer again, nothing carried out | never | another number, or a hello | the answer was lost |
//! | any other request | by the rows below | no session: no session; not decoded: malformed | | |
//! | part of the configuration | appended; offset 0 starts over | offset not at the end of the previous parts, total differs, or part exceeds the total: part | hello | |
//! | start | nodes replaced, lead node at the given posture | configuration incomplete or checksum differs: hash; not decodable: undecodable; out of range: parameter | hello, or a start, even if refused | |
//! | tick | nodes run once, the next tick is expected | samples of another board, not started, another tick | | the board's time is the time in the request |
//! | frames of a tick | received by the nodes before those of the tick's request; counted as refused in its reply if not decoded | beam board: other board; not started, another tick | | more frames than a request holds |
//! | resume | the given tick is expected next | not started; tick already carried out: tick | | time has passed without the board |
//! | order | applied to the lead node | not started; no lead node: other board; the lead node's reason | | |
//! | parameter set | kept until reset | motors may be on; index unknown; out of range | reset | |
//! | parameters saved | one write pending; answered when it is done | motors may be on; no node can be built with the values; store broken | answer | a flash write halts the core |
//! | any, while a save is under way | no answer | | the save is done | the host repeats its request |
//! | end of session | done; the board must be reset | never | hello | |
//! | rig | done | never | | the session is open |
//! | other requests for a driving board | none | always: malformed | | the rig simulates the bus and is the only host |

use super::framing::{Counters, Decoder, MAX_PAYLOAD, SerialFrame, crc32c};
use super::protocol::{
    self, MAX_CONFIG, PROTOCOL, Packed, Placement, Refusal, Reply, Request, Spread, StackUse,
    TICK_REPLY_HEAD, Telemetry,
};
use super::session_nodes::SessionNodes;
use super::stored_parameters::{Save, StoreError, StoredParameters};
use crate::bus;
use crate::config::ConfigError;
use crate::node::Outbox;
use crate::node::board::{Board, Output, Samples};
use crate::node::lead::LeadNode;
use crate::node::robot::RobotConfig;
use crate::params::{BoardKind, COUNT, Contents, Disarmed};
use crate::time::{Micros, TICK};
use crate::topology::Role;
use core::fmt::Write;

/// Identity of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Build identification of any length; a reply carries [`Self::short_build`].
    pub build: &'static str,
    /// Role of the board.
    pub role: Role,
}

impl Identity {
    /// Build identification, cut between characters to at most 64 bytes.
    pub fn short_build(&self) -> &'static str {
        let text = self.build;
        let end = (0..=64).rev().find(|&end| text.is_char_boundary(end));
        end.and_then(|end| text.get(..end)).unwrap_or(text)
    }
}

/// Board's side of the link in a session, with the nodes in a place of type `N`.
#[derive(Clone, Debug)]
pub struct SimLink<N = Option<Board>> {
    decoder: Decoder,
    session: Session<N>,
}

impl SimLink {
    /// Board after a start, without configuration and with an empty store; `stack` measures stack use.
    pub fn new(identity: Identity, stack: fn() -> StackUse) -> Self {
        Self::with_nodes(identity, stack, None)
    }

    /// The nodes, once they have been started.
    pub fn board(&self) -> Option<&Board> {
        self.session.nodes.as_ref()
    }
}

impl<N: SessionNodes> SimLink<N> {
    /// As [`SimLink::new`], with an empty place for the nodes.
    #[inline]
    pub fn with_nodes(identity: Identity, stack: fn() -> StackUse, nodes: N) -> Self {
        Self {
            decoder: Decoder::new(),
            session: Session::new(identity, stack, nodes),
        }
    }

    /// Loads the contents of the board's store after a start.
    pub fn load(&mut self, contents: &Contents) {
        self.session.stored.load(contents);
    }

    /// Pending write to the store, returned once; the caller reports the result by [`Self::saved`].
    pub fn save(&mut self) -> Option<Save> {
        let off = self.session.saving.as_mut()?.off.take()?;
        Some(self.session.stored.save(off))
    }

    /// Sends the host the result of the save: number of values written and contents of the store, or `None` if the
    /// write failed.
    pub fn saved(&mut self, done: Option<(usize, &Contents)>, send: &mut impl FnMut(&[u8])) {
        self.session.saved(done, send);
    }

    /// The parameters that the board keeps.
    pub fn stored(&self) -> &StoredParameters {
        &self.session.stored
    }

    /// Takes received bytes; passes each complete answer to `send`.
    pub fn receive(&mut self, bytes: &[u8], send: &mut impl FnMut(&[u8])) {
        for &byte in bytes {
            let before = self.decoder.counters();
            if let Some(payload) = self.decoder.take_byte(byte) {
                let counters = Counters {
                    received: before.received.wrapping_add(1),
                    ..before
                };
                self.session.handle(payload, counters, send);
            }
        }
    }

    /// Numbers of received and damaged frames.
    pub fn counters(&self) -> Counters {
        self.decoder.counters()
    }

    /// True if the host has ended the session and the board must be reset.
    pub fn has_ended(&self) -> bool {
        self.session.ended
    }
}

#[derive(Clone, Debug)]
struct Session<N> {
    identity: Identity,
    stack: fn() -> StackUse,
    /// True after a hello of this protocol version.
    open: bool,
    /// True if the host has ended the session since the hello.
    ended: bool,
    /// Number of the last request; `answer` is its reply.
    last: Option<u8>,
    answer: SerialFrame,
    configuration: Configuration,
    stored: StoredParameters,
    saving: Option<Saving>,
    nodes: N,
    tick: u32,
    /// Bus frames of the next tick that could not be decoded.
    refused: u8,
    outbox: Outbox,
    telemetry: Spread,
}

/// A request to save that is not answered yet.
#[derive(Clone, Copy, Debug)]
struct Saving {
    /// Number of the request to save.
    number: u8,
    /// Proof that the motors were off at the request; `None` once the write is taken.
    off: Option<Disarmed>,
}

impl<N: SessionNodes> Session<N> {
    #[inline]
    fn new(identity: Identity, stack: fn() -> StackUse, nodes: N) -> Self {
        Self {
            identity,
            stack,
            open: false,
            ended: false,
            last: None,
            answer: SerialFrame::default(),
            configuration: Configuration::default(),
            stored: StoredParameters::new(BoardKind::of(identity.role)),
            saving: None,
            nodes,
            tick: 0,
            refused: 0,
            outbox: Outbox::new(),
            telemetry: Spread::default(),
        }
    }

    fn handle(&mut self, payload: &[u8], counters: Counters, send: &mut impl FnMut(&[u8])) {
        let Some(&number) = payload.first() else {
            return;
        };
        if self.saving.is_some() {
            return;
        }
        let request = protocol::decode::<Request>(payload).map(|(_, request)| request);
        if let Some(Request::Hello { protocol, nonce }) = request {
            (self.open, self.ended) = (protocol == PROTOCOL, false);
            self.configuration = Configuration::default();
            self.nodes.discard();
            let reply = Reply::Hello {
                protocol: PROTOCOL,
                nonce,
                role: self.identity.role,
                build: self.identity.short_build(),
                counters,
                session: true,
            };
            self.respond(number, protocol::encode(number, &reply), send);
            // The next request is no repetition, whatever its number.
            self.last = None;
        } else if self.last == Some(number) {
            send(self.answer.repeated());
        } else {
            self.execute(number, request, send);
        }
    }

    /// Sends and stores an answer. Every reply fits a frame; an empty answer would make the host repeat its request.
    fn respond(&mut self, number: u8, answer: Option<SerialFrame>, send: &mut impl FnMut(&[u8])) {
        self.answer = answer.unwrap_or_default();
        self.last = Some(number);
        send(self.answer.bytes());
    }

    fn execute(&mut self, number: u8, request: Option<Request>, send: &mut impl FnMut(&[u8])) {
        if let (Some(Request::SaveParameters), true) = (request, self.open)
            && let Some(off) = self.nodes.disarmed()
            && self.stored.check().is_ok()
        {
            let off = Some(off);
            self.saving = Some(Saving { number, off });
            return;
        }
        // Storage that the reply borrows.
        let (mut text, mut bus) = (Text::new(), Packed::new());
        let reply = match request {
            Some(request) if self.open => self.reply_to(request, &mut text, &mut bus),
            Some(_) => Err(Refusal::NoSession),
            None => Err(Refusal::Malformed),
        };
        let answer = protocol::encode(number, &reply.unwrap_or_else(Reply::Refused));
        self.respond(number, answer, send);
    }

    fn saved(&mut self, done: Option<(usize, &Contents)>, send: &mut impl FnMut(&[u8])) {
        let Some(Saving { number, .. }) = self.saving.take() else {
            return;
        };
        let reply = match done {
            Some((values, contents)) => {
                self.stored.saved(contents);
                Reply::Saved {
                    values: u8::try_from(values).unwrap_or(u8::MAX),
                }
            }
            None => Reply::Refused(Refusal::NotSaved),
        };
        self.respond(number, protocol::encode(number, &reply), send);
    }

    fn reply_to<'a>(
        &'a mut self,
        request: Request,
        text: &'a mut Text,
        bus: &'a mut Packed,
    ) -> Result<Reply<'a>, Refusal<'a>> {
        match request {
            // `handle` answers a hello. The others are for a driving board: here a tick brings telemetry, and the rig
            // simulates the bus.
            Request::Hello { .. }
            | Request::Watch
            | Request::Configuration { .. }
            | Request::Record(_)
            | Request::Relay { .. }
            | Request::Crash
            | Request::Keep(_)
            | Request::Release(_)
            | Request::Send { .. } => Err(Refusal::Malformed),
            // The session is already open.
            Request::Rig => Ok(Reply::Done),
            Request::EndSession => self.end_session(),
            Request::Configure {
                total,
                offset,
                bytes,
            } => self.configuration.append(total, offset, bytes),
            Request::Start { hash, tick, place } => self.start(hash, tick, place, text),
            // A session has one host, so an order needs no lease.
            Request::Order { order, .. } => {
                order.execute(self.lead()?).map_err(Refusal::Point)?;
                Ok(Reply::Done)
            }
            Request::Axle {
                tick,
                samples,
                bus: received,
            } => {
                self.tick(tick, &Samples::Axle(samples), received, bus)
                    .map(|(output, refused)| Reply::Axle {
                        torque_nm: output.torque_nm,
                        active: output.active,
                        refused,
                        bus: bus.bytes(),
                        telemetry: {
                            let room = MAX_PAYLOAD - TICK_REPLY_HEAD - bus.bytes().len();
                            let chunk = self.telemetry.chunk(Micros::from(tick) * TICK);
                            self.telemetry.next(chunk.min(room))
                        },
                    })
            }
            Request::Frames { tick, bus } => self.receive_ahead(tick, bus),
            Request::Beam { tick, samples } => self
                .tick(tick, &Samples::Beam(samples), &[], bus)
                .map(|(_, refused)| Reply::Beam {
                    refused,
                    bus: bus.bytes(),
                }),
            Request::Resume { tick } => self.resume(tick),
            Request::Stack => Ok(Reply::Stack((self.stack)())),
            Request::Parameters => Ok(self.stored.summary()),
            Request::Parameter { index } => self.stored.get(index),
            Request::SetParameter { index, value } => {
                let off = self.nodes.disarmed().ok_or(Refusal::Armed)?;
                match self.stored.set(index, value, off) {
                    Ok(()) => Ok(Reply::Done),
                    Err(error) => Err(not_kept(error, text)),
                }
            }
            // `execute` starts a save that passes both checks; only a refusal gets here.
            Request::SaveParameters => {
                self.nodes.disarmed().ok_or(Refusal::Armed)?;
                Err(match self.stored.check() {
                    Ok(()) => Refusal::NotSaved,
                    Err(error) => not_kept(error, text),
                })
            }
        }
    }

    fn start<'a>(
        &mut self,
        hash: u32,
        tick: u32,
        place: Option<Placement>,
        text: &'a mut Text,
    ) -> Result<Reply<'a>, Refusal<'a>> {
        self.nodes.discard();
        self.telemetry = Spread::default();
        let bytes = self.configuration.complete(hash)?;
        let config: RobotConfig = postcard::from_bytes(bytes).map_err(|_| Refusal::Undecodable)?;
        if let Err(error) = self.nodes.start(&config, self.identity.role) {
            return Err(out_of_range(&error, text));
        }
        self.tick = tick;
        self.refused = 0;
        if let (Some(place), Ok(lead)) = (place, self.lead()) {
            lead.initialize(&place);
        }
        Ok(Reply::Done)
    }

    fn end_session<'a>(&mut self) -> Result<Reply<'a>, Refusal<'a>> {
        self.ended = true;
        Ok(Reply::Done)
    }

    /// Skips the ticks before `tick`.
    fn resume<'a>(&mut self, tick: u32) -> Result<Reply<'a>, Refusal<'a>> {
        self.started()?;
        if tick < self.tick {
            return Err(Refusal::Tick {
                expected: self.tick,
            });
        }
        self.tick = tick;
        Ok(Reply::Done)
    }

    fn lead<'a>(&mut self) -> Result<&mut LeadNode, Refusal<'a>> {
        self.started()?;
        let role = self.identity.role;
        self.nodes.lead().ok_or(Refusal::OtherBoard { role })
    }

    fn started<'a>(&self) -> Result<(), Refusal<'a>> {
        match self.nodes.are_started() {
            true => Ok(()),
            false => Err(Refusal::NotStarted),
        }
    }

    /// Hands the nodes bus frames for the next tick; the tick's request brings the other frames.
    fn receive_ahead<'a>(&mut self, tick: u32, received: &[u8]) -> Result<Reply<'a>, Refusal<'a>> {
        self.receive(false, tick, received)?;
        Ok(Reply::Done)
    }

    /// Takes frames that arrived before the next tick of an axle board or a beam board.
    fn receive<'a>(
        &mut self,
        is_beam: bool,
        tick: u32,
        received: &[u8],
    ) -> Result<(), Refusal<'a>> {
        let role = self.identity.role;
        if is_beam != role.is_beam() {
            return Err(Refusal::OtherBoard { role });
        }
        self.started()?;
        if tick != self.tick {
            return Err(Refusal::Tick {
                expected: self.tick,
            });
        }
        let now = Micros::from(tick) * TICK;
        for frame in protocol::unpack(received) {
            match bus::decode(&frame) {
                Ok(message) => self.nodes.receive(now, &message),
                Err(_) => self.refused = self.refused.saturating_add(1),
            }
        }
        Ok(())
    }

    /// Runs one tick and appends sent frames to `sent`; returns the output and the number of refused frames.
    fn tick<'a>(
        &mut self,
        tick: u32,
        samples: &Samples,
        received: &[u8],
        sent: &mut Packed,
    ) -> Result<(Output, u8), Refusal<'a>> {
        self.receive(matches!(samples, Samples::Beam(_)), tick, received)?;
        self.tick = self.tick.wrapping_add(1);
        let now = Micros::from(tick) * TICK;
        let mut refused = core::mem::take(&mut self.refused);
        let mut refuse = || refused = refused.saturating_add(1);
        self.outbox.clear();
        let output = self.nodes.step(now, samples, &mut self.outbox);
        for message in self.outbox.iter() {
            match bus::encode(message) {
                Ok(frame) if sent.push(&frame) => {}
                _ => refuse(),
            }
        }
        if let (Some(output), Some(lead)) = (output.lead, self.nodes.lead()) {
            self.telemetry.fill(&Telemetry::of(now, output, lead));
        }
        Ok((output, refused))
    }
}

/// Refusal with field, value and allowed range.
fn out_of_range<'a>(error: &ConfigError, text: &'a mut Text) -> Refusal<'a> {
    // Text that does not fit is dropped.
    let _ = write!(text, "{error}");
    Refusal::Parameter {
        text: text.as_str(),
    }
}

fn not_kept(error: StoreError, text: &mut Text) -> Refusal<'_> {
    match error {
        StoreError::Index => Refusal::Index { count: COUNT as u8 },
        StoreError::Value(error) => out_of_range(&error, text),
    }
}

/// Encoded configuration, received in parts.
#[derive(Clone, Debug, Default)]
struct Configuration {
    bytes: heapless::Vec<u8, MAX_CONFIG>,
    total: usize,
}

impl Configuration {
    /// Appends the next part; offset 0 starts over.
    fn append<'a>(
        &mut self,
        total: u16,
        offset: u16,
        part: &[u8],
    ) -> Result<Reply<'a>, Refusal<'a>> {
        if offset == 0 {
            self.bytes.clear();
            self.total = usize::from(total);
        }
        let refusal = Refusal::Part {
            received: self.bytes.len() as u16,
        };
        let received = self.bytes.len();
        let follows = usize::from(offset) == received && usize::from(total) == self.total;
        if !follows || received + part.len() > self.total {
            return Err(refusal);
        }
        self.bytes.extend_from_slice(part).map_err(|_| refusal)?;
        Ok(Reply::Configured {
            hash: crc32c(&self.bytes),
        })
    }

    /// The configuration, if it is complete and has this checksum.
    fn complete<'a>(&self, hash: u32) -> Result<&[u8], Refusal<'a>> {
        let found = crc32c(&self.bytes);
        if self.bytes.len() != self.total || found != hash {
            return Err(Refusal::Hash { found });
        }
        Ok(&self.bytes)
    }
}

/// A line of text of bounded length.
type Text = heapless::String<160>;

#[cfg(test)]
mod tests;
