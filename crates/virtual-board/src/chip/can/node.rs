//! The chip as a node on the bus.

use super::super::{Chip, Signal};
use crate::finding::FindingKind;
use crate::time::Time;
use crate::wire::{Action, Event, Node};

impl Chip {
    /// Messages lost because a receive FIFO was full.
    pub fn can_overruns(&self) -> u64 {
        self.units.can1.lost()
    }

    /// True if a signal of the controller is routed to a pin; records a finding if not.
    fn is_routed(&mut self, signal: Signal, name: &str) -> bool {
        let found = self.units.gpio.pin_of(signal).is_some();
        if !found {
            let text = format!("CAN1 is on the bus without a pin for {name}");
            self.shared.note(FindingKind::Pin, text);
        }
        found
    }
}

impl Node for Chip {
    fn take_action(&mut self) -> Option<(Time, Action)> {
        let (at, mut action) = self.units.can1.actions.pop_front()?;
        if let Action::Set(settings) = &mut action
            && settings.on
        {
            settings.transmit_enabled = self.is_routed(Signal::Can1Tx, "CAN1_TX");
            settings.receive_enabled = self.is_routed(Signal::Can1Rx, "CAN1_RX");
        }
        Some((at, action))
    }

    fn event(&mut self, event: Event) {
        self.units.can1.post(event, &mut self.shared);
    }
}
