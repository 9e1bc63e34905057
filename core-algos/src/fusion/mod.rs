//! Fusion: axle filter (paper eq. 16–19), covariance intersection, internal posture error
//! correction, and the second tier that joins both axles through the beam.
//!
//! [`ekf`] runs on each axle at the rate of its sensors and hands odometric increments to
//! [`tandem`], the second tier on the lead node; [`standstill`] zeroes its inertial sensors. The
//! second tier is built from [`compound`] (a posture seen through the beam), [`constants`] (errors
//! that stay the same) and [`track`] (what a posture owes to them), [`intersection`] (covariance
//! intersection), [`kalman`] (plain fusion, for comparison only), [`ipec`] (internal posture error
//! correction) and [`joint`] (one filter of both axles).

pub mod compound;
pub mod constants;
pub mod covariance;
pub mod ekf;
pub mod intersection;
pub mod ipec;
pub mod joint;
pub mod kalman;
pub mod standstill;
pub mod tandem;
#[cfg(test)]
pub(crate) mod testing;
pub mod track;

use crate::math::Posture;
use crate::math::matrix::{self, Mat3};

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

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.posture.is_finite() && matrix::is_finite(&self.covariance)
    }
}
