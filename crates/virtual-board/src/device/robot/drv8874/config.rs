//! Characteristics of the driver and of what is soldered to it.

use crate::time::Time;

/// Characteristics of the driver and what is soldered to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriverConfig {
    /// Resistance of each transistor, Ω. Data sheet: 0.1 typical at 25 °C.
    pub on_ohm: f64,
    /// Forward voltage of the transistors' diodes, V. Data sheet: 0.9.
    pub diode_v: f64,
    /// From an input's edge to the output. Data sheet: 650 ns.
    pub propagation: Time,
    /// Both transistors of a half bridge off between one and the other. Data sheet: 300 ns.
    pub dead: Time,
    /// From nSLEEP high to driving. Data sheet: 1 ms.
    pub wake: Time,
    /// From nSLEEP low to off; the inputs are obeyed until then. Data sheet: 1 ms.
    pub sleep: Time,
    /// Where the current is regulated, A: V(VREF) over R(IPROPI) over 455 µA/A. Default 6.6: 3.3 V and 1.1 kΩ.
    pub trip_a: f64,
    /// Off-time of the regulation. Data sheet: 25 µs.
    pub off_time: Time,
    /// From driving to the earliest regulation. Data sheet: 1.1 µs.
    pub blank: Time,
    /// Over-current, A. Data sheet: at least 6; default 8.
    pub over_current_a: f64,
    /// How long it must last. Data sheet: 3 µs.
    pub deglitch: Time,
    /// Until it is tried again. Data sheet: 2 ms.
    pub retry: Time,
    /// Undervoltage lockout: off below the first, on above the second, V. Data sheet: 4.35 and 4.45.
    pub lockout_v: (f64, f64),
}

impl Default for DriverConfig {
    fn default() -> Self {
        Self {
            on_ohm: 0.1,
            diode_v: 0.9,
            propagation: Time::from_nanos(650),
            dead: Time::from_nanos(300),
            wake: Time::from_micros(1000),
            sleep: Time::from_micros(1000),
            trip_a: 3.3 / (1.1e3 * 455e-6),
            off_time: Time::from_micros(25),
            blank: Time::from_nanos(1100),
            over_current_a: 8.0,
            deglitch: Time::from_micros(3),
            retry: Time::from_micros(2000),
            lockout_v: (4.35, 4.45),
        }
    }
}
