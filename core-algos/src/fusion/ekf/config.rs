//! Configuration of the axle filter.

use super::{AxleFilter, Covariance, N, Noise};
use crate::config::{Allowed, ConfigError, declare, non_negative, require};
use crate::math::matrix::Mat;

/// Process noise, Q of eq. 17.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ProcessNoise {
    /// Constant matrix per step, in the global frame (units of the state squared).
    Fixed(Mat<N, N>),
    /// Built each step from densities.
    Densities(Densities),
}

declare! {
    /// Noise densities of the motion model. Slip is given along the axle's heading, across it, and in
    /// heading, each per metre driven and per second; the filter turns it into the global frame.
    pub struct Densities {
        /// Slip along the heading that grows with distance.
        pub along_m_per_sqrt_m: f32 = 5e-4, "m/√m": NonNegative;
        /// Slip across the heading that grows with distance.
        pub across_m_per_sqrt_m: f32 = 2e-4, "m/√m": NonNegative;
        /// Slip in heading that grows with distance.
        pub heading_rad_per_sqrt_m: f32 = 2e-3, "rad/√m": NonNegative;
        /// Slip along the heading that grows with time.
        pub along_m_per_sqrt_s: f32 = 1e-5, "m/√s": NonNegative;
        /// Slip across the heading that grows with time.
        pub across_m_per_sqrt_s: f32 = 1e-5, "m/√s": NonNegative;
        /// Slip in heading that grows with time.
        pub heading_rad_per_sqrt_s: f32 = 5e-5, "rad/√s": NonNegative;
        /// Random change of the forward acceleration.
        pub jerk_m_s3_per_sqrt_hz: f32 = 3.0, "m/s³/√Hz": NonNegative;
        /// Random change of the yaw acceleration.
        pub yaw_jerk_rad_s3_per_sqrt_hz: f32 = 150.0, "rad/s³/√Hz": NonNegative;
    }
}

declare! {
    /// Parameters of the axle filter.
    pub struct Config {
        /// Standard deviation of the left wheel's speed.
        pub left_sigma_m_s: f32 = 0.02, "m/s": Range(1e-4, 1e3);
        /// Standard deviation of the right wheel's speed.
        pub right_sigma_m_s: f32 = 0.02, "m/s": Range(1e-4, 1e3);
        /// Standard deviation of the gyro's rate.
        pub gyro_sigma_rad_s: f32 = 0.005, "rad/s": Range(1e-5, 1e3);
        /// Standard deviation of the longitudinal acceleration.
        // Large, so that bias and floor slope (0.5 m/s² at 3°) do not outweigh the two wheels.
        pub accelerometer_sigma_m_s2: f32 = 1.0, "m/s²": Range(1e-3, 1e3);
        /// Process noise.
        pub noise: Densities = Densities::default();
        /// Largest accepted normalised innovation squared (NIS) of a scalar measurement, one degree of freedom.
        /// Without a value, every measurement is accepted.
        pub innovation_gate: Option<f32> = Some(36.0), "": Positive;
        /// Largest accepted NIS of a posture fix (three degrees of freedom). Without a value, every fix is accepted.
        pub fix_gate: Option<f32> = Some(30.0), "": Positive;
        /// Rejections in a row after which the next measurement of a sensor is accepted.
        pub gate_patience: u16 = 20, "": Range(0.0, 65_535.0);
        derived {
            /// Time between two steps (the paper's T).
            pub period_s: f32 = 1e-3, "s": Positive;
            /// Distance between the wheels (twice the paper's d).
            pub track_m: f32 = 0.324, "m": Positive;
        }
    }
}

impl Config {
    /// Builds the filter; an error names the parameter out of range.
    pub fn build(&self) -> Result<AxleFilter, ConfigError> {
        self.noise.check_ranges()?;
        self.build_with(ProcessNoise::Densities(self.noise))
    }

    /// Builds the filter with a process noise other than [`Self::noise`]. A fixed matrix must be symmetric, finite
    /// and free of negative diagonal entries.
    pub fn build_with(&self, noise: ProcessNoise) -> Result<AxleFilter, ConfigError> {
        self.check_ranges()?;
        let square = |x: f32| x * x;
        let t = self.period_s;
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
        let half_track = 0.5 * self.track_m;
        let left_variance = square(self.left_sigma_m_s);
        let right_variance = square(self.right_sigma_m_s);
        let gyro_variance = square(self.gyro_sigma_rad_s);
        let accelerometer_variance = square(self.accelerometer_sigma_m_s2);
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
            always_accepted_nis: self.innovation_gate.unwrap_or(f32::MAX),
            gate: self.innovation_gate,
            fix_gate: self.fix_gate,
            patience: self.gate_patience,
        })
    }
}
