//! The user's button of the front board: press to drive to the goal, press again to stop; after a
//! fault, the first press clears it.

use core_algos::fusion::Estimate;
use core_algos::math::Posture;
use core_algos::node::board::Board;
use core_algos::node::lead::Task;
use core_algos::safety::OperatingState;
use core_algos::time::{EPOCH, Micros, is_epoch_start};
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::peripherals::PA0;

/// Time the button must be down, in epochs: 50 ms.
const HOLD: u8 = 5;
const _: () = assert!(EPOCH == 10_000);

/// The button; high when pressed.
pub struct Button {
    pin: Input<'static>,
    held: u8,
    driving: bool,
    /// Where a drive begins: midpoint, and front axle seen from the rear.
    start: (Estimate, Estimate),
}

impl Button {
    /// On its pin; a press begins a drive at `start`: midpoint, and front axle seen from the rear.
    pub fn new(pin: Peri<'static, PA0>, start: (Estimate, Estimate)) -> Self {
        Self {
            pin: Input::new(pin, Pull::Down),
            held: 0,
            driving: false,
            start,
        }
    }

    /// The nodes began anew: they are idle.
    pub fn forget(&mut self) {
        self.driving = false;
    }

    /// Looks at the button; on the rear board there is no lead node and it does nothing.
    pub fn step(&mut self, now: Micros, board: &mut Board) {
        if !is_epoch_start(now) {
            return;
        }
        self.held = if self.pin.is_high() {
            self.held.saturating_add(1)
        } else {
            0
        };
        let Some(lead) = board.lead() else {
            return;
        };
        if self.held != HOLD {
            return;
        }
        if lead.supervision().operating() == OperatingState::Fault {
            lead.command(Task::Clear);
            self.driving = false;
            return;
        }
        self.driving = !self.driving;
        if self.driving {
            let (center, relative) = &self.start;
            lead.initialize(center, relative);
            lead.command(Task::Regulate {
                goal: Posture::ORIGIN,
            });
        } else {
            lead.command(Task::Stop);
        }
    }
}
