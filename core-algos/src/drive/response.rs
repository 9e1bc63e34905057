//! Response monitor of a motor: compares the applied voltage with the voltage that current and speed explain.
//!
//! Over a window of `n` periods of length T the means of voltage, current and speed obey
//! `V = R i + k_e ω + L (i_n − i_0)/(n T)`. The residual of a healthy motor is small, within a tolerance for the
//! resistance, which grows with the winding's temperature. With an open winding, a lost wire or a bridge that does not
//! switch, no current flows while the current loop raises the voltage, and the residual is nearly the whole voltage.
//!
//! [`Config::build`] validates; [`Response::step`] cannot fail. An input that is not finite counts as no response.

use super::current;
use crate::config::{ConfigError, declare, in_range};

declare! {
    /// Motor and tolerances.
    ///
    /// Default: The motor of [`current::Config`], with up to 60 % more resistance by heat.
    pub struct Config {
        /// Resistance of winding, leads and bridge (R).
        pub resistance_ohm: f32 = current::Config::default().resistance_ohm, "Ω": Range(1e-3, 1e3);
        /// Inductance of the winding (L).
        pub inductance_h: f32 = current::Config::default().inductance_h, "H": Range(1e-6, 1.0);
        /// Torque per current at the wheel, gear included (k_t = k_e).
        pub torque_constant_nm_a: f32 = current::Config::default().torque_constant_nm_a, "N m/A": Range(1e-4, 1e3);
        /// Time between steps (T).
        pub period_s: f32 = current::Config::default().period_s, "s": Range(1e-6, 1e-2);
        /// Length of a window.
        pub window_s: f32 = 0.01, "s": Range(4e-6, 1.0);
        /// Allowed residual voltage without current.
        pub tolerance_v: f32 = 1.5, "V": Range(0.1, 100.0);
        /// Further allowed residual voltage, as a share of R i.
        pub tolerance_share: f32 = 0.6, "": Range(0.0, 5.0);
    }
}

impl Config {
    /// Builds the monitor; the error names the invalid field.
    pub fn build(&self) -> Result<Response, ConfigError> {
        self.check_ranges()?;
        let period = self.period_s;
        let window = in_range("window_s", self.window_s, 4.0 * period, 1.0)?;
        Ok(Response {
            resistance: self.resistance_ohm,
            rise: self.inductance_h / period,
            torque_constant: self.torque_constant_nm_a,
            periods: (window / period).clamp(4.0, 60_000.0) as u16,
            tolerance: self.tolerance_v,
            share: self.tolerance_share,
        })
    }
}

/// State of a monitor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    periods: u16,
    /// Current at the beginning of the window, A.
    first: f32,
    /// Sum of the voltage over the window, V; below, the sums of current, A, and speed, rad/s.
    voltage: f32,
    current: f32,
    speed: f32,
    /// True if current and speed did not explain the voltage of the last window.
    unexplained: bool,
}

impl State {
    /// True if current and speed did not explain the voltage of the last whole window.
    pub fn unexplained(&self) -> bool {
        self.unexplained
    }
}

/// The monitor of one motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    resistance: f32,
    /// L/T, Ω: voltage across the inductance per change of the current in a period.
    rise: f32,
    torque_constant: f32,
    periods: u16,
    tolerance: f32,
    share: f32,
}

impl Response {
    /// Adds one period with the applied voltage, and with current (A) and wheel speed (rad/s) at its beginning. Call
    /// only while the bridge is on; begin with a new [`State`] when the bridge is switched on.
    pub fn step(&self, state: &mut State, voltage_v: f32, current_a: f32, speed_rad_s: f32) {
        if state.periods == 0 {
            state.first = current_a;
        }
        if state.periods >= self.periods {
            state.unexplained = !self.explains(state, current_a);
            *state = State {
                first: current_a,
                unexplained: state.unexplained,
                ..State::default()
            };
        }
        state.periods += 1;
        state.voltage += voltage_v;
        state.current += current_a;
        state.speed += speed_rad_s;
    }

    /// True if current and speed explain the voltage of a whole window that ends with the current `last` (A): the
    /// residual is within the tolerance.
    fn explains(&self, state: &State, last: f32) -> bool {
        let share = 1.0 / f32::from(self.periods);
        let current = state.current * share;
        let drop = self.resistance * current;
        let emf = self.torque_constant * state.speed * share;
        let induced = self.rise * (last - state.first) * share;
        let left = state.voltage * share - drop - emf - induced;
        left.abs() <= self.tolerance + self.share * drop.abs()
    }
}

#[cfg(test)]
mod tests;
