//! A full strain-gauge bridge with instrumentation amplifier and low-pass filter.
//!
//! Amplifier: Texas Instruments SBOS501 (INA826: rail-to-rail output, one gain resistor). With four active gauges the
//! bridge output is `V_ex·K·ε`, and the amplifier output is `V_ex/2 + G·V_ex·K·(ε + ε_offset)`: ratiometric. The
//! low-pass filter is of first order. Strain is linear in time between two calls of [`Bridge::strain`], so the filter
//! output is known in closed form and sampling is exact at any time.

use crate::device::span_s;
use crate::noise::Noise;
use crate::time::Time;

characteristics! {
    /// Characteristics of bridge and amplifier.
    pub struct BridgeConfig {
        /// Gauge factor: relative resistance change over strain. Default 2.1, constantan foil.
        pub gauge_factor: f64 = 2.1;
        /// Gain of the amplifier. Default 64.
        pub gain: f64 = 64.0;
        /// Relative error of gauge factor and gain. Default 0.
        pub gain_error: f64 = 0.0;
        /// Unbalance of the bridge, as strain. Default 0.
        pub offset_strain: f64 = 0.0;
        /// Cut-off frequency of the low-pass filter, Hz. Default 200.
        pub bandwidth_hz: f64 = 200.0;
        /// White noise of one conversion at the pin, V rms, from amplifier, wiring and switching of the motors. Default
        /// 3 mV, which leaves 0.7 µε in the mean of 96 conversions.
        pub noise_v: f64 = 3e-3;
        /// Distance from ground and from the amplifier's supply at which the output saturates, V.
        pub rail_v: f64 = 0.05;
    }
}

/// Faults of a bridge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BridgeFault {
    /// No fault.
    #[default]
    None,
    /// An arm or a lead of the bridge is open: the amplifier input is half the excitation.
    Open {
        /// True if the output goes to the upper rail, false for the lower rail.
        up: bool,
    },
    /// The amplifier output is stuck at a rail.
    Saturated {
        /// True for the upper rail.
        up: bool,
    },
}

/// A bridge with its amplifier.
#[derive(Clone, Debug)]
pub struct Bridge {
    config: BridgeConfig,
    noise: Noise,
    fault: BridgeFault,
    /// Time constant of the low-pass filter, s.
    tau_s: f64,
    supply_v: f64,
    excitation_v: f64,
    /// Strain and its slope at the time `since`.
    since: Time,
    strain: f64,
    strain_slope: f64,
    /// Amplifier output before the low-pass filter, V, and its slope, V/s.
    input_v: f64,
    slope_v_s: f64,
    /// Output of the low-pass filter, V, at the time `now`.
    now: Time,
    output_v: f64,
}

impl Bridge {
    /// A bridge at rest without strain; excitation and supply are `supply_v`.
    pub fn new(config: BridgeConfig, supply_v: f64, seed: u64) -> Self {
        let mut bridge = Self {
            config,
            noise: Noise::new(seed),
            fault: BridgeFault::None,
            tau_s: 1.0 / (std::f64::consts::TAU * config.bandwidth_hz),
            supply_v,
            excitation_v: supply_v,
            since: Time(0),
            strain: 0.0,
            strain_slope: 0.0,
            input_v: 0.0,
            slope_v_s: 0.0,
            now: Time(0),
            output_v: 0.0,
        };
        bridge.changed();
        bridge.output_v = bridge.input_v;
        bridge
    }

    /// Sets the strain and its rate of change, 1/s, from `at` on.
    pub fn strain(&mut self, at: Time, strain: f64, slope_per_s: f64) {
        self.advance(at);
        (self.since, self.strain, self.strain_slope) = (self.now, strain, slope_per_s);
        self.changed();
    }

    /// Sets the excitation of the bridge and the supply of the amplifier from `at` on.
    pub fn feed(&mut self, at: Time, excitation_v: f64, supply_v: f64) {
        self.advance(at);
        (self.excitation_v, self.supply_v) = (excitation_v, supply_v);
        self.changed();
    }

    /// Sets or clears a fault.
    pub fn set_fault(&mut self, at: Time, fault: BridgeFault) {
        self.advance(at);
        self.fault = fault;
        self.changed();
    }

    /// Voltage at the converter's pin at the time of a conversion, V.
    pub fn sample(&mut self, at: Time) -> f64 {
        self.advance(at);
        let noise = self.config.noise_v * self.noise.normal();
        (self.output_v + noise).clamp(0.0, self.supply_v)
    }

