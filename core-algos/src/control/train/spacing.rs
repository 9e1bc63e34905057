//! Distance of neighbouring axles along the curve at which their frame carries no axial force.
//!
//! The frame has a fixed length, so between two axles it is a little shorter than the curve or longer. To second order
//! in the slopes φ against the chord, a line of length S has a chord of S − ½∫φ² ds. The frame bends as a cubic with
//! the headings of the two axles at its ends, hence
//!
//! ```text
//! S = L + 2a + ½ (∫ φ_curve² ds − ∫ φ_frame² ds)
//! ```
//!
//! with the flexible length L and rigid ends a. Terms of fourth order nearly cancel in the difference: within 21 µm of
//! the exact elastica on clothoids. The first integral takes five Gauss points. The second is exact: with the slopes
//! α, β of the axles, the rigid ends tilt the chord of the flexible part by m = −a (α + β)/L, and
//! ∫φ_frame² = a (α² + β²) + L (m² + (2α'² − α'β' + 2β'²)/15) with α' = α − m, β' = β − m.
//!
//! The direction of the chord is the mean heading less a sixth of the mean cube of the slopes against it, to fifth order.
//! So only headings of the curve are needed, which cost no sine.
//!
//! The formula is symmetric, so places computed from either end of the robot agree.
//!
//! # Panic contract
//!
//! Nothing can fail. Cost of one evaluation: about 120 floating-point operations.

use super::curve::Curve;
use crate::math::trig::wrap_angle;

/// Five Gauss points on [0, 1] and their weights.
const POINTS: [(f32, f32); 5] = [
    (0.046_910_077, 0.118_463_44),
    (0.230_765_34, 0.239_314_34),
    (0.5, 0.284_444_44),
    (0.769_234_66, 0.239_314_34),
    (0.953_089_9, 0.118_463_44),
];
/// Iterations of the fixed point; each lowers the error to the share ½ φ².
const ITERATIONS: usize = 2;

/// Lengths of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Flexible length L, m.
    pub length_m: f32,
    /// Rigid length a between each end of the flexible part and its axle, m.
    pub rigid_end_m: f32,
}

impl Link {
    /// Distance of the axles on a straight curve, m.
    pub fn straight(&self) -> f32 {
        self.length_m + 2.0 * self.rigid_end_m
    }

    /// ∫φ_frame² ds for the slopes `root` and `tip` of the axles against their chord, m.
    fn bow(&self, root: f32, tip: f32) -> f32 {
        let (length, rigid) = (self.length_m, self.rigid_end_m);
        let tilt = -rigid * (root + tip) / length;
        let (a, b) = (root - tilt, tip - tilt);
        rigid * (root * root + tip * tip)
            + length * (tilt * tilt + (2.0 * a * a - a * b + 2.0 * b * b) * (1.0 / 15.0))
    }

    /// Length of the curve (m) that the frame needs, if its axles are at `rear` and `front` (m).
    fn needed(&self, curve: &Curve, rear: f32, front: f32) -> f32 {
        let length = front - rear;
        let root = curve.heading(rear);
        let turn = |s: f32| wrap_angle(curve.heading(s) - root);
        let turns = POINTS.map(|(point, weight)| (turn(rear + point * length), weight));
        let mean: f32 = turns.iter().map(|(turn, weight)| weight * turn).sum();
        let (mut square, mut cube) = (0.0, 0.0);
        for (turn, weight) in turns {
            let slope = turn - mean;
            square += weight * slope * slope;
            cube += weight * slope * slope * slope;
        }
        let off = cube * (1.0 / 6.0);
        let chord = mean - off;
        let curve_bow = length * (square + off * off);
        self.straight() + 0.5 * (curve_bow - self.bow(-chord, turn(front) - chord))
    }

    /// Place (m) of the axle behind the axle at `front` (m); `near` is a place nearby.
    pub fn behind(&self, curve: &Curve, front: f32, near: f32) -> f32 {
        let mut length = front - near;
        for _ in 0..ITERATIONS {
            length = self.needed(curve, front - length, front);
        }
        front - length
    }

