//! What looks on while the robot runs, and what is done to its boards' power.
//!
//! | module | what it holds |
//! |---|---|
//! | [`cuts`] | boards switched off and on again at their times |
//! | [`profile`] | where the boards' time went |
//! | `user` | what is done at the robot: button, recovery after the restart of an axle board |
//!
//! What is not asked for costs nothing.

pub mod cuts;
pub mod profile;
mod user;

use super::VirtualRobot;
use core_algos::topology::{Role, Topology};
use cuts::Cuts;
use host_sim::base::error::Error;
use host_sim::run::recovery::Recovery;
use host_sim::run::robot::Robot;
use host_sim::targets::{BoardTraffic, Event, Traffic};
use virtual_board::wire::Record as Sending;

/// Instruments.
#[derive(Clone)]
pub(super) struct Tools {
    cuts: Cuts,
    recovery: Recovery,
    /// True if the front board was restarted, and has forgotten the robot's place.
    moved: bool,
    /// Frames that each board has put on the bus, and sendings of it that failed.
    traffic: Vec<Traffic>,
}

impl Tools {
    /// Instruments of a robot without power.
    pub fn new(topology: Topology) -> Self {
        Self {
            cuts: Cuts::new(topology),
            recovery: Recovery::default(),
            moved: false,
            traffic: vec![Traffic::default(); topology.board_count()],
        }
    }

    /// A sending has ended; gives whether the frame is whole.
    pub fn heard(&mut self, role: Option<Role>, sending: &Sending) -> bool {
        let whole = sending.error.is_none();
        if let Some(role) = role {
            let traffic = &mut self.traffic[self.cuts.topology.place(role)];
            traffic.frames += u64::from(whole);
            traffic.damaged += u64::from(!whole);
        }
        whole
    }

    /// True if a board has no power.
    pub fn is_off(&self, role: Role) -> bool {
        self.cuts.is_off(role)
    }
}

impl VirtualRobot {
    /// Events of the boards' power.
    pub fn events(&self) -> &[Event] {
        self.tools.cuts.events()
    }

    /// Before a tick of the experiment.
    pub(super) fn begin_tick(&mut self) {
        if let Some(pace) = &mut self.control.pace {
            pace.wait();
        }
        self.switch_power();
        self.recover();
    }

    /// After a tick of the experiment.
    pub(super) fn end_tick(&mut self) -> Result<(), Error> {
        self.watch_power();
        self.publish();
        self.show()
    }

    /// The boards, with what they have put on the bus.
    pub(super) fn heard_of_boards(&self) -> Vec<BoardTraffic> {
        let of = |role: Role| BoardTraffic {
            name: self.topology.name(role),
            on: self.roles.contains(&role) && !self.tools.cuts.is_off(role),
            traffic: Some(self.tools.traffic[self.topology.place(role)]),
        };
        self.topology.boards().map(of).collect()
    }
}
