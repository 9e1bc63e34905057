//! Reports of the other nodes, and the estimates at the latest epoch that all axles have reported.
//!
//! The fusion of a pair of axles takes 0.3 ms on a board. With several pairs the work is spread over the ticks before
//! the step: [`LeadNode::fuse_ahead`] fuses one pair a tick.

use super::fused::Fused;
use super::pair::{Bend, Pair, PairReports, neighbours};
use super::track::{Advance, AxleReport, AxleTrack, EPOCHS, SETTLING};
use super::{LeadNode, Own};
use crate::bus::{Message, layout};
use crate::fusion::estimator::EstimatorOutput;
use crate::fusion::{Estimate, robot};
use crate::math::trig::sin_cos;
use crate::math::{Posture, Twist};
use crate::time::{EPOCH, Micros, Stamped, epoch_start, sequence, share_of_epoch};
use crate::topology::{AxleId, FrameId, MAX_AXLES, MAX_FRAMES};

/// Longest wait for a measurement of the beam that locates a restarted axle.
const REJOIN_PATIENCE: Micros = 500_000;

/// Reports of an epoch, and the estimates of the pairs that are fused already.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Fusing {
    /// True from the collection of the reports to the fusion of the last pair.
    under_way: bool,
    /// Motion of the axles.
    motion: [Advance; MAX_AXLES],
    /// True for an axle whose odometry restarted.
    restarted: [bool; MAX_AXLES],
    /// Measurements of the frames.
    beams: [Option<Stamped<Estimate>>; MAX_FRAMES],
    /// Bends of the frames at the epoch before.
    bends: [Bend; MAX_FRAMES],
    /// Outputs of the pairs.
    pairs: [robot::Output; MAX_FRAMES],
    /// Number of pairs that are fused.
    count: usize,
    /// Frames of the pairs' filters, as seen from `map`; of one pair, the origin.
    anchors: [Posture; MAX_FRAMES],
}

impl Default for Fusing {
    fn default() -> Self {
        Self {
            under_way: false,
            motion: [Advance::Unknown; MAX_AXLES],
            restarted: [false; MAX_AXLES],
            beams: [None; MAX_FRAMES],
            bends: [Bend::NONE; MAX_FRAMES],
            pairs: [robot::Output::default(); MAX_FRAMES],
            count: 0,
            anchors: [Posture::ORIGIN; MAX_FRAMES],
        }
    }
}

#[cfg(test)]
impl Fusing {
    /// Outputs of the pairs.
    pub(super) fn pairs(&self) -> &[robot::Output; MAX_FRAMES] {
        &self.pairs
    }
}

