//! Physical constants of the plant.

use serde::{Deserialize, Serialize};
use std::fmt;

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

/// Physical constants of the robot, SI units. Pairs are (front, rear); wheels are
/// `[axle][left, right]`. The source paper gives no values: all are chosen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlantConfig {
    /// Time step, s: 1e-5 to 5e-3.
    pub step_s: f64,
    /// Velocity error of the lower-order solution beyond which a step is divided, m/s.
    pub tolerance_m_s: f64,
    /// Mass of each axle with its wheels, kg.
    pub mass_kg: [f64; 2],
    /// Mass added to the rear axle by the batteries and amplifiers of the strain sensing, kg.
    pub sensing_mass_kg: f64,
    /// Yaw inertia of each axle about its midpoint, kg m².
    pub yaw_inertia_kg_m2: [f64; 2],
    /// Half the distance between the wheels of an axle (the paper's d), m.
    pub half_track_m: [f64; 2],
    /// True radius of each wheel (the paper's r_w), m.
    pub wheel_radius_m: [[f64; 2]; 2],
    /// Inertia of a wheel about its axis, gearbox and rotor included, kg m².
    pub wheel_inertia_kg_m2: f64,
    /// Friction coefficient μ between tyre and ground.
    pub friction: f64,
    /// Law of the tyre's force over its slip: `"creep"` or `"brush"`.
    pub tyre: Tyre,
    /// Slip velocity at which the creep tyre gives half its friction, m/s.
    pub creep_velocity_m_s: f64,
    /// Slip stiffness C of each wheel's brush tyre over its load: force over load for a unit of
    /// slip velocity over rolling speed, where both are small.
    pub slip_stiffness: [[f64; 2]; 2],
    /// Slip velocity at which the brush tyre of a wheel at rest gives half its friction, m/s.
    pub rest_creep_velocity_m_s: f64,
    /// Friction above μ at vanishing slip velocity, as a share of μ: 0 turns slip-stick off.
    pub static_excess: f64,
    /// Slip velocity over which that excess decays, m/s.
    pub static_decay_m_s: f64,
    /// Rolling resistance coefficient: resisting torque over load times radius.
    pub rolling_resistance: f64,
    /// Way aside, to the left, that each axle rolls free of force, over its way ahead.
    pub side_slip: [f64; 2],
    /// Way, along x and y of the floor, that the floor takes a wheel over the way it rolls.
    pub carpet_drift: [f64; 2],
    /// Relative fall of the rolling radius where the load is twice that of the bare robot at rest.
    pub radius_load_sensitivity: f64,
    /// Mass carried by each axle, a point, kg.
    pub payload_kg: [f64; 2],
    /// Position of the payload forward and to the left of the axle's midpoint, m.
    pub payload_position_m: [[f64; 2]; 2],
    /// Height of the centre of mass, m. Above 0, wheel loads shift with acceleration.
    pub center_of_mass_height_m: f64,
    /// Time in which wheel loads follow the acceleration, s.
    pub load_transfer_time_s: f64,
    /// Torque of a motor at standstill and full voltage, at the wheel, N m.
    pub stall_torque_n_m: f64,
    /// Wheel speed of a motor at full voltage and no load, rad/s.
    pub no_load_speed_rad_s: f64,
    /// Largest torque that the current loop allows, at the wheel, N m.
    pub torque_limit_n_m: f64,
    /// Time constant of the current loop, s: 0 for an ideal one.
    pub current_loop_time_s: f64,
    /// Play of each wheel's gear, from flank to flank, rad at the wheel.
    pub backlash_rad: [[f64; 2]; 2],
    /// Share of a wheel's inertia that turns on the motor's side of the play.
    pub rotor_inertia_share: f64,
    /// Amplitude of the cogging torque, N m at the wheel.
    pub cogging_torque_n_m: f64,
    /// Periods of the cogging torque in one turn of the wheel.
    pub cogging_periods: f64,
    /// Phase of each motor's cogging at the start, rad.
    pub cogging_phase_rad: [[f64; 2]; 2],
    /// Length of the flexible strip (the paper's L), m.
    pub strip_length_m: f64,
    /// Bending stiffness EI of the strip, N m².
    pub bending_stiffness_n_m2: f64,
    /// Axial stiffness EA of the strip, N.
    pub axial_stiffness_n: f64,
    /// Internal damping β: damping over stiffness, s.
    pub internal_damping_s: f64,
    /// Amplitude of the waviness of the unloaded strip, rad.
    pub natural_slope_rad: f64,
    /// Rigid part between the rear axle and the strip, m.
    pub rigid_root_m: f64,
    /// Rigid part between the strip and the front axle, m.
    pub rigid_tip_m: f64,
    /// Angle of the rear clamp, and of the strip in it, to the rear axle's heading, rad.
    pub clamp_angle_root_rad: f64,
    /// Angle of the front clamp to the front axle's heading, rad.
    pub clamp_angle_tip_rad: f64,
}

