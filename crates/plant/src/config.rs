//! Physical constants of the plant.

use super::per_axle::{MAX_AXLES, PerAxle};
use declare::{Allowed, Checked, ConfigError, Declared, Field, Kind, declare};
use serde::{Deserialize, Serialize};

/// Time by which [`Plant::step`](crate::Plant::step) advances, s: the tick of the robot's boards.
pub const TICK_S: f64 = 1e-3;

/// Law of the tyre's force over its slip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tyre {
    /// Force depends on the slip velocity alone, rolling or not.
    Creep(Creep),
    /// Force depends on slip over rolling speed.
    Brush(Brush),
}

declare! {
    /// A tyre whose force depends on the slip velocity alone.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Creep {
        /// Slip velocity at which the tyre gives half its friction.
        pub velocity_m_s: f64 = 0.01, "m/s": Range(1e-4, 1.0);
    }
}

declare! {
    /// A tyre whose force depends on slip over rolling speed.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Brush {
        /// Slip stiffness C of each wheel's tyre: at small slip, the force is C times the load times slip velocity over
        /// rolling speed.
        pub slip_stiffness: PerAxle<[f64; 2]> = [[20.0; 2]].into(), "": Range(1.0, 300.0);
        /// Slip velocity at which the tyre of a wheel at rest gives half its friction.
        pub rest_velocity_m_s: f64 = 2e-4, "m/s": Range(5e-5, 0.1);
    }
}

impl Default for Tyre {
    fn default() -> Self {
        Self::Creep(Creep::default())
    }
}

impl Declared for Tyre {
    const KIND: Kind = Kind::Table(&[
        Field {
            name: "creep",
            doc: "With the slip velocity alone, rolling or not.",
            kind: Creep::KIND,
        },
        Field {
            name: "brush",
            doc: "With slip over rolling speed.",
            kind: Brush::KIND,
        },
    ]);
}

impl Tyre {
    /// Brush tyres with one slip stiffness for all wheels.
    pub fn brush(stiffness: f64) -> Self {
        Self::Brush(Brush {
            slip_stiffness: [[stiffness; 2]; 1].into(),
            ..Brush::default()
        })
    }

    fn check(&self) -> Result<(), ConfigError> {
        let checked = match self {
            Self::Creep(creep) => creep.check_ranges(),
            Self::Brush(brush) => brush.check_ranges(),
        };
        checked.map_err(|error| ConfigError {
            field: match error.field {
                "slip_stiffness" => "tyre.brush.slip_stiffness",
                "rest_velocity_m_s" => "tyre.brush.rest_velocity_m_s",
                _ => "tyre.creep.velocity_m_s",
            },
            ..error
        })
    }
}

