//! How the plant's constants differ from robot to robot.

use crate::plant::PlantConfig;
use crate::world::sensors::normal;
use core_algos::config::{ConfigError, in_range};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

/// Standard deviations of the plant's constants about those of [`PlantConfig`], drawn a trial.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Spread {
    /// Of the logarithm of each wheel's slip stiffness: 0.3 is ± 30 %.
    pub slip_stiffness: f64,
    /// Of the strip's bending stiffness, relative.
    pub bending_stiffness: f64,
    /// Of the strip's length, m.
    pub strip_length_m: f64,
    /// Of the way aside that each axle rolls, over its way ahead.
    pub side_slip: f64,
    /// Of the way that the floor takes the robot over the way it rolls, along each axis of the floor.
    pub carpet_drift: f64,
    /// Of each gear's play from flank to flank, rad at the wheel; the play is the draw's magnitude.
    pub backlash_rad: f64,
    /// Of the rolling radius' fall where the load is twice that at rest, relative; the magnitude counts.
    pub radius_load_sensitivity: f64,
}

/// What the plant's constants are off by in one robot.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlantErrors {
    /// Slip stiffness of each wheel over the mean.
    pub slip_stiffness_factor: [[f64; 2]; 2],
    /// Bending stiffness over the mean.
    pub bending_stiffness_factor: f64,
    /// Length of the strip less the mean, m.
    pub strip_length_m: f64,
    /// Side slip of each axle beyond the mean.
    pub side_slip: [f64; 2],
    /// Carpet drift beyond the mean.
    pub carpet_drift: [f64; 2],
    /// Play of each gear beyond the mean, rad.
    pub backlash_rad: [[f64; 2]; 2],
    /// Load sensitivity of the radii beyond the mean.
    pub radius_load_sensitivity: f64,
}

impl PlantErrors {
    /// A plant as it is configured.
    pub const NONE: Self = Self {
        slip_stiffness_factor: [[1.0; 2]; 2],
        bending_stiffness_factor: 1.0,
        strip_length_m: 0.0,
        side_slip: [0.0; 2],
        carpet_drift: [0.0; 2],
        backlash_rad: [[0.0; 2]; 2],
        radius_load_sensitivity: 0.0,
    };

    /// Makes a plant this one.
    pub fn apply(&self, plant: &mut PlantConfig) {
        for i in 0..2 {
            plant.side_slip[i] += self.side_slip[i];
            plant.carpet_drift[i] += self.carpet_drift[i];
            for j in 0..2 {
                plant.slip_stiffness[i][j] *= self.slip_stiffness_factor[i][j];
                plant.backlash_rad[i][j] += self.backlash_rad[i][j];
            }
        }
        plant.bending_stiffness_n_m2 *= self.bending_stiffness_factor;
        plant.strip_length_m += self.strip_length_m;
        plant.radius_load_sensitivity += self.radius_load_sensitivity;
    }
}

impl Spread {
    /// Checks every value: a draw of eight standard deviations must leave a plant that can be.
    pub fn check(&self) -> Result<(), ConfigError> {
        for (field, value, most) in [
            ("spread.slip_stiffness", self.slip_stiffness, 0.35),
            ("spread.bending_stiffness", self.bending_stiffness, 0.1),
            ("spread.strip_length_m", self.strip_length_m, 0.01),
            ("spread.side_slip", self.side_slip, 0.01),
            ("spread.carpet_drift", self.carpet_drift, 0.02),
            ("spread.backlash_rad", self.backlash_rad, 0.02),
            (
                "spread.radius_load_sensitivity",
                self.radius_load_sensitivity,
                0.01,
            ),
        ] {
            in_range(field, value as f32, 0.0, most)?;
        }
        Ok(())
    }

    /// One robot's errors; the same numbers whatever the spread.
    pub fn draw(&self, random: &mut Pcg64) -> PlantErrors {
        let mut drawn = PlantErrors::NONE;
        for factor in drawn.slip_stiffness_factor.as_flattened_mut() {
            *factor = normal(random, self.slip_stiffness).exp();
        }
        drawn.bending_stiffness_factor += normal(random, self.bending_stiffness);
        drawn.strip_length_m = normal(random, self.strip_length_m);
        for slip in &mut drawn.side_slip {
            *slip = normal(random, self.side_slip);
        }
        for drift in &mut drawn.carpet_drift {
            *drift = normal(random, self.carpet_drift);
        }
        for play in drawn.backlash_rad.as_flattened_mut() {
            *play = normal(random, self.backlash_rad).abs();
        }
        drawn.radius_load_sensitivity = normal(random, self.radius_load_sensitivity).abs();
        drawn
    }
}
