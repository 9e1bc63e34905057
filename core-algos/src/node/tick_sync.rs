//! Schedule of a board's nodes: ticks in step with the common time, gaps, and the messages that synchronise the
//! boards.
//!
//! The front board's local time is the common time; the other boards follow by [`CommonClock`]. A tick runs the nodes
//! if it is within 0.1 ms of its whole millisecond, or within 0.05 ms if the tick before was out of step. A gap of up
//! to 5 ms is counted and passed over. After a longer gap, or a step of the common time, the nodes restart with
//! motors off, because no time in their states is valid.
//!
//! Nothing here can fail.

use super::clock::{CommonClock, Tick};
use crate::bus::Message;
use crate::safety::{Condition, Conditions};
use crate::time::{EPOCH, Micros, TICK, is_epoch_start};

/// Longest time between two runs without a restart.
const PASSED_OVER: Micros = 5 * TICK;

/// Action of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TickStep {
    /// The common time is not known or the tick is not in step with it: nothing may be driven.
    Wait,
    /// Run the nodes at this common time.
    Run(Micros),
    /// Restart the nodes, then run them at this common time.
    Restart(Micros),
}

/// Tick synchronisation of one board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickSync {
    /// Common time from the front board's messages; `None` on the front board.
    clock: Option<CommonClock>,
    last: Option<Micros>,
    in_step: bool,
    trim: i8,
    epoch_began: Option<Micros>,
    sent: Option<Micros>,
    missed: u16,
    restarts: u16,
    conditions: Conditions,
}

impl TickSync {
    const fn new(clock: Option<CommonClock>) -> Self {
        Self {
            clock,
            last: None,
            in_step: false,
            trim: 0,
            epoch_began: None,
            sent: None,
            missed: 0,
            restarts: 0,
            conditions: Conditions::NONE,
        }
    }

    /// Tick synchronisation of the front board, whose local time is the common time.
    pub const fn leading() -> Self {
        Self::new(None)
    }

    /// Tick synchronisation of a board that follows the front board.
    pub fn following() -> Self {
        Self::new(Some(CommonClock::default()))
    }

    /// Takes in a message that arrived at local time `local`.
    pub fn receive(&mut self, local: Micros, message: &Message) {
        if let Some(clock) = &mut self.clock {
            clock.receive(local, message);
        }
    }

    /// Decides on the tick at local time `local`.
    pub fn step(&mut self, local: Micros) -> TickStep {
        let common = match &self.clock {
            None => Some(local),
            Some(clock) => clock.common(local),
        };
        let tick = common.map(Tick::of);
        self.trim = tick.map_or(0, |tick| tick.trim());
        let before = self.in_step;
        let near = tick.filter(|tick| tick.in_step(before));
        let now = near.map(|tick| tick.now);
        self.in_step = now.is_some();
        self.conditions = Conditions::NONE;
        let Some(now) = now else {
            return TickStep::Wait;
        };
        let last = self.last.replace(now);
        let passed = last.map_or(TICK, |last| now.saturating_sub(last));
        if passed == TICK {
            TickStep::Run(now)
        } else if passed > TICK && passed <= PASSED_OVER {
            let missed = (passed / TICK - 1) as u16;
            self.missed = self.missed.saturating_add(missed);
            self.conditions.set(Condition::TickLate, true);
            self.conditions.set(Condition::TickOverrun, true);
            TickStep::Run(now)
        } else {
            self.restarts = self.restarts.saturating_add(1);
            self.conditions.set(Condition::ClockStepped, true);
            TickStep::Restart(now)
        }
    }

    /// Conditions of the latest tick.
    pub fn conditions(&self) -> Conditions {
        self.conditions
    }

    /// Message that the front board sends first at `now`; to be called at every tick that runs. `sent` is the local
    /// time at which the latest [`Message::TimeSync`] had left, once it is known.
    pub fn sync(&mut self, now: Micros, sent: Option<Micros>) -> Option<Message> {
        self.sent = sent.or(self.sent);
        if self.clock.is_some() || !is_epoch_start(now) {
            return None;
        }
        let began = self.epoch_began.replace(now);
        let last_delay_us = match (began, self.sent.take()) {
            // A `TimeSync` carries only the delay of the epoch directly before.
            (Some(began), Some(sent)) if began + EPOCH == now => sent
                .checked_sub(began)
                .filter(|&delay| delay < EPOCH)
                .map(|delay| delay as u16),
            _ => None,
        };
        Some(Message::TimeSync {
            epoch: (now / EPOCH) as u32,
            last_delay_us,
        })
    }

    /// Counts by which the period of the board's timer is to differ from the nominal period until the next tick: −1, 0
    /// or 1 near the millisecond, −4 or 4 far from the millisecond.
    pub fn trim(&self) -> i8 {
        self.trim
    }

    /// True if the latest tick ran the nodes.
    pub fn in_step(&self) -> bool {
        self.in_step
    }

    /// Common time of the latest tick that ran the nodes; `None` before the first.
    pub fn last(&self) -> Option<Micros> {
        self.last
    }

    /// Missed ticks that were passed over, saturating.
    pub fn missed(&self) -> u16 {
        self.missed
    }

    /// Restarts of the nodes, saturating.
    pub fn restarts(&self) -> u16 {
        self.restarts
    }
}

#[cfg(test)]
mod tests;
