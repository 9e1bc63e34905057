//! Nodes of one board: an axle node (on the front board with the lead node beside it) or the beam node.
//!
//! A board takes in the messages that arrived, then the samples of a tick. This module fixes the order, so that
//! simulation, serial link and firmware run a board alike.
//!
//! # Panic contract
//!
//! [`Ready::new`] validates, and [`Board::new`] through it; nothing else can fail.
//!
//! # Example
//!
//! ```
//! use core_algos::bus::Message;
//! use core_algos::node::board::{Board, Samples};
//! use core_algos::node::robot::RobotConfig;
//! use core_algos::node::{Outbox, axle};
//! use core_algos::time::TICK;
//! use core_algos::topology::{Role, Wheels};
//!
//! let mut board = Board::new(&RobotConfig::default(), Role::axle(1))?;
//! let mut outbox = Outbox::new();
//! for tick in 0..11 {
//!     outbox.clear();
//!     let samples = axle::Samples { encoder: Wheels::both(Some(0)), ..axle::Samples::default() };
//!     // Messages from the bus would go to board.receive first.
//!     let output = board.step(tick * TICK, &Samples::Axle(samples), &mut outbox);
//!     assert_eq!(output.torque_nm, Wheels::both(0.0), "nobody asks it to drive");
//! }
//! // The eleventh tick begins an epoch: the board reports its posture and its status.
//! assert!(outbox.iter().any(|message| matches!(message, Message::AxlePosture { .. })));
//! assert!(outbox.iter().any(|message| matches!(message, Message::NodeStatus { .. })));
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

use super::Outbox;
use super::axle::{self, AxleNode};
use super::beam::{self, BeamNode};
use super::lead::{self, LeadNode, Own};
use super::robot::RobotConfig;
use crate::bus::Message;
use crate::config::ConfigError;
use crate::time::{Micros, since_epoch_start};
use crate::topology::{Role, Wheels};

/// Readings of a board's sensors at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Samples {
    /// Encoders and inertial sensors of an axle.
    Axle(axle::Samples),
    /// Strain bridges.
    Beam(beam::Samples),
}

/// Output of a board at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// Wheel torques, N m; zero on the beam board.
    pub torque_nm: Wheels<f32>,
    /// True if the axle follows a reference; otherwise its motors are off.
    pub active: bool,
    /// True if latched faults of the board's drivers are to be cleared.
    pub clear: bool,
    /// Output of the lead node, at the ticks of its step.
    pub lead: Option<lead::Output>,
}

/// The nodes of one board.
// The larger variant cannot be boxed without a heap.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, PartialEq)]
pub enum Board {
    /// Board of an axle.
    Axle {
        /// Node of the axle.
        axle: AxleNode,
        /// The lead node, on one board of a robot.
        lead: Option<LeadNode>,
    },
    /// Board of an instrumented frame.
    Beam(BeamNode),
}

/// Checked configuration of a board: building the nodes from it cannot fail. Nodes are large and a
/// board's stack is small, so [`Self::begin`] is called where the nodes are to stay.
// The larger variant cannot be boxed without a heap.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ready {
    /// Parts of a [`Board::Axle`].
    Axle {
        /// Node of the axle.
        axle: AxleNode,
        /// Algorithms of the lead node, if the board has it.
        lead: Option<lead::Algorithms>,
    },
    /// Node of a [`Board::Beam`].
    Beam(BeamNode),
}

impl Ready {
    /// Checks a configuration; the error names the parameter that is wrong.
    pub fn new(config: &RobotConfig, role: Role) -> Result<Self, ConfigError> {
        Ok(match role {
            Role::Axle(axle) => Self::Axle {
                axle: config.build_axle(axle)?,
                lead: match role {
                    Role::LEAD => Some(config.build_lead()?),
                    _ => None,
                },
            },
            Role::Beam(frame) => Self::Beam(config.build_beam(frame)?),
        })
    }

