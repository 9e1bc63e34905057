//! The user's button of the front board: press to drive to the goal, press again to stop; after a
//! fault, the first press clears it.

use core_algos::fusion::Estimate;
use core_algos::math::Posture;
use core_algos::node::board::Board;
use core_algos::node::lead::Task;
use core_algos::time::{Micros, is_epoch_start};
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::peripherals::PA0;

use crate::rules::{Press, Presses};

/// The button; high when pressed.
pub struct Button {
    pin: Input<'static>,
    presses: Presses,
    /// Start of a drive: midpoint, and front axle seen from the rear.
    start: (Estimate, Estimate),
    goal: Posture,
}

impl Button {
    /// On its pin; a press begins a drive to `goal` at `start`: midpoint, and front axle seen from the rear.
    pub fn new(pin: Peri<'static, PA0>, start: (Estimate, Estimate), goal: Posture) -> Self {
        Self {
            pin: Input::new(pin, Pull::Down),
            presses: Presses::default(),
            start,
            goal,
        }
    }

    /// The nodes began anew: they are idle.
    pub fn forget(&mut self) {
        self.presses.forget();
    }

    /// Looks at the button; on the rear board there is no lead node and it does nothing.
    pub fn step(&mut self, now: Micros, board: &mut Board) {
        if !is_epoch_start(now) {
            return;
        }
        let lead = board.lead();
        let faulted = lead.as_ref().map(|lead| lead.is_faulted(now));
        let press = self.presses.step(self.pin.is_high(), faulted);
        let (Some(press), Some(lead)) = (press, lead) else {
            return;
        };
        let task = match press {
            Press::Clear => Task::Clear,
            Press::Stop => Task::Stop,
            Press::Drive => {
                let (center, relative) = &self.start;
                lead.initialize(center, relative);
                Task::Regulate { goal: self.goal }
            }
        };
        lead.command(task);
    }
}
