//! Instruments of a run, power cuts, and actions of the user.
//!
//! | module | what it holds |
//! |---|---|
//! | [`cuts`] | power cuts of boards at planned times |
//! | [`profile`] | execution time of the boards by function and interrupt |
//! | `user` | actions at the robot: button, recovery after the restart of an axle board |
//!
//! Unused instruments cost no time.

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

/// Instruments of a run: power cuts, recovery, bus traffic.
#[derive(Clone)]
pub(super) struct Tools {
    cuts: Cuts,
    recovery: Recovery,
    /// True if the front board has restarted and lost the robot's posture.
    lost_place: bool,
    /// Number of frames and of failed transmissions of each board on the bus.
    traffic: Vec<Traffic>,
}

impl Tools {
    /// Instruments of a robot that is switched off.
    pub fn new(topology: Topology) -> Self {
        Self {
            cuts: Cuts::new(topology),
            recovery: Recovery::default(),
            lost_place: false,
            traffic: vec![Traffic::default(); topology.board_count()],
        }
    }

    /// Counts a transmission that has ended; true if the frame is intact.
    pub fn count_transmission(&mut self, role: Option<Role>, sending: &Sending) -> bool {
        let intact = sending.error.is_none();
        if let Some(role) = role {
            let traffic = &mut self.traffic[self.cuts.topology.place(role)];
            traffic.frames += u64::from(intact);
            traffic.damaged += u64::from(!intact);
        }
        intact
    }

    /// True if a board has no power.
    pub fn is_off(&self, role: Role) -> bool {
        self.cuts.is_off(role)
    }
}

impl VirtualRobot {
    /// Power cuts and restarts of the boards, times at which all motors were off, and actions of the host.
    pub fn events(&self) -> &[Event] {
        self.tools.cuts.events()
    }

    /// Actions before a tick of the experiment.
    pub(super) fn begin_tick(&mut self) {
        if let Some(pace) = &mut self.control.pace {
            pace.wait();
        }
        self.switch_power();
        self.recover();
    }

    /// Actions after a tick of the experiment.
    pub(super) fn end_tick(&mut self) -> Result<(), Error> {
        self.check_motors_off();
        self.publish();
        self.notify_observers()
    }

    /// Boards with their bus traffic.
    pub(super) fn board_traffic(&self) -> Vec<BoardTraffic> {
        let of = |role: Role| BoardTraffic {
            name: self.topology.name(role),
            on: self.roles.contains(&role) && !self.tools.cuts.is_off(role),
            traffic: Some(self.tools.traffic[self.topology.place(role)]),
        };
        self.topology.boards().map(of).collect()
    }
}
