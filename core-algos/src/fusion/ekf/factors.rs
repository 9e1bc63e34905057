//! Covariance of the axle filter, split into motion and posture as the model is.
//!
//! The motion states m = (v, φ̇, v̇, φ̈) do not depend on the posture p, and the axle's sensors measure m alone. So
//! the error of the posture is kept as p = G m + e with e independent of m. A measurement of m corrects p through G
//! and leaves G and the covariance of e unchanged. An update therefore costs as much as in a filter of four states.
//!
//! Both covariances, of m and of e, are kept as U D Uᵀ, U unit upper triangular, D diagonal (Bierman, Thornton). In
//! single precision a filter loses accuracy where it forms a small variance as the difference of large ones: by a
//! measurement much more accurate than the prediction, by two wheels that correlate speed and yaw rate, by a position
//! that moves out and back with an unknown heading. The factors form no such difference. P is positive semidefinite
//! by construction, and single precision achieves what the plain matrix needs double precision for.
//!
//! In the order of the states (paper eq. 19) each is driven only by later ones, so Φ U is again unit upper triangular
//! and D does not change. Process noise is added as rank-one terms (Agee and Turner), measurements one by one
//! (Bierman). With m' = Φ m the posture's dependence is G Φ⁻¹. Noise w changes motion and posture by b w and a w. The
//! regression of w on the changed motion, w = κᵀ m' + rest, gives p' = (G + γ κᵀ) m' + e + γ rest with γ = a − G b.

mod observe;
mod upkeep;

use super::{N, PHI, X, Y};
use crate::math::matrix::{Mat, Mat3};

/// Largest variance, in squared state units; a larger variance is scaled back to this value.
const MAX_VARIANCE: f32 = 1e6;

/// Number of motion states, and their indices.
pub(super) const M: usize = 4;
pub(super) const SPEED: usize = 0;
pub(super) const YAW_RATE: usize = 1;
pub(super) const ACCELERATION: usize = 2;
pub(super) const YAW_ACCELERATION: usize = 3;

/// A symmetric positive semidefinite 7×7 covariance: 28 numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance {
    /// Covariance of the motion states: D on the diagonal, U above it, zeros below.
    motion: Mat<M, M>,
    /// Matrix G: dependence of the posture error on the errors of the motion states.
    follow: Mat<3, M>,
    /// Covariance of e, the part of the posture error that is independent of the motion, factorised like `motion`.
    own: Mat3,
    /// True if an entry of U correlates (v, v̇) with (φ̇, φ̈). Two wheels of equal noise measure v and φ̇ separately,
    /// so that the two pairs are usually two filters of two states.
    coupled: bool,
}

/// Position part of the process noise, added after the heading part.
struct PositionNoise {
    xx: f32,
    xy: f32,
    yy: f32,
}

impl PositionNoise {
    fn add(&mut self, a: [f32; 3], variance: f32) {
        let scaled = variance * a[Y];
        self.yy += scaled * a[Y];
        self.xy += scaled * a[X];
        self.xx += variance * a[X] * a[X];
    }
}

/// Quantities of a motion step that its covariance depends on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub t: f32,
    pub half_t2: f32,
    /// Sine and cosine of the midpoint heading.
    pub sin: f32,
    pub cos: f32,
    /// Displacement in global coordinates.
    pub dx: f32,
    pub dy: f32,
}

/// Rank-one update of column `J` of a factorised matrix by `variance · a aᵀ`. On return `a` and `variance` describe the
/// rest of the update, for the columns before `J`. Returns β and the ratio of the old to the new diagonal entry.
fn absorb<const K: usize, const J: usize>(
    factors: &mut Mat<K, K>,
    a: &mut [f32; K],
    variance: &mut f32,
) -> (f32, f32) {
    let before = factors[J][J];
    let scaled = *variance * a[J];
    // The smallest positive number avoids a division by zero if variance and noise are both zero.
    let after = before + scaled * a[J] + f32::MIN_POSITIVE;
    let inverse = 1.0 / after;
    let (beta, ratio) = (scaled * inverse, before * inverse);
    for i in 0..J {
        a[i] -= a[J] * factors[i][J];
        factors[i][J] += beta * a[i];
    }
    *variance *= ratio;
    factors[J][J] = after;
    (beta, ratio)
}

