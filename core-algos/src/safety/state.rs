//! Operating states and the table of transitions between them.

use super::condition::{Class, Condition};

wire_enum! {
    /// Operating state of a node.
    #[repr(u8)]
    OperatingState {
        /// Checking itself; motors off.
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
        /// Driving is done: hold.
        Finish,
        /// Come to rest and switch the motors off.
        Disarm,
        /// Forget latched faults.
        Clear,
        /// The coordinated stop has come to rest, or took too long.
        Halted,
    }
}

/// Event that changes the state of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Somebody asks.
    Request(StateRequest),
    /// A condition holds and has held for its time.
    Condition(Condition),
}

/// The state after `cause` in `state`. `hard` tells whether a condition of class stop or cut is
/// latched or still holds: arming, clearing and the end of a stop depend on it.
pub const fn transition(state: OperatingState, cause: Cause, hard: bool) -> OperatingState {
    use OperatingState::{Active, Armed, Boot, Fault, Idle, SafeStop};
    match cause {
        Cause::Condition(condition) => match (condition.class(), state) {
            (Class::Notice | Class::Degraded, _) => state,
            // Nothing moves: waiting is enough, and arming is refused while it holds. An emergency
            // stop is latched wherever it comes.
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
mod tests {
    use super::*;
    use OperatingState::{Active, Armed, Boot, Fault, Idle, SafeStop};

    fn causes() -> impl Iterator<Item = Cause> {
        let conditions = Condition::ALL.into_iter().map(Cause::Condition);
        conditions.chain(StateRequest::ALL.into_iter().map(Cause::Request))
    }

    fn all() -> impl Iterator<Item = (OperatingState, Cause, bool)> {
        OperatingState::ALL.into_iter().flat_map(|state| {
            causes().flat_map(move |cause| [(state, cause, false), (state, cause, true)])
        })
    }

    /// Motors come on only along Idle → Armed → Active, each step asked for, none while something
    /// is wrong.
    #[test]
    fn power_comes_by_request_only_and_never_over_a_fault() {
        for (state, cause, hard) in all() {
            let next = transition(state, cause, hard);
            if next == Armed && state != Armed {
                let asked = matches!(
                    (state, cause),
                    (Idle, Cause::Request(StateRequest::Arm))
                        | (Active, Cause::Request(StateRequest::Finish))
                );
                assert!(asked && !(state == Idle && hard), "{state:?} {cause:?}");
            }
            if next == Active && state != Active {
                assert_eq!((state, cause), (Armed, Cause::Request(StateRequest::Start)));
            }
        }
    }

    #[test]
    fn no_hard_condition_leaves_the_robot_driving() {
        for (state, cause, hard) in all() {
            let Cause::Condition(condition) = cause else {
                continue;
            };
            let next = transition(state, cause, hard);
            match condition.class() {
                Class::Notice | Class::Degraded => assert_eq!(next, state),
                Class::Stop => assert!(!matches!(next, Active | Armed), "{state:?} {condition:?}"),
                Class::Cut => assert_eq!(next, Fault, "{state:?} {condition:?}"),
            }
        }
    }

    #[test]
    fn a_fault_is_left_by_clearing_alone_and_only_when_its_cause_is_gone() {
        for (state, cause, hard) in all() {
            if state == Fault && transition(state, cause, hard) != Fault {
                assert_eq!(cause, Cause::Request(StateRequest::Clear));
                assert!(!hard);
                assert_eq!(transition(state, cause, hard), Idle);
            }
        }
    }

    /// From any state any sequence of stops and halts ends with motors off.
    #[test]
    fn stopping_always_ends_with_the_motors_off() {
        for state in OperatingState::ALL {
            for condition in Condition::ALL.into_iter().filter(|c| c.class().is_hard()) {
                let mut now = transition(state, Cause::Condition(condition), true);
                now = transition(now, Cause::Request(StateRequest::Halted), true);
                assert_eq!(now.permit(), Permit::Off, "{state:?} {condition:?}");
            }
        }
    }

    #[test]
    fn the_way_to_drive_and_back() {
        let mut state = Boot;
        for (request, expected) in [
            (StateRequest::Start, Boot),
            (StateRequest::Ready, Idle),
            (StateRequest::Start, Idle),
            (StateRequest::Arm, Armed),
            (StateRequest::Start, Active),
            (StateRequest::Finish, Armed),
            (StateRequest::Start, Active),
            (StateRequest::Disarm, SafeStop),
            (StateRequest::Start, SafeStop),
            (StateRequest::Halted, Idle),
        ] {
            state = transition(state, Cause::Request(request), false);
            assert_eq!(state, expected, "{request:?}");
        }
    }
}
