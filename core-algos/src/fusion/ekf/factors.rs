//! Covariance of the axle filter as P = U D Uᵀ, U unit upper triangular, D diagonal (Bierman,
//! Thornton), with its time and measurement updates.
//!
//! What filters lose in single precision they lose when a small variance is formed as the
//! difference of large ones: by a measurement much stronger than the prediction, by two wheels that
//! tie speed and yaw rate together, by a position that swings out and back with an unknown heading.
//! In factors no such difference is ever taken, P is positive semidefinite by construction, and
//! single precision gives what the matrix itself would need twice the digits for.
//!
//! The order of the states (paper eq. 19) suits the model: each state is driven only by later ones,
//! so that A is unit upper triangular, A U is again of the form wanted, and D is untouched. Process
//! noise is added as rank-one terms (Agee and Turner), measurements one by one (Bierman); both equal
//! Joseph's form in exact arithmetic.

use super::{N, OMEGA, OMEGA_DOT, PHI, V, V_DOT, X, Y};
use crate::math::TwoFloat;
use crate::math::matrix::{Mat, Mat3};

/// Variances are scaled back to this (in squared state units) when they pass it.
const MAX_VARIANCE: f32 = 1e6;

/// A symmetric positive semidefinite 7×7 covariance in factors: 28 numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance {
    /// D on the diagonal, U above it, zeros below.
    factors: Mat<N, N>,
}

/// A step of the motion model, as its covariance needs it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub t: f32,
    pub half_t2: f32,
    /// Sine and cosine of the midpoint heading.
    pub sin: f32,
    pub cos: f32,
    /// Displacement in the global frame.
    pub dx: f32,
    pub dy: f32,
}

/// variance · a aᵀ on its way into the factors.
struct RankOne {
    a: [f32; N],
    variance: f32,
}

impl RankOne {
    /// Puts the share of state `J` into the factors; what remains lies in the states before it.
    #[inline(always)]
    fn absorb<const J: usize>(&mut self, u: &mut Mat<N, N>) {
        let before = u[J][J];
        let scaled = self.variance * self.a[J];
        let after = before + scaled * self.a[J];
        if !(after > 0.0) {
            return;
        }
        let inverse = 1.0 / after;
        let beta = scaled * inverse;
        for i in 0..J {
            self.a[i] -= self.a[J] * u[i][J];
            u[i][J] += beta * self.a[i];
        }
        self.variance *= before * inverse;
        u[J][J] = after;
    }
}

impl Covariance {
    /// Nothing unknown.
    pub const ZERO: Self = Self {
        factors: [[0.0; N]; N],
    };

    /// From a symmetric positive semidefinite matrix; its upper triangle is read. A state whose
    /// variance is, up to rounding, explained by later ones gets none of its own.
    pub fn from_matrix(matrix: &Mat<N, N>) -> Self {
        let mut rest = matrix.map(|row| row.map(TwoFloat::from_f32));
        let mut factors = [[0.0; N]; N];
        for j in (0..N).rev() {
            let pivot = rest[j][j];
            if !(pivot.high > 0.0 && pivot.is_finite()) {
                continue;
            }
            factors[j][j] = pivot.value();
            for i in 0..j {
                let factor = rest[i][j] / pivot;
                factors[i][j] = factor.value();
                for k in 0..=i {
                    rest[k][i] = rest[k][i] - factor * rest[k][j];
                }
            }
        }
        Self { factors }
    }

    /// Entry of U: row `i`, column `j` ≥ `i`.
    #[inline]
    fn unit(&self, i: usize, j: usize) -> f32 {
        if i == j { 1.0 } else { self.factors[i][j] }
    }

    /// One entry of P.
    pub fn entry(&self, i: usize, j: usize) -> f32 {
        let (i, j) = (i % N, j % N);
        let mut sum = 0.0;
        for k in i.max(j)..N {
            sum += self.unit(i, k) * self.unit(j, k) * self.factors[k][k];
        }
        sum
    }

    /// P, exactly symmetric.
    pub fn matrix(&self) -> Mat<N, N> {
        let mut full = [[0.0; N]; N];
        for i in 0..N {
            for j in i..N {
                let entry = self.entry(i, j);
                full[i][j] = entry;
                full[j][i] = entry;
            }
        }
        full
    }

    /// P with more digits than `f32`, so that it stays positive definite however small a pivot is.
    pub fn wide_matrix(&self) -> [[TwoFloat; N]; N] {
        let mut full = [[TwoFloat::ZERO; N]; N];
        for i in 0..N {
            for j in i..N {
                let mut sum = TwoFloat::ZERO;
                for k in j..N {
                    let term = TwoFloat::from_f32(self.unit(i, k))
                        * TwoFloat::from_f32(self.unit(j, k))
                        * TwoFloat::from_f32(self.factors[k][k]);
                    sum = sum + term;
                }
                full[i][j] = sum;
                full[j][i] = sum;
            }
        }
        full
    }

