//! The user, after an axle board was restarted: clears the faults by the button, puts the robot back on its start and
//! presses the button again.

use crate::base::error::Error;
use crate::run::recovery::Monitor;
use crate::run::robot::Robot;
use crate::run::virtual_robot::{PRESS, VirtualRobot};
use crate::targets::What;
use core_algos::link::framing::Decoder;
use core_algos::link::protocol::{self, Reply, Request};
use core_algos::safety::OperatingState;
use core_algos::topology::{Node, Role};

/// Time after a restart until the user acts, ticks.
const PAUSE: u32 = 1000;
/// Time in which the nodes must become idle after a press, ticks.
const CLEARING: u32 = 500;
/// Time in which a board answers at its serial port, ticks.
const ANSWER: u32 = 100;
/// Presses before the user gives up.
const PRESSES: u32 = 3;

/// Next act of the user.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct User {
    /// Tick of the next look at the robot, and how often the button was pressed.
    next: Option<(u32, u32)>,
}

impl User {
    /// A board has got its power back.
    pub fn restarted(&mut self, tick: u32, role: Role) {
        if role != Role::Beam {
            self.next = Some((tick + PAUSE, 0));
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
        let Some((_, presses)) = self.tools.user.next.filter(|(at, _)| *at == tick) else {
            return;
        };
        let nodes = [Node::Lead, Node::FrontAxle, Node::RearAxle];
        let ready = nodes.iter().all(|node| idle(&self.monitor, *node));
        if !ready && presses == PRESSES {
            self.tools.user.next = None;
            return;
        }
        if ready {
            for (turned, axle) in self.turned.iter_mut().zip(&self.plant.state().axle) {
                let [left, right] = axle.motor_angle;
                *turned = [turned[0] + left, turned[1] + right];
            }
            self.plant.place(self.start);
        }
        self.press();
        let what = if ready { What::Resumed } else { What::Cleared };
        self.tools.cuts.note(tick, what);
        self.tools.user.next = (!ready).then_some((tick + CLEARING, presses + 1));
    }

    /// Sends a request to an axle board's serial port and runs until the answer has come; the answer is read by `take`.
    /// `None` if there is none within 0.1 s, or it is of another number.
    pub fn ask<T>(
        &mut self,
        role: Role,
        (number, request): (u8, &Request),
        take: impl FnOnce(Reply) -> T,
    ) -> Result<Option<T>, Error> {
        let now = self.network.now();
        let frame = protocol::encode(number, request);
        let (Some(frame), Some(axle)) = (frame, self.axle(role)) else {
            return Ok(None);
        };
        axle.serial.sent.clear();
        axle.serial.send(frame.bytes(), now);
        for _ in 0..ANSWER {
            self.step()?;
            let mut decoder = Decoder::new();
            let sent = self.axle(role).map(|axle| axle.serial.sent.clone());
            for byte in sent.unwrap_or_default() {
                let answer = decoder.take_byte(byte).and_then(protocol::decode::<Reply>);
                if let Some((answered, reply)) = answer {
                    return Ok((answered == number).then(|| take(reply)));
                }
            }
        }
        Ok(None)
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
