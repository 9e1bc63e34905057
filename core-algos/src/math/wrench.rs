//! Wrench of the frame between two axles, and its load on each axle.

use super::trig::{atan2, sin_cos, wrap_angle};
use super::{Posture, Steering};

/// Forces and moments of the frame. Axes are those of the rear axle, the origin is at the root.
///
/// The frame acts on the rear axle with `(+force, +moment_root)` at its root and on the front axle with
/// `(−force, −moment_end)` at its tip. For a massless frame with its tip at `(x, y)` from the root,
/// `moment_root = moment_end + x force_y − y force_x`. A frame bent to the left (ψ > 0) in pure bending has no force
/// and both moments `+EI κ`: the frame turns the rear axle left and the front axle right.
///
/// The moments may also be those about the two axle midpoints, for a frame with rigid ends reduced to these points.
/// The rigid lengths in [`Wrench::on_rear`] and [`Wrench::on_front`] are then 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Wrench {
    /// Force along the rear axle's forward direction, N.
    pub force_x: f32,
    /// Force to the rear axle's left, N.
    pub force_y: f32,
    /// Moment at the root, N m.
    pub moment_root: f32,
    /// Moment at the tip, N m.
    pub moment_end: f32,
}

/// Load of the frame on one axle, in that axle's own coordinates, at the axle's midpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AxleLoad {
    /// Force along the axle's forward direction, N.
    pub forward: f32,
    /// Force to the axle's left, N; the tyres carry it.
    pub lateral: f32,
    /// Moment about the axle's midpoint, N m, counter-clockwise positive.
    pub moment: f32,
}

impl AxleLoad {
    /// Sum of the loads of two frames.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            forward: self.forward + other.forward,
            lateral: self.lateral + other.lateral,
            moment: self.moment + other.moment,
        }
    }

    /// True if all components are finite.
    pub fn is_finite(&self) -> bool {
        self.forward.is_finite() && self.lateral.is_finite() && self.moment.is_finite()
    }
}

impl Wrench {
    /// No load.
    pub const ZERO: Self = Self {
        force_x: 0.0,
        force_y: 0.0,
        moment_root: 0.0,
        moment_end: 0.0,
    };

    /// True if all components are finite.
    pub fn is_finite(&self) -> bool {
        self.force_x.is_finite()
            && self.force_y.is_finite()
            && self.moment_root.is_finite()
            && self.moment_end.is_finite()
    }

    /// Pure bending at the steering angle `psi`: `M = EI 2ψ/L`, with bending stiffness EI (N m²) and flexible length
    /// L (m).
    pub fn pure_bending(stiffness: f32, length: f32, psi: Steering) -> Self {
        let moment = stiffness * 2.0 * psi.0 / length;
        Self {
            moment_root: moment,
            moment_end: moment,
            ..Self::default()
        }
    }

    /// Wrench of a frame whose front axle is at `relative` from its rear axle, without axial force: the cubic beam with
    /// the slopes a, b of root and tip against the chord, `M_root = −EI (4a + 2b)/L`, `M_end = EI (2a + 4b)/L`, and the
    /// shear `(M_root − M_end)/L` across the chord. Bending stiffness EI (N m²), flexible length L and rigid length at
    /// each end in m. The moments are those at the ends of the flexible part.
    pub fn cubic(stiffness: f32, length: f32, rigid_end: f32, relative: Posture) -> Self {
        let (sin, cos) = sin_cos(relative.phi);
        let x = relative.x - rigid_end * (1.0 + cos);
        let y = relative.y - rigid_end * sin;
        let chord = atan2(y, x);
        let (root, tip) = (-chord, wrap_angle(relative.phi - chord));
        let scale = stiffness / length;
        let (moment_root, moment_end) = (
            -scale * (4.0 * root + 2.0 * tip),
            scale * (2.0 * root + 4.0 * tip),
        );
        let shear = (moment_root - moment_end) / length;
        let (sin, cos) = sin_cos(chord);
        Self {
            force_x: -shear * sin,
            force_y: shear * cos,
            moment_root,
            moment_end,
        }
    }

    /// Load on the rear axle, whose midpoint is `rigid_root` (m) behind the root.
    pub fn on_rear(&self, rigid_root: f32) -> AxleLoad {
        AxleLoad {
            forward: self.force_x,
            lateral: self.force_y,
            moment: self.moment_root + rigid_root * self.force_y,
        }
    }

