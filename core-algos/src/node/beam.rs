//! Beam node: bridge counts in once a millisecond, relative posture of the axles out once an epoch.
//!
//! # Panic contract
//!
//! [`crate::beam::sensor::Config::build`] validates; nothing else can fail. When no posture can be
//! computed the message says so with zero gauges.

use super::{Micros, Outbox, is_epoch_start, sequence};
use crate::beam::sensor::State;
use crate::beam::{Estimate, MAX_GAUGES, RelativePositionSensor};
use crate::bus::Message;
use crate::math::{Posture, Wrench};

/// The node of the instrumented frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamNode {
    sensor: RelativePositionSensor,
    state: State,
    latest: Option<Estimate>,
}

impl BeamNode {
    /// A node around a sensor.
    pub fn new(sensor: RelativePositionSensor) -> Self {
        Self {
            sensor,
            state: State::default(),
            latest: None,
        }
    }

    /// The sensor with its calibration.
    pub fn sensor(&self) -> &RelativePositionSensor {
        &self.sensor
    }

    /// The estimate of the latest epoch, with faults and strains.
    pub fn latest(&self) -> Option<&Estimate> {
        self.latest.as_ref()
    }

    /// One tick: the counts of all bridges. At the beginning of an epoch the posture of that
    /// instant goes to `outbox`.
    pub fn step(&mut self, now: Micros, counts: &[i32; MAX_GAUGES], outbox: &mut Outbox) {
        self.sensor.sample(&mut self.state, counts);
        if !is_epoch_start(now) {
            return;
        }
        let estimate = self.sensor.estimate(&mut self.state);
        self.latest = Some(estimate);
        let sequence = sequence(now);
        let Some(relative) = estimate.relative else {
            outbox.push(Message::BeamPosture {
                sequence,
                posture: Posture::ORIGIN,
                gauges: 0,
            });
            return;
        };
        // The covariance goes first: who has the posture of an epoch then has its covariance too.
        outbox.push(Message::BeamUncertainty {
            sequence,
            covariance: relative.covariance,
        });
        outbox.push(Message::BeamPosture {
            sequence,
            posture: relative.posture,
            gauges: estimate.used.count() as u8,
        });
        if let Some(wrench) = estimate.wrench {
            outbox.push(Message::BeamWrench {
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
    use crate::node::TICK;

    fn node() -> BeamNode {
        BeamNode::new(Config::default().build().unwrap())
    }

    /// Messages of two epochs with the same counts.
    fn run(node: &mut BeamNode, counts: impl Fn(u64) -> [i32; MAX_GAUGES]) -> Vec<Message> {
        let mut outbox = Outbox::new();
        for tick in 1..=20u64 {
            outbox.clear();
            node.step(tick * TICK, &counts(tick), &mut outbox);
        }
        outbox.iter().copied().collect()
    }

    #[test]
    fn a_bent_strip_is_seen_as_an_arc() {
        // 2 1/m of curvature: strain 1e-3 on all gauges, noise of one count so that none is stuck.
        let config = Config::default();
        let bent = (1e-3 / config.calibration.strain_per_count) as i32;
        let messages = run(&mut node(), |tick| {
            [2048 + bent + (tick % 2) as i32; MAX_GAUGES]
        });
        let posture = messages.iter().find_map(|message| match message {
            Message::BeamPosture {
                posture, gauges, ..
            } => Some((*posture, *gauges)),
            _ => None,
        });
        let (posture, gauges) = posture.unwrap();
        assert_eq!(gauges, 5);
        let phi = 2.0 * 0.37f64;
        // The arc of a circle of radius 0.5 m.
        assert!((posture.phi as f64 - phi).abs() < 2e-3, "{posture:?}");
        assert!((posture.x as f64 - 0.5 * phi.sin()).abs() < 5e-4);
        assert!((posture.y as f64 - 0.5 * (1.0 - phi.cos())).abs() < 5e-4);
    }

    #[test]
    fn without_a_valid_gauge_it_says_so() {
        let messages = run(&mut node(), |_| [0; MAX_GAUGES]);
        assert_eq!(messages.len(), 1);
        assert!(matches!(
            messages[0],
            Message::BeamPosture { gauges: 0, .. }
        ));
    }
}
