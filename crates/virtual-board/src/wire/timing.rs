//! Bit timing: quanta, segments, synchronization (ISO 11898-1, section on bit timing).

use crate::time::Time;

/// Bit timing of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Length of a time quantum, 2⁻³² ps.
    pub quantum: u64,
    /// Quanta of propagation segment and first phase segment together.
    pub segment1: u32,
    /// Quanta of the second phase segment.
    pub segment2: u32,
    /// Synchronization jump width: limit of the quanta by which an edge lengthens or shortens a bit.
    pub jump: u32,
}

impl BitTiming {
    /// A timing with `segment1 + segment2 + 1` quanta in a bit at this rate; the controller's clock is `fast_ppb` parts
    /// in 10⁹ too fast.
    pub fn new(rate_hz: u64, segments: (u32, u32), jump: u32, fast_ppb: i64) -> Self {
        let (segment1, segment2) = segments;
        let quanta = u64::from(1 + segment1 + segment2);
        let nano_hz = i128::from(rate_hz * quanta) * (1_000_000_000 + i128::from(fast_ppb)).max(1);
        let quantum = (1_000_000_000_000_000_000_000u128 << 32) / nano_hz.max(1) as u128;
        Self {
            quantum: quantum as u64,
            segment1,
            segment2,
            jump,
        }
    }

    /// 1 Mbit/s, sampled at 6/7 of a bit, with an exact clock.
    pub fn megabit() -> Self {
        Self::new(1_000_000, (5, 1), 1, 0)
    }

    /// Quanta in a bit.
    pub fn quanta(&self) -> u32 {
        1 + self.segment1 + self.segment2
    }

    /// Length of a bit.
    pub fn bit(&self) -> Time {
        Time(((u128::from(self.quantum) * u128::from(self.quanta())) >> 32) as u64)
    }
}

/// Position of a controller within its bits. Quanta are counted from the origin; synchronization to an edge moves the
/// bits, not the quanta.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BitClock {
    timing: BitTiming,
    origin: Time,
    /// First quantum of the bit.
    first: u64,
    /// Quantum at whose start the bit is sampled, and quantum at which the next bit begins.
    sample: u64,
    next: u64,
    /// True if the bit was sampled.
    pub sampled: bool,
    /// True if the clock synchronized to an edge since the last sample.
    followed: bool,
    /// Quantum of an edge detected beyond the present bit; `None` without such an edge.
    early: Option<u64>,
}

impl BitClock {
    /// Creates the bit clock of a controller whose bit begins at `now`.
    pub fn new(timing: BitTiming, now: Time) -> Self {
        let mut clock = Self {
            timing,
            origin: now,
            first: 0,
            sample: 0,
            next: 0,
            sampled: false,
            followed: false,
            early: None,
        };
        clock.begin(0);
        clock
    }

    /// Length of a bit.
    pub fn bit(&self) -> Time {
        self.timing.bit()
    }

    fn begin(&mut self, first: u64) {
        self.first = first;
        self.sample = first + 1 + u64::from(self.timing.segment1);
        self.next = self.sample + u64::from(self.timing.segment2);
        self.sampled = false;
    }

    fn time(&self, quantum: u64) -> Time {
        let span = (u128::from(quantum) * u128::from(self.timing.quantum)) >> 32;
        Time(self.origin.0 + span as u64)
    }

    /// First quantum that begins at `time` or later.
    fn quantum(&self, time: Time) -> u64 {
        let span = u128::from((time - self.origin).0) << 32;
        span.div_ceil(u128::from(self.timing.quantum)) as u64
    }

    /// Sample time of the bit.
    pub fn sample_time(&self) -> Time {
        self.time(self.sample)
    }

    /// Start time of the next bit.
    pub fn next_time(&self) -> Time {
        self.time(self.next)
    }

    /// Begins the next bit. `hard` and `behind` are as in [`Self::edge`], for an edge detected earlier.
    pub fn advance(&mut self, hard: bool, behind: bool) {
        let edge = self.early.take();
        self.begin(self.next);
        if let Some(edge) = edge {
            self.follow(edge, hard, behind);
        }
    }

