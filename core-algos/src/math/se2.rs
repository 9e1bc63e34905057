//! Planar rigid motion: posture, twist, composition and its Jacobians.

use super::matrix::Mat3;
use super::trig::{cos, sin, sin_cos, wrap_angle};
use core::f32::consts::PI;

/// Position (m) and heading (rad) of a body in plane coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(from = "[f32; 3]", into = "[f32; 3]"))]
pub struct Posture {
    /// Position along the first axis of the coordinates, m.
    pub x: f32,
    /// Position along the second axis of the coordinates, m.
    pub y: f32,
    /// Heading, rad, counter-clockwise positive.
    pub phi: f32,
}

impl From<[f32; 3]> for Posture {
    fn from([x, y, phi]: [f32; 3]) -> Self {
        Self { x, y, phi }
    }
}

impl From<Posture> for [f32; 3] {
    fn from(p: Posture) -> Self {
        [p.x, p.y, p.phi]
    }
}

impl Posture {
    /// Origin of the coordinates, heading 0.
    pub const ORIGIN: Self = Self::new(0.0, 0.0, 0.0);

    /// A posture from position (m) and heading (rad).
    pub const fn new(x: f32, y: f32, phi: f32) -> Self {
        Self { x, y, phi }
    }

    /// True if all three components are finite.
    pub fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.phi.is_finite()
    }

    /// `self ⊕ relative`: the posture that is `relative` as seen from `self`. Heading wrapped.
    pub fn compose(&self, relative: Self) -> Self {
        let (s, c) = sin_cos(self.phi);
        Self {
            x: self.x + c * relative.x - s * relative.y,
            y: self.y + s * relative.x + c * relative.y,
            phi: wrap_angle(self.phi + relative.phi),
        }
    }

    /// `⊖ self`: the frame as seen from this posture.
    pub fn inverse(&self) -> Self {
        let (s, c) = sin_cos(self.phi);
        Self {
            x: -c * self.x - s * self.y,
            y: s * self.x - c * self.y,
            phi: -self.phi,
        }
    }

    /// `⊖ base ⊕ self`: this posture as seen from `base`. Heading wrapped.
    #[inline(always)]
    pub fn relative_to(&self, base: Self) -> Self {
        let (s, c) = sin_cos(base.phi);
        let (dx, dy) = (self.x - base.x, self.y - base.y);
        Self {
            x: c * dx + s * dy,
            y: -s * dx + c * dy,
            phi: wrap_angle(self.phi - base.phi),
        }
    }

    /// Component-wise difference `self − other` in the common coordinates, heading wrapped.
    pub fn minus(&self, other: Self) -> [f32; 3] {
        [
            self.x - other.x,
            self.y - other.y,
            wrap_angle(self.phi - other.phi),
        ]
    }

    /// Derivatives of [`Self::compose`]: with respect to `self` and to `relative`.
    pub fn compose_jacobians(&self, relative: Self) -> (Mat3, Mat3) {
        let (s, c) = sin_cos(self.phi);
        let by_self = [
            [1.0, 0.0, -s * relative.x - c * relative.y],
            [0.0, 1.0, c * relative.x - s * relative.y],
            [0.0, 0.0, 1.0],
        ];
        let by_relative = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]];
        (by_self, by_relative)
    }

    /// Derivatives of [`Self::relative_to`]: with respect to `self` and to `base`.
    pub fn relative_jacobians(&self, base: Self) -> (Mat3, Mat3) {
        let (s, c) = sin_cos(base.phi);
        let r = self.relative_to(base);
        let by_self = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]];
        let by_base = [[-c, -s, r.y], [s, -c, -r.x], [0.0, 0.0, -1.0]];
        (by_self, by_base)
    }

    /// Derivative of [`Self::inverse`].
    pub fn inverse_jacobian(&self) -> Mat3 {
        let (s, c) = sin_cos(self.phi);
        let i = self.inverse();
        [[-c, -s, i.y], [s, -c, -i.x], [0.0, 0.0, -1.0]]
    }

    /// Distance between the two positions, m.
    pub fn distance(&self, other: Self) -> f32 {
        super::trig::hypot(self.x - other.x, self.y - other.y)
    }

    /// The posture after driving an arc of signed length `ds` (m) with heading change `dphi` (rad)
    /// under a constant twist: exact, and free of division by a small `dphi`.
    pub fn advance(&self, ds: f32, dphi: f32) -> Self {
        let chord = ds * super::trig::sinc(0.5 * dphi);
        let direction = self.phi + 0.5 * dphi;
        Self {
            x: self.x + chord * cos(direction),
            y: self.y + chord * sin(direction),
            phi: wrap_angle(self.phi + dphi),
        }
    }
}

