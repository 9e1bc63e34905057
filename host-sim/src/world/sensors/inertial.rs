//! Yaw-rate gyroscopes and accelerometers.

use super::SAMPLE_RATE_HZ;
use super::delay::{Delay, Drift, MAX_DELAY_MS};
use crate::base::table::table;
use crate::world::normal::standard_normal;
use crate::world::random::SMALL;
use crate::world::random::normal;
use rand_pcg::Pcg64;

/// Declares one channel of a micromechanical inertial sensor.
///
/// `reading = quantised(truth·(1 + scale error) + bias + drift + noise)`, saturated at the range.
/// Defaults: a 6-axis part of the ICM-42688 class. A part of the MPU-6050 class has two to six times the
/// noise and ten times the bias.
macro_rules! channel {
    (
        $(#[$doc:meta])*
        $name:ident, $unit:tt, $walk:tt, $density:tt: $bias_sigma:literal $bias_walk:literal $noise:literal $range:literal
    ) => {
        table! {
            $(#[$doc])*
            #[derive(Copy)]
            pub struct $name {
                /// True if the axles carry the sensor.
                pub fitted: bool = false;
                /// Standard deviation of the bias at power-up.
                pub bias_sigma: f64 = $bias_sigma, $unit: NonNegative;
                /// Averaging time at rest at power-up: the driver takes the mean as bias and subtracts it. At 0 the
                /// driver hands on the raw reading.
                pub rest_average_s: f64 = 1.0, "s": NonNegative;
                /// Time from the average at rest to the start of a trial, while the robot is carried to its mark: the
                /// random walk of the bias goes on.
                pub rest_age_s: f64 = 60.0, "s": NonNegative;
                /// Random walk of the bias.
                pub bias_walk: f64 = $bias_walk, $walk: NonNegative;
                /// One-sided density of the white noise; the bandwidth is half the sample rate.
                pub noise_density: f64 = $noise, $density: NonNegative;
                /// Relative standard deviation of the scale factor.
                pub scale_sigma: f64 = 5e-3, "": Range(0.0, SMALL);
                /// Full scale to either side.
                pub range: f64 = $range, $unit: Positive;
                /// Bits of a reading over the whole range.
                pub bits: u32 = 16, "": Range(2.0, 24.0);
                /// Age of a sample when the board reads it.
                pub delay_ms: u32 = 1, "ms": Range(0.0, MAX_DELAY_MS as f32);
            }
        }

        impl From<$name> for Channel {
            fn from(config: $name) -> Self {
                Self {
                    fitted: config.fitted,
                    bias_sigma: config.bias_sigma,
                    rest_average_s: config.rest_average_s,
                    rest_age_s: config.rest_age_s,
                    bias_walk: config.bias_walk,
                    noise_density: config.noise_density,
                    range: config.range,
                    bits: config.bits,
                    delay_ms: config.delay_ms,
                }
            }
        }
    };
}

channel! {
    /// Yaw-rate gyroscope of an axle.
    Gyro, "rad/s", "rad/s/√s", "rad/s/√Hz": 8.7e-3 5e-5 4.9e-5 4.36
}
channel! {
    /// Longitudinal accelerometer of an axle.
    Accelerometer, "m/s²", "m/s²/√s", "m/s²/√Hz": 0.2 5e-3 6.9e-4 19.6
}

/// Parameters of a gyro or an accelerometer.
#[derive(Clone, Copy)]
pub(super) struct Channel {
    fitted: bool,
    bias_sigma: f64,
    rest_average_s: f64,
    rest_age_s: f64,
    bias_walk: f64,
    noise_density: f64,
    range: f64,
    bits: u32,
    delay_ms: u32,
}

impl Channel {
    /// Standard deviation of the noise in one sample.
    fn noise_sigma(&self) -> f64 {
        self.noise_density * (SAMPLE_RATE_HZ / 2.0).sqrt()
    }

    /// Bias at the start of the trial: the error of the driver's average at rest plus the random walk since then, or
    /// the raw bias if the driver takes no average.
    pub fn draw_bias(&self, random: &mut Pcg64) -> f64 {
        let raw = normal(random, self.bias_sigma);
        let rest = standard_normal(random);
        if self.rest_average_s > 0.0 {
            // White noise averaged over T has an equivalent bandwidth of 1/(2T).
            let averaged = self.noise_density / (2.0 * self.rest_average_s).sqrt();
            rest * libm::hypot(averaged, self.bias_walk * self.rest_age_s.sqrt())
        } else {
            raw
        }
    }
}

/// Gyro or accelerometer of one axle.
#[derive(Clone, Debug)]
pub(super) struct InertialChannel {
    random: Pcg64,
    bias: Drift,
    scale: f64,
    noise_sigma: f64,
    resolution: f64,
    range: f64,
    fitted: bool,
    delay: Delay<f32>,
}

impl InertialChannel {
    pub fn new(config: Channel, bias: f64, scale_error: f64, random: Pcg64) -> Self {
        Self {
            random,
            bias: Drift::new(bias, config.bias_walk),
            scale: 1.0 + scale_error,
            noise_sigma: config.noise_sigma(),
            resolution: 2.0 * config.range / libm::exp2(f64::from(config.bits)),
            range: config.range,
            fitted: config.fitted,
            delay: Delay::new(config.delay_ms),
        }
    }

    /// Draws bias and noise of the next sample.
    fn errors(&mut self) -> (f64, f64) {
        let bias = self.bias.next(&mut self.random);
        (bias, normal(&mut self.random, self.noise_sigma))
    }

    /// Bias of the next sample; zero if the sensor is not fitted. Call either this or [`Self::sample`] in a tick: both
    /// draw the next errors.
    pub fn bias(&mut self) -> f64 {
        if self.fitted { self.errors().0 } else { 0.0 }
    }

    pub fn sample(&mut self, truth: f64) -> Option<f32> {
        if !self.fitted {
            return None;
        }
        let (bias, noise) = self.errors();
        let value = self.scale * truth + bias + noise;
        let value = (value / self.resolution).round() * self.resolution;
        let value = value.clamp(-self.range, self.range - self.resolution);
        Some(self.delay.pass(value as f32))
    }
}
