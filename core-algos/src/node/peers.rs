//! Heartbeats of the other nodes.

use crate::bus::Message;
use crate::bus::layout;
use crate::safety::{OperatingState, supervisor};
use crate::time::{Micros, Stamped, sequence};
use crate::topology::Node;

/// Nodes of a robot that send heartbeats.
const COUNT: usize = 4;

/// The latest heartbeat of one node.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Heartbeat {
    state: OperatingState,
    reason: u8,
}

/// The latest heartbeat of every node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Peers {
    heard: [Option<Stamped<Heartbeat>>; COUNT],
}

impl Peers {
    /// Takes in a message that arrived at `now`; other messages than heartbeats are ignored.
    pub fn receive(&mut self, now: Micros, message: &Message) {
        if let Message::NodeStatus {
            node,
            state,
            reason,
            ..
        } = *message
            && let Some(slot) = self.heard.get_mut(node as usize)
        {
            *slot = Some(Stamped::new(Heartbeat { state, reason }, now));
        }
    }

    fn fresh(&self, node: Node, now: Micros) -> Option<&Heartbeat> {
        let timeout = (layout::timeout_s(layout::id::NODE_STATUS) * 1e6) as Micros;
        self.heard.get(node as usize)?.as_ref()?.fresh(now, timeout)
    }

    /// True if the node has not been heard for the time of its heartbeat, or never.
    pub fn lost(&self, node: Node, now: Micros) -> bool {
        self.fresh(node, now).is_none()
    }

    /// True if the node says that its motors are off and that it is not to drive.
    pub fn rests(&self, node: Node, now: Micros) -> bool {
        let rests = |state| matches!(state, OperatingState::Boot | OperatingState::Idle);
        self.fresh(node, now).is_some_and(|beat| rests(beat.state))
    }

    /// True if the node says that it is stopping or has stopped because something is wrong.
    pub fn failed(&self, node: Node, now: Micros) -> bool {
        self.fresh(node, now).is_some_and(|beat| {
            let stopped = matches!(beat.state, OperatingState::SafeStop | OperatingState::Fault);
            stopped && beat.reason != 0
        })
    }
}

/// The heartbeat of `node` at `now`: its notices are all since the one before.
pub fn heartbeat(node: Node, now: Micros, state: &mut supervisor::State) -> Message {
    Message::NodeStatus {
        node,
        sequence: sequence(now),
        state: state.operating(),
        reason: state.first().map_or(0, |condition| condition.code()),
        notices: state.take_seen().soft(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::testing::beat;
    use crate::safety::Condition;

    #[test]
    fn a_silent_node_is_lost_and_a_speaking_one_is_not() {
        let mut peers = Peers::default();
        assert!(peers.lost(Node::RearAxle, 0), "never heard");
        peers.receive(1_000_000, &beat(Node::RearAxle, 0, OperatingState::Idle, 0));
        assert!(!peers.lost(Node::RearAxle, 1_050_000));
        assert!(peers.lost(Node::RearAxle, 1_050_001));
        assert!(peers.lost(Node::FrontAxle, 1_000_000));
    }

    #[test]
    fn a_node_rests_that_is_heard_and_does_not_drive() {
        let mut peers = Peers::default();
        assert!(!peers.rests(Node::RearAxle, 0), "never heard");
        for (state, rests) in [
            (OperatingState::Boot, true),
            (OperatingState::Idle, true),
            (OperatingState::Armed, false),
            (OperatingState::Active, false),
            (OperatingState::SafeStop, false),
        ] {
            peers.receive(0, &beat(Node::RearAxle, 0, state, 0));
            assert_eq!(peers.rests(Node::RearAxle, 10), rests, "{state:?}");
        }
        peers.receive(0, &beat(Node::RearAxle, 0, OperatingState::Idle, 0));
        assert!(!peers.rests(Node::RearAxle, 50_001), "lost");
    }

    #[test]
    fn only_a_stop_with_a_reason_is_a_failure() {
        let reason = Condition::SupplyLow.code();
        for (state, code, failed) in [
            (OperatingState::SafeStop, reason, true),
            (OperatingState::Fault, reason, true),
            (OperatingState::SafeStop, 0, false),
            (OperatingState::Idle, reason, false),
            (OperatingState::Active, 0, false),
        ] {
            let mut peers = Peers::default();
            peers.receive(0, &beat(Node::Lead, 0, state, code));
            assert_eq!(peers.failed(Node::Lead, 10), failed, "{state:?} {code}");
        }
    }
}
