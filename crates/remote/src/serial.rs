//! Boards on serial ports.

use crate::link::{Descriptors, Link};
use host_sim::base::error::Error;
use rustix::fs::{FlockOperation, Mode, OFlags, flock};
use rustix::termios::{OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};
use std::fs::File;
use std::io;
use std::path::Path;
use std::time::Duration;

/// Link to a board on a serial port.
pub struct Serial {
    link: Descriptors,
}

impl Serial {
    /// Opens a port with eight data bits, no parity and no translation. Discards bytes already received.
    pub fn open(path: &Path, baud: u32) -> Result<Self, Error> {
        let port = || -> io::Result<File> {
            let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
            let port = rustix::fs::open(path, flags, Mode::empty())?;
            flock(&port, FlockOperation::NonBlockingLockExclusive).map_err(
                |error| match error {
                    rustix::io::Errno::WOULDBLOCK => io::Error::other("another program uses it"),
                    other => other.into(),
                },
            )?;
            let mut settings = tcgetattr(&port)?;
            settings.make_raw();
            settings.set_speed(baud)?;
            tcsetattr(&port, OptionalActions::Now, &settings)?;
            tcflush(&port, QueueSelector::IOFlush)?;
            Ok(File::from(port))
        };
        let port = port()
            .and_then(|port| Ok((port.try_clone()?, port)))
            .map_err(|error| {
                Error::input(format!(
                    "{}: {error}: must be a serial port with {baud} baud; `cfmmr doctor` lists \
                     the serial ports and what each of them lacks",
                    path.display()
                ))
            })?;
        Ok(Self {
            link: Descriptors::new(port.0, port.1),
        })
    }
}

impl Link for Serial {
    fn name(&self) -> &'static str {
        "serial port"
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.link.send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.link.receive(buffer, timeout)
    }

    fn second(&self) -> Option<File> {
        self.link.second()
    }

    /// Does nothing: the user resets the board, and the next hello waits for that.
    fn switch_on(&mut self) -> Result<(), Error> {
        Ok(())
    }
}
