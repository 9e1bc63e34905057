//! Disturbance observer of one axle: force and moment of the ground that no model predicts.
//!
//! A slope, rolling resistance and the cogging of the motors load an axle. The law of [`super::dynamic`] is
//! proportional in velocity: a force of 2.5 N holds the axle back by 12 mm/s, or makes it creep by as much at rest.
//! The observer estimates the load `(F, M)`, and the law feeds its opposite forward.
//!
//! # Theory
//!
//! With the velocity error `e = v_c − v` (paper eq. 7), rate ω_i, gain K₁ of the law, and the speed `s` of the faster
//! wheel of the reference,
//!
//! `Ḟ = −ω_i K₁ (e + c s F)`, and for the moment `Ṁ = −ω_i K₂ (e_ω + c s M/d²)`.
//!
//! - **Integral action.** For c = 0, −F is the integral of `ω_i K₁ e`: at a constant load e decays to zero. An error
//!   of the axle's velocity fades with the rate ω_i; below K₁/m (30 1/s) by a factor of 3 or more the loop is damped.
//! - **Axles push against each other** through the strip. If the wheel radii are off by a share δ, the axles cannot
//!   both drive at their reference, and for c = 0 the force of the strip would grow until the tyres slip. With c the
//!   axle yields to a load in proportion to its speed, as a tyre does: at a constant load `e = −c s F`, so the force
//!   of the strip ends at δ/c. The robot drives slower by the share c F, at any speed: a slope never stops the robot
//!   on its last millimetres.
//! - **Rest.** For s = 0 the axle does not yield, and e is taken without the posture error: −F is then the stiffness
//!   `ω_i K₁` times the displacement of the wheels since they stopped, and the axle holds its place. With the posture
//!   error, an error of the estimated bend would press the axles against each other without end.
//! - **Windup.** F and M are bounded. Neither grows while the torques are limited. A step without a valid command
//!   sets both to zero, as does the node while the motors are off.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; [`Observer::step`] cannot fail. A command that is not valid sets the estimate to zero,
//! so no number that is not finite enters it.

use super::dynamic::{self, Command, Input};
use crate::config::{ConfigError, declare};
use crate::math::{AxleLoad, Twist, bounded};
use crate::time::TICK_S;

declare! {
    /// Parameters of the disturbance observer.
    pub struct Config {
        /// Rate at which the estimated force follows a disturbance (ω_i); 0 switches the observer off.
        pub force_rate_per_s: f32 = 6.0, "1/s": Range(0.0, 50.0);
        /// Rate at which the estimated moment follows a disturbance.
        pub moment_rate_per_s: f32 = 6.0, "1/s": Range(0.0, 50.0);
        /// Share of its speed by which an axle yields per force (c).
        pub yield_per_n: f32 = 0.01, "1/N": Range(0.0, 1.0);
        /// Largest estimated force.
        pub max_force_n: f32 = 10.0, "N": NonNegative;
        /// Largest estimated moment.
        pub max_moment_nm: f32 = 1.0, "N m": NonNegative;
    }
}

impl Config {
    /// Builds the observer beside a controller; the error names the field that is wrong.
    pub fn build(&self, controller: &dynamic::Config) -> Result<Observer, ConfigError> {
        self.check_ranges()?;
        let half_track = controller.half_track_m;
        Ok(Observer {
            force_gain: TICK_S * self.force_rate_per_s * controller.velocity_gain_n_s_m,
            moment_gain: TICK_S * self.moment_rate_per_s * controller.yaw_rate_gain_nm_s_rad,
            yields: Twist::new(
                self.yield_per_n,
                self.yield_per_n / (half_track * half_track),
            ),
            half_track,
            max_force: self.max_force_n,
            max_moment: self.max_moment_nm,
        })
    }
}

/// Disturbance observer with checked parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observer {
    /// Change of the force in a step per velocity error, N s/m; of the moment per error of the yaw rate, N m s/rad.
    force_gain: f32,
    moment_gain: f32,
    /// Share of the wheels' speed by which the axle yields: velocity per force, 1/N, yaw rate per moment, 1/(N m²).
    yields: Twist,
    half_track: f32,
    max_force: f32,
    max_moment: f32,
}

impl Observer {
    /// Advances the estimated load of the ground by a tick, in which the controller computed `command` from `input`.
    pub fn step(&self, load: AxleLoad, input: &Input, command: &Command) -> AxleLoad {
        if !command.valid {
            return AxleLoad::default();
        }
        let reference = input.reference.twist;
        let speed = reference.v.abs() + self.half_track * reference.omega.abs();
        let demanded = if speed > 0.0 {
            command.velocity
        } else {
            Twist::REST
        };
        let ahead = demanded.v - input.twist.v + self.yields.v * speed * load.forward;
        let turn = demanded.omega - input.twist.omega + self.yields.omega * speed * load.moment;
        let limited = command.scale < 1.0;
        AxleLoad {
            forward: grown(
                load.forward,
                -self.force_gain * ahead,
                limited,
                self.max_force,
            ),
            lateral: 0.0,
            moment: grown(
                load.moment,
                -self.moment_gain * turn,
                limited,
                self.max_moment,
            ),
        }
    }
}

/// `load` after a change, within ±`most`; if the torques are limited, not larger than before.
fn grown(load: f32, change: f32, limited: bool, most: f32) -> f32 {
    let bound = if limited { load.abs() } else { most };
    bounded(load + change, bound)
}
