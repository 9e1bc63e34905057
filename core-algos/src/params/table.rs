//! The one table of parameters.
//!
//! An identifier is the key in the store and is never given to another parameter. A version goes up
//! when the meaning of a value changes; values of other versions are not used.

use super::Settings;
use crate::beam::PerGauge;
use crate::config::{Allowed, ConfigError, in_range, require};
use crate::control::regulator::Strategy;
use crate::fusion::robot::Mode;

/// One parameter.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Key in the store, 1 to [`MAX_ID`].
    pub id: u8,
    /// Version of its meaning.
    pub version: u8,
    /// Name: its place in [`Settings`], for those of `robot` the same as in a scenario.
    pub name: &'static str,
    /// Unit; empty for a pure number.
    pub unit: &'static str,
    /// Smallest and largest value.
    pub range: (f32, f32),
    /// True if only whole numbers are values.
    pub whole: bool,
    /// Meaning of the parameter.
    pub meaning: &'static str,
    read: fn(&Settings) -> f32,
    write: fn(&mut Settings, f32),
}

/// Largest identifier.
pub const MAX_ID: u8 = 191;

impl Parameter {
    /// Its value in `settings`.
    pub fn get(&self, settings: &Settings) -> f32 {
        (self.read)(settings)
    }

    /// Its value when nothing is stored, on a board whose own settings are the defaults.
    pub fn default(&self) -> f32 {
        self.get(&Settings::default())
    }

    /// Refuses NaN and what is out of range; the error names the parameter.
    pub fn validate(&self, value: f32) -> Result<f32, ConfigError> {
        in_range(self.name, value, self.range.0, self.range.1)?;
        let whole = Allowed::Condition("a whole number");
        require(
            !self.whole || value == value as i32 as f32,
            self.name,
            value,
            whole,
        )
    }

    /// Puts a value into `settings`, or refuses it and changes nothing.
    pub fn set(&self, settings: &mut Settings, value: f32) -> Result<(), ConfigError> {
        (self.write)(settings, self.validate(value)?);
        Ok(())
    }
}

/// A hash of the table: with the same one, an index means the same parameter, unit and range.
pub fn fingerprint() -> u32 {
    // FNV-1a.
    let mut hash = 0x811c_9dc5u32;
    let mut add = |bytes: &[u8]| {
        for &byte in bytes {
            hash = (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        }
    };
    for parameter in &TABLE {
        add(&[parameter.id, parameter.version, u8::from(parameter.whole)]);
        add(parameter.name.as_bytes());
        add(&[0]);
        add(parameter.unit.as_bytes());
        add(&parameter.range.0.to_le_bytes());
        add(&parameter.range.1.to_le_bytes());
    }
    hash
}

/// The parameter of a name.
pub fn find(name: &str) -> Option<&'static Parameter> {
    TABLE.iter().find(|parameter| parameter.name == name)
}

fn gauge(list: &PerGauge, i: usize) -> f32 {
    list.padded().get(i).copied().unwrap_or_default()
}

macro_rules! access {
    (number $first:ident $($rest:ident)+) => {
        (
            |settings| settings.$first$(.$rest)+,
            |settings, value| settings.$first$(.$rest)+ = value,
        )
    };
    (count $first:ident $($rest:ident)+) => {
        (
            |settings| settings.$first$(.$rest)+ as f32,
            |settings, value| settings.$first$(.$rest)+ = value as u32,
        )
    };
    (strategy $first:ident $($rest:ident)+) => {
        (
            |settings| settings.$first$(.$rest)+ as u8 as f32,
            |settings, value| {
                settings.$first$(.$rest)+ = match value {
                    0.0 => Strategy::Funnel,
                    _ => Strategy::PaperLaw,
                }
            },
        )
    };
    (mode $first:ident $($rest:ident)+) => {
        (
            |settings| settings.$first$(.$rest)+ as u8 as f32,
            |settings, value| {
                settings.$first$(.$rest)+ = match value {
                    0.0 => Mode::Odometry,
                    1.0 => Mode::Intersection,
                    2.0 => Mode::IntersectionIpec,
                    _ => Mode::Joint,
                }
            },
        )
    };
    (($i:literal) $first:ident $($rest:ident)+) => {
        (
            |settings| gauge(&settings.$first$(.$rest)+, $i),
            |settings, value| settings.$first$(.$rest)+.set($i, value),
        )
    };
}

