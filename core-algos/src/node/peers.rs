//! Heartbeats of the other nodes.

use crate::bus::Message;
use crate::bus::layout;
use crate::safety::{OperatingState, supervisor};
use crate::time::{Micros, Stamped, sequence};
use crate::topology::{MAX_AXLES, Node, Topology};

/// Largest number of nodes that drive: lead node and axles. Heartbeats of frames are not watched.
const MOST: usize = 1 + MAX_AXLES;

/// Age above which a heartbeat no longer counts, µs.
const TIMEOUT: Micros = layout::timeout_ms(layout::id::NODE_STATUS) as Micros * 1000;

/// Index of a node's heartbeat; beyond the list for a node that is not watched.
const fn place(node: Node) -> usize {
    match node {
        Node::Lead => 0,
        Node::Axle(axle) => 1 + axle.index(),
        Node::Beam(_) | Node::Service => MOST,
    }
}

/// The latest heartbeat of one node.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Heartbeat {
    state: OperatingState,
    reason: u8,
}

impl Heartbeat {
    /// True if the node reports that it is stopping or has stopped for a reason.
    fn failed(&self) -> bool {
        let stopped = matches!(self.state, OperatingState::SafeStop | OperatingState::Fault);
        stopped && self.reason != 0
    }
}

/// The latest heartbeat of every node that drives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Peers {
    heartbeats: [Option<Stamped<Heartbeat>>; MOST],
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
            && let Some(slot) = self.heartbeats.get_mut(place(node))
        {
            *slot = Some(Stamped::new(Heartbeat { state, reason }, now));
        }
    }

    /// The latest heartbeat of a node; `None` if it is older than the timeout or never arrived.
    fn latest(&self, node: Node, now: Micros) -> Option<&Heartbeat> {
        self.heartbeats
            .get(place(node))?
            .as_ref()?
            .fresh(now, TIMEOUT)
    }

    /// Two flags over all axles except the node `own`: an axle is lost, an axle has failed.
    pub fn others(&self, own: Node, topology: Topology, now: Micros) -> (bool, bool) {
        let (mut lost, mut failed) = (false, false);
        let axles = self.heartbeats.iter().skip(1).zip(topology.axles());
        for (heartbeat, axle) in axles {
            if Node::Axle(axle) != own {
                match heartbeat.as_ref().and_then(|beat| beat.fresh(now, TIMEOUT)) {
                    Some(beat) => failed |= beat.failed(),
                    None => lost = true,
                }
            }
        }
        (lost, failed)
    }

    /// True if the node reports *boot* or *idle*: motors off and not armed.
    pub fn rests(&self, node: Node, now: Micros) -> bool {
        let rests = |state| matches!(state, OperatingState::Boot | OperatingState::Idle);
        self.latest(node, now).is_some_and(|beat| rests(beat.state))
    }

    /// True if the node reports that it is stopping or has stopped for a reason.
    pub fn failed(&self, node: Node, now: Micros) -> bool {
        self.latest(node, now).is_some_and(Heartbeat::failed)
    }
}

/// The heartbeat of `node` at `now`, with all notices since the heartbeat before.
pub fn heartbeat(node: Node, now: Micros, state: &mut supervisor::State) -> Message {
    Message::NodeStatus {
        node,
        sequence: sequence(now),
        state: state.operating(),
        reason: state.first().map_or(0, |condition| condition.code()),
        notices: state.take_occurred().soft(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::testing::beat;
    use crate::safety::Condition;

    #[test]
    fn a_silent_axle_is_lost_and_a_sending_one_is_not() {
        let lost = |peers: &Peers, own, now| peers.others(own, Topology::PAIR, now).0;
        let mut peers = Peers::default();
        assert!(lost(&peers, Node::axle(0), 0), "never heard");
        peers.receive(1_000_000, &beat(Node::axle(1), 0, OperatingState::Idle, 0));
        assert!(!lost(&peers, Node::axle(0), 1_050_000));
        assert!(lost(&peers, Node::axle(0), 1_050_001));
        assert!(lost(&peers, Node::axle(1), 1_000_000));
        assert!(lost(&peers, Node::Lead, 1_000_000));
    }

    /// One axle of three is silent or stops. The axle itself does not count; the lead node counts all.
    #[test]
    fn one_axle_is_lost_or_failed_for_all_nodes_except_its_own() {
        let robot = Topology::new(3).unwrap();
        let reason = Condition::SupplyLow.code();
        for axle in robot.axles().map(Node::Axle) {
            let mut silent = Peers::default();
            for other in robot.axles().map(Node::Axle).filter(|other| *other != axle) {
                silent.receive(0, &beat(other, 0, OperatingState::Active, 0));
            }
            let mut failed = silent;
            failed.receive(0, &beat(axle, 0, OperatingState::Fault, reason));
            for own in robot.axles().map(Node::Axle).chain([Node::Lead]) {
                let counts = own != axle;
                assert_eq!(silent.others(own, robot, 0), (counts, false), "{own:?}");
                assert_eq!(failed.others(own, robot, 0), (false, counts), "{own:?}");
            }
        }
    }

    #[test]
    fn node_rests_if_its_heartbeat_reports_boot_or_idle() {
        let mut peers = Peers::default();
        assert!(!peers.rests(Node::axle(1), 0), "never heard");
        for (state, rests) in [
            (OperatingState::Boot, true),
            (OperatingState::Idle, true),
            (OperatingState::Armed, false),
            (OperatingState::Active, false),
            (OperatingState::SafeStop, false),
        ] {
            peers.receive(0, &beat(Node::axle(1), 0, state, 0));
            assert_eq!(peers.rests(Node::axle(1), 10), rests, "{state:?}");
        }
        peers.receive(0, &beat(Node::axle(1), 0, OperatingState::Idle, 0));
        assert!(!peers.rests(Node::axle(1), 50_001), "lost");
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
