//! Common time of the boards, estimated from bus frames.

use core_algos::bus::Message;
use core_algos::time::{EPOCH, Micros, TICK};

/// Estimate of the boards' common time, from `TimeSync` messages.
#[derive(Clone, Copy, Debug, Default)]
pub struct Clock {
    epoch: Option<Epoch>,
    /// Time of validity of the lead node's latest estimates, µs.
    estimate_time: Option<Micros>,
}

/// Latest epoch of which a `TimeSync` was received.
#[derive(Clone, Copy, Debug)]
struct Epoch {
    number: u32,
    /// Start of the epoch, µs.
    began_at: Micros,
    /// Arrival of the epoch's `TimeSync`, µs.
    received_at: Micros,
}

impl Clock {
    /// Time of validity of the lead node's latest estimates, µs: the start of their epoch.
    pub fn estimate_time(&self) -> Option<Micros> {
        self.estimate_time
    }

    /// Common time at `at`, µs; 0 before the first epoch.
    pub fn common(&self, at: Micros) -> i64 {
        self.epoch.map_or(0, |epoch| {
            i64::from(epoch.number) * EPOCH as i64 + at as i64 - epoch.began_at as i64
        })
    }

    /// Handles a message whose frame ended at `at`, µs.
    pub fn receive(&mut self, at: Micros, message: &Message) {
        match *message {
            Message::TimeSync {
                epoch,
                last_delay_us,
            } => {
                let began_at = match (self.epoch, last_delay_us) {
                    (Some(last), Some(delay)) if last.number + 1 == epoch => {
                        last.received_at + EPOCH - Micros::from(delay)
                    }
                    // Until the first delay is known, assume that the message leaves within a quarter of a tick.
                    _ => at.saturating_sub(TICK / 4),
                };
                self.epoch = Some(Epoch {
                    number: epoch,
                    began_at,
                    received_at: at,
                });
            }
            Message::LeadStatus { .. } => {
                self.estimate_time = self.epoch.map(|epoch| epoch.began_at)
            }
            _ => {}
        }
    }
}
