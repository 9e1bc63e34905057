//! Current loop of a brushed motor: proportional-integral, with back-EMF fed forward.
//!
//! # Theory
//!
//! Sampled at its own period T the winding is `i⁺ = a i + b (u − e)`, `a = exp(−R T/L)`,
//! `b = (1 − a)/R`, `e = k_e ω`. The controller `K (z − a)/(z − 1)` cancels the winding's pole, and
//! `K = (1 − exp(−ω_b T))/b` puts the closed loop's pole at `exp(−ω_b T)`: a step of the reference is
//! followed as `1 − exp(−ω_b t)`. If the voltage takes effect one period later, as on a board, the response has no
//! overshoot as long as `1 − exp(−ω_b T) ≤ 1/4`; `build` requires this.
//!
//! When the voltage is limited, the difference is subtracted from the integral (back-calculation with the same time
//! constant). The integral then follows the real voltage drop of the winding, so there is no windup and no jump when
//! the limit is left.
//!
//! All quantities refer to the wheel: a gear ratio r gives `k_t = r · k_t,motor`. Positive torque, current and voltage
//! drive forward.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; [`CurrentLoop::step`] cannot fail. If an input is not finite or the supply is not above
//! zero, the duty is 0 and [`Output::valid`] is false.

use crate::config::{Allowed, ConfigError, declare, require};
use crate::math::compare::{all_finite, lesser};
use crate::math::trig::{clamp, lag_gain};

declare! {
    /// Motor and loop.
    ///
    /// Default: A 12 V gear motor of 2.5 N m at standstill and 20 rad/s without load.
    pub struct Config {
        /// Resistance of winding, leads and bridge (R).
        pub resistance_ohm: f32 = 2.88, "Ω": Range(1e-3, 1e3);
        /// Inductance of the winding (L).
        pub inductance_h: f32 = 2.3e-3, "H": Range(1e-6, 1.0);
        /// Torque per current at the wheel, gear included (k_t = k_e).
        pub torque_constant_nm_a: f32 = 0.6, "N m/A": Range(1e-4, 1e3);
        /// Bandwidth of the loop (ω_b).
        pub bandwidth_rad_s: f32 = 5000.0, "rad/s": Positive;
        /// Time between steps (T).
        pub period_s: f32 = 50e-6, "s": Range(1e-6, 1e-2);
        /// Largest current.
        pub max_current_a: f32 = 4.0, "A": Range(1e-3, 1e3);
        /// Largest share of the supply voltage applied to the motor.
        pub max_duty: f32 = 0.98, "": Range(0.05, 1.0);
    }
}

impl Config {
    /// Builds the current loop; the error names the invalid field.
    pub fn build(&self) -> Result<CurrentLoop, ConfigError> {
        self.check_ranges()?;
        let resistance = self.resistance_ohm;
        let inductance = self.inductance_h;
        let period = self.period_s;
        let bandwidth = self.bandwidth_rad_s;
        let share = lag_gain(bandwidth * period);
        require(
            share <= 0.25,
            "bandwidth_rad_s",
            bandwidth,
            Allowed::Condition("at most 0.287 divided by period_s"),
        )?;
        let decay = lag_gain(resistance * period / inductance);
        Ok(CurrentLoop {
            gain: share * resistance / decay,
            integral_share: decay,
            torque_constant: self.torque_constant_nm_a,
            max_current: self.max_current_a,
            max_duty: self.max_duty,
        })
    }
}

/// Input of the loop at a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Input {
    /// Commanded wheel torque, N m.
    pub torque_nm: f32,
    /// Measured current, A.
    pub current_a: f32,
    /// Speed of the wheel, rad/s.
    pub speed_rad_s: f32,
    /// Measured supply voltage, V.
    pub supply_v: f32,
    /// Current limit at this step, A, from [`super::winding`].
    pub limit_a: f32,
}

/// Output of the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// Share of the supply voltage to apply to the motor, −1 to 1.
    pub duty: f32,
    /// Reference current after the limit, A.
    pub reference_a: f32,
    /// True if current or voltage is limited.
    pub limited: bool,
    /// True if all inputs were usable; if not, the motor must be switched off.
    pub valid: bool,
}

/// State of a current loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    integral_v: f32,
}

/// The current loop of one motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurrentLoop {
    gain: f32,
    /// Ratio of integral gain to proportional gain, for one period.
    integral_share: f32,
    torque_constant: f32,
    max_current: f32,
    max_duty: f32,
}

impl CurrentLoop {
    /// Torque of a current, N m.
    pub fn torque(&self, current_a: f32) -> f32 {
        self.torque_constant * current_a
    }

    /// Runs one period, about 40 operations.
    pub fn step(&self, state: &mut State, input: &Input) -> Output {
        let (torque, current, speed) = (input.torque_nm, input.current_a, input.speed_rad_s);
        let off = !(all_finite([torque, current, speed, input.supply_v])
            // A supply below the smallest normal number would round the quotient `duty` beyond its bound.
            && input.supply_v >= f32::MIN_POSITIVE
            && input.limit_a >= 0.0);
        if off {
            *state = State::default();
            return Output::default();
        }
        let limit = lesser(input.limit_a, self.max_current);
        let wanted = input.torque_nm / self.torque_constant;
        let reference = clamp(wanted, -limit, limit);
        let error = reference - input.current_a;
        let emf = self.torque_constant * input.speed_rad_s;
        let voltage = self.gain * error + state.integral_v + emf;
        let most = self.max_duty * input.supply_v;
        let applied = clamp(voltage, -most, most);
        let lacking = applied - voltage;
        state.integral_v += self.integral_share * (self.gain * error + lacking);
        if !state.integral_v.is_finite() {
            *state = State::default();
            return Output::default();
        }
        Output {
            duty: applied / input.supply_v,
            reference_a: reference,
            limited: applied != voltage || reference != wanted,
            valid: true,
        }
    }
}

#[cfg(test)]
mod tests;
