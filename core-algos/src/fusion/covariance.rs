//! Covariance of a filter and its measurement updates, one scalar at a time.
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
    pub fn matrix(&self) -> Mat<N, N> {
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

    /// Row (or column) `m`.
    #[inline]
    pub(super) fn row(&self, m: usize) -> [f32; N] {
        let m = m % N;
        let mut row = self.upper[m];
        for j in 0..m {
            row[j] = self.upper[j][m];
        }
        row
    }

    /// Writes row and column `m`.
    #[inline]
    fn set_row(&mut self, m: usize, row: &[f32; N]) {
        let m = m % N;
        for j in 0..m {
            self.upper[j][m] = row[j];
        }
        // Not copied as a slice: that is a call, which costs more than these few entries.
        for (j, entry) in row.iter().enumerate().skip(m) {
            self.upper[m][j] = *entry;
        }
    }

    /// Update by a measurement of `Σ coefficient · state` over a few different states, with noise of
    /// the given variance; returns the gain.
    ///
    /// Joseph's form with 1 − K_i h_i of the measured states evaluated as (s − P_i h h_i)/s without
    /// the part that cancels. Between other states, and between those and the measured ones, the
    /// form reduces to products with one side of (I − K h).
    pub(super) fn observe_sum<const S: usize>(
        &mut self,
        states: [usize; S],
        coefficients: [f32; S],
        variance: f32,
    ) -> [f32; N] {
        let mut rows = [[0.0; N]; S];
        for k in 0..S {
            rows[k] = self.row(states[k]);
        }
        let mut row = [0.0; N];
        for k in 0..S {
            for j in 0..N {
                row[j] += coefficients[k] * rows[k][j];
            }
        }
        let mut total = variance;
        for k in 0..S {
            total += coefficients[k] * at(&row, states[k]);
        }
        let inverse = 1.0 / total;
        let gain = row.map(|entry| entry * inverse);
        // The block of I − K h between the measured states.
        let mut factor = [[0.0; S]; S];
        for i in 0..S {
            for k in 0..S {
                factor[i][k] = -at(&gain, states[i]) * coefficients[k];
            }
            let mut rest = variance;
            for l in 0..S {
                if l != i {
                    rest += coefficients[l] * at(&row, states[l]);
                }
            }
            factor[i][i] = rest * inverse;
        }
        for i in 0..N {
            for j in i..N {
                self.upper[i][j] -= gain[i] * row[j];
            }
        }
        let left = matrix::multiply(&factor, &rows);
        for i in 0..S {
            self.set_row(states[i], &left[i]);
        }
        for i in 0..S {
            for j in i..S {
                let mut entry = variance * at(&gain, states[i]) * at(&gain, states[j]);
                for l in 0..S {
                    entry += at(&left[i], states[l]) * factor[j][l];
                }
                self.set(states[i], states[j], entry);
            }
        }
        gain
    }

    #[inline]
    fn set(&mut self, i: usize, j: usize, entry: f32) {
        self.upper[i.min(j) % N][i.max(j) % N] = entry;
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

/// Entry `i` of a row, without a panic path where the compiler cannot see that `i` is below `N`.
#[inline]
fn at<const N: usize>(row: &[f32; N], i: usize) -> f32 {
    row.get(i).copied().unwrap_or(0.0)
}
