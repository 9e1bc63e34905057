//! Beam node: bridge counts in once a millisecond, relative posture of the axles out once an epoch.
//!
//! # Panic contract
//!
//! [`crate::beam::sensor::Config::build`] validates; nothing else can fail. If no posture can be computed, the
//! message has zero gauges.

use super::{Outbox, peers};
use crate::beam::health::Fault;
use crate::beam::{Estimate, MAX_GAUGES, RelativePositionSensor, sensor};
use crate::bus::{LeadMode, Message, layout};
use crate::math::{Posture, Wrench};
use crate::safety::supervisor::{self, Supervisor};
use crate::safety::{Condition, Conditions, OperatingState, StateRequest};
use crate::time::{Micros, is_epoch_start, sequence};
use crate::topology::{FrameId, Node, Topology};

/// Readings of the beam board's sensors at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Samples {
    /// Counts of the bridges from the root on; counts beyond the last configured gauge are not used.
    pub counts: [i32; MAX_GAUGES],
    /// Conditions found by the board's drivers: converter, bus, time.
    pub conditions: Conditions,
}

impl From<[i32; MAX_GAUGES]> for Samples {
    /// Samples with these counts and without conditions.
    fn from(counts: [i32; MAX_GAUGES]) -> Self {
        Self {
            counts,
            conditions: Conditions::NONE,
        }
    }
}

/// Node of a frame: sends the front axle's posture and the wrench, measured by the gauges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamNode {
    frame: FrameId,
    /// Epochs between two uncertainties.
    uncertainty_epochs: u8,
    sensor: RelativePositionSensor,
    supervisor: Supervisor,
    state: State,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct State {
    sensor: sensor::State,
    latest: Option<Estimate>,
    supervision: supervisor::State,
    /// Conditions found by the board's drivers in this epoch.
    found: Conditions,
    /// True if faults are to be cleared at the next step.
    clear: bool,
    /// Number of gauges of the latest uncertainty on the bus.
    stated_gauges: u8,
}

impl BeamNode {
    /// Creates the node of a frame of a robot with its sensor.
    pub fn new(
        topology: Topology,
        frame: FrameId,
        sensor: RelativePositionSensor,
        supervisor: Supervisor,
    ) -> Self {
        Self {
            frame,
            uncertainty_epochs: layout::uncertainty_epochs(topology),
            sensor,
            supervisor,
            state: State::default(),
        }
    }

    /// Frame of this node.
    pub fn frame(&self) -> FrameId {
        self.frame
    }

    /// Resets the node to its state after construction.
    pub fn restart(&mut self) {
        self.state = State::default();
    }

    /// The estimate of the latest epoch, with faults and strains.
    pub fn latest(&self) -> Option<&Estimate> {
        self.state.latest.as_ref()
    }

    /// Operating state of the node, and its reason.
    pub fn supervision(&self) -> &supervisor::State {
        &self.state.supervision
    }

    /// Takes in a message; only the lead node's request to clear faults counts.
    pub fn receive(&mut self, message: &Message) {
        if let Message::LeadStatus { mode, .. } = *message {
            self.state.clear = mode == LeadMode::Clear;
        }
    }

    /// Sends the heartbeat with the conditions of this epoch; the board has no motors to stop.
    fn supervise(&mut self, now: Micros, estimate: &Estimate, outbox: &mut Outbox) {
        let state = &mut self.state;
        let out = estimate
            .faults
            .into_iter()
            .any(|fault| fault != Fault::None);
        let found = core::mem::take(&mut state.found);
        let conditions = found
            .with(Condition::GaugeLost, out)
            .with(Condition::GaugesInconsistent, !estimate.consistent)
            .with(Condition::BeamLost, estimate.relative.is_none());
        let request = match state.supervision.operating() {
            OperatingState::Boot => Some(StateRequest::Ready),
            OperatingState::Fault if state.clear => Some(StateRequest::Clear),
            _ => None,
        };
        let input = supervisor::Input {
            conditions,
            request,
            ..supervisor::Input::default()
        };
        self.supervisor.step(&mut state.supervision, now, &input);
        outbox.push(peers::heartbeat(
            Node::Beam(self.frame),
            now,
            &mut state.supervision,
        ));
    }

