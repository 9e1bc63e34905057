//! Operating states and the table of transitions between them.
//!
//! Next state for each state (row) and cause (column); · means no change. With a slash, the first state applies if no
//! condition of class stop or cut is latched, the second otherwise. Notices and degradations change no state.
//!
//! | | Ready | Arm | Start | Finish | Disarm | Clear | Halted | emergency stop | other stop | cut |
//! |---|---|---|---|---|---|---|---|---|---|---|
//! | Boot | Idle / · | · | · | · | · | · | · | Fault | · | Fault |
//! | Idle | · | Armed / · | · | · | · | · | · | Fault | · | Fault |
//! | Armed | · | · | Active | · | SafeStop | · | · | SafeStop | SafeStop | Fault |
//! | Active | · | · | · | Armed | SafeStop | · | · | SafeStop | SafeStop | Fault |
//! | SafeStop | · | · | · | · | · | · | Idle / Fault | · | · | Fault |
//! | Fault | · | · | · | · | · | Idle / · | · | · | · | Fault |
//!
//! Motors are switched on only by request, one step at a time, and never during a fault. While the motors are off, a
//! condition of class stop only prevents arming; an emergency stop is latched in every state.

use super::condition::{Class, Condition};

wire_enum! {
    /// Operating state of a node.
    #[repr(u8)]
    OperatingState {
        /// Self-check; motors off.
        #[default]
        Boot = "boot",
        /// Ready; motors off.
        Idle = "idle",
        /// Motors hold the robot where it is.
        Armed = "armed",
        /// Driving.
        Active = "active",
        /// Slowing down together with the rest of the robot.
        SafeStop = "safe_stop",
        /// Motors off until cleared.
        Fault = "fault",
    }
}

impl OperatingState {
    /// Permit of the motors.
    pub const fn permit(self) -> Permit {
        match self {
            Self::Boot | Self::Idle | Self::Fault => Permit::Off,
            Self::Armed => Permit::Hold,
            Self::Active => Permit::Drive,
            Self::SafeStop => Permit::Brake,
        }
    }
}

/// Permit of the motors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Permit {
    /// No torque.
    #[default]
    Off,
    /// Torque to stay in place.
    Hold,
    /// Torque to come to rest.
    Brake,
    /// Torque to follow references.
    Drive,
}

enumeration! {
    /// Request to a node, by its operator, by the lead node or by itself.
    StateRequest {
        /// The self-check is done.
        Ready,
        /// Switch the motors on.
        Arm,
        /// Begin to drive.
        Start,
        /// End the drive and hold.
        Finish,
        /// Come to rest and switch the motors off.
        Disarm,
        /// Clear latched faults.
        Clear,
        /// The coordinated stop has come to rest, or took too long.
        Halted,
    }
}

/// Event that changes the state of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Request to the node.
    Request(StateRequest),
    /// A condition has held for its hold time.
    Condition(Condition),
}

