//! Yaw-rate gyroscopes and accelerometers.

use super::SAMPLE_RATE_HZ;
use super::delay::{Delay, Drift};
use crate::world::normal::standard_normal;
use crate::world::random::normal;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

/// Marks the yaw-rate channel of [`InertialConfig`]: rad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gyro;
/// Marks the longitudinal-acceleration channel of [`InertialConfig`]: m/s².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Accelerometer;

/// One channel of a micromechanical inertial sensor; `u` is rad/s for [`Gyro`], m/s² for
/// [`Accelerometer`].
///
/// `reading = quantised(truth·(1 + scale error) + bias + drift + noise)`, saturated at the range.
/// The defaults are those of a present 6-axis part of the ICM-42688 class; an older one of the
/// MPU-6050 class has twice to six times the noise and ten times the bias.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default, bound = "InertialConfig<Kind>: Default")]
pub struct InertialConfig<Kind> {
    /// True if the axles carry the sensor.
    pub fitted: bool,
    /// Standard deviation of the bias at power-up, u.
    pub bias_sigma: f64,
    /// Time at rest over which the driver averages at power-up and takes the mean as bias, s; 0
    /// hands the raw reading on.
    pub rest_average_s: f64,
    /// Time from that average to the start of a trial, s: the bias walks on while the robot is
    /// carried to its mark and set down.
    pub rest_age_s: f64,
    /// Random walk of the bias, u/√s.
    pub bias_walk: f64,
    /// White noise, u/√Hz, one-sided density; half the sample rate is the bandwidth.
    pub noise_density: f64,
    /// Relative standard deviation of the scale factor.
    pub scale_sigma: f64,
    /// Full scale to either side, u.
    pub range: f64,
    /// Bits of a reading over the whole range.
    pub bits: u32,
    /// Age of a sample when the board has it, ms.
    pub delay_ms: u32,
    #[serde(skip)]
    kind: Kind,
}

impl Default for InertialConfig<Gyro> {
    fn default() -> Self {
        Self::of(Gyro, 8.7e-3, 5e-5, 4.9e-5, 4.36)
    }
}

impl Default for InertialConfig<Accelerometer> {
    fn default() -> Self {
        Self::of(Accelerometer, 0.2, 5e-3, 6.9e-4, 19.6)
    }
}

impl<Kind> InertialConfig<Kind> {
    fn of(kind: Kind, bias_sigma: f64, bias_walk: f64, noise_density: f64, range: f64) -> Self {
        Self {
            fitted: false,
            bias_sigma,
            rest_average_s: 1.0,
            rest_age_s: 60.0,
            bias_walk,
            noise_density,
            scale_sigma: 5e-3,
            range,
            bits: 16,
            delay_ms: 1,
            kind,
        }
    }

    /// Standard deviation of one sample's noise.
    fn noise_sigma(&self) -> f64 {
        self.noise_density * (SAMPLE_RATE_HZ / 2.0).sqrt()
    }

    /// The bias at the start of the trial: what the driver's average at rest left, and what has
    /// come since.
    pub(super) fn draw_bias(&self, random: &mut Pcg64) -> f64 {
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

/// One axle's channel.
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
    pub fn new<Kind>(
        config: &InertialConfig<Kind>,
        bias: f64,
        scale_error: f64,
        random: Pcg64,
    ) -> Self {
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

    /// Bias of this sample, and the reading's noise.
    fn errors(&mut self) -> (f64, f64) {
        let bias = self.bias.next(&mut self.random);
        (bias, normal(&mut self.random, self.noise_sigma))
    }

    /// The bias that [`Self::sample`] would have; takes its place.
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
