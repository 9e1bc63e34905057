//! Minima of the fit, and which of two is better.

use super::ray::Parameters;
use super::{Normal, Shape};
use crate::beam::strip::GaugeMask;
use crate::math::matrix::{cholesky, cholesky_solve, inverse_spd};

/// A residual this large makes the fit try other starts.
pub(super) const SUSPICIOUS: f32 = 12.0;

/// The load is known if the prior decides less than this share of a parameter.
const PRIOR_SHARE: f32 = 0.1;

/// Residuals of 4 to 8 readings that readings of the stated uncertainty leave, or less, with probability 2.5e-4.
const EXACT: [f32; 5] = [1e-7, 5e-4, 0.0096, 0.0455, 0.12];

/// End of a descent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Minimum {
    pub(super) parameters: Parameters,
    pub(super) shape: Shape,
    pub(super) normal: Normal,
    pub(super) converged: bool,
}

impl Minimum {
    /// True if this is the lower minimum, or the same one but settled.
    fn better_than(&self, other: &Self) -> bool {
        let margin = if self.converged && !other.converged {
            1e-2
        } else {
            -1e-2
        };
        self.normal.cost < other.normal.cost + margin
    }
}

/// True if the strains alone fix the load.
pub(super) fn told(normal: &Normal) -> bool {
    inverse_spd(&normal.hessian)
        .is_some_and(|inverse| normal.prior * (inverse[1][1] + inverse[2][2]) < PRIOR_SHARE)
}

/// Decrease of the cost that the Gauss–Newton step promises.
pub(super) fn promise(normal: &Normal) -> Option<f32> {
    let step = cholesky_solve(&cholesky(&normal.hessian)?, &normal.descent);
    let mut promise = 0.0;
    for i in 0..3 {
        promise += step[i] * normal.descent[i];
    }
    Some(promise)
}

/// True if the residual shows that the readings are far more exact than stated.
pub(super) fn is_exact(mask: GaugeMask, chi_square: f32) -> bool {
    let limit = (mask.count() as usize)
        .checked_sub(4)
        .and_then(|row| EXACT.get(row));
    limit.is_some_and(|limit| chi_square < *limit)
}

/// True if there may be a better minimum elsewhere.
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