    /// Computes the amplifier output after a change of strain, supply or fault.
    fn changed(&mut self) {
        let c = &self.config;
        self.strain += self.strain_slope * span_s(self.since, self.now);
        self.since = self.now;
        let slope = c.gain * c.gauge_factor * (1.0 + c.gain_error) * self.excitation_v;
        let middle = 0.5 * self.excitation_v;
        let low = c.rail_v.min(self.supply_v);
        let high = (self.supply_v - c.rail_v).max(low);
        let ideal = match self.fault {
            BridgeFault::None => middle + slope * (self.strain + c.offset_strain),
            BridgeFault::Open { up } => middle * (1.0 + if up { c.gain } else { -c.gain }),
            BridgeFault::Saturated { up } => f64::from(u8::from(up)) * self.supply_v,
        };
        self.input_v = ideal.clamp(low, high);
        let moves = self.fault == BridgeFault::None && self.input_v == ideal;
        self.slope_v_s = if moves {
            slope * self.strain_slope
        } else {
            0.0
        };
    }

    fn advance(&mut self, to: Time) {
        let span = span_s(self.now, to);
        if span == 0.0 {
            return;
        }
        // τ ẏ + y = u with u linear in time: y = u − τ u̇ + (y₀ − u₀ + τ u̇) e^(−t/τ).
        let lag = self.tau_s * self.slope_v_s;
        let left = decay(span / self.tau_s);
        let difference = self.output_v - self.input_v + lag;
        self.input_v += self.slope_v_s * span;
        self.output_v = self.input_v - lag + difference * left;
        self.now = to;
    }
}

/// e^(−x); by its series for small x, the usual case between two conversions.
fn decay(x: f64) -> f64 {
    if x < 0.03 {
        // The next term, x⁶/720, is at most 1.1·10⁻¹².
        1.0 - x * (1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0))))
    } else {
        libm::exp(-x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const US: u64 = 1_000_000;

    fn noiseless() -> Bridge {
        let config = BridgeConfig {
            noise_v: 0.0,
            ..BridgeConfig::default()
        };
        Bridge::new(config, 3.3, 1)
    }

    #[test]
    fn output_per_strain_is_gain_times_gauge_factor_and_ratiometric() {
        let mut bridge = noiseless();
        bridge.strain(Time(0), 1000e-6, 0.0);
        let share = bridge.sample(Time(100_000 * US)) / 3.3;
        // The output is above the middle by K·G·ε = 2.1·64·10⁻³ of full scale.
        assert!((share - 0.5 - 0.1344).abs() < 1e-9, "{share}");
        bridge.feed(Time(100_000 * US), 3.0, 3.3);
        let share = bridge.sample(Time(200_000 * US)) / 3.0;
        assert!((share - 0.5 - 0.1344).abs() < 1e-9, "{share}");
    }

    #[test]
    fn low_pass_response_to_step_and_ramp_is_exact_at_any_sampling() {
        let tau = 1.0 / (std::f64::consts::TAU * 200.0);
        let scale = 64.0 * 2.1 * 3.3;
        for step in [2u64, 10, 997] {
            let mut bridge = noiseless();
            bridge.strain(Time(0), 500e-6, 0.2);
            let mut t = 0;
            while t < 3000 * US {
                t += step * US;
                let found = bridge.sample(Time(t));
                let s = t as f64 * 1e-12;
                let gone = (-s / tau).exp();
                let strain = 500e-6 * (1.0 - gone) + 0.2 * (s - tau * (1.0 - gone));
                let expected = 1.65 + scale * strain;
                assert!((found - expected).abs() < 1e-10, "{t} {found} {expected}");
            }
        }
    }

    #[test]
    fn noise_of_96_conversions_is_0_7_microstrain() {
        let mut bridge = Bridge::new(BridgeConfig::default(), 3.3, 3);
        let mut squares = 0.0;
        for ms in 0..500u64 {
            let sum: f64 = (0..96)
                .map(|k| bridge.sample(Time(ms * 1000 * US + k * 10 * US)) - 1.65)
                .sum();
            squares += (sum / 96.0 / (64.0 * 2.1 * 3.3)).powi(2);
        }
        let rms = (squares / 500.0).sqrt();
        assert!((rms - 0.7e-6).abs() < 0.07e-6, "{rms}");
    }

    #[test]
    fn faulty_or_overloaded_bridge_saturates_at_a_rail() {
        let late = |k: u64| Time(k * 100_000 * US);
        let mut bridge = noiseless();
        bridge.set_fault(late(0), BridgeFault::Open { up: true });
        assert!((bridge.sample(late(1)) - 3.25).abs() < 1e-9);
        bridge.set_fault(late(1), BridgeFault::Open { up: false });
        assert!((bridge.sample(late(2)) - 0.05).abs() < 1e-9);
        bridge.set_fault(late(2), BridgeFault::Saturated { up: true });
        assert!((bridge.sample(late(3)) - 3.25).abs() < 1e-9);
        bridge.set_fault(late(3), BridgeFault::None);
        bridge.feed(late(3), 0.0, 3.3);
        assert!((bridge.sample(late(4)) - 0.05).abs() < 1e-9);
        bridge.feed(late(4), 3.3, 3.3);
        bridge.strain(late(4), 0.02, 0.0);
        assert!((bridge.sample(late(5)) - 3.25).abs() < 1e-9);
    }
}
