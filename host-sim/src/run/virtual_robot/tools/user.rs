//! The user, after an axle board was restarted: clears the faults and repeats the task. The front board has forgotten where
//! the robot is: the user puts it back on its start first, and a path is lost.

use crate::run::recovery::Monitor;
use crate::run::virtual_robot::{PRESS, VirtualRobot};
use crate::targets::{HostCommand, What};
use core_algos::node::lead::Task;
use core_algos::safety::OperatingState;
use core_algos::topology::{Node, Role};

/// Time after a restart until the user acts, ticks.
const PAUSE: u32 = 1000;
/// Time in which the nodes must become idle after an attempt, ticks.
const CLEARING: u32 = 500;
/// Attempts before the user gives up.
const ATTEMPTS: u32 = 3;

/// Next act of the user.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct User {
    /// Tick of the next look at the robot, and attempts to clear the faults.
    next: Option<(u32, u32)>,
    /// True if the front board was restarted.
    front: bool,
}

impl User {
    /// A board has got its power back.
    pub fn restarted(&mut self, tick: u32, role: Role) {
        if role != Role::Beam {
            self.next = Some((tick + PAUSE, 0));
            self.front |= role == Role::Front;
        }
    }

    /// True if the user will still act.
    pub fn is_waited_for(&self) -> bool {
        self.next.is_some()
    }
}

fn idle(monitor: &Monitor, node: Node) -> bool {
    let status = monitor.latest(node);
    status.is_some_and(|it| it.state == OperatingState::Idle && it.reason.is_none())
}

impl VirtualRobot {
    /// Does what the user does at this tick.
    pub(in crate::run::virtual_robot) fn act_as_user(&mut self) {
        let tick = self.tick as u32;
        let Some((_, attempts)) = self.tools.user.next.filter(|(at, _)| *at == tick) else {
            return;
        };
        let nodes = [Node::Lead, Node::FrontAxle, Node::RearAxle];
        let ready = nodes.iter().all(|node| idle(&self.control.monitor, *node));
        if !ready && attempts == ATTEMPTS {
            self.tools.user.next = None;
            return;
        }
        let task = self.task;
        match (ready, std::mem::take(&mut self.tools.user.front)) {
            (false, front) => {
                self.tools.user.front = front;
                self.link.command(&HostCommand::Task(Task::Clear));
            }
            (true, true) => {
                self.put_back();
                self.link.command(&HostCommand::Place(self.place));
                self.link.command(&HostCommand::Task(task));
            }
            (true, false) => self.link.command(&HostCommand::Task(task)),
        }
        let what = if ready { What::Resumed } else { What::Cleared };
        self.tools.cuts.note(tick, what);
        self.tools.user.next = (!ready).then_some((tick + CLEARING, attempts + 1));
    }

    /// Puts the robot back on its start.
    fn put_back(&mut self) {
        for (turned, axle) in self.turned.iter_mut().zip(&self.plant.state().axle) {
            let [left, right] = axle.motor_angle;
            *turned = [turned[0] + left, turned[1] + right];
        }
        self.plant.place(self.start);
    }

    /// Presses the button of the front board.
    pub(in crate::run::virtual_robot) fn press(&mut self) {
        let now = self.network.now();
        if let Some(front) = self.axle(Role::Front) {
            front.press(true, now);
            front.press(false, now + PRESS);
        }
    }
}
