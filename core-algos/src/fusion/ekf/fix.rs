//! Measurement model: a posture fix, z = (x, y, φ) with a full noise covariance, from a camera over
//! the floor, a beacon or a known start.
//!
//! The noise is decorrelated by R = L D Lᵀ; the three scalar updates that follow equal the batch
//! update. The heading innovation is wrapped.

use super::factors::M;
use super::{AxleFilter, PHI, State, V, Verdict, X, Y};
use crate::math::Posture;
use crate::math::matrix::{Mat3, Vec3};
use crate::math::trig::wrap_angle;

/// The decorrelated noise of a posture fix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fix {
    covariance: Mat3,
    /// Rows 1 and 2 of L⁻¹ below the diagonal: (1, 0), (2, 0), (2, 1).
    mixing: [f32; 3],
    variances: [f32; 3],
}

impl Fix {
    /// Decorrelates a noise with this covariance of (x, y, φ), of which the lower triangle is read. `None` unless it is
    /// positive definite.
    pub fn new(covariance: &Mat3) -> Option<Self> {
        let r = covariance;
        let ok = |variance: f32| variance > 0.0 && variance.is_finite();
        let d0 = r[0][0];
        if !ok(d0) {
            return None;
        }
        let (l10, l20) = (r[1][0] / d0, r[2][0] / d0);
        let d1 = r[1][1] - l10 * r[1][0];
        if !ok(d1) {
            return None;
        }
        let l21 = (r[2][1] - l20 * r[1][0]) / d1;
        let d2 = r[2][2] - l20 * r[2][0] - l21 * l21 * d1;
        if !ok(d2) {
            return None;
        }
        Some(Self {
            covariance: *covariance,
            mixing: [-l10, l21 * l10 - l20, -l21],
            variances: [d0, d1, d2],
        })
    }
}

impl AxleFilter {
    /// Update by a posture in the filter's frame.
    pub fn update_fix(&self, state: &mut State, posture: &Posture, fix: &Fix) -> Verdict {
        if !posture.is_finite() {
            return state.counters.fix.refuse();
        }
        let z: Vec3 = [posture.x, posture.y, posture.phi];
        let mut innovation = [0.0; 3];
        for i in 0..3 {
            // The high part is subtracted first: this difference of near values is exact, so the low part is not lost.
            innovation[i] = (z[i] - state.posture[i].high) - state.posture[i].low;
        }
        innovation[PHI] = wrap_angle(innovation[PHI]);
        let nis = || {
            let mut s = state.covariance.posture();
            for i in 0..3 {
                for j in 0..3 {
                    s[i][j] += fix.covariance[i.max(j)][i.min(j)];
                }
            }
            match crate::math::matrix::cholesky(&s) {
                Some(factor) => {
                    let solved = crate::math::matrix::cholesky_solve(&factor, &innovation);
                    (0..3).map(|i| innovation[i] * solved[i]).sum()
                }
                None => f32::INFINITY,
            }
        };
        let verdict = state
            .counters
            .fix
            .verdict(nis, self.fix_gate, self.patience);
        if verdict != Verdict::Used {
            return verdict;
        }
        let [m10, m20, m21] = fix.mixing;
        let rows = [[1.0, 0.0, 0.0], [m10, 1.0, 0.0], [m20, m21, 1.0]];
        let p = &mut state.covariance;
        let change = p.observe_posture(&rows, &fix.variances, &innovation);
        state.advance([change[X], change[Y], change[PHI]]);
        for k in 0..M {
            state.motion[k] += change[V + k];
        }
        verdict
    }
}
