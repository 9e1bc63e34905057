//! Cascade connection (paper eq. 5, 6): from the motion of the robot's midpoint O to a reference
//! for each axle.
//!
//! # Geometry
//!
//! The frame bends in a circular arc between the axles (pure bending), so the axles are turned by
//! +ψ (front) and −ψ (rear) from the line C2→C1, whose direction is the heading φ of O. With
//! flexible length L and a rigid section a at each end the axles are a chord
//! `c(ψ) = L sin ψ/ψ + 2 a cos ψ` apart. Neither axle slips sideways, which gives, with v the
//! velocity of O along its heading,
//!
//! - `κ = φ̇/v = 2 tan ψ/c(ψ)`; for a = 0 this is paper eq. 5, `2ψ/(L cos ψ)`;
//! - `v_i = (v ± ½ ċ)/cos ψ`, `+` for the front axle, `ċ = c'(ψ) ψ̇`; for small ψ and a = 0 this is
//!   paper eq. 6, since `c' → −L ψ/3`;
//! - `ω_i = φ̇ ± ψ̇`;
//! - O itself moves sideways by `½ tan ψ ċ`: of third order in ψ, absent from the paper.
//!
//! # Panic contract
//!
//! [`Config::build`] validates the geometry; nothing else here can fail. Steering angles outside
//! ±[`Config::max_steering_rad`] are limited to it, NaN counts as zero.

use super::arc::{Arc, Shape};
use crate::config::{ConfigError, in_range, non_negative, positive};
use crate::math::trig::wrap_angle;
use crate::math::{Posture, Steering, Transform, Twist};
use core::f32::consts::PI;
use core::hint::cold_path;

/// Largest steering angle that can be configured, rad. Beyond, 1/cos ψ loses its digits.
pub const MAX_STEERING: f32 = 1.5;

/// Which form of the axle velocities (paper eq. 6) is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "lowercase"))]
pub enum Form {
    /// `v_i = (v ± ½ ċ)/cos ψ` with the exact rate of the chord.
    #[default]
    Exact,
    /// `v_i = v/cos ψ ∓ L ψ ψ̇/6`, as the paper prints it.
    Printed,
}

/// Geometry of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Config {
    /// Length of the flexible part of the frame (L), m.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub frame_length_m: f32,
    /// Length of the rigid section between each end of the flexible part and the midpoint of its
    /// axle, m; the same at both ends.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub rigid_end_m: f32,
    /// Largest steering angle |ψ| asked of the frame, rad.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub max_steering_rad: f32,
    /// Form of the axle velocities.
    pub form: Form,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            frame_length_m: 0.37,
            rigid_end_m: 0.0,
            max_steering_rad: 0.5,
            form: Form::Exact,
        }
    }
}

impl Config {
    /// The ready-to-run form; the error names the field that is wrong.
    pub fn build(&self) -> Result<Cascade, ConfigError> {
        let length = positive("frame_length_m", self.frame_length_m)?;
        let rigid_end = non_negative("rigid_end_m", self.rigid_end_m)?;
        let mut cascade = Cascade {
            arc: Arc::new(length, rigid_end),
            max_steering: in_range(
                "max_steering_rad",
                self.max_steering_rad,
                1e-3,
                MAX_STEERING,
            )?,
            max_curvature: 0.0,
            form: self.form,
        };
        cascade.max_curvature = cascade.curvature(Steering(cascade.max_steering));
        Ok(cascade)
    }
}

/// Motion of the midpoint O: speed along the heading and steering angle, with their rates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Motion {
    /// Velocity of O along its heading (v), m/s, negative in reverse.
    pub v: f32,
    /// Acceleration (v̇), m/s².
    pub v_rate: f32,
    /// Steering angle (ψ = ψ1 = −ψ2).
    pub psi: Steering,
    /// Steering rate (ψ̇), rad/s.
    pub psi_rate: f32,
    /// Steering acceleration (ψ̈), rad/s².
    pub psi_acceleration: f32,
}

/// Reference of one axle at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AxleReference {
    /// Posture of the axle's midpoint in the global frame (q_r).
    pub posture: Posture,
    /// Forward velocity and yaw rate (v_r).
    pub twist: Twist,
    /// Rates of both (v̇_r): m/s², rad/s².
    pub acceleration: Twist,
}

