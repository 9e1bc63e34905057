//! Reports of the other nodes, and the estimate of the latest epoch of which both axles have told.

use super::track::{AxleReport, AxleTrack, EPOCHS, SETTLING};
use super::{LeadNode, NIS_MOST, NIS_SHARE, State};
use crate::bus::Message;
use crate::fusion::Estimate;
use crate::fusion::ekf::Verdict;
use crate::fusion::robot;
use crate::math::Twist;
use crate::math::matrix::propagate;
use crate::math::trig::sin_cos;
use crate::time::{EPOCH, Micros, Stamped, epoch_start, sequence, share_of_epoch};
use crate::topology::{AxleId, FrameId};

/// Age in epochs up to which a measurement of the beam is used.
const BEAM_EPOCHS: Micros = 3;
/// Time that is waited for the beam to find a restarted axle by.
const REJOIN_PATIENCE: Micros = 500_000;

impl LeadNode {
    /// Takes in a message that arrived at `now`.
    pub fn receive(&mut self, now: Micros, message: &Message) {
        self.state.peers.receive(now, message);
        match *message {
            Message::BeamWrench {
                frame: FrameId(0),
                sequence,
                wrench,
            } => {
                self.state.wrench = Some(Stamped::new(wrench, epoch_start(now, sequence)));
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
                report.pair();
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
                report.pair();
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
                frame: FrameId(0),
                sequence,
                posture,
                gauges,
            } if gauges > 0 => {
                self.state.beam_posture = Some(Stamped::new(posture, epoch_start(now, sequence)));
                self.state.pair_beam();
            }
            Message::BeamUncertainty {
                frame: FrameId(0),
                sequence,
                covariance,
            } => {
                self.state.beam_uncertainty =
                    Some(Stamped::new(covariance, epoch_start(now, sequence)));
                self.state.pair_beam();
            }
            _ => {}
        }
    }

    /// Brings the estimate to the present epoch; `None` while reports are missing.
    pub(super) fn fuse(&mut self, now: Micros) -> Option<robot::Output> {
        let state = &mut self.state;
        state.fusion.as_ref()?;
        for track in &state.tracks {
            if track.report.whole?.0.age(now) > self.with.report_timeout {
                return None;
            }
        }
        // The estimate is of the latest epoch of which both axles have told.
        let epoch = epoch_start(now, sequence(now));
        let mut latest = (0..EPOCHS as Micros).map(|age| epoch.saturating_sub(age * EPOCH));
        let told = |time: &Micros| {
            let mut axles = state.tracks.iter();
            axles.all(|track| track.report.past.at(*time).is_some())
        };
        let at = latest.find(told).unwrap_or(0);
        let beam = state.beam_at(at);
        let restarted = state.tracks.each_ref().map(AxleTrack::restarted);
        let patience = match beam.is_none() && self.with.fusion.uses_beam() {
            true => REJOIN_PATIENCE,
            false => SETTLING,
        };
        if restarted.iter().flatten().any(|uptime| *uptime < patience) {
            return None;
        }
        let [front, rear] = state.tracks.each_mut().map(|track| track.advance(at));
        let known = match restarted {
            [None, Some(_)] => Some(AxleId(0)),
            [Some(_), None] => Some(AxleId(1)),
            _ => None,
        };
        let lost = restarted != [None; 2];
        let inputs = robot::Inputs {
            front: front.increment(&rear),
            rear: rear.increment(&front),
            // The frame may have bent by more than an update of the estimate can follow.
            beam: beam.map(|beam| beam.value).filter(|_| !lost),
        };
        if let Some(beam) = beam {
            state.beam_used = Some(Stamped::new(now, beam.time));
        }
        let fusion = state.fusion.as_mut()?;
        let output = self.with.fusion.step(fusion, &inputs);
        let judged = matches!(output.beam.verdict, Verdict::Used | Verdict::Gated);
        if judged && fusion.joint().is_some() {
            state.nis += NIS_SHARE * (output.beam.nis.min(NIS_MOST) - state.nis);
        }
        match (known, beam) {
            (Some(axle), Some(beam)) if self.with.fusion.uses_beam() => {
                Some(self.with.fusion.rejoin(fusion, axle, &output, &beam.value))
            }
            _ => Some(output),
        }
    }
}

impl State {
    /// Reports of an axle; `None` of one that the robot does not have.
    fn report(&mut self, axle: AxleId) -> Option<&mut AxleReport> {
        Some(&mut self.tracks.get_mut(axle.index())?.report)
    }

    /// Posture and covariance of one epoch make a measurement.
    fn pair_beam(&mut self) {
        if let (Some(posture), Some(covariance)) = (self.beam_posture, self.beam_uncertainty)
            && posture.time == covariance.time
        {
            let measured = Estimate::new(posture.value, covariance.value);
            self.beam.put(Stamped::new(measured, posture.time));
        }
    }

    /// The latest measurement of the beam up to an epoch that was not used, with its own epoch. It is carried to that
    /// epoch by the odometry since.
    fn beam_at(&self, epoch: Micros) -> Option<Stamped<Estimate>> {
        let used = self.beam_used.map_or(0, |used| used.time);
        // As a rule it is of that epoch, and the copies below are spared.
        if let (Some(measured), true) = (self.beam.at(epoch), epoch > used) {
            return Some(Stamped::new(measured, epoch));
        }
        let mut ages = (1..=BEAM_EPOCHS).map(|age| epoch.saturating_sub(age * EPOCH));
        let (time, measured) = ages.find_map(|time| Some((time, self.beam.at(time)?)))?;
        if time <= used {
            return None;
        }
        let [front, rear] = self.tracks.each_ref().map(|track| track.moved(time, epoch));
        let (front, rear) = (front?, rear?);
        let posture = measured.posture.compose(front).relative_to(rear);
        let (sin, cos) = sin_cos(rear.phi);
        let turn = [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]];
        let covariance = propagate(&turn, &measured.covariance);
        Some(Stamped::new(Estimate::new(posture, covariance), time))
    }
}
