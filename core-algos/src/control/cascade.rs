//! Cascade connection (paper eq. 5, 6): from the motion of the robot's midpoint O to a reference
//! for each axle.
//!
//! # Geometry
//!
//! The frame bends in a circular arc between the axles (pure bending). The axles are therefore turned by +ψ (front)
//! and −ψ (rear) from the line C2→C1, whose direction is the heading φ of O. With flexible length L and a rigid
//! section a at each end the axles are a chord `c(ψ) = L sin ψ/ψ + 2 a cos ψ` apart. Neither axle slips sideways,
//! which gives, with v the velocity of O along its heading,
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
//! ±[`Config::max_steering_rad`] are limited to this range, NaN counts as zero.

use super::arc::{Arc, Shape};
use crate::config::{ConfigError, declare};
use crate::math::trig::wrap_angle;
use crate::math::{Posture, Steering, Transform, Twist};
use core::f32::consts::PI;
use core::hint::cold_path;

/// Largest steering angle that can be configured, rad. Beyond, 1/cos ψ loses its digits.
pub const MAX_STEERING: f32 = 1.5;

declare! {
    /// Form of the axle velocities (paper eq. 6).
    pub enum Form, default Exact {
        /// `v_i = (v ± ½ ċ)/cos ψ` with the exact rate of the chord.
        Exact = "exact",
        /// `v_i = v/cos ψ ∓ L ψ ψ̇/6`, as the paper prints it.
        Printed = "printed",
    }
}

declare! {
    /// Geometry of the frame.
    pub struct Config {
        /// Form of the axle velocities.
        pub form: Form = Form::Exact;
        derived {
            /// Length of the flexible part of the frame (L).
            pub frame_length_m: f32 = 0.37, "m": Positive;
            /// Length of the rigid section between each end of the flexible part and the midpoint of its
            /// axle; the same at both ends.
            pub rigid_end_m: f32 = 0.0, "m": NonNegative;
            /// Largest commanded steering angle |ψ|.
            pub max_steering_rad: f32 = 0.5, "rad": Range(1e-3, MAX_STEERING);
        }
    }
}

impl Config {
    /// Builds the validated cascade; the error names the invalid field.
    pub fn build(&self) -> Result<Cascade, ConfigError> {
        self.check_ranges()?;
        let length = self.frame_length_m;
        let rigid_end = self.rigid_end_m;
        let mut cascade = Cascade {
            arc: Arc::new(length, rigid_end),
            max_steering: self.max_steering_rad,
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
    /// Rates of forward velocity and yaw rate (v̇_r): m/s², rad/s².
    pub acceleration: Twist,
}

/// Steering angle with its first two derivatives in time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SteeringMotion {
    /// Steering angle ψ, rad.
    pub psi: Steering,
    /// Steering rate ψ̇, rad/s.
    pub rate: f32,
    /// Steering acceleration ψ̈, rad/s².
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
    /// Limit of the steering angle, rad.
    pub fn max_steering(&self) -> f32 {
        self.max_steering
    }

    /// Path curvature at the limit of the steering angle, 1/m.
    pub fn max_curvature(&self) -> f32 {
        self.max_curvature
    }

    /// `psi` limited to the largest steering angle; NaN gives 0.
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

        // Rate of 1/cos ψ divided by 1/cos ψ, 1/s.
        let growth = shape.tan * psi_rate;
        let speed_rate = v_rate + v * growth;
        // Half the rate of the chord and its derivative, then both converted to the axles' headings.
        let [front, rear] = match self.form {
            Form::Exact => {
                let parting = shape.slope * psi_rate;
                let rate = shape.second * (psi_rate * psi_rate)
                    + shape.slope * psi_acceleration
                    + parting * growth;
                [(parting, rate), (-parting, -rate)]
                    .map(|(part, rate)| ((v + part) * shape.sec, (speed_rate + rate) * shape.sec))
            }
            Form::Printed => {
                cold_path();
                let sixth = -self.arc.length() / 6.0;
                let parting = sixth * psi.0 * psi_rate;
                let rate = sixth * (psi_rate * psi_rate + psi.0 * psi_acceleration);
                [(parting, rate), (-parting, -rate)]
                    .map(|(part, rate)| (v * shape.sec + part, speed_rate * shape.sec + rate))
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
mod tests;
