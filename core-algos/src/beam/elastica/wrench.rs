//! Wrench of the strip on the axles.

use crate::math::Posture;
use crate::math::matrix::{Mat3, is_finite};

/// Standard deviations within which a force is not significant.
const SIGNIFICANT_SIGMAS: f32 = 2.0;

/// Wrench of the strip on the axles, in the rear axle's coordinates.
///
/// The strip acts on the rear axle with force (+fx, +fy) and moment +root_moment, on the front axle with force (−fx,
/// −fy) and moment −tip_moment. Each moment is about the axle's midpoint. A left bend by pure moments has fx = fy = 0
/// and both moments positive; a strip compressed between the axles has fx < 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench {
    /// Force along the rear axle's x, N.
    pub fx: f32,
    /// Force along the rear axle's y, N.
    pub fy: f32,
    /// Moment at the rear axle's midpoint, N m.
    pub root_moment: f32,
    /// Moment at the front axle's midpoint, N m.
    pub tip_moment: f32,
    /// Covariance of (fx, fy, root_moment). The strains of a nearly straight strip do not determine fx; its variance
    /// is then that of the prior.
    pub covariance: Mat3,
}

impl Wrench {
    /// True if every number is finite.
    pub fn is_finite(&self) -> bool {
        self.fx.is_finite()
            && self.fy.is_finite()
            && self.root_moment.is_finite()
            && self.tip_moment.is_finite()
            && is_finite(&self.covariance)
    }

    /// Significant part of the wrench: each force is reduced by its uncertainty, and is zero within two standard
    /// deviations. `posture` is that of the front axle, for the balance of moments. The strains of a nearly straight
    /// strip do not determine the axial force; the fitted force must neither stop the robot nor drive its motors.
    pub fn significant(&self, posture: Posture) -> Self {
        let significant = |force: f32, variance: f32| {
            let share = 1.0 - SIGNIFICANT_SIGMAS * SIGNIFICANT_SIGMAS * variance / (force * force);
            // The share is NaN or −∞ for a force of zero.
            if share > 0.0 { share * force } else { 0.0 }
        };
        let fx = significant(self.fx, self.covariance[0][0]);
        let fy = significant(self.fy, self.covariance[1][1]);
        Self {
            fx,
            fy,
            tip_moment: self.root_moment + fx * posture.y - fy * posture.x,
            ..*self
        }
    }
}
