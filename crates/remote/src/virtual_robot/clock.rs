//! The common time of the boards, as the bus shows it.

use core_algos::bus::Message;
use core_algos::time::{EPOCH, Micros, TICK};

/// The common time.
#[derive(Clone, Copy, Debug, Default)]
pub struct Clock {
    /// Number of the latest epoch, its beginning and the arrival of its message, µs.
    epoch: Option<(u32, Micros, Micros)>,
    /// Time of validity of the lead node's latest estimates, µs.
    held: Option<Micros>,
}

impl Clock {
    /// Time of validity of the lead node's latest estimates: the beginning of its epoch, µs.
    pub fn held(&self) -> Option<Micros> {
        self.held
    }

    /// Common time at `at`, µs.
    pub fn common(&self, at: Micros) -> i64 {
        let since = |(epoch, began, _)| i64::from(epoch) * EPOCH as i64 + at as i64 - began as i64;
        self.epoch.map_or(0, since)
    }

    /// A message whose frame ended at `at`, µs.
    pub fn hear(&mut self, at: Micros, message: &Message) {
        match *message {
            Message::TimeSync {
                epoch,
                last_delay_us,
            } => {
                let began = match (self.epoch, last_delay_us) {
                    (Some((last, _, heard)), Some(delay)) if last + 1 == epoch => {
                        heard + EPOCH - Micros::from(delay)
                    }
                    // Until the first delay is told: the message leaves within a fraction of a tick.
                    _ => at.saturating_sub(TICK / 4),
                };
                self.epoch = Some((epoch, began, at));
            }
            Message::LeadStatus { .. } => self.held = self.epoch.map(|(_, began, _)| began),
            _ => {}
        }
    }
}
