//! Covariance of a filter and its measurement updates.
//!
//! Only the upper triangle is kept, so the matrix is symmetric by construction.

use crate::math::matrix::{self, Mat, Mat3};

/// A pivot of the covariance below this share of its variance is lifted by [`LIFT`]: correlation
/// coefficients are then kept away from the ±1 that rounding would carry them past.
const LEAST_PIVOT: f32 = 1e-4;
/// Share of a variance that is added when its pivot is too small.
const LIFT: f32 = 4e-6;
/// Variances are scaled back to this (in squared state units) when they pass it.
const MAX_VARIANCE: f32 = 1e6;

/// The covariance of `N` states, at least three, of which the first three are a posture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance<const N: usize> {
    /// Entries with column ≥ row are valid; the rest stay zero.
    pub(super) upper: Mat<N, N>,
}

impl<const N: usize> Covariance<N> {
    /// From a symmetric matrix; its upper triangle is read.
    pub fn from_matrix(matrix: &Mat<N, N>) -> Self {
        let mut upper = [[0.0; N]; N];
        for i in 0..N {
            for j in i..N {
                upper[i][j] = matrix[i][j];
            }
        }
        Self { upper }
    }

    /// The full matrix, exactly symmetric.
    #[cfg(test)]
    pub(crate) fn matrix(&self) -> Mat<N, N> {
        let mut full = self.upper;
        for i in 0..N {
            for j in 0..i {
                full[i][j] = self.upper[j][i];
            }
        }
        full
    }

    /// The block of the first three states.
    pub fn posture(&self) -> Mat3 {
        let u = &self.upper;
        let mut block = [[0.0; 3]; 3];
        for (i, row) in u.iter().enumerate().take(3) {
            for (j, entry) in row.iter().enumerate().take(3).skip(i) {
                block[i][j] = *entry;
                block[j][i] = *entry;
            }
        }
        block
    }

    /// Gain of `M` measurements, each of one state from `first` on and of `h` times those of
    /// `states`; `noise` is the covariance of their noise. With S = H P Hᵀ + R = L Lᵀ, gives L and
    /// L⁻¹ H P. Nothing if S is not positive definite.
    #[inline(always)]
    pub(super) fn seen<const S: usize, const M: usize>(
        &self,
        first: usize,
        states: &[usize; S],
        h: &Mat<M, S>,
        noise: &Mat<M, M>,
    ) -> Option<(Mat<M, M>, Mat<M, N>)> {
        let mut told = [[0.0; N]; M];
        let u = &self.upper;
        for j in 0..N {
            let entry = |state: usize| match state < j {
                true => u[state % N][j],
                false => u[j][state % N],
            };
            let others = states.map(entry);
            for m in 0..M {
                let mut sum = entry(first + m);
                for k in 0..S {
                    sum += h[m][k] * others[k];
                }
                told[m][j] = sum;
            }
        }
        let mut sum = *noise;
        for m in 0..M {
            for n in 0..M {
                sum[m][n] += told[m][(first + n) % N];
                for k in 0..S {
                    sum[m][n] += h[n][k] * told[m][states[k] % N];
                }
            }
        }
        let factor = matrix::cholesky(&sum)?;
        for m in 0..M {
            let inverse = 1.0 / factor[m][m];
            for l in 0..m {
                let by = factor[m][l];
                for j in 0..N {
                    told[m][j] -= by * told[l][j];
                }
            }
            for entry in &mut told[m] {
                *entry *= inverse;
            }
        }
        Some((factor, told))
    }

    /// Takes off what three measurements have told ([`Self::seen`]): P − (L⁻¹ H P)ᵀ (L⁻¹ H P).
    pub(super) fn take_off(&mut self, told: &Mat<3, N>) {
        for i in 0..N {
            let [x, y, z] = told;
            let by = [x[i], y[i], z[i]];
            let told = x[i..].iter().zip(&y[i..]).zip(&z[i..]);
            for (entry, ((x, y), z)) in self.upper[i][i..].iter_mut().zip(told) {
                *entry -= by[0] * x + by[1] * y + by[2] * z;
            }
        }
    }

    /// State `m` becomes `kept` times itself and an independent error of variance `added`.
    pub(super) fn fade(&mut self, m: usize, kept: f32, added: f32) {
        let m = m % N;
        for j in 0..N {
            self.upper[j.min(m)][j.max(m)] *= kept;
        }
        self.upper[m][m] = kept * self.upper[m][m] + added;
    }

    /// Keeps the matrix finite and positive definite over millions of steps: scales back variances
    /// that have grown without bound, and lifts those whose pivot is lost in rounding. Both happen
    /// rarely, and both only when the entries concerned have lost their meaning.
    pub(super) fn condition(&mut self) {
        for i in 0..N {
            let variance = self.upper[i][i];
            if !(variance <= MAX_VARIANCE) {
                let shrink = crate::math::trig::sqrt(MAX_VARIANCE / variance);
                for j in 0..N {
                    if j < i {
                        self.upper[j][i] *= shrink;
                    } else {
                        self.upper[i][j] *= shrink;
                    }
                }
                self.upper[i][i] = MAX_VARIANCE;
            }
        }
        // Pivots of L D Lᵀ, eliminating from the first state on.
        let mut rest = self.upper;
        for k in 0..N {
            let variance = self.upper[k][k];
            let floor = LEAST_PIVOT * variance;
            if !(rest[k][k] >= floor) {
                let lift = (LIFT * variance).max(floor - rest[k][k]).min(variance);
                self.upper[k][k] += lift;
                rest[k][k] = (rest[k][k] + lift).max(floor);
            }
            if !(rest[k][k] > 0.0) {
                continue;
            }
            let inverse = 1.0 / rest[k][k];
            for i in k + 1..N {
                let factor = rest[k][i] * inverse;
                for j in i..N {
                    rest[i][j] -= factor * rest[k][j];
                }
            }
        }
    }
}
