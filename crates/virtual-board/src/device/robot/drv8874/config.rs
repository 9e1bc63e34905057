//! Characteristics of the driver and of what is soldered to it.

use crate::time::Time;

characteristics! {
    /// Characteristics of the driver and what is soldered to it.
    pub struct DriverConfig {
        /// Resistance of each transistor, Ω. Data sheet: 0.1 typical at 25 °C.
        pub on_ohm: f64 = 0.1;
        /// Forward voltage of the transistors' diodes, V. Data sheet: 0.9.
        pub diode_v: f64 = 0.9;
        /// From an input's edge to the output. Data sheet: 650 ns.
        pub propagation: Time = Time::from_nanos(650);
        /// Both transistors of a half bridge off between one and the other. Data sheet: 300 ns.
        pub dead: Time = Time::from_nanos(300);
        /// From nSLEEP high to driving. Data sheet: 1 ms.
        pub wake: Time = Time::from_micros(1000);
        /// From nSLEEP low to off; the inputs are obeyed until then. Data sheet: 1 ms.
        pub sleep: Time = Time::from_micros(1000);
        /// Current at which it is regulated, A: V(VREF) over R(IPROPI) over 455 µA/A. Default 6.6: 3.3 V and 1.1 kΩ.
        pub trip_a: f64 = 3.3 / (1.1e3 * 455e-6);
        /// Off-time of the regulation. Data sheet: 25 µs.
        pub off_time: Time = Time::from_micros(25);
        /// From driving to the earliest regulation. Data sheet: 1.1 µs.
        pub blank: Time = Time::from_nanos(1100);
        /// Over-current, A. Data sheet: at least 6; default 8.
        pub over_current_a: f64 = 8.0;
        /// Least duration. Data sheet: 3 µs.
        pub deglitch: Time = Time::from_micros(3);
        /// Until it is tried again. Data sheet: 2 ms.
        pub retry: Time = Time::from_micros(2000);
        /// Undervoltage lockout: off below the first, on above the second, V. Data sheet: 4.35 and 4.45.
        pub lockout_v: (f64, f64) = (4.35, 4.45);
    }
}
