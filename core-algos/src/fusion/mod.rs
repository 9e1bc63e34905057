//! Fusion in two tiers: one filter on each axle, then one fusion of both axles with the beam.
//!
//! First tier, on each axle board: [`ekf`] is the axle filter (paper eq. 16–19), [`standstill`] estimates the biases
//! of the inertial sensors at rest.
//!
//! Second tier, on the lead node: [`robot`] combines odometric increments of both axles with the beam's posture. Its
//! methods are [`intersection`] (covariance intersection), [`ipec`] (internal posture error correction) and [`joint`]
//! (one filter of both axles). [`compound`] computes a posture seen through the beam. [`constants`] describes errors
//! that stay the same throughout a drive, [`track`] a posture's sensitivity to them. [`estimator`] is the interface of
//! an estimator of the user.

pub mod compound;
pub mod constants;
pub mod covariance;
pub mod ekf;
pub mod estimator;
pub mod intersection;
pub mod ipec;
pub mod joint;
pub mod robot;
pub mod standstill;
#[cfg(test)]
pub(crate) mod testing;
pub mod track;

use crate::math::Posture;
use crate::math::matrix::{self, Mat3};
use crate::math::trig::{sin_cos, sqrt};

/// A posture with the covariance of its error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Estimate {
    /// The posture (m, m, rad).
    pub posture: Posture,
    /// Covariance of (x, y, phi), errors along the axes of the frame the posture is given in;
    /// m², m rad, rad².
    pub covariance: Mat3,
}

impl Estimate {
    /// A posture with its covariance.
    pub const fn new(posture: Posture, covariance: Mat3) -> Self {
        Self {
            posture,
            covariance,
        }
    }

    /// A posture with independent errors of the given standard deviations (m, m, rad).
    pub fn with_sigmas(posture: Posture, sigmas: [f32; 3]) -> Self {
        Self::new(posture, matrix::diagonal(sigmas.map(|sigma| sigma * sigma)))
    }

    /// Estimate of the point `distance` (m) ahead on a rigid body.
    #[must_use]
    pub fn ahead(&self, distance: f32) -> Self {
        let (posture, turned) = (self.posture.advance(distance, 0.0), self.posture.phi);
        let (sin, cos) = sin_cos(turned);
        let carried = [
            [1.0, 0.0, -distance * sin],
            [0.0, 1.0, distance * cos],
            [0.0, 0.0, 1.0],
        ];
        Self::new(posture, matrix::propagate(&carried, &self.covariance))
    }

    /// Half axes of the 95 % region: longer half axis of the position ellipse (m), half the interval of the heading
    /// (rad).
    pub fn half_axes_95(&self) -> [f32; 2] {
        let p = &self.covariance;
        let half = 0.5 * (p[0][0] - p[1][1]);
        let across = sqrt(half * half + p[0][1] * p[1][0]);
        let longest = 0.5 * (p[0][0] + p[1][1]) + across;
        // 95 % quantiles of χ² with two degrees of freedom and with one.
        [sqrt(5.991 * longest), sqrt(3.841 * p[2][2])]
    }

    /// True if every number is finite.
    pub fn is_finite(&self) -> bool {
        self.posture.is_finite() && matrix::is_finite(&self.covariance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ellipse of known half axes at several angles; a search over directions gives the reference.
    #[test]
    fn half_axes_95_of_a_turned_ellipse_match_a_search_over_directions() {
        for turn in [0.0f32, 0.4, 1.2, 2.5] {
            let (sin, cos) = turn.sin_cos();
            let (long, short) = (0.02f32 * 0.02, 0.005f32 * 0.005);
            let mut covariance = matrix::diagonal([0.0, 0.0, 4e-4]);
            covariance[0][0] = cos * cos * long + sin * sin * short;
            covariance[1][1] = sin * sin * long + cos * cos * short;
            covariance[0][1] = sin * cos * (long - short);
            covariance[1][0] = covariance[0][1];
            let widest = (0..3142)
                .map(|k| {
                    let (y, x) = (k as f32 * 1e-3).sin_cos();
                    x * x * covariance[0][0]
                        + 2.0 * x * y * covariance[0][1]
                        + y * y * covariance[1][1]
                })
                .fold(0.0, f32::max);
            let [position, heading] = Estimate::new(Posture::ORIGIN, covariance).half_axes_95();
            // 95 % of two normal errors lie within √(−2 ln 0.05), of one within 1.96.
            let factor = (-2.0 * 0.05f32.ln()).sqrt();
            assert!((position / (factor * widest.sqrt()) - 1.0).abs() < 1e-4);
            assert!((position / (factor * 0.02) - 1.0).abs() < 1e-3);
            assert!((heading / (1.96 * 0.02) - 1.0).abs() < 1e-3);
        }
        let unknown = Estimate::with_sigmas(Posture::ORIGIN, [f32::NAN; 3]);
        assert!(unknown.half_axes_95().iter().all(|axis| axis.is_nan()));
    }
}
