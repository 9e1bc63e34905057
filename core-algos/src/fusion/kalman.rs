//! Plain Kalman fusion of two posture estimates, which takes their errors as independent.
//!
//! For comparison only: between axles that exchange postures the errors are strongly correlated,
//! and this rule counts shared information again at every exchange. Use
//! [`intersection`](super::intersection) or [`joint`](super::joint) instead.

use super::Estimate;
use super::intersection::{ExtendedEstimate, Pair};
use crate::math::TwoFloat;

/// The estimate of least variance if the errors of `a` and `b` were independent:
/// P = A (A + B)⁻¹ B, x = a + A (A + B)⁻¹ (b − a), heading difference wrapped.
///
/// `None` unless both covariances are positive definite and all numbers finite.
pub fn fuse(a: &Estimate, b: &Estimate) -> Option<Estimate> {
    let pair = Pair::new(&ExtendedEstimate::from(a), &ExtendedEstimate::from(b))?;
    pair.combine(TwoFloat::ONE, TwoFloat::ONE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Posture;

    #[test]
    fn two_scalars_average_by_inverse_variance() {
        let a = Estimate::with_sigmas(Posture::new(1.0, 0.0, 3.1), [1.0, 2.0, 0.1]);
        let b = Estimate::with_sigmas(Posture::new(2.0, 5.0, -3.1), [2.0, 2.0, 0.1]);
        let fused = fuse(&a, &b).unwrap();
        // Variances 1 and 4: weights 4/5 and 1/5.
        assert!((fused.posture.x - 1.2).abs() < 1e-6);
        assert!((fused.posture.y - 2.5).abs() < 1e-6);
        assert!((fused.posture.phi.abs() - core::f32::consts::PI).abs() < 1e-6);
        assert!((fused.covariance[0][0] - 0.8).abs() < 1e-6);
        assert!((fused.covariance[1][1] - 2.0).abs() < 1e-6);
        assert!((fused.covariance[2][2] - 0.005).abs() < 1e-8);
    }
}
