//! Limits of the variances.

use super::{Covariance, M, MAX_VARIANCE};
use crate::fusion::ekf::N;

impl Covariance {
    /// Does one part of the upkeep; the caller runs the parts in turn. Part k from 0 to 6 scales the variance of state
    /// k back to the limit and keeps the correlations. Part 7 removes a negligible coupling of (v, v̇) and (φ̇, φ̈).
    /// Other parts do nothing.
    pub(in crate::fusion::ekf) fn keep_up(&mut self, part: usize) {
        if part < N {
            let variance = self.variance(part);
            if !(variance <= MAX_VARIANCE) {
                self.shrink(part, crate::math::trig::sqrt(MAX_VARIANCE / variance));
            }
        } else if part == N && self.coupled {
            self.find_coupling(Self::NEGLIGIBLE);
        }
    }

    fn variance(&self, i: usize) -> f32 {
        if i < 3 {
            let mut own = self.own[i][i];
            for k in i + 1..3 {
                own += self.own[i][k] * self.own[i][k] * self.own[k][k];
            }
            own + self.motion_variance(&self.follow[i])
        } else {
            let mut row = [0.0; M];
            row[i - 3] = 1.0;
            self.motion_variance(&row)
        }
    }

    #[cold]
    fn shrink(&mut self, i: usize, factor: f32) {
        let mut factors = self.factors();
        for k in 0..i {
            factors[k][i] /= factor;
        }
        for j in i + 1..N {
            factors[i][j] *= factor;
        }
        factors[i][i] *= factor * factor;
        *self = Self::from_factors(&factors);
    }
}