/// `Σ a[k] b[k]` of a row of G and a motion.
fn dot(a: &[f32; M], b: &[f32; M]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
}

impl Covariance {
    /// Covariance of an exactly known state.
    pub const ZERO: Self = Self {
        motion: [[0.0; M]; M],
        follow: [[0.0; M]; 3],
        own: [[0.0; 3]; 3],
        coupled: false,
    };

    /// Correlation below which (v, v̇) and (φ̇, φ̈) count as independent.
    const NEGLIGIBLE: f32 = 1e-6;

    /// Factors of a symmetric positive semidefinite matrix, of which the upper triangle is read. A state whose variance
    /// is explained by later states, up to rounding, gets no variance of its own.
    pub fn from_matrix(matrix: &Mat<N, N>) -> Self {
        let mut rest = matrix.map(|row| row.map(f64::from));
        let mut factors = [[0.0; N]; N];
        for j in (0..N).rev() {
            let pivot = rest[j][j];
            if !(pivot > 0.0 && pivot.is_finite()) {
                continue;
            }
            factors[j][j] = pivot as f32;
            for i in 0..j {
                let factor = rest[i][j] / pivot;
                factors[i][j] = factor as f32;
                for k in 0..=i {
                    rest[k][i] -= factor * rest[k][j];
                }
            }
        }
        Self::from_factors(&factors)
    }

    /// Splits the factors of the whole matrix, D on the diagonal and U above it.
    fn from_factors(factors: &Mat<N, N>) -> Self {
        let mut p = Self::ZERO;
        for i in 0..M {
            for j in i..M {
                p.motion[i][j] = factors[3 + i][3 + j];
            }
        }
        for i in 0..3 {
            for j in i..3 {
                p.own[i][j] = factors[i][j];
            }
            // G U = the upper right block.
            for j in 0..M {
                let mut sum = factors[i][3 + j];
                for k in 0..j {
                    sum -= p.follow[i][k] * p.motion[k][j];
                }
                p.follow[i][j] = sum;
            }
        }
        p.find_coupling(0.0);
        p
    }

    /// Sets `coupled` if a correlation above `limit` couples (v, v̇) and (φ̇, φ̈); otherwise sets the coupling entries
    /// of U to zero.
    fn find_coupling(&mut self, limit: f32) {
        const TIES: [[usize; 2]; 4] = [
            [SPEED, YAW_RATE],
            [SPEED, YAW_ACCELERATION],
            [YAW_RATE, ACCELERATION],
            [ACCELERATION, YAW_ACCELERATION],
        ];
        let u = &self.motion;
        self.coupled = TIES.iter().any(|&[i, j]| {
            let tie = u[i][j];
            !(tie * tie * u[j][j] <= limit * limit * u[i][i])
        });
        if !self.coupled {
            for [i, j] in TIES {
                self.motion[i][j] = 0.0;
            }
        }
    }

    /// True if (v, v̇) and (φ̇, φ̈) are correlated.
    pub(super) fn is_coupled(&self) -> bool {
        self.coupled
    }

    /// The factors of the whole matrix.
    pub(super) fn factors(&self) -> Mat<N, N> {
        let mut factors = [[0.0; N]; N];
        for i in 0..N {
            for j in i..N {
                factors[i][j] = if i == j {
                    self.pivot(i)
                } else {
                    self.unit(i, j)
                };
            }
        }
        factors
    }

    /// Diagonal entry `i` of D of the whole matrix.
    fn pivot(&self, i: usize) -> f32 {
        match i {
            0..3 => self.own[i][i],
            _ => self.motion[i - 3][i - 3],
        }
    }

    /// Entry of U of the whole matrix: row `i`, column `j`.
    fn unit(&self, i: usize, j: usize) -> f32 {
        self.wide_unit(i, j) as f32
    }

