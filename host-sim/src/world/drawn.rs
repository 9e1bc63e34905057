//! One robot, drawn from the distributions of a world.

use crate::world::spread::PlantErrors;
use core_algos::beam::MAX_GAUGES;
use core_algos::topology::Topology;
use serde::Serialize;

/// Errors of one drawn robot, constant within a trial. Lists by axle and by frame begin at the front; wheel 0 is the
/// left wheel.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Drawn {
    /// True rolling radius over nominal, by axle and wheel.
    pub wheel_radius_factor: Vec<[f64; 2]>,
    /// Ratio of true to nominal track, by axle.
    pub track_factor: Vec<f64>,
    /// True minus intended start posture of O: x (m), y (m), heading (rad).
    pub placement: [f64; 3],
    /// Phase of each encoder within a count, in [0, 1), by axle and wheel.
    pub encoder_phase: Vec<[f64; 2]>,
    /// Bias of each axle's gyro at the start of the trial, in the driver's output, rad/s.
    pub gyro_bias: Vec<f64>,
    /// Relative error of the scale factor of each axle's gyro.
    pub gyro_scale_error: Vec<f64>,
    /// Bias of each axle's accelerometer at the start of the trial, in the driver's output, m/s².
    pub accelerometer_bias: Vec<f64>,
    /// Relative error of the scale factor of each axle's accelerometer.
    pub accelerometer_scale_error: Vec<f64>,
    /// Errors of each frame's bridges.
    pub frames: Vec<FrameErrors>,
    /// Creep of the gauges minus its mean, share of the strain.
    pub gauge_creep_error: f64,
    /// Errors of the plant's constants.
    pub plant: PlantErrors,
}

/// Errors of the strain bridges of one frame, by gauge from the root.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FrameErrors {
    /// Relative error of each bridge's gain.
    pub bridge_gain_error: [f64; MAX_GAUGES],
    /// Unbalance of each bridge at zeroing, strain.
    pub bridge_offset: [f64; MAX_GAUGES],
    /// Drift of each bridge from zeroing to the start of the trial, strain; includes the error common to all bridges.
    pub bridge_drift: [f64; MAX_GAUGES],
    /// Zero shift of each bridge per kelvin, strain.
    pub bridge_zero_per_k: [f64; MAX_GAUGES],
    /// Position error of each gauge along the strip, true minus nominal, m. The plant's strain is sampled at the true
    /// position.
    pub gauge_shift_m: [f64; MAX_GAUGES],
    /// Seed of the nonlinearity of the bridges' converter.
    pub converter: u32,
}

impl Drawn {
    /// Robot without errors, for tests and comparisons.
    pub fn none(topology: Topology) -> Self {
        let axles = topology.axle_count();
        Self {
            wheel_radius_factor: vec![[1.0; 2]; axles],
            track_factor: vec![1.0; axles],
            encoder_phase: vec![[0.0; 2]; axles],
            gyro_bias: vec![0.0; axles],
            gyro_scale_error: vec![0.0; axles],
            accelerometer_bias: vec![0.0; axles],
            accelerometer_scale_error: vec![0.0; axles],
            frames: vec![FrameErrors::default(); topology.frame_count()],
            plant: PlantErrors::none(topology),
            ..Self::default()
        }
    }
}
