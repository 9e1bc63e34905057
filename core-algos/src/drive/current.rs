//! Current loop of a brushed motor: proportional-integral, with back-EMF fed forward.
//!
//! # Theory
//!
//! Sampled at its own period T the winding is `i⁺ = a i + b (u − e)`, `a = exp(−R T/L)`,
//! `b = (1 − a)/R`, `e = k_e ω`. The controller `K (z − a)/(z − 1)` cancels the winding's pole, and
//! `K = (1 − exp(−ω_b T))/b` puts the closed loop's at `exp(−ω_b T)`: a step of the reference is
//! followed as `1 − exp(−ω_b t)`. A voltage that takes effect a period later, as on a board, keeps
//! the response free of overshoot as long as `1 − exp(−ω_b T) ≤ 1/4`; `build` asks for that.
//! When the voltage is limited, what it lacks is taken off the integral (back-calculation with the
//! same time constant), which then follows the voltage the winding really drops: nothing winds up,
//! and nothing kicks when the limit is left.
//!
//! All quantities are those of the wheel: gear ratio r makes `k_t = r · k_t,motor`, and the speed is
//! that of the wheel. Positive torque, current and voltage drive forward.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; [`CurrentLoop::step`] cannot fail. An input that is not finite, or a
//! supply not above zero, gives zero volts and says so.

use crate::config::{Allowed, ConfigError, in_range, positive, require};
use crate::math::compare::{all_finite, lesser};
use crate::math::trig::{clamp, exp};

/// Motor and loop.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(deny_unknown_fields, default)
)]
pub struct Config {
    /// Resistance of winding, leads and bridge (R), Ω.
    pub resistance_ohm: f32,
    /// Inductance of the winding (L), H.
    pub inductance_h: f32,
    /// Torque per current at the wheel, gear included (k_t = k_e), N m/A.
    pub torque_constant_nm_a: f32,
    /// Bandwidth of the loop (ω_b), rad/s.
    pub bandwidth_rad_s: f32,
    /// Time between steps (T), s.
    pub period_s: f32,
    /// Largest current, A.
    pub max_current_a: f32,
    /// Largest share of the supply put on the motor.
    pub max_duty: f32,
}

impl Default for Config {
    /// A 12 V gear motor of 2.5 N m at standstill and 20 rad/s without load.
    fn default() -> Self {
        Self {
            resistance_ohm: 2.88,
            inductance_h: 2.3e-3,
            torque_constant_nm_a: 0.6,
            bandwidth_rad_s: 5000.0,
            period_s: 50e-6,
            max_current_a: 4.0,
            max_duty: 0.98,
        }
    }
}

impl Config {
    /// The ready-to-run form; the error names the field that is wrong.
    pub fn build(&self) -> Result<CurrentLoop, ConfigError> {
        let resistance = in_range("resistance_ohm", self.resistance_ohm, 1e-3, 1e3)?;
        let inductance = in_range("inductance_h", self.inductance_h, 1e-6, 1.0)?;
        let period = in_range("period_s", self.period_s, 1e-6, 1e-2)?;
        let bandwidth = positive("bandwidth_rad_s", self.bandwidth_rad_s)?;
        let share = 1.0 - exp(-bandwidth * period);
        require(
            share <= 0.25,
            "bandwidth_rad_s",
            bandwidth,
            Allowed::Condition("at most 0.287 divided by period_s"),
        )?;
        let pole = exp(-resistance * period / inductance);
        let gain = share * resistance / (1.0 - pole);
        Ok(CurrentLoop {
            gain,
            integral_share: 1.0 - pole,
            torque_constant: in_range(
                "torque_constant_nm_a",
                self.torque_constant_nm_a,
                1e-4,
                1e3,
            )?,
            max_current: in_range("max_current_a", self.max_current_a, 1e-3, 1e3)?,
            max_duty: in_range("max_duty", self.max_duty, 0.05, 1.0)?,
        })
    }
}

/// What the loop is told at a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Input {
    /// Wheel torque asked for, N m.
    pub torque_nm: f32,
    /// Measured current, A.
    pub current_a: f32,
    /// Speed of the wheel, rad/s.
    pub speed_rad_s: f32,
    /// Measured supply, V.
    pub supply_v: f32,
    /// Largest current at present, A, from [`super::winding`].
    pub limit_a: f32,
}

/// What the loop decides.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// Share of the supply to put on the motor, −1 to 1.
    pub duty: f32,
    /// Current asked for, A, limits applied.
    pub reference_a: f32,
    /// Whether a limit of current or voltage holds.
    pub limited: bool,
    /// Whether all inputs were usable; if not, the motor must be switched off.
    pub valid: bool,
}

