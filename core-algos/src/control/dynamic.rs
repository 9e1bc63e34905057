//! Dynamic motion controller of one axle (paper eq. 7–10): from a reference to wheel torques.
//!
//! # The law
//!
//! With `S = [cos φ, 0; sin φ, 0; 0, 1]` and, for wheels (left, right),
//! `E = [cos φ, cos φ; sin φ, sin φ; −d, d]/r_w`,
//! `(SᵀE)⁻¹ = (r_w/2) [1, −1/d; 1, 1/d]` turns a force along the axle's heading and a moment about
//! its midpoint into the two torques. Then
//!
//! - eq. 10: `e = R(φ)(q_r − q)`, the reference as seen from the axle;
//! - eq. 9: `v_c = [v_r cos e_φ + k_X e_X; ω_r + k_Y v_r e_Y + k_φ u sin e_φ]`;
//! - eq. 7: `τ = −(SᵀE)⁻¹ K (v − v_c) ‖ξ‖²`, plus the feedforward described below;
//! - eq. 8: ξ collects norms.
//!
//! # Differences from the paper, with reasons
//!
//! - **Reverse.** The paper has `u = v_r`. For e_X = 0 the errors obey
//!   `ė_Y = v_r sin e_φ, ė_φ = −k_Y v_r e_Y − k_φ u sin e_φ`, characteristic polynomial
//!   `λ² + k_φ u λ + k_Y v_r²`: stable in reverse only if `u > 0`, hence `u = |v_r|`. The gain k_Y
//!   keeps the sign of v_r: with |v_r| there the last term would be `k_Y v_r |v_r|`, negative in
//!   reverse, a saddle. The Lyapunov function `(e_X² + e_Y²)/2 + (1 − cos e_φ)/k_Y` needs the same
//!   signs.
//! - **Standstill.** An axle that turns on the spot has v_r = 0, and with it no heading feedback.
//!   `u = max(|v_r|, heading_speed_floor)`; a floor of 0 is the paper's law.
//! - **ξ.** The second and fifth entries of (8) are printed alike. Taken here:
//!   `{‖v_c‖, ‖v‖, ‖v_r‖, ‖v̇_r‖, ‖v‖², 1, ‖F_K‖}`: ‖v_c‖ as printed (its rate would have to be differentiated from
//!   noise), ‖v‖² because centripetal terms and friction grow with the square of speed. Norms mix m/s with rad/s and
//!   N with N m, as the paper's do. ‖ξ‖² is capped, since ‖v̇_r‖² would drive chatter at the start of a motion.
//! - **Feedforward.** (7) is proportional in velocity, so the frame's bending moment leaves a yaw error, and a slope
//!   an error of speed. Three terms are therefore fed forward: the load of the frame, from the reference bend or from
//!   the beam's estimate; the inertia, `m v̇_r` and `J ω̇_r`; the force of the ground, from [`super::disturbance`].
//! - **Limits.** Both torques are scaled by one factor, so the direction of (force, moment) is
//!   kept.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; [`Dynamic::step`] cannot fail. If any input is not finite the
//! torques are zero and [`Command::valid`] is false.
//!
//! # Example
//!
//! ```
//! use core_algos::control::cascade::AxleReference;
//! use core_algos::control::dynamic::{Config, Input};
//! use core_algos::math::Posture;
//!
//! let config = Config::default();
//! let controller = config.build()?;
//! // At rest, 2 cm behind the reference and turned 0.1 rad too far to the right.
//! let posture = Posture::new(0.02, 0.0, 0.1);
//! let reference = AxleReference { posture, ..AxleReference::default() };
//! let command = controller.step(&Input { reference, ..Input::default() });
//!
//! let (left, right) = (command.torque_nm.left, command.torque_nm.right);
//! assert!(command.valid && left + right > 0.0 && right > left);
//! // Within the limits that is equation 7.
//! let force = config.velocity_gain_n_s_m * command.velocity.v * command.xi_squared;
//! let moment = config.yaw_rate_gain_nm_s_rad * command.velocity.omega * command.xi_squared;
//! let expected = 0.5 * config.wheel_radius_m * (force - moment / config.half_track_m);
//! assert!(command.scale == 1.0 && (left - expected).abs() < 1e-5);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