/// The state after `cause` in `state`. `hard` is true if a condition of class stop or cut is latched or still holds:
/// arming, clearing and the end of a stop depend on it.
pub const fn transition(state: OperatingState, cause: Cause, hard: bool) -> OperatingState {
    use OperatingState::{Active, Armed, Boot, Fault, Idle, SafeStop};
    match cause {
        Cause::Condition(condition) => match (condition.class(), state) {
            (Class::Notice | Class::Degraded, _) => state,
            // Motors are off: the condition only prevents arming. An emergency stop is latched in every state.
            (Class::Stop, Boot | Idle) => match condition {
                Condition::EmergencyStop => Fault,
                _ => state,
            },
            (Class::Stop, Armed | Active | SafeStop) => SafeStop,
            (Class::Stop, Fault) | (Class::Cut, _) => Fault,
        },
        Cause::Request(request) => match (request, state) {
            (StateRequest::Ready, Boot) if !hard => Idle,
            (StateRequest::Arm, Idle) if !hard => Armed,
            (StateRequest::Start, Armed) => Active,
            (StateRequest::Finish, Active) => Armed,
            (StateRequest::Disarm, Armed | Active) => SafeStop,
            (StateRequest::Halted, SafeStop) if hard => Fault,
            (StateRequest::Halted, SafeStop) => Idle,
            (StateRequest::Clear, Fault) if !hard => Idle,
            _ => state,
        },
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Cell of the table in this module's documentation.
    fn cell(state: OperatingState, column: &str) -> &'static str {
        let mut rows = include_str!("state.rs")
            .lines()
            .filter_map(|line| line.strip_prefix("//! |"))
            .map(|line| line.split('|').map(str::trim).collect::<Vec<_>>());
        let head = rows.next().expect("a table");
        let column = head.iter().position(|name| *name == column).expect(column);
        let name = format!("{state:?}");
        rows.find(|row| row[0] == name).expect("a row")[column]
    }

    /// The state that the table demands.
    pub fn demanded(state: OperatingState, cause: Cause, hard: bool) -> OperatingState {
        let request;
        let column = match cause {
            Cause::Request(it) => {
                request = format!("{it:?}");
                &request
            }
            Cause::Condition(Condition::EmergencyStop) => "emergency stop",
            Cause::Condition(condition) => match condition.class() {
                Class::Notice | Class::Degraded => return state,
                Class::Stop => "other stop",
                Class::Cut => "cut",
            },
        };
        let cell = cell(state, column);
        let (free, latched) = cell.split_once(" / ").unwrap_or((cell, cell));
        match if hard { latched } else { free } {
            "·" => state,
            name => OperatingState::ALL
                .into_iter()
                .find(|state| format!("{state:?}") == name)
                .expect(name),
        }
    }

    /// Every state and cause, with and without a latched stop or cut.
    fn all() -> impl Iterator<Item = (OperatingState, Cause, bool)> {
        OperatingState::ALL.into_iter().flat_map(|state| {
            let conditions = Condition::ALL.into_iter().map(Cause::Condition);
            let causes = conditions.chain(StateRequest::ALL.into_iter().map(Cause::Request));
            causes.flat_map(move |cause| [(state, cause, false), (state, cause, true)])
        })
    }

    #[test]
    fn every_transition_matches_the_table() {
        for (state, cause, hard) in all() {
            let next = transition(state, cause, hard);
            assert_eq!(
                next,
                demanded(state, cause, hard),
                "{state:?} {cause:?} {hard}"
            );
        }
        assert_eq!(all().count(), 2 * 6 * (Condition::ALL.len() + 7));
    }

    #[test]
    fn motors_have_the_permit_of_the_state() {
        use OperatingState::{Active, Armed, Boot, Fault, Idle, SafeStop};
        for (permit, states) in [
            (Permit::Off, &[Boot, Idle, Fault][..]),
            (Permit::Hold, &[Armed]),
            (Permit::Drive, &[Active]),
            (Permit::Brake, &[SafeStop]),
        ] {
            assert!(
                states.iter().all(|state| state.permit() == permit),
                "{permit:?}"
            );
        }
    }

    /// From any state any stop or cut ends with motors off once the robot rests.
    #[test]
    fn stopping_always_ends_with_the_motors_off() {
        for state in OperatingState::ALL {
            for condition in Condition::ALL.into_iter().filter(|c| c.class().is_hard()) {
                let mut now = demanded(state, Cause::Condition(condition), true);
                now = demanded(now, Cause::Request(StateRequest::Halted), true);
                assert_eq!(now.permit(), Permit::Off, "{state:?} {condition:?}");
            }
        }
    }

    #[test]
    fn fault_ends_only_by_clearing_after_its_cause_is_gone() {
        for (_, cause, hard) in all().filter(|(state, ..)| *state == OperatingState::Fault) {
            let next = demanded(OperatingState::Fault, cause, hard);
            let cleared = cause == Cause::Request(StateRequest::Clear) && !hard;
            assert_eq!(next == OperatingState::Fault, !cleared, "{cause:?} {hard}");
        }
    }
}