macro_rules! name {
    (($i:literal) $first:ident $($rest:ident)+) => {
        concat!(stringify!($first) $(, ".", stringify!($rest))+, "[", $i, "]")
    };
    ($kind:ident $first:ident $($rest:ident)+) => {
        concat!(stringify!($first) $(, ".", stringify!($rest))+)
    };
}

macro_rules! is_whole {
    (count) => {
        true
    };
    (strategy) => {
        true
    };
    (mode) => {
        true
    };
    ($other:tt) => {
        false
    };
}

macro_rules! parameters {
    ($($id:literal v $version:literal $kind:tt $first:ident$(.$rest:ident)+, $unit:literal $low:literal to $high:literal: $meaning:literal;)+) => {
        /// Every parameter, in the order of the identifiers.
        pub static TABLE: [Parameter; COUNT] = [
            $({
                type Access = (fn(&Settings) -> f32, fn(&mut Settings, f32));
                const ACCESS: Access = access!($kind $first $($rest)+);
                Parameter {
                    id: $id,
                    version: $version,
                    name: name!($kind $first $($rest)+),
                    unit: $unit,
                    range: ($low, $high),
                    whole: is_whole!($kind),
                    meaning: $meaning,
                    read: ACCESS.0,
                    write: ACCESS.1,
                }
            },)+
        ];

        /// Number of parameters.
        pub const COUNT: usize = [$($id),+].len();
    };
}

