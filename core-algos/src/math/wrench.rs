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
