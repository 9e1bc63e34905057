//! Reference governor: smooths the command of the kinematic controller and keeps it within limits.
//!
//! # Theory
//!
//! The cascade needs v̇, ψ̇ and ψ̈ of its input; differentiating the output of the kinematic controller would
//! differentiate the noise of the estimate. The controller's command, the *input* `(v, ψ)`, therefore drives two small
//! filters whose states are the reference:
//!
//! - ψ follows a critically damped second-order filter, with poles placed exactly for the sampling interval. Its
//!   acceleration is limited to ψ̈_max and its rate to ψ̇_max. Both are also limited so that braking at ψ̈_max always
//!   stops ψ before ±ψ_max: |ψ| ≤ ψ_max holds for any input.
//! - v follows a first-order lag with |v̇| limited. Its target is scaled by `max(0, 1 − |ψ_input − ψ|/tolerance)`:
//!   speed waits for steering, which keeps the path. An input may allow a steering error without waiting. At a change
//!   of direction, v rests at zero for a short time.
//! - No wheel exceeds its speed limit. With steering ψ the fastest wheel (outer, either axle) runs at
//!   `|v| (1/cos ψ + d |κ|) + (d + ½ |c'|/cos ψ) |ψ̇|`; the last term is bounded by its value at ψ̇_max, so that the
//!   speed limit depends on ψ alone. If v could not brake as fast as a bending frame lowers that limit, ψ̇_max is
//!   reduced when the governor is built.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; [`Governor::step`] and [`Governor::stop`] cannot fail. An input that
//! is not finite counts as absent: the robot brakes as by [`Governor::stop`].

use super::cascade::{Cascade, Motion};
use crate::config::{Allowed, ConfigError, declare, require};
use crate::math::trig::{lag_gain, sqrt};
use crate::math::{Steering, bounded, greater, lesser};
use core::hint::cold_path;

/// Number of steering angles at which the speed limit is sampled when a governor is built.
const SAMPLES: usize = 64;
/// The lag of v ends in a linear ramp at this share of the largest acceleration, so that v reaches its target.
const FINAL_RAMP: f32 = 0.05;

declare! {
    /// Limits and time constants of the reference.
    pub struct Config {
        /// Largest |v̇|.
        pub max_acceleration_m_s2: f32 = 0.4, "m/s²": Range(0.01, 5.0);
        /// Deceleration of a stop; not less than the largest |v̇|.
        pub stop_deceleration_m_s2: f32 = 0.8, "m/s²": Range(0.01, 10.0);
        /// Largest |ψ̇|.
        pub max_steering_rate_rad_s: f32 = 1.0, "rad/s": Range(0.05, 10.0);
        /// Largest |ψ̈|.
        pub max_steering_acceleration_rad_s2: f32 = 8.0, "rad/s²": Range(0.1, 100.0);
        /// Rate of the first-order lag of v.
        pub speed_rate_per_s: f32 = 6.0, "1/s": Positive;
        /// Natural frequency of the critically damped filter of ψ.
        pub steering_frequency_rad_s: f32 = 8.0, "rad/s": Positive;
        /// Steering error above which the speed is zero.
        pub steering_tolerance_rad: f32 = 0.15, "rad": Positive;
        /// Time at zero speed when the direction changes.
        pub reversal_hold_s: f32 = 0.1, "s": NonNegative;
        /// Largest circumferential speed of any wheel.
        pub max_wheel_speed_m_s: f32 = 0.6, "m/s": Range(0.02, 5.0);
        derived {
            /// Largest |v| of the midpoint O.
            pub max_speed_m_s: f32 = 0.25, "m/s": Positive;
            /// Largest |ψ|; not more than that of the cascade.
            pub max_steering_rad: f32 = 0.5, "rad": Range(1e-3, 1.5);
            /// Half of the track of an axle (d).
            pub half_track_m: f32 = 0.162, "m": Positive;
        }
    }
}

