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
//! # Speeds
//!
//! The chord c = L + 2a − ½∫φ_frame² ds keeps up with both axles. With the slopes α of the rear axle and β of the front
//! axle against it, dc = (1 − ½β²) ds_f − (1 − ½α²) ds_r, and the chord turns by (β ds_f − α ds_r)/c. The derivative of
//! the right side by the slopes then gives ds_r/ds_f.
//!
//! # Panic contract
//!
//! Nothing can fail. Cost of a place: about 300 floating-point operations.

use super::curve::Curve;
use crate::math::Posture;
use crate::math::trig::{atan2, wrap_angle};

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

/// Place of an axle, found from that of its neighbour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Place, m.
    pub place: f32,
    /// Speed of the axle over that of its neighbour, or of the leader.
    pub ratio: f32,
}

impl Neighbour {
    /// `next`, which was found from this axle, with its speed over that of the leader.
    pub(super) fn then(self, next: Self) -> Self {
        Self {
            ratio: self.ratio * next.ratio,
            ..next
        }
    }
}

/// Frame between two places.
#[derive(Clone, Copy, Debug, Default)]
struct Fit {
    /// Length of the curve that the frame needs, m.
    length: f32,
    /// Slope of the rear axle against the chord, rad.
    root: f32,
    /// Slope of the front axle against the chord, rad.
    tip: f32,
}

impl Link {
    /// Distance of the axles on a straight curve, m.
    pub fn straight(&self) -> f32 {
        self.length_m + 2.0 * self.rigid_end_m
    }

    /// Half the moment of the frame on its front axle less half that on its rear axle, over EI/L, rad, with the front
    /// axle at `relative` from the rear axle. The frame is a cubic with the moments M_front = EI (2α' + 4β')/L and
    /// M_rear = −EI (4α' + 2β')/L at its flexible ends, and its shear acts on the rigid ends.
    pub fn uneven_bend(&self, relative: Posture) -> f32 {
        let chord = atan2(relative.y, relative.x);
        let longer = self.straight() / self.length_m;
        3.0 * longer * longer * wrap_angle(relative.phi - 2.0 * chord)
    }

    /// ∫φ_frame² ds for the slopes `root` and `tip` of the axles against their chord, m.
    fn bow(&self, root: f32, tip: f32) -> f32 {
        let (length, rigid) = (self.length_m, self.rigid_end_m);
        let tilt = -rigid * (root + tip) / length;
        let (a, b) = (root - tilt, tip - tilt);
        rigid * (root * root + tip * tip)
            + length * (tilt * tilt + (2.0 * a * a - a * b + 2.0 * b * b) * (1.0 / 15.0))
    }

    /// Derivatives of [`Self::bow`] by the slopes of the rear and the front axle, m.
    fn bow_slopes(&self, root: f32, tip: f32) -> [f32; 2] {
        let (length, rigid) = (self.length_m, self.rigid_end_m);
        let by_slope = -rigid / length;
        let tilt = by_slope * (root + tip);
        let (a, b) = (root - tilt, tip - tilt);
        let (by_a, by_b) = ((4.0 * a - b) * (1.0 / 15.0), (4.0 * b - a) * (1.0 / 15.0));
        let common = length * by_slope * (2.0 * tilt - by_a - by_b);
        [
            2.0 * rigid * root + length * by_a + common,
            2.0 * rigid * tip + length * by_b + common,
        ]
    }

    /// Length of the curve (m) that the frame needs, if its axles are at `rear` and `front` (m).
    fn needed(&self, curve: &Curve, rear: f32, front: f32) -> Fit {
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
        let (root, tip) = (-chord, turn(front) - chord);
        Fit {
            length: self.straight() + 0.5 * (curve_bow - self.bow(root, tip)),
            root,
            tip,
        }
    }

    /// Shares of the motions of rear and front axle in the change of the chord less that of the frame.
    fn shares(&self, curve: &Curve, rear: f32, front: f32, fit: Fit) -> [f32; 2] {
        let Fit { length, root, tip } = fit;
        let [by_root, by_tip] = self.bow_slopes(root, tip).map(|slope| 0.5 * slope);
        let (turn_by_rear, turn_by_front) = (root / length, tip / length);
        [
            1.0 - 0.5 * root * root
                - by_root * (curve.kappa(rear) + turn_by_rear)
                - by_tip * turn_by_rear,
            1.0 - 0.5 * tip * tip + by_tip * (curve.kappa(front) - turn_by_front)
                - by_root * turn_by_front,
        ]
    }

