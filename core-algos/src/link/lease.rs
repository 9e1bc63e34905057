//! Lease: one host at a time commands the robot, any number may watch.
//!
//! The first order of a host takes the lease, each further order renews it. It ends when the host releases it, or lapses after
//! [`TERM`] without an order.

use crate::time::Micros;
use serde::{Deserialize, Serialize};

/// Time after the latest order at which the lease ends.
pub const TERM: Micros = 1_000_000;

/// Sender and place of an order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Number that a host draws at its start.
    pub owner: u16,
    /// Number of the order; it grows by at least one and begins again after 65535.
    pub sequence: u16,
}

/// Why an order is not admitted.
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
    /// The latest order, and its time.
    latest: Option<(Stamp, Micros)>,
    /// True from an order to the end of the lease.
    held: bool,
}

impl Lease {
    /// Admits an order that arrived at `now`. Refuses that of another host while the lease lasts, and one that is not newer
    /// than the latest.
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

    /// True once after a lease that lapsed.
    pub fn take_lapsed(&mut self, now: Micros) -> bool {
        let lapsed = |(_, renewed)| now.saturating_sub(renewed) > TERM;
        let lapsed = self.held && self.latest.is_some_and(lapsed);
        self.held &= !lapsed;
        lapsed
    }

    /// Ends the lease. The latest order stays known: a repetition that comes late is refused.
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
    fn order_of_another_host_is_refused_until_the_lease_ends() {
        let mut lease = Lease::default();
        let began = 5 * TERM;
        assert_eq!(lease.admit(began, stamp(1, 7)), Ok(()));
        assert_eq!(lease.admit(began + TERM, stamp(2, 9)), Err(Denied::Leased));
        assert_eq!(lease.admit(began + TERM, stamp(1, 8)), Ok(()));
        assert_eq!(lease.admit(began + 2 * TERM + 1, stamp(2, 1)), Ok(()));
        let former = lease.admit(began + 2 * TERM + 2, stamp(1, 9));
        assert_eq!(former, Err(Denied::Leased));
        lease.release();
        assert_eq!(lease.admit(began + 2 * TERM + 3, stamp(1, 9)), Ok(()));
    }

    #[test]
    fn lease_lapses_once_and_not_after_its_release() {
        let mut lease = Lease::default();
        assert!(!lease.take_lapsed(9 * TERM));
        assert_eq!(lease.admit(0, stamp(1, 7)), Ok(()));
        assert!(!lease.take_lapsed(TERM));
        assert!(lease.take_lapsed(TERM + 1));
        assert!(!lease.take_lapsed(TERM + 2));
        assert_eq!(lease.admit(2 * TERM, stamp(1, 8)), Ok(()));
        lease.release();
        assert!(!lease.take_lapsed(9 * TERM));
    }

    #[test]
    fn order_with_old_sequence_is_refused() {
        let mut lease = Lease::default();
        assert_eq!(lease.admit(0, stamp(1, u16::MAX)), Ok(()));
        for old in [u16::MAX, u16::MAX - 1, 0x8000] {
            assert_eq!(lease.admit(1, stamp(1, old)), Err(Denied::OldOrder));
        }
        assert_eq!(lease.admit(1, stamp(1, 0)), Ok(()));
        // A host that came back after the end of its lease is no other one.
        assert_eq!(lease.admit(10 * TERM, stamp(1, 0)), Err(Denied::OldOrder));
        assert_eq!(lease.admit(10 * TERM, stamp(1, 1)), Ok(()));
    }

    #[test]
    fn order_from_before_the_release_is_refused_after_it() {
        let mut lease = Lease::default();
        for sequence in [7, 8] {
            assert_eq!(lease.admit(0, stamp(1, sequence)), Ok(()));
        }
        lease.release();
        assert_eq!(lease.admit(1, stamp(1, 7)), Err(Denied::OldOrder));
        assert_eq!(lease.admit(1, stamp(1, 9)), Ok(()));
    }
}
