//! Spread of the plant's constants from robot to robot.

use crate::base::table::table;
use crate::world::random::{BOUND, bounded};
use core_algos::topology::Topology;
use plant::{PlantConfig, Tyre};
use rand_pcg::Pcg64;
use serde::Serialize;

table! {
    /// Standard deviations of the plant's constants. Each trial draws its constants once, about the means in
    /// [`PlantConfig`] and within [`BOUND`] standard deviations.
    pub struct Spread {
        /// Standard deviation of the logarithm of each wheel's slip stiffness: 0.3 is ± 30 %.
        pub slip_stiffness: f64 = 0.0, "": Range(0.0, 0.35);
        /// Standard deviation of the strip's bending stiffness, relative.
        pub bending_stiffness: f64 = 0.0, "": Range(0.0, 0.1);
        /// Standard deviation of the strip's length.
        pub strip_length_m: f64 = 0.0, "m": Range(0.0, 0.01);
        /// Standard deviation of each axle's side slip: motion aside per motion ahead.
        pub side_slip: f64 = 0.0, "": Range(0.0, 0.01);
        /// Standard deviation of the carpet drift along each axis of the floor: displacement by the floor per
        /// distance rolled.
        pub carpet_drift: f64 = 0.0, "": Range(0.0, 0.02);
        /// Standard deviation of each gear's backlash, from flank to flank at the wheel; the magnitude of the draw
        /// counts.
        pub backlash_rad: f64 = 0.0, "rad": Range(0.0, 0.02);
        /// Standard deviation of the relative decrease of the rolling radius at twice the load at rest; the magnitude
        /// of the draw counts.
        pub radius_load_sensitivity: f64 = 0.0, "": Range(0.0, 0.01);
    }
}

/// Errors of the plant's constants in one robot.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PlantErrors {
    /// Ratio of each wheel's slip stiffness to the mean.
    pub slip_stiffness_factor: Vec<[f64; 2]>,
    /// Ratio of the bending stiffness to the mean.
    pub bending_stiffness_factor: f64,
    /// Length of the strip minus the mean, m.
    pub strip_length_m: f64,
    /// Side slip of each axle minus the mean.
    pub side_slip: Vec<f64>,
    /// Carpet drift minus the mean, along each axis of the floor.
    pub carpet_drift: [f64; 2],
    /// Backlash of each gear minus the mean, rad.
    pub backlash_rad: Vec<[f64; 2]>,
    /// Load sensitivity of the rolling radii minus the mean.
    pub radius_load_sensitivity: f64,
}

impl PlantErrors {
    /// No errors: the plant as configured.
    pub fn none(topology: Topology) -> Self {
        let axles = topology.axle_count();
        Self {
            slip_stiffness_factor: vec![[1.0; 2]; axles],
            side_slip: vec![0.0; axles],
            backlash_rad: vec![[0.0; 2]; axles],
            bending_stiffness_factor: 1.0,
            ..Self::default()
        }
    }

    /// Adds the errors to a plant of mean constants.
    pub fn apply(&self, plant: &mut PlantConfig) {
        for (drift, error) in plant.carpet_drift.iter_mut().zip(self.carpet_drift) {
            *drift += error;
        }
        for (i, error) in self.side_slip.iter().enumerate() {
            plant.side_slip.entries_mut()[i] += error;
            for j in 0..2 {
                if let Tyre::Brush(brush) = &mut plant.tyre {
                    brush.slip_stiffness.entries_mut()[i][j] *= self.slip_stiffness_factor[i][j];
                }
                plant.backlash_rad.entries_mut()[i][j] += self.backlash_rad[i][j];
            }
        }
        plant.bending_stiffness_n_m2 *= self.bending_stiffness_factor;
        plant.strip_length_m += self.strip_length_m;
        plant.radius_load_sensitivity += self.radius_load_sensitivity;
    }
}

impl Spread {
    /// Draws one robot's errors; the spread only scales the random numbers.
    pub fn draw(&self, topology: Topology, random: &mut Pcg64) -> PlantErrors {
        self.errors(topology, |sigma| bounded(random, sigma))
    }

    /// Errors of the robot whose draws all lie at the lower (-1) or upper (1) bound.
    pub fn extreme(&self, topology: Topology, side: f64) -> PlantErrors {
        self.errors(topology, |sigma| side * BOUND * sigma)
    }

    fn errors(&self, topology: Topology, mut draw: impl FnMut(f64) -> f64) -> PlantErrors {
        let mut drawn = PlantErrors::none(topology);
        for factor in drawn.slip_stiffness_factor.as_flattened_mut() {
            *factor = libm::exp(draw(self.slip_stiffness));
        }
        drawn.bending_stiffness_factor += draw(self.bending_stiffness);
        drawn.strip_length_m = draw(self.strip_length_m);
        for slip in &mut drawn.side_slip {
            *slip = draw(self.side_slip);
        }
        for drift in &mut drawn.carpet_drift {
            *drift = draw(self.carpet_drift);
        }
        for play in drawn.backlash_rad.as_flattened_mut() {
            *play = draw(self.backlash_rad).abs();
        }
        drawn.radius_load_sensitivity = draw(self.radius_load_sensitivity).abs();
        drawn
    }
}
