//! Messages a node wants to send, in order.

use crate::bus::Message;
use crate::topology::MAX_AXLES;
use heapless::Vec;

/// Largest number of messages that an outbox holds; further messages are dropped. The front board sends most at the
/// lead node's step: heartbeat and status of the lead node, two messages of a reference for each axle, and the
/// heartbeat of its own axle node if its state changes.
pub const CAPACITY: usize = 3 + 2 * MAX_AXLES;

/// A short list of messages; messages that do not fit are dropped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outbox {
    messages: Vec<Message, CAPACITY>,
}

impl Outbox {
    /// An empty list.
    pub fn new() -> Self {
        Self::default()
    }

    /// Appends a message.
    pub fn push(&mut self, message: Message) {
        let _ = self.messages.push(message);
    }

    /// The messages in the order they were appended.
    pub fn iter(&self) -> impl Iterator<Item = &Message> {
        self.messages.iter()
    }

    /// Removes all messages.
    pub fn clear(&mut self) {
        self.messages.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::LeadMode;
    use crate::node::testing::lead_status;
    use crate::time::EPOCH;

    #[test]
    fn keeps_order_and_drops_what_does_not_fit() {
        let mut outbox = Outbox::new();
        let status = |epoch: u64| lead_status(epoch * EPOCH, LeadMode::Idle, 0.0);
        for epoch in 0..15 {
            outbox.push(status(epoch));
        }
        assert!(outbox.iter().copied().eq((0..13).map(status)));
        outbox.clear();
        assert_eq!(outbox.iter().count(), 0);
    }
}
