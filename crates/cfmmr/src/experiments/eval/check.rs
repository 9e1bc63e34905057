//! Checks of numbers and covariances from input lines; each error names the field, the value and the allowed range.

use core_algos::math::Posture;
use std::f64::consts::{PI, TAU};

/// Lower limit of the pivots of a covariance scaled to unit variances.
const MIN_PIVOT: f64 = 1e-12;
/// Limit of the difference of two mirrored covariance entries, divided by the product of the standard deviations.
const ASYMMETRY: f64 = 1e-6;
/// Limit of the magnitude of a heading, rad. At this limit f64 resolves 0.1 µrad.
const MAX_HEADING_RAD: f64 = 1e9;

/// `value` as `f32`; fails if it is not finite in `f32`.
pub fn number(field: &str, value: f64) -> Result<f32, String> {
    let narrow = value as f32;
    if narrow.is_finite() {
        Ok(narrow)
    } else {
        Err(format!(
            "{field} = {value:e}: must be a number from {:e} to {:e}",
            f32::MIN,
            f32::MAX
        ))
    }
}

/// As [`number`]; fails also for a value of at most zero.
pub fn positive(field: &str, value: f64) -> Result<f32, String> {
    let narrow = number(field, value)?;
    if narrow > 0.0 {
        Ok(narrow)
    } else {
        Err(format!("{field} = {value}: must be greater than 0"))
    }
}

/// As [`number`]; fails also for a negative value.
pub fn non_negative(field: &str, value: f64) -> Result<f32, String> {
    let narrow = number(field, value)?;
    if narrow >= 0.0 {
        Ok(narrow)
    } else {
        Err(format!("{field} = {value}: must be 0 or greater"))
    }
}

/// Vector in `f32`; fails if a component is not finite in `f32`.
pub fn vector<const N: usize>(field: &str, values: &[f64; N]) -> Result<[f32; N], String> {
    let mut out = [0.0; N];
    for i in 0..N {
        out[i] = number(&format!("{field}[{i}]"), values[i])?;
    }
    Ok(out)
}

/// Posture with the heading wrapped to ±π in f64: at 1000 rad, f32 resolves only 60 µrad.
pub fn posture(field: &str, values: &[f64; 3]) -> Result<[f64; 3], String> {
    vector(field, values)?;
    let [x, y, phi] = *values;
    if phi.abs() > MAX_HEADING_RAD {
        return Err(format!(
            "{field}[2] = {phi:e}: must be a number from {:e} to {MAX_HEADING_RAD:e}",
            -MAX_HEADING_RAD
        ));
    }
    let turns = if phi.abs() > PI {
        (phi / TAU).round()
    } else {
        0.0
    };
    Ok([x, y, phi - TAU * turns])
}

/// [`posture`] in single precision.
pub fn narrow_posture(field: &str, values: &[f64; 3]) -> Result<Posture, String> {
    Ok(posture(field, values)?.map(|value| value as f32).into())
}

/// Requirement on a covariance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Definite {
    /// Symmetric, positive definite.
    Positive,
    /// Symmetric, positive semidefinite.
    Semi,
}

