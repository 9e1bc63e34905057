//! Messages a node wants to send, in order.

use crate::bus::Message;
use heapless::Vec;

/// Room for the messages of one step.
pub const CAPACITY: usize = 8;

/// A short list of messages; what does not fit is counted and dropped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outbox {
    messages: Vec<Message, CAPACITY>,
    dropped: u16,
}

impl Outbox {
    /// An empty list.
    pub fn new() -> Self {
        Self::default()
    }

    /// Appends a message.
    pub fn push(&mut self, message: Message) {
        let full = self.messages.push(message).is_err();
        self.dropped = self.dropped.saturating_add(full.into());
    }

    /// The messages in the order they were appended.
    pub fn iter(&self) -> impl Iterator<Item = &Message> {
        self.messages.iter()
    }

    /// Forgets the messages; the count of dropped ones stays.
    pub fn clear(&mut self) {
        self.messages.clear();
    }

    /// Messages that found no room since the list was made.
    pub fn dropped(&self) -> u16 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::LeadMode;

    #[test]
    fn keeps_order_and_counts_what_does_not_fit() {
        let mut outbox = Outbox::new();
        let status = |sequence| Message::LeadStatus {
            sequence,
            mode: LeadMode::Idle,
            steering_rad: 0.0,
            velocity_m_s: 0.0,
        };
        for sequence in 0..10 {
            outbox.push(status(sequence));
        }
        assert_eq!(outbox.dropped(), 2);
        assert!(outbox.iter().copied().eq((0..8).map(status)));
        outbox.clear();
        assert_eq!(outbox.iter().count(), 0);
    }
}