impl Default for PlantConfig {
    /// Aluminium axles with a spring-steel strip of 50 × 1 mm; sensing fitted; tyres of constant
    /// creep and none of the other imperfections.
    fn default() -> Self {
        Self {
            step_s: 1e-3,
            tolerance_m_s: 6.5e-4,
            mass_kg: [4.76; 2],
            sensing_mass_kg: 0.6,
            yaw_inertia_kg_m2: [0.0186; 2],
            half_track_m: [0.162; 2],
            wheel_radius_m: [[0.073; 2]; 2],
            wheel_inertia_kg_m2: 0.004,
            friction: 0.7,
            tyre: Tyre::Creep,
            creep_velocity_m_s: 0.01,
            slip_stiffness: [[20.0; 2]; 2],
            rest_creep_velocity_m_s: 2e-4,
            static_excess: 0.0,
            static_decay_m_s: 0.05,
            rolling_resistance: 0.0,
            side_slip: [0.0; 2],
            carpet_drift: [0.0; 2],
            radius_load_sensitivity: 0.0,
            payload_kg: [0.0; 2],
            payload_position_m: [[0.0; 2]; 2],
            center_of_mass_height_m: 0.0,
            load_transfer_time_s: 0.02,
            stall_torque_n_m: 2.5,
            no_load_speed_rad_s: 20.0,
            torque_limit_n_m: 2.5,
            current_loop_time_s: 0.0,
            backlash_rad: [[0.0; 2]; 2],
            rotor_inertia_share: 0.75,
            cogging_torque_n_m: 0.0,
            cogging_periods: 60.0,
            cogging_phase_rad: [[0.0; 2]; 2],
            strip_length_m: 0.37,
            bending_stiffness_n_m2: 0.833,
            axial_stiffness_n: 1e7,
            internal_damping_s: 1e-3,
            natural_slope_rad: 1e-3,
            rigid_root_m: 0.0,
            rigid_tip_m: 0.0,
            clamp_angle_root_rad: 0.0,
            clamp_angle_tip_rad: 0.0,
        }
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

fn check_pair(field: &str, value: [f64; 2], low: f64, high: f64) -> Result<(), PlantError> {
    for (i, v) in value.into_iter().enumerate() {
        check(&format!("{field}[{i}]"), v, low, high)?;
    }
    Ok(())
}

fn check_wheels(field: &str, value: [[f64; 2]; 2], low: f64, high: f64) -> Result<(), PlantError> {
    for (i, pair) in value.into_iter().enumerate() {
        check_pair(&format!("{field}[{i}]"), pair, low, high)?;
    }
    Ok(())
}

impl PlantConfig {
    /// Checks every constant by itself.
    pub(super) fn check(&self) -> Result<(), PlantError> {
        check("step_s", self.step_s, 1e-5, 5e-3)?;
        check("tolerance_m_s", self.tolerance_m_s, 1e-7, 1.0)?;
        self.check_bodies()?;
        self.check_tyres()?;
        self.check_motors()?;
        self.check_frame()
    }

    fn check_bodies(&self) -> Result<(), PlantError> {
        check_pair("mass_kg", self.mass_kg, 0.1, 1e3)?;
        check("sensing_mass_kg", self.sensing_mass_kg, 0.0, 1e2)?;
        check_pair("yaw_inertia_kg_m2", self.yaw_inertia_kg_m2, 1e-4, 1e2)?;
        check_pair("half_track_m", self.half_track_m, 0.01, 2.0)?;
        check_wheels("wheel_radius_m", self.wheel_radius_m, 5e-3, 1.0)?;
        check("wheel_inertia_kg_m2", self.wheel_inertia_kg_m2, 1e-6, 10.0)?;
        check_pair("payload_kg", self.payload_kg, 0.0, 1e3)?;
        check_wheels("payload_position_m", self.payload_position_m, -2.0, 2.0)?;
        let height = self.center_of_mass_height_m;
        check("center_of_mass_height_m", height, 0.0, 1.0)?;
        check("load_transfer_time_s", self.load_transfer_time_s, 5e-3, 1.0)?;
        Ok(())
    }

    fn check_tyres(&self) -> Result<(), PlantError> {
        check("friction", self.friction, 0.0, 3.0)?;
        check("creep_velocity_m_s", self.creep_velocity_m_s, 1e-4, 1.0)?;
        check_wheels("slip_stiffness", self.slip_stiffness, 1.0, 300.0)?;
        let rest = self.rest_creep_velocity_m_s;
        check("rest_creep_velocity_m_s", rest, 5e-5, 0.1)?;
        check("static_excess", self.static_excess, 0.0, 1.0)?;
        check("static_decay_m_s", self.static_decay_m_s, 1e-3, 1.0)?;
        check("rolling_resistance", self.rolling_resistance, 0.0, 0.5)?;
        check_pair("side_slip", self.side_slip, -0.1, 0.1)?;
        check_pair("carpet_drift", self.carpet_drift, -0.1, 0.1)?;
        let softness = self.radius_load_sensitivity;
        check("radius_load_sensitivity", softness, 0.0, 0.1)?;
        Ok(())
    }

    fn check_motors(&self) -> Result<(), PlantError> {
        check("stall_torque_n_m", self.stall_torque_n_m, 1e-3, 1e3)?;
        check("no_load_speed_rad_s", self.no_load_speed_rad_s, 0.1, 1e4)?;
        check("torque_limit_n_m", self.torque_limit_n_m, 0.0, 1e3)?;
        check("current_loop_time_s", self.current_loop_time_s, 0.0, 1.0)?;
        check_wheels("backlash_rad", self.backlash_rad, 0.0, 0.2)?;
        check("rotor_inertia_share", self.rotor_inertia_share, 0.02, 0.98)?;
        check("cogging_torque_n_m", self.cogging_torque_n_m, 0.0, 10.0)?;
        check("cogging_periods", self.cogging_periods, 1.0, 1e5)?;
        check_wheels("cogging_phase_rad", self.cogging_phase_rad, -10.0, 10.0)?;
        Ok(())
    }

    fn check_frame(&self) -> Result<(), PlantError> {
        let bending = self.bending_stiffness_n_m2;
        check("strip_length_m", self.strip_length_m, 0.02, 10.0)?;
        check("bending_stiffness_n_m2", bending, 1e-3, 1e4)?;
        check("axial_stiffness_n", self.axial_stiffness_n, 1e3, 1e9)?;
        check("internal_damping_s", self.internal_damping_s, 0.0, 0.1)?;
        check("natural_slope_rad", self.natural_slope_rad, -0.05, 0.05)?;
        check("rigid_root_m", self.rigid_root_m, 0.0, 1.0)?;
        check("rigid_tip_m", self.rigid_tip_m, 0.0, 1.0)?;
        let (root, tip) = (self.clamp_angle_root_rad, self.clamp_angle_tip_rad);
        check("clamp_angle_root_rad", root, -0.2, 0.2)?;
        check("clamp_angle_tip_rad", tip, -0.2, 0.2)?;
        // A strip as stout as its length is no strip, and its equations would be ill-conditioned.
        let slender = bending / self.strip_length_m.powi(2);
        check(
            "axial_stiffness_n",
            self.axial_stiffness_n,
            1e2 * slender,
            1e9 * slender,
        )?;
        Ok(())
    }
}
