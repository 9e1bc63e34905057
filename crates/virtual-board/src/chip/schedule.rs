//! Who is due next.

use super::map::Unit;
use crate::time::{Cycles, NEVER};

/// Leaves of the tree, a power of two.
const LEAVES: usize = Unit::SCHEDULED.len().next_power_of_two();

/// When each source is due. A tree whose every node names the earlier of the two below it, so that a
/// change costs a comparison for each level; of two at the same cycle the first in the list is first.
#[derive(Clone, Debug)]
pub(crate) struct Schedule {
    at: [Cycles; LEAVES],
    /// Node 1 is the root, those below node k are 2 k and 2 k + 1, the leaves come last.
    nodes: [u8; 2 * LEAVES],
}

impl Schedule {
    pub fn new() -> Self {
        let mut schedule = Self {
            at: [NEVER; LEAVES],
            nodes: std::array::from_fn(|node| (node % LEAVES) as u8),
        };
        for leaf in 0..LEAVES {
            schedule.climb(leaf);
        }
        schedule
    }

    pub fn set(&mut self, unit: Unit, at: Cycles) {
        self.at[unit as usize] = at;
        self.climb(unit as usize);
    }

    pub fn due(&self, unit: Unit) -> Cycles {
        self.at[unit as usize]
    }

    /// The next that is due, and when.
    pub fn next(&self) -> (Unit, Cycles) {
        let first = self.nodes[1] as usize;
        let source = Unit::SCHEDULED.get(first).copied();
        (source.unwrap_or(Unit::SCHEDULED[0]), self.at[first])
    }

    fn climb(&mut self, leaf: usize) {
        let mut node = (LEAVES + leaf) / 2;
        while node > 0 {
            let (a, b) = (self.nodes[2 * node], self.nodes[2 * node + 1]);
            let first = self.at[a as usize % LEAVES] <= self.at[b as usize % LEAVES];
            self.nodes[node] = if first { a } else { b };
            node /= 2;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::Noise;

    #[test]
    fn the_next_is_the_earliest_and_of_equals_the_first() {
        let mut schedule = Schedule::new();
        assert_eq!(schedule.next().1, NEVER);
        let mut random = Noise::new(3);
        for _ in 0..10_000 {
            let source = Unit::SCHEDULED[random.bits() as usize % Unit::SCHEDULED.len()];
            let at = match random.bits() % 20 {
                0 => NEVER,
                at => at,
            };
            schedule.set(source, at);
            assert_eq!(schedule.due(source), at);
            let earliest = Unit::SCHEDULED
                .iter()
                .min_by_key(|&&source| schedule.due(source));
            let (next, at) = schedule.next();
            assert_eq!(at, schedule.due(next));
            if at != NEVER {
                assert_eq!(Some(&next), earliest);
            }
        }
    }
}