/// Steering angle with its first two derivatives in time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SteeringMotion {
    /// ψ.
    pub psi: Steering,
    /// ψ̇, rad/s.
    pub rate: f32,
    /// ψ̈, rad/s².
    pub acceleration: f32,
}

/// The cascade connection of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cascade {
    arc: Arc,
    max_steering: f32,
    max_curvature: f32,
    form: Form,
}

impl Cascade {
    /// Largest steering angle, rad.
    pub fn max_steering(&self) -> f32 {
        self.max_steering
    }

    /// Path curvature at the largest steering angle, 1/m.
    pub fn max_curvature(&self) -> f32 {
        self.max_curvature
    }

    /// `psi` limited to what the frame may be asked for; NaN gives 0.
    #[inline(always)]
    fn limited(&self, Steering(psi): Steering) -> Steering {
        Steering(if psi.abs() <= self.max_steering {
            psi
        } else if psi.is_nan() {
            cold_path();
            0.0
        } else {
            cold_path();
            self.max_steering.copysign(psi)
        })
    }

    /// Shape of the frame at the limited `psi`.
    #[inline(always)]
    pub(super) fn bent(&self, psi: Steering) -> Shape {
        self.arc.bent(self.limited(psi))
    }

    /// Path curvature of O at steering angle `psi`, 1/m (paper eq. 5).
    pub fn curvature(&self, psi: Steering) -> f32 {
        self.bent(psi).kappa
    }

    /// κ(ψ) and its first two derivatives by ψ: 1/m, 1/(m rad), 1/(m rad²).
    pub fn curvature_derivatives(&self, psi: Steering) -> [f32; 3] {
        let shape = self.bent(psi);
        let second = (2.0
            * (shape.tan * (shape.sec * shape.sec) - shape.kappa_slope * shape.slope)
            - shape.kappa * shape.second)
            / shape.half;
        [shape.kappa, shape.kappa_slope, second]
    }

    /// Steering angle for a path curvature (1/m): the inverse of [`Self::curvature`], by Newton's
    /// method. Curvature beyond the bound gives the largest steering angle of its sign; NaN gives 0.
    #[inline(always)]
    pub fn steering(&self, kappa: f32) -> Steering {
        if kappa.abs() < self.max_curvature {
            self.arc.steering(kappa, self.max_steering)
        } else if kappa.is_nan() {
            cold_path();
            Steering::STRAIGHT
        } else {
            cold_path();
            Steering(self.max_steering.copysign(kappa))
        }
    }

    /// Steering angle and its derivatives for a path curvature (1/m) that changes at `rate`
    /// (1/(m s)) and `acceleration` (1/(m s²)): `ψ̇ = κ̇/κ'(ψ)`, `ψ̈ = (κ̈ − κ''(ψ) ψ̇²)/κ'(ψ)`.
    ///
    /// At the bound of curvature the angle is limited, the derivatives are not.
    pub fn steering_motion(&self, kappa: f32, rate: f32, acceleration: f32) -> SteeringMotion {
        let psi = self.steering(kappa);
        let [_, first, second] = self.curvature_derivatives(psi);
        let psi_rate = rate / first;
        SteeringMotion {
            psi,
            rate: psi_rate,
            acceleration: (acceleration - second * psi_rate * psi_rate) / first,
        }
    }

    /// Velocity and acceleration of both axles, front first (paper eq. 6 in the configured form).
    pub fn axle_twists(&self, motion: &Motion) -> [(Twist, Twist); 2] {
        self.twists_of(motion, self.limited(motion.psi)).1
    }

