//! Physical constants of the plant.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::RangeInclusive;

/// Time by which [`Plant::step`](crate::Plant::step) advances, s: the tick of the robot's boards.
pub const TICK_S: f64 = 1e-3;

/// Law of the tyre's force over its slip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tyre {
    /// With the slip velocity alone, rolling or not: [`PlantConfig::creep_velocity_m_s`].
    #[default]
    Creep,
    /// With slip over rolling speed: [`PlantConfig::slip_stiffness`].
    Brush,
}

/// Declares the constants: type, default and allowed range of each number.
macro_rules! constants {
    (
        $(#[$doc:meta])*
        pub struct $name:ident {
            $($(#[$field_doc:meta])* $field:ident: $type:ty = $default:expr $(, $range:expr)?;)*
        }
    ) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }

        impl $name {
            /// Checks every constant by itself.
            fn check_ranges(&self) -> Result<(), PlantError> {
                $($(self.$field.check(stringify!($field), $range)?;)?)*
                Ok(())
            }
        }
    };
}

constants! {
    /// Physical constants of the robot, SI units. Pairs are (front, rear); wheels are
    /// `[axle][left, right]`. The source paper gives no values: all are chosen.
    ///
    /// Defaults: aluminium axles with a spring-steel strip of 50 × 1 mm; sensing fitted; tyres of
    /// constant creep and none of the other imperfections.
    pub struct PlantConfig {
        /// Equal steps into which a tick ([`TICK_S`]) is divided, 1 to 100.
        substeps: u32 = 1, 1.0..=100.0;
        /// Velocity error of the lower-order solution beyond which a step is divided, m/s.
        tolerance_m_s: f64 = 6.5e-4, 1e-7..=1.0;
        /// Mass of each axle with its wheels, kg.
        mass_kg: [f64; 2] = [4.76; 2], 0.1..=1e3;
        /// Mass added to the rear axle by the batteries and amplifiers of the strain sensing, kg.
        sensing_mass_kg: f64 = 0.6, 0.0..=1e2;
        /// Yaw inertia of each axle about its midpoint, kg m².
        yaw_inertia_kg_m2: [f64; 2] = [0.0186; 2], 1e-4..=1e2;
        /// Half the distance between the wheels of an axle (the paper's d), m.
        half_track_m: [f64; 2] = [0.162; 2], 0.01..=2.0;
        /// True radius of each wheel (the paper's r_w), m.
        wheel_radius_m: [[f64; 2]; 2] = [[0.073; 2]; 2], 5e-3..=1.0;
        /// Inertia of a wheel about its axis, gearbox and rotor included, kg m².
        wheel_inertia_kg_m2: f64 = 0.004, 1e-6..=10.0;
        /// Friction coefficient μ between tyre and ground.
        friction: f64 = 0.7, 0.0..=3.0;
        /// Law of the tyre's force over its slip: `"creep"` or `"brush"`.
        tyre: Tyre = Tyre::Creep;
        /// Slip velocity at which the creep tyre gives half its friction, m/s.
        creep_velocity_m_s: f64 = 0.01, 1e-4..=1.0;
        /// Slip stiffness C of each wheel's brush tyre over its load: force over load for a unit of
        /// slip velocity over rolling speed, where both are small.
        slip_stiffness: [[f64; 2]; 2] = [[20.0; 2]; 2], 1.0..=300.0;
        /// Slip velocity at which the brush tyre of a wheel at rest gives half its friction, m/s.
        rest_creep_velocity_m_s: f64 = 2e-4, 5e-5..=0.1;
        /// Friction above μ at vanishing slip velocity, as a share of μ: 0 turns slip-stick off.
        static_excess: f64 = 0.0, 0.0..=1.0;
        /// Slip velocity over which that excess decays, m/s.
        static_decay_m_s: f64 = 0.05, 1e-3..=1.0;
        /// Rolling resistance coefficient: resisting torque over load times radius.
        rolling_resistance: f64 = 0.0, 0.0..=0.5;
        /// Way aside, to the left, that each axle rolls free of force, over its way ahead.
        side_slip: [f64; 2] = [0.0; 2], -0.1..=0.1;
        /// Way, along x and y of the floor, that the floor takes a wheel over the way it rolls.
        carpet_drift: [f64; 2] = [0.0; 2], -0.1..=0.1;
        /// Relative fall of the rolling radius where the load is twice that of the bare robot at rest.
        radius_load_sensitivity: f64 = 0.0, 0.0..=0.1;
        /// Slope of the floor, rad.
        slope_rad: f64 = 0.0, 0.0..=0.35;
        /// Direction on the floor in which it falls, rad.
        downhill_rad: f64 = 0.0, -10.0..=10.0;
        /// Mass carried by each axle, a point, kg.
        payload_kg: [f64; 2] = [0.0; 2], 0.0..=1e3;
        /// Position of the payload forward and to the left of the axle's midpoint, m.
        payload_position_m: [[f64; 2]; 2] = [[0.0; 2]; 2], -2.0..=2.0;
        /// Height of the centre of mass, m. Above 0, wheel loads shift with acceleration.
        center_of_mass_height_m: f64 = 0.0, 0.0..=1.0;
        /// Time in which wheel loads follow the acceleration, s.
        load_transfer_time_s: f64 = 0.02, 5e-3..=1.0;
        /// Torque of a motor at standstill and full voltage, at the wheel, N m.
        stall_torque_n_m: f64 = 2.5, 1e-3..=1e3;
        /// Wheel speed of a motor at full voltage and no load, rad/s.
        no_load_speed_rad_s: f64 = 20.0, 0.1..=1e4;
        /// Largest torque that the current loop allows, at the wheel, N m.
        torque_limit_n_m: f64 = 2.5, 0.0..=1e3;
        /// Time constant of the current loop, s: 0 for an ideal one.
        current_loop_time_s: f64 = 0.0, 0.0..=1.0;
        /// Play of each wheel's gear, from flank to flank, rad at the wheel.
        backlash_rad: [[f64; 2]; 2] = [[0.0; 2]; 2], 0.0..=0.2;
        /// Share of a wheel's inertia that turns on the motor's side of the play.
        rotor_inertia_share: f64 = 0.75, 0.02..=0.98;
        /// Amplitude of the cogging torque, N m at the wheel.
        cogging_torque_n_m: f64 = 0.0, 0.0..=10.0;
        /// Periods of the cogging torque in one turn of the wheel.
        cogging_periods: f64 = 60.0, 1.0..=1e5;
        /// Phase of each motor's cogging at the start, rad.
        cogging_phase_rad: [[f64; 2]; 2] = [[0.0; 2]; 2], -10.0..=10.0;
        /// Length of the flexible strip (the paper's L), m.
        strip_length_m: f64 = 0.37, 0.02..=10.0;
        /// Bending stiffness EI of the strip, N m².
        bending_stiffness_n_m2: f64 = 0.833, 1e-3..=1e4;
        /// Axial stiffness EA of the strip, N.
        axial_stiffness_n: f64 = 1e7, 1e3..=1e9;
        /// Internal damping β: damping over stiffness, s.
        internal_damping_s: f64 = 1e-3, 0.0..=0.1;
        /// Amplitude of the waviness of the unloaded strip, rad.
        natural_slope_rad: f64 = 1e-3, -0.05..=0.05;
        /// Rigid part between the rear axle and the strip, m.
        rigid_root_m: f64 = 0.0, 0.0..=1.0;
        /// Rigid part between the strip and the front axle, m.
        rigid_tip_m: f64 = 0.0, 0.0..=1.0;
        /// Angle of the rear clamp, and of the strip in it, to the rear axle's heading, rad.
        clamp_angle_root_rad: f64 = 0.0, -0.2..=0.2;
        /// Angle of the front clamp to the front axle's heading, rad.
        clamp_angle_tip_rad: f64 = 0.0, -0.2..=0.2;
    }
}

/// A constant of the plant outside its range.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantError {
    /// Name of the constant, as it stands in the configuration file.
    pub field: String,
    /// The value that was refused.
    pub value: f64,
    /// Smallest and largest value allowed.
    pub range: (f64, f64),
}

