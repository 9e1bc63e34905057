//! Covariance of a filter and its measurement updates.
//!
//! Only the upper triangle is kept, so the matrix is symmetric by construction.

use crate::math::matrix::{self, Mat, Mat3};

/// Smallest pivot of the L D Lᵀ factors, as a share of the state's variance. A smaller pivot is raised, because
/// rounding could carry a correlation coefficient past ±1.
const LEAST_PIVOT: f32 = 1e-4;
/// Smallest increase of a variance whose pivot is too small, as a share of the variance.
const LIFT: f32 = 4e-6;
/// Largest variance, in squared state units; a larger variance is scaled back to this value.
const MAX_VARIANCE: f32 = 1e6;

/// The covariance of `N` states, at least three, of which the first three are a posture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance<const N: usize> {
    /// Entries with column ≥ row are valid; the rest stay zero.
    pub(super) upper: Mat<N, N>,
}

impl<const N: usize> Covariance<N> {
    /// Covariance from a symmetric matrix, of which the upper triangle is read.
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

    /// Innovation covariance and gain of `M` measurements. Measurement m is state `first` + m plus row m of `h` times
    /// the states `states`; `noise` is the covariance of the noise. With S = H P Hᵀ + R = L Lᵀ, returns L and L⁻¹ H
    /// P; `None` if S is not positive definite.
    pub(super) fn innovation_factors<const S: usize, const M: usize>(
        &self,
        first: usize,
        states: &[usize; S],
        h: &Mat<M, S>,
        noise: &Mat<M, M>,
    ) -> Option<(Mat<M, M>, Mat<M, N>)> {
        let mut root_gain = [[0.0; N]; M];
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
                root_gain[m][j] = sum;
            }
        }
        let mut sum = *noise;
        for m in 0..M {
            for n in 0..M {
                sum[m][n] += root_gain[m][(first + n) % N];
                for k in 0..S {
                    sum[m][n] += h[n][k] * root_gain[m][states[k] % N];
                }
            }
        }
        let factor = matrix::cholesky(&sum)?;
        for m in 0..M {
            let inverse = 1.0 / factor[m][m];
            for l in 0..m {
                let by = factor[m][l];
                for j in 0..N {
                    root_gain[m][j] -= by * root_gain[l][j];
                }
            }
            for entry in &mut root_gain[m] {
                *entry *= inverse;
            }
        }
        Some((factor, root_gain))
    }

    /// Measurement update by three measurements: P − (L⁻¹ H P)ᵀ (L⁻¹ H P), with the matrix from
    /// [`Self::innovation_factors`].
    pub(super) fn subtract_update(&mut self, root_gain: &Mat<3, N>) {
        for i in 0..N {
            let [x, y, z] = root_gain;
            let by = [x[i], y[i], z[i]];
            let root_gain = x[i..].iter().zip(&y[i..]).zip(&z[i..]);
            for (entry, ((x, y), z)) in self.upper[i][i..].iter_mut().zip(root_gain) {
                *entry -= by[0] * x + by[1] * y + by[2] * z;
            }
        }
    }

    /// Scales state `m` by `kept` and adds an independent error of variance `added`.
    pub(super) fn fade(&mut self, m: usize, kept: f32, added: f32) {
        let m = m % N;
        for j in 0..N {
            self.upper[j.min(m)][j.max(m)] *= kept;
        }
        self.upper[m][m] = kept * self.upper[m][m] + added;
    }

    /// Keeps the matrix finite and positive definite over millions of steps: scales back variances that have grown
    /// without bound, and raises variances whose pivot is lost in rounding. Both are rare and change only entries
    /// that have lost their meaning.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::testing::{Matrix, Random, cholesky, random_covariance, wide};

    const N: usize = 5;

    fn random(seed: u64, sigmas: [f32; N]) -> Mat<N, N> {
        random_covariance(&mut Random::new(seed), sigmas, 0.5)
    }

    fn conditioned(matrix: &Mat<N, N>) -> Mat<N, N> {
        let mut covariance = Covariance::from_matrix(matrix);
        covariance.condition();
        covariance.matrix()
    }

    /// Compares each entry with its expected value, relative to the standard deviations.
    fn assert_near(found: &Mat<N, N>, expected: &Matrix<N, N>, what: usize) {
        for (i, j) in (0..N * N).map(|k| (k / N, k % N)) {
            let scale = (expected[i][i] * expected[j][j]).sqrt();
            let error = (f64::from(found[i][j]) - expected[i][j]).abs();
            assert!(error <= 1e-6 * scale, "{what}: {i} {j}");
        }
    }

    #[test]
    fn fading_scales_one_state_and_adds_to_its_variance() {
        for m in 0..N {
            let before = random(1, [1.0, 0.1, 3.0, 1e-3, 2.0]);
            let mut covariance = Covariance::from_matrix(&before);
            covariance.fade(m, 0.75, 0.5);
            let mut expected = wide(&before);
            for j in 0..N {
                expected[m][j] *= 0.75;
                expected[j][m] *= 0.75;
            }
            expected[m][m] += 0.5;
            assert_near(&covariance.matrix(), &expected, m);
        }
    }

    #[test]
    fn variance_above_the_limit_is_scaled_back_and_correlations_stay() {
        for m in 0..N {
            let mut sigmas = [1.0; N];
            sigmas[m] = 3e3;
            let before = random(2, sigmas);
            let mut expected = wide(&before);
            let shrink = 1e3 / expected[m][m].sqrt();
            assert!(shrink < 1.0);
            for j in 0..N {
                expected[m][j] *= shrink;
                expected[j][m] *= shrink;
            }
            let found = conditioned(&before);
            assert_near(&found, &expected, m);
            assert_eq!(found[m][m], MAX_VARIANCE);
        }
        let infinite = matrix::diagonal([1.0, f32::INFINITY, 2.0, 0.0, 3.0]);
        let bounded = matrix::diagonal([1.0, MAX_VARIANCE, 2.0, 0.0, 3.0]);
        assert_eq!(conditioned(&infinite), bounded);
    }

    #[test]
    fn sound_covariance_and_zero_variance_states_stay_bit_identical() {
        let mut sound = random(3, [1.0, 0.1, 3.0, 1e-3, 2.0]);
        assert_eq!(conditioned(&sound), sound);
        for k in 0..N {
            (sound[1][k], sound[k][1]) = (0.0, 0.0);
        }
        assert_eq!(conditioned(&sound), sound);
    }

    /// Two states have a correlation of almost 1, or above 1. A third state depends on the first, and has an additional
    /// covariance of `apart` with the second.
    #[test]
    fn lost_pivot_raises_its_variance_and_leaves_the_other_entries() {
        // Pivot of the second state over its variance, `apart`, and expected relative increase of the second variance.
        for (pivot, apart, gain) in [
            (0.0, 0.0, 1e-4),
            (1e-6, 3e-3, 9.9e-5),
            (9.9e-5, 3e-3, 4e-6),
            (-1e-6, 3e-3, 1.01e-4),
            (-3.0, 3e-3, 1.0),
            (-3.0, 0.02, 1.0),
        ] {
            let correlation = f64::sqrt(1.0 - pivot) as f32;
            let mut before = matrix::diagonal([4.0, 0.25, 9.0, 1.0, 2.0]);
            let tied = 0.75 * correlation + apart;
            for (i, j, entry) in [(0, 1, correlation), (0, 2, 3.0), (1, 2, tied)] {
                (before[i][j], before[j][i]) = (entry, entry);
            }
            let found = conditioned(&before);
            let gained = f64::from(found[1][1] - before[1][1]) / 0.25;
            assert!(
                (gained - gain).abs() < 0.02 * gain + 3e-7,
                "{pivot}: {gained}"
            );
            // If the second pivot is raised to its floor, this quotient is subtracted from the third pivot, 6.75.
            let lost = apart * apart / (LEAST_PIVOT * 0.25) > 6.75;
            assert_eq!(found[2][2] > before[2][2], lost, "{pivot} {apart}");
            let mut others = found;
            (others[1][1], others[2][2]) = (before[1][1], before[2][2]);
            assert_eq!(others, before, "{pivot}");
            if pivot > -1.0 {
                let pivots = cholesky(&wide(&found));
                assert!((0..N).all(|k| pivots[k][k].powi(2) > 5e-5 * wide(&found)[k][k]));
            }
        }
    }
}
