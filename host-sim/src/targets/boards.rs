//! The boards of one robot in lockstep; boards may fail and restart.
//!
//! # When a board is lost
//!
//! A board that is off sends nothing and gives no torque. The other boards detect the loss by the age of its messages,
//! slow down together and switch their motors off. The run then continues where possible:
//!
//! - **Rear axle restarted**: the robot stays at rest until the host clears the faults and repeats the command. The
//!   lead node detects that the axle's odometry has restarted, and drives on.
//! - **Beam restarted or lost**: the robot drives on, without the beam by odometry alone.
//! - **Front board restarted**: the lead node has lost its estimate of the posture, and no other board stores the
//!   estimate. The run ends with the motors off.
//! - **An axle lost for good**: the run ends, at rest.

use super::losses::{Event, EventKind, Losses};
use super::{BoardTraffic, Fault, HostCommand, Outgoing, Output, Room, Target, TargetReport};
use crate::base::error::Error;
use core_algos::bus::{CanFrame, Message};
use core_algos::link::protocol::Placement;
use core_algos::node::board::Samples;
use core_algos::node::robot::RobotConfig;
use core_algos::time::{Micros, TICK};
use core_algos::topology::{Role, Topology, Wheels};

/// Planned failure of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Failure {
    /// Board that fails.
    pub role: Role,
    /// Time of the failure, ms from the start of the simulation.
    pub at: u32,
    /// Kind of failure.
    pub mode: FailureMode,
}

/// Failure of a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FailureMode {
    /// The host switches the board off.
    #[default]
    Off,
    /// The board ends; the host finds its link closed.
    Crash,
    /// The board stops running and does not answer the host.
    Hang,
}

struct Slot {
    role: Role,
    target: Box<dyn Target>,
    /// False if the board is not fitted or is off.
    on: bool,
    /// Time of the planned restart, ms; `None` if no restart is planned.
    restart_at: Option<u32>,
    /// True if the board does not run and holds its outputs.
    held: bool,
    /// Lag of the board's clock, ticks.
    clock_lag: u32,
    /// Tick that the board expects next.
    next: u32,
    last: Output,
}

impl Slot {
    /// Hands over the samples of a tick. After a gap in its ticks the board first gets the new time.
    fn begin(&mut self, tick: u32, samples: &Samples) -> Result<(), Fault> {
        let tick = tick - self.clock_lag;
        if tick != self.next {
            self.target.resume(tick)?;
        }
        self.next = tick + 1;
        self.target.begin(tick, samples)
    }
}

/// Boards of a robot.
pub struct Boards {
    topology: Topology,
    slots: Vec<Slot>,
    configs: Vec<RobotConfig>,
    failures: Vec<Failure>,
    restart_after: Option<u32>,
    losses: Losses,
    /// Outputs of the latest tick.
    outputs: Vec<Output>,
}

/// Index of the board with the lead node.
const LEAD: usize = 0;

impl Boards {
    /// Starts the boards; without the relative position sensor there is no beam board.
    pub fn start(
        topology: Topology,
        targets: Vec<Box<dyn Target>>,
        configs: Vec<RobotConfig>,
        place: &Placement,
        rps: bool,
    ) -> Result<Self, Error> {
        let slot = |(role, target): (Role, _)| Slot {
            role,
            target,
            on: !role.is_beam() || rps,
            restart_at: None,
            held: false,
            clock_lag: 0,
            next: 0,
            last: Output::default(),
        };
        let mut slots: Vec<_> = topology.boards().zip(targets).map(slot).collect();
        for slot in slots.iter_mut().filter(|slot| slot.on) {
            let place = (slot.role == Role::LEAD).then_some(place);
            slot.target
                .start(&configs[topology.place(slot.role)], 0, place)
                .map_err(|fault| fatal(topology.name(slot.role), fault))?;
        }
        Ok(Self {
            topology,
            slots,
            configs,
            failures: Vec::new(),
            restart_after: None,
            losses: Losses::new(topology),
            outputs: Vec::new(),
        })
    }

