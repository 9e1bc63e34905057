//! Reports of one axle, paired to odometric increments.

use super::RESTART_SIGMAS;
use crate::bus::field::wrap_position;
use crate::fusion::robot::Increment;
use crate::math::matrix::{Mat3, diagonal, scale};
use crate::math::{Posture, Twist};
use crate::time::{EPOCH, Micros, Stamped};

/// Time after which the filter of an axle that was restarted on the move, and takes itself to be at
/// rest, has settled.
pub(super) const SETTLING: Micros = 100_000;

/// The latest report of one axle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct AxleReport {
    /// Latest posture and time since the start, maybe not of one epoch.
    pub(super) posture: Option<Stamped<Posture>>,
    pub(super) uptime: Option<Stamped<Micros>>,
    /// Latest posture whose time since the start is known: a posture alone does not tell whether
    /// it is still one of the same odometric frame.
    pub(super) whole: Option<(Stamped<Posture>, Micros)>,
    pub(super) uncertainty: Option<Stamped<Mat3>>,
    /// Latest speed and yaw rate.
    pub(super) twist: Twist,
    /// Share of the axle's ticks in which its gyro took part.
    pub(super) gyro_share: f32,
    pub(super) gyro_zeroed: bool,
}

impl AxleReport {
    pub(super) fn pair(&mut self) {
        if let (Some(posture), Some(uptime)) = (self.posture, self.uptime)
            && posture.time == uptime.time
        {
            self.whole = Some((posture, uptime.value));
        }
    }
}

/// Motion of an axle since the last step of the lead node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Advance {
    /// Nothing new came, or nothing to compare it with.
    Unknown,
    /// By its odometry.
    Moved(Increment),
    /// Its odometry began anew on the way, which took this many epochs.
    Restarted { ticks: u16 },
}

impl Advance {
    /// The motion; that of an axle that was restarted is the `other`'s, give or take the frame.
    pub(super) fn increment(&self, other: &Self) -> Option<Increment> {
        match (self, other) {
            (Self::Unknown, _) => None,
            (Self::Moved(increment), _) => Some(*increment),
            (Self::Restarted { ticks }, other) => Some(Increment {
                posture: match other {
                    Self::Moved(increment) => increment.posture,
                    _ => Posture::ORIGIN,
                },
                covariance: diagonal(RESTART_SIGMAS.map(|sigma| sigma * sigma)),
                ticks: *ticks,
                gyro_share: 0.0,
                gyro_zeroed: true,
            }),
        }
    }
}

/// One axle as the lead node knows it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct AxleTrack {
    pub(super) report: AxleReport,
    /// Odometric posture up to which the fused estimate goes.
    pub(super) odometry: Option<Stamped<Posture>>,
}

impl AxleTrack {
    /// Time since the axle was started, if that was after the last step. After a silence longer than
    /// the time it can tell, it may have been.
    pub(super) fn restarted(&self) -> Option<Micros> {
        let (latest, uptime) = self.report.whole?;
        (uptime < latest.time.saturating_sub(self.odometry?.time)).then_some(uptime)
    }

    /// The motion since the last step, however many epochs it spans.
    pub(super) fn advance(&mut self) -> Advance {
        let Some((latest, uptime)) = self.report.whole else {
            return Advance::Unknown;
        };
        let Some(last) = self.odometry else {
            self.odometry = Some(latest);
            return Advance::Unknown;
        };
        if latest.time <= last.time {
            return Advance::Unknown;
        }
        self.odometry = Some(latest);
        let span = latest.time - last.time;
        let ticks = (span / EPOCH).min(u64::from(u16::MAX)) as u16;
        if uptime < span {
            return Advance::Restarted { ticks };
        }
        // Positions repeat after a span of the bus, so only their wrapped difference counts.
        let moved = Posture::new(
            wrap_position(latest.value.x - last.value.x),
            wrap_position(latest.value.y - last.value.y),
            latest.value.phi,
        );
        // The tier adds slip of its own, so a covariance that never came leaves some.
        let covariance = self.report.uncertainty.map_or([[0.0; 3]; 3], |u| u.value);
        Advance::Moved(Increment {
            posture: moved.relative_to(Posture::new(0.0, 0.0, last.value.phi)),
            covariance: scale(&covariance, f32::from(ticks)),
            ticks,
            gyro_share: self.report.gyro_share,
            gyro_zeroed: self.report.gyro_zeroed,
        })
    }
}
