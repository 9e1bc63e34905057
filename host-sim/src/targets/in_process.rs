//! Board whose nodes are called directly.

use super::{Fault, HostCommand, Outgoing, Output, Room, Target, TargetReport};
use crate::base::error::Error;
use crate::scenario::own::{Own, Parts};
use core_algos::bus::{CanFrame, Message};
use core_algos::link::protocol::Placement;
use core_algos::node::Outbox;
use core_algos::node::board::{Board, Samples};
use core_algos::node::lead::LeadNode;
use core_algos::node::robot::RobotConfig;
use core_algos::time::{Micros, TICK};
use core_algos::topology::{Role, Topology};

/// Board whose nodes run in this process.
pub struct InProcess {
    role: Role,
    name: &'static str,
    board: Option<Board>,
    tick: Option<(u32, Samples)>,
    outbox: Outbox,
    own: Parts,
}

impl InProcess {
    /// Board that has not been started.
    pub fn new(topology: Topology, role: Role) -> Self {
        Self {
            role,
            name: topology.name(role),
            board: None,
            tick: None,
            outbox: Outbox::new(),
            own: Parts::default(),
        }
    }

    /// Board that has not been started; the lead node uses the parts of the user.
    pub fn with_own(topology: Topology, role: Role, own: &Own) -> Self {
        let own = match role {
            Role::LEAD => own.make(),
            _ => Parts::default(),
        };
        Self {
            own,
            ..Self::new(topology, role)
        }
    }

    /// Fault that a board reports while its supply is off.
    fn off(name: &str) -> Fault {
        Fault::Silent(format!("{name} board is off"))
    }

    fn lead(&mut self) -> Option<&mut LeadNode> {
        self.board.as_mut().and_then(Board::lead)
    }
}

impl Target for InProcess {
    fn start(
        &mut self,
        config: &RobotConfig,
        _tick: u32,
        place: Option<&Placement>,
    ) -> Result<(), Fault> {
        self.board = Some(Board::new(config, self.role).map_err(Error::from)?);
        if let (Some(lead), Some(place)) = (self.lead(), place) {
            lead.initialize(place);
        }
        Ok(())
    }

    fn command(&mut self, command: &HostCommand) -> Result<(), Fault> {
        let name = self.name;
        let lead = self.lead().ok_or_else(|| Self::off(name))?;
        let mut orders = command.orders().into_iter();
        let refused = |error| Error::input(format!("{}: {error}", command.subject()));
        Ok(orders
            .try_for_each(|order| order.execute(lead))
            .map_err(refused)?)
    }

    fn room(&mut self) -> Room {
        let task = self.lead().map(LeadNode::path_task);
        Room {
            path: task.as_ref().map_or(0, |task| task.path_room()),
            trajectory: task.map_or(0, |task| task.trajectory_room()),
        }
    }

    fn receive(&mut self, now: Micros, _frame: &CanFrame, message: &Message) {
        if let Some(board) = &mut self.board {
            board.receive(now, message);
        }
    }

    fn begin(&mut self, tick: u32, samples: &Samples) -> Result<(), Fault> {
        self.tick = Some((tick, *samples));
        Ok(())
    }

    fn finish(&mut self, send: &mut dyn FnMut(Outgoing)) -> Result<Output, Fault> {
        let (Some(board), Some((tick, samples))) = (&mut self.board, self.tick.take()) else {
            return Err(Self::off(self.name));
        };
        self.outbox.clear();
        let now = Micros::from(tick) * TICK;
        let output = board.step_with(now, &samples, &mut self.outbox, &mut self.own.lend());
        for message in self.outbox.iter() {
            send(Outgoing::Message(message));
        }
        Ok(Output {
            torque_nm: output.torque_nm,
            lead: output.lead,
        })
    }

    fn switch_off(&mut self) -> Result<(), Error> {
        self.board = None;
        Ok(())
    }

    fn switch_on(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn report(&self) -> TargetReport {
        TargetReport {
            role: self.name,
            target: "in process",
            build: env!("CARGO_PKG_VERSION").to_owned(),
            frames: 0,
            lost: 0,
            damaged: 0,
            sent_per_tick: 0.0,
            received_per_tick: 0.0,
            latency: None,
            stack: None,
        }
    }
}