    /// Marks the bit as sampled; synchronization to another edge is allowed again.
    pub fn sample(&mut self) {
        self.sampled = true;
        self.followed = false;
    }

    /// Synchronizes to an edge from recessive to dominant that the controller detects at `time`. `hard`: the edge
    /// restarts the bit. `behind`: synchronization to a late edge is allowed.
    pub fn edge(&mut self, time: Time, hard: bool, behind: bool) {
        let edge = self.quantum(time);
        if edge >= self.next && self.sampled {
            self.early = Some(edge);
        } else {
            self.follow(edge, hard, behind);
        }
    }

    fn follow(&mut self, edge: u64, hard: bool, behind: bool) {
        if self.followed {
            return;
        }
        let jump = u64::from(self.timing.jump);
        if hard {
            self.followed = true;
            self.begin(edge);
        } else if self.sampled {
            // The edge is early for the next bit: the rest of this bit is shortened.
            self.followed = true;
            self.next = (self.next - jump).max(edge);
        } else if edge > self.first && behind {
            self.followed = true;
            let late = (edge - self.first).min(jump);
            self.sample += late;
            self.next += late;
        }
    }

    /// Advances by whole bits to the bit that contains `now`, after an idle period. Sample times at the controller are
    /// later than on the bus by `delay`.
    pub fn skip(&mut self, now: Time, delay: Time) {
        let bit = u64::from(self.timing.quanta());
        let quantum = self.quantum(now);
        if quantum > self.next {
            self.begin(self.next + ((quantum - self.next).div_ceil(bit) - 1) * bit);
            (self.followed, self.early) = (false, None);
        }
        self.sampled = self.sample_time() - delay < now;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clock with ten quanta of 100 ns in a bit.
    fn clock(jump: u32) -> BitClock {
        BitClock::new(BitTiming::new(1_000_000, (6, 3), jump, 0), Time(0))
    }

    #[test]
    fn bit_has_the_configured_sample_point_and_length() {
        let mut clock = clock(1);
        assert_eq!(clock.sample_time(), Time::from_nanos(700));
        assert_eq!(clock.next_time(), Time::from_nanos(1000));
        clock.sample();
        clock.advance(false, true);
        assert_eq!(clock.sample_time(), Time::from_nanos(1700));
    }

    #[test]
    fn edges_move_the_sample_point_by_at_most_the_jump_width() {
        // The edge is three quanta late.
        for (jump, sample) in [(1, 800), (2, 900), (4, 1000)] {
            let mut clock = clock(jump);
            clock.edge(Time::from_nanos(300), false, true);
            assert_eq!(clock.sample_time(), Time::from_nanos(sample));
            // Only one edge in each bit counts.
            clock.edge(Time::from_nanos(500), false, true);
            assert_eq!(clock.sample_time(), Time::from_nanos(sample));
        }
        // The edge is two quanta early.
        for (jump, next) in [(1, 900), (2, 800), (3, 800)] {
            let mut clock = clock(jump);
            clock.sample();
            clock.edge(Time::from_nanos(800), false, true);
            assert_eq!(clock.next_time(), Time::from_nanos(next));
        }
        // The sender of a dominant bit does not synchronize to its own late edge.
        let mut sender = clock(4);
        sender.edge(Time::from_nanos(300), false, false);
        assert_eq!(sender.sample_time(), Time::from_nanos(700));
        // A start of frame restarts the bit, on a quantum.
        let mut idle = clock(1);
        idle.edge(Time::from_nanos(430), true, true);
        assert_eq!(idle.sample_time(), Time::from_nanos(1200));
    }

    #[test]
    fn skip_keeps_the_grid_of_bits() {
        let mut clock = clock(1);
        for (now, sampled) in [(12_345_600, false), (12_346_778, true), (12_346_999, true)] {
            clock.skip(Time::from_nanos(now), Time::from_nanos(50));
            assert_eq!(clock.first % 10, 0);
            assert!(clock.first * 100 <= now && clock.next * 100 > now);
            assert_eq!(clock.sampled, sampled, "{now}");
        }
    }
}