parameters! {
    1 v 1 number robot.geometry.wheel_radius_m, "m" 0.01 to 0.5: "radius of the axle's wheels";
    2 v 1 number robot.geometry.half_track_m, "m" 0.02 to 2.0: "half the distance between the axle's wheels";
    3 v 1 count robot.geometry.encoder_counts_per_revolution, "" 16.0 to 1000000.0: "encoder counts per revolution of a wheel";
    4 v 1 number robot.geometry.frame_length_m, "m" 0.05 to 5.0: "flexible length of the frame";
    5 v 1 number robot.geometry.rigid_end_m, "m" 0.0 to 1.0: "rigid length between frame and axle, each end";
    6 v 1 number robot.geometry.half_thickness_m, "m" 0.00005 to 0.02: "distance of the gauges from the neutral axis";
    7 v 1 number robot.geometry.bending_stiffness_n_m2, "N m2" 0.001 to 1000.0: "bending stiffness of the frame";
    8 v 1 number robot.limits.max_speed_m_s, "m/s" 0.01 to 2.0: "largest speed of the midpoint";
    9 v 1 number robot.limits.max_steering_rad, "rad" 0.05 to 1.2: "largest steering angle";
    10 v 1 number robot.limits.steering_margin_rad, "rad" 0.0 to 0.1: "margin of the steering angle that is never commanded";
    11 v 1 number inertial.gyro_gain, "" 0.9 to 1.1: "true yaw rate over measured yaw rate";
    12 v 1 number inertial.accelerometer_gain, "" 0.9 to 1.1: "true acceleration over measured acceleration";
    13 v 1 number robot.axle.controller.longitudinal_gain_per_s, "1/s" 0.0 to 100.0: "gain of the longitudinal error";
    14 v 1 number robot.axle.controller.lateral_gain_rad_m2, "rad/m2" 0.0 to 1000.0: "gain of the lateral error";
    15 v 1 number robot.axle.controller.heading_gain_rad_m, "rad/m" 0.0 to 1000.0: "gain of the heading error";
    16 v 1 number robot.axle.controller.velocity_gain_n_s_m, "N s/m" 1.0 to 10000.0: "gain of the velocity error";
    17 v 1 number robot.axle.controller.yaw_rate_gain_nm_s_rad, "N m s/rad" 0.01 to 1000.0: "gain of the yaw rate error";
    18 v 1 number robot.axle.controller.frame_feedforward, "" 0.0 to 2.0: "share of the frame's load fed forward";
    19 v 1 number robot.axle.controller.inertia_feedforward, "" 0.0 to 2.0: "share of the inertia fed forward";
    20 v 1 number robot.axle.controller.mass_kg, "kg" 0.0 to 100.0: "mass of the axle";
    21 v 1 number robot.axle.controller.yaw_inertia_kg_m2, "kg m2" 0.0 to 10.0: "yaw inertia of the axle";
    22 v 1 number robot.axle.controller.wheel_inertia_kg_m2, "kg m2" 0.0 to 1.0: "inertia of a wheel with its motor";
    23 v 1 number robot.axle.controller.max_torque_nm, "N m" 0.01 to 20.0: "largest torque of a wheel";
    24 v 1 number robot.axle.wheel.bandwidth_rad_s, "rad/s" 10.0 to 2000.0: "bandwidth of the wheel observers";
    25 v 1 number robot.axle.filter.left_sigma_m_s, "m/s" 0.0001 to 1.0: "noise of the left wheel's speed";
    26 v 1 number robot.axle.filter.right_sigma_m_s, "m/s" 0.0001 to 1.0: "noise of the right wheel's speed";
    27 v 1 number robot.axle.filter.gyro_sigma_rad_s, "rad/s" 0.00001 to 1.0: "noise of the gyro";
    28 v 1 number robot.axle.filter.accelerometer_sigma_m_s2, "m/s2" 0.001 to 10.0: "noise of the accelerometer";
    29 v 1 strategy robot.lead.regulator.strategy, "" 0.0 to 1.0: "strategy of posture regulation: 0 planner and funnel, 1 the paper's law alone";
    30 v 1 number robot.lead.governor.max_acceleration_m_s2, "m/s2" 0.01 to 5.0: "largest acceleration";
    31 v 1 number robot.lead.governor.stop_deceleration_m_s2, "m/s2" 0.01 to 10.0: "deceleration of a stop";
    32 v 1 number robot.lead.governor.max_steering_rate_rad_s, "rad/s" 0.05 to 10.0: "largest steering rate";
    33 v 1 number robot.lead.governor.max_steering_acceleration_rad_s2, "rad/s2" 0.1 to 100.0: "largest steering acceleration";
    34 v 1 number robot.lead.governor.max_wheel_speed_m_s, "m/s" 0.02 to 5.0: "largest speed of a wheel over ground";
    35 v 1 number robot.lead.regulator.law.approach_gain_m_s, "m/s" 0.01 to 20.0: "k1 of the paper's law alone";
    36 v 1 number robot.lead.regulator.law.heading_gain_rad_s, "rad/s" 0.01 to 20.0: "k2 of the paper's law alone";
    37 v 1 number robot.lead.regulator.accept_distance_m, "m" 0.003 to 0.5: "distance at which a goal counts as reached";
    38 v 1 number robot.lead.regulator.accept_heading_rad, "rad" 0.001 to 1.0: "heading error at which a goal counts as reached";
    39 v 1 number robot.lead.course.law.approach_gain_m_s, "m/s" 0.01 to 20.0: "approach along a path (k1)";
    40 v 1 number robot.lead.course.law.heading_gain_rad_s, "rad/s" 0.01 to 20.0: "heading along a path (k2)";
    41 v 1 number robot.lead.course.path.nominal_speed_m_s, "m/s" 0.01 to 2.0: "speed along a path";
    42 v 1 number robot.lead.course.path.deceleration_m_s2, "m/s2" 0.01 to 5.0: "deceleration toward bends and the end";
    43 v 1 number robot.geometry.wheel_ratio, "" 0.8 to 1.25: "radius of the right wheel over radius of the left wheel";
    44 v 1 number drive.supply_gain, "" 0.9 to 1.1: "true supply voltage over measured supply voltage";
    45 v 1 number drive.supply_minimum_v, "V" 6.0 to 15.0: "supply below which the robot stops; 3.3 V a cell: 9.9 for three, 13.2 for four";
    46 v 1 number drive.supply_warning_v, "V" 6.0 to 17.0: "supply below which the robot reports a warning; 3.5 V a cell: 10.5 for three, 14.0 for four";
    47 v 1 number drive.supply_maximum_v, "V" 10.0 to 17.6: "supply above which the robot stops; a full pack and 3 %: 13.0 for three cells, 17.4 for four";
    48 v 1 number drive.shunt_ohm, "ohm" 0.001 to 0.1: "shunt in a motor's lead";
    49 v 1 number drive.amplifier_gain, "" 1.0 to 100.0: "gain of the amplifier across the shunt";
    50 v 1 (0) robot.beam.strip.gauges_m, "m" 0.0 to 5.0: "distance of the gauge from the root";
    51 v 1 (1) robot.beam.strip.gauges_m, "m" 0.0 to 5.0: "distance of the gauge from the root";
    52 v 1 (2) robot.beam.strip.gauges_m, "m" 0.0 to 5.0: "distance of the gauge from the root";
    53 v 1 (3) robot.beam.strip.gauges_m, "m" 0.0 to 5.0: "distance of the gauge from the root";
    54 v 1 (4) robot.beam.strip.gauges_m, "m" 0.0 to 5.0: "distance of the gauge from the root";
    58 v 1 number robot.lead.regulator.approach.approach_gain_m_s, "m/s" 0.01 to 20.0: "k1 of the approach in the funnel";
    60 v 1 (0) robot.beam.calibration.zero_counts, "counts" 0.0 to 16777215.0: "reading with the strip straight";
    61 v 1 (1) robot.beam.calibration.zero_counts, "counts" 0.0 to 16777215.0: "reading with the strip straight";
    62 v 1 (2) robot.beam.calibration.zero_counts, "counts" 0.0 to 16777215.0: "reading with the strip straight";
    63 v 1 (3) robot.beam.calibration.zero_counts, "counts" 0.0 to 16777215.0: "reading with the strip straight";
    64 v 1 (4) robot.beam.calibration.zero_counts, "counts" 0.0 to 16777215.0: "reading with the strip straight";
    70 v 1 (0) robot.beam.calibration.gain, "" 0.5 to 2.0: "true strain over measured strain";
    71 v 1 (1) robot.beam.calibration.gain, "" 0.5 to 2.0: "true strain over measured strain";
    72 v 1 (2) robot.beam.calibration.gain, "" 0.5 to 2.0: "true strain over measured strain";
    73 v 1 (3) robot.beam.calibration.gain, "" 0.5 to 2.0: "true strain over measured strain";
    74 v 1 (4) robot.beam.calibration.gain, "" 0.5 to 2.0: "true strain over measured strain";
    80 v 1 number robot.beam.strip.uncertainty.offset_strain, "" 0.0 to 0.01: "uncertainty of each zero";
    81 v 1 number robot.beam.strip.uncertainty.common_offset_strain, "" 0.0 to 0.01: "uncertainty common to all zeros";
    82 v 1 number robot.beam.strip.uncertainty.gain, "" 0.0 to 1.0: "uncertainty of each gain";
    83 v 1 number robot.beam.strip.uncertainty.common_gain, "" 0.0 to 1.0: "uncertainty common to all gains";
    84 v 1 number drive.resistance_ohm, "ohm" 0.05 to 100.0: "resistance of a motor's winding, leads and bridge";
    85 v 1 number drive.inductance_h, "H" 0.00001 to 0.1: "inductance of a motor's winding";
    86 v 1 number drive.torque_constant_nm_a, "N m/A" 0.001 to 1.0: "torque per current of a motor before its gear";
    87 v 1 number drive.gear_ratio, "" 1.0 to 500.0: "turns of a motor in one turn of its wheel";
    88 v 1 number drive.max_current_a, "A" 0.2 to 5.5: "largest current of a motor";
    89 v 1 number drive.thermal_resistance_k_w, "K/W" 0.1 to 100.0: "thermal resistance from winding to ambient";
    90 v 1 number drive.thermal_time_constant_s, "s" 1.0 to 1000.0: "thermal time constant of a winding";
    91 v 1 number drive.winding_max_c, "degC" 70.0 to 180.0: "winding temperature at which the current limit is 0";
    92 v 1 number drive.winding_fold_back_k, "K" 5.0 to 35.0: "span below that temperature in which the current limit falls";
    93 v 1 number drive.driver_max_c, "degC" 60.0 to 150.0: "driver temperature at which the current limit is 0";
    94 v 1 number drive.driver_fold_back_k, "K" 5.0 to 35.0: "span below that temperature in which the current limit falls";
    95 v 1 mode robot.lead.fusion.mode, "" 0.0 to 3.0: "fusion on the front board: 0 odometry (no beam board fitted), 1 intersection, 2 intersection and IPEC, 3 joint filter";
    96 v 1 number button.start.x, "m" -50.0 to 50.0: "start of the button's drive, x";
    97 v 1 number button.start.y, "m" -50.0 to 50.0: "start of the button's drive, y";
    98 v 1 number button.start.phi, "rad" -3.2 to 3.2: "start of the button's drive, heading";
    99 v 1 number button.goal.x, "m" -50.0 to 50.0: "goal of the button's drive, x";
    100 v 1 number button.goal.y, "m" -50.0 to 50.0: "goal of the button's drive, y";
    101 v 1 number button.goal.phi, "rad" -3.2 to 3.2: "goal of the button's drive, heading";
    102 v 1 count button.action, "" 0.0 to 2.0: "button of a robot at rest: 0 latest goal again, the button's if there was none; 1 the button's start and goal; 2 nothing";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_rise_and_names_are_unique() {
        for pair in TABLE.windows(2) {
            assert!(pair[0].id < pair[1].id, "{}", pair[1].name);
        }
        assert!(TABLE[0].id > 0 && TABLE[COUNT - 1].id <= MAX_ID);
        for (i, parameter) in TABLE.iter().enumerate() {
            let at = TABLE.iter().position(|other| other.name == parameter.name);
            assert_eq!(at, Some(i));
            assert_eq!(find(parameter.name).unwrap().id, parameter.id);
        }
        assert!(find("robot.geometry.weight_kg").is_none());
    }

    #[test]
    fn defaults_are_valid_and_each_parameter_is_its_own() {
        let start = Settings::default();
        for parameter in &TABLE {
            let default = parameter.default();
            // An error names the parameter.
            assert_eq!(parameter.validate(default), Ok(default));
            let mut settings = start;
            let (low, high) = parameter.range;
            let other = match parameter.whole {
                true if default == high => default - 1.0,
                true => default + 1.0,
                false => 0.5 * (low + high),
            };
            parameter.set(&mut settings, other).unwrap();
            for each in &TABLE {
                let expected = match each.id == parameter.id {
                    true => other,
                    false => each.default(),
                };
                let (value, by) = (each.get(&settings), parameter.name);
                assert_eq!(value, expected, "{} by {by}", each.name);
            }
        }
    }

    #[test]
    fn what_is_out_of_range_is_refused_by_name_and_changes_nothing() {
        for parameter in &TABLE {
            let (low, high) = parameter.range;
            let start = Settings::default();
            let infinite = [f32::NAN, f32::INFINITY, -f32::INFINITY];
            let outside = [low - 1.0, high * 1.01 + 1.0];
            for bad in infinite.into_iter().chain(outside) {
                let mut settings = start;
                let error = parameter.set(&mut settings, bad).unwrap_err();
                assert_eq!(error.field, parameter.name);
                assert_eq!(settings, start);
            }
            let mut settings = start;
            let refused = parameter.set(&mut settings, 16.5).is_err();
            let outside = !(low..=high).contains(&16.5);
            assert_eq!(refused, parameter.whole || outside);
        }
    }
}
