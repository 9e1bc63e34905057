//! Motors, drivers and supply of an axle board, in the numbers of their data sheets.
//!
//! The configurations of current loops, response monitors, thermal model, current sensors and supply converter are
//! derived from this one set. A test checks that the defaults of the set give the defaults of each part.

use crate::acquisition::analog::SupplyConfig;
use crate::config::{Allowed, ConfigError, declare, require};
use crate::drive::winding::fold_back;
use crate::drive::{current, response, shunt, winding};

/// Distance from the stop limits of the supply to the trip limits, at which the motors are switched off at once, V:
/// below and above.
const BEYOND_V: (f32, f32) = (1.0, 0.8);
/// Share of the converter's range in which a reading is a supply voltage; above, the divider may be broken.
const READABLE: f32 = 0.98;

declare! {
    /// Circuits behind the pins of an axle board.
    ///
    /// Default: A 12 V gear motor of 2.5 N m at standstill and 20 rad/s without load, and INA240A1 on 10 mΩ. The lower
    /// limits of the supply suit three cells (3.3 V and 3.5 V a cell), the upper limit four full cells.
    pub struct Drive {
        /// True supply voltage divided by the measured voltage.
        pub supply_gain: f32 = 1.0, "": Range(0.9, 1.1);
        /// Supply below which the robot stops; 3.3 V a cell: 9.9 for three, 13.2 for four.
        pub supply_minimum_v: f32 = 9.9, "V": Range(6.0, 15.0);
        /// Supply below which the robot reports a warning; 3.5 V a cell: 10.5 for three, 14.0 for four.
        pub supply_warning_v: f32 = 10.5, "V": Range(6.0, 17.0);
        /// Supply above which the robot stops; a full pack and 3 %: 13.0 for three cells, 17.4 for four.
        pub supply_maximum_v: f32 = 17.4, "V": Range(10.0, 17.6);
        /// Shunt resistance in a motor's lead.
        pub shunt_ohm: f32 = 0.01, "Ω": Range(1e-3, 0.1);
        /// Gain of the amplifier across the shunt.
        pub amplifier_gain: f32 = 20.0, "": Range(1.0, 100.0);
        /// Resistance of winding, leads and bridge.
        pub resistance_ohm: f32 = 2.88, "Ω": Range(0.05, 100.0);
        /// Inductance of the winding.
        pub inductance_h: f32 = 2.3e-3, "H": Range(1e-5, 0.1);
        /// Torque per current of the motor before its gear.
        pub torque_constant_nm_a: f32 = 0.02, "N m/A": Range(1e-3, 1.0);
        /// Turns of a motor per turn of its wheel.
        pub gear_ratio: f32 = 30.0, "": Range(1.0, 500.0);
        /// Largest current of a motor.
        pub max_current_a: f32 = 4.0, "A": Range(0.2, 5.5);
        /// Thermal resistance from winding to ambient.
        pub thermal_resistance_k_w: f32 = 6.0, "K/W": Range(0.1, 100.0);
        /// Thermal time constant of the winding.
        pub thermal_time_constant_s: f32 = 30.0, "s": Range(1.0, 1e3);
        /// Temperature of the winding at which the current limit reaches 0.
        pub winding_max_c: f32 = 120.0, "°C": Range(70.0, 180.0);
        /// Span below `winding_max_c` in which the current limit falls.
        pub winding_fold_back_k: f32 = 20.0, "K": Range(5.0, 35.0);
        /// Temperature between the drivers at which the current limit reaches 0.
        pub driver_max_c: f32 = 105.0, "°C": Range(60.0, 150.0);
        /// Span below `driver_max_c` in which the current limit falls.
        pub driver_fold_back_k: f32 = 20.0, "K": Range(5.0, 35.0);
    }
}

impl Drive {
    /// Configuration of the current loops.
    pub fn current_loop(&self) -> current::Config {
        current::Config {
            resistance_ohm: self.resistance_ohm,
            inductance_h: self.inductance_h,
            torque_constant_nm_a: self.wheel_torque_constant(),
            max_current_a: self.max_current_a,
            ..current::Config::default()
        }
    }

