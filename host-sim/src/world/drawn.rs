//! One robot, drawn from the distributions of a world.

use crate::world::spread::PlantErrors;
use core_algos::beam::MAX_GAUGES;
use serde::Serialize;

/// Errors of one drawn robot, constant within a trial. Axle 0 is the front, wheel 0 the left.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Drawn {
    /// True rolling radius over nominal, by axle and wheel.
    pub wheel_radius_factor: [[f64; 2]; 2],
    /// True track over nominal, by axle.
    pub track_factor: [f64; 2],
    /// True start posture of O minus the intended one: x (m), y (m), heading (rad).
    pub placement: [f64; 3],
    /// Phase of each encoder within a count, in [0, 1).
    pub encoder_phase: [[f64; 2]; 2],
    /// Bias of each gyro at the start as the driver hands it on, rad/s.
    pub gyro_bias: [f64; 2],
    /// Relative error of each gyro's scale factor.
    pub gyro_scale_error: [f64; 2],
    /// Bias of each accelerometer at the start as the driver hands it on, m/s².
    pub accelerometer_bias: [f64; 2],
    /// Relative error of each accelerometer's scale factor.
    pub accelerometer_scale_error: [f64; 2],
    /// Relative error of each bridge's gain.
    pub bridge_gain_error: [f64; MAX_GAUGES],
    /// Unbalance of each bridge when it was zeroed, strain.
    pub bridge_offset: [f64; MAX_GAUGES],
    /// Further offset of each bridge at the start of the trial, strain; what all share included.
    pub bridge_drift: [f64; MAX_GAUGES],
    /// Zero shift of each bridge per kelvin, strain.
    pub bridge_zero_per_k: [f64; MAX_GAUGES],
    /// True place of each gauge along the strip minus the intended one, m: the plant's strain is
    /// to be taken there.
    pub gauge_shift_m: [f64; MAX_GAUGES],
    /// Seed of the nonlinearity of the bridges' converter.
    pub converter: u32,
    /// Creep of the gauges beyond the mean share.
    pub gauge_creep_error: f64,
    /// Errors of the plant's constants.
    pub plant: PlantErrors,
}

impl Drawn {
    /// A robot without any: for tests and comparisons.
    pub fn none() -> Self {
        Self {
            wheel_radius_factor: [[1.0; 2]; 2],
            track_factor: [1.0; 2],
            plant: PlantErrors::none(),
            ..Self::default()
        }
    }
}
