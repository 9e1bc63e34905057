//! Virtual board behind its serial port, in its own thread.
//!
//! The board's time advances only during an exchange: from the first byte sent to the end of the reply, or to the
//! timeout of a request.

use crate::board_log::BoardLog;
use crate::images::Images;
use crate::link::{Link, flash_file, placed_flash};
use crate::log_reader::Reader;
use crate::serial_line::SerialLine;
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use output::files;
use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use virtual_board::Time;
use virtual_board::board::Board;
use virtual_board::chip::{Circuit, Drive, Inputs, Pin};
use virtual_board::finding::FindingKind;

/// Pin of the strap that marks an axle board other than the front board.
const STRAP: Pin = Pin::new('C', 13);
/// Pin that wakes the motor drivers (nSLEEP).
const NSLEEP: Pin = Pin::new('C', 4);
/// Time that the board runs between two checks of its output, ns.
const SLICE_NS: u64 = 200_000;
/// Timeout of a request, ns.
const REQUEST_TIMEOUT_NS: u64 = 250_000_000;
/// Offset of the parameter store in the flash, bytes.
const STORE: usize = 16 << 10;

/// Circuit of the board: a serial adapter and, on an axle board other than the front board, the strap.
#[derive(Clone)]
struct Port {
    grounded: bool,
    strap_set: bool,
    line: SerialLine,
    /// True if the board has woken the motor drivers.
    woken: bool,
}

impl Circuit for Port {
    fn pin(&mut self, pin: Pin, drive: Drive, _at: Time) {
        self.woken |= pin == NSLEEP && drive == Drive::High;
    }

    fn serial(&mut self, byte: u8, _at: Time) {
        self.line.sent.push(byte);
    }

    fn next(&self) -> Time {
        match self.strap_set {
            true => self.line.next(),
            false => Time(0),
        }
    }

    fn advance(&mut self, at: Time, inputs: &mut Inputs) {
        if !self.strap_set {
            self.strap_set = true;
            let strap = if self.grounded {
                Drive::Low
            } else {
                Drive::Open
            };
            inputs.pins.push((STRAP, strap));
        }
        self.line.advance(at, inputs);
    }
}

/// Command to the thread of a board.
enum ThreadCommand {
    Send(Vec<u8>),
    Power(bool),
    Hold(bool),
}

struct ThreadedBoard {
    board: Board,
    reader: Reader,
    held: bool,
    file: Option<PathBuf>,
    saved: Vec<u8>,
}

impl ThreadedBoard {
    fn execute(&mut self, command: ThreadCommand) -> Option<io::Result<Vec<u8>>> {
        match command {
            ThreadCommand::Power(on) => self.board.power(on),
            ThreadCommand::Hold(held) => self.held = held,
            ThreadCommand::Send(bytes) => return Some(self.exchange(&bytes)),
        }
        None
    }

    /// Sends bytes and runs the board to the end of its reply, or to the timeout.
    fn exchange(&mut self, bytes: &[u8]) -> io::Result<Vec<u8>> {
        if self.held {
            return Ok(Vec::new());
        }
        let now = self.board.now();
        self.port()?.line.send(bytes, now);
        self.board.chip().refresh();
        let end = now + Time::from_nanos(REQUEST_TIMEOUT_NS);
        loop {
            let until = self.board.now() + Time::from_nanos(SLICE_NS);
            self.board.run_until(until);
            let sent = &self.port()?.line.sent;
            // A reply ends with a zero and has at least one other byte.
            if sent.len() > 1 && sent.ends_with(&[0]) || until > end {
                break;
            }
        }
        self.reader.read(&mut self.board);
        self.save_store()?;
        let findings = self.board.chip().findings().list().iter();
        let mut findings = findings.filter(|finding| finding.kind != FindingKind::Reset);
        if let Some(finding) = findings.next() {
            return Err(io::Error::other(finding.to_string()));
        }
        let port = self.port()?;
        if port.woken {
            return Err(io::Error::other(
                "the motor drivers were enabled during a session",
            ));
        }
        Ok(std::mem::take(&mut port.line.sent))
    }

    fn port(&mut self) -> io::Result<&mut Port> {
        let port = self.board.chip().circuit::<Port>();
        port.ok_or_else(|| io::Error::other("the board has no port"))
    }