    /// Returns the boards in their present state.
    pub fn release(self) -> Vec<Box<dyn Target>> {
        self.slots.into_iter().map(|slot| slot.target).collect()
    }

    /// Plans failures of boards during the run. A lost board restarts `restart_after` ms later, or stays off without
    /// `restart_after`. A board that restarts by itself is started again at the next tick.
    pub fn plan(&mut self, failures: Vec<Failure>, restart_after: Option<u32>) {
        self.failures = failures;
        self.restart_after = restart_after;
    }

    /// Stops a board with its outputs held if `held` is true, else lets the board run. Sets the lag of its clock to
    /// `clock_lag` ticks.
    pub fn hold(&mut self, role: Role, held: bool, clock_lag: u32) -> Result<(), Error> {
        let slot = &mut self.slots[self.topology.place(role)];
        if slot.held != held && slot.on {
            slot.target.halt(held)?;
        }
        (slot.held, slot.clock_lag) = (held, clock_lag);
        Ok(())
    }

    /// Events of the boards since the start.
    pub fn events(&self) -> &[Event] {
        self.losses.events()
    }

    /// Latest restart of an axle board, ms; `None` without a restart.
    pub fn last_restart(&self) -> Option<u32> {
        self.losses.last_restart()
    }

    /// Records an action of the host.
    pub fn note(&mut self, tick: u32, what: EventKind) {
        self.losses.note(tick, what);
    }

    /// Reason that the run must end at `tick`; `None` if the run can continue.
    pub fn end(&self, tick: u32) -> Option<&str> {
        self.losses.end(tick)
    }

    /// Report of each fitted board; with the stack use of boards that are running.
    pub fn reports(&mut self) -> Vec<TargetReport> {
        let mut reports = Vec::new();
        for slot in &mut self.slots {
            let lost = self.losses.has(slot.role);
            if slot.on || slot.restart_at.is_some() || lost {
                let stack = slot.on.then(|| slot.target.stack()).flatten();
                reports.push(TargetReport {
                    stack,
                    ..slot.target.report()
                });
            }
        }
        reports
    }

    /// Traffic of the links since the start.
    pub fn traffic(&self) -> Vec<BoardTraffic> {
        let of = |slot: &Slot| BoardTraffic {
            name: self.topology.name(slot.role),
            on: slot.on,
            traffic: slot.target.traffic(),
        };
        self.slots.iter().map(of).collect()
    }

    /// Sends a command to the lead node; does nothing if the front board is off.
    pub fn command(&mut self, command: &HostCommand) -> Result<(), Error> {
        let front = &mut self.slots[LEAD];
        if !front.on {
            return Ok(());
        }
        match front.target.command(command) {
            // Not an error here: the next tick detects and handles the fault.
            Ok(()) | Err(Fault::Restarted | Fault::Silent(_)) => Ok(()),
            Err(Fault::Fatal(error)) => Err(error),
        }
    }

    /// Free points in the lead node's buffers.
    pub fn room(&mut self) -> Room {
        let front = &mut self.slots[LEAD];
        match front.on {
            true => front.target.room(),
            false => Room {
                path: 0,
                trajectory: 0,
            },
        }
    }

    /// Delivers a message to a board at `now`.
    pub fn receive(&mut self, role: Role, now: Micros, frame: &CanFrame, message: &Message) {
        let slot = &mut self.slots[self.topology.place(role)];
        if slot.on && !slot.held {
            let clock_lag = Micros::from(slot.clock_lag) * TICK;
            slot.target
                .receive(now.saturating_sub(clock_lag), frame, message);
        }
    }