    /// Builds the nodes, at rest.
    pub fn begin(self) -> Board {
        match self {
            Self::Axle {
                axle,
                lead: Some(lead),
            } => Board::Axle {
                axle,
                lead: Some(LeadNode::new(lead)),
            },
            Self::Axle { axle, lead: None } => Board::Axle { axle, lead: None },
            Self::Beam(beam) => Board::Beam(beam),
        }
    }
}

impl Ready {
    /// [`Self::begin`] in `place`, without the nodes on the stack.
    pub fn begin_in(self, place: &mut Option<Board>) -> &mut Board {
        let (own, lead) = match self {
            Self::Axle { axle, lead } => (Board::Axle { axle, lead: None }, lead),
            Self::Beam(beam) => (Board::Beam(beam), None),
        };
        let board = place.insert(own);
        if let (Board::Axle { lead: slot, .. }, Some(lead)) = (&mut *board, lead) {
            LeadNode::new_in(slot, lead);
        }
        board
    }
}

impl Board {
    /// Builds the nodes of a board, at rest; the error names the parameter that is wrong.
    pub fn new(config: &RobotConfig, role: Role) -> Result<Self, ConfigError> {
        Ready::new(config, role).map(Ready::begin)
    }

    /// Resets the board to the state of [`Self::new`] with the same configuration.
    pub fn restart(&mut self) {
        match self {
            Self::Axle { axle, lead } => {
                axle.restart();
                if let Some(lead) = lead {
                    lead.restart();
                }
            }
            Self::Beam(beam) => beam.restart(),
        }
    }

    /// Role of this board.
    pub fn role(&self) -> Role {
        match self {
            Self::Axle { axle, .. } => Role::Axle(axle.axle()),
            Self::Beam(beam) => Role::Beam(beam.frame()),
        }
    }

    /// The lead node, if the board has it.
    pub fn lead(&mut self) -> Option<&mut LeadNode> {
        match self {
            Self::Axle { lead, .. } => lead.as_mut(),
            Self::Beam(_) => None,
        }
    }

    /// Takes in a message that arrived at `now`.
    pub fn receive(&mut self, now: Micros, message: &Message) {
        match self {
            Self::Axle { axle, lead } => {
                axle.receive(now, message);
                if let Some(lead) = lead {
                    lead.receive(now, message);
                }
            }
            Self::Beam(beam) => beam.receive(message),
        }
    }

    /// Runs one tick at `now`; messages of the nodes are appended to `outbox`. Samples of another kind of board count
    /// as missing.
    pub fn step(&mut self, now: Micros, samples: &Samples, outbox: &mut Outbox) -> Output {
        self.step_with(now, samples, outbox, &mut Own::default())
    }

    /// [`Self::step`] with parts of the user, which the lead node uses.
    pub fn step_with(
        &mut self,
        now: Micros,
        samples: &Samples,
        outbox: &mut Outbox,
        own: &mut Own<'_>,
    ) -> Output {
        match self {
            Self::Axle { axle, lead: None } => step_axle(axle, now, samples, outbox),
            Self::Axle {
                axle,
                lead: Some(lead),
            } => {
                let mut output = step_axle(axle, now, samples, outbox);
                let (phase, work) = (since_epoch_start(now), lead.phases());
                if phase == *work.end() {
                    output.lead = Some(lead.step_with(now, outbox, own));
                } else if work.contains(&phase) {
                    lead.fuse_ahead(now, own);
                } else if phase != 0 {
                    lead.prepare();
                }
                output
            }
            Self::Beam(beam) => {
                if let Samples::Beam(samples) = samples {
                    beam.step(now, samples, outbox);
                }
                Output::default()
            }
        }
    }
}