/// A posture with the sine and cosine of its heading, computed once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    /// The posture.
    pub posture: Posture,
    /// Sine of the heading.
    pub sin: f32,
    /// Cosine of the heading.
    pub cos: f32,
}

impl From<Posture> for Transform {
    fn from(posture: Posture) -> Self {
        let (sin, cos) = sin_cos(posture.phi);
        Self { posture, sin, cos }
    }
}

impl Transform {
    /// Position unchanged, heading turned by π.
    pub fn turned(&self) -> Self {
        let phi = wrap_angle(self.posture.phi + PI);
        Self {
            posture: Posture {
                phi,
                ..self.posture
            },
            sin: -self.sin,
            cos: -self.cos,
        }
    }
}

/// Velocity of a body that does not slip sideways.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Twist {
    /// Forward velocity, m/s.
    pub v: f32,
    /// Yaw rate, rad/s.
    pub omega: f32,
}

impl Twist {
    /// Twist of a body at rest.
    pub const REST: Self = Self { v: 0.0, omega: 0.0 };

    /// A twist from forward velocity (m/s) and yaw rate (rad/s).
    pub const fn new(v: f32, omega: f32) -> Self {
        Self { v, omega }
    }

    /// True if both components are finite.
    pub fn is_finite(&self) -> bool {
        self.v.is_finite() && self.omega.is_finite()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn posture() -> impl Strategy<Value = Posture> {
        (-5.0f32..5.0, -5.0f32..5.0, -3.1f32..3.1).prop_map(|(x, y, phi)| Posture::new(x, y, phi))
    }

    fn close(a: Posture, b: Posture, tolerance: f32) -> bool {
        a.minus(b).iter().all(|d| d.abs() < tolerance)
    }

    /// Central difference of `f` with respect to component `k` of `at`.
    fn difference(f: impl Fn(Posture) -> Posture, at: Posture, k: usize) -> [f32; 3] {
        let h = 1e-2;
        let (mut low, mut high): ([f32; 3], [f32; 3]) = (at.into(), at.into());
        low[k] -= h;
        high[k] += h;
        f(high.into()).minus(f(low.into())).map(|d| d / (2.0 * h))
    }

    properties! {
        #[test]
        fn relative_undoes_compose(a in posture(), b in posture()) {
            prop_assert!(close(a.compose(b).relative_to(a), b, 1e-5));
            prop_assert!(close(a.inverse().compose(a), Posture::ORIGIN, 1e-5));
            prop_assert!(close(b.relative_to(a), a.inverse().compose(b), 1e-5));
        }

        #[test]
        fn jacobians_match_central_differences(a in posture(), b in posture()) {
            let (ja, jb) = a.compose_jacobians(b);
            let (ra, rb) = a.relative_jacobians(b);
            let ji = a.inverse_jacobian();
            for k in 0..3 {
                let columns = [
                    (difference(|p| p.compose(b), a, k), ja),
                    (difference(|p| a.compose(p), b, k), jb),
                    (difference(|p| p.relative_to(b), a, k), ra),
                    (difference(|p| a.relative_to(p), b, k), rb),
                    (difference(|p| p.inverse(), a, k), ji),
                ];
                for (column, jacobian) in columns {
                    for row in 0..3 {
                        prop_assert!((column[row] - jacobian[row][k]).abs() < 2e-3);
                    }
                }
            }
        }

        #[test]
        fn arc_is_the_limit_of_many_short_steps(ds in -1.0f32..1.0, dphi in -2.0f32..2.0) {
            let end = Posture::ORIGIN.advance(ds, dphi);
            let (mut x, mut y, n) = (0.0f64, 0.0f64, 4000);
            for i in 0..n {
                let phi = dphi as f64 * (i as f64 + 0.5) / n as f64;
                x += ds as f64 / n as f64 * phi.cos();
                y += ds as f64 / n as f64 * phi.sin();
            }
            prop_assert!((end.x as f64 - x).abs() < 1e-6 && (end.y as f64 - y).abs() < 1e-6);
        }
    }
}
