//! Table of stored parameters. Unit, range and meaning come from the declaration of [`Settings`].
//!
//! An identifier is the key in the store and is never given to another parameter. A version goes up
//! when the meaning of a value changes; values of other versions are not used.

use super::Press;
use super::Settings;
use crate::beam::PerGauge;
use crate::config::{Allowed, ConfigError, in_range, require};
use crate::control::regulator::Strategy;
use crate::fusion::robot::Mode;
use declare::{Choice, Field, Kind, field_at, find as find_field};

/// Row of the table: a parameter that a board can store.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Key in the store, 1 to [`MAX_ID`].
    pub id: u8,
    /// Version of the parameter's meaning.
    pub version: u8,
    /// Name: path in [`Settings`]; names below `robot` are also keys of a scenario.
    pub name: &'static str,
    /// Unit; empty for a pure number.
    pub unit: &'static str,
    /// Smallest and largest allowed value.
    pub range: (f32, f32),
    /// True if only whole numbers are allowed.
    pub whole: bool,
    read: fn(&Settings) -> f32,
    write: fn(&mut Settings, f32),
}

/// Largest identifier (key in the store) of a parameter.
pub const MAX_ID: u8 = 191;

impl Parameter {
    /// Value of the parameter in `settings`.
    pub fn get(&self, settings: &Settings) -> f32 {
        (self.read)(settings)
    }

    /// Value of the parameter in the default settings.
    pub fn default(&self) -> f32 {
        self.get(&Settings::default())
    }

    /// First sentence of the parameter's meaning.
    pub fn meaning(&self) -> &'static str {
        self.field().map_or("", Field::summary)
    }

    /// First sentence of the meaning of the table that holds the parameter; empty if the table has none.
    pub fn table_meaning(&self) -> &'static str {
        let table = self.name.rsplit_once('.').map_or("", |(table, _)| table);
        match find_field(Settings::FIELDS, table) {
            Some(field) => field.summary(),
            None => "",
        }
    }

    /// Names of the values 0, 1, … of an enumeration; empty for a number.
    pub fn choices(&self) -> &'static [Choice] {
        match self.field().map(|field| field.kind) {
            Some(Kind::Choice(choices)) => choices,
            _ => &[],
        }
    }

    fn field(&self) -> Option<&'static Field> {
        let place = TABLE.iter().position(|other| other.id == self.id)?;
        FIELDS.get(place)
    }

    /// Refuses NaN, values out of range and fractions of a whole number; the error names the parameter.
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

    /// Sets the value in `settings`; changes nothing on an error.
    pub fn set(&self, settings: &mut Settings, value: f32) -> Result<(), ConfigError> {
        (self.write)(settings, self.validate(value)?);
        Ok(())
    }
}

/// Hash of the table: with equal hashes, an index means the same parameter, unit and range.
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

/// Parameter with this name; `None` if no parameter has the name.
pub fn find(name: &str) -> Option<&'static Parameter> {
    TABLE.iter().find(|parameter| parameter.name == name)
}

fn gauge(list: &PerGauge, i: usize) -> f32 {
    list.padded().get(i).copied().unwrap_or_default()
}

macro_rules! access {
    (number $($path:ident).+) => {
        (
            |settings| settings.$($path).+,
            |settings, value| settings.$($path).+ = value,
        )
    };
    (count $($path:ident).+) => {
        (
            |settings| settings.$($path).+ as f32,
            |settings, value| settings.$($path).+ = value as u32,
        )
    };
    (($i:literal) $($path:ident).+) => {
        (
            |settings| gauge(&settings.$($path).+, $i),
            |settings, value| settings.$($path).+.set($i, value),
        )
    };
    ($choice:ident $($path:ident).+) => {
        (
            |settings| settings.$($path).+ as u8 as f32,
            |settings, value| {
                if let Some(&choice) = $choice::ALL.get(value as usize) {
                    settings.$($path).+ = choice;
                }
            },
        )
    };
}

/// Path with dots and without spaces; `stringify!` of a whole path sets spaces around the dots.
macro_rules! path {
    ($first:ident $(.$rest:ident)*) => {
        concat!(stringify!($first) $(, ".", stringify!($rest))*)
    };
}

