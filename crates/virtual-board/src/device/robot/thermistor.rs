//! A thermistor from a pin to ground, with a pull-up resistor to the supply.
//!
//! NTC of 10 kΩ at 25 °C with B = 3950 K: `R = R₂₅ exp(B (1/T − 1/298.15 K))`.

characteristics! {
    /// A thermistor and its pull-up resistor.
    pub struct Thermistor {
        /// Resistance at 25 °C, Ω.
        pub resistance_25_ohm: f64 = 10e3;
        /// B constant: slope of ln R over 1/T, K.
        pub b_k: f64 = 3950.0;
        /// Resistance of the pull-up resistor, Ω.
        pub pull_up_ohm: f64 = 10e3;
        /// True if a lead is open.
        pub open: bool = false;
    }
}

impl Thermistor {
    /// Resistance at a temperature, Ω.
    pub fn resistance(&self, celsius: f64) -> f64 {
        if self.open {
            return f64::INFINITY;
        }
        let inverse = 1.0 / (celsius + 273.15) - 1.0 / 298.15;
        self.resistance_25_ohm * libm::exp(self.b_k * inverse)
    }

    /// Voltage at the pin, V.
    pub fn voltage(&self, celsius: f64, supply_v: f64) -> f64 {
        // In this form an infinite resistance gives the supply voltage.
        supply_v / (1.0 + self.pull_up_ohm / self.resistance(celsius))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resistance_matches_the_table_of_a_10_k_b_3950_part() {
        // Values of a manufacturer's table. The tolerance of 3 % covers the spread of B.
        let thermistor = Thermistor::default();
        for (celsius, ohm) in [
            (0.0, 33_620.0),
            (25.0, 10_000.0),
            (50.0, 3_588.0),
            (85.0, 1_088.0),
        ] {
            let found = thermistor.resistance(celsius);
            assert!((found / ohm - 1.0).abs() < 0.03, "{celsius} {found}");
        }
    }

    #[test]
    fn voltage_is_half_the_supply_at_25_c_and_the_supply_with_an_open_lead() {
        let mut thermistor = Thermistor::default();
        assert!((thermistor.voltage(25.0, 3.3) - 1.65).abs() < 1e-12);
        thermistor.open = true;
        assert_eq!(thermistor.voltage(25.0, 3.3), 3.3);
    }
}