declare! {
    /// Physical constants of the robot, SI units. A list of axles ([`PerAxle`]) holds one entry for
    /// all axles, or one per axle, front first; wheels are left, right. The frames are equal. The source paper gives no
    /// values: all are chosen.
    ///
    /// Defaults: aluminium axles with a spring-steel strip of 50 × 1 mm; sensing fitted; tyres of
    /// constant creep and none of the other imperfections.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct PlantConfig {
        /// Integrator steps in a tick of 1 ms.
        pub substeps: u32 = 1, "": Range(1.0, 100.0);
        /// Largest velocity difference between the first-order and the second-order solution of an undivided step.
        pub tolerance_m_s: f64 = 6.5e-4, "m/s": Range(1e-7, 1.0);
        /// Mass of each axle with its wheels.
        pub mass_kg: PerAxle<f64> = [4.76].into(), "kg": Range(0.1, 1e3);
        /// Mass that the batteries and amplifiers of a frame's strain sensing add to the axle behind the frame.
        pub sensing_mass_kg: f64 = 0.6, "kg": Range(0.0, 1e2);
        /// Yaw inertia of each axle about its midpoint.
        pub yaw_inertia_kg_m2: PerAxle<f64> = [0.0186].into(), "kg m²": Range(1e-4, 1e2);
        /// Half the distance between the wheels of an axle (the paper's d).
        pub half_track_m: PerAxle<f64> = [0.162].into(), "m": Range(0.01, 2.0);
        /// True radius of each wheel (the paper's r_w).
        pub wheel_radius_m: PerAxle<[f64; 2]> = [[0.073; 2]].into(), "m": Range(5e-3, 1.0);
        /// Inertia of a wheel about its axis, gearbox and rotor included.
        pub wheel_inertia_kg_m2: f64 = 0.004, "kg m²": Range(1e-6, 10.0);
        /// Friction coefficient μ between tyre and ground.
        pub friction: f64 = 0.7, "": Range(0.0, 3.0);
        /// Law of the tyre's force over its slip.
        pub tyre: Tyre = Tyre::default();
        /// Excess of friction over μ at vanishing slip velocity, as a share of μ; 0 turns stick-slip off.
        pub static_excess: f64 = 0.0, "": Range(0.0, 1.0);
        /// Slip velocity over which the excess of friction decays.
        pub static_decay_m_s: f64 = 0.05, "m/s": Range(1e-3, 1.0);
        /// Rolling resistance coefficient: resisting torque divided by load times radius.
        pub rolling_resistance: f64 = 0.0, "": Range(0.0, 0.5);
        /// Side slip of each axle that rolls free of force: motion aside, positive to the left, per motion ahead.
        pub side_slip: PerAxle<f64> = [0.0].into(), "": Range(-0.1, 0.1);
        /// Carpet drift of a wheel along x and y of the floor: displacement by the floor per distance rolled.
        pub carpet_drift: [f64; 2] = [0.0; 2], "": Range(-0.1, 0.1);
        /// Relative decrease of the rolling radius at twice the load of the bare robot at rest.
        pub radius_load_sensitivity: f64 = 0.0, "": Range(0.0, 0.1);
        /// Slope of the floor.
        pub slope_rad: f64 = 0.0, "rad": Range(0.0, 0.35);
        /// Direction on the floor in which the slope falls.
        pub downhill_rad: f64 = 0.0, "rad": Range(-10.0, 10.0);
        /// Payload of each axle, a point mass.
        pub payload_kg: PerAxle<f64> = [0.0].into(), "kg": Range(0.0, 1e3);
        /// Position of the payload forward and to the left of the axle's midpoint.
        pub payload_position_m: PerAxle<[f64; 2]> = [[0.0; 2]].into(), "m": Range(-2.0, 2.0);
        /// Height of the centre of mass. Above 0, wheel loads shift with acceleration.
        pub center_of_mass_height_m: f64 = 0.0, "m": Range(0.0, 1.0);
        /// Time constant with which wheel loads follow the acceleration.
        pub load_transfer_time_s: f64 = 0.02, "s": Range(5e-3, 1.0);
        /// Torque of a motor at standstill and full voltage, at the wheel.
        pub stall_torque_n_m: f64 = 2.5, "N m": Range(1e-3, 1e3);
        /// Wheel speed of a motor at full voltage and no load.
        pub no_load_speed_rad_s: f64 = 20.0, "rad/s": Range(0.1, 1e4);
        /// Largest torque that the current loop allows, at the wheel.
        pub torque_limit_n_m: f64 = 2.5, "N m": Range(0.0, 1e3);
        /// Time constant of the current loop: 0 for an ideal loop.
        pub current_loop_time_s: f64 = 0.0, "s": Range(0.0, 1.0);
        /// Backlash of each wheel's gear, from flank to flank at the wheel.
        pub backlash_rad: PerAxle<[f64; 2]> = [[0.0; 2]].into(), "rad": Range(0.0, 0.2);
        /// Share of a wheel's inertia that turns on the motor's side of the backlash.
        pub rotor_inertia_share: f64 = 0.75, "": Range(0.02, 0.98);
        /// Amplitude of the cogging torque at the wheel.
        pub cogging_torque_n_m: f64 = 0.0, "N m": Range(0.0, 10.0);
        /// Periods of the cogging torque in one turn of the wheel.
        pub cogging_periods: f64 = 60.0, "": Range(1.0, 1e5);
        /// Phase of each motor's cogging at the start.
        pub cogging_phase_rad: PerAxle<[f64; 2]> = [[0.0; 2]].into(), "rad": Range(-10.0, 10.0);
        /// Length of the flexible strip (the paper's L).
        pub strip_length_m: f64 = 0.37, "m": Range(0.02, 10.0);
        /// Bending stiffness EI of the strip.
        pub bending_stiffness_n_m2: f64 = 0.833, "N m²": Range(1e-3, 1e4);
        /// Axial stiffness EA of the strip.
        pub axial_stiffness_n: f64 = 1e7, "N": Range(1e3, 1e9);
        /// Internal damping β: damping over stiffness.
        pub internal_damping_s: f64 = 1e-3, "s": Range(0.0, 0.1);
        /// Amplitude of the waviness of the unloaded strip.
        pub natural_slope_rad: f64 = 1e-3, "rad": Range(-0.05, 0.05);
        /// Length of the rigid part between the axle behind a frame and the strip.
        pub rigid_root_m: f64 = 0.0, "m": Range(0.0, 1.0);
        /// Length of the rigid part between the strip and the axle ahead of it.
        pub rigid_tip_m: f64 = 0.0, "m": Range(0.0, 1.0);
        /// Angle of the rear clamp of a frame, and of the strip in it, to the heading of the axle behind.
        pub clamp_angle_root_rad: f64 = 0.0, "rad": Range(-0.2, 0.2);
        /// Angle of the front clamp of a frame to the heading of the axle ahead.
        pub clamp_angle_tip_rad: f64 = 0.0, "rad": Range(-0.2, 0.2);
    }
}

impl PlantConfig {
    /// The constants with an entry for each of `axles` axles, 2 to [`MAX_AXLES`].
    pub fn for_axles(&self, axles: usize) -> Result<Self, ConfigError> {
        Allowed::Range(2.0, MAX_AXLES as f32).check("axles", axles as f32)?;
        let mut config = self.clone();
        macro_rules! spread {
            ($($list:ident)*) => {
                $(config.$list.spread(concat!(stringify!($list), " (number of entries)"), axles)?;)*
            };
        }
        spread! {
            mass_kg yaw_inertia_kg_m2 half_track_m wheel_radius_m side_slip payload_kg payload_position_m
            backlash_rad cogging_phase_rad
        }
        if let Tyre::Brush(brush) = &mut config.tyre {
            let field = "tyre.brush.slip_stiffness (number of entries)";
            brush.slip_stiffness.spread(field, axles)?;
        }
        Ok(config)
    }

    /// Number of axles; the constants must have an entry for each axle.
    pub(super) fn axles(&self) -> usize {
        self.mass_kg.entries().len()
    }

    /// Checks the range of every constant. The strip's bending stiffness and length give the range of its axial
    /// stiffness.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        self.check_ranges()?;
        self.tyre.check()?;
        // A strip as stout as its length is no strip, and its equations would be ill-conditioned.
        let slender = self.bending_stiffness_n_m2 / (self.strip_length_m * self.strip_length_m);
        let allowed = Allowed::Range((1e2 * slender) as f32, (1e9 * slender) as f32);
        self.axial_stiffness_n.check("axial_stiffness_n", allowed)
    }
}
