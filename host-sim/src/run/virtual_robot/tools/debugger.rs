//! gdb at a board: while it has the board stopped, time stands still for everything.

use crate::base::error::Error;
use core_algos::topology::Role;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::Duration;
use virtual_board::Time;
use virtual_board::board::Board;
use virtual_board::network::Network;
use virtual_board::probe::gdb::{GdbError, Next, Server, Session};

/// Time between two looks at a debugger that has nothing to say.
const PAUSE: Duration = Duration::from_millis(1);

/// Debuggers that boards wait for when their power comes on.
#[derive(Clone, Debug, Default)]
pub struct Gdb {
    ports: Vec<(Role, u16)>,
    /// Ends the waiting.
    interrupt: Arc<AtomicBool>,
}

impl Gdb {
    /// From texts `BOARD@PORT`, whose ports must be free; the flag ends the waiting for debuggers.
    pub fn new(texts: &[String], interrupt: &Arc<AtomicBool>) -> Result<Self, Error> {
        let mut ports: Vec<(Role, u16)> = Vec::new();
        for text in texts {
            let (role, port) = parse(text)?;
            if ports.iter().any(|(other, _)| *other == role) {
                return Err(Error::input(format!("--gdb {text}: only one port a board")));
            }
            // Tried now; opened when the board is there to answer.
            listen(role, port)?;
            ports.push((role, port));
        }
        Ok(Self {
            ports,
            interrupt: interrupt.clone(),
        })
    }
}

fn listen(role: Role, port: u16) -> Result<Server, Error> {
    Server::listen(port).map_err(|error| {
        let name = role.name();
        Error::input(format!("--gdb {name}@{port}: {error}: must be a free port"))
    })
}

/// Board and port of `BOARD@PORT`.
fn parse(text: &str) -> Result<(Role, u16), Error> {
    let parts = text.split_once('@').and_then(|(board, port)| {
        let role = Role::ALL.into_iter().find(|role| role.name() == board)?;
        let port: u16 = port.parse().ok()?;
        (port > 0).then_some((role, port))
    });
    parts.ok_or_else(|| {
        Error::input(format!(
            "--gdb {text}: must be front, rear or beam, then @ and a port from 1 to 65535"
        ))
    })
}

/// A board's debugger.
struct Attached {
    place: usize,
    role: Role,
    server: Server,
    session: Option<Session>,
    /// A debugger has let the board run.
    begun: bool,
}

/// The debuggers of a robot.
#[derive(Default)]
pub(super) struct Debugger {
    attached: Vec<Attached>,
    interrupt: Arc<AtomicBool>,
}

fn broken(role: Role, error: &GdbError) -> Error {
    Error::Failure(format!("--gdb, {} board: {error}", role.name()))
}

impl Debugger {
    /// For the boards of a robot in their order.
    pub fn new(gdb: &Gdb, roles: &[Role]) -> Result<Self, Error> {
        let mut attached = Vec::new();
        for &(role, port) in &gdb.ports {
            let Some(place) = roles.iter().position(|other| *other == role) else {
                return Err(Error::input(format!(
                    "--gdb {}@{port}: this board is not fitted",
                    role.name()
                )));
            };
            attached.push(Attached {
                place,
                role,
                server: listen(role, port)?,
                session: None,
                begun: false,
            });
        }
        Ok(Self {
            attached,
            interrupt: gdb.interrupt.clone(),
        })
    }

    /// The board stands at its first instruction until its debugger has come.
    pub fn wait(&mut self, place: usize, board: &mut Board) -> Result<(), Error> {
        let Some(attached) = self.attached.iter_mut().find(|a| a.place == place) else {
            return Ok(());
        };
        let failed = |error: GdbError| broken(attached.role, &error);
        let port = attached.server.port().map_err(failed)?;
        eprintln!(
            "{} board: waiting for gdb at port {port}: target remote :{port}",
            attached.role.name()
        );
        while attached.session.is_none() {
            attached.poll(board)?;
            pause(&self.interrupt)?;
        }
        Ok(())
    }

    /// Runs everything to `time`, as far as the debuggers let it.
    pub fn run(&mut self, network: &mut Network, time: Time) -> Result<(), Error> {
        loop {
            network.run_until(time);
            let mut waits = false;
            for attached in &mut self.attached {
                if let Some(board) = network.board(attached.place) {
                    waits |= attached.serve(board)?;
                }
            }
            if waits {
                pause(&self.interrupt)?;
            } else if network.now() >= time {
                return Ok(());
            }
        }
    }
}

impl Attached {
    /// Does what the debugger asks for; gives whether it has the board stopped.
    fn serve(&mut self, board: &mut Board) -> Result<bool, Error> {
        let Some(session) = &mut self.session else {
            self.poll(board)?;
            return Ok(self.session.is_some() || !self.begun);
        };
        match session.serve(board) {
            Ok(Next::Run) => {
                self.begun = true;
                return Ok(false);
            }
            Ok(Next::Wait) => return Ok(true),
            Ok(Next::Gone) => self.begun = true,
            Err(error) => {
                self.drop_client(&error);
                if !self.begun {
                    board.stop();
                }
            }
        }
        self.session = None;
        Ok(!self.begun)
    }

    /// Takes a client that has connected. One that is no gdb is dropped, and the port goes on listening.
    fn poll(&mut self, board: &mut Board) -> Result<(), Error> {
        match self.server.poll(board) {
            Ok(session) => self.session = session,
            Err(error @ GdbError::Port(..)) => return Err(broken(self.role, &error)),
            Err(error) => self.drop_client(&error),
        }
        Ok(())
    }

    fn drop_client(&self, error: &GdbError) {
        let name = self.role.name();
        eprintln!("{name} board: client at the port for gdb dropped: {error}");
    }
}

fn pause(interrupt: &AtomicBool) -> Result<(), Error> {
    if interrupt.load(Relaxed) {
        return Err(Error::Failure("interrupted".to_owned()));
    }
    thread::sleep(PAUSE);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_debugger_has_a_board_and_a_port() {
        assert_eq!(parse("rear@3333").unwrap(), (Role::Rear, 3333));
        for bad in ["rear", "middle@1", "rear@0", "beam@65536", "beam@-1", "@1"] {
            let error = parse(bad).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{bad}");
            assert!(error.to_string().contains(bad), "{error}");
        }
    }
}
