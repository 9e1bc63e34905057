//! Characteristics of the driver and of its external parts.

use crate::time::Time;

characteristics! {
    /// Characteristics of the driver and of its external parts.
    pub struct DriverConfig {
        /// Resistance of each transistor, Ω. Data sheet: 0.1 typical at 25 °C.
        pub on_ohm: f64 = 0.1;
        /// Forward voltage of the body diodes, V. Data sheet: 0.9.
        pub diode_v: f64 = 0.9;
        /// Propagation delay from input to output. Data sheet: 650 ns.
        pub propagation: Time = Time::from_nanos(650);
        /// Dead time between the two transistors of a half bridge. Data sheet: 300 ns.
        pub dead: Time = Time::from_nanos(300);
        /// Wake-up time from nSLEEP high to driving. Data sheet: 1 ms.
        pub wake: Time = Time::from_micros(1000);
        /// Time from nSLEEP low to off; the inputs work until then. Data sheet: 1 ms.
        pub sleep: Time = Time::from_micros(1000);
        /// Current limit of the regulation, A: V(VREF) over R(IPROPI) over 455 µA/A. Default 6.6, for 3.3 V and 1.1 kΩ.
        pub trip_a: f64 = 3.3 / (1.1e3 * 455e-6);
        /// Off-time of the regulation. Data sheet: 25 µs.
        pub off_time: Time = Time::from_micros(25);
        /// Blanking time from the start of driving to the earliest regulation. Data sheet: 1.1 µs.
        pub blank: Time = Time::from_nanos(1100);
        /// Over-current threshold, A. Data sheet: at least 6; default 8.
        pub over_current_a: f64 = 8.0;
        /// Shortest over-current that shuts the bridge down. Data sheet: 3 µs.
        pub deglitch: Time = Time::from_micros(3);
        /// Shutdown time before a retry. Data sheet: 2 ms.
        pub retry: Time = Time::from_micros(2000);
        /// Undervoltage lockout: off below the first voltage, on above the second, V. Data sheet: 4.35 and 4.45.
        pub lockout_v: (f64, f64) = (4.35, 4.45);
    }
}