    /// Load on the front axle, whose heading is `relative.phi` from the rear axle's and whose
    /// midpoint is `rigid_tip` (m) ahead of the tip.
    pub fn on_front(&self, relative: Posture, rigid_tip: f32) -> AxleLoad {
        let (s, c) = sin_cos(relative.phi);
        let lateral = s * self.force_x - c * self.force_y;
        AxleLoad {
            forward: -c * self.force_x - s * self.force_y,
            lateral,
            moment: -self.moment_end - rigid_tip * lateral,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    properties! {
        /// A massless frame leaves no net force and no net moment on the two axles together.
        #[test]
        fn loads_on_both_axles_balance(
            force_x in -20.0f32..20.0, force_y in -20.0f32..20.0, moment_end in -3.0f32..3.0,
            x in 0.1f32..0.4, y in -0.2f32..0.2, phi in -1.5f32..1.5,
            root in 0.0f32..0.1, tip in 0.0f32..0.1,
        ) {
            let wrench = Wrench {
                force_x, force_y, moment_end,
                moment_root: moment_end + x * force_y - y * force_x,
            };
            // Midpoint of the front axle in the rear axle's coordinates.
            let relative = Posture::new(root, 0.0, 0.0)
                .compose(Posture::new(x, y, phi))
                .compose(Posture::new(tip, 0.0, 0.0));
            let rear = wrench.on_rear(root);
            let front = wrench.on_front(relative, tip);
            let (s, c) = (phi as f64).sin_cos();
            let (forward, lateral) = (front.forward as f64, front.lateral as f64);
            let fx = c * forward - s * lateral;
            let fy = s * forward + c * lateral;
            prop_assert!((fx + rear.forward as f64).abs() < 2e-5);
            prop_assert!((fy + rear.lateral as f64).abs() < 2e-5);
            let about_rear = rear.moment as f64 + front.moment as f64
                + relative.x as f64 * fy - relative.y as f64 * fx;
            prop_assert!(about_rear.abs() < 2e-5);
        }
    }

    /// Moments of the cubic are EI times its second derivative, taken from samples in f64; the shear is its third.
    #[test]
    fn cubic_frame_has_the_moments_of_its_curvature_and_no_axial_force() {
        let (stiffness, length) = (0.833f64, 0.37f64);
        for (a, b) in [(-0.1, 0.1), (0.05, 0.12), (-0.2, -0.05), (0.0, 0.15)] {
            for rigid in [0.0, 0.04] {
                // Headings against the rear axle: of the chord of the flexible part, of the front axle.
                let turn = -a;
                let tip: [f64; 2] = [turn, turn + b];
                let x = rigid + length * tip[0].cos() + rigid * tip[1].cos();
                let y = length * tip[0].sin() + rigid * tip[1].sin();
                let relative = Posture::new(x as f32, y as f32, tip[1] as f32);
                let [f, l, r] = [stiffness, length, rigid].map(|v| v as f32);
                let wrench = Wrench::cubic(f, l, r, relative);
                let cubic =
                    |u: f64| length * (a * u * (1.0 - u) * (1.0 - u) - b * u * u * (1.0 - u));
                let h = 1e-3;
                let second = |u: f64| {
                    let [low, here, high] = [u - h, u, u + h].map(cubic);
                    (low - 2.0 * here + high) / (h * h * length * length)
                };
                let moments = [0.0, 1.0].map(|u| stiffness * second(u));
                assert!((f64::from(wrench.moment_root) - moments[0]).abs() < 1e-4);
                assert!((f64::from(wrench.moment_end) - moments[1]).abs() < 1e-4);
                let shear = (moments[0] - moments[1]) / length;
                let (s, c) = turn.sin_cos();
                assert!((f64::from(wrench.force_x) + shear * s).abs() < 1e-3);
                assert!((f64::from(wrench.force_y) - shear * c).abs() < 1e-3);
            }
        }
    }

    /// Pure bending is a circle; the cubic gives its moment up to terms of third order in ψ.
    #[test]
    fn cubic_frame_on_a_circle_is_in_pure_bending() {
        for psi in [-0.3f32, 0.05, 0.2] {
            let chord = 0.37 * psi.sin() / psi;
            let relative = Posture::new(chord * psi.cos(), chord * psi.sin(), 2.0 * psi);
            let cubic = Wrench::cubic(0.833, 0.37, 0.0, relative);
            let pure = Wrench::pure_bending(0.833, 0.37, Steering(psi));
            assert!((cubic.moment_root - pure.moment_root).abs() < 1e-5);
            assert!((cubic.moment_end - pure.moment_end).abs() < 1e-5);
            assert!(cubic.force_x.abs() + cubic.force_y.abs() < 1e-4);
        }
    }

    #[test]
    fn bent_frame_loads_its_axles_with_opposite_moments() {
        // 0.833 N m² over 0.37 m at 0.5 rad: 2.25 N m.
        let wrench = Wrench::pure_bending(0.833, 0.37, Steering(0.5));
        let relative = Posture::new(0.3, 0.1, 1.0);
        assert!((wrench.on_rear(0.0).moment - 2.2514).abs() < 1e-3);
        let (front, rear) = (wrench.on_front(relative, 0.02), wrench.on_rear(0.02));
        assert_eq!(front.moment, -rear.moment);
    }
}