impl fmt::Display for PlantError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (low, high) = self.range;
        write!(
            f,
            "{} = {}: must be a number from {low} to {high}",
            self.field, self.value
        )
    }
}

impl std::error::Error for PlantError {}

/// Returns `value` if it lies within `low` and `high`.
pub(super) fn check(field: &str, value: f64, low: f64, high: f64) -> Result<f64, PlantError> {
    if value >= low && value <= high {
        Ok(value)
    } else {
        Err(PlantError {
            field: field.to_owned(),
            value,
            range: (low, high),
        })
    }
}

/// A constant, or one for each axle or wheel.
trait Constant {
    fn check(&self, field: &str, range: RangeInclusive<f64>) -> Result<(), PlantError>;
}

impl Constant for u32 {
    fn check(&self, field: &str, range: RangeInclusive<f64>) -> Result<(), PlantError> {
        f64::from(*self).check(field, range)
    }
}

impl Constant for f64 {
    fn check(&self, field: &str, range: RangeInclusive<f64>) -> Result<(), PlantError> {
        check(field, *self, *range.start(), *range.end()).map(drop)
    }
}

impl<C: Constant> Constant for [C; 2] {
    fn check(&self, field: &str, range: RangeInclusive<f64>) -> Result<(), PlantError> {
        let mut entries = self.iter().enumerate();
        entries.try_for_each(|(i, entry)| entry.check(&format!("{field}[{i}]"), range.clone()))
    }
}

impl PlantConfig {
    /// Checks every constant.
    pub(super) fn check(&self) -> Result<(), PlantError> {
        self.check_ranges()?;
        // A strip as stout as its length is no strip, and its equations would be ill-conditioned.
        let slender = self.bending_stiffness_n_m2 / (self.strip_length_m * self.strip_length_m);
        let allowed = 1e2 * slender..=1e9 * slender;
        self.axial_stiffness_n.check("axial_stiffness_n", allowed)
    }
}
