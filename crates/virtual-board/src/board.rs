//! A board in time: core, chip and the circuit around the chip.

use crate::chip::{Cause, Chip, Circuit};
use crate::core::{Core, Stop, System};
use crate::image::Image;
use crate::time::Time;

/// A reset of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reset {
    /// Time of the reset.
    pub at: Time,
    /// Cause of the reset.
    pub cause: Cause,
}

/// A board: core, chip and circuit, run to given times.
#[derive(Clone)]
pub struct Board {
    core: Core,
    chip: Chip,
    powered: bool,
    /// True if the core has locked up since the latest reset.
    locked: bool,
    resets: Vec<Reset>,
    now: Time,
    /// True if the core is held while time continues.
    held: bool,
}

impl Board {
    /// Creates a board without power and with an erased flash. Its clocks run `fast_ppb` parts in 10⁹ too fast.
    pub fn new(circuit: Box<dyn Circuit>, fast_ppb: i64) -> Self {
        Self {
            core: Core::new(),
            chip: Chip::new(circuit, fast_ppb),
            powered: false,
            locked: false,
            resets: Vec::new(),
            now: Time(0),
            held: false,
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

    /// Pulls the reset pin low for a moment.
    pub fn reset(&mut self) {
        if self.powered {
            self.restart(Cause::Pin);
        }
    }

    /// The core, to read registers and counters.
    pub fn core(&self) -> &Core {
        &self.core
    }

    /// The core, for changes by a debugger.
    pub fn core_mut(&mut self) -> &mut Core {
        &mut self.core
    }

    /// The chip around the core.
    pub fn chip(&mut self) -> &mut Chip {
        &mut self.chip
    }

    /// Core and chip, for callers that step the core directly.
    pub fn parts(&mut self) -> (&mut Core, &mut Chip) {
        (&mut self.core, &mut self.chip)
    }

    /// Resets after the first power-on.
    pub fn resets(&self) -> &[Reset] {
        &self.resets
    }

    /// Holds or resumes the core, as a debug probe does. Time and chip continue.
    pub fn hold(&mut self, held: bool) {
        self.held = held;
        self.chip.halt(held, self.core.cycles());
    }

    /// Time reached so far.
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

    /// Runs to `time`; the core may be up to an instruction ahead.
    pub fn run_until(&mut self, time: Time) {
        loop {
            // Computed again in each turn, because the program may have changed the length of a cycle.
            let until = self.chip.cycle_of(time);
            let cycle = self.core.cycles();
            if cycle >= until {
                self.now = time;
                return;
            }
            if !self.powered {
                self.core.add_cycles(until - cycle);
                continue;
            }
            if self.chip.is_held() {
                let next = self.chip.advance(cycle, until);
                // `advance` may have released the core from reset.
                if self.chip.is_held() {
                    self.core.add_cycles(next.min(until).max(cycle + 1) - cycle);
                }
            } else if self.held {
                self.core.stand_still(&mut self.chip, until);
            } else {
                let stop = self.core.run(&mut self.chip, until);
                self.locked |= stop == Stop::LockUp;
            }
            if let Some(cause) = self.chip.take_reset() {
                self.restart(cause);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::Bare;
    use crate::image::tests::Builder;

    /// A board that runs `1: adds r0, #1; b 1b`.
    fn counting() -> Board {
        let mut board = Board::new(Box::new(Bare), 0);
        board.flash(&Builder::new(&[0x40, 0x1c, 0xfd, 0xe7]).image());
        board.power(true);
        board
    }

    const fn ms(count: u64) -> Time {
        Time::from_micros(1000 * count)
    }

    #[test]
    fn held_core_stops_while_time_continues() {
        let mut board = counting();
        board.run_until(ms(2));
        let first = board.core().register(0);
        board.run_until(ms(10));
        let before = board.core().register(0);
        board.hold(true);
        board.run_until(ms(20));
        assert_eq!(board.core().register(0), before);
        assert_eq!(board.core().cycles(), board.chip().cycle_of(ms(20)));
        board.hold(false);
        board.run_until(ms(28));
        // `then` and `now` are the core's increments in 8 ms before the hold and in 8 ms after it.
        let (then, now) = (before - first, board.core().register(0) - before);
        assert!(now.abs_diff(then) <= 2, "{then} {now}");
    }

    #[test]
    fn unpowered_board_executes_nothing_while_time_continues() {
        let mut board = counting();
        board.power(false);
        board.run_until(ms(5));
        assert_eq!(board.now(), ms(5));
        board.power(true);
        board.run_until(ms(6));
        assert_eq!(board.core().register(0), 0, "still in reset");
        board.run_until(ms(7));
        assert!(board.core().register(0) > 1000);
    }

    /// The reset is released at 1.5 ms; the loop then takes three cycles per iteration at 16 MHz.
    #[test]
    fn core_runs_from_the_release_of_the_reset() {
        let mut board = counting();
        board.run_until(ms(10));
        let rounds = board.core().register(0);
        assert!(rounds.abs_diff(8_500 * 16 / 3) <= 4, "{rounds}");
    }
}