    /// Place (m) of the axle ahead of the axle at `rear` (m); `near` is a place nearby.
    pub fn ahead(&self, curve: &Curve, rear: f32, near: f32) -> f32 {
        let mut length = near - rear;
        for _ in 0..ITERATIONS {
            length = self.needed(curve, rear, rear + length);
        }
        rear + length
    }
}

#[cfg(test)]
mod tests {
    use super::super::Direction;
    use super::super::curve::Knot;
    use super::*;

    fn curve(kappa: impl Fn(f32) -> f32) -> Curve {
        let mut curve = Curve::EMPTY;
        let at = |posture| Knot {
            posture,
            kappa: kappa(0.0),
        };
        curve.restart(at(crate::math::Posture::ORIGIN), 0.01);
        for k in 1..200u16 {
            curve.extend(Direction::Forward, kappa(0.01 * f32::from(k)));
        }
        curve
    }

    const LINK: Link = Link {
        length_m: 0.37,
        rigid_end_m: 0.0,
    };

    /// On a circle the frame is the circle: any constant curvature leaves its length unchanged.
    #[test]
    fn frame_on_a_circle_takes_its_own_length() {
        for kappa in [-2.5f32, -1.0, 0.0, 0.3, 2.3] {
            let curve = curve(|_| kappa);
            let length = 1.5 - LINK.behind(&curve, 1.5, 1.13);
            assert!((length - 0.37).abs() < 1e-4, "{kappa}: {length}");
        }
    }

    /// The length of the cubic through the two axles, integrated in f64, is the length of the frame, but for
    /// terms of fourth order.
    #[test]
    fn cubic_between_the_axles_has_the_length_of_the_frame() {
        for (amplitude, phase) in [(2.0f32, 0.0f32), (2.0, 0.8), (2.5, 1.6), (2.5, 2.4)] {
            let curve = curve(|s| amplitude * (3.0 * s + phase).sin());
            let front = 1.3;
            let rear = LINK.behind(&curve, front, front - 0.37);
            let p = curve.at(front).knot.posture;
            let q = curve.at(rear).knot.posture;
            let (dx, dy) = (f64::from(p.x - q.x), f64::from(p.y - q.y));
            let chord = dx.hypot(dy);
            let [a, b] = [q, p].map(|p| (f64::from(p.phi) - dy.atan2(dx)).tan());
            let steps = 10_000;
            let length: f64 = (0..steps)
                .map(|i| {
                    let x = (f64::from(i) + 0.5) / f64::from(steps);
                    let slope = a * (1.0 - 4.0 * x + 3.0 * x * x) + b * (3.0 * x * x - 2.0 * x);
                    chord / f64::from(steps) * slope.hypot(1.0)
                })
                .sum();
            assert!(
                (length - 0.37).abs() < 1e-3,
                "{amplitude} {phase}: {length}"
            );
        }
    }

    #[test]
    fn places_from_either_end_agree() {
        for link in [
            LINK,
            Link {
                length_m: 0.3,
                rigid_end_m: 0.035,
            },
        ] {
            let curve = curve(|s| 2.3 * (4.0 * s).sin());
            for front in [0.9f32, 1.2, 1.45] {
                let near = front - link.straight();
                let back = link.ahead(&curve, link.behind(&curve, front, near), front);
                assert!((back - front).abs() < 2e-6, "{front}: {back}");
            }
        }
    }

    /// The polygon of rigid end, cubic and rigid end closes on a symmetric bend: an arc of the flexible part with
    /// straight ends has the chord 2 (a cos ψ + (L/2ψ) sin ψ).
    #[test]
    fn rigid_ends_shorten_the_chord_as_their_geometry_says() {
        let (length_m, rigid_end_m, psi) = (0.3f64, 0.05f64, 0.3f64);
        let link = Link {
            length_m: length_m as f32,
            rigid_end_m: rigid_end_m as f32,
        };
        let chord = 2.0 * (rigid_end_m * psi.cos() + length_m / (2.0 * psi) * psi.sin());
        let by_link = f64::from(link.straight() - 0.5 * link.bow(psi as f32, -psi as f32));
        // Fourth order: L ψ⁴/120 + 2 a ψ⁴/24.
        assert!((by_link - chord).abs() < 6e-5, "{by_link} {chord}");
    }
}
