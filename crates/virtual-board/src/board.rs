//! A board: core, chip and what is around it, in time.

use crate::chip::{Cause, Chip, Circuit};
#[cfg(feature = "gdb")]
use crate::core::WatchAccess;
use crate::core::{Core, Stop, System};
use crate::image::Image;
use crate::time::{Cycles, Time};

/// A reset of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reset {
    /// When.
    pub at: Time,
    /// Why.
    pub cause: Cause,
}

/// Breakpoints and requests of the debugger gdb.
#[cfg(feature = "gdb")]
#[derive(Clone, Debug, Default)]
pub(crate) struct Gdb {
    pub breakpoints: Vec<u32>,
    pub watchpoints: Vec<(u32, u32, WatchAccess)>,
    /// Registers of peripherals may be read and written.
    pub peripherals: bool,
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
    /// Why a debugger has it stand still, and time with it.
    stopped: Option<Stop>,
    /// One instruction, then it stops.
    steps: bool,
    /// The core stands still while time goes on.
    held: bool,
    #[cfg(feature = "gdb")]
    pub(crate) gdb: Gdb,
}

impl Board {
    /// A board without power, its flash erased. Its clocks are fast by `fast_ppb` parts in 10⁹.
    pub fn new(circuit: Box<dyn Circuit>, fast_ppb: i64) -> Self {
        Self {
            core: Core::new(),
            chip: Chip::new(circuit, fast_ppb),
            powered: false,
            locked: false,
            resets: Vec::new(),
            now: Time(0),
            stopped: None,
            steps: false,
            held: false,
            #[cfg(feature = "gdb")]
            gdb: Default::default(),
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

    /// A debugger stops it at the instruction that it has come to: [`Self::run_until`] does nothing
    /// until [`Self::resume`].
    pub fn stop(&mut self) {
        self.stopped.get_or_insert(Stop::Until);
    }

    /// Why it was stopped: by a breakpoint, a watchpoint, after a step, or from outside
    /// ([`Stop::Until`]).
    pub fn stopped(&self) -> Option<Stop> {
        self.stopped
    }

    /// Goes on after a stop, for one instruction if `step`.
    pub fn resume(&mut self, step: bool) {
        (self.stopped, self.steps) = (None, step);
    }

    /// The core stands still while time and the chip go on, as under a debug probe, until told to go on.
    pub fn hold(&mut self, held: bool) {
        self.held = held;
        self.chip.halt(held, self.core.cycles());
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

    /// Runs to `time`; the board may end up to an instruction later, or earlier where a debugger stops
    /// it.
    pub fn run_until(&mut self, time: Time) {
        while self.stopped.is_none() {
            // The length of a cycle may have changed on the way.
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
                // It may have been let go just now.
                if self.chip.is_held() {
                    self.core.add_cycles(next.min(until).max(cycle + 1) - cycle);
                }
            } else if self.held {
                self.core.stand_still(&mut self.chip, until);
            } else {
                self.execute(until);
            }
            if let Some(cause) = self.chip.take_reset() {
                self.restart(cause);
            }
        }
        self.now = self.chip.time_of(self.core.cycles());
    }

    fn execute(&mut self, until: Cycles) {
        let stop = if self.steps {
            self.core.step(&mut self.chip, until)
        } else {
            self.core.run(&mut self.chip, until)
        };
        match stop {
            Stop::LockUp => {
                self.locked = true;
                self.stopped = self.core.debugger_attached().then_some(stop);
            }
            Stop::Breakpoint(_) | Stop::Watchpoint { .. } | Stop::Step => {
                self.stopped = Some(stop);
            }
            Stop::Until | Stop::Reset => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::Bare;
    use crate::image::tests::Builder;

    /// `1: adds r0, #1; b 1b`.
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
    fn a_held_core_stands_still_while_time_goes_on() {
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
        // It goes on as fast as before.
        let after = board.core().register(0);
        assert!(
            (after - before).abs_diff(before - first) <= 2,
            "{before} {after}"
        );
    }

    #[test]
    fn for_a_stopped_board_time_stands_still() {
        let mut board = counting();
        board.run_until(ms(10));
        board.stop();
        board.run_until(ms(20));
        assert_eq!(board.stopped(), Some(Stop::Until));
        assert!(board.now() < ms(10) + Time::from_micros(1));
        board.resume(true);
        let pc = board.core().pc();
        board.run_until(ms(20));
        assert_eq!(board.stopped(), Some(Stop::Step));
        assert!(board.core().pc() != pc && board.now() < ms(10) + Time::from_micros(1));
        board.resume(false);
        board.run_until(ms(20));
        assert_eq!((board.stopped(), board.now()), (None, ms(20)));
    }

    #[test]
    fn without_power_time_goes_on_and_nothing_happens() {
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

    /// 16 MHz and three cycles a round: what runs from 1.5 ms on.
    #[test]
    fn the_core_runs_from_the_moment_at_which_the_reset_is_let_go() {
        let mut board = counting();
        board.run_until(ms(10));
        let rounds = board.core().register(0);
        assert!(rounds.abs_diff(8_500 * 16 / 3) <= 4, "{rounds}");
    }
}
