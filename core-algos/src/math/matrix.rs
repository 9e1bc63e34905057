//! Small matrices as nested arrays, rows first; all loops have constant bounds, so nothing panics.

/// A matrix of `R` rows and `C` columns.
pub type Mat<const R: usize, const C: usize> = [[f32; C]; R];
/// A 3×3 matrix.
pub type Mat3 = Mat<3, 3>;
/// A vector of three components.
pub type Vec3 = [f32; 3];

/// The identity of order `N`.
pub const fn identity<const N: usize>() -> Mat<N, N> {
    let mut m = [[0.0; N]; N];
    let mut i = 0;
    while i < N {
        m[i][i] = 1.0;
        i += 1;
    }
    m
}

/// A diagonal matrix.
pub fn diagonal<const N: usize>(entries: [f32; N]) -> Mat<N, N> {
    let mut m = [[0.0; N]; N];
    for i in 0..N {
        m[i][i] = entries[i];
    }
    m
}

/// Product `a b`.
pub fn multiply<const R: usize, const K: usize, const C: usize>(
    a: &Mat<R, K>,
    b: &Mat<K, C>,
) -> Mat<R, C> {
    let mut m = [[0.0; C]; R];
    for i in 0..R {
        for j in 0..C {
            let mut sum = 0.0;
            for k in 0..K {
                sum += a[i][k] * b[k][j];
            }
            m[i][j] = sum;
        }
    }
    m
}

/// Product `a v`.
pub fn apply<const R: usize, const C: usize>(a: &Mat<R, C>, v: &[f32; C]) -> [f32; R] {
    let mut out = [0.0; R];
    for i in 0..R {
        let mut sum = 0.0;
        for k in 0..C {
            sum += a[i][k] * v[k];
        }
        out[i] = sum;
    }
    out
}

/// The transpose of `a`.
pub fn transpose<const R: usize, const C: usize>(a: &Mat<R, C>) -> Mat<C, R> {
    let mut m = [[0.0; R]; C];
    for i in 0..R {
        for j in 0..C {
            m[j][i] = a[i][j];
        }
    }
    m
}

/// `a + b`.
pub fn add<const R: usize, const C: usize>(a: &Mat<R, C>, b: &Mat<R, C>) -> Mat<R, C> {
    let mut m = *a;
    for i in 0..R {
        for j in 0..C {
            m[i][j] += b[i][j];
        }
    }
    m
}

/// `a − b`.
pub fn subtract<const R: usize, const C: usize>(a: &Mat<R, C>, b: &Mat<R, C>) -> Mat<R, C> {
    let mut m = *a;
    for i in 0..R {
        for j in 0..C {
            m[i][j] -= b[i][j];
        }
    }
    m
}

/// `s a`.
pub fn scale<const R: usize, const C: usize>(a: &Mat<R, C>, s: f32) -> Mat<R, C> {
    a.map(|row| row.map(|entry| s * entry))
}

/// `j p jᵀ` for a symmetric `p`: propagation of a covariance through a linear map. The result is exactly symmetric.
pub fn propagate<const R: usize, const C: usize>(j: &Mat<R, C>, p: &Mat<C, C>) -> Mat<R, R> {
    let jp = multiply(j, p);
    let mut m = [[0.0; R]; R];
    for i in 0..R {
        for k in i..R {
            let mut sum = 0.0;
            for l in 0..C {
                sum += jp[i][l] * j[k][l];
            }
            m[i][k] = sum;
            m[k][i] = sum;
        }
    }
    m
}

/// `(a + aᵀ)/2`.
pub fn symmetrized<const N: usize>(a: &Mat<N, N>) -> Mat<N, N> {
    let mut m = *a;
    for i in 0..N {
        for j in 0..i {
            let mean = 0.5 * (a[i][j] + a[j][i]);
            m[i][j] = mean;
            m[j][i] = mean;
        }
    }
    m
}

/// True if every entry is finite.
pub fn is_finite<const R: usize, const C: usize>(a: &Mat<R, C>) -> bool {
    a.iter()
        .all(|row| row.iter().all(|entry| entry.is_finite()))
}

/// Lower Cholesky factor of a symmetric matrix (its lower triangle is read); `None` unless it is
/// positive definite. NaN gives `None`.
pub fn cholesky<const N: usize>(a: &Mat<N, N>) -> Option<Mat<N, N>> {
    let mut l = [[0.0; N]; N];
    for j in 0..N {
        let mut pivot = a[j][j];
        for k in 0..j {
            pivot -= l[j][k] * l[j][k];
        }
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        let root = super::trig::sqrt(pivot);
        l[j][j] = root;
        for i in j + 1..N {
            let mut sum = a[i][j];
            for k in 0..j {
                sum -= l[i][k] * l[j][k];
            }
            l[i][j] = sum / root;
        }
    }
    Some(l)
}

/// Solves `l lᵀ x = b` for the lower Cholesky factor `l`.
pub fn cholesky_solve<const N: usize>(l: &Mat<N, N>, b: &[f32; N]) -> [f32; N] {
    let mut x = *b;
    for i in 0..N {
        for k in 0..i {
            x[i] -= l[i][k] * x[k];
        }
        x[i] /= l[i][i];
    }
    for i in (0..N).rev() {
        for k in i + 1..N {
            x[i] -= l[k][i] * x[k];
        }
        x[i] /= l[i][i];
    }
    x
}

/// Inverse of a symmetric matrix; `None` unless the matrix is positive definite.
pub fn inverse_spd<const N: usize>(a: &Mat<N, N>) -> Option<Mat<N, N>> {
    let l = cholesky(a)?;
    let unit = identity::<N>();
    let mut m = [[0.0; N]; N];
    for j in 0..N {
        let column = cholesky_solve(&l, &unit[j]);
        for i in 0..N {
            m[i][j] = column[i];
        }
    }
    Some(symmetrized(&m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn matrix4() -> impl Strategy<Value = Mat<4, 4>> {
        proptest::array::uniform4(proptest::array::uniform4(-2.0f32..2.0))
    }

    properties! {
        #[test]
        fn inverse_times_matrix_is_identity(a in matrix4()) {
            let spd = add(&propagate(&a, &identity()), &identity());
            let product = multiply(&inverse_spd(&spd).unwrap(), &spd);
            for i in 0..4 {
                for j in 0..4 {
                    let expected = if i == j { 1.0 } else { 0.0 };
                    prop_assert!((product[i][j] - expected).abs() < 1e-4);
                }
            }
        }

        #[test]
        fn propagate_is_the_product_of_three(a in matrix4(), b in matrix4()) {
            let p = symmetrized(&b);
            let direct = multiply(&multiply(&a, &p), &transpose(&a));
            let fast = propagate(&a, &p);
            for i in 0..4 {
                for j in 0..4 {
                    prop_assert!((direct[i][j] - fast[i][j]).abs() < 1e-4);
                    prop_assert_eq!(fast[i][j], fast[j][i]);
                }
            }
        }
    }

    #[test]
    fn indefinite_or_nan_matrix_has_no_factor() {
        assert!(cholesky(&[[1.0, 2.0], [2.0, 1.0]]).is_none());
        assert!(cholesky(&[[f32::NAN, 0.0], [0.0, 1.0]]).is_none());
        assert!(cholesky(&[[1.0, f32::NAN], [f32::NAN, 1.0]]).is_none());
    }
}