    /// Shape of the frame at the limited `psi`, and the twists of both axles.
    #[inline(always)]
    fn twists_of(&self, motion: &Motion, psi: Steering) -> (Shape, [(Twist, Twist); 2]) {
        let (v, v_rate) = (motion.v, motion.v_rate);
        let (psi_rate, psi_acceleration) = (motion.psi_rate, motion.psi_acceleration);
        let shape = self.arc.bent(psi);
        let yaw_rate = v * shape.kappa;
        let yaw_acceleration = v_rate * shape.kappa + v * shape.kappa_slope * psi_rate;

        // Rate of 1/cos ψ over itself.
        let growth = shape.tan * psi_rate;
        let along = v_rate + v * growth;
        // Half of the rate at which the axles part, and its own rate, along the chord; then all
        // seen along the axles' headings.
        let [front, rear] = match self.form {
            Form::Exact => {
                let parting = shape.slope * psi_rate;
                let rate = shape.second * (psi_rate * psi_rate)
                    + shape.slope * psi_acceleration
                    + parting * growth;
                [(parting, rate), (-parting, -rate)]
                    .map(|(part, rate)| ((v + part) * shape.sec, (along + rate) * shape.sec))
            }
            Form::Printed => {
                cold_path();
                let sixth = -self.arc.length() / 6.0;
                let parting = sixth * psi.0 * psi_rate;
                let rate = sixth * (psi_rate * psi_rate + psi.0 * psi_acceleration);
                [(parting, rate), (-parting, -rate)]
                    .map(|(part, rate)| (v * shape.sec + part, along * shape.sec + rate))
            }
        };
        let front = (
            Twist::new(front.0, yaw_rate + psi_rate),
            Twist::new(front.1, yaw_acceleration + psi_acceleration),
        );
        let rear = (
            Twist::new(rear.0, yaw_rate - psi_rate),
            Twist::new(rear.1, yaw_acceleration - psi_acceleration),
        );
        (shape, [front, rear])
    }

    /// Postures of both axles, front first: half a chord ahead and behind, turned by +ψ and −ψ.
    #[inline(always)]
    fn postures_of(center: &Transform, Steering(psi): Steering, half_chord: f32) -> [Posture; 2] {
        let (dx, dy) = (half_chord * center.cos, half_chord * center.sin);
        let Posture { x, y, phi } = center.posture;
        let (mut left, mut right) = (phi + psi, phi - psi);
        if !(phi.abs() + psi.abs() <= PI) {
            cold_path();
            (left, right) = (wrap_angle(left), wrap_angle(right));
        }
        [
            Posture::new(x + dx, y + dy, left),
            Posture::new(x - dx, y - dy, right),
        ]
    }

