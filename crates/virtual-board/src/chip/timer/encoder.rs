//! Input levels, and counting of encoders on all edges (RM0090, 18.3.12).

use super::Timer;
use super::counter::Turn;
use super::input::{self, Filter};
use super::registers::*;
use crate::chip::pin::Signal;
use crate::chip::shared::Shared;

impl Timer {
    /// True if the timer counts an encoder.
    pub(super) fn is_encoder(&self) -> bool {
        self.reg(SMCR) & 7 == ENCODER
    }

    /// Handles a new level of an input.
    pub fn input(&mut self, signal: Signal, level: bool, shared: &mut Shared) {
        if signal == Signal::Tim1Bkin {
            self.break_level = level;
            if self.is_broken() {
                self.sync(shared);
                self.do_break(shared);
                self.plan(shared);
            }
            return;
        }
        let channels = Signal::CHANNELS[self.id as usize];
        let Some(which) = channels.iter().position(|&channel| channel == signal) else {
            return;
        };
        if !self.is_encoder() || which > 1 {
            return self.inputs[which].follow(level);
        }
        let bits = match self.is_output(which) {
            true => 0,
            false => self.mode_bits(which) >> 4,
        };
        let filter = Filter::of(bits, self.counter.clock(), self.sampling());
        if self.inputs[which].change(level, filter, shared.now) {
            self.encoder_edge(which, shared);
        }
        self.timed = true;
        self.plan(shared);
    }

    /// Counts an edge of an encoder input behind its filter.
    pub(super) fn encoder_edge(&mut self, which: usize, shared: &mut Shared) {
        if !self.is_encoder() || self.reg(CR1) & CEN == 0 || self.frozen || self.gated {
            return;
        }
        let ccer = self.reg(CCER);
        let levels = [0, 1].map(|k| self.inputs[k].level != (ccer >> (4 * k + 1) & 1 != 0));
        let by = input::counts(which, levels[which], levels[1 - which]);
        let (now, reload) = (shared.now, self.counter.reload);
        let count = self.counter.value(now);
        self.counter.up = by > 0;
        let (next, turn) = match by {
            1 if count == reload => (0, Some(Turn::Overflow)),
            -1 if count == 0 => (reload, Some(Turn::Underflow)),
            _ => (count.wrapping_add_signed(by) & self.id.max_count(), None),
        };
        self.counter.set(next, now);
        if let Some(turn) = turn {
            self.ended(turn, shared);
        }
        for k in 0..4 {
            if self.channels[k].compare == next {
                self.matched(k, shared);
            }
            self.compare(k, next, shared);
        }
    }
}