impl Config {
    /// Builds the validated governor for a frame and the interval between two steps, s; the error names the invalid
    /// field.
    pub fn build(&self, cascade: &Cascade, interval_s: f32) -> Result<Governor, ConfigError> {
        self.check_ranges()?;
        Allowed::Range(1e-4, 0.1).check("interval_s", interval_s)?;
        require(
            self.stop_deceleration_m_s2 >= self.max_acceleration_m_s2,
            "stop_deceleration_m_s2",
            self.stop_deceleration_m_s2,
            Allowed::Condition("not less than max_acceleration_m_s2"),
        )?;
        Allowed::Range(1e-3, cascade.max_steering())
            .check("max_steering_rad", self.max_steering_rad)?;

        let mut governor = Governor {
            config: *self,
            cascade: *cascade,
            max_steering_rate: self.max_steering_rate_rad_s,
            wheel_speed_left: 0.0,
            unlimited_steering: 0.0,
            per_steering_tolerance: 1.0 / self.steering_tolerance_rad,
            twice_bending: 2.0 * self.max_steering_acceleration_rad_s2,
            longest_rest: 2.0 * self.reversal_hold_s + 1.0,
            free: 0.0,
            gains: Gains::new(self, interval_s),
        };
        // Largest wheel speed per steering rate, m/rad.
        let bending = self.half_track_m + governor.largest_parting();
        governor.wheel_speed_left =
            self.max_wheel_speed_m_s - bending * self.max_steering_rate_rad_s;
        require(
            governor.wheel_speed_left > 0.0,
            "max_wheel_speed_m_s",
            self.max_wheel_speed_m_s,
            Allowed::Condition(
                "more than max_steering_rate_rad_s * (half_track_m + axle speed per steering rate)",
            ),
        )?;
        let slope = governor.steepest_speed_limit();
        governor.max_steering_rate = self
            .max_steering_rate_rad_s
            .min(self.max_acceleration_m_s2 / slope.max(1e-9));
        governor.unlimited_steering = governor.last_unlimited_steering();
        let stopping = 0.5 * governor.max_steering_rate + governor.gains.bending;
        governor.free =
            governor.max_steering_rate * stopping / self.max_steering_acceleration_rad_s2;
        Ok(governor)
    }
}

/// Limits and gains of one step, for a fixed interval between steps.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Gains {
    /// Interval between two steps, s. The next two fields: half the interval, s, and the inverse of the interval, 1/s.
    dt: f32,
    half_dt: f32,
    per_dt: f32,
    /// Change of ψ̇ in a step per error of ψ, 1/s. `damping` is the change per error of ψ̇. Both poles of the filter
    /// are at `e^(−ω dt)` for an acceleration that is constant over the step: stable at any interval.
    stiffness: f32,
    damping: f32,
    /// Limit of the change of ψ̇ in a step, rad/s. `bending_square` is the square of the limit.
    bending: f32,
    bending_square: f32,
    /// Share of the error of v that its lag corrects in one step.
    speed_share: f32,
    /// Limit of the change of v in a step, m/s. The next two fields: change of v in a step of a stop, and of the final
    /// ramp, m/s.
    ramp: f32,
    stop_ramp: f32,
    final_ramp: f32,
}

impl Gains {
    fn new(config: &Config, dt: f32) -> Self {
        let steering = lag_gain(config.steering_frequency_rad_s * dt);
        let bending = config.max_steering_acceleration_rad_s2 * dt;
        let ramp = config.max_acceleration_m_s2 * dt;
        Self {
            dt,
            half_dt: 0.5 * dt,
            per_dt: 1.0 / dt,
            stiffness: steering * steering / dt,
            damping: 0.5 * steering * (4.0 - steering),
            bending,
            bending_square: bending * bending,
            speed_share: lag_gain(config.speed_rate_per_s * dt),
            ramp,
            stop_ramp: config.stop_deceleration_m_s2 * dt,
            final_ramp: FINAL_RAMP * ramp,
        }
    }
}

/// Commanded velocity and steering, before the governor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GovernorInput {
    /// Velocity of O, m/s.
    pub v: f32,
    /// Rate of `v` if known (on a trajectory), m/s², otherwise 0; removes the lag of the filter.
    pub v_rate: f32,
    /// Steering angle ψ, rad.
    pub psi: Steering,
    /// Rate of `psi` if known (from the path ahead), rad/s, otherwise 0; removes the lag of the filter.
    pub psi_rate: f32,
    /// Steering error that does not reduce the speed, rad, since feedback on a path corrects it; otherwise 0.
    pub steering_slack: f32,
}

impl GovernorInput {
    /// An input of velocity (m/s) and path curvature (1/m).
    #[inline(always)]
    pub fn from_curvature(cascade: &Cascade, v: f32, kappa: f32) -> Self {
        // A curvature that is not finite gives NaN, which the governor treats as an absent input.
        let psi = if kappa.abs() < cascade.max_curvature() || kappa.is_finite() {
            cascade.steering(kappa)
        } else {
            cold_path();
            Steering(f32::NAN)
        };
        Self {
            v,
            psi,
            ..Self::default()
        }
    }
}

