//! A server for the debugger gdb: one board at a port.
//!
//! While gdb has the board stopped, time stands still for everything (see
//! [`crate::board::Board::stop`]), so nothing is missed. Registers with those of floating point,
//! breakpoints and watchpoints in any number, single steps and interrupting work as with a debug probe.
//! Memory is read and written without side effects; registers of peripherals, whose reading may have
//! some, only after `monitor peripherals on`. The flash is not written.
//!
//! ```
//! use virtual_board::board::Board;
//! use virtual_board::probe::gdb::{GdbError, Next, Server};
//!
//! fn debug(board: &mut Board, port: u16) -> Result<(), GdbError> {
//!     let server = Server::listen(port)?;
//!     let mut session = loop {
//!         if let Some(session) = server.poll(board)? {
//!             break session;
//!         }
//!     };
//!     loop {
//!         board.run_until(board.now() + virtual_board::Time::from_micros(1000));
//!         match session.serve(board)? {
//!             Next::Run => {}
//!             Next::Wait => std::thread::sleep(std::time::Duration::from_millis(1)),
//!             Next::Gone => return Ok(()),
//!         }
//!     }
//! }
//! ```

mod registers;
mod target;

use crate::board::Board;
use crate::core::{Stop, WatchAccess};
use gdbstub::common::Signal;
use gdbstub::stub::state_machine::GdbStubStateMachine;
use gdbstub::stub::{GdbStub, SingleThreadStopReason};
use gdbstub::target::ext::breakpoints::WatchKind;
use std::fmt;
use std::io::{self, ErrorKind, Read};
use std::net::{Ipv4Addr, TcpListener, TcpStream};

/// What ended a session or kept it from beginning.
#[derive(Debug)]
pub enum GdbError {
    /// The port cannot be opened.
    Port(u16, io::Error),
    /// The connection broke.
    Connection(io::Error),
    /// gdb sent what is no packet, or something the server does not expect.
    Protocol(String),
}

impl fmt::Display for GdbError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Port(port, error) => write!(f, "port {port} cannot be opened: {error}"),
            Self::Connection(error) => write!(f, "connection to gdb: {error}"),
            Self::Protocol(text) => write!(f, "protocol of gdb: {text}"),
        }
    }
}

impl std::error::Error for GdbError {}

impl From<io::Error> for GdbError {
    fn from(error: io::Error) -> Self {
        Self::Connection(error)
    }
}

fn protocol(error: impl fmt::Display) -> GdbError {
    GdbError::Protocol(error.to_string())
}

/// What the caller is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Let the board run, and call again soon.
    Run,
    /// The board is stopped: wait a little and call again.
    Wait,
    /// gdb has gone; the board runs freely.
    Gone,
}

/// A port of this machine (127.0.0.1) at which gdb is awaited.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
}

