//! Reports of the other nodes, and the estimates at the latest epoch that all axles have reported.

use super::pair::{Fused, Pair, neighbours};
use super::track::{AxleReport, AxleTrack, EPOCHS, SETTLING};
use super::{LeadNode, Own, PAIRS, State};
use crate::bus::Message;
use crate::fusion::Estimate;
use crate::math::Twist;
use crate::time::{EPOCH, Micros, Stamped, epoch_start, sequence, share_of_epoch};
use crate::topology::{AxleId, FrameId};

/// Longest wait for a measurement of the beam that locates a restarted axle.
const REJOIN_PATIENCE: Micros = 500_000;

impl LeadNode {
    /// Takes in a message that arrived at `now`.
    pub fn receive(&mut self, now: Micros, message: &Message) {
        self.state.peers.receive(now, message);
        match *message {
            Message::BeamWrench {
                frame,
                sequence,
                wrench,
            } => {
                let Some(pair) = self.state.pair(frame) else {
                    return;
                };
                pair.wrench = Some(Stamped::new(wrench, epoch_start(now, sequence)));
            }
            Message::AxlePosture {
                axle,
                sequence,
                posture,
            } => {
                let Some(report) = self.state.report(axle) else {
                    return;
                };
                report.posture = Some(Stamped::new(posture, epoch_start(now, sequence)));
                report.complete();
            }
            Message::AxleMotion {
                axle,
                sequence,
                velocity_m_s,
                yaw_rate_rad_s,
                gyro_samples,
                gyro_zeroed,
                uptime,
                ..
            } => {
                let Some(report) = self.state.report(axle) else {
                    return;
                };
                let uptime = Micros::from(uptime) * EPOCH;
                report.uptime = Some(Stamped::new(uptime, epoch_start(now, sequence)));
                report.twist = Twist::new(velocity_m_s, yaw_rate_rad_s);
                report.gyro_share = share_of_epoch(gyro_samples);
                report.gyro_zeroed = gyro_zeroed;
                report.complete();
            }
            Message::AxleUncertainty {
                axle,
                sequence,
                covariance,
            } => {
                let Some(report) = self.state.report(axle) else {
                    return;
                };
                report.uncertainty = Some(Stamped::new(covariance, epoch_start(now, sequence)));
            }
            Message::BeamPosture {
                frame,
                sequence,
                posture,
                gauges,
            } if gauges > 0 => {
                let Some(pair) = self.state.pair(frame) else {
                    return;
                };
                pair.posture = Some(Stamped::new(posture, epoch_start(now, sequence)));
                pair.complete();
            }
            Message::BeamUncertainty {
                frame,
                sequence,
                covariance,
            } => {
                let Some(pair) = self.state.pair(frame) else {
                    return;
                };
                pair.uncertainty = Some(Stamped::new(covariance, epoch_start(now, sequence)));
                pair.complete();
            }
            _ => {}
        }
    }

    /// Advances the estimates to the latest epoch that all axles have reported; `None` while reports are missing or a
    /// restarted axle settles, or if the estimates of a user's estimator are not sound.
    pub(super) fn fuse(&mut self, now: Micros, own: &mut Own<'_>) -> Option<Fused> {
        let Self { with, state, .. } = self;
        state.unsound = false;
        if state.pairs.iter().any(|pair| pair.fusion.is_none()) {
            return None;
        }
        for track in &state.tracks {
            if track.report.whole?.0.age(now) > with.report_timeout {
                return None;
            }
        }
        let at = state.latest_epoch(now);
        let beams: [Option<Stamped<Estimate>>; PAIRS] = core::array::from_fn(|pair| {
            state.pairs[pair].measurement(at, neighbours(&state.tracks, pair))
        });
        let restarted = state.tracks.each_ref().map(AxleTrack::restarted);
        for (pair, beam) in beams.iter().enumerate() {
            let patience = match beam.is_none() && with.fusion.uses_beam() {
                true => REJOIN_PATIENCE,
                false => SETTLING,
            };
            let mut uptimes = neighbours(&restarted, pair).into_iter().flatten();
            if uptimes.any(|uptime| *uptime < patience) {
                return None;
            }
        }
        let motion = state.tracks.each_mut().map(|track| track.advance(at));
        let pairs = core::array::from_fn(|pair| {
            let motion = neighbours(&motion, pair);
            let restarted = neighbours(&restarted, pair).map(Option::is_some);
            state.pairs[pair].step(&with.fusion, now, motion, restarted, beams[pair], own)
        });
        let fused = Fused { pairs };
        state.unsound = own.estimator.is_some() && !fused.is_sound();
        (!state.unsound).then_some(fused)
    }
}

impl State {
    /// Reports of an axle; `None` for an axle that the robot does not have.
    fn report(&mut self, axle: AxleId) -> Option<&mut AxleReport> {
        Some(&mut self.tracks.get_mut(axle.index())?.report)
    }

    /// The pair of axles that a frame joins; `None` for a frame that the robot does not have.
    fn pair(&mut self, frame: FrameId) -> Option<&mut Pair> {
        self.pairs.get_mut(frame.index())
    }

    /// The latest epoch that all axles have reported.
    fn latest_epoch(&self, now: Micros) -> Micros {
        let epoch = epoch_start(now, sequence(now));
        let mut latest = (0..EPOCHS as Micros).map(|age| epoch.saturating_sub(age * EPOCH));
        let reported = |time: &Micros| {
            let mut axles = self.tracks.iter();
            axles.all(|track| track.report.past.at(*time).is_some())
        };
        latest.find(reported).unwrap_or(0)
    }
}
