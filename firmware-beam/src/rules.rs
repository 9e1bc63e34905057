//! Rules of the tick without access to hardware.

use core_algos::bus::{LeadMode, Message};
use core_algos::safety::Permit;
use core_algos::time::{Micros, TICK};

/// Time since the last message that shows or commands motors on, after which the motors count as off: twice the timeout
/// of a heartbeat.
const MOTORS_OFF: Micros = 100 * TICK;

/// Local time of the latest message that shows or commands motors on; `None` before the first.
#[derive(Clone, Copy, Debug, Default)]
pub struct Motors(Option<Micros>);

impl Motors {
    /// Takes a message that arrived at local time `local`.
    pub fn receive(&mut self, local: Micros, message: &Message) {
        let on = match message {
            Message::LeadStatus { mode, .. } => matches!(mode, LeadMode::Active | LeadMode::Hold),
            Message::NodeStatus { state, .. } => state.permit() != Permit::Off,
            _ => false,
        };
        if on {
            self.0 = Some(local);
        }
    }

    /// True if the motors are off at local time `local`.
    pub fn are_off(&self, local: Micros) -> bool {
        self.0
            .is_none_or(|last| local.saturating_sub(last) > MOTORS_OFF)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::safety::{Conditions, OperatingState};
    use core_algos::topology::Node;

    fn lead(mode: LeadMode) -> Message {
        Message::LeadStatus {
            sequence: 0,
            mode,
            steering_rad: 0.0,
            velocity_m_s: 0.0,
        }
    }

    fn status(state: OperatingState) -> Message {
        Message::NodeStatus {
            node: Node::Lead,
            sequence: 0,
            state,
            reason: 0,
            notices: Conditions::NONE,
        }
    }

    #[test]
    fn motors_count_as_on_for_100_ms_after_a_message_that_shows_them_on() {
        for (message, on) in [
            (lead(LeadMode::Active), true),
            (lead(LeadMode::Hold), true),
            (lead(LeadMode::Idle), false),
            (status(OperatingState::SafeStop), true),
            (status(OperatingState::Idle), false),
            (status(OperatingState::Fault), false),
        ] {
            let mut motors = Motors::default();
            assert!(motors.are_off(0));
            motors.receive(7_000, &message);
            let off = [7_000, 107_000, 107_001].map(|local| motors.are_off(local));
            assert_eq!(off, [!on, !on, true], "{message:?}");
        }
    }
}