/// Checks a covariance and makes it exactly symmetric.
pub fn covariance<const N: usize>(
    field: &str,
    matrix: &[[f64; N]; N],
    definite: Definite,
) -> Result<[[f64; N]; N], String> {
    let mut m = *matrix;
    for i in 0..N {
        for j in 0..N {
            number(&format!("{field}[{i}][{j}]"), m[i][j])?;
        }
        let bad = match definite {
            Definite::Positive => !(m[i][i] as f32 > 0.0),
            Definite::Semi => !(m[i][i] >= 0.0),
        };
        if bad {
            let bound = match definite {
                Definite::Positive => "greater than 0",
                Definite::Semi => "0 or greater",
            };
            return Err(format!(
                "{field}[{i}][{i}] = {}: a variance must be {bound}",
                m[i][i]
            ));
        }
    }
    for i in 0..N {
        for j in 0..i {
            let scale = (m[i][i] * m[j][j]).sqrt();
            if !((m[i][j] - m[j][i]).abs() <= ASYMMETRY * scale) {
                return Err(format!(
                    "{field}[{i}][{j}] = {}, {field}[{j}][{i}] = {}: must be symmetric",
                    m[i][j], m[j][i]
                ));
            }
            if scale == 0.0 && m[i][j] != 0.0 {
                return Err(format!(
                    "{field}[{i}][{j}] = {}: must be 0 if a variance is 0",
                    m[i][j]
                ));
            }
            let mean = 0.5 * (m[i][j] + m[j][i]);
            m[i][j] = mean;
            m[j][i] = mean;
        }
    }
    // Factors the matrix, scaled to unit variances, as L D Lᵀ.
    let mut scaled = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..N {
            let scale = (m[i][i] * m[j][j]).sqrt();
            scaled[i][j] = if scale > 0.0 { m[i][j] / scale } else { 0.0 };
        }
    }
    let least = match definite {
        Definite::Positive => MIN_PIVOT,
        Definite::Semi => -1e-9,
    };
    for k in 0..N {
        let pivot = scaled[k][k];
        let absent = definite == Definite::Semi && m[k][k] == 0.0;
        if !(pivot > least || absent) {
            let kind = match definite {
                Definite::Positive => "positive definite",
                Definite::Semi => "positive semidefinite",
            };
            return Err(format!(
                "{field}: must be {kind}; pivot {k} of its correlations is {pivot:e}"
            ));
        }
        if pivot > 1e-12 {
            for i in k + 1..N {
                let factor = scaled[i][k] / pivot;
                for j in k + 1..N {
                    scaled[i][j] -= factor * scaled[k][j];
                }
            }
        }
    }
    Ok(m)
}

/// A matrix in `f32`.
pub fn narrow<const N: usize>(matrix: &[[f64; N]; N]) -> [[f32; N]; N] {
    matrix.map(|row| row.map(|entry| entry as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_are_wrapped_in_double_precision() {
        for turns in [0.0, 1.0, -160.0, 1.6e6] {
            for phi in [-3.1, 0.1, 2.0] {
                let reduced = posture("a", &[1.0, 2.0, phi + TAU * turns]).unwrap();
                assert!((reduced[2] - phi).abs() < 1e-7 && reduced[..2] == [1.0, 2.0]);
            }
        }
        let error = posture("a", &[0.0, 0.0, -1e12]).unwrap_err();
        assert!(error.starts_with("a[2] = -1e12: must be"), "{error}");
    }

    #[test]
    fn covariances_are_checked() {
        let good = [[2.0, 1.0], [1.0, 2.0]];
        assert_eq!(covariance("A", &good, Definite::Positive), Ok(good));
        let singular = [[1.0, 1.0], [1.0, 1.0]];
        assert!(covariance("A", &singular, Definite::Semi).is_ok());
        let error = covariance("A", &singular, Definite::Positive).unwrap_err();
        assert!(error.starts_with("A: must be positive definite"), "{error}");
        let zero = [[0.0, 0.0], [0.0, 1.0]];
        assert!(covariance("Q", &zero, Definite::Semi).is_ok());
        assert!(covariance("Q", &zero, Definite::Positive).is_err());
        for indefinite in [[[1.0, 2.0], [2.0, 1.0]], [[-1.0, 0.0], [0.0, 1.0]]] {
            assert!(covariance("Q", &indefinite, Definite::Semi).is_err());
        }
        let skew = [[1.0, 0.1], [0.2, 1.0]];
        let error = covariance("Q", &skew, Definite::Semi).unwrap_err();
        assert!(error.contains("Q[1][0] = 0.2"), "{error}");
        let coupled_zero = [[0.0, 0.5], [0.5, 1.0]];
        assert!(covariance("Q", &coupled_zero, Definite::Semi).is_err());
    }

    #[test]
    fn numbers_are_checked() {
        assert!(number("dt", 1e39).unwrap_err().starts_with("dt = 1e39"));
        assert!(number("dt", f64::NAN).is_err());
        assert!(positive("dt", 0.0).is_err());
        // 1e-60 becomes zero in f32.
        assert!(positive("dt", 1e-60).is_err());
        assert!(non_negative("s", -1.0).is_err());
    }
}