impl LeadNode {
    /// Takes in a message that arrived at `now`.
    pub fn receive(&mut self, now: Micros, message: &Message) {
        self.state.peers.receive(now, message);
        let epochs = layout::uncertainty_epochs(self.with.topology);
        match *message {
            Message::BeamWrench {
                frame,
                sequence,
                wrench,
            } => {
                let Some(pair) = self.pair(frame) else {
                    return;
                };
                pair.wrench = Some(Stamped::new(wrench, epoch_start(now, sequence)));
            }
            Message::AxlePosture {
                axle,
                sequence,
                posture,
            } => {
                let Some(report) = self.report(axle) else {
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
                let Some(report) = self.report(axle) else {
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
                let Some(report) = self.report(axle) else {
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
                let Some(pair) = self.pair(frame) else {
                    return;
                };
                pair.posture = Some(Stamped::new(posture, epoch_start(now, sequence)));
                pair.complete(epochs);
            }
            Message::BeamUncertainty {
                frame,
                sequence,
                covariance,
            } => {
                let Some(pair) = self.pair(frame) else {
                    return;
                };
                pair.uncertainty = Some(Stamped::new(covariance, epoch_start(now, sequence)));
                pair.complete(epochs);
            }
            _ => {}
        }
    }

    /// Collects the reports of the latest epoch that all axles have reported. False while reports are missing or a
    /// restarted axle settles.
    fn collect(&mut self, now: Micros) -> bool {
        let (tracks, pairs) = (&mut self.tracks, &self.pairs);
        if pairs.iter().any(|pair| pair.fusion.is_none()) {
            return false;
        }
        let timeout = self.with.report_timeout;
        let late = |track: &AxleTrack| {
            let whole = track.report.whole;
            whole.is_none_or(|(posture, _)| posture.age(now) > timeout)
        };
        if tracks.iter().any(late) {
            return false;
        }
        let at = latest_epoch(tracks, now);
        let fusing = &mut self.fusing;
        let kept = fusing.beams.iter_mut().zip(&mut fusing.bends);
        for ((pair, axles), (kept_beam, kept_bend)) in
            pairs.iter().zip(neighbours(tracks)).zip(kept)
        {
            let beam = pair.measurement(at, axles);
            let patience = match beam.is_none() && self.with.fusion.uses_beam() {
                true => REJOIN_PATIENCE,
                false => SETTLING,
            };
            let settles = |track: &AxleTrack| track.restarted().is_some_and(|it| it < patience);
            if axles.into_iter().any(settles) {
                return false;
            }
            (*kept_beam, *kept_bend) = (beam, pair.bend);
        }
        let kept = fusing.motion.iter_mut().zip(&mut fusing.restarted);
        for (track, (motion, restarted)) in tracks.iter_mut().zip(kept) {
            *restarted = track.restarted().is_some();
            *motion = track.advance(at);
        }
        (fusing.count, fusing.under_way) = (0, true);
        true
    }

    /// Fuses the next pair of the reports.
    fn fuse_pair(&mut self, now: Micros, own: &mut Own<'_>) {
        let fusing = &mut self.fusing;
        let k = fusing.count;
        let pair = self.pairs.get_mut(k).zip(fusing.pairs.get_mut(k));
        let axles = neighbours(&fusing.motion).zip(neighbours(&fusing.restarted));
        let reports = axles.zip(fusing.beams).nth(k);
        fusing.count = k + 1;
        let (Some((pair, output)), Some(((motion, restarted), beam))) = (pair, reports) else {
            return;
        };
        let bend = |frame: Option<usize>| {
            let bend = frame.and_then(|frame| fusing.bends.get(frame));
            bend.unwrap_or(&Bend::NONE)
        };
        let [ahead, behind] = [k.checked_sub(1), k.checked_add(1)].map(bend);
        let reports = PairReports {
            motion,
            restarted: restarted.map(|it| *it),
            beam,
            loads: bend(Some(k)).loads(ahead, behind),
        };
        *output = pair.step(&self.with.fusion, now, &reports, own);
        // The frame of a single pair is in pure bending.
        if let Some(train) = &self.with.train {
            let relative = output.front.posture.relative_to(output.rear.posture);
            pair.bend = Bend::new(train.frame(), relative);
        }
    }

    /// Fuses one pair ahead of the next step. To be called at the ticks from the lead
    /// node's [`begin_phase`](super::begin_phase) to its step, at whose `now` all reports have arrived.
    pub fn fuse_ahead(&mut self, now: Micros, own: &mut Own<'_>) {
        self.begin(own);
        let ready = self.fusing.under_way || self.collect(now);
        if ready && self.fusing.count < self.frame_count() {
            self.fuse_pair(now, own);
        }
    }

    /// Advances the estimates to the latest epoch that all axles have reported; `None` while reports are missing or a
    /// restarted axle settles, or if the estimates of a user's estimator are not sound.
    pub(super) fn fuse(&mut self, now: Micros, own: &mut Own<'_>) -> Option<Fused> {
        self.state.unsound = false;
        if !(self.fusing.under_way || self.collect(now)) {
            return None;
        }
        while self.fusing.count < self.frame_count() {
            self.fuse_pair(now, own);
        }
        self.fusing.under_way = false;
        let Fusing { pairs, anchors, .. } = &mut self.fusing;
        let mut own_pairs = pairs.iter().take(self.with.topology.frame_count());
        self.state.unsound = own.estimator.is_some() && !own_pairs.all(is_sound);
        (!self.state.unsound).then(|| Fused::new(self.with.topology, pairs, anchors))
    }

    /// Heading of O before the latest epoch and motion of O in this epoch by odometry alone, along the axes of `map`.
    pub(super) fn moved(&self, map: Posture) -> Option<(f32, Posture)> {
        let frames = self.frame_count();
        if frames == 1 {
            return Some(self.fusion()?.moved());
        }
        // The change of O in `map` less the mean correction of the pairs.
        let [mut x, mut y, mut turn] = map.minus(self.state.map?);
        let share = 1.0 / frames as f32;
        for (pair, anchor) in self.pairs.iter().zip(&self.fusing.anchors) {
            let (sin, cos) = sin_cos(anchor.phi);
            let [dx, dy, dphi] = pair.corrected.map(|it| share * it);
            x -= cos * dx - sin * dy;
            y -= sin * dx + cos * dy;
            turn -= dphi;
        }
        Some((self.state.map?.phi, Posture::new(x, y, turn)))
    }

    /// Number of frames.
    pub(super) fn frame_count(&self) -> usize {
        self.with.topology.frame_count()
    }

    /// Reports of an axle; `None` for an axle that the robot does not have.
    fn report(&mut self, axle: AxleId) -> Option<&mut AxleReport> {
        Some(&mut self.tracks.get_mut(axle.index())?.report)
    }

    /// The pair of axles that a frame joins; `None` for a frame that the robot does not have.
    fn pair(&mut self, frame: FrameId) -> Option<&mut Pair> {
        self.pairs.get_mut(frame.index())
    }
}

/// True if the robot can drive by the estimates of a user's estimator.
fn is_sound(pair: &robot::Output) -> bool {
    let &robot::Output {
        front, rear, robot, ..
    } = pair;
    EstimatorOutput { front, rear, robot }.is_sound()
}

/// The latest epoch that all axles have reported.
fn latest_epoch(tracks: &[AxleTrack], now: Micros) -> Micros {
    let epoch = epoch_start(now, sequence(now));
    let mut latest = (0..EPOCHS as Micros).map(|age| epoch.saturating_sub(age * EPOCH));
    let reported = |time: &Micros| {
        let mut axles = tracks.iter();
        axles.all(|track| track.report.past.at(*time).is_some())
    };
    latest.find(reported).unwrap_or(0)
}