    /// Runs one tick. At the beginning of an epoch the posture of that instant goes to `outbox`.
    pub fn step(&mut self, now: Micros, samples: &Samples, outbox: &mut Outbox) {
        self.state.found = self.state.found.union(samples.conditions);
        self.sensor.sample(&mut self.state.sensor, &samples.counts);
        if !is_epoch_start(now) {
            return;
        }
        let estimate = self.sensor.estimate(&mut self.state.sensor);
        self.state.latest = Some(estimate);
        self.supervise(now, &estimate, outbox);
        let (frame, sequence) = (self.frame, sequence(now));
        let Some(relative) = estimate.relative else {
            outbox.push(Message::BeamPosture {
                frame,
                sequence,
                posture: Posture::ORIGIN,
                gauges: 0,
            });
            return;
        };
        let gauges = estimate.used.count() as u8;
        // The covariance is sent first, so that a receiver of the posture has its covariance too. It follows the bend,
        // which changes little within a few epochs, and the gauges: a lost gauge is stated at once.
        let due = layout::is_uncertainty_due(self.uncertainty_epochs, sequence, frame.0);
        if due || gauges != self.state.stated_gauges {
            self.state.stated_gauges = gauges;
            outbox.push(Message::BeamUncertainty {
                frame,
                sequence,
                covariance: relative.noise,
            });
        }
        outbox.push(Message::BeamPosture {
            frame,
            sequence,
            posture: relative.posture,
            gauges,
        });
        if let Some(wrench) = estimate.wrench {
            let wrench = wrench.significant(relative.posture);
            outbox.push(Message::BeamWrench {
                frame,
                sequence,
                wrench: Wrench {
                    force_x: wrench.fx,
                    force_y: wrench.fy,
                    moment_root: wrench.root_moment,
                    moment_end: wrench.tip_moment,
                },
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::beam::sensor::Config;
    use crate::node::testing::lead_status;
    use crate::time::TICK;

    fn node() -> BeamNode {
        BeamNode::new(
            Topology::PAIR,
            FrameId(0),
            Config::default().build().unwrap(),
            supervisor::Config::default().build().unwrap(),
        )
    }

    /// Runs the node for 1.2 s; returns the messages of the last epoch.
    fn run(node: &mut BeamNode, counts: impl Fn(u64) -> [i32; MAX_GAUGES]) -> Vec<Message> {
        let mut outbox = Outbox::new();
        for tick in 1..=1200u64 {
            outbox.clear();
            node.step(tick * TICK, &counts(tick).into(), &mut outbox);
        }
        outbox.iter().copied().collect()
    }

    #[test]
    fn bent_strip_is_measured_as_an_arc() {
        // A curvature of 2 1/m gives a strain of 1e-3 on all gauges; noise of one count keeps them from counting as
        // stuck.
        let config = Config::default();
        let bent = (1e-3 / config.calibration.strain_per_count) as i32;
        let mut node = node();
        let messages = run(&mut node, |tick| {
            [2048 + bent + (tick % 2) as i32; MAX_GAUGES]
        });
        // The covariance goes before its posture.
        let [
            _,
            Message::BeamUncertainty { covariance, .. },
            Message::BeamPosture { .. },
            Message::BeamWrench { wrench, .. },
        ] = messages[..]
        else {
            panic!("{messages:?}");
        };
        let latest = node.latest().unwrap();
        assert_eq!(covariance, latest.relative.unwrap().noise);
        // In pure bending the moment at both ends is EI over the radius.
        assert!(
            (wrench.moment_root.abs() - 0.833 / 0.5).abs() < 0.02,
            "{wrench:?}"
        );
        assert!(
            (wrench.moment_root - wrench.moment_end).abs() < 0.02,
            "{wrench:?}"
        );
        assert!(
            wrench.force_x.abs() + wrench.force_y.abs() < 0.1,
            "{wrench:?}"
        );
        let posture = messages.iter().find_map(|message| match message {
            Message::BeamPosture {
                posture, gauges, ..
            } => Some((*posture, *gauges)),
            _ => None,
        });
        let (posture, gauges) = posture.unwrap();
        assert_eq!(gauges, 5);
        assert!(matches!(
            messages[0],
            Message::NodeStatus {
                notices: Conditions::NONE,
                ..
            }
        ));
        let phi = 2.0 * 0.37f64;
        // The arc of a circle of radius 0.5 m.
        assert!((posture.phi as f64 - phi).abs() < 2e-3, "{posture:?}");
        assert!((posture.x as f64 - 0.5 * phi.sin()).abs() < 5e-4);
        assert!((posture.y as f64 - 0.5 * (1.0 - phi.cos())).abs() < 5e-4);
    }

    /// A fault of the board's drivers is reported until the lead node clears it, and a notice of one tick in the two
    /// heartbeats after it.
    #[test]
    fn conditions_of_the_drivers_are_in_the_heartbeat() {
        let mut node = node();
        let mut reported = Vec::new();
        for tick in 1..=100u64 {
            let mut samples = Samples::from([2048; MAX_GAUGES]);
            if tick == 15 {
                samples.conditions = Conditions::only(Condition::Restarted);
                samples.conditions.set(Condition::ConversionsLost, true);
            }
            let mode = match tick {
                ..60 => LeadMode::Idle,
                _ => LeadMode::Clear,
            };
            node.receive(&lead_status(tick * TICK, mode, 0.0));
            let mut outbox = Outbox::new();
            node.step(tick * TICK, &samples, &mut outbox);
            for message in outbox.iter() {
                if let Message::NodeStatus {
                    state,
                    reason,
                    notices,
                    ..
                } = *message
                {
                    reported.push((tick, state, reason, notices));
                }
            }
        }
        node.restart();
        assert_eq!(node, self::node());
        let code = Condition::Restarted.code();
        for (tick, state, reason, notices) in reported {
            let faulty = (20..60).contains(&tick);
            let expected = if faulty { code } else { 0 };
            assert_eq!((reason, state == OperatingState::Fault), (expected, faulty));
            let lost = notices.contains(Condition::ConversionsLost);
            assert_eq!(lost, (20..=30).contains(&tick), "{tick}");
        }
    }

    /// From four axles on, every fifth epoch has a covariance, and so has the epoch in which a gauge is lost.
    #[test]
    fn covariance_of_four_axles_is_sent_every_fifth_epoch_and_when_a_gauge_is_lost() {
        let robot = crate::topology::Topology::new(4).unwrap();
        let sensor = Config::default().build().unwrap();
        let supervisor = supervisor::Config::default().build().unwrap();
        let mut node = BeamNode::new(robot, FrameId(1), sensor, supervisor);
        let mut stated = Vec::new();
        let (mut gauges, mut postures) = (Vec::new(), 0);
        for tick in 1..=3000u64 {
            let mut counts = [2048 + (tick % 2) as i32; MAX_GAUGES];
            if tick > 2004 {
                counts[1] = 0;
            }
            let mut outbox = Outbox::new();
            node.step(tick * TICK, &counts.into(), &mut outbox);
            for message in outbox.iter() {
                match message {
                    Message::BeamUncertainty { .. } => stated.push(tick / 10),
                    Message::BeamPosture { gauges: used, .. } => {
                        postures += 1;
                        gauges.push(*used);
                    }
                    _ => {}
                }
            }
        }
        assert_eq!(postures, 300);
        let changes = gauges.windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert_eq!(changes, 1, "the lost gauge");
        let gap = stated.windows(2).map(|pair| pair[1] - pair[0]).max();
        assert_eq!(gap, Some(5));
        // Besides the regular ones: at the start, at the loss, and where the sequence number wraps.
        assert!((60..=63).contains(&stated.len()), "{stated:?}");
        let lost = gauges.iter().position(|used| *used < 5).unwrap() as u64 + 1;
        assert!(stated.contains(&lost), "{lost}: {stated:?}");
    }

    #[test]
    fn node_without_a_valid_gauge_reports_zero_gauges() {
        let messages = run(&mut node(), |_| [0; MAX_GAUGES]);
        assert_eq!(messages.len(), 2);
        let Message::NodeStatus { state, notices, .. } = messages[0] else {
            panic!("no heartbeat");
        };
        assert_eq!(state, OperatingState::Idle);
        assert!(notices.contains(Condition::GaugeLost));
        let none = matches!(messages[1], Message::BeamPosture { gauges: 0, .. });
        assert!(none, "{messages:?}");
    }
}
