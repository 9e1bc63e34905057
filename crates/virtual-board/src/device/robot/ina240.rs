//! INA240A1 current-sense amplifier at a shunt in a motor lead.
//!
//! Data sheet: Texas Instruments SBOS662, "INA240 −4-V to 80-V, Bidirectional, Ultra-Precise Current Sense Amplifier
//! With Enhanced PWM Rejection". REF1 is at the supply and REF2 at ground: without current, the output is half the
//! supply.
//!
//! Modelled: gain and gain error; offset; bandwidth, as the lag behind a current with constant slope, which holds
//! between two edges; noise; rails; a decaying disturbance after a common-mode edge. For the disturbance, the data
//! sheet gives only the settling time to 0.5 %, 9.6 µs, and oscilloscope pictures. Its size and shape before that time
//! are an estimate.

use crate::device::span_s;
use crate::noise::Noise;
use crate::time::Time;

characteristics! {
    /// Characteristics of shunt and amplifier.
    pub struct AmplifierConfig {
        /// Resistance of the shunt, Ω.
        pub shunt_ohm: f64 = 0.01;
        /// Gain of the amplifier. INA240A1: 20.
        pub gain: f64 = 20.0;
        /// Relative error of shunt and gain. Default 0.
        pub gain_error: f64 = 0.0;
        /// Offset at the input, V. Data sheet: ±5 µV typical, ±25 µV at most. Default 0.
        pub offset_v: f64 = 0.0;
        /// Bandwidth, Hz. Data sheet: 400 kHz.
        pub bandwidth_hz: f64 = 400e3;
        /// Noise at the output, V rms. Default 0.63 mV: 40 nV/√Hz times 20 over 400 kHz·π/2.
        pub noise_v: f64 = 0.63e-3;
        /// Distances of the output from ground and from the supply at which it saturates, V. Data sheet: 1 mV and 50 mV
        /// typical.
        pub rails_v: (f64, f64) = (1e-3, 50e-3);
        /// Disturbance at the output right after an edge, relative to the height of the edge. Default 0.5 %: 60 mV at
        /// 12 V.
        pub edge_share: f64 = 5e-3;
        /// Time constant of the decay of the disturbance, s. Lower bound 0.4 µs, from the bandwidth. Upper bound 4.8
        /// µs, with which 60 mV decay to 0.5 % of half the supply in the 9.6 µs of the data sheet.
        pub edge_tau_s: f64 = 0.4e-6;
    }
}

/// Faults of an amplifier.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AmplifierFault {
    /// No fault.
    #[default]
    None,
    /// The shunt or its Kelvin leads are shorted: the measured current is 0.
    ShuntShort,
    /// A Kelvin lead is open or the output is stuck: the output is at this fraction of the supply.
    Stuck(f64),
}

/// Shunt and amplifier.
#[derive(Clone, Debug)]
pub struct Amplifier {
    config: AmplifierConfig,
    noise: Noise,
    fault: AmplifierFault,
}

impl Amplifier {
    /// An amplifier with a seed for its noise.
    pub fn new(config: AmplifierConfig, seed: u64) -> Self {
        Self {
            config,
            noise: Noise::new(seed),
            fault: AmplifierFault::None,
        }
    }

    /// Sets or clears a fault.
    pub fn set_fault(&mut self, fault: AmplifierFault) {
        self.fault = fault;
    }

    /// Output at a time, V, for a current (A) with the slope `slope_a_s` (A/s). `edge` is the lead's latest edge, from
    /// [`super::Drv8874::latest_edge`]. `supply_v` is the supply of the amplifier.
    pub fn output(
        &mut self,
        at: Time,
        current_a: f64,
        slope_a_s: f64,
        edge: (Time, f64),
        supply_v: f64,
    ) -> f64 {
        let c = &self.config;
        let lag = 1.0 / (std::f64::consts::TAU * c.bandwidth_hz);
        let sensed = match self.fault {
            AmplifierFault::Stuck(share) => return share * supply_v,
            AmplifierFault::ShuntShort => 0.0,
            AmplifierFault::None => current_a - lag * slope_a_s,
        };
        let age = span_s(edge.0, at) / c.edge_tau_s;
        let disturbance = if age < 20.0 {
            c.edge_share * edge.1 * libm::exp(-age)
        } else {
            0.0
        };
        let input = c.shunt_ohm * sensed * (1.0 + c.gain_error) + c.offset_v;
        let output =
            0.5 * supply_v + c.gain * input + disturbance + c.noise_v * self.noise.normal();
        let (low, high) = (c.rails_v.0.min(supply_v), supply_v - c.rails_v.1);
        output.clamp(low, high.max(low))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUIET: (Time, f64) = (Time(0), 0.0);

    fn noiseless() -> Amplifier {
        let config = AmplifierConfig {
            noise_v: 0.0,
            ..AmplifierConfig::default()
        };
        Amplifier::new(config, 1)
    }

    #[test]
    fn output_is_0_2_v_per_ampere_about_the_middle_within_the_rails() {
        let mut amplifier = noiseless();
        let at = Time::from_micros(100);
        for (amps, volts) in [
            (0.0, 1.65),
            (3.0, 2.25),
            (-3.0, 1.05),
            (10.0, 3.25),
            (-10.0, 1e-3),
        ] {
            let found = amplifier.output(at, amps, 0.0, QUIET, 3.3);
            assert!((found - volts).abs() < 1e-9, "{amps} {found}");
        }
    }

    #[test]
    fn disturbance_of_an_edge_decays_within_2_microseconds() {
        let mut amplifier = noiseless();
        let edge = (Time::from_micros(10), 12.0);
        let at = |ns| Time::from_micros(10) + Time::from_nanos(ns);
        let first = amplifier.output(at(0), 0.0, 0.0, edge, 3.3) - 1.65;
        assert!((first - 0.06).abs() < 1e-9);
        // After five time constants the disturbance is less than a count of the converter (0.8 mV).
        let last = amplifier.output(at(2000), 0.0, 0.0, edge, 3.3) - 1.65;
        assert!(last > 0.0 && last < 0.8e-3, "{last}");
    }

    #[test]
    fn output_lags_a_ramp_by_the_time_constant() {
        let mut amplifier = noiseless();
        // A lag of 0.398 µs behind a ramp of 5 A/ms is 2 mA, or 0.4 mV at the output.
        let found = amplifier.output(Time::from_micros(50), 1.0, 5e3, QUIET, 3.3);
        assert!((found - 1.85 + 0.398e-3).abs() < 1e-6, "{found}");
    }

    #[test]
    fn faults_give_zero_current_or_a_stuck_output() {
        let mut amplifier = noiseless();
        amplifier.set_fault(AmplifierFault::ShuntShort);
        assert_eq!(amplifier.output(Time(1), 3.0, 0.0, QUIET, 3.3), 1.65);
        amplifier.set_fault(AmplifierFault::Stuck(1.0));
        assert_eq!(amplifier.output(Time(1), 3.0, 0.0, QUIET, 3.3), 3.3);
    }
}
