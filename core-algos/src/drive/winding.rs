//! Thermal limit of a motor's current: a model of the winding, and fold-back.
//!
//! The winding warms by its own loss and cools towards its surroundings:
//! `τ dϑ/dt = R_th R i² − ϑ`, ϑ above ambient (the i²t protection of motor drives). Near the temperature limit the
//! permitted current falls linearly to zero, so that a hot motor gets weak and is not damaged. A board that restarts
//! begins at [`Config::start_c`].
//!
//! [`Config::build`] validates; [`Winding::step`] cannot fail. A current that is not finite counts as the largest
//! current.

use crate::config::{Allowed, ConfigError, declare, in_range, require};
use crate::math::trig::{clamp, lag_gain};

declare! {
    /// Thermal data of a motor's winding, and limits of temperature and current.
    pub struct Config {
        /// Resistance of the winding (R).
        pub resistance_ohm: f32 = 2.88, "Ω": Range(1e-3, 1e3);
        /// Thermal resistance to ambient (R_th).
        pub thermal_resistance_k_w: f32 = 6.0, "K/W": Range(1e-3, 1e3);
        /// Thermal time constant (τ).
        pub time_constant_s: f32 = 30.0, "s": Range(0.1, 1e4);
        /// Ambient temperature.
        pub ambient_c: f32 = 30.0, "°C": Range(-40.0, 85.0);
        /// Temperature assumed at the start.
        pub start_c: f32 = 60.0, "°C": Range(-40.0, 200.0);
        /// Temperature from which the current is folded back.
        pub fold_back_c: f32 = 100.0, "°C": Range(-39.0, 200.0);
        /// Temperature at which the current limit reaches 0.
        pub max_c: f32 = 120.0, "°C": Range(-38.0, 250.0);
        /// Time between steps.
        pub period_s: f32 = 1e-3, "s": Range(1e-5, 0.1);
        /// Largest current.
        pub max_current_a: f32 = 4.0, "A": Positive;
    }
}

impl Config {
    /// Builds the thermal model; the error names the invalid field.
    pub fn build(&self) -> Result<Winding, ConfigError> {
        self.check_ranges()?;
        let resistance = self.resistance_ohm;
        let thermal = self.thermal_resistance_k_w;
        let constant = self.time_constant_s;
        let period = self.period_s;
        let ambient = self.ambient_c;
        in_range("start_c", self.start_c, ambient, 200.0)?;
        in_range("fold_back_c", self.fold_back_c, ambient + 1.0, 200.0)?;
        in_range("max_c", self.max_c, self.fold_back_c + 1.0, 250.0)?;
        require(
            self.start_c < self.max_c,
            "start_c",
            self.start_c,
            Allowed::Condition("less than max_c"),
        )?;
        Ok(Winding {
            rise_per_square: thermal * resistance,
            step: lag_gain(period / constant),
            ambient,
            start: self.start_c,
            fold_back: self.fold_back_c,
            max: self.max_c,
            max_current: self.max_current_a,
        })
    }
}

/// Permitted share of the current at `temperature`: 1 up to `from`, 0 at `to`; 0 for NaN.
pub fn fold_back(temperature: f32, from: f32, to: f32) -> f32 {
    permitted((to - temperature) / (to - from))
}

/// Limits a share to 0 to 1; NaN gives 0.
fn permitted(share: f32) -> f32 {
    if share > 0.0 { share.min(1.0) } else { 0.0 }
}

/// State of a thermal model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Estimated temperature of the winding, °C.
    pub temperature_c: f32,
    /// Remainder of a step below the resolution of the temperature, K.
    carry: f32,
}

/// The thermal model of one motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Winding {
    rise_per_square: f32,
    step: f32,
    ambient: f32,
    start: f32,
    fold_back: f32,
    max: f32,
    max_current: f32,
}

impl Winding {
    /// State after a start.
    pub fn at_start(&self) -> State {
        State {
            temperature_c: self.start,
            carry: 0.0,
        }
    }