    fn wide_unit(&self, i: usize, j: usize) -> f64 {
        match (i, j) {
            _ if i == j => 1.0,
            _ if i > j => 0.0,
            (0..3, 0..3) => self.own[i][j].into(),
            (0..3, _) => {
                let mut sum = f64::from(self.follow[i][j - 3]);
                for k in 0..j - 3 {
                    sum += f64::from(self.follow[i][k]) * f64::from(self.motion[k][j - 3]);
                }
                sum
            }
            _ => self.motion[i - 3][j - 3].into(),
        }
    }

    /// Entry of the whole covariance P in row `i` and column `j`.
    pub fn entry(&self, i: usize, j: usize) -> f32 {
        let (i, j) = (i % N, j % N);
        let mut sum = 0.0;
        for k in i.max(j)..N {
            sum += self.unit(i, k) * self.unit(j, k) * self.pivot(k);
        }
        sum
    }

    /// Variance of `row · m`.
    #[inline]
    pub(super) fn motion_variance(&self, row: &[f32; M]) -> f32 {
        let u = &self.motion;
        let mut sum = 0.0;
        for j in 0..M {
            let mut f = row[j];
            for i in 0..j {
                f += row[i] * u[i][j];
            }
            sum += f * f * u[j][j];
        }
        sum
    }

