//! Odometric increments with the covariance of slip.

use super::{Increment, Load, REFERENCE_TIME_S, REFERENCE_WAY_M, RobotFusion};
use crate::fusion::{Estimate, constants};
use crate::math::RelativeHeading;

/// An odometric increment with the variance of slip added.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Slipping {
    /// Increment. Its covariance lies along and across the heading at its end, and in heading.
    pub(super) estimate: Estimate,
    /// Variance of the heading change; constant errors count as random walks.
    pub(super) heading_variance: f32,
    pub(super) advance: f32,
    pub(super) ticks: f32,
    pub(super) gyro_share: f32,
}

impl RobotFusion {
    /// The increment with slip and the noise of uneven ground added; a missing increment counts as no motion. `bend` is
    /// the relative heading of the pair.
    pub(super) fn with_slip(
        &self,
        increment: Option<Increment>,
        bend: RelativeHeading,
        load: &Load,
        unevenness: f32,
    ) -> Slipping {
        let Some(increment) = increment else {
            return Slipping::default();
        };
        let ticks = f32::from(increment.ticks);
        let advance = increment.posture.x;
        let driven = advance.abs();
        let gyro_share = increment.gyro_share.clamp(0.0, 1.0);
        let by_wheels = 1.0 - gyro_share;
        let heading = bend.0 - load.unloaded.0;
        let mut posture = increment.posture;
        posture.y += self.joint.tyres().slip_aside(load.aside) * driven;
        let position = self.position_per_tick * ticks;
        let turning = (self.heading_per_tick + self.creep_per_tick * heading * heading) * ticks;
        let mut covariance = increment.covariance;
        covariance[0][0] += self.per_m[0] * driven + position;
        let across = self.per_m[1] + self.side_per_m * heading * heading;
        covariance[1][1] += across * driven + position;
        let per_m = self.per_m[2] + self.creep_per_m * heading * heading;
        covariance[2][2] += by_wheels * (per_m * driven + turning);
        let uneven = self.ground.variances(unevenness, driven, gyro_share);
        for (k, variance) in uneven.into_iter().enumerate() {
            covariance[k][k] += variance;
        }
        let by = |constant: usize| self.constants[constant] * by_wheels;
        let (drift, slip) = (by(constants::DRIFT), by(constants::COMPLIANCE) * heading);
        let bias = self.constants[constants::GYRO_BIAS] * gyro_share;
        Slipping {
            estimate: Estimate::new(posture, covariance),
            heading_variance: covariance[2][2]
                + (drift * drift + slip * slip) * driven * REFERENCE_WAY_M
                + bias * bias * ticks * self.period * REFERENCE_TIME_S,
            advance,
            ticks,
            gyro_share,
        }
    }
}
