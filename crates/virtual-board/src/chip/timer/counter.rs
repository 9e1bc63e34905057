//! The counter of a timer; its value is computed from the time.

use crate::time::Cycles;

/// Steps of the counter in one direction, from a turn or restart to the next.
#[derive(Clone, Copy, Debug)]
struct Leg {
    /// Cycle at which the counter was at `from` with the prescaler at zero.
    start: Cycles,
    from: u32,
    /// Steps from `start` to the next turn or restart, at least one.
    length: u64,
    /// True if the counter is above the reload value: it counts to its full width, without an event.
    beyond: bool,
}

/// Event with which the counter turns or restarts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Turn {
    Overflow,
    Underflow,
    /// The counter, which was above the reload value, exceeds its full width.
    Wrap,
}

/// The counter with its prescaler.
#[derive(Clone, Debug)]
pub(super) struct Counter {
    /// Active reload value.
    pub reload: u32,
    /// Active prescaler.
    prescaler: u32,
    /// Core cycles in one cycle of the timer's clock.
    clock: u64,
    /// Core cycles in one step of the counter.
    step: u64,
    /// Largest value of the counter's width.
    max: u32,
    /// True if the counter counts up and down alternately.
    pub centred: bool,
    /// True if the counter counts up.
    pub up: bool,
    /// Value while stopped, and core cycles into the next step.
    value: u32,
    phase: u64,
    leg: Option<Leg>,
}

impl Counter {
    pub fn new(max: u32) -> Self {
        Self {
            reload: max,
            prescaler: 0,
            clock: 1,
            step: 1,
            max,
            centred: false,
            up: true,
            value: 0,
            phase: 0,
            leg: None,
        }
    }

    pub fn clock(&self) -> u64 {
        self.clock
    }

    /// Changes the timer's clock; the elapsed fraction of a step is kept.
    pub fn set_clock(&mut self, clock: u64, now: Cycles) {
        let runs = self.leg.is_some();
        self.stop(now);
        self.phase = self.phase / self.clock * clock;
        self.clock = clock;
        self.set_prescaler(self.prescaler);
        if runs {
            self.start(now);
        }
    }

    /// Activates a prescaler, at the end of a step.
    pub fn set_prescaler(&mut self, prescaler: u32) {
        self.prescaler = prescaler;
        self.step = self.clock * (u64::from(prescaler) + 1);
    }

    /// First edge of the timer's clock at `now` or later.
    pub fn edge(&self, now: Cycles) -> Cycles {
        now.div_ceil(self.clock) * self.clock
    }

    pub fn runs(&self) -> bool {
        self.leg.is_some()
    }

    pub fn value(&self, now: Cycles) -> u32 {
        let Some(leg) = &self.leg else {
            return self.value;
        };
        let steps = (now.saturating_sub(leg.start) / self.step).min(leg.length - 1) as u32;
        if self.up {
            leg.from + steps
        } else {
            leg.from - steps
        }
    }

    /// Starts the counter at its present value.
    pub fn start(&mut self, now: Cycles) {
        let start = now - self.phase.min(now);
        self.begin(self.value, start);
    }

    /// Stops the counter at its present value.
    pub fn stop(&mut self, now: Cycles) {
        if let Some(leg) = &self.leg {
            let passed = now.saturating_sub(leg.start) % self.step;
            (self.value, self.phase) = (self.value(now), passed);
            self.leg = None;
        }
    }

    /// Sets the counter to a value; a running counter continues from there.
    pub fn set(&mut self, value: u32, now: Cycles) {
        let runs = self.leg.is_some();
        self.stop(now);
        self.value = value;
        if runs {
            self.start(now);
        }
    }

    /// Resets counter and prescaler, as an update by software does.
    pub fn clear(&mut self, now: Cycles) {
        if self.centred {
            self.up = true;
        }
        let (runs, from) = (self.runs(), if self.up { 0 } else { self.reload });
        (self.value, self.phase, self.leg) = (from, 0, None);
        if runs {
            self.begin(from, self.edge(now));
        }
    }

    /// Changes reload value, direction or alignment.
    pub fn adapt(&mut self, now: Cycles, change: impl FnOnce(&mut Self)) {
        let runs = self.leg.is_some();
        self.stop(now);
        change(self);
        if runs {
            self.start(now);
        }
    }