/// State of the governor: reference motion, time at rest, and direction of the latest motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// The smooth reference.
    pub motion: Motion,
    /// Time since v became zero, s; 0 in motion. It stops counting at a limit that exceeds the reversal hold.
    pub rest_s: f32,
    /// Direction in which O last moved: 1, −1, or 0 before the first motion.
    pub direction: f32,
}

impl State {
    /// State at rest at the steering angle `psi`; NaN counts as straight.
    pub fn at_rest(psi: Steering) -> Self {
        Self {
            motion: Motion {
                psi: if psi.0.is_finite() {
                    psi
                } else {
                    Steering::STRAIGHT
                },
                ..Motion::default()
            },
            ..Self::default()
        }
    }
}

/// Reference governor with checked limits: turns commands into a reference within the limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Governor {
    config: Config,
    cascade: Cascade,
    /// ψ̇_max, reduced if v could not brake as fast as the bending frame lowers the speed limit.
    max_steering_rate: f32,
    /// Wheel speed left for driving while the frame bends at full rate, m/s.
    wheel_speed_left: f32,
    /// Largest |ψ|, rad, at which no wheel limits the speed of O.
    unlimited_steering: f32,
    /// Inverse of the steering tolerance, 1/rad.
    per_steering_tolerance: f32,
    /// Twice the largest |ψ̈|, rad/s².
    twice_bending: f32,
    /// Value at which [`State::rest_s`] stops counting, s.
    longest_rest: f32,
    /// Distance to the limit of ψ, rad, above which only the limit of the rate applies.
    free: f32,
    gains: Gains,
}

impl Governor {
    /// Largest |½ c'(ψ)|/cos ψ within the steering limit, m/rad: grows with ψ.
    fn largest_parting(&self) -> f32 {
        let motion = Motion {
            psi: Steering(self.config.max_steering_rad),
            psi_rate: 1.0,
            ..Motion::default()
        };
        let [(front, _), (rear, _)] = self.cascade.axle_twists(&motion);
        front.v.abs().max(rear.v.abs())
    }

    /// Largest |v| (m/s) at the steering angle `psi` within the limits of the wheels and of the robot.
    pub fn speed_limit(&self, Steering(psi): Steering) -> f32 {
        if psi.abs() < self.unlimited_steering {
            return self.config.max_speed_m_s;
        }
        let within = bounded(psi, self.config.max_steering_rad);
        let shape = self.cascade.bent(Steering(within));
        let outer = shape.sec + self.config.half_track_m * shape.kappa.abs();
        lesser(self.wheel_speed_left / outer, self.config.max_speed_m_s)
    }

    /// The largest |ψ| at which no wheel limits the speed: the limit falls as the frame bends.
    fn last_unlimited_steering(&self) -> f32 {
        let unlimited = |psi| self.speed_limit(Steering(psi)) >= self.config.max_speed_m_s;
        let (mut good, mut bad) = (0.0, self.config.max_steering_rad);
        if unlimited(bad) {
            return bad;
        }
        for _ in 0..24 {
            let middle = 0.5 * (good + bad);
            *(if unlimited(middle) {
                &mut good
            } else {
                &mut bad
            }) = middle;
        }
        good
    }

    /// Upper bound of |d speed_limit/dψ| within the steering limit, m/(s rad).
    fn steepest_speed_limit(&self) -> f32 {
        let step = self.config.max_steering_rad / SAMPLES as f32;
        let mut steepest = 0.0f32;
        let mut last = self.speed_limit(Steering::STRAIGHT);
        for i in 1..=SAMPLES {
            let next = self.speed_limit(Steering(step * i as f32));
            steepest = steepest.max((last - next) / step);
            last = next;
        }
        // The speed limit may be steepest between two samples.
        1.05 * steepest
    }