    /// One tick of all boards, in the order of [`Topology::boards`].
    pub fn tick(
        &mut self,
        tick: u32,
        samples: impl IntoIterator<Item = Samples>,
        send: &mut dyn FnMut(Outgoing),
    ) -> Result<&[Output], Error> {
        self.switch(tick)?;
        for (i, samples) in samples.into_iter().enumerate() {
            let slot = &mut self.slots[i];
            if slot.on && !slot.held {
                let begun = slot.begin(tick, &samples);
                self.value_or_loss(i, tick, begun)?;
            }
        }
        self.outputs.clear();
        for i in 0..self.slots.len() {
            let mut output = Output::default();
            let slot = &mut self.slots[i];
            if slot.on && slot.held {
                output = Output {
                    lead: None,
                    ..slot.last
                };
            } else if slot.on {
                let finished = slot.target.finish(send);
                output = self.value_or_loss(i, tick, finished)?.unwrap_or_default();
                self.slots[i].last = output;
            }
            self.outputs.push(output);
        }
        self.record_motors_off(tick);
        Ok(&self.outputs)
    }

    /// Carries out planned failures and restarts.
    fn switch(&mut self, tick: u32) -> Result<(), Error> {
        for i in 0..self.slots.len() {
            let role = self.slots[i].role;
            let due = |failure: &&Failure| failure.role == role && failure.at == tick;
            let failure = self.failures.iter().find(due);
            if let (true, Some(failure)) = (self.slots[i].on, failure) {
                let target = &mut self.slots[i].target;
                match failure.mode {
                    FailureMode::Off => {
                        target.switch_off()?;
                        self.lost(i, tick, "switched off".to_owned(), self.restart_after);
                    }
                    FailureMode::Crash => target.crash()?,
                    FailureMode::Hang => target.halt(true)?,
                }
            }
            if self.slots[i].restart_at == Some(tick) {
                self.slots[i].target.switch_on()?;
                self.restart(i, tick)?;
            }
        }
        Ok(())
    }

    /// Value of a board's answer; `None` if the board gave no answer or restarted, and so was lost. An error if the run
    /// cannot continue.
    fn value_or_loss<T>(
        &mut self,
        i: usize,
        tick: u32,
        result: Result<T, Fault>,
    ) -> Result<Option<T>, Error> {
        match result {
            Ok(value) => Ok(Some(value)),
            Err(Fault::Fatal(error)) => Err(error),
            Err(Fault::Silent(why)) => {
                self.lost(i, tick, why, self.restart_after);
                Ok(None)
            }
            Err(Fault::Restarted) => {
                self.lost(i, tick, "restarted without a command".to_owned(), Some(1));
                self.restart(i, tick + 1)?;
                Ok(None)
            }
        }
    }

    /// Records the loss of a board, which restarts after `restart_after` ms or stays off.
    fn lost(&mut self, i: usize, tick: u32, why: String, restart_after: Option<u32>) {
        let role = self.slots[i].role;
        self.slots[i].on = false;
        self.slots[i].restart_at = restart_after.map(|after| tick + after.max(1));
        self.losses.lost(tick, role, why, restart_after.is_some());
    }

    fn restart(&mut self, i: usize, tick: u32) -> Result<(), Error> {
        let slot = &mut self.slots[i];
        let role = slot.role;
        slot.restart_at = None;
        slot.target
            .start(&self.configs[i], tick, None)
            .map_err(|fault| fatal(self.topology.name(role), fault))?;
        slot.on = true;
        slot.next = tick;
        self.losses.restarted(tick, role);
        if role == Role::LEAD {
            self.losses.lost_estimate(tick);
        }
        Ok(())
    }

    /// Records when all motors are off after the loss of an axle board.
    fn record_motors_off(&mut self, tick: u32) {
        // The output of a lost board is zero torque.
        let mut outputs = self.outputs.iter();
        let off = outputs.all(|output| output.torque_nm == Wheels::both(0.0));
        self.losses.record_motors_off(tick, off);
    }
}

/// Error of a run whose board had this fault during its start.
pub fn fatal(board: &str, fault: Fault) -> Error {
    match fault {
        Fault::Fatal(error) => error,
        Fault::Silent(why) => Error::Failure(format!("{board} board: {why}")),
        Fault::Restarted => Error::Failure(format!("{board} board: restarted during its start")),
    }
}
