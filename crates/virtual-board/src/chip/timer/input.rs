//! Inputs of a timer: digital filter and encoder.

use crate::time::Cycles;

/// Sampling of an input filter (ICxF): dividers of f_DTS, and samples that must agree.
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

/// Setting of a filter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Filter {
    /// Cycles of the core from sample to sample.
    unit: u64,
    /// Samples that must agree; none for no filter.
    samples: u64,
}

impl Filter {
    /// Of ICxF; `timer` is a cycle of the timer's clock and `sampling` one of f_DTS, in cycles of the
    /// core.
    pub fn of(bits: u32, timer: u64, sampling: u64) -> Self {
        let (divider, samples) = FILTERS[bits as usize & 15];
        // The first three are sampled by the timer's own clock.
        let unit = if bits < 4 { timer } else { sampling * divider };
        Self { unit, samples }
    }

    /// The first sample at `now` or later.
    fn sample(&self, now: Cycles) -> Cycles {
        now.div_ceil(self.unit) * self.unit
    }
}

/// An input behind its filter.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Input {
    /// Level at the pin.
    raw: bool,
    /// Level behind the filter.
    pub level: bool,
    /// When the filter lets the other level through.
    pub due: Option<Cycles>,
    /// Since when the pin is back at the old level meanwhile.
    back: Cycles,
}

impl Input {
    /// An input that nobody listens to: levels pass.
    pub fn follow(&mut self, level: bool) {
        (self.raw, self.level, self.due) = (level, level, None);
    }

    /// The pin has another level. Whether the level behind the filter changes at once.
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
        // A return to the old level between two samples was not seen.
        let unseen = filter.sample(self.back) >= now;
        if !(self.due.is_some_and(|due| due >= now) && unseen) {
            self.due = Some(filter.sample(now) + (filter.samples - 1) * filter.unit);
        }
        false
    }

    /// The filter's time has come; whether the level behind it changes.
    pub fn pass(&mut self) -> bool {
        self.due = None;
        let changes = self.level != self.raw;
        self.level = self.raw;
        changes
    }
}

/// What an edge of an encoder counts, by which input changed (0 or 1), its new level and that of the other
/// (RM0090, table of counting direction versus encoder signals).
pub(super) fn counts(which: usize, level: bool, other: bool) -> i32 {
    // TI1 rises while TI2 is low: up.
    let up = (level != other) == (which == 0);
    if up { 1 } else { -1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filter_passes_what_lasts_for_its_samples_and_nothing_shorter() {
        // A timer at 84 MHz of a core at 168 MHz; f_DTS/32, eight samples: 64 cycles each.
        let filter = Filter::of(15, 2, 2);
        let mut input = Input::default();
        assert!(!input.change(true, filter, 1000));
        // Sampled at 1024, 1088, …, 1472.
        assert_eq!(input.due, Some(1472));
        input.change(false, filter, 1471);
        assert!(!input.pass() && !input.level);
        input.change(true, filter, 2000);
        assert!(input.pass() && input.level);
        let mut plain = Input::default();
        assert!(plain.change(true, Filter::of(0, 2, 2), 5) && plain.level);
    }

    #[test]
    fn what_lies_between_two_samples_is_not_seen() {
        let filter = Filter::of(15, 2, 2);
        let mut input = Input::default();
        input.change(true, filter, 1000);
        // Back between the samples at 1088 and 1152.
        input.change(false, filter, 1090);
        input.change(true, filter, 1150);
        assert_eq!(input.due, Some(1472));
        // Back at the sample at 1152: it begins anew.
        input.change(false, filter, 1151);
        input.change(true, filter, 1153);
        assert_eq!(input.due, Some(1216 + 448));
    }

    #[test]
    fn filters_of_the_manual_take_their_time() {
        // ICxF, shortest time that always passes, in cycles of the timer with f_DTS the same.
        for (bits, time) in [(1, 2), (3, 8), (4, 12), (7, 32), (10, 80), (15, 256)] {
            let filter = Filter::of(bits, 1, 1);
            assert_eq!(filter.unit * filter.samples, time, "{bits}");
        }
    }

    #[test]
    fn four_edges_of_a_quadrature_count_four_one_way_and_minus_four_the_other() {
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