    /// Writes the parameter store to its file if the store has changed.
    fn save_store(&mut self) -> io::Result<()> {
        let Some(file) = &self.file else {
            return Ok(());
        };
        let store = &self.board.chip().flash()[STORE..STORE + self.saved.len()];
        if store != self.saved {
            self.saved = store.to_vec();
            files::write_file(file, &self.saved)
                .map_err(|error| io::Error::other(error.to_string()))?;
        }
        Ok(())
    }
}

/// Link to a virtual board.
pub struct VirtualLink {
    on: bool,
    commands: Option<Sender<ThreadCommand>>,
    replies: Receiver<io::Result<Vec<u8>>>,
    /// Number of exchanges whose reply was not yet read.
    waiting: usize,
    rest: VecDeque<u8>,
    thread: Option<JoinHandle<()>>,
}

impl VirtualLink {
    /// Switches a board of a robot on. Its log goes to `log`. Its parameter store is in the file `flash`, or in memory if
    /// `flash` is `None`; a new store holds only the place of the board.
    pub fn start(
        images: &Images,
        (robot, role): (Topology, Role),
        log: &BoardLog,
        flash: Option<&Path>,
    ) -> Result<Self, Error> {
        let port = Port {
            grounded: role != Role::LEAD && !role.is_beam(),
            strap_set: false,
            line: SerialLine::default(),
            woken: false,
        };
        let image = images.of(role);
        let mut board = Board::new(Box::new(port), 0);
        board.flash(image);
        let existing = flash.map(flash_file).transpose()?.flatten();
        let saved = match existing {
            Some(bytes) => bytes,
            None => placed_flash(robot, role)?,
        };
        if let Some(file) = flash {
            files::write_file(file, &saved)?;
        }
        board.chip().flash()[STORE..STORE + saved.len()].copy_from_slice(&saved);
        board.power(true);
        let mut threaded = ThreadedBoard {
            board,
            reader: Reader::new(image, log),
            held: false,
            file: flash.map(Path::to_owned),
            saved,
        };
        let (commands, from) = channel();
        let (to, replies) = channel();
        let thread = thread::spawn(move || {
            for command in from {
                // The send fails once the link is being dropped; the thread then ends.
                if let Some(reply) = threaded.execute(command)
                    && to.send(reply).is_err()
                {
                    break;
                }
            }
        });
        Ok(Self {
            on: true,
            commands: Some(commands),
            replies,
            waiting: 0,
            rest: VecDeque::new(),
            thread: Some(thread),
        })
    }

    fn command(&self, command: ThreadCommand) -> io::Result<()> {
        let commands = self.commands.as_ref().ok_or(ErrorKind::BrokenPipe)?;
        commands
            .send(command)
            .map_err(|_| ErrorKind::BrokenPipe.into())
    }

    fn power(&mut self, on: bool) -> Result<(), Error> {
        self.on = on;
        self.rest.clear();
        Ok(self.command(ThreadCommand::Power(on))?)
    }
}

impl Link for VirtualLink {
    fn name(&self) -> &'static str {
        "virtual"
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        if !self.on {
            return Err(ErrorKind::BrokenPipe.into());
        }
        self.waiting += 1;
        self.command(ThreadCommand::Send(bytes.to_vec()))
    }

    fn receive(&mut self, buffer: &mut [u8], _timeout: Duration) -> io::Result<usize> {
        if self.rest.is_empty() && self.waiting > 0 {
            self.waiting -= 1;
            let reply = self.replies.recv().map_err(|_| ErrorKind::BrokenPipe)?;
            self.rest.extend(reply?);
        }
        self.rest.read(buffer)
    }

    fn switch_off(&mut self) -> Result<(), Error> {
        self.power(false)
    }

    fn halt(&mut self, halted: bool) -> Result<(), Error> {
        Ok(self.command(ThreadCommand::Hold(halted))?)
    }

    fn switch_on(&mut self) -> Result<(), Error> {
        self.power(true)
    }
}

impl Drop for VirtualLink {
    fn drop(&mut self) {
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            // A panic of the thread is ignored, because `drop` cannot return an error.
            let _ = thread.join();
        }
    }
}
