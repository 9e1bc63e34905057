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

/// An input behind its filter.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Input {
    /// Level at the pin.
    raw: bool,
    /// Level behind the filter.
    pub level: bool,
    /// When the filter lets the pin's level through.
    pub due: Option<Cycles>,
}

impl Input {
    /// The pin has another level. `timer` is a cycle of the timer's clock and `sampling` one of f_DTS, in
    /// cycles of the core. Whether the level behind the filter changes at once.
    pub fn change(
        &mut self,
        level: bool,
        filter: u32,
        (timer, sampling): (u64, u64),
        now: Cycles,
    ) -> bool {
        self.raw = level;
        if level == self.level {
            // Too short: the filter never saw it for long enough.
            self.due = None;
            return false;
        }
        let (divider, samples) = FILTERS[filter as usize & 15];
        if samples == 0 {
            self.level = level;
            self.due = None;
            return true;
        }
        // The first three are sampled by the timer's own clock.
        let unit = if filter < 4 {
            timer
        } else {
            sampling * divider
        };
        if self.due.is_none() {
            self.due = Some(now.div_ceil(unit) * unit + (samples - 1) * unit);
        }
        false
    }

    /// The filter's time has come: the level behind it changes.
    pub fn pass(&mut self) {
        self.due = None;
        self.level = self.raw;
    }
}

/// What an edge of an encoder counts, by the mode (1: edges of TI2, 2: of TI1, 3: of both), which input
/// changed (0 or 1), its new level and that of the other (RM0090, table 97).
pub(super) fn counts(mode: u32, which: usize, level: bool, other: bool) -> i32 {
    let counted = match mode {
        1 => which == 1,
        2 => which == 0,
        _ => true,
    };
    if !counted {
        return 0;
    }
    // TI1 rises while TI2 is low: up.
    let up = (level != other) == (which == 0);
    if up { 1 } else { -1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A timer at 84 MHz of a core at 168 MHz.
    const CLOCKS: (u64, u64) = (2, 2);

    #[test]
    fn a_filter_passes_what_lasts_for_its_samples_and_nothing_shorter() {
        // f_DTS/32, eight samples: 64 cycles each.
        let mut input = Input::default();
        assert!(!input.change(true, 15, CLOCKS, 1000));
        // Sampled at 1024, 1088, …, 1472.
        assert_eq!(input.due, Some(1472));
        assert!(!input.change(false, 15, CLOCKS, 1471));
        assert_eq!((input.due, input.level), (None, false));
        input.change(true, 15, CLOCKS, 2000);
        input.pass();
        assert!(input.level);
        let mut plain = Input::default();
        assert!(plain.change(true, 0, CLOCKS, 5) && plain.level);
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
                counted += counts(3, which, level, levels[1 - which]);
            }
            assert_eq!(counted, sum);
        }
        assert_eq!(counts(1, 0, true, false), 0);
    }
}
