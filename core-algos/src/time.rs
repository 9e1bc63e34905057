//! Time of the robot: microseconds, ticks and epochs.
//!
//! All boards count microseconds on a common clock (synchronised by the bus, see
//! [`node::clock`](crate::node::clock)). An epoch is 10 ms; axles and beam report their state at the beginning of an
//! epoch. The lead node processes the reports [`LEAD_PHASE`] later, when they have arrived.

/// Time in microseconds.
pub type Micros = u64;

/// Period of axle and beam ticks, µs.
pub const TICK: Micros = 1_000;
/// [`TICK`] in seconds.
pub const TICK_S: f32 = 1e-3;
/// Length of an epoch, µs: the period of reports, fusion and references.
pub const EPOCH: Micros = 10_000;
/// [`EPOCH`] in seconds.
pub const EPOCH_S: f32 = 0.01;
/// Duration of `ticks` ticks as a share of an epoch, at most 1.
pub fn share_of_epoch(ticks: u8) -> f32 {
    (f32::from(ticks) / (EPOCH / TICK) as f32).min(1.0)
}

/// Delay of the lead node's step after the beginning of an epoch, µs.
pub const LEAD_PHASE: Micros = 3_000;

/// A value with its time stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stamped<T> {
    /// The value.
    pub value: T,
    /// Time at which the value was valid, µs.
    pub time: Micros,
}

impl<T> Stamped<T> {
    /// A value with the time stamp `time`.
    pub const fn new(value: T, time: Micros) -> Self {
        Self { value, time }
    }

    /// Age of the value at `now`, µs; zero if the time stamp is later than `now`.
    pub const fn age(&self, now: Micros) -> Micros {
        now.saturating_sub(self.time)
    }

    /// The value; `None` if its age at `now` exceeds `limit`, µs.
    pub fn fresh(&self, now: Micros, limit: Micros) -> Option<&T> {
        (self.age(now) <= limit).then_some(&self.value)
    }
}

/// Sequence number of the epoch that `now` lies in.
pub const fn sequence(now: Micros) -> u8 {
    (now / EPOCH) as u8
}

/// Beginning of the latest epoch, not after `now`, with this sequence number.
pub const fn epoch_start(now: Micros, number: u8) -> Micros {
    let epoch = now / EPOCH;
    let back = (epoch as u8).wrapping_sub(number) as u64;
    epoch.saturating_sub(back) * EPOCH
}

/// Time since the beginning of the epoch that `now` lies in.
pub const fn since_epoch_start(now: Micros) -> Micros {
    // In 32-bit words: a Cortex-M4F has no 64-bit division.
    const EPOCH_WORD: u32 = EPOCH as u32;
    const CARRY: u32 = ((1u64 << 32) % EPOCH) as u32;
    let (high, low) = ((now >> 32) as u32, now as u32);
    ((high % EPOCH_WORD * CARRY + low % EPOCH_WORD) % EPOCH_WORD) as Micros
}

/// True if `now` is the beginning of an epoch.
pub const fn is_epoch_start(now: Micros) -> bool {
    since_epoch_start(now) == 0
}

/// Microseconds as seconds; meant for short spans.
pub fn seconds(span: Micros) -> f32 {
    // 32 bits hold more than an hour, and one instruction converts them.
    if span <= u32::MAX as u64 {
        span as u32 as f32 * 1e-6
    } else {
        span as f32 * 1e-6
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn epoch_begins_every_ten_milliseconds() {
        for epoch in [0u64, 1, 429_496, 429_497, 858_993_459, u64::MAX / EPOCH] {
            for offset in [0, 1, EPOCH - 1, 5_000] {
                let now = (epoch * EPOCH).saturating_add(offset);
                assert_eq!(since_epoch_start(now), now % EPOCH, "{now}");
            }
        }
    }

    #[test]
    fn epoch_start_is_recovered_from_the_sequence_number() {
        for epoch in [0u64, 1, 200, 255, 256, 300, 70_000] {
            let start = epoch * EPOCH;
            for later in [0, 1, 9_999, 10_000, 400_000, 2_549_999] {
                assert_eq!(epoch_start(start + later, sequence(start)), start);
            }
        }
        assert_eq!(epoch_start(5_000, 250), 0, "before the first epoch");
    }

    #[test]
    fn tick_and_epoch_in_seconds_match_their_microseconds() {
        assert_eq!((TICK_S * 1e6).round() as Micros, TICK);
        assert_eq!((EPOCH_S * 1e6).round() as Micros, EPOCH);
    }

    #[test]
    fn age_never_wraps() {
        let value = Stamped::new(1, 5_000);
        assert_eq!(value.age(4_000), 0);
        assert_eq!(value.fresh(15_000, 10_000), Some(&1));
        assert_eq!(value.fresh(15_001, 10_000), None);
    }
}
