//! SysTick timer: counts down, sets its exception pending at 0, and reloads one tick later.
//!
//! The counter is not stepped: its value is computed from the cycle.

use crate::time::{Cycles, NEVER};

const ENABLE: u32 = 1;
const TICKINT: u32 = 2;
const CLKSOURCE: u32 = 4;
const COUNTFLAG: u32 = 1 << 16;
const MASK: u32 = 0xff_ffff;

/// TENMS is not 10 ms (SKEW): 18 750 is 1 ms of HCLK/8 at 150 MHz (RM0090, 12.1.2).
const CALIBRATION: u32 = 0x4000_493e;

#[derive(Clone, Debug, Default)]
pub(super) struct SysTick {
    control: u32,
    reload: u32,
    /// Counter value at tick number `tick`.
    value: u32,
    tick: u64,
    flag: bool,
    /// Cycle at which the counter next reaches 0; `None` if it never does.
    zero: Option<Cycles>,
}

impl SysTick {
    /// Clock ticks up to a cycle; HCLK/8 ticks at every eighth cycle.
    fn ticks(&self, cycle: Cycles) -> u64 {
        if self.control & CLKSOURCE != 0 {
            cycle
        } else {
            cycle / 8
        }
    }

    fn cycle_of(&self, tick: u64) -> Cycles {
        if self.control & CLKSOURCE != 0 {
            tick
        } else {
            tick * 8
        }
    }

    fn value_at(&self, cycle: Cycles) -> u32 {
        if self.control & ENABLE == 0 {
            return self.value;
        }
        let gone = self.ticks(cycle) - self.tick;
        let value = u64::from(self.value);
        if gone <= value {
            return (value - gone) as u32;
        }
        let period = u64::from(self.reload) + 1;
        self.reload - ((gone - value - 1) % period) as u32
    }

    /// Moves the reference point of value and tick to this cycle.
    fn rebase(&mut self, cycle: Cycles) {
        self.value = self.value_at(cycle);
        self.tick = self.ticks(cycle);
    }

    fn schedule(&mut self) {
        self.zero = if self.control & ENABLE == 0 {
            None
        } else if self.value > 0 {
            Some(self.cycle_of(self.tick + u64::from(self.value)))
        } else if self.reload > 0 {
            Some(self.cycle_of(self.tick + 1 + u64::from(self.reload)))
        } else {
            None
        };
    }

    /// Cycle at which the counter next reaches 0; `NEVER` if it never does.
    pub(super) fn deadline(&self) -> Cycles {
        self.zero.unwrap_or(NEVER)
    }

    /// Handles the zeros up to this cycle; true if the exception becomes pending.
    pub(super) fn advance(&mut self, cycle: Cycles) -> bool {
        let Some(zero) = self.zero.filter(|&zero| zero <= cycle) else {
            return false;
        };
        self.flag = true;
        // The counter may have reached 0 several times since, so its value is computed from the first time.
        self.value = 0;
        self.tick = self.ticks(zero);
        self.rebase(cycle);
        self.schedule();
        self.control & TICKINT != 0
    }

    /// Reads a register by its offset from 0xE000_E010; `advance` must have been called.
    pub(super) fn read(&mut self, offset: u32, cycle: Cycles) -> u32 {
        match offset {
            0 => {
                let flag = if self.flag { COUNTFLAG } else { 0 };
                self.flag = false;
                self.control | flag
            }
            4 => self.reload,
            8 => self.value_at(cycle),
            _ => CALIBRATION,
        }
    }

    /// Writes a register by its offset; `advance` must have been called.
    pub(super) fn write(&mut self, offset: u32, value: u32, cycle: Cycles) {
        self.rebase(cycle);
        match offset {
            0 => {
                self.control = value & (ENABLE | TICKINT | CLKSOURCE);
                self.tick = self.ticks(cycle);
            }
            4 => self.reload = value & MASK,
            8 => {
                self.value = 0;
                self.flag = false;
            }
            _ => {}
        }
        self.schedule();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference counter, stepped tick by tick.
    struct Stepped {
        value: u32,
        reload: u32,
    }

    impl Stepped {
        fn tick(&mut self) -> bool {
            if self.value == 0 {
                self.value = self.reload;
                return false;
            }
            self.value -= 1;
            self.value == 0
        }
    }

    #[test]
    fn counter_matches_a_stepped_counter_through_reloads() {
        for source in [CLKSOURCE, 0] {
            let mut timer = SysTick::default();
            let mut stepped = Stepped {
                value: 0,
                reload: 6,
            };
            timer.write(4, 6, 0);
            timer.write(0, ENABLE | TICKINT | source, 0);
            for cycle in 1..4000u64 {
                let ticks = source != 0 || cycle % 8 == 0;
                let expected = ticks && stepped.tick();
                assert_eq!(timer.advance(cycle), expected, "cycle {cycle}");
                assert_eq!(timer.read(8, cycle), stepped.value, "cycle {cycle}");
                match cycle {
                    777 => {
                        timer.write(4, 3, cycle);
                        stepped.reload = 3;
                    }
                    1500 => {
                        timer.write(8, 99, cycle);
                        stepped.value = 0;
                    }
                    2000 => {
                        timer.write(4, 10, cycle);
                        stepped.reload = 10;
                    }
                    _ => {}
                }
            }
        }
    }

    #[test]
    fn late_advance_counts_one_zero_and_keeps_the_phase() {
        let mut timer = SysTick::default();
        timer.write(4, 99, 0);
        timer.write(0, ENABLE | TICKINT | CLKSOURCE, 0);
        assert_eq!(timer.deadline(), 100);
        assert!(timer.advance(350));
        assert_eq!(timer.read(0, 350) & COUNTFLAG, COUNTFLAG);
        assert_eq!(timer.read(0, 350) & COUNTFLAG, 0);
        assert_eq!(timer.read(8, 350), 50);
        assert_eq!(timer.deadline(), 400);
    }

    #[test]
    fn reload_of_zero_stops_the_counter_at_zero() {
        let mut timer = SysTick::default();
        timer.write(4, 5, 0);
        timer.write(0, ENABLE | TICKINT | CLKSOURCE, 0);
        timer.write(4, 0, 2);
        assert!(timer.advance(6));
        assert_eq!(timer.deadline(), NEVER);
        assert_eq!(timer.read(8, 100), 0);
    }
}