use crate::config::{ConfigError, declare};
use crate::control::cascade::AxleReference;
use crate::math::trig::{clamp, sin_cos};
use crate::math::{AxleLoad, Posture, Twist};
use crate::topology::Wheels;

declare! {
    /// Source of the load of the frame on the axle.
    pub enum FrameForce, default Reference {
        /// A disturbance: neither compensated nor a component of ξ.
        Off = "off",
        /// Pure bending at the reference steering angle.
        Reference = "reference",
        /// The wrench estimated from the strains of the frame; pure bending if the estimate is missing.
        Beam = "beam",
    }
}

::declare::declare! {
    /// Speed–torque line of the motors, at the wheel. A configuration file must give both numbers.
    #[derive(Clone, Copy, Debug, PartialEq)]
    #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
    #[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
    pub struct Motor {
        /// Torque at standstill and full voltage.
        pub stall_torque_nm: f32 = 2.5, "N m": Positive;
        /// Speed at full voltage and no torque.
        pub no_load_speed_rad_s: f32 = 20.0, "rad/s": Positive;
    }
}

declare! {
    /// Gains, geometry and limits of one axle.
    pub struct Config {
        /// Gain of the longitudinal error (k_X).
        pub longitudinal_gain_per_s: f32 = 2.0, "1/s": Range(0.0, 100.0);
        /// Gain of the lateral error (k_Y).
        pub lateral_gain_rad_m2: f32 = 20.0, "rad/m²": Range(0.0, 1e4);
        /// Gain of the heading error (k_φ).
        pub heading_gain_rad_m: f32 = 16.0, "rad/m": Range(0.0, 1e4);
        /// Least speed that multiplies the heading gain; 0 is the paper's law.
        pub heading_speed_floor_m_s: f32 = 0.05, "m/s": NonNegative;
        /// Gain of the velocity error (K_1).
        // With twice this gain, wheels with half a degree of gear backlash chatter and slide.
        pub velocity_gain_n_s_m: f32 = 200.0, "N s/m": Range(1.0, 1e4);
        /// Gain of the yaw rate error (K_2).
        pub yaw_rate_gain_nm_s_rad: f32 = 3.5, "N m s/rad": Range(0.01, 1e3);
        /// Largest ‖ξ‖².
        pub max_xi_squared: f32 = 2.0, "": Positive;
        /// True if ‖F_K‖ is a component of ξ; no effect if the frame force is off.
        pub frame_force_in_xi: bool = true;
        /// Source of the load of the frame.
        pub frame_force: FrameForce = FrameForce::Reference;
        /// Share of the frame's load that is fed forward.
        pub frame_feedforward: f32 = 1.0, "": Range(-2.0, 2.0);
        /// Share of the inertia that is fed forward.
        pub inertia_feedforward: f32 = 1.0, "": Range(-2.0, 2.0);
        /// Mass of the axle without the rotational inertia of its wheels (m).
        pub mass_kg: f32 = 4.76, "kg": Range(0.0, 1e3);
        /// Yaw inertia about the midpoint, without the rotational inertia of the wheels (J).
        pub yaw_inertia_kg_m2: f32 = 0.0186, "kg m²": Range(0.0, 100.0);
        /// Inertia of one wheel with its motor about its axis (J_w).
        pub wheel_inertia_kg_m2: f32 = 0.004, "kg m²": Range(0.0, 10.0);
        /// Largest torque of each wheel.
        pub max_torque_nm: f32 = 2.0, "N m": Range(0.01, 50.0);
        /// Speed–torque line of the motors; without it the torque limit holds at any speed.
        pub motor: Option<Motor> = None;
        derived {
            /// Half of the track (d).
            pub half_track_m: f32 = 0.162, "m": Positive;
            /// Radius of the wheels (r_w).
            pub wheel_radius_m: f32 = 0.073, "m": Positive;
        }
    }
}