    /// Complete references of both axles, front first.
    #[inline(always)]
    pub fn references(&self, center: impl Into<Transform>, motion: &Motion) -> [AxleReference; 2] {
        let psi = self.limited(motion.psi);
        let (shape, [(front_twist, front_rate), (rear_twist, rear_rate)]) =
            self.twists_of(motion, psi);
        let [front, rear] = Self::postures_of(&center.into(), psi, shape.half);
        [
            AxleReference {
                posture: front,
                twist: front_twist,
                acceleration: front_rate,
            },
            AxleReference {
                posture: rear,
                twist: rear_twist,
                acceleration: rear_rate,
            },
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cascade(rigid_end_m: f32, form: Form) -> Cascade {
        Config {
            rigid_end_m,
            max_steering_rad: 1.4,
            form,
            ..Config::default()
        }
        .build()
        .unwrap()
    }

    /// Posture of the front axle in the rear axle's frame by walking along the frame in `f64`.
    fn walked(length: f64, end: f64, psi: f64) -> (f64, f64) {
        let n = 20_000;
        let (mut x, mut y) = (end, 0.0);
        for i in 0..n {
            let theta = 2.0 * psi * (i as f64 + 0.5) / n as f64;
            x += length / n as f64 * theta.cos();
            y += length / n as f64 * theta.sin();
        }
        let (s, c) = (2.0 * psi).sin_cos();
        (x + end * c, y + end * s)
    }

    /// κ of eq. 5 solved by bisection in `f64`.
    fn bisected(length: f64, kappa: f64) -> f64 {
        let (mut low, mut high) = (0.0, std::f64::consts::FRAC_PI_2);
        for _ in 0..100 {
            let mid = 0.5 * (low + high);
            if 2.0 * mid < kappa.abs() * length * mid.cos() {
                low = mid;
            } else {
                high = mid;
            }
        }
        low * kappa.signum()
    }

    properties! {
        #[test]
        fn steering_solves_equation_five(kappa in -30.0f32..30.0, length in 0.05f32..1.0) {
            let cascade = Config { frame_length_m: length, max_steering_rad: 1.5, ..Config::default() }
                .build().unwrap();
            prop_assume!(kappa.abs() < cascade.max_curvature());
            let exact = bisected(length as f64, kappa as f64);
            prop_assert!((f64::from(cascade.steering(kappa).0) - exact).abs() < 3e-7);
        }

        #[test]
        fn steering_inverts_curvature(psi in -1.39f32..1.39, end in 0.0f32..0.4) {
            let cascade = cascade(end, Form::Exact);
            prop_assert!((cascade.steering(cascade.curvature(Steering(psi))).0 - psi).abs() < 1e-6);
        }

        #[test]
        fn axles_stand_where_the_bent_frame_puts_them(psi in -1.3f32..1.3, end in 0.0f32..0.1) {
            let cascade = cascade(end, Form::Exact);
            let center = Posture::new(0.4, -0.3, 2.0);
            let motion = Motion { psi: Steering(psi), ..Motion::default() };
            let [front, rear] = cascade.references(center, &motion).map(|axle| axle.posture);
            let relative = front.relative_to(rear);
            let (x, y) = walked(0.37, end as f64, psi as f64);
            prop_assert!((relative.x as f64 - x).abs() < 1e-6);
            prop_assert!((relative.y as f64 - y).abs() < 1e-6);
            prop_assert!((wrap_angle(relative.phi - 2.0 * psi)).abs() < 1e-6);
            prop_assert!((0.5 * (front.x + rear.x) - center.x).abs() < 1e-6);
            prop_assert!((0.5 * (front.y + rear.y) - center.y).abs() < 1e-6);
            let heading = crate::math::trig::atan2(front.y - rear.y, front.x - rear.x);
            prop_assert!((heading - center.phi).abs() < 1e-6);
        }

        /// The axles are carried by their references: central differences, in `f64`, of the
        /// postures that O and ψ put them in give the velocities, with nothing across the axle.
        #[test]
        fn velocities_are_the_rates_of_the_postures(
            v in -0.5f32..0.5, psi in -1.2f32..1.2, psi_rate in -2.0f32..2.0, end in 0.0f32..0.1,
        ) {
            let cascade = cascade(end, Form::Exact);
            let motion = Motion { v, psi: Steering(psi), psi_rate, ..Motion::default() };
            let twists = cascade.axle_twists(&motion);
            let chord = |p: f64| 0.37 * if p == 0.0 { 1.0 } else { p.sin() / p }
                + 2.0 * end as f64 * p.cos();
            let yaw_rate = v as f64 * cascade.curvature(Steering(psi)) as f64;
            let h = 1e-4;
            // O moves across its heading as the chord changes: ½ tan ψ ċ.
            let stretch = (chord(psi as f64 + h) - chord(psi as f64 - h)) / (2.0 * h);
            let lateral = 0.5 * (psi as f64).tan() * stretch * psi_rate as f64;
            for (side, (twist, _)) in [1.0, -1.0].into_iter().zip(twists) {
                let at = |t: f64| {
                    let p = psi as f64 + psi_rate as f64 * t;
                    let phi = yaw_rate * t;
                    let half = side * 0.5 * chord(p);
                    (
                        v as f64 * t + half * phi.cos(),
                        lateral * t + half * phi.sin(),
                        phi + side * p,
                    )
                };
                let (a, b) = (at(-h), at(h));
                let (s, c) = (side * psi as f64).sin_cos();
                let (dx, dy) = ((b.0 - a.0) / (2.0 * h), (b.1 - a.1) / (2.0 * h));
                prop_assert!((c * dx + s * dy - twist.v as f64).abs() < 2e-6);
                prop_assert!((c * dy - s * dx).abs() < 2e-6, "slips sideways");
                prop_assert!(((b.2 - a.2) / (2.0 * h) - twist.omega as f64).abs() < 5e-6);
            }
        }

        #[test]
        fn accelerations_are_central_differences_of_velocities(
            v in -0.3f32..0.3, v_rate in -0.4f32..0.4,
            psi in -0.9f32..0.9, psi_rate in -1.0f32..1.0, psi_acceleration in -8.0f32..8.0,
            printed: bool,
        ) {
            let form = if printed { Form::Printed } else { Form::Exact };
            let cascade = cascade(0.03, form);
            let at = |t: f32| cascade.axle_twists(&Motion {
                v: v + v_rate * t,
                psi: Steering(psi + (psi_rate + 0.5 * psi_acceleration * t) * t),
                psi_rate: psi_rate + psi_acceleration * t,
                ..Motion::default()
            });
            let motion = Motion { v, v_rate, psi: Steering(psi), psi_rate, psi_acceleration };
            let h = 4e-3;
            for i in 0..2 {
                let analytic = cascade.axle_twists(&motion)[i].1;
                let (low, high) = (at(-h)[i].0, at(h)[i].0);
                let dv = (high.v - low.v) / (2.0 * h);
                let dw = (high.omega - low.omega) / (2.0 * h);
                prop_assert!((dv - analytic.v).abs() < 2e-3, "{dv} {}", analytic.v);
                prop_assert!((dw - analytic.omega).abs() < 2e-2, "{dw} {}", analytic.omega);
            }
        }

        #[test]
        fn steering_rates_are_central_differences(
            kappa in -3.0f32..3.0, rate in -4.0f32..4.0, acceleration in -10.0f32..10.0,
        ) {
            let cascade = cascade(0.0, Form::Exact);
            let motion = cascade.steering_motion(kappa, rate, acceleration);
            let at = |t: f64| bisected(
                0.37f32 as f64,
                kappa as f64 + (rate as f64 + 0.5 * acceleration as f64 * t) * t,
            );
            let h = 1e-4;
            prop_assert!((((at(h) - at(-h)) / (2.0 * h)) - motion.rate as f64).abs() < 1e-5);
            let second = (at(h) - 2.0 * at(0.0) + at(-h)) / (h * h);
            prop_assert!((second - motion.acceleration as f64).abs() < 1e-3);
        }
    }

    #[test]
    fn printed_form_is_the_small_angle_limit_of_the_exact_one() {
        let (exact, printed) = (cascade(0.0, Form::Exact), cascade(0.0, Form::Printed));
        let gap = |psi: f32| {
            let motion = Motion {
                v: 0.2,
                psi: Steering(psi),
                psi_rate: 1.0,
                ..Motion::default()
            };
            let (a, b) = (exact.axle_twists(&motion), printed.axle_twists(&motion));
            // The term itself, so that its sign is compared too.
            assert!((a[0].0.v - a[1].0.v) * psi < 0.0);
            [0, 1].map(|i| (a[i].0.v - b[i].0.v).abs())
        };
        for psi in [-0.1, 0.1] {
            let (near, far) = (gap(0.5 * psi), gap(2.0 * psi));
            for i in 0..2 {
                // The term is 6 mm/s at 0.1 rad; the forms differ by its share ψ²/2 − ψ²/10.
                assert!(near[i] < 1e-5 && far[i] < 5e-4);
                assert!(far[i] > 30.0 * near[i], "a difference of third order");
            }
        }
    }

    #[test]
    fn straight_frame_moves_as_one_body() {
        let motion = Motion {
            v: 0.2,
            v_rate: 0.1,
            ..Motion::default()
        };
        for (twist, rate) in cascade(0.02, Form::Exact).axle_twists(&motion) {
            assert_eq!(twist, Twist::new(0.2, 0.0));
            assert_eq!(rate, Twist::new(0.1, 0.0));
        }
    }

    #[test]
    fn bounds_hold_and_nan_counts_as_straight() {
        let cascade = Config::default().build().unwrap();
        assert_eq!(cascade.steering(1e9).0, 0.5);
        assert_eq!(cascade.steering(f32::NEG_INFINITY).0, -0.5);
        assert_eq!(cascade.steering(f32::NAN).0, 0.0);
        assert_eq!(cascade.curvature(Steering(f32::NAN)), 0.0);
        assert_eq!(cascade.curvature(Steering(9.0)), cascade.max_curvature());
        // 2 · 0.5/(0.37 cos 0.5)
        assert!((cascade.max_curvature() - 3.079_712).abs() < 1e-5);
    }

    #[test]
    fn bad_geometry_is_named() {
        let bad = Config {
            frame_length_m: 0.0,
            ..Config::default()
        };
        assert_eq!(bad.build().unwrap_err().field, "frame_length_m");
        let bad = Config {
            max_steering_rad: f32::NAN,
            ..Config::default()
        };
        assert_eq!(bad.build().unwrap_err().field, "max_steering_rad");
    }
}
