//! Place for the nodes of a board in a session.
//!
//! The nodes of an axle board are large, because they may contain a lead node. An image of a beam board has room only
//! for its own node.
//!
//! # Panic contract
//!
//! [`SessionNodes::start`] validates; nothing else can fail.

use crate::bus::Message;
use crate::config::ConfigError;
use crate::node::Outbox;
use crate::node::beam::BeamNode;
use crate::node::board::{Board, Output, Ready, Samples};
use crate::node::lead::LeadNode;
use crate::node::robot::RobotConfig;
use crate::params::Disarmed;
use crate::time::Micros;
use crate::topology::Role;

/// Place for the nodes of a board that runs in a session.
pub trait SessionNodes {
    /// Builds the nodes of a board, at rest; the error names the parameter that is wrong.
    fn start(&mut self, config: &RobotConfig, role: Role) -> Result<(), ConfigError>;
    /// Discards the nodes.
    fn discard(&mut self);
    /// True from [`Self::start`] until [`Self::discard`].
    fn are_started(&self) -> bool;
    /// The proof that the motors are off, if they are; see [`Disarmed::of`].
    fn disarmed(&self) -> Option<Disarmed>;
    /// The lead node, if the board has it.
    fn lead(&mut self) -> Option<&mut LeadNode>;
    /// Takes in a message that arrived at `now`.
    fn receive(&mut self, now: Micros, message: &Message);
    /// Runs one tick at `now`, as [`Board::step`]; without nodes nothing happens.
    fn step(&mut self, now: Micros, samples: &Samples, outbox: &mut Outbox) -> Output;
}

impl SessionNodes for Option<Board> {
    // Not inlined, so that the stack of a caller does not hold nodes.
    #[inline(never)]
    fn start(&mut self, config: &RobotConfig, role: Role) -> Result<(), ConfigError> {
        Ready::new(config, role)?.begin_in(self);
        Ok(())
    }

    fn discard(&mut self) {
        *self = None;
    }

    fn are_started(&self) -> bool {
        self.is_some()
    }

    fn disarmed(&self) -> Option<Disarmed> {
        Disarmed::of(self.as_ref())
    }

    fn lead(&mut self) -> Option<&mut LeadNode> {
        self.as_mut()?.lead()
    }

    fn receive(&mut self, now: Micros, message: &Message) {
        if let Some(board) = self {
            board.receive(now, message);
        }
    }

    fn step(&mut self, now: Micros, samples: &Samples, outbox: &mut Outbox) -> Output {
        let board = self.as_mut();
        board.map_or_else(Output::default, |board| board.step(now, samples, outbox))
    }
}

/// Node of a beam board, whose memory holds no lead node.
impl SessionNodes for Option<BeamNode> {
    #[inline(never)]
    fn start(&mut self, config: &RobotConfig, role: Role) -> Result<(), ConfigError> {
        if let Role::Beam(frame) = role {
            *self = Some(config.build_beam(frame)?);
        }
        Ok(())
    }

    fn discard(&mut self) {
        *self = None;
    }

    fn are_started(&self) -> bool {
        self.is_some()
    }

    fn disarmed(&self) -> Option<Disarmed> {
        Disarmed::when(self.is_none())
    }

    fn lead(&mut self) -> Option<&mut LeadNode> {
        None
    }

    fn receive(&mut self, _now: Micros, message: &Message) {
        if let Some(beam) = self {
            beam.receive(message);
        }
    }

    fn step(&mut self, now: Micros, samples: &Samples, outbox: &mut Outbox) -> Output {
        if let (Some(beam), Samples::Beam(samples)) = (self, samples) {
            beam.step(now, samples, outbox);
        }
        Output::default()
    }
}

/// Nodes elsewhere in memory.
impl SessionNodes for &mut dyn SessionNodes {
    fn start(&mut self, config: &RobotConfig, role: Role) -> Result<(), ConfigError> {
        (**self).start(config, role)
    }

    fn discard(&mut self) {
        (**self).discard();
    }

    fn are_started(&self) -> bool {
        (**self).are_started()
    }

    fn disarmed(&self) -> Option<Disarmed> {
        (**self).disarmed()
    }

    fn lead(&mut self) -> Option<&mut LeadNode> {
        (**self).lead()
    }

    fn receive(&mut self, now: Micros, message: &Message) {
        (**self).receive(now, message);
    }

    fn step(&mut self, now: Micros, samples: &Samples, outbox: &mut Outbox) -> Output {
        (**self).step(now, samples, outbox)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::beam::MAX_GAUGES;
    use crate::time::TICK;

    /// A place for a beam node alone gives the same messages as a place for any board.
    #[test]
    fn beam_node_alone_acts_like_a_beam_board() {
        let config = RobotConfig::default();
        let (mut any, mut beam): (Option<Board>, Option<BeamNode>) = (None, None);
        let mut places: [&mut dyn SessionNodes; 2] = [&mut any, &mut beam];
        let [mut any, mut beam] = [Outbox::new(), Outbox::new()];
        for place in &mut places {
            assert!(!place.are_started() && place.disarmed().is_some());
            place.start(&config, Role::beam(0)).unwrap();
            assert!(place.are_started() && place.disarmed().is_none());
            assert!(place.lead().is_none());
        }
        let mut sent = 0;
        for tick in 0..100 {
            let samples = Samples::Beam([2048 + tick as i32; MAX_GAUGES].into());
            for (place, outbox) in places.iter_mut().zip([&mut any, &mut beam]) {
                outbox.clear();
                assert_eq!(place.step(tick * TICK, &samples, outbox), Output::default());
            }
            assert_eq!(any, beam);
            sent += any.iter().count();
        }
        assert!(sent > 20, "{sent}");
        for place in &mut places {
            let mut wrong = config;
            wrong.geometry.half_thickness_m = -1.0;
            assert!(place.start(&wrong, Role::beam(0)).is_err());
            place.discard();
            assert!(!place.are_started());
        }
    }
}
