//! Power cuts of boards during a run.

use crate::virtual_robot::VirtualRobot;
use core_algos::topology::{Role, Topology};
use host_sim::targets::{Event, Failure, Losses};

/// Planned and past power cuts of the boards.
#[derive(Clone)]
pub(super) struct Cuts {
    pub topology: Topology,
    failures: Vec<Failure>,
    restart_after: Option<u32>,
    /// Time at which each board's power returns, ms; `None` while no return is planned.
    restart_at: Vec<Option<u32>>,
    off: Vec<bool>,
    pub losses: Losses,
}

impl Cuts {
    /// No cuts; all boards have power.
    pub fn new(topology: Topology) -> Self {
        Self {
            topology,
            failures: Vec::new(),
            restart_after: None,
            restart_at: vec![None; topology.board_count()],
            off: vec![false; topology.board_count()],
            losses: Losses::new(topology),
        }
    }

    pub fn events(&self) -> &[Event] {
        self.losses.events()
    }

    pub fn is_off(&self, role: Role) -> bool {
        self.off[self.topology.place(role)]
    }
}

impl VirtualRobot {
    /// Plans power cuts; the power returns after `restart_after` ms, or never if `None`.
    pub fn plan(&mut self, failures: Vec<Failure>, restart_after: Option<u32>) {
        let cuts = &mut self.tools.cuts;
        (cuts.failures, cuts.restart_after) = (failures, restart_after);
    }

    /// Switches the power of boards off and on at the planned times.
    pub(super) fn switch_power(&mut self) {
        let tick = self.tick as u32;
        let mut restarted = Vec::new();
        let cuts = &mut self.tools.cuts;
        for (place, &role) in self.roles.iter().enumerate() {
            let k = cuts.topology.place(role);
            let due = |failure: &Failure| failure.role == role && failure.at == tick;
            let Some(board) = self.network.board(place) else {
                continue;
            };
            if !cuts.off[k] && cuts.failures.iter().any(due) {
                board.power(false);
                let why = "switched off".to_owned();
                let observers = self.control.observers.iter_mut();
                observers.for_each(|observer| observer.off(role, tick, &why));
                let back = cuts.restart_after.map(|after| tick + after.max(1));
                (cuts.off[k], cuts.restart_at[k]) = (true, back);
                cuts.losses.lost(tick, role, why, back.is_some());
            }
            if cuts.restart_at[k] == Some(tick) {
                board.power(true);
                (cuts.off[k], cuts.restart_at[k]) = (false, None);
                cuts.losses.restarted(tick, role);
                restarted.push(role);
                if role == Role::LEAD {
                    self.tools.lost_place = true;
                    let path = self.task.is_on_path();
                    self.failure = path.then(|| {
                        "the front board was restarted: its path and its posture are lost"
                            .to_owned()
                    });
                }
            }
        }
        // A restart closes the board's link to the host.
        for role in restarted {
            self.open_link(role);
        }
    }

    /// True if a board's power will return, or an action of the host after a restart is due.
    pub(in crate::virtual_robot) fn restart_pending(&self) -> bool {
        self.tools.recovery.is_pending() || self.tools.cuts.restart_at.iter().any(Option::is_some)
    }

    /// Records whether the motors are off after a power cut. Ends the run if a lost board demands it.
    pub(super) fn check_motors_off(&mut self) {
        if self.tools.cuts.losses.events().is_empty() {
            return;
        }
        let (tick, now) = (self.tick as u32, self.network.now());
        // A motor braked by a short circuit counts as off.
        let mut axles = self.topology.axles().map(Role::Axle);
        let off = axles.all(|role| {
            let on = !self.tools.cuts.is_off(role);
            !on || self.axle(role).is_none_or(|axle| !axle.is_driven(now))
        });
        let cuts = &mut self.tools.cuts;
        cuts.losses.record_motors_off(tick, off);
        if let Some(why) = cuts.losses.end(tick) {
            self.failure.get_or_insert_with(|| why.to_owned());
        }
    }
}
