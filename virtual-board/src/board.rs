//! A board: core, chip and what is around it, in time.

use crate::chip::{Cause, Chip, Surroundings};
use crate::core::{Core, Stop, System};
use crate::probe::image::Image;
use crate::time::Time;

/// A reset of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reset {
    /// When.
    pub at: Time,
    /// Why.
    pub cause: Cause,
}

/// A board.
pub struct Board {
    core: Core,
    chip: Chip,
    powered: bool,
    /// The core has locked up: it does nothing until a reset.
    locked: bool,
    resets: Vec<Reset>,
    now: Time,
}

impl Board {
    /// A board without power, its flash erased. Its clocks are fast by `fast_ppb` parts in 10⁹.
    pub fn new(surroundings: Box<dyn Surroundings>, fast_ppb: i64) -> Self {
        Self {
            core: Core::new(),
            chip: Chip::new(surroundings, fast_ppb),
            powered: false,
            locked: false,
            resets: Vec::new(),
            now: Time(0),
        }
    }

    /// Writes an image into the flash, as a debug probe does.
    pub fn flash(&mut self, image: &Image) {
        image.load(self.chip.flash());
    }

    /// Switches the power on or off.
    pub fn power(&mut self, on: bool) {
        if on && !self.powered {
            self.begin(Cause::PowerOn);
        } else if !on && self.powered {
            self.chip.power_off(self.core.cycles());
        }
        self.powered = on;
    }

    /// Whether it has power.
    pub fn is_powered(&self) -> bool {
        self.powered
    }

    /// Pulls the reset pin low for a moment.
    pub fn reset(&mut self) {
        if self.powered {
            self.restart(Cause::Pin);
        }
    }

    /// The core.
    pub fn core(&self) -> &Core {
        &self.core
    }

    /// The core, to be changed by a debugger.
    pub fn core_mut(&mut self) -> &mut Core {
        &mut self.core
    }

    /// The chip around the core.
    pub fn chip(&mut self) -> &mut Chip {
        &mut self.chip
    }

    /// Both, for what steps the core by hand.
    pub fn parts(&mut self) -> (&mut Core, &mut Chip) {
        (&mut self.core, &mut self.chip)
    }

    /// Resets since power came on first, but that one.
    pub fn resets(&self) -> &[Reset] {
        &self.resets
    }

    /// Whether the core has locked up.
    pub fn is_locked_up(&self) -> bool {
        self.locked
    }

    /// The time it has come to.
    pub fn now(&self) -> Time {
        self.now
    }

    fn restart(&mut self, cause: Cause) {
        let at = self.chip.time_of(self.core.cycles());
        self.resets.push(Reset { at, cause });
        self.begin(cause);
    }

    fn begin(&mut self, cause: Cause) {
        self.locked = false;
        self.chip.restart(cause, self.core.cycles());
        self.core.reset(&mut self.chip);
    }

    /// Runs to `time`; the board may end up to an instruction later.
    pub fn run_until(&mut self, time: Time) {
        self.now = time;
        loop {
            // The length of a cycle may have changed on the way.
            let until = self.chip.cycle_of(time);
            let cycle = self.core.cycles();
            if cycle >= until {
                return;
            }
            if !self.powered {
                self.core.add_cycles(until - cycle);
                return;
            }
            if self.chip.is_held() {
                let next = self.chip.advance(cycle, until);
                self.core.add_cycles(next.min(until).max(cycle + 1) - cycle);
            } else if self.core.run(&mut self.chip, until) == Stop::LockUp {
                self.locked = true;
            }
            if let Some(cause) = self.chip.take_reset() {
                self.restart(cause);
            }
        }
    }
}
