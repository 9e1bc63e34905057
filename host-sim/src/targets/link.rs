//! Byte links to boards: in this process, or through file descriptors.

use crate::error::Error;
use core_algos::hil::protocol::StackUse;
use core_algos::hil::{Endpoint, Identity};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::time::Duration;

/// A link to one board.
pub trait Link: Send {
    /// What the link is, for reports.
    fn name(&self) -> &'static str;

    /// Sends bytes.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Waits for bytes; 0 if none came in time. An error means that the board is gone.
    fn receive(&mut self, room: &mut [u8], timeout: Duration) -> io::Result<usize>;

    /// Switches the board off.
    fn kill(&mut self) -> Result<(), Error> {
        let name = self.name();
        Err(Error::input(format!(
            "{name}: the board cannot be switched off from here"
        )))
    }

    /// Ends the board as if it had failed by itself; only the link may tell.
    fn crash(&mut self) -> Result<(), Error> {
        self.kill()
    }

    /// Stops the board's processor with its link open, or lets it go on.
    fn halt(&mut self, _halted: bool) -> Result<(), Error> {
        let name = self.name();
        Err(Error::input(format!(
            "{name}: the board cannot be stopped from here"
        )))
    }

    /// Switches the board on again.
    fn revive(&mut self) -> Result<(), Error> {
        let name = self.name();
        Err(Error::input(format!(
            "{name}: the board cannot be switched on from here"
        )))
    }
}

/// An endpoint in this process, behind its frames.
pub struct Loopback {
    identity: Identity,
    endpoint: Option<Endpoint>,
    halted: bool,
    waiting: VecDeque<u8>,
}

impl Loopback {
    /// A board that has just been started.
    pub fn new(identity: Identity) -> Self {
        Self {
            identity,
            endpoint: Some(Endpoint::new(identity, StackUse::unknown)),
            halted: false,
            waiting: VecDeque::new(),
        }
    }
}

impl Link for Loopback {
    fn name(&self) -> &'static str {
        "frames in process"
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let endpoint = self.endpoint.as_mut().ok_or(ErrorKind::BrokenPipe)?;
        if self.halted {
            return Ok(());
        }
        endpoint.receive(bytes, &mut |answer| self.waiting.extend(answer));
        Ok(())
    }

    fn receive(&mut self, room: &mut [u8], _timeout: Duration) -> io::Result<usize> {
        self.waiting.read(room)
    }

    fn kill(&mut self) -> Result<(), Error> {
        self.endpoint = None;
        self.waiting.clear();
        Ok(())
    }

    fn halt(&mut self, halted: bool) -> Result<(), Error> {
        self.halted = halted;
        Ok(())
    }

    fn revive(&mut self) -> Result<(), Error> {
        self.endpoint = Some(Endpoint::new(self.identity, StackUse::unknown));
        Ok(())
    }
}

/// A link through file descriptors: pipes, a socket, a serial port.
#[derive(Debug)]
pub struct Descriptors {
    from: File,
    to: File,
}

impl Descriptors {
    /// Reads from one and writes to the other.
    pub fn new(from: File, to: File) -> Self {
        Self { from, to }
    }

    /// Sends bytes.
    pub fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.to.write_all(bytes)
    }

    /// Waits for bytes; 0 if none came in time.
    pub fn receive(&mut self, room: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let timeout = Timespec::try_from(timeout).map_err(|_| ErrorKind::InvalidInput)?;
        let mut waiting = [PollFd::new(&self.from, PollFlags::IN)];
        match poll(&mut waiting, Some(&timeout)) {
            Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(0),
            Ok(_) => {}
            Err(error) => return Err(error.into()),
        }
        match self.from.read(room) {
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(0),
            other => other,
        }
    }
}
