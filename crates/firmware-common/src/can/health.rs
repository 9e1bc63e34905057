//! Health of the bus: counters, and whether a frame was acknowledged since bus-off.

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, Ordering};

use critical_section::Mutex;

/// Counters of the bus since the start, saturating.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub struct Counters {
    /// Messages that could not be encoded.
    pub refused: u16,
    /// Messages for which a queue had no room, or that became too old to be sent.
    pub dropped: u16,
    /// Received frames that are no message of this bus.
    pub unknown: u16,
    /// Errors that the controller reported, at most one in five milliseconds.
    pub errors: u16,
    /// Overruns of the FIFO; each lost at least one frame.
    pub overrun: u16,
}

impl Counters {
    const NONE: Self = Self {
        refused: 0,
        dropped: 0,
        unknown: 0,
        errors: 0,
        overrun: 0,
    };
}

/// Health of a bus, shared by tick, supervision and interrupt handlers.
pub struct Health {
    counters: Mutex<Cell<Counters>>,
    /// True from bus-off until the next acknowledged frame.
    was_off: AtomicBool,
}

impl Health {
    /// A bus without errors.
    pub const fn new() -> Self {
        Self {
            counters: Mutex::new(Cell::new(Counters::NONE)),
            was_off: AtomicBool::new(false),
        }
    }

    /// Adds one to the counter that `which` selects, saturating.
    pub fn count(&self, which: impl FnOnce(&mut Counters) -> &mut u16) {
        critical_section::with(|cs| {
            let mut counters = self.counters.borrow(cs).get();
            let counter = which(&mut counters);
            *counter = counter.saturating_add(1);
            self.counters.borrow(cs).set(counters);
        });
    }

    /// Counters of the bus since the start.
    pub fn counters(&self) -> Counters {
        critical_section::with(|cs| self.counters.borrow(cs).get())
    }

    /// Records that a frame was acknowledged: the board can send again after bus-off.
    pub fn on_acknowledged(&self) {
        self.was_off.store(false, Ordering::Relaxed);
    }

    /// True if the board cannot send: bus-off at this moment (`bus_off`), or no frame acknowledged since bus-off. On
    /// a dead bus the controller recovers and goes bus-off again every two milliseconds.
    pub fn was_off(&self, bus_off: bool) -> bool {
        if bus_off {
            self.was_off.store(true, Ordering::Relaxed);
        }
        self.was_off.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bus_off_is_remembered_until_a_frame_is_acknowledged() {
        let health = Health::new();
        assert!(!health.was_off(false));
        assert!(health.was_off(true));
        assert!(health.was_off(false));
        health.on_acknowledged();
        assert!(!health.was_off(false));
    }

    #[test]
    fn counters_count_each_event_and_saturate() {
        let health = Health::new();
        for _ in 0..70_000 {
            health.count(|counters| &mut counters.dropped);
        }
        health.count(|counters| &mut counters.errors);
        let expected = Counters {
            dropped: u16::MAX,
            errors: 1,
            ..Counters::NONE
        };
        assert_eq!(health.counters(), expected);
    }
}
