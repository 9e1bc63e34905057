//! Schedule of events.

use super::map::Unit;
use crate::time::{Cycles, NEVER};

/// Cycle of the next event of each unit.
#[derive(Clone, Debug)]
pub(crate) struct Schedule {
    at: [Cycles; Unit::SCHEDULED.len()],
    /// Index of the unit whose event is next.
    first: usize,
}

impl Schedule {
    pub fn new() -> Self {
        Self {
            at: [NEVER; Unit::SCHEDULED.len()],
            first: 0,
        }
    }

    pub fn set(&mut self, unit: Unit, at: Cycles) {
        let place = unit as usize;
        self.at[place] = at;
        // Of two events at the same cycle, the unit with the lower index is first.
        if place == self.first {
            let earliest = (0..self.at.len()).min_by_key(|&place| self.at[place]);
            self.first = earliest.unwrap_or_default();
        } else if (at, place) < (self.at[self.first], self.first) {
            self.first = place;
        }
    }

    pub fn due(&self, unit: Unit) -> Cycles {
        self.at[unit as usize]
    }

    /// Unit with the next event, and its cycle.
    pub fn next(&self) -> (Unit, Cycles) {
        (Unit::SCHEDULED[self.first], self.at[self.first])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::Noise;

    #[test]
    fn next_event_is_the_earliest_and_ties_go_to_the_first_unit() {
        let mut schedule = Schedule::new();
        let mut random = Noise::new(3);
        for _ in 0..10_000 {
            let source = Unit::SCHEDULED[random.bits() as usize % Unit::SCHEDULED.len()];
            let at = match random.bits() % 20 {
                0 => NEVER,
                at => at,
            };
            schedule.set(source, at);
            assert_eq!(schedule.due(source), at);
            let sources = Unit::SCHEDULED.into_iter();
            let earliest = sources.min_by_key(|&source| schedule.due(source));
            assert_eq!(Some(schedule.next().0), earliest);
        }
    }
}
