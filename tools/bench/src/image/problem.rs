//! Filter problem: seven states, measurements of two wheels, gyro and accelerometer.

/// Period of the filter, s.
pub const T: f32 = 0.001;
/// Distance between the wheels, m.
pub const TRACK: f32 = 0.324;
/// Variances of the measurements: left wheel and right wheel, m²/s²; gyro, rad²/s²; accelerometer, m²/s⁴.
pub const R: [f32; 4] = [4e-4, 4e-4, 2.5e-5, 1e-2];
/// Noise density of the slip in any direction (m/√s) and in heading (rad/√s).
pub const SLIP: f32 = 1e-3;
/// Noise density of the jerk, m/s³/√Hz.
pub const JERK: f32 = 1.0;
/// Noise density of the yaw jerk, rad/s³/√Hz.
pub const YAW_JERK: f32 = 6.0;
/// Initial state of the filter.
pub const X0: [f32; 7] = [0.1, -0.2, 0.3, 0.2, 0.1, 0.0, 0.0];
/// Diagonal of the initial covariance.
pub const P0: [f32; 7] = [1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-2, 1e-2];
/// Number of steps of the filter in a run.
pub const STEPS: u32 = 100;

/// Measurements at step `k`: left wheel, right wheel, m/s; gyro, rad/s; accelerometer, m/s².
pub fn measurement(k: u32) -> [f32; 4] {
    let wave = 0.01 * ((k * 37 % 64) as f32 - 32.0) / 32.0;
    let (v, omega) = (0.2 + wave, 0.1 - wave);
    [
        v - 0.5 * TRACK * omega,
        v + 0.5 * TRACK * omega,
        omega,
        wave,
    ]
}