    #[cfg(test)]
    pub(crate) fn matrix(&self) -> Mat<N, N> {
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

    /// P in double precision, which stays positive definite however small a pivot is.
    pub fn wide_matrix(&self) -> [[f64; N]; N] {
        let mut full = [[0.0; N]; N];
        for i in 0..N {
            for j in i..N {
                let mut sum = 0.0;
                for k in j..N {
                    sum += self.wide_unit(i, k) * self.wide_unit(j, k) * f64::from(self.pivot(k));
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

    /// True if every number is finite.
    pub fn is_finite(&self) -> bool {
        crate::math::matrix::is_finite(&self.motion)
            && crate::math::matrix::is_finite(&self.follow)
            && crate::math::matrix::is_finite(&self.own)
    }

    /// Change of the posture due to a change of the motion: G · `change`.
    pub(super) fn follow(&self, change: &[f32; M]) -> [f32; 3] {
        let [x, y, phi] = &self.follow;
        [dot(x, change), dot(y, change), dot(phi, change)]
    }

    /// A P Aᵀ (eq. 17).
    pub(super) fn propagate(&mut self, motion: &Motion) {
        let Motion {
            t,
            half_t2,
            sin,
            cos,
            dx,
            dy,
        } = *motion;
        let [x, y, phi] = &mut self.follow;
        // Derivatives of the heading change and of the distance with respect to the motion states.
        let turn = [0.0, t, 0.0, half_t2];
        let distance = [t, 0.0, half_t2, 0.0];
        for j in 0..M {
            let middle = if j % 2 == 0 {
                phi[j]
            } else {
                phi[j] + 0.5 * turn[j]
            };
            x[j] -= dy * middle;
            y[j] += dx * middle;
            if j % 2 == 0 {
                x[j] += cos * distance[j];
                y[j] += sin * distance[j];
            } else {
                phi[j] += turn[j];
            }
        }
        // The rows of G Φ⁻¹: dependence of the posture on the motion after the step.
        for row in &mut self.follow {
            row[ACCELERATION] -= t * row[SPEED];
            row[YAW_ACCELERATION] -= t * row[YAW_RATE];
        }
        self.own[X][PHI] -= dy;
        self.own[Y][PHI] += dx;
        let u = &mut self.motion;
        u[SPEED][ACCELERATION] += t;
        if self.coupled {
            u[SPEED][YAW_ACCELERATION] += t * u[ACCELERATION][YAW_ACCELERATION];
        }
        u[YAW_RATE][YAW_ACCELERATION] += t;
    }

    /// Adds noise w of the given variance, which changes the motion states by `b` w and the posture by `a` w.
    /// Components of `b` after `LAST` are zero. `times_b` computes row · b without the zeros of `b`. Returns γ and the
    /// variance of the rest: the part that moves the posture independently of the motion.
    fn add_motion_noise<const LAST: usize>(
        &mut self,
        a: [f32; 3],
        b: [f32; M],
        variance: f32,
        times_b: impl Fn(&[f32; M]) -> f32,
    ) -> ([f32; 3], f32) {
        let before = self.motion;
        let (mut beta, mut ratio) = ([0.0; M], [1.0; M]);
        let (mut rest, mut remaining) = (b, variance);
        if LAST >= 3 {
            (beta[3], ratio[3]) = absorb::<M, 3>(&mut self.motion, &mut rest, &mut remaining);
        }
        if LAST >= 2 {
            (beta[2], ratio[2]) = absorb::<M, 2>(&mut self.motion, &mut rest, &mut remaining);
        }
        if LAST >= 1 {
            (beta[1], ratio[1]) = absorb::<M, 1>(&mut self.motion, &mut rest, &mut remaining);
        }
        (beta[0], ratio[0]) = absorb::<M, 0>(&mut self.motion, &mut rest, &mut remaining);
        // κ = U⁻ᵀ w with w[j] = β[j] · (product of the ratios before j).
        let mut kappa = [0.0; M];
        let mut product = 1.0;
        for j in 0..M {
            let mut sum = if j <= LAST { beta[j] * product } else { 0.0 };
            product *= ratio[j];
            for i in 0..j {
                sum -= before[i][j] * kappa[i];
            }
            kappa[j] = sum;
        }
        let mut gamma = a;
        for i in 0..3 {
            let row = &mut self.follow[i];
            gamma[i] -= times_b(row);
            for j in 0..M {
                row[j] += gamma[i] * kappa[j];
            }
        }
        (gamma, remaining)
    }

    /// As `add_motion_noise`, for noise that changes motion state `I` by `b` w and `K` > `I` by w, if both are
    /// uncorrelated with the other motion states.
    fn add_pair_noise<const I: usize, const K: usize>(
        &mut self,
        b: f32,
        variance: f32,
    ) -> ([f32; 3], f32) {
        let u = self.motion[I][K];
        let mut pair = [[self.motion[I][I], u], [0.0, self.motion[K][K]]];
        let (mut rest, mut remaining) = ([b, 1.0], variance);
        let (beta, _) = absorb::<2, 1>(&mut pair, &mut rest, &mut remaining);
        let (first, ratio) = absorb::<2, 0>(&mut pair, &mut rest, &mut remaining);
        self.motion[I][I] = pair[0][0];
        self.motion[I][K] = pair[0][1];
        self.motion[K][K] = pair[1][1];
        let second = beta * ratio - u * first;
        let mut gamma = [0.0; 3];
        for i in 0..3 {
            let row = &mut self.follow[i];
            gamma[i] = -(row[I] * b + row[K]);
            row[I] += gamma[i] * first;
            row[K] += gamma[i] * second;
        }
        (gamma, remaining)
    }

    /// Adds the noise of the motion model. `jerk` and `yaw_jerk` are the variances of the changes of v̇ and φ̈; v and
    /// φ̇ change by `half_t` times as much. `longitudinal`, `lateral` and `heading` are variances of slip; `cos`
    /// and `sin` are those of the heading.
    pub(super) fn add_model_noise(
        &mut self,
        half_t: f32,
        [jerk, yaw_jerk]: [f32; 2],
        [cos, sin]: [f32; 2],
        [longitudinal, lateral, heading]: [f32; 3],
    ) {
        let (forward, turning) = if self.coupled {
            let turning = self.add_motion_noise::<YAW_ACCELERATION>(
                [0.0; 3],
                [0.0, half_t, 0.0, 1.0],
                yaw_jerk,
                |row| row[YAW_RATE] * half_t + row[YAW_ACCELERATION],
            );
            let forward = self.add_motion_noise::<ACCELERATION>(
                [0.0; 3],
                [half_t, 0.0, 1.0, 0.0],
                jerk,
                |row| row[SPEED] * half_t + row[ACCELERATION],
            );
            (forward, turning)
        } else {
            let forward = self.add_pair_noise::<SPEED, ACCELERATION>(half_t, jerk);
            let turning = self.add_pair_noise::<YAW_RATE, YAW_ACCELERATION>(half_t, yaw_jerk);
            (forward, turning)
        };
        let mut position = PositionNoise {
            xx: longitudinal * cos * cos + lateral * sin * sin,
            xy: (longitudinal - lateral) * cos * sin,
            yy: longitudinal * sin * sin + lateral * cos * cos,
        };
        self.add_own_noise(forward, &mut position);
        self.add_own_noise(turning, &mut position);
        self.add_own_noise(([0.0, 0.0, 1.0], heading), &mut position);
        self.add_position_noise(&position);
    }

    /// Adds the heading part of a posture noise; its position part goes to `position`.
    fn add_own_noise(
        &mut self,
        (mut a, mut variance): ([f32; 3], f32),
        position: &mut PositionNoise,
    ) {
        absorb::<3, PHI>(&mut self.own, &mut a, &mut variance);
        position.add(a, variance);
    }

    /// Adds noise that moves the position alone.
    fn add_position_noise(&mut self, noise: &PositionNoise) {
        let u = self.own[X][Y];
        let after = self.own[Y][Y] + noise.yy + f32::MIN_POSITIVE;
        // Covariance of the noise of x − u y with that of y.
        let mixed = noise.xy - u * noise.yy;
        let shift = mixed / after;
        let rest = noise.xx - u * (noise.xy + mixed) - mixed * shift;
        self.own[X][Y] = u + shift;
        self.own[Y][Y] = after;
        // Rounding can make this variance negative.
        if rest > 0.0 {
            self.own[X][X] += rest;
        }
    }

    /// Adds a Q given by the factors of the whole matrix.
    #[inline(never)]
    pub(super) fn add(&mut self, q: &Mat<N, N>) {
        let posture = |j: usize| [q[X][j], q[Y][j], q[PHI][j]];
        let mut position = PositionNoise {
            xx: q[X][X],
            xy: 0.0,
            yy: 0.0,
        };
        position.add([q[X][Y], 1.0, 0.0], q[Y][Y]);
        let by = |b: [f32; M]| move |row: &[f32; M]| dot(row, &b);
        let b = [1.0, 0.0, 0.0, 0.0];
        let noise = self.add_motion_noise::<0>(posture(3), b, q[3][3], by(b));
        self.add_own_noise(noise, &mut position);
        let b = [q[3][4], 1.0, 0.0, 0.0];
        let noise = self.add_motion_noise::<1>(posture(4), b, q[4][4], by(b));
        self.add_own_noise(noise, &mut position);
        let b = [q[3][5], q[4][5], 1.0, 0.0];
        let noise = self.add_motion_noise::<2>(posture(5), b, q[5][5], by(b));
        self.add_own_noise(noise, &mut position);
        let b = [q[3][6], q[4][6], q[5][6], 1.0];
        let noise = self.add_motion_noise::<3>(posture(6), b, q[6][6], by(b));
        self.add_own_noise(noise, &mut position);
        let noise = ([q[X][PHI], q[Y][PHI], 1.0], q[PHI][PHI]);
        self.add_own_noise(noise, &mut position);
        self.add_position_noise(&position);
        self.find_coupling(0.0);
    }

    /// Takes out and returns the given share of the covariance of e: of the posture error that remains if speeds and
    /// accelerations are known.
    pub(super) fn take_posture(&mut self, share: f32) -> Mat3 {
        let mut own = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in i..3 {
                let mut sum = 0.0;
                for k in j..3 {
                    let unit = |i: usize| if i == k { 1.0 } else { self.own[i][k] };
                    sum += unit(i) * unit(j) * self.own[k][k];
                }
                own[i][j] = share * sum;
                own[j][i] = share * sum;
            }
        }
        for k in 0..3 {
            self.own[k][k] *= 1.0 - share;
        }
        own
    }
}

#[cfg(test)]
mod tests;
