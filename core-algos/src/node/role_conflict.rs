//! Two boards with one role, for example after the strap of the rear board broke or with one stored place.
//!
//! Both would drive as the same axle, and two front boards would both command the robot. A CAN controller does not
//! receive its own frames, so a message in the name of the board's own role comes from another board.
//!
//! Nothing here can fail.

use crate::bus::Message;
use crate::time::Micros;
use crate::topology::Role;

/// Time for which a conflict lasts after the latest message of the other board: ten health reports.
const LASTS: Micros = 1_000_000;

/// Detects another board with the role of this board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoleConflict {
    role: Role,
    latest: Option<Micros>,
}

impl RoleConflict {
    /// Detector for a board with this role.
    pub const fn new(role: Role) -> Self {
        Self { role, latest: None }
    }

    /// Takes a message that arrived at local time `local`.
    pub fn receive(&mut self, local: Micros, message: &Message) {
        if sender(message) == Some(self.role) {
            self.latest = Some(local);
        }
    }

    /// True while another board has this role.
    pub fn is_present(&self, local: Micros) -> bool {
        self.latest
            .is_some_and(|latest| local.saturating_sub(latest) < LASTS)
    }
}

/// Role of the board that sent a message; `None` for a message that does not contain its sender.
fn sender(message: &Message) -> Option<Role> {
    match message {
        Message::BoardHealth { board, .. } | Message::BoardIdentity { board, .. } => Some(*board),
        Message::NodeStatus { node, .. } => node.board(),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::field::Hash24;
    use crate::safety::{Conditions, OperatingState};
    use crate::topology::{MAX_AXLES, Node, Topology};

    fn status(node: Node) -> Message {
        Message::NodeStatus {
            node,
            sequence: 0,
            state: OperatingState::Idle,
            reason: 0,
            notices: Conditions::NONE,
        }
    }

    fn identity(board: Role) -> Message {
        let hash = Hash24::of(&[1]);
        Message::BoardIdentity {
            board,
            sequence: 0,
            chip: hash,
            build: hash,
            schema: 0,
        }
    }

    #[test]
    fn only_messages_in_the_name_of_the_own_role_are_a_conflict() {
        let nodes = [
            (Node::Lead, Role::LEAD),
            (Node::axle(0), Role::LEAD),
            (Node::axle(1), Role::axle(1)),
            (Node::beam(0), Role::beam(0)),
        ];
        let inner = [2, 3, 4].map(|axle| (Node::axle(axle), Role::axle(axle)));
        let frames = [1, 2, 3].map(|frame| (Node::beam(frame), Role::beam(frame)));
        let nodes = nodes.into_iter().chain(inner).chain(frames);
        for own in Topology::new(MAX_AXLES).unwrap().boards() {
            for (node, role) in nodes.clone() {
                let mut conflict = RoleConflict::new(own);
                conflict.receive(5, &status(node));
                assert_eq!(conflict.is_present(5), role == own, "{own:?} {node:?}");
                conflict.receive(6, &identity(role));
                assert_eq!(conflict.is_present(6), role == own, "{own:?} {role:?}");
            }
        }
    }

    #[test]
    fn a_conflict_ends_a_second_after_the_last_message() {
        let mut conflict = RoleConflict::new(Role::axle(1));
        assert!(!conflict.is_present(0));
        conflict.receive(7, &status(Node::axle(1)));
        let present = [7, 1_000_006, 1_000_007].map(|local| conflict.is_present(local));
        assert_eq!(present, [true, true, false]);
    }
}
