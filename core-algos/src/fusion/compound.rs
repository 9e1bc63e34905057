//! Compounding of uncertain postures (Smith and Cheeseman): the posture of one axle seen through the beam from the
//! other.
//!
//! The beam measures r, the front axle's posture in the rear axle's frame. Each function is linearised in the errors
//! by the Jacobians of planar rigid motion. The two inputs are assumed independent. NaN propagates; nothing here
//! panics.

use crate::math::Posture;
use crate::math::matrix::{Mat3, add, identity, multiply};
use crate::math::trig::atan2;

/// Posture of O in the rear axle's frame, for the front axle at `relative`, with its derivative by `relative`. O lies
/// halfway between the axles and heads from rear to front.
pub fn midpoint_seen_from_rear(relative: Posture) -> (Posture, Mat3) {
    let (x, y) = (relative.x, relative.y);
    let square = x * x + y * y;
    let (by_x, by_y) = if square > 0.0 {
        (-y / square, x / square)
    } else {
        (0.0, 0.0)
    };
    (
        Posture::new(0.5 * x, 0.5 * y, atan2(y, x)),
        [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [by_x, by_y, 0.0]],
    )
}

/// Posture computed from a base posture and the beam's relative posture, with its derivatives with respect to both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain {
    /// The computed posture.
    pub posture: Posture,
    /// Derivative with respect to the base posture, along the global axes.
    pub by_base: Mat3,
    /// Derivative with respect to the relative posture.
    pub by_relative: Mat3,
}

impl Chain {
    /// Chain of `base` and `q`, a posture in the frame of `base`. `q_by_relative` is the derivative of `q` with respect
    /// to the relative posture.
    fn new(base: Posture, q: Posture, q_by_relative: &Mat3) -> Self {
        let (by_base, by_q) = base.compose_jacobians(q);
        Self {
            posture: base.compose(q),
            by_base,
            by_relative: multiply(&by_q, q_by_relative),
        }
    }

    /// Posture of the front axle, from the rear axle's posture.
    pub fn front_from_rear(rear: Posture, relative: Posture) -> Self {
        Self::new(rear, relative, &identity())
    }

    /// Posture of the rear axle, from the front axle's posture.
    pub fn rear_from_front(front: Posture, relative: Posture) -> Self {
        Self::new(front, relative.inverse(), &relative.inverse_jacobian())
    }

    /// Posture of O, from the rear axle's posture.
    pub fn midpoint_from_rear(rear: Posture, relative: Posture) -> Self {
        let (q, q_by_r) = midpoint_seen_from_rear(relative);
        Self::new(rear, q, &q_by_r)
    }

    /// Posture of O, from the front axle's posture. In the front axle's frame O is ⊖ r ⊕ q(r).
    pub fn midpoint_from_front(front: Posture, relative: Posture) -> Self {
        let (q, q_by_r) = midpoint_seen_from_rear(relative);
        let back = relative.inverse();
        let (by_back, by_q) = back.compose_jacobians(q);
        let by_relative = add(
            &multiply(&by_back, &relative.inverse_jacobian()),
            &multiply(&by_q, &q_by_r),
        );
        Self::new(front, back.compose(q), &by_relative)
    }

    /// Posture of the rear axle, from the posture of O.
    pub fn rear_from_midpoint(robot: Posture, relative: Posture) -> Self {
        let (q, q_by_r) = midpoint_seen_from_rear(relative);
        let by_relative = multiply(&q.inverse_jacobian(), &q_by_r);
        Self::new(robot, q.inverse(), &by_relative)
    }

    /// Posture of the front axle, from the posture of O. In O's frame the front axle is ⊖ q(r) ⊕ r.
    pub fn front_from_midpoint(robot: Posture, relative: Posture) -> Self {
        let (q, q_by_r) = midpoint_seen_from_rear(relative);
        let back = q.inverse();
        let (by_back, by_r) = back.compose_jacobians(relative);
        let by_back = multiply(&by_back, &multiply(&q.inverse_jacobian(), &q_by_r));
        Self::new(robot, back.compose(relative), &add(&by_back, &by_r))
    }