    fn begin(&mut self, from: u32, start: Cycles) {
        self.value = from;
        self.leg = None;
        if self.reload == 0 {
            // Manual: a reload value of 0 blocks the counter.
            return;
        }
        if self.centred && (from == 0 || from == self.reload) {
            self.up = from == 0;
        }
        let (from_, reload) = (u64::from(from), u64::from(self.reload));
        let beyond = self.up && from > self.reload;
        let length = match (self.up, self.centred) {
            (true, _) if beyond => u64::from(self.max) - from_ + 1,
            (true, true) => reload - from_,
            (true, false) => reload - from_ + 1,
            (false, true) => from_,
            (false, false) => from_ + 1,
        };
        self.leg = Some(Leg {
            start,
            from,
            length,
            beyond,
        });
    }

    /// Cycle at which the counter next turns or restarts; `None` if the counter is stopped or blocked.
    pub fn end(&self) -> Option<Cycles> {
        let leg = self.leg.as_ref()?;
        Some(leg.start + leg.length * self.step)
    }

    /// Event with which the counter next turns or restarts.
    pub fn turn(&self) -> Turn {
        match (&self.leg, self.up) {
            (Some(Leg { beyond: true, .. }), _) => Turn::Wrap,
            (_, true) => Turn::Overflow,
            (_, false) => Turn::Underflow,
        }
    }

    /// Turns or restarts the counter at cycle `end`, with the active reload value.
    pub fn next_leg(&mut self, turn: Turn, end: Cycles) {
        self.phase = 0;
        let from = match (turn, self.centred) {
            (Turn::Overflow, true) => self.reload,
            (Turn::Underflow, false) => self.reload,
            _ => 0,
        };
        if self.centred {
            self.up = turn != Turn::Overflow;
        }
        self.begin(from, end);
    }

    /// Cycle at which the counter reaches `value`; `None` if it turns or restarts first.
    pub fn meets(&self, value: u32) -> Option<Cycles> {
        let leg = self.leg.as_ref()?;
        let steps = if self.up {
            u64::from(value.checked_sub(leg.from)?)
        } else {
            u64::from(leg.from.checked_sub(value)?)
        };
        (steps < leg.length).then(|| leg.start + steps * self.step)
    }

    /// Skips whole groups of `legs` counts from one turn or restart to the next that have ended by `now`. The present
    /// count must have begun at 0 or at the reload value.
    pub fn skip(&mut self, legs: u64, now: Cycles) {
        if let Some(leg) = &mut self.leg {
            let length = u64::from(self.reload) + u64::from(!self.centred);
            let stretch = legs * length * self.step;
            leg.start += now.saturating_sub(leg.start) / stretch * stretch;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centre_aligned_counter_stays_at_each_end_for_one_step() {
        let mut counter = Counter::new(0xffff);
        (counter.reload, counter.centred) = (6, true);
        counter.start(0);
        // RM0090, figure of a centre-aligned counter with reload value 6.
        let mut values = Vec::new();
        for now in 0..14 {
            if counter.end() == Some(now) {
                counter.next_leg(counter.turn(), now);
            }
            values.push(counter.value(now));
        }
        assert_eq!(values, [0, 1, 2, 3, 4, 5, 6, 5, 4, 3, 2, 1, 0, 1]);
    }

    #[test]
    fn counter_above_its_reload_value_wraps_at_its_width() {
        let mut counter = Counter::new(0xffff);
        counter.set(0xfff0, 0);
        counter.start(0);
        counter.adapt(4, |counter| counter.reload = 100);
        assert_eq!((counter.turn(), counter.end()), (Turn::Wrap, Some(16)));
        counter.next_leg(Turn::Wrap, 16);
        assert_eq!((counter.value(26), counter.end()), (10, Some(117)));
    }

    #[test]
    fn prescaler_phase_is_kept_while_the_counter_is_stopped() {
        let mut counter = Counter::new(0xffff);
        counter.set_prescaler(9);
        counter.start(0);
        counter.stop(25);
        assert_eq!(counter.value(1000), 2);
        counter.start(1000);
        assert_eq!((counter.value(1004), counter.value(1005)), (2, 3));
        // The clock now takes two core cycles; the elapsed half of a step stays half a step.
        counter.set_clock(2, 1010);
        assert_eq!((counter.value(1019), counter.value(1020)), (3, 4));
    }

    #[test]
    fn skipped_stretches_keep_the_value_of_the_counter() {
        let mut counter = Counter::new(0xffff);
        (counter.reload, counter.centred) = (7, true);
        counter.start(0);
        counter.skip(4, 1000);
        // The first 980 cycles are skipped: 35 groups of four counts of 7 cycles.
        assert_eq!((counter.end(), counter.value(983)), (Some(987), 3));
    }
}