    /// One step towards `input`, after which the state's [`motion`](State::motion) is the reference.
    ///
    /// `v_rate` and `psi_acceleration` of the motion are those of the step just made.
    #[inline(always)]
    pub fn step(&self, state: &mut State, input: &GovernorInput) {
        // NaN or infinity makes the sum not finite; finite numbers do so only at the limit of `f32`.
        let sum = (input.v + input.psi.0) + (input.v_rate + input.psi_rate + input.steering_slack);
        if !(sum.abs() <= f32::MAX) {
            cold_path();
            return self.stop(state);
        }
        let gains = &self.gains;
        let before = state.motion;
        let target_psi = bounded(input.psi.0, self.config.max_steering_rad);
        let target_rate = match input.psi_rate {
            0.0 => 0.0,
            rate => bounded(rate, self.max_steering_rate),
        };
        // Critically damped filter towards a target that moves at `target_rate`.
        let wanted = gains.stiffness * (target_psi - before.psi.0)
            + gains.damping * (target_rate - before.psi_rate);
        self.steer(&mut state.motion, wanted);

        let steering_excess = (target_psi - state.motion.psi.0).abs() - input.steering_slack;
        let limit = self.speed_limit(state.motion.psi);
        let (mut target, mut rate) = (bounded(input.v, limit), input.v_rate);
        if steering_excess > 0.0 {
            let waiting = greater(1.0 - steering_excess * self.per_steering_tolerance, 0.0);
            (target, rate) = (target * waiting, rate * waiting);
        }
        let heading = if target != 0.0 { target } else { rate };
        if heading * state.direction < 0.0 {
            cold_path();
            // Change of direction: first brake to zero, then rest, then drive.
            if state.motion.v != 0.0 || state.rest_s < self.config.reversal_hold_s {
                (target, rate) = (0.0, 0.0);
            }
        }
        let gap = target - before.v;
        let mut approach = gap.abs() * gains.speed_share;
        if approach < gains.final_ramp {
            approach = lesser(gains.final_ramp, gap.abs());
        }
        let approach = if gap < 0.0 { -approach } else { approach };
        let mut change = bounded(approach + rate * gains.dt, gains.ramp);
        let after = before.v + change;
        if after * before.v < 0.0 || (before.v == 0.0 && after * heading < 0.0) {
            cold_path();
            change = -before.v;
        }
        self.drive(state, change, limit);
    }

    /// One step of an emergency stop: v ramps to zero at the stop deceleration, ψ̇ to zero at ψ̈_max, and ψ stays at
    /// the resulting angle.
    pub fn stop(&self, state: &mut State) {
        let Motion { v, psi_rate, .. } = state.motion;
        self.steer(&mut state.motion, -psi_rate);
        let change = lesser(self.gains.stop_ramp, v.abs());
        let limit = self.config.max_speed_m_s;
        self.drive(state, -change.copysign(v), limit);
    }

    /// Applies the change of ψ̇ nearest to `wanted` (rad/s) that keeps the limits of ψ̈, ψ̇ and ψ.
    ///
    /// Braking from rate w takes at most `D(w) = w²/(2A) + w T/2` in steps of T. The rate after the step is held
    /// where `ψ + (w + w')T/2 + D(w') ≤ ψ_max`. If the inequality holds before a step, full braking keeps it, so it
    /// always holds.
    fn steer(&self, motion: &mut Motion, wanted: f32) {
        let gains = &self.gains;
        let limit = self.config.max_steering_rad;
        let rate = motion.psi_rate;
        // The highest rate is at least zero, so that only the limit on the side of the wanted rate can apply.
        let demanded = rate + wanted;
        let ahead = motion.psi.0 + rate * gains.half_dt;
        let room = if demanded < 0.0 {
            limit + ahead
        } else {
            limit - ahead
        };
        let highest = if room >= self.free {
            self.max_steering_rate
        } else {
            cold_path();
            let braking = gains.bending_square + self.twice_bending * greater(room, 0.0);
            lesser(sqrt(braking) - gains.bending, self.max_steering_rate)
        };
        let mut next = bounded(demanded, highest);
        if !((next - rate).abs() <= gains.bending) {
            cold_path();
            next = rate + gains.bending.copysign(next - rate);
        }
        motion.psi.0 = bounded(motion.psi.0 + gains.half_dt * (rate + next), limit);
        motion.psi_acceleration = (next - rate) * gains.per_dt;
        motion.psi_rate = next;
    }

    /// Applies a change of speed and the speed limit.
    #[inline(always)]
    fn drive(&self, state: &mut State, change: f32, limit: f32) {
        let gains = &self.gains;
        let before = state.motion.v;
        let v = bounded(before + change, limit);
        state.motion.v = v;
        state.motion.v_rate = (v - before) * gains.per_dt;
        if v == 0.0 {
            cold_path();
            state.rest_s = lesser(state.rest_s + gains.dt, self.longest_rest);
        } else {
            state.rest_s = 0.0;
            state.direction = if v < 0.0 { -1.0 } else { 1.0 };
        }
    }
}

#[cfg(test)]
mod tests;
