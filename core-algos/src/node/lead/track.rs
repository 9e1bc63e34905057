//! Reports of one axle, combined into odometric increments.

use super::RESTART_SIGMAS;
use crate::bus::field::wrap_position;
use crate::fusion::robot::Increment;
use crate::math::matrix::{Mat3, diagonal, scale};
use crate::math::{Posture, Twist};
use crate::time::{EPOCH, Micros, Stamped};

/// Settling time of the filter of an axle that restarts on the move: the filter starts at rest.
pub(super) const SETTLING: Micros = 100_000;

/// The latest report of one axle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct AxleReport {
    /// Latest posture and latest uptime, possibly of different epochs.
    pub(super) posture: Option<Stamped<Posture>>,
    pub(super) uptime: Option<Stamped<Micros>>,
    /// Latest posture with the uptime of its epoch. Only the uptime shows if the odometric frame is still the same.
    pub(super) whole: Option<(Stamped<Posture>, Micros)>,
    /// Postures with uptimes of the latest epochs.
    pub(super) past: Recent<(Posture, Micros)>,
    pub(super) uncertainty: Option<Stamped<Mat3>>,
    /// Latest speed and yaw rate.
    pub(super) twist: Twist,
    /// Share of the axle's ticks in which its gyro was used.
    pub(super) gyro_share: f32,
    pub(super) gyro_zeroed: bool,
}

impl AxleReport {
    /// No report.
    const EMPTY: Self = Self {
        posture: None,
        uptime: None,
        whole: None,
        past: Recent::EMPTY,
        uncertainty: None,
        twist: Twist::new(0.0, 0.0),
        gyro_share: 0.0,
        gyro_zeroed: false,
    };

    /// Combines posture and uptime of one epoch into a whole report.
    pub(super) fn complete(&mut self) {
        if let (Some(posture), Some(uptime)) = (self.posture, self.uptime)
            && posture.time == uptime.time
        {
            let last = self.whole.map_or(0, |(last, _)| last.time);
            if uptime.value < posture.time.saturating_sub(last) {
                // Earlier postures are in another odometric frame.
                self.past = Recent::EMPTY;
            }
            self.whole = Some((posture, uptime.value));
            self.past
                .put(Stamped::new((posture.value, uptime.value), posture.time));
        }
    }
}

/// Values of the latest `EPOCHS` epochs, found by the time at which the epoch began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Recent<T>([Option<Stamped<T>>; EPOCHS]);

/// Number of epochs that are kept.
pub(super) const EPOCHS: usize = 8;

impl<T> Recent<T> {
    /// No values.
    pub(super) const EMPTY: Self = Self([const { None }; EPOCHS]);
}

impl<T: Copy> Recent<T> {
    /// Stores the value of an epoch.
    pub(super) fn put(&mut self, value: Stamped<T>) {
        self.0[Self::place(value.time)] = Some(value);
    }

    /// The value of the epoch that began at `time`.
    pub(super) fn at(&self, time: Micros) -> Option<T> {
        let value = self.0[Self::place(time)]?;
        (value.time == time).then_some(value.value)
    }

    fn place(time: Micros) -> usize {
        // Only 32 bits are divided, because a division of 64 bits takes 2 µs on a board. Where they wrap, a value is
        // lost.
        (time as u32 / EPOCH as u32) as usize % EPOCHS
    }
}

/// Motion of an axle since the last step of the lead node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Advance {
    /// No new report, or no earlier report to compare with.
    Unknown,
    /// Motion by odometry.
    Moved(Increment),
    /// The odometry restarted within this number of epochs.
    Restarted { ticks: u16 },
}

impl Advance {
    /// The increment; `None` without a new report. A restarted axle gets the motion of the `other` axle, with the
    /// uncertainty [`RESTART_SIGMAS`].
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

/// Posture `after` in the frame of `before`. Positions repeat after a span of the bus, so only their wrapped
/// difference counts.
fn between(before: Posture, after: Posture) -> Posture {
    let moved = Posture::new(
        wrap_position(after.x - before.x),
        wrap_position(after.y - before.y),
        after.phi,
    );
    moved.relative_to(Posture::new(0.0, 0.0, before.phi))
}

/// Latest report of one axle, and its odometric posture at the fused estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct AxleTrack {
    pub(super) report: AxleReport,
    /// Odometric posture at the epoch of the fused estimate.
    pub(super) odometry: Option<Stamped<Posture>>,
}

impl AxleTrack {
    /// No report.
    pub(super) const EMPTY: Self = Self {
        report: AxleReport::EMPTY,
        odometry: None,
    };

    /// Uptime of the axle, if the axle started after the last step. After a silence longer than the largest uptime of
    /// a report, a restart is assumed.
    pub(super) fn restarted(&self) -> Option<Micros> {
        let (latest, uptime) = self.report.whole?;
        (uptime < latest.time.saturating_sub(self.odometry?.time)).then_some(uptime)
    }

    /// Motion between two epochs by odometry.
    pub(super) fn moved(&self, from: Micros, to: Micros) -> Option<Posture> {
        let past = &self.report.past;
        let ((before, _), (after, _)) = (past.at(from)?, past.at(to)?);
        Some(between(before, after))
    }

    /// Motion since the last step up to the epoch `to`, over any number of epochs.
    pub(super) fn advance(&mut self, to: Micros) -> Advance {
        let Some((posture, uptime)) = self.report.past.at(to) else {
            return Advance::Unknown;
        };
        let latest = Stamped::new(posture, to);
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
        // The fusion adds slip, so the covariance is not zero even if none was reported.
        let covariance = self.report.uncertainty.map_or([[0.0; 3]; 3], |u| u.value);
        Advance::Moved(Increment {
            posture: between(last.value, latest.value),
            covariance: scale(&covariance, f32::from(ticks)),
            ticks,
            gyro_share: self.report.gyro_share,
            gyro_zeroed: self.report.gyro_zeroed,
        })
    }
}