    /// Configuration of the response monitors of the motors.
    pub fn response(&self) -> response::Config {
        response::Config {
            resistance_ohm: self.resistance_ohm,
            inductance_h: self.inductance_h,
            torque_constant_nm_a: self.wheel_torque_constant(),
            ..response::Config::default()
        }
    }

    /// Configuration of the thermal model of the windings.
    pub fn winding(&self) -> winding::Config {
        winding::Config {
            resistance_ohm: self.resistance_ohm,
            thermal_resistance_k_w: self.thermal_resistance_k_w,
            time_constant_s: self.thermal_time_constant_s,
            fold_back_c: self.winding_max_c - self.winding_fold_back_k,
            max_c: self.winding_max_c,
            max_current_a: self.max_current_a,
            ..winding::Config::default()
        }
    }

    /// Configuration of the current sensors.
    pub fn shunt(&self) -> shunt::Config {
        shunt::Config {
            volts_per_ampere: self.shunt_ohm * self.amplifier_gain,
            ..shunt::Config::default()
        }
    }

    /// Configuration of the supply converter.
    pub fn supply(&self) -> SupplyConfig {
        let plain = SupplyConfig::default();
        SupplyConfig {
            divider: self.supply_gain * plain.divider,
            ..plain
        }
    }

    /// Trip limits of the supply, at which the motors are switched off at once, V: beyond the stop limits, within the
    /// converter's range.
    pub fn supply_trip_v(&self) -> (f32, f32) {
        let supply = self.supply();
        let readable = READABLE * supply.divider * supply.reference_v;
        (
            self.supply_minimum_v - BEYOND_V.0,
            readable.min(self.supply_maximum_v + BEYOND_V.1),
        )
    }

    /// Temperature between the drivers above which the current is folded back, °C.
    pub fn driver_fold_back_c(&self) -> f32 {
        self.driver_max_c - self.driver_fold_back_k
    }

    /// Permitted share of the current at a temperature between the drivers, °C; 0.5 without a reading.
    pub fn driver_share(&self, temperature_c: Option<f32>) -> f32 {
        temperature_c.map_or(0.5, |temperature| {
            fold_back(temperature, self.driver_fold_back_c(), self.driver_max_c)
        })
    }

    /// Checks that every part can be built; the error names the field.
    // Not inlined: the nodes are checked by the same caller, and a board's stack is small.
    #[inline(never)]
    pub fn check(&self) -> Result<(), ConfigError> {
        self.check_ranges()?;
        self.current_loop().build()?;
        self.response().build()?;
        self.winding().build()?;
        self.shunt().build()?;
        self.supply().build()?;
        require(
            self.supply_minimum_v < self.supply_maximum_v,
            "supply_minimum_v",
            self.supply_minimum_v,
            Allowed::Condition("less than supply_maximum_v"),
        )
        .map(|_| ())
    }

