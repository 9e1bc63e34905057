//! Lease: one host at a time commands the robot; any number of hosts may watch.
//!
//! | condition | reaction | after | until | reason |
//! |---|---|---|---|---|
//! | no order yet, or lease released | order of any host taken | at once | an order is taken | no host commands |
//! | newer order of the latest host | order taken, lease renewed | at once | more than 1 s without an order, or release | the host is alive |
//! | order of the latest host, sequence number 0 or at least 32768 ahead of the latest | refused: old order; lease not renewed | at once | an order of another host | a delayed frame stays old, also after end or release of the lease |
//! | order of another host, latest order 1 s ago or less | refused: leased; lease not renewed | at once | more than 1 s after the latest order, or release | one host commands |
//! | order of another host, latest order longer ago | order with any number taken, the lease passes to that host | at once | as above | the former host is gone |
//! | lease held, latest order more than 1 s ago | lease lapses, reported once | at once | the next order taken | a robot without a commanding host stops |
//! | clock before the latest order | no time has passed | at once | | a clock does not run back |

use crate::time::Micros;
use serde::{Deserialize, Serialize};

/// Timeout of the lease after the latest order, µs.
pub const TERM: Micros = 1_000_000;

/// Sender and sequence number of an order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Random number that a host draws when it starts; identifies the host.
    pub owner: u16,
    /// Sequence number; increases by at least one per order and wraps after 65535.
    pub sequence: u16,
}

/// Reason for which an order is not admitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Denied {
    /// Another host commands the robot.
    Leased,
    /// The order is not newer than the latest one.
    OldOrder,
}

/// Lease of the front board.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lease {
    /// Stamp and time of arrival of the latest order; `None` before the first order.
    latest: Option<(Stamp, Micros)>,
    /// True from an order to the end of the lease.
    held: bool,
}

impl Lease {
    /// Admits an order that arrived at `now`. Denied are orders of another host during the lease, and orders of the
    /// latest host that are not newer.
    pub fn admit(&mut self, now: Micros, stamp: Stamp) -> Result<(), Denied> {
        if let Some((latest, renewed)) = self.latest {
            let lasts = self.held && now.saturating_sub(renewed) <= TERM;
            let newer = stamp.sequence.wrapping_sub(latest.sequence).cast_signed() > 0;
            match stamp.owner == latest.owner {
                true if !newer => return Err(Denied::OldOrder),
                false if lasts => return Err(Denied::Leased),
                _ => {}
            }
        }
        (self.latest, self.held) = (Some((stamp, now)), true);
        Ok(())
    }

    /// True once after the lease lapsed.
    pub fn take_lapsed(&mut self, now: Micros) -> bool {
        let lapsed = |(_, renewed)| now.saturating_sub(renewed) > TERM;
        let lapsed = self.held && self.latest.is_some_and(lapsed);
        self.held &= !lapsed;
        lapsed
    }

    /// Ends the lease. The latest order stays known, so that a delayed repetition is refused.
    pub fn release(&mut self) {
        self.held = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn stamp(owner: u16, sequence: u16) -> Stamp {
        Stamp { owner, sequence }
    }

    #[test]
    fn lease_is_taken_renewed_and_lost_to_the_microsecond() {
        const LEASED: Result<(), Denied> = Err(Denied::Leased);
        const OLD: Result<(), Denied> = Err(Denied::OldOrder);
        let mut lease = Lease::default();
        for (now, owner, sequence, expected) in [
            (5_000_000, 1, 7, Ok(())),
            (6_000_000, 2, 9, LEASED),
            // A refused order does not renew the lease.
            (6_000_000, 1, 7, OLD),
            (6_000_001, 2, 1, Ok(())),
            (6_000_001, 1, 9, LEASED),
            (7_000_001, 1, 9, LEASED),
            (7_000_001, 2, 2, Ok(())),
            (8_000_001, 1, 9, LEASED),
            // An old order is refused also after the end of the lease.
            (8_000_002, 2, 2, OLD),
            (8_000_002, 2, 3, Ok(())),
            (3_000_000, 1, 9, LEASED),
            (9_000_002, 1, 9, LEASED),
            (9_000_003, 1, 9, Ok(())),
        ] {
            let found = lease.admit(now, stamp(owner, sequence));
            assert_eq!(found, expected, "{now} {owner} {sequence}");
        }
        // After a release any host may take the lease; earlier orders stay old.
        for (owner, sequence, expected) in
            [(1, 9, OLD), (2, 1, Ok(())), (1, 1, Ok(())), (1, 2, Ok(()))]
        {
            lease.release();
            let found = lease.admit(9_000_004, stamp(owner, sequence));
            assert_eq!(found, expected, "{owner} {sequence}");
        }
    }

    #[test]
    fn lease_lapses_once_more_than_a_second_after_its_latest_order() {
        let mut lease = Lease::default();
        assert!(!lease.take_lapsed(9_000_000));
        for (now, sequence) in [(5_000_000, 7), (7_000_000, 8)] {
            assert_eq!(lease.admit(now, stamp(1, sequence)), Ok(()));
            assert_eq!(lease.admit(now + 999_999, stamp(2, 1)), Err(Denied::Leased));
            for (later, lapsed) in [
                (now - 4_000_000, false),
                (now + 1_000_000, false),
                (now + 1_000_001, true),
                (now + 1_000_002, false),
            ] {
                assert_eq!(lease.take_lapsed(later), lapsed, "{later}");
            }
        }
        for sequence in 9..12 {
            assert_eq!(lease.admit(9_000_000, stamp(1, sequence)), Ok(()));
            assert!(!lease.take_lapsed(10_000_000));
        }
        lease.release();
        assert!(!lease.take_lapsed(90_000_000));
    }

    #[test]
    fn order_is_newer_by_1_to_32767_numbers() {
        for latest in [0, 7, 32_768, u16::MAX] {
            for (ahead, newer) in [
                (0, false),
                (1, true),
                (32_767, true),
                (32_768, false),
                (65_535, false),
            ] {
                let mut lease = Lease::default();
                assert_eq!(lease.admit(0, stamp(1, latest)), Ok(()));
                let expected = if newer { Ok(()) } else { Err(Denied::OldOrder) };
                let found = lease.admit(1, stamp(1, latest.wrapping_add(ahead)));
                assert_eq!(found, expected, "{latest} {ahead}");
            }
        }
    }
}
