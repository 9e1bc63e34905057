//! Measurement updates of the factors.

use super::{Covariance, M, SPEED, YAW_RATE};
use crate::fusion::ekf::{N, X};
use crate::math::matrix::{Mat, Mat3};

/// The measurement update of a factorised covariance (Bierman): `row` gives the entries of Uᵀ h, of
/// which those before `FIRST` are zero. Returns the gain.
fn bierman<const K: usize, const FIRST: usize>(
    u: &mut Mat<K, K>,
    variance: f32,
    row: impl Fn(&Mat<K, K>, usize) -> f32,
) -> [f32; K] {
    // The first column has nothing before it to correct.
    let f = row(u, FIRST);
    let g = u[FIRST][FIRST] * f;
    // Innovation variance so far and its inverse.
    let mut total = variance + f * g;
    let mut inverse = 1.0 / total;
    u[FIRST][FIRST] *= variance * inverse;
    let mut gain = [0.0; K];
    for i in 0..FIRST {
        gain[i] = u[i][FIRST] * g;
    }
    gain[FIRST] = g;
    for j in FIRST + 1..K {
        let f = row(u, j);
        let g = u[j][j] * f;
        let before = total;
        let shrink = -f * inverse;
        total += f * g;
        inverse = 1.0 / total;
        u[j][j] *= before * inverse;
        for i in 0..j {
            let entry = u[i][j];
            u[i][j] = entry + gain[i] * shrink;
            gain[i] += entry * g;
        }
        gain[j] = g;
    }
    gain.map(|entry| entry * inverse)
}

impl Covariance {
    /// Update by a measurement of `speed · v + yaw · φ̇` with noise of the given variance (eq. 18).
    /// Returns the gain.
    pub(in crate::fusion::ekf) fn observe_rates(
        &mut self,
        speed: f32,
        yaw: f32,
        variance: f32,
    ) -> [f32; M] {
        self.coupled = true;
        bierman::<M, SPEED>(&mut self.motion, variance, |u, j| match j {
            SPEED => speed,
            YAW_RATE => u[SPEED][YAW_RATE] * speed + yaw,
            _ => u[SPEED][j] * speed + u[YAW_RATE][j] * yaw,
        })
    }

    /// Update by a measurement of the motion state `STATE`. Returns the gain.
    pub(in crate::fusion::ekf) fn observe<const STATE: usize>(
        &mut self,
        variance: f32,
    ) -> [f32; M] {
        bierman::<M, STATE>(&mut self.motion, variance, |u, j| {
            if j == STATE { 1.0 } else { u[STATE][j] }
        })
    }

    /// Update by a measurement of motion state `I`, if only `K` > `I` is correlated with it. Returns the gains of
    /// both.
    pub(in crate::fusion::ekf) fn observe_first<const I: usize, const K: usize>(
        &mut self,
        variance: f32,
    ) -> [f32; 2] {
        let mut pair = [
            [self.motion[I][I], self.motion[I][K]],
            [0.0, self.motion[K][K]],
        ];
        let gain = bierman::<2, 0>(
            &mut pair,
            variance,
            |u, j| if j == 0 { 1.0 } else { u[0][1] },
        );
        self.motion[I][I] = pair[0][0];
        self.motion[I][K] = pair[0][1];
        self.motion[K][K] = pair[1][1];
        gain
    }

    /// Update by a measurement of motion state `K`, if only `I` < `K` is correlated with it. Returns the gains of
    /// both.
    pub(in crate::fusion::ekf) fn observe_second<const I: usize, const K: usize>(
        &mut self,
        variance: f32,
    ) -> [f32; 2] {
        let before = self.motion[K][K];
        let inverse = 1.0 / (before + variance);
        let gain = before * inverse;
        self.motion[K][K] = gain * variance;
        [self.motion[I][K] * gain, gain]
    }

    /// Update by three measurements, row · p for each row of `rows`, one after the other. `innovation` is measured less
    /// predicted posture. Returns the change of all states.
    pub(in crate::fusion::ekf) fn observe_posture(
        &mut self,
        rows: &Mat3,
        variances: &[f32; 3],
        innovation: &[f32; 3],
    ) -> [f32; N] {
        let mut factors = self.factors();
        let mut change = [0.0; N];
        for (row, variance) in rows.iter().zip(variances) {
            let mut h = [0.0; N];
            let mut rest = 0.0;
            for i in 0..3 {
                h[i] = row[i];
                rest += row[i] * (innovation[i] - change[i]);
            }
            let gain = bierman::<N, X>(&mut factors, *variance, |u, j| {
                (0..j).fold(h[j], |sum, i| sum + u[i][j] * h[i])
            });
            for i in 0..N {
                change[i] += gain[i] * rest;
            }
        }
        *self = Self::from_factors(&factors);
        change
    }
}
