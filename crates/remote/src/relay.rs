//! Link to a board over another board's serial port, which relays requests and replies over the bus.

use crate::board::Remote;
use crate::link::Link;
use core_algos::link::framing::{Decoder, MAX_FRAME, SerialFrame};
use core_algos::link::protocol::{self, Reply, Request};
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use host_sim::targets::boards::fatal;
use std::collections::VecDeque;
use std::io::{self, Read};
use std::time::{Duration, Instant};

/// Link to a board that another board relays.
pub struct Relay {
    port: Remote,
    to: Role,
    outgoing: Decoder,
    incoming: Decoder,
    waiting: VecDeque<u8>,
}

impl Relay {
    /// Opens a link to the board `to` over the port of the board `of`, which must be driving.
    pub fn open(robot: Topology, of: Role, port: Box<dyn Link>, to: Role) -> Result<Self, Error> {
        let mut port = Remote::new(robot, of, port);
        port.close_earlier_session()
            .map_err(|fault| fatal(robot.name(of), fault))?;
        Ok(Self {
            port,
            to,
            outgoing: Decoder::new(),
            incoming: Decoder::new(),
            waiting: VecDeque::new(),
        })
    }

    /// Takes bytes from the port; replies of the relaying board are discarded.
    fn take(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            if let Some(payload) = self.incoming.take_byte(byte)
                && let Some((_, Reply::Relayed { payload })) = protocol::decode(payload)
                && let Some(frame) = SerialFrame::new(payload)
            {
                self.waiting.extend(frame.bytes());
            }
        }
    }
}

impl Link for Relay {
    fn name(&self) -> &'static str {
        "bus"
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        for &byte in bytes {
            let Some(payload) = self.outgoing.take_byte(byte) else {
                continue;
            };
            let number = payload.first().copied().unwrap_or_default();
            let role = self.to;
            let frame = protocol::encode(number, &Request::Relay { role, payload })
                .ok_or_else(|| io::Error::other("the request is too long for a relay"))?;
            self.port.link().send(frame.repeated())?;
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let deadline = Instant::now() + timeout;
        let mut bytes = [0; 2 * MAX_FRAME];
        while self.waiting.is_empty() {
            let left = deadline.saturating_duration_since(Instant::now());
            let count = self.port.link().receive(&mut bytes, left)?;
            self.take(&bytes[..count]);
            if count == 0 && left.is_zero() {
                break;
            }
        }
        self.waiting.read(buffer)
    }

    /// Does nothing: the next hello waits for the board.
    fn switch_on(&mut self) -> Result<(), Error> {
        Ok(())
    }
}
