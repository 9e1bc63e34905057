//! Disturbance observer of one axle: force of the ground along the heading that no model predicts.
//!
//! A slope, rolling resistance and the cogging of the motors load an axle. The law of [`super::dynamic`] is
//! proportional in velocity: a force of 2.5 N holds the axle back by 12 mm/s, and an axle at rest creeps by as much.
//! The observer estimates the force F, and the law feeds its opposite forward.
//!
//! # Theory
//!
//! With the velocity error `e = v_r − v`, the rate ω_i, the gain K₁ of the law, and s, the speed of the faster wheel in
//! the reference,
//!
//! `Ḟ = −ω_i K₁ (e + c s F)`.
//!
//! - **Rest.** For s = 0, −F is the stiffness ω_i K₁ times the displacement of the wheels since they stopped: the axle
//!   holds its place. A slope changes F before the stop, so it causes no displacement; a force that ends with the
//!   motion, such as rolling resistance, moves the axle by its magnitude over the stiffness.
//! - **Motion.** At a constant load the axle yields as a tyre does, in proportion to its speed: `e = −c s F`. It
//!   reaches its reference however slow the reference is, so no load stops the robot short of its goal.
//! - **Axles push against each other** through the frame. If their wheel radii differ by a share δ, both cannot drive
//!   at their reference. For c = 0 the force in the frame would grow until the tyres slip; it ends at δ/c.
//! - **Posture error.** e has no part of the posture error (eq. 9), unlike the velocity error of eq. 7. The posture
//!   errors of two axles, seen from the robot's midpoint, are opposite: their integral would press the axles against
//!   each other. It raised the frame force by 40 % with the joint filter and doubled it with intersection.
//! - **Damping.** The law alone corrects an error of the velocity at the rate K₁/m, about 30 1/s. ω_i is a third of
//!   that.
//! - **Windup.** F is bounded and does not grow while the torques are limited. A command that is not valid sets F to
//!   zero; so does the node while the motors are off or the reference is far away.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; [`Observer::step`] cannot fail. F is always finite: NaN or infinity in the input makes
//! the command invalid.

use super::dynamic::{self, Command, Input};
use crate::config::{ConfigError, declare};
use crate::math::{bounded, lesser};
use crate::time::TICK_S;

declare! {
    /// Parameters of the disturbance observer.
    pub struct Config {
        /// Rate at which the estimated force follows a disturbance (ω_i); 0 switches the observer off.
        pub rate_per_s: f32 = 10.0, "1/s": Range(0.0, 50.0);
        /// Share of its speed by which an axle yields per force (c).
        pub yield_per_n: f32 = 0.15, "1/N": Range(0.0, 10.0);
        /// Largest estimated force; the default is that of an axle on a slope of 10°.
        pub max_force_n: f32 = 10.0, "N": NonNegative;
    }
}

impl Config {
    /// Builds the observer for an axle's controller; the error names the field that is wrong.
    pub fn build(&self, controller: &dynamic::Config) -> Result<Observer, ConfigError> {
        self.check_ranges()?;
        Ok(Observer {
            gain: TICK_S * self.rate_per_s * controller.velocity_gain_n_s_m,
            half_track: controller.half_track_m,
            yield_per_n: self.yield_per_n,
            max_force: self.max_force_n,
        })
    }
}

/// Disturbance observer with checked parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observer {
    /// Change of the force in a tick per velocity error, N s/m.
    gain: f32,
    half_track: f32,
    yield_per_n: f32,
    max_force: f32,
}

impl Observer {
    /// Force of the ground (N, forward positive) after a tick in which the controller computed `command` from `input`,
    /// which holds the force before the tick.
    pub fn step(&self, input: &Input, command: &Command) -> f32 {
        if !command.valid {
            return 0.0;
        }
        let before = input.ground_force_n;
        let reference = input.reference.twist;
        let speed = reference.v.abs() + self.half_track * reference.omega.abs();
        let error = reference.v - input.twist.v + self.yield_per_n * speed * before;
        let bound = if command.scale < 1.0 {
            lesser(before.abs(), self.max_force)
        } else {
            self.max_force
        };
        bounded(before - self.gain * error, bound)
    }
}

#[cfg(test)]
mod tests;