macro_rules! name {
    (($i:literal) $($path:ident).+) => {
        concat!(path!($($path).+), "[", $i, "]")
    };
    ($kind:ident $($path:ident).+) => {
        path!($($path).+)
    };
}

macro_rules! parameters {
    ($($id:literal v $version:literal $kind:tt $($path:ident).+;)+) => {
        /// Every parameter, in the order of the identifiers.
        pub static TABLE: [Parameter; COUNT] = [
            $({
                type Access = (fn(&Settings) -> f32, fn(&mut Settings, f32));
                const ACCESS: Access = access!($kind $($path).+);
                const FIELD: Field = field_at(Settings::FIELDS, path!($($path).+));
                const NUMBERS: Numbers = Numbers::of(FIELD.kind);
                Parameter {
                    id: $id,
                    version: $version,
                    name: name!($kind $($path).+),
                    unit: NUMBERS.unit,
                    range: NUMBERS.range,
                    whole: NUMBERS.whole,
                    read: ACCESS.0,
                    write: ACCESS.1,
                }
            },)+
        ];

        /// Declarations of the parameters, in the order of the table. Separate from the table, so that firmware does
        /// not contain them.
        static FIELDS: [Field; COUNT] = [
            $(field_at(Settings::FIELDS, path!($($path).+)),)+
        ];

        /// Number of parameters.
        pub const COUNT: usize = [$($id),+].len();
    };
}

/// Unit and allowed values of a declared key.
struct Numbers {
    unit: &'static str,
    range: (f32, f32),
    whole: bool,
}

impl Numbers {
    /// Unit and allowed values of a declaration; panics at compile time for a number without two bounds.
    const fn of(kind: Kind) -> Self {
        match kind {
            Kind::Number {
                unit,
                allowed: Allowed::Range(low, high),
                whole,
            } => Self {
                unit,
                range: (low, high),
                whole,
            },
            Kind::Choice(choices) => Self {
                unit: "",
                range: (0.0, (choices.len() - 1) as f32),
                whole: true,
            },
            _ => panic!("a parameter is a number with two bounds or a choice"),
        }
    }
}