    /// Runs one step with the root mean square of the current, A; returns the current limit until the next step, A.
    /// `driver_share` is the share that the driver's temperature permits (see [`fold_back`]).
    pub fn step(&self, state: &mut State, current_a: f32, driver_share: f32) -> f32 {
        let most = 2.0 * self.max_current;
        let current = if current_a.is_finite() {
            clamp(current_a, -most, most)
        } else {
            self.max_current
        };
        let settled = self.ambient + self.rise_per_square * current * current;
        let add = (settled - state.temperature_c) * self.step + state.carry;
        let next = state.temperature_c + add;
        state.carry = add - (next - state.temperature_c);
        state.temperature_c = next;
        let share = fold_back(next, self.fold_back, self.max);
        self.max_current * share.min(permitted(driver_share))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn temperature_follows_the_exponential() {
        let config = Config::default();
        let winding = config.build().unwrap();
        let mut state = winding.at_start();
        let settled = 30.0 + 6.0 * 2.88 * 1.5f64 * 1.5;
        for k in 1..=200_000u32 {
            winding.step(&mut state, 1.5, 1.0);
            if k % 10_000 == 0 {
                let expected = settled + (60.0 - settled) * (-f64::from(k) * 1e-3 / 30.0).exp();
                let error = (f64::from(state.temperature_c) - expected).abs();
                assert!(error < 0.01, "{k}: {} {expected}", state.temperature_c);
            }
        }
    }

    /// A motor that always draws the permitted current never exceeds its temperature limit.
    #[test]
    fn full_load_settles_below_the_limit() {
        let winding = Config::default().build().unwrap();
        let mut state = winding.at_start();
        let mut limit = 4.0;
        for _ in 0..600_000 {
            limit = winding.step(&mut state, limit, 1.0);
            assert!(state.temperature_c < 120.0);
        }
        // The current settles where loss and fold-back meet: 30 + 17.28 i² = 120 − 5 i.
        let expected = (-5.0 + (25.0f64 + 4.0 * 17.28 * 90.0).sqrt()) / (2.0 * 17.28);
        let error = f64::from(limit) - expected;
        assert!(error.abs() < 1e-3, "{limit} {expected}");
    }

    #[test]
    fn input_that_is_not_finite_never_raises_the_limit() {
        let winding = Config::default().build().unwrap();
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let (mut state, mut full) = (winding.at_start(), winding.at_start());
            winding.step(&mut state, bad, 1.0);
            winding.step(&mut full, 4.0, 1.0);
            assert_eq!(state, full);
        }
        assert_eq!(winding.step(&mut winding.at_start(), 0.0, f32::NAN), 0.0);
        assert_eq!(fold_back(f32::NAN, 80.0, 100.0), 0.0);
        assert_eq!(fold_back(90.0, 80.0, 100.0), 0.5);
        assert_eq!(fold_back(-50.0, 80.0, 100.0), 1.0);
        assert_eq!(fold_back(101.0, 80.0, 100.0), 0.0);
    }

    /// The winding permits the whole current at 30 °C, half at 110 °C, none at 130 °C. The driver's share is limited to
    /// 0 to 1.
    #[test]
    fn lesser_share_of_winding_and_driver_limits_the_current() {
        let winding = Config::default().build().unwrap();
        for (temperature_c, driver, share) in [
            (30.0, 7.0, 1.0),
            (30.0, 0.5, 0.5),
            (30.0, -1.0, 0.0),
            (110.0, 0.25, 0.25),
            (110.0, 0.75, 0.5),
            (130.0, 1.0, 0.0),
        ] {
            let mut state = State {
                temperature_c,
                ..winding.at_start()
            };
            let limit = winding.step(&mut state, 0.0, driver);
            assert!(
                (limit - 4.0 * share).abs() < 1e-3,
                "{temperature_c} {driver}: {limit}"
            );
        }
    }

    /// A current heats by its square. The model limits it to twice the largest current.
    #[test]
    fn heating_is_independent_of_sign_and_bounded() {
        let winding = Config::default().build().unwrap();
        let after = |current| {
            let mut state = winding.at_start();
            winding.step(&mut state, current, 1.0);
            state
        };
        for (current, same) in [(-1.5, 1.5), (100.0, 8.0), (-100.0, 8.0), (-7.9, 7.9)] {
            assert_eq!(after(current), after(same));
        }
        assert_ne!(after(7.9), after(8.0));
    }

    /// One step covers the share 1 − exp(−T/τ) of the difference to the settled temperature.
    #[test]
    fn step_covers_the_exponential_share_of_the_difference() {
        for (period_s, time_constant_s) in [(1e-5, 1.0), (9.9e-3, 1.0), (1e-2, 1.0), (0.1, 0.1)] {
            let config = Config {
                period_s,
                time_constant_s,
                ..Config::default()
            };
            let step = f64::from(config.build().unwrap().step);
            let expected = -(-f64::from(period_s) / f64::from(time_constant_s)).exp_m1();
            assert!(
                (step / expected - 1.0).abs() < 1e-6,
                "{period_s}: {step} {expected}"
            );
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
            ("max_c", |c| c.max_c = 90.0),
            ("max_c", |c| c.max_c = 100.9),
            ("start_c", |c| c.start_c = 120.0),
            ("start_c", |c| c.start_c = 29.9),
            ("fold_back_c", |c| c.fold_back_c = f32::NAN),
            ("fold_back_c", |c| c.fold_back_c = 30.9),
            ("time_constant_s", |c| c.time_constant_s = 0.0),
            ("max_current_a", |c| c.max_current_a = 0.0),
        ]);
        let least = Config {
            start_c: 30.0,
            fold_back_c: 31.0,
            max_c: 32.0,
            ..Config::default()
        };
        assert!(least.build().is_ok());
    }
}
