//! A board that drives, at its link: it says who it is, and takes a request for a session with a rig.

use super::endpoint::Identity;
use super::framing::Decoder;
use super::protocol::{self, PROTOCOL, Refusal, Reply, Request};

/// A board that drives.
#[derive(Clone, Debug)]
pub struct Attendant {
    decoder: Decoder,
    identity: Identity,
}

impl Attendant {
    /// A board that has just been started.
    pub fn new(identity: Identity) -> Self {
        Self {
            decoder: Decoder::new(),
            identity,
        }
    }

    /// Takes bytes that arrived and gives each answer to `send`, whole. True if the board is to reset into a session;
    /// a board that is `armed` refuses one.
    pub fn receive(&mut self, bytes: &[u8], armed: bool, send: &mut impl FnMut(&[u8])) -> bool {
        let mut session = false;
        for &byte in bytes {
            let counters = self.decoder.counters();
            let Some(payload) = self.decoder.take_byte(byte) else {
                continue;
            };
            let Some((number, request)) = protocol::decode::<Request>(payload) else {
                let refused = Reply::Refused(Refusal::Malformed);
                answer(payload.first().copied(), &refused, send);
                continue;
            };
            let reply = match request {
                Request::Hello { nonce, .. } => Reply::Hello {
                    protocol: PROTOCOL,
                    nonce,
                    role: self.identity.role,
                    build: self.identity.short_build(),
                    counters,
                    session: false,
                },
                Request::Rig if armed => Reply::Refused(Refusal::Armed),
                Request::Rig => {
                    session = true;
                    Reply::Done
                }
                _ => Reply::Refused(Refusal::NoSession),
            };
            answer(Some(number), &reply, send);
        }
        session
    }
}

fn answer(number: Option<u8>, reply: &Reply, send: &mut impl FnMut(&[u8])) {
    let frame = number.and_then(|number| protocol::encode(number, reply));
    send(frame.unwrap_or_default().bytes());
}
