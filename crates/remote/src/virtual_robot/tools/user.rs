//! Actions of the host and the user at the robot. A restarted front board has lost the robot's posture: the robot is
//! put back on its start. On a path, the path is lost too, and the run ends.

use crate::virtual_robot::{PRESS_DURATION, VirtualRobot};
use core_algos::node::lead::Task;
use core_algos::topology::Role;
use host_sim::targets::{EventKind, HostCommand};

impl VirtualRobot {
    /// Sends the host's commands that are due in this tick after a restart of a board.
    pub(in crate::virtual_robot) fn recover(&mut self) {
        let tools = &mut self.tools;
        let (tick, restart) = (self.tick as u32, tools.cuts.losses.last_restart());
        let Some(action) = tools.recovery.step(tick, restart, &self.monitor) else {
            return;
        };
        let task = match action {
            EventKind::Cleared => Task::Clear,
            _ => self.task,
        };
        if action == EventKind::Resumed && std::mem::take(&mut tools.lost_place) {
            self.return_to_start();
            self.link.command(&HostCommand::SetPose(self.place));
        }
        self.link.command(&HostCommand::Task(task));
        self.tools.cuts.losses.note(tick, action);
    }

    /// Puts the robot back on its start posture.
    fn return_to_start(&mut self) {
        for (angles, axle) in self.start_angles.iter_mut().zip(self.plant.axles()) {
            let [left, right] = axle.motor_angle;
            *angles = [angles[0] + left, angles[1] + right];
        }
        self.plant.place(self.start);
    }

    /// Presses the button of the front board.
    pub(in crate::virtual_robot) fn press(&mut self) {
        let now = self.network.now();
        if let Some(front) = self.axle(Role::LEAD) {
            front.press(true, now);
            front.press(false, now + PRESS_DURATION);
        }
    }
}