    /// The block of x, y and φ.
    pub fn posture(&self) -> Mat3 {
        let mut block = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in i..3 {
                let entry = self.entry(i, j);
                block[i][j] = entry;
                block[j][i] = entry;
            }
        }
        block
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        crate::math::matrix::is_finite(&self.factors)
    }

    /// A P Aᵀ (eq. 17): A U in place, with the zeros and ones of both left out.
    #[inline]
    pub(super) fn propagate(&mut self, motion: &Motion) {
        let Motion {
            t,
            half_t2,
            sin,
            cos,
            dx,
            dy,
        } = *motion;
        let row = |u: &Mat<N, N>, i: usize, j: usize| match i.cmp(&j) {
            core::cmp::Ordering::Less => u[i][j],
            core::cmp::Ordering::Equal => 1.0,
            core::cmp::Ordering::Greater => 0.0,
        };
        let u = &mut self.factors;
        for j in PHI..N {
            let distance = t * row(u, V, j) + half_t2 * row(u, V_DOT, j);
            let turn = t * row(u, OMEGA, j) + half_t2 * row(u, OMEGA_DOT, j);
            let middle = row(u, PHI, j) + 0.5 * turn;
            u[X][j] += cos * distance - dy * middle;
            u[Y][j] += sin * distance + dx * middle;
            if j >= OMEGA {
                u[PHI][j] += turn;
            }
        }
        u[V][V_DOT] += t;
        u[V][OMEGA_DOT] += t * u[V_DOT][OMEGA_DOT];
        u[OMEGA][OMEGA_DOT] += t;
    }

    /// P + variance · a aᵀ, for a vector whose components after `LAST` are zero (Agee and Turner).
    #[inline]
    pub(super) fn add_rank_one<const LAST: usize>(&mut self, a: [f32; N], variance: f32) {
        let mut term = RankOne { a, variance };
        if LAST >= 6 {
            term.absorb::<6>(&mut self.factors);
        }
        if LAST >= 5 {
            term.absorb::<5>(&mut self.factors);
        }
        if LAST >= 4 {
            term.absorb::<4>(&mut self.factors);
        }
        if LAST >= 3 {
            term.absorb::<3>(&mut self.factors);
        }
        if LAST >= 2 {
            term.absorb::<2>(&mut self.factors);
        }
        if LAST >= 1 {
            term.absorb::<1>(&mut self.factors);
        }
        self.factors[0][0] += term.variance * term.a[0] * term.a[0];
    }

    /// P + Q for a Q given in factors.
    pub(super) fn add(&mut self, noise: &Self) {
        let q = &noise.factors;
        let column = |j: usize| {
            let mut a = [0.0; N];
            for i in 0..j {
                a[i] = q[i][j];
            }
            a[j] = 1.0;
            a
        };
        self.add_rank_one::<0>(column(0), q[0][0]);
        self.add_rank_one::<1>(column(1), q[1][1]);
        self.add_rank_one::<2>(column(2), q[2][2]);
        self.add_rank_one::<3>(column(3), q[3][3]);
        self.add_rank_one::<4>(column(4), q[4][4]);
        self.add_rank_one::<5>(column(5), q[5][5]);
        self.add_rank_one::<6>(column(6), q[6][6]);
    }

    /// Update by a measurement of h · state with noise of the given variance (eq. 18, Bierman); the
    /// components of h before `FIRST` are zero. Returns the gain.
    #[inline]
    pub(super) fn observe<const FIRST: usize>(&mut self, h: &[f32; N], variance: f32) -> [f32; N] {
        let u = &mut self.factors;
        let mut gain = [0.0; N];
        // Innovation variance so far and its inverse.
        let mut total = variance;
        let mut inverse = 1.0 / total;
        for j in FIRST..N {
            let mut f = h[j];
            for i in FIRST..j {
                f += u[i][j] * h[i];
            }
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

    /// Takes the given share of the posture's own covariance out and returns it.
    ///
    /// The leading block of the factors is the posture's covariance given all other states: what
    /// remains of its error when speeds and accelerations are known.
    pub(super) fn take_posture(&mut self, share: f32) -> Mat3 {
        let mut own = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in i..3 {
                let mut sum = 0.0;
                for k in j..3 {
                    sum += self.unit(i, k) * self.unit(j, k) * self.factors[k][k];
                }
                own[i][j] = share * sum;
                own[j][i] = share * sum;
            }
        }
        for k in 0..3 {
            self.factors[k][k] *= 1.0 - share;
        }
        own
    }

    /// Scales back variances that have grown without bound, correlations kept.
    pub(super) fn bound(&mut self) {
        for i in 0..N {
            let variance = self.entry(i, i);
            if !(variance <= MAX_VARIANCE) {
                let shrink = crate::math::trig::sqrt(MAX_VARIANCE / variance);
                for k in 0..i {
                    self.factors[k][i] /= shrink;
                }
                for j in i + 1..N {
                    self.factors[i][j] *= shrink;
                }
                self.factors[i][i] *= shrink * shrink;
            }
        }
    }
}