impl Config {
    /// Builds the validated controller; the error names the invalid field.
    pub fn build(&self) -> Result<Dynamic, ConfigError> {
        self.check_ranges()?;
        let half_track = self.half_track_m;
        let radius = self.wheel_radius_m;
        if let Some(motor) = self.motor {
            motor.check_ranges()?;
        }
        // Factors of (SᵀE)⁻¹: wheel torque per force along the heading, m, and per moment.
        let (per_force, per_moment) = (0.5 * radius, 0.5 * radius / half_track);
        // Both wheels roll with the axle: their rotational inertia adds to the mass and the yaw inertia.
        let rolling = 2.0 * self.wheel_inertia_kg_m2 / (radius * radius);
        Ok(Dynamic {
            config: *self,
            mass: per_force * self.inertia_feedforward * (self.mass_kg + rolling),
            yaw_inertia: per_moment
                * self.inertia_feedforward
                * (self.yaw_inertia_kg_m2 + rolling * half_track * half_track),
            velocity_gain: per_force * self.velocity_gain_n_s_m,
            yaw_rate_gain: per_moment * self.yaw_rate_gain_nm_s_rad,
            force_share: per_force * self.frame_feedforward,
            moment_share: per_moment * self.frame_feedforward,
            per_force,
            frame_in_xi: if self.frame_force_in_xi { 1.0 } else { 0.0 },
            torque_line: self.motor.map(|motor| {
                let per_speed = motor.stall_torque_nm / (motor.no_load_speed_rad_s * radius);
                [motor.stall_torque_nm, per_speed]
            }),
        })
    }
}

/// Input of the controller of one axle at a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Input {
    /// Estimated posture of the axle (q).
    pub posture: Posture,
    /// Estimated velocity and yaw rate (v).
    pub twist: Twist,
    /// The reference (q_r, v_r, v̇_r).
    pub reference: AxleReference,
    /// Load of the frame in the reference bend, on this axle; see [`crate::math::Wrench`].
    pub reference_load: AxleLoad,
    /// Load of the frame estimated from its strains; `None` without a valid estimate.
    pub beam_load: Option<AxleLoad>,
    /// Force of the ground along the heading that [`super::disturbance`] estimates, N.
    pub ground_force_n: f32,
}

/// Wheel torques, with intermediate results.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Wheel torques, N m; a positive torque drives forward.
    pub torque_nm: Wheels<f32>,
    /// Factor by which both torques were reduced: 1 within the limits.
    pub scale: f32,
    /// False if an input was not finite; the torques are then zero.
    pub valid: bool,
    /// Posture error `(e_X, e_Y, e_φ)` in the axle's coordinates (eq. 10): m, m, rad.
    pub error: Posture,
    /// Velocity command v_c (eq. 9).
    pub velocity: Twist,
    /// ‖ξ‖² after its cap.
    pub xi_squared: f32,
}

/// The dynamic controller of one axle. It has no state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dynamic {
    config: Config,
    /// Mean wheel torque per acceleration. The next two fields: per velocity error, per frame force.
    mass: f32,
    velocity_gain: f32,
    force_share: f32,
    /// Half the difference of the torques per yaw acceleration. The next two fields: per yaw rate error, per frame
    /// moment.
    yaw_inertia: f32,
    yaw_rate_gain: f32,
    moment_share: f32,
    /// Mean wheel torque per force of the ground, m.
    per_force: f32,
    /// 1 if ‖F_K‖ is a component of ξ, otherwise 0.
    frame_in_xi: f32,
    /// Stall torque (N m), and decrease of torque with the speed of the wheel over ground (N m s/m); `None` if the
    /// torque limit holds at any speed.
    torque_line: Option<[f32; 2]>,
}

fn norm_squared(twist: Twist) -> f32 {
    twist.v * twist.v + twist.omega * twist.omega
}

