//! Configuration of the axle filter.

use super::{AxleFilter, Covariance, N, Noise};
use crate::config::{Allowed, ConfigError, non_negative, positive, require};
use crate::math::matrix::Mat;

/// Q of eq. 17.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ProcessNoise {
    /// The same matrix each step, in the global frame (units of the state squared).
    Fixed(Mat<N, N>),
    /// Built each step from densities.
    Densities(Densities),
}

/// Noise densities of the motion model. Slip is given along the axle's heading, across it, and in
/// heading, each per metre driven and per second; the filter turns it into the global frame.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Densities {
    /// Slip along the heading, m/√m.
    pub along_m_per_sqrt_m: f32,
    /// Slip across the heading, m/√m.
    pub across_m_per_sqrt_m: f32,
    /// Slip in heading, rad/√m.
    pub heading_rad_per_sqrt_m: f32,
    /// Slip along the heading, m/√s.
    pub along_m_per_sqrt_s: f32,
    /// Slip across the heading, m/√s.
    pub across_m_per_sqrt_s: f32,
    /// Slip in heading, rad/√s.
    pub heading_rad_per_sqrt_s: f32,
    /// Change of the forward acceleration, m/s³/√Hz.
    pub jerk_m_s3_per_sqrt_hz: f32,
    /// Change of the yaw acceleration, rad/s³/√Hz.
    pub yaw_jerk_rad_s3_per_sqrt_hz: f32,
}

impl Default for Densities {
    fn default() -> Self {
        Self {
            along_m_per_sqrt_m: 5e-4,
            across_m_per_sqrt_m: 2e-4,
            heading_rad_per_sqrt_m: 2e-3,
            along_m_per_sqrt_s: 1e-5,
            across_m_per_sqrt_s: 1e-5,
            heading_rad_per_sqrt_s: 5e-5,
            jerk_m_s3_per_sqrt_hz: 3.0,
            // An axle that steers goes from rest to 36 rad/s² and more at once: with a seventh of this the
            // gate takes the gyro for broken.
            yaw_jerk_rad_s3_per_sqrt_hz: 150.0,
        }
    }
}

/// Parameters of the axle filter.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Config {
    /// Time between two steps (the paper's T), s.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub period_s: f32,
    /// Distance between the wheels (twice the paper's d), m.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub track_m: f32,
    /// Standard deviation of the left wheel's speed, m/s.
    pub left_sigma_m_s: f32,
    /// Standard deviation of the right wheel's speed, m/s.
    pub right_sigma_m_s: f32,
    /// Standard deviation of the gyro's rate, rad/s.
    pub gyro_sigma_rad_s: f32,
    /// Standard deviation of the longitudinal acceleration, m/s².
    pub accelerometer_sigma_m_s2: f32,
    /// Process noise.
    pub noise: Densities,
    /// Largest accepted NIS of a scalar measurement (one degree of freedom); `None` accepts all.
    pub innovation_gate: Option<f32>,
    /// Largest accepted NIS of a posture fix (three degrees of freedom); `None` accepts all.
    pub fix_gate: Option<f32>,
    /// Rejections in a row after which a sensor is believed again.
    pub gate_patience: u16,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            period_s: 1e-3,
            track_m: 0.324,
            left_sigma_m_s: 0.02,
            right_sigma_m_s: 0.02,
            gyro_sigma_rad_s: 0.005,
            // Its bias and the slope of the floor, 0.5 m/s² at 3°, must not outweigh two wheels.
            accelerometer_sigma_m_s2: 1.0,
            noise: Densities::default(),
            innovation_gate: Some(36.0),
            fix_gate: Some(30.0),
            gate_patience: 20,
        }
    }
}

impl Config {
    /// The ready form; an error names the parameter out of range.
    pub fn build(&self) -> Result<AxleFilter, ConfigError> {
        let noise = &self.noise;
        non_negative("along_m_per_sqrt_m", noise.along_m_per_sqrt_m)?;
        non_negative("across_m_per_sqrt_m", noise.across_m_per_sqrt_m)?;
        non_negative("heading_rad_per_sqrt_m", noise.heading_rad_per_sqrt_m)?;
        non_negative("along_m_per_sqrt_s", noise.along_m_per_sqrt_s)?;
        non_negative("across_m_per_sqrt_s", noise.across_m_per_sqrt_s)?;
        non_negative("heading_rad_per_sqrt_s", noise.heading_rad_per_sqrt_s)?;
        non_negative("jerk_m_s3_per_sqrt_hz", noise.jerk_m_s3_per_sqrt_hz)?;
        non_negative(
            "yaw_jerk_rad_s3_per_sqrt_hz",
            noise.yaw_jerk_rad_s3_per_sqrt_hz,
        )?;
        self.build_with(ProcessNoise::Densities(*noise))
    }

    /// The ready form with another process noise than [`Self::noise`]; a fixed matrix must be
    /// symmetric, finite and free of negative diagonal entries.
    pub fn build_with(&self, noise: ProcessNoise) -> Result<AxleFilter, ConfigError> {
        let square = |x: f32| x * x;
        let t = positive("period_s", self.period_s)?;
        if let Some(gate) = self.innovation_gate {
            positive("innovation_gate", gate)?;
        }
        if let Some(gate) = self.fix_gate {
            positive("fix_gate", gate)?;
        }
        let noise = match noise {
            ProcessNoise::Fixed(q) => {
                for i in 0..N {
                    non_negative("process_noise", q[i][i])?;
                    for j in 0..i {
                        require(
                            q[i][j] == q[j][i] && q[i][j].is_finite(),
                            "process_noise",
                            q[i][j],
                            Allowed::Condition("a symmetric matrix of finite numbers"),
                        )?;
                    }
                }
                Noise::Fixed(Covariance::from_matrix(&q).factors())
            }
            ProcessNoise::Densities(d) => Noise::Densities {
                per_m: [
                    square(d.along_m_per_sqrt_m),
                    square(d.across_m_per_sqrt_m),
                    square(d.heading_rad_per_sqrt_m),
                ],
                per_step: [
                    t * square(d.along_m_per_sqrt_s),
                    t * square(d.across_m_per_sqrt_s),
                    t * square(d.heading_rad_per_sqrt_s),
                ],
                jerk: t * square(d.jerk_m_s3_per_sqrt_hz),
                yaw_jerk: t * square(d.yaw_jerk_rad_s3_per_sqrt_hz),
            },
        };
        let half_track = 0.5 * positive("track_m", self.track_m)?;
        let left_variance = square(positive("left_sigma_m_s", self.left_sigma_m_s)?);
        let right_variance = square(positive("right_sigma_m_s", self.right_sigma_m_s)?);
        let gyro_variance = square(positive("gyro_sigma_rad_s", self.gyro_sigma_rad_s)?);
        let accelerometer_variance = square(positive(
            "accelerometer_sigma_m_s2",
            self.accelerometer_sigma_m_s2,
        )?);
        Ok(AxleFilter {
            t,
            half_t2: 0.5 * t * t,
            noise,
            half_track,
            left_variance,
            right_variance,
            gyro_variance,
            reductions: AxleFilter::reductions(
                half_track,
                [left_variance, right_variance, gyro_variance],
            ),
            accelerometer_variance,
            information: [
                left_variance,
                right_variance,
                gyro_variance,
                accelerometer_variance,
            ]
            .map(|variance| 1.0 / variance),
            surely_accepted: self.innovation_gate.unwrap_or(f32::MAX),
            gate: self.innovation_gate,
            fix_gate: self.fix_gate,
            patience: self.gate_patience,
        })
    }
}
