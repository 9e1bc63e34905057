//! The counter of a timer: where it stands follows from the time.

use crate::time::Cycles;

/// A stretch of counting in one direction, up to the step at which the counter turns or begins anew.
#[derive(Clone, Copy, Debug)]
struct Leg {
    /// When the counter stood at `from`, its prescaler at zero.
    start: Cycles,
    from: u32,
    /// Steps until the leg ends; at least one.
    length: u64,
    /// The counter was beyond the reload value and runs over at its full width, without an event.
    beyond: bool,
}

/// How a leg ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Turn {
    Overflow,
    Underflow,
    /// At the full width of a counter that was beyond the reload value.
    Wrap,
}

/// The counter with its prescaler.
#[derive(Clone, Debug)]
pub(super) struct Counter {
    /// Reload value in force.
    pub reload: u32,
    /// Prescaler in force.
    prescaler: u32,
    /// Cycles of the core in one of the timer's clock.
    clock: u64,
    /// Cycles of the core in one step.
    step: u64,
    /// The largest value of the counter's width.
    most: u32,
    /// Whether it counts up and down in turn.
    pub centred: bool,
    /// Direction.
    pub up: bool,
    /// Where it stands while it does not run, and the cycles into the next step.
    value: u32,
    phase: u64,
    leg: Option<Leg>,
}

impl Counter {
    pub fn new(most: u32) -> Self {
        Self {
            reload: most,
            prescaler: 0,
            clock: 1,
            step: 1,
            most,
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

    /// The timer's clock has another length. What is left of a step keeps its share.
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

    /// Another prescaler is in force, from the end of a step on.
    pub fn set_prescaler(&mut self, prescaler: u32) {
        self.prescaler = prescaler;
        self.step = self.clock * (u64::from(prescaler) + 1);
    }

    /// The first edge of the timer's clock at `now` or later.
    pub fn edge(&self, now: Cycles) -> Cycles {
        now.div_ceil(self.clock) * self.clock
    }

    pub fn runs(&self) -> bool {
        self.leg.is_some()
    }

    /// Where it stands.
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

    /// Lets it count from where it stands.
    pub fn start(&mut self, now: Cycles) {
        let start = now - self.phase.min(now);
        self.begin(self.value, start);
    }

    /// Stops it where it stands.
    pub fn stop(&mut self, now: Cycles) {
        if let Some(leg) = &self.leg {
            let passed = now.saturating_sub(leg.start) % self.step;
            (self.value, self.phase) = (self.value(now), passed);
            self.leg = None;
        }
    }

    /// Puts it at a value; a running one goes on from there.
    pub fn set(&mut self, value: u32, now: Cycles) {
        let runs = self.leg.is_some();
        self.stop(now);
        self.value = value;
        if runs {
            self.start(now);
        }
    }

    /// Puts it and its prescaler at the beginning, as an update by software does.
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

    /// Reload value, direction or alignment have changed.
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
            // The manual: the counter is blocked.
            return;
        }
        if self.centred && (from == 0 || from == self.reload) {
            self.up = from == 0;
        }
        let (from_, reload) = (u64::from(from), u64::from(self.reload));
        let beyond = self.up && from > self.reload;
        let length = match (self.up, self.centred) {
            (true, _) if beyond => u64::from(self.most) - from_ + 1,
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

    /// When the leg ends.
    pub fn end(&self) -> Option<Cycles> {
        let leg = self.leg.as_ref()?;
        Some(leg.start + leg.length * self.step)
    }

    /// How the leg ends.
    pub fn turn(&self) -> Turn {
        match (&self.leg, self.up) {
            (Some(Leg { beyond: true, .. }), _) => Turn::Wrap,
            (_, true) => Turn::Overflow,
            (_, false) => Turn::Underflow,
        }
    }

    /// Begins the next leg at `end`, with the reload value that is in force now.
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

    /// When it comes to stand at a value on this leg.
    pub fn meets(&self, value: u32) -> Option<Cycles> {
        let leg = self.leg.as_ref()?;
        let steps = if self.up {
            u64::from(value.checked_sub(leg.from)?)
        } else {
            u64::from(leg.from.checked_sub(value)?)
        };
        (steps < leg.length).then(|| leg.start + steps * self.step)
    }

    /// Leaves out as many stretches of `legs` legs as have passed by `now`, when each is as the other.
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
    fn a_centred_counter_stands_at_its_ends_for_one_step_each() {
        let mut counter = Counter::new(0xffff);
        (counter.reload, counter.centred) = (6, true);
        counter.start(0);
        // RM0090, the figure of a centre-aligned counter with a reload value of 6.
        let mut seen = Vec::new();
        for now in 0..14 {
            if counter.end() == Some(now) {
                counter.next_leg(counter.turn(), now);
            }
            seen.push(counter.value(now));
        }
        assert_eq!(seen, [0, 1, 2, 3, 4, 5, 6, 5, 4, 3, 2, 1, 0, 1]);
    }

    #[test]
    fn a_counter_beyond_its_reload_value_runs_over_at_its_width() {
        let mut counter = Counter::new(0xffff);
        counter.set(0xfff0, 0);
        counter.start(0);
        counter.adapt(4, |counter| counter.reload = 100);
        assert_eq!((counter.turn(), counter.end()), (Turn::Wrap, Some(16)));
        counter.next_leg(Turn::Wrap, 16);
        assert_eq!((counter.value(26), counter.end()), (10, Some(117)));
    }

    #[test]
    fn a_prescaler_keeps_its_place_when_the_counter_stands_still() {
        let mut counter = Counter::new(0xffff);
        counter.set_prescaler(9);
        counter.start(0);
        counter.stop(25);
        assert_eq!(counter.value(1000), 2);
        counter.start(1000);
        assert_eq!((counter.value(1004), counter.value(1005)), (2, 3));
        // Twice as many cycles in a clock: the half of a step that has passed stays half a step.
        counter.set_clock(2, 1010);
        assert_eq!((counter.value(1019), counter.value(1020)), (3, 4));
    }

    #[test]
    fn skipped_stretches_change_nothing_but_the_time() {
        let mut counter = Counter::new(0xffff);
        (counter.reload, counter.centred) = (7, true);
        counter.start(0);
        counter.skip(4, 1000);
        // 35 stretches of 28 cycles.
        assert_eq!((counter.end(), counter.value(983)), (Some(987), 3));
    }
}
