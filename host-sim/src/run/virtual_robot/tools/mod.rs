//! What looks on while the robot runs, and what is done to its boards' power.
//!
//! | module | what it holds |
//! |---|---|
//! | [`cuts`] | boards switched off and on again at their times |
//! | [`waves`] | pins, interrupts and bus in a file |
//! | [`profile`] | where the boards' time went |
//! | `user` | what the user does after the restart of an axle board |
//!
//! What is not asked for costs nothing.

pub mod cuts;
pub mod profile;
mod user;
pub mod waves;

use super::VirtualRobot;
use crate::base::error::Error;
use crate::run::robot::Robot;
use crate::targets::{BoardTraffic, Event, Traffic};
use core_algos::topology::Role;
use cuts::Cuts;
use std::path::PathBuf;
use virtual_board::Time;
use virtual_board::wire::Record as Sending;
use waves::Waves;

/// Requested instruments.
#[derive(Clone, Debug, Default)]
pub struct Instruments {
    /// File for pins, interrupts and bus.
    pub vcd: Option<PathBuf>,
    /// True if time is counted by instruction, for [`profile`].
    pub profile: bool,
}

/// Instruments.
#[derive(Default)]
pub(super) struct Tools {
    waves: Option<Waves>,
    cuts: Cuts,
    user: user::User,
    /// Frames that each board has put on the bus, and sendings of it that failed.
    traffic: [Traffic; 3],
}

impl Tools {
    /// A sending has ended; gives whether the frame is whole.
    pub fn heard(&mut self, role: Option<Role>, sending: &Sending) -> bool {
        if let Some(waves) = &mut self.waves {
            waves.frame(sending);
        }
        let whole = sending.error.is_none();
        if let Some(role) = role {
            let traffic = &mut self.traffic[role as usize];
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

    /// Puts the instruments at boards that have no power yet.
    pub(super) fn fit(&mut self, instruments: &Instruments) -> Result<(), Error> {
        if instruments.profile {
            for board in self.network.boards() {
                board.core_mut().set_profiling(true);
            }
        }
        if let Some(path) = &instruments.vcd {
            let named = |role: &Role| (role.name(), self.images.of(*role));
            let boards: Vec<_> = self.roles.iter().map(named).collect();
            self.tools.waves = Some(Waves::create(path, &mut self.network, &boards)?);
        }
        Ok(())
    }

    /// Boards and bus to this time.
    pub(super) fn run_until(&mut self, time: Time) -> Result<(), Error> {
        self.network.run_until(time);
        match &mut self.tools.waves {
            Some(waves) => waves.follow(&mut self.network),
            None => Ok(()),
        }
    }

    /// Before a tick of the experiment.
    pub(super) fn begin_tick(&mut self) {
        if let Some(pace) = &mut self.control.pace {
            pace.wait();
        }
        self.switch_power();
        self.act_as_user();
    }

    /// After a tick of the experiment.
    pub(super) fn end_tick(&mut self) -> Result<(), Error> {
        self.watch_power();
        self.publish();
        self.show()
    }

    /// Ends what writes to files by itself; gives the files.
    pub fn close(&mut self) -> Result<Vec<PathBuf>, Error> {
        match self.tools.waves.take() {
            Some(waves) => waves.finish(&mut self.network).map(|path| vec![path]),
            None => Ok(Vec::new()),
        }
    }

    /// The boards, with what they have put on the bus.
    pub(super) fn heard_of_boards(&self) -> Vec<BoardTraffic> {
        let of = |role: Role| BoardTraffic {
            role,
            on: self.roles.contains(&role) && !self.tools.cuts.is_off(role),
            traffic: Some(self.tools.traffic[role as usize]),
        };
        Role::ALL.map(of).to_vec()
    }
}
