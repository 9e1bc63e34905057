//! The undisturbed middle of a frame in one step.
//!
//! While one node transmits and all others receive the same bits without error, the protocol has no event before the
//! end of the checksum. Only the sample times of each node and its synchronization to edges remain; they are computed
//! as in single steps. If any condition does not hold, the wire takes single steps; the result is the same.

use super::bus::Wire;
use crate::time::Time;

/// Minimum number of bits for the fast path.
const MIN_BITS: usize = 4;
/// Bits at the end of a frame that need single steps, because nodes may respond: from the last bit before the checksum
/// delimiter on.
const TAIL: usize = 11;

impl Wire {
    /// Processes several bits of the sender in one step, all sampled before `limit`; false if single steps are needed.
    /// The sender must be about to begin a bit, and all other nodes must have sampled the previous bit.
    pub(super) fn fast_forward(&mut self, sender: usize, limit: Time) -> bool {
        let Some((from, to)) = self.stretch(sender, limit) else {
            return false;
        };
        let Some((bits, _)) = self.can_nodes[sender].controller.sending() else {
            return false;
        };
        let bits = *bits;
        // Start times of the bits, and of the bit after them.
        let mut begins = [Time(0); 160];
        let mut clock = self.can_nodes[sender].clock;
        for begin in &mut begins[from..to] {
            *begin = clock.next_time();
            clock.advance(false, false);
            clock.sample();
        }
        begins[to] = clock.next_time();
        let mut clocks = [clock; 8];
        for (can_node, clock) in self.can_nodes.iter().zip(&mut clocks) {
            if !can_node.controller.is_in() || can_node.controller.sending().is_some() {
                continue;
            }
            *clock = can_node.clock;
            for i in from..to {
                if bits.recessive(i - 1) && !bits.recessive(i) {
                    clock.edge(begins[i] + self.delay, false, true);
                }
                clock.advance(false, true);
                let sample = clock.sample_time() - self.delay;
                if sample < begins[i] || sample >= begins[i + 1] {
                    return false;
                }
                clock.sample();
            }
        }
        let mut arrived = *self.can_nodes[sender].controller.arrived();
        for i in from..to {
            arrived.step(!bits.recessive(i));
        }
        for (can_node, clock) in self.can_nodes.iter_mut().zip(clocks) {
            if can_node.controller.is_in() {
                can_node.clock = clock;
                can_node.read = !bits.recessive(to - 1);
                can_node.controller.fast_forward(arrived, to);
                can_node.plan(self.delay);
            }
        }
        self.drive_last_bit(sender);
        true
    }

    /// Bits for the fast path: the sender's next bit, and the end (exclusive); `None` if single steps are needed.
    fn stretch(&self, sender: usize, limit: Time) -> Option<(usize, usize)> {
        let can_node = &self.can_nodes[sender];
        let (bits, from) = can_node.controller.sending()?;
        let to = bits.length().saturating_sub(TAIL);
        let calm = self.forced.is_none() && self.noise.is_off() && self.can_nodes.len() <= 8;
        if !calm || !can_node.clock.sampled || from == 0 || to < from + MIN_BITS {
            return None;
        }
        let reads_back = can_node.transmit_enabled
            && can_node.is_reading()
            && can_node.with(|s| s.transmit_enabled);
        let arrived = can_node.controller.arrived();
        let follow = self.can_nodes.iter().enumerate().all(|(i, other)| {
            i == sender
                || !other.controller.is_in()
                || other.clock.sampled
                    && !other.dominant
                    && other.is_reading()
                    && other.piece == can_node.piece
                    && other.controller.follows(arrived)
        });
        if !reads_back || !follow {
            return None;
        }
        // Other nodes sample later than the sender by less than one bit.
        let span = limit - can_node.clock.next_time();
        let fit = (span.0 / can_node.clock.bit().0.max(1)).saturating_sub(2);
        let to = to.min(from + fit as usize);
        (to >= from + MIN_BITS).then_some((from, to))
    }

    /// Sets the level that the sender drives after the last processed bit.
    fn drive_last_bit(&mut self, sender: usize) {
        let can_node = &mut self.can_nodes[sender];
        let before = std::mem::replace(&mut can_node.dominant, can_node.read);
        match (before, can_node.read) {
            (false, true) => self.drivers[can_node.piece] += 1,
            (true, false) => self.drivers[can_node.piece] -= 1,
            _ => {}
        }
    }
}