/// All that changes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    integral_v: f32,
}

/// The current loop of one motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurrentLoop {
    gain: f32,
    /// Integral over proportional gain, for one period.
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

    /// One period. Cost about 40 operations.
    #[inline(always)]
    pub fn step(&self, state: &mut State, input: &Input) -> Output {
        let (torque, current, speed) = (input.torque_nm, input.current_a, input.speed_rad_s);
        let off = !(all_finite([torque, current, speed, input.supply_v])
            // Below it the duty, a quotient, would round beyond its bound.
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
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The winding in double precision, exact for a voltage held over a period.
    struct Motor {
        current: f64,
        speed: f64,
    }

    impl Motor {
        fn step(&mut self, config: &Config, voltage: f64) {
            let (r, l) = (
                f64::from(config.resistance_ohm),
                f64::from(config.inductance_h),
            );
            let settled = (voltage - f64::from(config.torque_constant_nm_a) * self.speed) / r;
            let left = (-r * f64::from(config.period_s) / l).exp();
            self.current = settled + (self.current - settled) * left;
        }
    }

    const SUPPLY: f64 = 12.0;

    /// Runs the loop; `delay` periods pass until a voltage takes effect.
    fn run(
        config: &Config,
        motor: &mut Motor,
        steps: usize,
        delay: usize,
        mut torque: impl FnMut(usize) -> f32,
    ) -> Vec<f64> {
        let current_loop = config.build().unwrap();
        let mut state = State::default();
        let mut pending = std::collections::VecDeque::from(vec![0.0; delay]);
        (0..steps)
            .map(|k| {
                let output = current_loop.step(
                    &mut state,
                    &Input {
                        torque_nm: torque(k),
                        current_a: motor.current as f32,
                        speed_rad_s: motor.speed as f32,
                        supply_v: SUPPLY as f32,
                        limit_a: 10.0,
                    },
                );
                assert!(output.valid && output.duty.abs() <= config.max_duty * 1.000_001);
                pending.push_back(f64::from(output.duty) * SUPPLY);
                let voltage = pending.pop_front().unwrap();
                motor.step(config, voltage);
                motor.current
            })
            .collect()
    }

    #[test]
    fn a_step_is_followed_as_the_exponential_of_the_bandwidth() {
        let config = Config::default();
        for speed in [0.0, 8.0, -8.0] {
            let mut motor = Motor {
                current: 0.0,
                speed,
            };
            let response = run(&config, &mut motor, 200, 0, |_| 0.3);
            let bandwidth = f64::from(config.bandwidth_rad_s) * f64::from(config.period_s);
            for (k, current) in response.iter().enumerate() {
                let expected = 0.5 * (1.0 - (-bandwidth * (k + 1) as f64).exp());
                assert!(
                    (current - expected).abs() < 1e-4,
                    "{k}: {current} {expected}"
                );
            }
        }
    }

    #[test]
    fn a_voltage_one_period_late_does_not_overshoot() {
        let mut config = Config::default();
        config.bandwidth_rad_s = 5700.0;
        let mut motor = Motor {
            current: 0.0,
            speed: 0.0,
        };
        let response = run(&config, &mut motor, 400, 1, |_| 0.3);
        let peak = response.iter().fold(0.0f64, |a, &b| a.max(b));
        assert!(peak < 0.5 + 1e-4, "{peak}");
        assert!((response[399] - 0.5).abs() < 1e-4);
        // Within 2 % after 1.5 ms.
        assert!((response[30] - 0.5).abs() < 0.01, "{}", response[30]);
    }

    #[test]
    fn parameters_that_are_off_leave_no_lasting_error() {
        let believed = Config::default();
        let real = Config {
            resistance_ohm: 3.6,
            inductance_h: 3.0e-3,
            torque_constant_nm_a: 0.54,
            ..believed
        };
        let current_loop = believed.build().unwrap();
        let (mut state, mut voltage) = (State::default(), 0.0);
        let mut motor = Motor {
            current: 0.0,
            speed: 6.0,
        };
        for _ in 0..1000 {
            let input = Input {
                torque_nm: 0.9,
                current_a: motor.current as f32,
                speed_rad_s: 6.0,
                supply_v: SUPPLY as f32,
                limit_a: 10.0,
            };
            motor.step(&real, voltage);
            voltage = f64::from(current_loop.step(&mut state, &input).duty) * SUPPLY;
        }
        assert!((motor.current - 1.5).abs() < 1e-3, "{}", motor.current);
    }

    /// Long in saturation, the loop leaves it at once when the reference comes back.
    #[test]
    fn saturation_does_not_wind_up() {
        let config = Config::default();
        let mut motor = Motor {
            current: 0.0,
            // Faster than the supply can drive 2 A through.
            speed: 18.0,
        };
        let response = run(&config, &mut motor, 3000, 1, |k| {
            if k < 2000 { 1.2 } else { 0.15 }
        });
        let stuck = (0.98 * SUPPLY - 0.6 * 18.0) / 2.88;
        assert!((response[1999] - stuck).abs() < 1e-3, "{}", response[1999]);
        // 2 ms are ten time constants of the loop.
        assert!((response[2040] - 0.25).abs() < 2e-3, "{}", response[2040]);
        let lowest = response[2000..].iter().fold(1.0f64, |a, &b| a.min(b));
        assert!(lowest > 0.24, "{lowest}");
    }

    #[test]
    fn current_stays_within_the_lesser_limit() {
        let config = Config::default();
        let current_loop = config.build().unwrap();
        for (limit, expected) in [(10.0, 4.0), (1.5, 1.5), (0.0, 0.0)] {
            let mut state = State::default();
            let mut motor = Motor {
                current: 0.0,
                speed: -2.0,
            };
            for _ in 0..500 {
                let output = current_loop.step(
                    &mut state,
                    &Input {
                        torque_nm: 100.0,
                        current_a: motor.current as f32,
                        speed_rad_s: -2.0,
                        supply_v: SUPPLY as f32,
                        limit_a: limit,
                    },
                );
                assert!(output.limited && output.reference_a == expected);
                motor.step(&config, f64::from(output.duty) * SUPPLY);
                assert!(motor.current < f64::from(expected) + 1e-3);
            }
            assert!((motor.current - f64::from(expected)).abs() < 1e-3);
        }
    }

    properties! {
        #[test]
        fn any_input_gives_a_bounded_duty(bits: [u32; 5], rounds in 1usize..20) {
            let config = Config::default();
            let current_loop = config.build().unwrap();
            let mut state = State::default();
            let [torque_nm, current_a, speed_rad_s, supply_v, limit_a] = bits.map(f32::from_bits);
            let input = Input { torque_nm, current_a, speed_rad_s, supply_v, limit_a };
            for _ in 0..rounds {
                let output = current_loop.step(&mut state, &input);
                prop_assert!(output.duty.abs() <= 0.980_001);
                prop_assert!(output.valid || output.duty == 0.0);
            }
            // Whatever came, the next sound sample is followed again.
            let sound = Input { torque_nm: 0.0, supply_v: 12.0, limit_a: 1.0, ..Input::default() };
            for _ in 0..2 {
                prop_assert!(current_loop.step(&mut state, &sound).valid);
            }
        }
    }

    #[test]
    fn what_is_not_a_number_switches_off() {
        let current_loop = Config::default().build().unwrap();
        let good = Input {
            torque_nm: 1.0,
            current_a: 0.0,
            speed_rad_s: 0.0,
            supply_v: 12.0,
            limit_a: 4.0,
        };
        let spoiled: [fn(&mut Input, f32); 5] = [
            |i, x| i.torque_nm = x,
            |i, x| i.current_a = x,
            |i, x| i.speed_rad_s = x,
            |i, x| i.supply_v = x,
            |i, x| i.limit_a = x,
        ];
        for (k, spoil) in spoiled.iter().enumerate() {
            for bad in [f32::NAN, f32::NEG_INFINITY] {
                let mut state = State::default();
                current_loop.step(&mut state, &good);
                let mut input = good;
                spoil(&mut input, bad);
                assert_eq!(
                    current_loop.step(&mut state, &input),
                    Output::default(),
                    "{k}"
                );
                assert_eq!(state, State::default());
            }
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        type Spoil = fn(&mut Config);
        let spoiled: [(Spoil, &str); 6] = [
            (|c| c.resistance_ohm = 0.0, "resistance_ohm"),
            (|c| c.inductance_h = f32::NAN, "inductance_h"),
            (|c| c.bandwidth_rad_s = 6000.0, "bandwidth_rad_s"),
            (|c| c.torque_constant_nm_a = -1.0, "torque_constant_nm_a"),
            (|c| c.max_current_a = f32::INFINITY, "max_current_a"),
            (|c| c.max_duty = 1.5, "max_duty"),
        ];
        for (spoil, field) in spoiled {
            let mut config = Config::default();
            spoil(&mut config);
            assert_eq!(config.build().unwrap_err().field, field);
        }
    }
}