impl Server {
    /// Opens a port; 0 takes any that is free.
    pub fn listen(port: u16) -> Result<Self, GdbError> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port));
        let listener = listener.map_err(|error| GdbError::Port(port, error))?;
        Ok(Self { listener })
    }

    /// The port.
    pub fn port(&self) -> Result<u16, GdbError> {
        Ok(self.listener.local_addr()?.port())
    }

    /// A session if gdb has connected since the last call.
    pub fn poll(&self, board: &mut Board) -> Result<Option<Session>, GdbError> {
        self.listener.set_nonblocking(true)?;
        match self.listener.accept() {
            Ok((stream, _)) => Session::new(stream, board).map(Some),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

type Machine = GdbStubStateMachine<'static, Board, TcpStream>;

/// A connected gdb.
pub struct Session {
    stream: TcpStream,
    /// Taken out while it works.
    machine: Option<Machine>,
}

impl Session {
    fn new(stream: TcpStream, board: &mut Board) -> Result<Self, GdbError> {
        stream.set_nonblocking(false)?;
        let other = stream.try_clone()?;
        board.core_mut().attach_debugger(true);
        board.stop();
        let machine = GdbStub::new(other).run_state_machine(board);
        let machine = machine.map_err(|error| {
            target::release(board);
            protocol(error)
        })?;
        Ok(Self {
            stream,
            machine: Some(machine),
        })
    }

    /// Does what gdb asks for, tells it when the board has stopped, and comes back at once. After an
    /// error the session is over and the board runs freely.
    pub fn serve(&mut self, board: &mut Board) -> Result<Next, GdbError> {
        let next = self.step(board);
        if next.is_err() {
            self.leave(board);
        }
        next
    }

    fn step(&mut self, board: &mut Board) -> Result<Next, GdbError> {
        let mut bytes = [0; 1024];
        loop {
            self.report(board)?;
            let count = match self.receive(&mut bytes) {
                Ok(0) => return Ok(self.leave(board)),
                Ok(count) => count,
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    return Ok(match self.machine {
                        Some(GdbStubStateMachine::Running(_)) => Next::Run,
                        _ => Next::Wait,
                    });
                }
                Err(error) => return Err(error.into()),
            };
            for &byte in &bytes[..count] {
                self.feed(board, byte)?;
                if self.machine.is_none() {
                    return Ok(self.leave(board));
                }
            }
        }
    }

    /// What has come, without waiting. Writing waits again.
    fn receive(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.stream.set_nonblocking(true)?;
        let count = self.stream.read(bytes);
        self.stream.set_nonblocking(false)?;
        count
    }

    /// Tells gdb if the board has stopped.
    fn report(&mut self, board: &mut Board) -> Result<(), GdbError> {
        if let (Some(GdbStubStateMachine::Running(_)), Some(stop)) =
            (&self.machine, board.stopped())
        {
            let Some(GdbStubStateMachine::Running(machine)) = self.machine.take() else {
                return Ok(());
            };
            let next = machine.report_stop(board, reason(stop));
            self.machine = Some(next.map_err(protocol)?);
        }
        Ok(())
    }

    /// A byte from gdb. Without a machine afterwards gdb has gone.
    fn feed(&mut self, board: &mut Board, byte: u8) -> Result<(), GdbError> {
        let next = match self.machine.take() {
            Some(GdbStubStateMachine::Idle(machine)) => machine.incoming_data(board, byte),
            Some(GdbStubStateMachine::Running(machine)) => machine.incoming_data(board, byte),
            other => {
                self.machine = other;
                return Ok(());
            }
        };
        let next = next.map_err(protocol)?;
        self.machine = match next {
            GdbStubStateMachine::Disconnected(_) => None,
            GdbStubStateMachine::CtrlCInterrupt(machine) => {
                board.stop();
                let reason = SingleThreadStopReason::Signal(Signal::SIGINT);
                let next = machine.interrupt_handled(board, Some(reason));
                Some(next.map_err(protocol)?)
            }
            next => Some(next),
        };
        Ok(())
    }

    /// gdb has gone: nothing of it stays.
    fn leave(&mut self, board: &mut Board) -> Next {
        self.machine = None;
        target::release(board);
        Next::Gone
    }
}

/// Why the board stopped, in gdb's words.
fn reason(stop: Stop) -> SingleThreadStopReason<u32> {
    match stop {
        Stop::Step => SingleThreadStopReason::DoneStep,
        Stop::Watchpoint { address, write, .. } => SingleThreadStopReason::Watch {
            tid: (),
            kind: if write {
                WatchKind::Write
            } else {
                WatchKind::Read
            },
            addr: address,
        },
        Stop::LockUp => SingleThreadStopReason::Signal(Signal::SIGSEGV),
        Stop::Until => SingleThreadStopReason::Signal(Signal::SIGINT),
        Stop::Breakpoint(_) | Stop::Reset => SingleThreadStopReason::Signal(Signal::SIGTRAP),
    }
}

/// Accesses of a watchpoint.
fn access(kind: WatchKind) -> WatchAccess {
    match kind {
        WatchKind::Write => WatchAccess::Write,
        WatchKind::Read => WatchAccess::Read,
        WatchKind::ReadWrite => WatchAccess::Any,
    }
}

#[cfg(test)]
mod tests;