    /// Place of the axle behind the axle at `front` (m); `near` is a place nearby.
    pub fn behind(&self, curve: &Curve, front: f32, near: f32) -> Neighbour {
        let (mut place, mut fit) = (near, Fit::default());
        for _ in 0..ITERATIONS {
            fit = self.needed(curve, place, front);
            place = front - fit.length;
        }
        let [by_rear, by_front] = self.shares(curve, place, front, fit);
        Neighbour {
            place,
            ratio: by_front / by_rear,
        }
    }

    /// Place of the axle ahead of the axle at `rear` (m); `near` is a place nearby.
    pub fn ahead(&self, curve: &Curve, rear: f32, near: f32) -> Neighbour {
        let (mut place, mut fit) = (near, Fit::default());
        for _ in 0..ITERATIONS {
            fit = self.needed(curve, rear, place);
            place = rear + fit.length;
        }
        let [by_rear, by_front] = self.shares(curve, rear, place, fit);
        Neighbour {
            place,
            ratio: by_rear / by_front,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Direction;
    use super::super::curve::Knot;
    use super::*;
    use crate::math::Wrench;

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
    const RIGID: Link = Link {
        length_m: 0.3,
        rigid_end_m: 0.035,
    };

    /// On a circle the frame is the circle: any constant curvature leaves its length unchanged.
    #[test]
    fn frame_on_a_circle_takes_its_own_length() {
        for kappa in [-2.5f32, -1.0, 0.0, 0.3, 2.3] {
            let curve = curve(|_| kappa);
            let length = 1.5 - LINK.behind(&curve, 1.5, 1.13).place;
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
            let rear = LINK.behind(&curve, front, front - 0.37).place;
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
        for link in [LINK, RIGID] {
            let curve = curve(|s| 2.3 * (4.0 * s).sin());
            for front in [0.9f32, 1.2, 1.45] {
                let near = front - link.straight();
                let rear = link.behind(&curve, front, near);
                let back = link.ahead(&curve, rear.place, front);
                assert!((back.place - front).abs() < 2e-6, "{front}: {back:?}");
                assert!((back.ratio * rear.ratio - 1.0).abs() < 1e-5, "{front}");
            }
        }
    }

    /// The ratio of speeds is the difference quotient of the places.
    #[test]
    fn ratio_is_the_derivative_of_the_place() {
        let half = 0.01;
        for (link, wave) in [(LINK, 4.0f32), (RIGID, 4.0), (RIGID, 7.0)] {
            let curve = curve(|s| 2.3 * (wave * s).sin());
            let (mut largest, mut worst) = (0.0f32, 0.0f32);
            for k in 0..40u8 {
                let front = 0.9 + 0.01 * f32::from(k);
                let near = front - link.straight();
                let [before, at, after] =
                    [-half, 0.0, half].map(|d| link.behind(&curve, front + d, near + d));
                let found = (after.place - before.place) / (2.0 * half);
                largest = largest.max((at.ratio - 1.0).abs());
                worst = worst.max((at.ratio - found).abs());
            }
            // The ratio differs enough from 1 for this test.
            assert!(worst < 4e-4 && largest > 3e-3, "{worst} {largest}");
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

    /// The wrench of a cubic frame, moments about the axles.
    #[test]
    fn uneven_bend_is_that_of_the_cubic_wrench() {
        for rigid in [0.0, 0.03, 0.1] {
            let link = Link {
                length_m: 0.37,
                rigid_end_m: rigid,
            };
            for (y, phi) in [(0.03, 0.0), (-0.02, 0.15), (0.05, 0.3), (0.04, -0.2)] {
                let relative = Posture::new(link.straight() - 0.005, y, phi);
                let wrench = Wrench::cubic(link.length_m, link.length_m, rigid, relative);
                let on_front = -wrench.on_front(relative, rigid).moment;
                let on_rear = wrench.on_rear(rigid).moment;
                let uneven = link.uneven_bend(relative);
                let difference = 0.5 * (on_front - on_rear);
                let most = 0.03 * difference.abs() + 3e-3;
                assert!((uneven - difference).abs() < most, "{uneven} {difference}");
                let mean = 0.5 * (on_front + on_rear);
                assert!((mean - phi).abs() < 0.12 * phi.abs() + 3e-3, "{mean} {phi}");
            }
        }
    }
}