    /// Posture of O, from the postures of both axles: position halfway, heading from rear to front. `by_base` is the
    /// derivative with respect to the front axle, `by_relative` to the rear axle.
    pub fn midpoint(front: Posture, rear: Posture) -> Self {
        let (x, y) = (front.x - rear.x, front.y - rear.y);
        let square = (x * x + y * y).max(f32::MIN_POSITIVE);
        let heading = [-y / square, x / square, 0.0];
        let half = |heading| [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], heading];
        Self {
            posture: Posture::new(
                0.5 * (front.x + rear.x),
                0.5 * (front.y + rear.y),
                atan2(y, x),
            ),
            by_base: half(heading),
            by_relative: half(heading.map(|h| -h)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::Estimate;
    use crate::fusion::testing::{compose as forward, covariance_error, wrap};
    use crate::math::matrix::propagate;
    use proptest::prelude::*;

    fn estimate() -> impl Strategy<Value = Estimate> {
        (
            (-2.0f32..2.0, -2.0f32..2.0, -3.1f32..3.1),
            proptest::array::uniform3(proptest::array::uniform3(-0.02f32..0.02)),
        )
            .prop_map(|((x, y, phi), root)| {
                let unit = crate::math::matrix::diagonal([1e-5; 3]);
                let spread = propagate(&root, &crate::math::matrix::identity());
                Estimate::new(Posture::new(x, y, phi), add(&spread, &unit))
            })
    }

    /// Covariance of `f` of both postures in `f64`, without Jacobians: by central differences along the columns of
    /// the Cholesky factors.
    fn unscented(
        a: &Estimate,
        b: &Estimate,
        f: impl Fn([f64; 3], [f64; 3]) -> [f64; 3],
    ) -> [[f64; 3]; 3] {
        let pose = |e: &Estimate| -> [f64; 3] {
            let p: [f32; 3] = e.posture.into();
            p.map(f64::from)
        };
        // Small steps, so that only the linear part counts.
        let shrink = 1e-3;
        let mut covariance = [[0.0; 3]; 3];
        for (which, e) in [a, b].into_iter().enumerate() {
            let l = crate::math::matrix::cholesky(&e.covariance).unwrap();
            for column in 0..3 {
                let shifted = |sign: f64| {
                    let mut q = pose(e);
                    for row in 0..3 {
                        q[row] += sign * shrink * l[row][column] as f64;
                    }
                    if which == 0 {
                        f(q, pose(b))
                    } else {
                        f(pose(a), q)
                    }
                };
                let (low, high) = (shifted(-1.0), shifted(1.0));
                let mut change = [0, 1, 2].map(|k| high[k] - low[k]);
                change[2] = wrap(change[2]);
                let d = change.map(|c| c / (2.0 * shrink));
                for i in 0..3 {
                    for j in 0..3 {
                        covariance[i][j] += d[i] * d[j];
                    }
                }
            }
        }
        covariance
    }

    fn backward(a: [f64; 3], r: [f64; 3]) -> [f64; 3] {
        let phi = a[2] - r[2];
        let (s, c) = phi.sin_cos();
        [a[0] - c * r[0] + s * r[1], a[1] - s * r[0] - c * r[1], phi]
    }

    fn agree(covariance: &[[f32; 3]; 3], reference: &[[f64; 3]; 3]) -> bool {
        covariance_error(covariance, reference) < 1e-5
    }

    properties! {
        #[test]
        fn chained_covariances_equal_those_by_central_differences(a in estimate(), r in estimate()) {
            let chained = |chain: Chain| add(
                &propagate(&chain.by_base, &a.covariance),
                &propagate(&chain.by_relative, &r.covariance),
            );
            // Posture of O by its definition, from the postures of both axles.
            let middle = |f: [f64; 3], b: [f64; 3]| {
                let (x, y) = (f[0] - b[0], f[1] - b[1]);
                [0.5 * (f[0] + b[0]), 0.5 * (f[1] + b[1]), y.atan2(x)]
            };
            // The axle at `relative` in the rear axle's frame, for O at `o` and the front axle at `r` in the rear
            // axle's frame.
            let axle = |o: [f64; 3], relative: [f64; 3], r: [f64; 3]| {
                let q = middle(r, [0.0; 3]);
                forward(backward(o, q), relative)
            };
            let (p, q) = (a.posture, r.posture);
            prop_assume!(q.x.hypot(q.y) > 0.05);
            prop_assert!(agree(
                &chained(Chain::front_from_rear(p, q)),
                &unscented(&a, &r, forward)
            ));
            prop_assert!(agree(
                &chained(Chain::rear_from_front(p, q)),
                &unscented(&a, &r, backward)
            ));
            prop_assert!(agree(
                &chained(Chain::midpoint_from_rear(p, q)),
                &unscented(&a, &r, |a, r| middle(forward(a, r), a))
            ));
            prop_assert!(agree(
                &chained(Chain::midpoint_from_front(p, q)),
                &unscented(&a, &r, |a, r| middle(a, backward(a, r)))
            ));
            prop_assert!(agree(
                &chained(Chain::rear_from_midpoint(p, q)),
                &unscented(&a, &r, |a, r| axle(a, [0.0; 3], r))
            ));
            prop_assert!(agree(
                &chained(Chain::front_from_midpoint(p, q)),
                &unscented(&a, &r, |a, r| axle(a, r, r))
            ));
            prop_assume!((p.x - q.x).hypot(p.y - q.y) > 0.05);
            prop_assert!(agree(
                &chained(Chain::midpoint(p, q)),
                &unscented(&a, &r, middle)
            ));
        }

        #[test]
        fn front_from_rear_and_back_returns_the_rear_axle(a in estimate(), r in estimate()) {
            let front = Chain::front_from_rear(a.posture, r.posture).posture;
            let back = Chain::rear_from_front(front, r.posture).posture.minus(a.posture);
            prop_assert!(back.iter().all(|d| d.abs() < 2e-6));
        }
    }

    #[test]
    fn coincident_axles_give_a_midpoint_heading_without_derivatives() {
        let (q, by) = midpoint_seen_from_rear(Posture::new(0.0, 0.0, 1.0));
        let at = Posture::new(1.0, -2.0, 0.5);
        let chain = Chain::midpoint(at, Posture { phi: 0.7, ..at });
        assert_eq!(
            (q, chain.posture),
            (Posture::ORIGIN, Posture { phi: 0.0, ..at })
        );
        for by in [by, chain.by_base, chain.by_relative] {
            assert_eq!(by, [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0; 3]]);
        }
    }
}
