//! Mechanical contacts (button, strap, emergency stop) with bounce.

use crate::noise::Noise;
use crate::time::Time;
use std::collections::VecDeque;

/// A mechanical contact with bounce.
///
/// After closing or opening, the contact changes randomly for up to the bounce time, the largest bounce in the data
/// sheet (5 ms for a tactile switch).
#[derive(Clone, Debug)]
pub struct Contact {
    closed: bool,
    bounce: Time,
    noise: Noise,
    edges: VecDeque<(Time, bool)>,
}

impl Contact {
    /// A contact that is open or closed; each later change bounces for up to `bounce`.
    pub fn new(closed: bool, bounce: Time, seed: u64) -> Self {
        Self {
            closed,
            bounce,
            noise: Noise::new(seed),
            edges: VecDeque::new(),
        }
    }

    /// Opens or closes the contact at `at`, which must not be before the end of earlier changes.
    pub fn set(&mut self, closed: bool, at: Time) {
        let last = self.edges.back().map_or(self.closed, |e| e.1);
        if closed == last {
            return;
        }
        self.edges.push_back((at, closed));
        // A random number of bounces, each in the remaining bounce time.
        let mut from = at;
        let end = at + self.bounce;
        for _ in 0..self.noise.bits() % 6 {
            for level in [!closed, closed] {
                let left = (end - from).0 as f64;
                let share = 0.3 * self.noise.uniform();
                from = from + Time((left * share) as u64);
                if from > at {
                    self.edges.push_back((from, level));
                }
            }
        }
    }

    /// True if the contact conducts at the time of the latest call.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Time of the next change of the contact; [`Time::NEVER`] if none is due.
    pub fn next(&self) -> Time {
        self.edges.front().map_or(Time::NEVER, |e| e.0)
    }

    /// Advances the contact to a time.
    pub fn advance(&mut self, to: Time) {
        while let Some((_, closed)) = self.edges.pop_front_if(|(at, _)| *at <= to) {
            self.closed = closed;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000_000;

    #[test]
    fn button_bounces_within_the_bounce_time_then_settles() {
        let mut longest = 0;
        for seed in 0..50 {
            let mut button = Contact::new(false, Time(5 * MS), seed);
            button.set(true, Time(MS));
            assert_eq!(button.next(), Time(MS));
            let (mut edges, mut last) = (0, false);
            while button.next() != Time::NEVER {
                let at = button.next();
                assert!(at <= Time(6 * MS));
                button.advance(at);
                edges += u32::from(button.is_closed() != last);
                last = button.is_closed();
            }
            assert!(button.is_closed() && edges % 2 == 1);
            longest = longest.max(edges);
        }
        assert!((3..=11).contains(&longest), "{longest}");
    }

    #[test]
    fn contact_without_bounce_has_one_edge_per_change() {
        let mut strap = Contact::new(true, Time(0), 1);
        strap.set(true, Time(MS));
        assert_eq!(strap.next(), Time::NEVER);
        strap.set(false, Time(2 * MS));
        strap.advance(Time(2 * MS));
        assert!(!strap.is_closed() && strap.next() == Time::NEVER);
    }
}