    /// Torque per current at the wheel, N m/A.
    fn wheel_torque_constant(&self) -> f32 {
        self.torque_constant_nm_a * self.gear_ratio
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::TABLE;

    fn close(a: f32, b: f32) -> bool {
        (a - b).abs() <= 1e-6 * b.abs()
    }

    #[test]
    fn defaults_give_the_defaults_of_the_parts() {
        let drive = Drive::default();
        let (wheel, own) = (drive.current_loop(), current::Config::default());
        assert!(close(wheel.torque_constant_nm_a, own.torque_constant_nm_a));
        let torque_constant_nm_a = own.torque_constant_nm_a;
        let same = current::Config {
            torque_constant_nm_a,
            ..wheel
        };
        assert_eq!(same, own);
        let same = response::Config {
            torque_constant_nm_a,
            ..drive.response()
        };
        assert_eq!(same, response::Config::default());
        assert_eq!(drive.winding(), winding::Config::default());
        assert_eq!(drive.supply(), SupplyConfig::default());
        let own = shunt::Config::default();
        assert!(close(drive.shunt().volts_per_ampere, own.volts_per_ampere));
    }

    #[test]
    fn parameters_reach_each_part() {
        let drive = Drive {
            supply_gain: 1.1,
            shunt_ohm: 0.02,
            resistance_ohm: 1.5,
            inductance_h: 1e-3,
            torque_constant_nm_a: 0.03,
            gear_ratio: 25.0,
            max_current_a: 3.0,
            thermal_resistance_k_w: 5.0,
            thermal_time_constant_s: 20.0,
            winding_max_c: 110.0,
            winding_fold_back_k: 15.0,
            ..Drive::default()
        };
        let (wheel, monitor, winding) = (drive.current_loop(), drive.response(), drive.winding());
        let resistances = [wheel.resistance_ohm, monitor.resistance_ohm];
        assert_eq!((resistances, winding.resistance_ohm), ([1.5; 2], 1.5));
        assert_eq!([wheel.inductance_h, monitor.inductance_h], [1e-3; 2]);
        assert_eq!([wheel.max_current_a, winding.max_current_a], [3.0; 2]);
        assert!(close(wheel.torque_constant_nm_a, 0.75));
        assert!(close(monitor.torque_constant_nm_a, 0.75));
        let thermal = [winding.thermal_resistance_k_w, winding.time_constant_s];
        assert_eq!(thermal, [5.0, 20.0]);
        assert_eq!([winding.fold_back_c, winding.max_c], [95.0, 110.0]);
        assert!(close(drive.shunt().volts_per_ampere, 0.4));
        let divider = SupplyConfig::default().divider;
        assert!(close(drive.supply().divider, 1.1 * divider));
    }

    /// Lithium cells, computed by hand: a full pack of four does not stop the robot, an empty pack of three does. Trip
    /// limits lie beyond stop limits, and a converter at its rail trips.
    #[test]
    fn supply_limits_suit_three_and_four_cells() {
        let drive = Drive::default();
        assert!(drive.supply_maximum_v > 4.0 * 4.2 * 1.02);
        assert!(drive.supply_minimum_v >= 3.0 * 3.2 && drive.supply_warning_v <= 3.0 * 3.6);
        let (low, high) = drive.supply_trip_v();
        assert!(low < drive.supply_minimum_v && high > drive.supply_maximum_v);
        for gain in [0.9, 1.0, 1.1] {
            let drive = Drive {
                supply_gain: gain,
                supply_maximum_v: 17.6,
                ..drive
            };
            let rail = drive.supply().build().unwrap().read(4095);
            assert!(rail > drive.supply_trip_v().1, "{gain} {rail}");
        }
    }

    #[test]
    fn driver_share_falls_linearly() {
        let drive = Drive::default();
        for (temperature, share) in [(25.0, 1.0), (85.0, 1.0), (95.0, 0.5), (105.0, 0.0)] {
            assert!((drive.driver_share(Some(temperature)) - share).abs() < 1e-6);
        }
        assert_eq!(drive.driver_share(None), 0.5);
        assert_eq!(drive.driver_share(Some(f32::NAN)), 0.0);
    }

    /// Any two parameters may be at the ends of their ranges, except supply limits that contradict each other.
    #[test]
    fn every_value_of_the_ranges_can_be_built() {
        let own = || TABLE.iter().filter(|p| p.name.starts_with("drive."));
        assert_eq!(own().count() * 4, core::mem::size_of::<Drive>());
        let mut refused = 0;
        for first in own() {
            for second in own() {
                for a in [first.range.0, first.range.1] {
                    for b in [second.range.0, second.range.1] {
                        let mut settings = crate::params::Settings::default();
                        first.set(&mut settings, a).unwrap();
                        second.set(&mut settings, b).unwrap();
                        let drive = settings.drive;
                        let sound = drive.supply_minimum_v < drive.supply_maximum_v;
                        let names = [first.name, second.name];
                        assert_eq!(drive.check().is_ok(), sound, "{names:?}");
                        refused += usize::from(!sound);
                    }
                }
            }
        }
        // The lowest maximum with the highest minimum, in either order.
        assert_eq!(refused, 2);
    }
}
