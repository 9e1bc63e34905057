//! The user's button of the front board: stops a moving robot, clears a fault, or starts a drive.

use core_algos::link::Order;
use core_algos::link::protocol::Placement;
use core_algos::node::board::Board;
use core_algos::node::lead::Task;
use core_algos::params::{self, Press};
use core_algos::time::{Micros, is_epoch_start};
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::peripherals::PA0;
use firmware_common::link::TickEnd;

use crate::rules::{Presses, task_of_press};

/// The button; high when pressed.
pub struct Button {
    pin: Input<'static>,
    presses: Presses,
    /// Posture that a drive starts from if the lead node has no estimate, or by [`Press::StartAndGoal`].
    start: Placement,
    settings: params::Button,
}

impl Button {
    /// Button on its pin. A drive begins at `start` if the lead node has no estimate, or by [`Press::StartAndGoal`].
    pub fn new(pin: Peri<'static, PA0>, start: Placement, settings: params::Button) -> Self {
        Self {
            pin: Input::new(pin, Pull::Down),
            presses: Presses::default(),
            start,
            settings,
        }
    }

    /// Samples the button once an epoch and executes the orders of a press. Without a lead node, on the rear board, a
    /// press has no effect.
    pub fn step(&mut self, now: Micros, board: &mut Board, link: &mut TickEnd) {
        if !is_epoch_start(now) || !self.presses.step(self.pin.is_high()) {
            return;
        }
        let Some(lead) = board.lead() else {
            return;
        };
        let task = task_of_press(lead.activity(now), &self.settings, lead.latest_goal());
        let placed = lead.fusion().is_some() && self.settings.action != Press::StartAndGoal;
        let begins = !placed && matches!(task, Some(Task::Regulate { .. }));
        let place = begins.then_some(Order::SetPose(self.start));
        for order in [place, task.map(Order::Task)].into_iter().flatten() {
            link.execute(order, lead);
        }
    }
}
