//! Random numbers, matrices and postures in `f64` for tests, independent of the code under test.

/// SplitMix64.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d)
    }

    /// Random number, uniform in [0, 1).
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Random number, uniform in [low, high).
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Random number, standard normal (Box and Muller).
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (core::f64::consts::TAU * self.uniform()).cos()
    }
}

/// A random covariance of the given standard deviations; `mixing` makes its correlations.
pub(crate) fn random_covariance<const N: usize>(
    random: &mut Random,
    sigmas: [f32; N],
    mixing: f64,
) -> [[f32; N]; N] {
    let root: Matrix<N, N> = core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            let unit = if i == j { 1.0 } else { 0.0 };
            f64::from(sigmas[i]) * (mixing * random.normal() + unit)
        })
    });
    product(&root, &transpose(&root)).map(|row| row.map(|entry| entry as f32))
}

/// A matrix of `R` rows.
pub(crate) type Matrix<const R: usize, const C: usize> = [[f64; C]; R];

/// A matrix in `f64`.
pub(crate) fn wide<const R: usize, const C: usize>(m: &[[f32; C]; R]) -> Matrix<R, C> {
    m.map(|row| row.map(f64::from))
}

/// a b.
pub(crate) fn product<const R: usize, const K: usize, const C: usize>(
    a: &Matrix<R, K>,
    b: &Matrix<K, C>,
) -> Matrix<R, C> {
    a.map(|row| core::array::from_fn(|j| (0..K).map(|k| row[k] * b[k][j]).sum()))
}

/// mᵀ.
pub(crate) fn transpose<const R: usize, const C: usize>(m: &Matrix<R, C>) -> Matrix<C, R> {
    core::array::from_fn(|i| core::array::from_fn(|j| m[j][i]))
}

/// m⁻¹ by cofactors.
pub(crate) fn inverse(m: &Matrix<3, 3>) -> Matrix<3, 3> {
    let cofactor = |i: usize, j: usize| {
        let (r, s) = ((i + 1) % 3, (i + 2) % 3);
        let (c, d) = ((j + 1) % 3, (j + 2) % 3);
        m[r][c] * m[s][d] - m[r][d] * m[s][c]
    };
    let determinant: f64 = (0..3).map(|j| m[0][j] * cofactor(0, j)).sum();
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| cofactor(j, i) / determinant))
}

/// eᵀ m e.
pub(crate) fn quadratic(m: &Matrix<3, 3>, e: [f64; 3]) -> f64 {
    (0..9).map(|k| e[k / 3] * m[k / 3][k % 3] * e[k % 3]).sum()
}

/// Lower triangular l with l lᵀ = m. Where m is not positive definite, a diagonal entry is 0 or NaN.
pub(crate) fn cholesky<const N: usize>(m: &Matrix<N, N>) -> Matrix<N, N> {
    let mut l = [[0.0f64; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let rest = m[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = if i == j { rest.sqrt() } else { rest / l[j][j] };
        }
    }
    l
}

/// True if a matrix is finite, symmetric and positive definite.
pub(crate) fn is_definite<const N: usize>(m: &Matrix<N, N>) -> bool {
    let l = cholesky(m);
    *m == transpose(m) && (0..N).all(|i| l[i][i] > 0.0 && l[i][i].is_finite())
}

/// Covariance of samples.
pub(crate) fn sample_covariance<const N: usize>(samples: &[[f64; N]]) -> Matrix<N, N> {
    let mean =
        |of: &dyn Fn(&[f64; N]) -> f64| samples.iter().map(of).sum::<f64>() / samples.len() as f64;
    let means: [f64; N] = core::array::from_fn(|i| mean(&|p| p[i]));
    core::array::from_fn(|i| {
        core::array::from_fn(|j| mean(&|p| (p[i] - means[i]) * (p[j] - means[j])))
    })
}

/// Largest difference of two covariances, as a share of the standard deviations.
pub(crate) fn covariance_error<const N: usize>(found: &[[f32; N]; N], exact: &Matrix<N, N>) -> f64 {
    let errors = (0..N * N).map(|k| {
        let (i, j) = (k / N, k % N);
        let sigmas = (exact[i][i] * exact[j][j]).sqrt();
        ((f64::from(found[i][j]) - exact[i][j]) / sigmas).abs()
    });
    errors.max_by(f64::total_cmp).unwrap_or_default()
}

/// A posture (x, y, phi).
pub(crate) type Pose = [f64; 3];

/// An angle within half a turn.
pub(crate) fn wrap(angle: f64) -> f64 {
    let turn = core::f64::consts::TAU;
    angle - turn * (angle / turn).round()
}

/// The posture that is `relative` as seen from `base`; its heading is not wrapped.
pub(crate) fn compose(base: Pose, relative: Pose) -> Pose {
    let (s, c) = base[2].sin_cos();
    [
        base[0] + c * relative[0] - s * relative[1],
        base[1] + s * relative[0] + c * relative[1],
        base[2] + relative[2],
    ]
}

/// `tip` as seen from `base`.
pub(crate) fn relative(tip: Pose, base: Pose) -> Pose {
    let (s, c) = base[2].sin_cos();
    let (x, y) = (tip[0] - base[0], tip[1] - base[1]);
    [c * x + s * y, -s * x + c * y, wrap(tip[2] - base[2])]
}