impl Dynamic {
    /// Velocity command v_c (eq. 9) for a posture error (eq. 10), heading within half a turn.
    pub fn velocity_command(&self, error: Posture, reference: Twist) -> Twist {
        let config = &self.config;
        let (sin, cos) = sin_cos(error.phi);
        let speed = reference.v.abs();
        let speed = if speed < config.heading_speed_floor_m_s {
            config.heading_speed_floor_m_s
        } else {
            speed
        };
        Twist {
            v: reference.v * cos + config.longitudinal_gain_per_s * error.x,
            omega: reference.omega
                + config.lateral_gain_rad_m2 * reference.v * error.y
                + config.heading_gain_rad_m * speed * sin,
        }
    }

    /// ‖ξ‖² (eq. 8), capped.
    fn xi_squared(&self, command: Twist, input: &Input, load: &AxleLoad) -> f32 {
        let speed = norm_squared(input.twist);
        let frame =
            load.forward * load.forward + load.lateral * load.lateral + load.moment * load.moment;
        let sum = norm_squared(command)
            + speed
            + norm_squared(input.reference.twist)
            + norm_squared(input.reference.acceleration)
            + speed * speed
            + 1.0
            + self.frame_in_xi * frame;
        let most = self.config.max_xi_squared;
        if sum <= most { sum } else { most }
    }

    /// Largest torque of a wheel in the direction of `torque` at `speed` (m/s over ground), N m.
    fn available(&self, torque: f32, speed: f32) -> f32 {
        let limit = self.config.max_torque_nm;
        let Some([stall, per_speed]) = self.torque_line else {
            return limit;
        };
        let forward_speed = if torque < 0.0 { -speed } else { speed };
        let line = stall - per_speed * forward_speed;
        if line >= limit {
            limit
        } else if line > 0.0 {
            line
        } else {
            0.0
        }
    }

    /// One step: torques for the reference (eq. 7).
    pub fn step(&self, input: &Input) -> Command {
        let reference = &input.reference;
        let error = reference.posture.relative_to(input.posture);
        let velocity = self.velocity_command(error, reference.twist);
        let load = match self.config.frame_force {
            FrameForce::Off => AxleLoad::default(),
            FrameForce::Reference => input.reference_load,
            FrameForce::Beam => match input.beam_load {
                Some(load) if load.is_finite() => load,
                _ => input.reference_load,
            },
        };
        let xi_squared = self.xi_squared(velocity, input, &load);

        // The gains include (SᵀE)⁻¹, so `ahead` is the mean of the torques, and `across` half their difference.
        let ahead = self.mass * reference.acceleration.v
            - self.velocity_gain * (input.twist.v - velocity.v) * xi_squared
            - self.force_share * load.forward
            - self.per_force * input.ground_force_n;
        let across = self.yaw_inertia * reference.acceleration.omega
            - self.yaw_rate_gain * (input.twist.omega - velocity.omega) * xi_squared
            - self.moment_share * load.moment;
        let (left, right) = (ahead - across, ahead + across);

        let turning = self.config.half_track_m * input.twist.omega;
        let limits = [
            self.available(left, input.twist.v - turning),
            self.available(right, input.twist.v + turning),
        ];
        let sizes = [left.abs(), right.abs()];
        let (mut torque_nm, mut scale) = (Wheels { left, right }, 1.0f32);
        if !(sizes[0] <= limits[0] && sizes[1] <= limits[1]) {
            // Every input enters a torque through sums and products only, and ‖ξ‖² is positive: NaN or infinity in an
            // input always reaches a torque.
            if !(sizes[0] <= f32::MAX && sizes[1] <= f32::MAX) {
                return Command::default();
            }
            for (limit, size) in limits.into_iter().zip(sizes) {
                if size > limit && limit < scale * size {
                    scale = limit / size;
                }
            }
            // The clamp removes an excess due to rounding.
            let limit = self.config.max_torque_nm;
            torque_nm = torque_nm.map(|torque| clamp(scale * torque, -limit, limit));
        }
        Command {
            torque_nm,
            scale,
            valid: true,
            error,
            velocity,
            xi_squared,
        }
    }
}

#[cfg(test)]
mod tests;
