//! Minima of the fit and their comparison.

use super::ray::Parameters;
use super::{Normal, Shape};
use crate::beam::strip::GaugeMask;
use crate::math::matrix::{cholesky, cholesky_solve, inverse_spd};

/// Residual (weighted sum of squares) from which the fit tries other starts.
pub(super) const SUSPICIOUS: f32 = 12.0;

/// Share of the load decided by the prior below which the strains determine the load.
const PRIOR_SHARE: f32 = 0.1;

/// Residuals below which 4, 5, 6, 7 and 8 readings are more accurate than stated. Readings of the stated uncertainty
/// have a smaller residual with probability 2.5e-4.
const EXACT: [f32; 5] = [1e-7, 5e-4, 0.0096, 0.0455, 0.12];

/// Result of a descent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Minimum {
    pub(super) parameters: Parameters,
    pub(super) shape: Shape,
    pub(super) normal: Normal,
    pub(super) converged: bool,
}

impl Minimum {
    /// True if the cost of this minimum is below the other's cost less 0.01. If only this minimum converged, true if
    /// its cost is below the other's cost plus 0.01.
    fn better_than(&self, other: &Self) -> bool {
        let margin = if self.converged && !other.converged {
            1e-2
        } else {
            -1e-2
        };
        self.normal.cost < other.normal.cost + margin
    }
}

/// True if the strains alone determine the load.
pub(super) fn determines_load(normal: &Normal) -> bool {
    inverse_spd(&normal.hessian)
        .is_some_and(|inverse| normal.prior * (inverse[1][1] + inverse[2][2]) < PRIOR_SHARE)
}

/// Decrease of the cost predicted by the Gauss–Newton step.
pub(super) fn predicted_decrease(normal: &Normal) -> Option<f32> {
    let step = cholesky_solve(&cholesky(&normal.hessian)?, &normal.descent);
    let mut decrease = 0.0;
    for i in 0..3 {
        decrease += step[i] * normal.descent[i];
    }
    Some(decrease)
}

/// True if the residual shows that the readings are far more accurate than stated.
pub(super) fn is_exact(mask: GaugeMask, chi_square: f32) -> bool {
    let limit = (mask.count() as usize)
        .checked_sub(4)
        .and_then(|row| EXACT.get(row));
    limit.is_some_and(|limit| chi_square < *limit)
}

/// True if another start may lead to a lower minimum.
pub(super) fn is_suspicious(found: Option<&Minimum>) -> bool {
    found.is_none_or(|found| !found.converged || !(found.normal.chi_square < SUSPICIOUS))
}

/// The lower of two minima.
pub(super) fn lower(a: Option<Minimum>, b: Option<Minimum>) -> Option<Minimum> {
    match (a, b) {
        (Some(a), Some(b)) if b.better_than(&a) => Some(b),
        (None, b) => b,
        (a, _) => a,
    }
}