fn step_axle(axle: &mut AxleNode, now: Micros, samples: &Samples, outbox: &mut Outbox) -> Output {
    let none = axle::Samples::default();
    let samples = match samples {
        Samples::Axle(samples) => samples,
        Samples::Beam(_) => &none,
    };
    let output = axle.step(now, samples, outbox);
    Output {
        torque_nm: output.torque_nm,
        active: output.active,
        clear: axle.clears(now),
        lead: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::beam::MAX_GAUGES;
    use crate::time::{EPOCH, TICK, is_epoch_start};
    use crate::topology::{AxleId, MAX_AXLES, Topology};

    #[test]
    fn nodes_built_in_place_equal_nodes_built_by_value() {
        let mut config = RobotConfig::default();
        config.geometry.axles = MAX_AXLES as u32;
        let mut place = None;
        for role in config.topology().boards() {
            let ready = Ready::new(&config, role).unwrap();
            let expected = ready.begin();
            assert_eq!(*ready.begin_in(&mut place), expected);
        }
    }

    #[test]
    fn each_role_sends_its_own_messages_and_only_the_front_board_leads() {
        for role in Topology::PAIR.boards() {
            let mut board = Board::new(&RobotConfig::default(), role).unwrap();
            assert_eq!(board.role(), role);
            assert_eq!(board.lead().is_some(), role == Role::LEAD);
            let samples = match role {
                Role::Beam(_) => Samples::Beam([2048; MAX_GAUGES].into()),
                _ => Samples::Axle(axle::Samples {
                    encoder: Wheels::both(Some(0)),
                    ..axle::Samples::default()
                }),
            };
            let (mut led, mut outbox) = (0, Outbox::new());
            for tick in 0..10 {
                led += u32::from(
                    board
                        .step(tick * TICK, &samples, &mut outbox)
                        .lead
                        .is_some(),
                );
            }
            assert_eq!(led, u32::from(role == Role::LEAD));
            let from = |message: &Message| match message {
                Message::AxlePosture {
                    axle: AxleId(0), ..
                }
                | Message::LeadStatus { .. } => Some(Role::LEAD),
                Message::AxlePosture {
                    axle: AxleId(1), ..
                } => Some(Role::axle(1)),
                Message::BeamPosture { .. } => Some(Role::beam(0)),
                _ => None,
            };
            let senders = outbox.iter().filter_map(from).collect::<Vec<_>>();
            assert!(!senders.is_empty() && senders.iter().all(|sender| *sender == role));
        }
    }

    #[test]
    fn restarted_board_equals_a_new_board() {
        use crate::control::path::PathPoint;
        use crate::math::Posture;
        use crate::node::robot::ConfiguredPlacement;
        for role in Topology::PAIR.boards() {
            let new = Board::new(&RobotConfig::default(), role).unwrap();
            let mut board = new.clone();
            if let Some(lead) = board.lead() {
                let place = Posture::new(1.0, 0.0, 0.0);
                lead.initialize(
                    &RobotConfig::default().placement(place, &ConfiguredPlacement::default()),
                );
                lead.path_task()
                    .push_path_point(PathPoint::default())
                    .unwrap();
                lead.command(lead::Task::regulate(Posture::ORIGIN));
            }
            let mut outbox = Outbox::new();
            for tick in 0..200u64 {
                for message in core::mem::take(&mut outbox).iter() {
                    board.receive(tick * TICK, message);
                }
                let samples = match role {
                    Role::Beam(_) => Samples::Beam([2040 + (tick % 3) as i32; MAX_GAUGES].into()),
                    _ => Samples::Axle(axle::Samples {
                        encoder: [Some(tick as i32), Some(2 * tick as i32)].into(),
                        gyro_rad_s: Some(0.2),
                        acceleration_m_s2: Some(0.1),
                        ..axle::Samples::default()
                    }),
                };
                board.step(tick * TICK, &samples, &mut outbox);
            }
            assert_ne!(board, new, "{role:?}");
            board.restart();
            assert_eq!(board, new, "{role:?}");
        }
    }

    #[test]
    fn received_message_reaches_the_nodes_of_its_board() {
        use crate::bus::LeadMode;
        use crate::node::testing::beat;
        use crate::safety::OperatingState;
        use crate::topology::Node;
        for role in Topology::PAIR.boards() {
            let new = Board::new(&RobotConfig::default(), role).unwrap();
            let mut board = new.clone();
            let message = match role {
                Role::LEAD => beat(Node::axle(1), 0, OperatingState::Idle, 0),
                Role::Axle(_) => beat(Node::Lead, 0, OperatingState::Idle, 0),
                Role::Beam(_) => Message::LeadStatus {
                    sequence: 0,
                    mode: LeadMode::Clear,
                    steering_rad: 0.0,
                    velocity_m_s: 0.0,
                },
            };
            board.receive(0, &message);
            assert!(board != new, "{role:?}");
            // On the front board the message reaches both nodes.
            if let (Board::Axle { axle, lead }, Board::Axle { axle: a, lead: l }) = (&board, &new) {
                assert!(axle != a && (lead != l || role != Role::LEAD));
            }
        }
    }

    /// The front board steps its lead node once an epoch, and calls `prepare` at each other tick that does not begin
    /// an epoch.
    #[test]
    fn lead_node_prepares_ahead_between_its_steps() {
        use crate::math::Posture;
        use crate::node::robot::ConfiguredPlacement;
        use crate::node::testing::{axle_report, beat};
        use crate::safety::OperatingState;
        use crate::topology::Node;
        let config = RobotConfig::default();
        let mut board = Board::new(&config, Role::LEAD).unwrap();
        let lead = board.lead().unwrap();
        lead.initialize(&config.placement(Posture::ORIGIN, &ConfiguredPlacement::default()));
        lead.command(lead::Task::regulate(Posture::new(-1.0, 0.5, 0.0)));
        let Board::Axle {
            mut axle,
            lead: Some(mut lead),
        } = board.clone()
        else {
            panic!("no lead node");
        };
        let samples = axle::Samples {
            encoder: Wheels::both(Some(0)),
            ..axle::Samples::default()
        };
        let (mut works, mut own) = ([0; 3], Outbox::new());
        for tick in 0..2000u64 {
            let now = tick * TICK;
            let mut messages: Vec<Message> = core::mem::take(&mut own).iter().copied().collect();
            if is_epoch_start(now) {
                let uptime = (now / EPOCH).min(255) as u8;
                let report = axle_report(AxleId(1), now, Posture::ORIGIN, uptime, None);
                messages.extend(report);
                messages.push(beat(Node::axle(1), now, OperatingState::Active, 0));
            }
            for message in &messages {
                board.receive(now, message);
                axle.receive(now, message);
                lead.receive(now, message);
            }
            board.step(now, &Samples::Axle(samples), &mut own);
            let mut outbox = Outbox::new();
            axle.step(now, &samples, &mut outbox);
            let before = lead.clone();
            match tick % 10 {
                0 => {}
                3 => {
                    lead.step(now, &mut outbox);
                    works[0] += 1;
                }
                phase => {
                    lead.prepare();
                    works[if phase < 3 { 1 } else { 2 }] += u32::from(lead != before);
                }
            }
            let Board::Axle {
                axle: a,
                lead: Some(l),
            } = &board
            else {
                panic!("another board");
            };
            assert!(a == &axle && l == &lead, "{tick}");
        }
        assert!(works[0] == 200 && works[2] > 0, "{works:?}");
    }

    #[test]
    fn samples_of_another_board_count_as_missing() {
        let mut board = Board::new(&RobotConfig::default(), Role::axle(1)).unwrap();
        let mut same = board.clone();
        let mut outbox = Outbox::new();
        let beam = Samples::Beam([1; MAX_GAUGES].into());
        let none = Samples::Axle(axle::Samples::default());
        let other = board.step(0, &beam, &mut outbox);
        assert_eq!(other, same.step(0, &none, &mut outbox));
        assert_eq!(board, same);
    }
}
