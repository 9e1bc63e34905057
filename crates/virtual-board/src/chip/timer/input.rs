//! Inputs of a timer: digital filter and encoder direction.

use crate::time::Cycles;

/// Settings of an input filter (ICxF): divider of f_DTS, and number of samples that must agree.
const FILTERS: [(u64, u64); 16] = [
    (0, 0),
    (1, 2),
    (1, 4),
    (1, 8),
    (2, 6),
    (2, 8),
    (4, 6),
    (4, 8),
    (8, 6),
    (8, 8),
    (16, 5),
    (16, 6),
    (16, 8),
    (32, 5),
    (32, 6),
    (32, 8),
];

#[derive(Clone, Copy, Debug)]
pub(super) struct Filter {
    /// Core cycles between samples.
    unit: u64,
    /// Number of samples that must agree; 0 without a filter.
    samples: u64,
}

impl Filter {
    /// Settings from ICxF. `timer` is the period of the timer's clock and `sampling` that of f_DTS, in core cycles.
    pub fn of(bits: u32, timer: u64, sampling: u64) -> Self {
        let (divider, samples) = FILTERS[bits as usize & 15];
        // With ICxF from 1 to 3 the filter samples at the timer's clock.
        let unit = if bits < 4 { timer } else { sampling * divider };
        Self { unit, samples }
    }

    /// Cycle of the first sample at `now` or later.
    fn sample(&self, now: Cycles) -> Cycles {
        now.div_ceil(self.unit) * self.unit
    }
}

/// An input with its filter.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Input {
    /// Level at the pin.
    raw: bool,
    /// Level behind the filter.
    pub level: bool,
    /// Cycle at which the filter passes the new level; `None` if the filter does not run.
    pub due: Option<Cycles>,
    /// Latest cycle at which the pin returned to the filtered level.
    back: Cycles,
}

impl Input {
    /// Sets the level of an input that nothing reads, without filtering.
    pub fn follow(&mut self, level: bool) {
        (self.raw, self.level, self.due) = (level, level, None);
    }

    /// Handles a new level at the pin. True if the level behind the filter changes at once.
    pub fn change(&mut self, level: bool, filter: Filter, now: Cycles) -> bool {
        if level == self.raw {
            return false;
        }
        self.raw = level;
        if filter.samples == 0 {
            self.level = level;
            self.due = None;
            return true;
        }
        if level == self.level {
            self.back = now;
            return false;
        }
        // A return to the old level between two samples has no effect.
        let unseen = filter.sample(self.back) >= now;
        if !(self.due.is_some_and(|due| due >= now) && unseen) {
            self.due = Some(filter.sample(now) + (filter.samples - 1) * filter.unit);
        }
        false
    }

    /// Ends the filter time; true if the level behind the filter changes.
    pub fn pass(&mut self) -> bool {
        self.due = None;
        let changes = self.level != self.raw;
        self.level = self.raw;
        changes
    }
}

/// Count of an encoder edge, +1 or −1. `which` is the input that changed (0 or 1), `level` its new level, `other` the
/// level of the other input (RM0090, table of counting direction versus encoder signals).
pub(super) fn counts(which: usize, level: bool, other: bool) -> i32 {
    // TI1 rises while TI2 is low: up.
    let up = (level != other) == (which == 0);
    if up { 1 } else { -1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filter_passes_a_level_only_after_all_its_samples() {
        // The timer's clock is two core cycles. The filter takes eight samples at f_DTS/32, 64 core cycles apart.
        let filter = Filter::of(15, 2, 2);
        let mut input = Input::default();
        assert!(!input.change(true, filter, 1000));
        // The filter samples at cycles 1024, 1088, …, 1472.
        assert_eq!(input.due, Some(1472));
        input.change(false, filter, 1471);
        assert!(!input.pass() && !input.level);
        input.change(true, filter, 2000);
        assert!(input.pass() && input.level);
        let mut plain = Input::default();
        assert!(plain.change(true, Filter::of(0, 2, 2), 5) && plain.level);
    }

    #[test]
    fn filter_ignores_a_pulse_between_two_samples() {
        let filter = Filter::of(15, 2, 2);
        let mut input = Input::default();
        input.change(true, filter, 1000);
        // The input returns to its old level between the samples at 1088 and 1152.
        input.change(false, filter, 1090);
        input.change(true, filter, 1150);
        assert_eq!(input.due, Some(1472));
        // The sample at 1152 has the old level: the filter restarts.
        input.change(false, filter, 1151);
        input.change(true, filter, 1153);
        assert_eq!(input.due, Some(1216 + 448));
    }

    #[test]
    fn filter_times_match_the_manual() {
        // Each pair is ICxF and the time of all its samples, cycles of the timer's clock. f_DTS equals this clock.
        for (bits, time) in [(1, 2), (3, 8), (4, 12), (7, 32), (10, 80), (15, 256)] {
            let filter = Filter::of(bits, 1, 1);
            assert_eq!(filter.unit * filter.samples, time, "{bits}");
        }
    }

    #[test]
    fn quadrature_period_counts_plus_four_forward_and_minus_four_backward() {
        let forward = [(0, true), (1, true), (0, false), (1, false)];
        for (sequence, sum) in [
            (forward.to_vec(), 4),
            (vec![(1, true), (0, true), (1, false), (0, false)], -4),
        ] {
            let mut levels = [false; 2];
            let mut counted = 0;
            for (which, level) in sequence {
                levels[which] = level;
                counted += counts(which, level, levels[1 - which]);
            }
            assert_eq!(counted, sum);
        }
    }
}