parameters! {
    1 v 1 number robot.geometry.wheel_radius_m;
    2 v 1 number robot.geometry.half_track_m;
    3 v 1 count robot.geometry.encoder_counts_per_revolution;
    4 v 1 number robot.geometry.frame_length_m;
    5 v 1 number robot.geometry.rigid_end_m;
    6 v 1 number robot.geometry.half_thickness_m;
    7 v 1 number robot.geometry.bending_stiffness_n_m2;
    8 v 1 number robot.limits.max_speed_m_s;
    9 v 1 number robot.limits.max_steering_rad;
    10 v 1 number robot.limits.steering_margin_rad;
    11 v 1 number inertial.gyro_gain;
    12 v 1 number inertial.accelerometer_gain;
    13 v 1 number robot.axle.controller.longitudinal_gain_per_s;
    14 v 1 number robot.axle.controller.lateral_gain_rad_m2;
    15 v 1 number robot.axle.controller.heading_gain_rad_m;
    16 v 1 number robot.axle.controller.velocity_gain_n_s_m;
    17 v 1 number robot.axle.controller.yaw_rate_gain_nm_s_rad;
    18 v 1 number robot.axle.controller.frame_feedforward;
    19 v 1 number robot.axle.controller.inertia_feedforward;
    20 v 1 number robot.axle.controller.mass_kg;
    21 v 1 number robot.axle.controller.yaw_inertia_kg_m2;
    22 v 1 number robot.axle.controller.wheel_inertia_kg_m2;
    23 v 1 number robot.axle.controller.max_torque_nm;
    24 v 1 number robot.axle.wheel.bandwidth_rad_s;
    25 v 1 number robot.axle.filter.left_sigma_m_s;
    26 v 1 number robot.axle.filter.right_sigma_m_s;
    27 v 1 number robot.axle.filter.gyro_sigma_rad_s;
    28 v 1 number robot.axle.filter.accelerometer_sigma_m_s2;
    29 v 1 Strategy robot.lead.regulator.strategy;
    30 v 1 number robot.lead.governor.max_acceleration_m_s2;
    31 v 1 number robot.lead.governor.stop_deceleration_m_s2;
    32 v 1 number robot.lead.governor.max_steering_rate_rad_s;
    33 v 1 number robot.lead.governor.max_steering_acceleration_rad_s2;
    34 v 1 number robot.lead.governor.max_wheel_speed_m_s;
    35 v 1 number robot.lead.regulator.law.approach_gain_m_s;
    36 v 1 number robot.lead.regulator.law.heading_gain_rad_s;
    37 v 1 number robot.lead.regulator.accept_distance_m;
    38 v 1 number robot.lead.regulator.accept_heading_rad;
    39 v 1 number robot.lead.course.law.approach_gain_m_s;
    40 v 1 number robot.lead.course.law.heading_gain_rad_s;
    41 v 1 number robot.lead.course.path.nominal_speed_m_s;
    42 v 1 number robot.lead.course.path.deceleration_m_s2;
    43 v 1 number robot.geometry.wheel_ratio;
    44 v 1 number drive.supply_gain;
    45 v 1 number drive.supply_minimum_v;
    46 v 1 number drive.supply_warning_v;
    47 v 1 number drive.supply_maximum_v;
    48 v 1 number drive.shunt_ohm;
    49 v 1 number drive.amplifier_gain;
    50 v 1 (0) robot.beam.strip.gauges_m;
    51 v 1 (1) robot.beam.strip.gauges_m;
    52 v 1 (2) robot.beam.strip.gauges_m;
    53 v 1 (3) robot.beam.strip.gauges_m;
    54 v 1 (4) robot.beam.strip.gauges_m;
    58 v 1 number robot.lead.regulator.approach.approach_gain_m_s;
    60 v 1 (0) robot.beam.calibration.zero_counts;
    61 v 1 (1) robot.beam.calibration.zero_counts;
    62 v 1 (2) robot.beam.calibration.zero_counts;
    63 v 1 (3) robot.beam.calibration.zero_counts;
    64 v 1 (4) robot.beam.calibration.zero_counts;
    70 v 1 (0) robot.beam.calibration.gain;
    71 v 1 (1) robot.beam.calibration.gain;
    72 v 1 (2) robot.beam.calibration.gain;
    73 v 1 (3) robot.beam.calibration.gain;
    74 v 1 (4) robot.beam.calibration.gain;
    80 v 1 number robot.beam.strip.uncertainty.offset_strain;
    81 v 1 number robot.beam.strip.uncertainty.common_offset_strain;
    82 v 1 number robot.beam.strip.uncertainty.gain;
    83 v 1 number robot.beam.strip.uncertainty.common_gain;
    84 v 1 number drive.resistance_ohm;
    85 v 1 number drive.inductance_h;
    86 v 1 number drive.torque_constant_nm_a;
    87 v 1 number drive.gear_ratio;
    88 v 1 number drive.max_current_a;
    89 v 1 number drive.thermal_resistance_k_w;
    90 v 1 number drive.thermal_time_constant_s;
    91 v 1 number drive.winding_max_c;
    92 v 1 number drive.winding_fold_back_k;
    93 v 1 number drive.driver_max_c;
    94 v 1 number drive.driver_fold_back_k;
    95 v 1 Mode robot.lead.fusion.mode;
    96 v 1 number button.start.x;
    97 v 1 number button.start.y;
    98 v 1 number button.start.phi;
    99 v 1 number button.goal.x;
    100 v 1 number button.goal.y;
    101 v 1 number button.goal.phi;
    102 v 1 Press button.action;
    103 v 1 count robot.geometry.axles;
    104 v 1 count board.place;
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
    fn defaults_are_valid_and_set_changes_only_its_parameter() {
        let start = Settings::default();
        for parameter in &TABLE {
            let default = parameter.default();
            // A failure of this assertion names the parameter.
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
    fn value_out_of_range_is_refused_by_name_and_changes_nothing() {
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
