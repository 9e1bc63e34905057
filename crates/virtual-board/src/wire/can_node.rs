//! A node on the bus: clock, levels, transceiver.

use super::controller::Controller;
use super::node::Settings;
use super::timing::{BitClock, BitTiming};
use crate::time::Time;

#[derive(Clone)]
pub(super) struct CanNode {
    pub controller: Controller,
    pub clock: BitClock,
    /// True if the node drives dominant.
    pub dominant: bool,
    /// Level that the node read last; true is dominant.
    pub read: bool,
    pub transmit_enabled: bool,
    pub receive_enabled: bool,
    pub piece: usize,
    /// Time of the node's next event, as seen on the bus.
    pub due: Time,
}

impl CanNode {
    pub fn new() -> Self {
        Self {
            controller: Controller::default(),
            clock: BitClock::new(BitTiming::megabit(), Time(0)),
            dominant: false,
            read: false,
            transmit_enabled: true,
            receive_enabled: true,
            piece: 0,
            due: Time::NEVER,
        }
    }

    pub fn with(&self, of: impl Fn(&Settings) -> bool) -> bool {
        self.controller.settings().is_some_and(of)
    }

    /// True if the node's dominant level reaches the bus.
    pub fn is_driving(&self) -> bool {
        self.dominant && self.transmit_enabled && self.with(|s| s.transmit_enabled)
    }

    /// True if the node reads the bus.
    pub fn is_reading(&self) -> bool {
        self.receive_enabled && self.with(|s| s.receive_enabled)
    }

    pub fn plan(&mut self, delay: Time) {
        self.due = if !self.controller.is_in() {
            Time::NEVER
        } else if self.clock.sampled {
            self.clock.next_time()
        } else {
            self.clock.sample_time() - delay
        };
    }
}

/// Random errors of the bits that a node reads.
#[derive(Clone)]
pub(super) struct Noise {
    rate: f64,
    state: u64,
    /// Number of correct bits left before the next error.
    left: u64,
}

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self {
            rate: 0.0,
            state: seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1,
            left: u64::MAX,
        }
    }

    pub fn is_off(&self) -> bool {
        self.rate == 0.0
    }

    pub fn set(&mut self, rate: f64) {
        self.rate = rate;
        self.draw();
    }

    /// Draws the number of correct bits before an error from a geometric distribution.
    fn draw(&mut self) {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        let uniform = ((self.state >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
        self.left = if self.rate > 0.0 {
            (libm::log(uniform) / libm::log1p(-self.rate.min(1.0))) as u64
        } else {
            u64::MAX
        };
    }

    pub fn next_bit_flips(&mut self) -> bool {
        if self.left > 0 {
            self.left -= 1;
            return false;
        }
        self.draw();
        true
    }
}
