//! One channel of an inertial sensor: counts to rad/s or m/s², with the bias estimated at standstill.
//!
//! The bias is the mean of a window whose noise, drift and mean are within the part's limits. A window in which the
//! robot moved is rejected, and the next window begins. Until a window is accepted, the channel gives no reading.
//!
//! [`Config::build`] validates; [`Channel::step`] cannot fail.

use crate::config::{Allowed, ConfigError, in_range, require};
use crate::math::trig::sqrt;

/// Scale, and limits of the bias estimation. `u` is the unit of the channel, rad/s or m/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Value of a count, u; negative if the part is mounted the other way round.
    pub unit_per_count: f32,
    /// Number of samples in a window.
    pub window: u16,
    /// Standard deviation of a window above which the window is rejected, u.
    pub max_noise: f32,
    /// Difference between the means of a window's halves above which the window is rejected, u.
    pub max_drift: f32,
    /// Magnitude of a window's mean above which the window is rejected, u.
    pub max_bias: f32,
}

impl Config {
    /// Yaw rate of an ICM-42688-P at ±250 °/s, rad/s: 131 counts per °/s.
    pub const GYRO: Self = Self {
        unit_per_count: core::f32::consts::PI / 180.0 / 131.0,
        window: 1000,
        max_noise: 5e-3,
        max_drift: 1e-3,
        max_bias: 0.05,
    };

    /// Acceleration of an ICM-42688-P at ±2 g, m/s²: 16 384 counts per g.
    pub const ACCELEROMETER: Self = Self {
        unit_per_count: 9.806_65 / 16_384.0,
        window: 1000,
        max_noise: 0.1,
        max_drift: 0.02,
        max_bias: 1.0,
    };

    /// Builds the validated channel; the error names the invalid field.
    pub fn build(&self) -> Result<Channel, ConfigError> {
        let unit = self.unit_per_count;
        require(
            unit.abs() >= 1e-9 && unit.abs() <= 1.0,
            "unit_per_count",
            unit,
            Allowed::Condition("from 1e-9 to 1 in magnitude"),
        )?;
        in_range("window", f32::from(self.window), 16.0, 20_000.0)?;
        Ok(Channel {
            unit,
            half: u32::from(self.window / 2),
            max_noise: in_range("max_noise", self.max_noise, 1e-9, 1e3)?,
            max_drift: in_range("max_drift", self.max_drift, 1e-9, 1e3)?,
            max_bias: in_range("max_bias", self.max_bias, 1e-9, 1e3)?,
            state: State::default(),
        })
    }
}

/// Reason for the rejection of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The window's standard deviation is too large: the robot shakes or turns.
    Noisy,
    /// The means of the window's halves differ too much.
    Drifting,
    /// The window's mean is too large for a bias of this part: the robot moves steadily or is tilted, or the part is
    /// broken.
    Offset,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct State {
    bias_counts: Option<f32>,
    samples: u32,
    first_sum: i32,
    sum: i32,
    squares: i64,
    refused: Option<Refused>,
}

/// Channel of an inertial sensor: one axis of gyroscope or accelerometer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Channel {
    unit: f32,
    half: u32,
    max_noise: f32,
    max_drift: f32,
    max_bias: f32,
    state: State,
}

impl Channel {
    /// True if the bias is known.
    pub fn is_zeroed(&self) -> bool {
        self.state.bias_counts.is_some()
    }

    /// Discards the bias and the window in progress.
    pub fn forget(&mut self) {
        self.state = State::default();
    }

    /// Reason for the rejection of the latest window; `None` if the window was accepted or interrupted, or none is
    /// complete.
    pub fn refused(&self) -> Option<Refused> {
        self.state.refused
    }

    /// Takes a sample and returns its value less the bias, u. `None` while the bias is unknown or if the sample is
    /// saturated. `still` is true while the motors are off; windows are collected only then.
    pub fn step(&mut self, count: i16, still: bool) -> Option<f32> {
        if count == i16::MIN || count == i16::MAX {
            self.state = State {
                bias_counts: self.state.bias_counts,
                ..State::default()
            };
            return None;
        }
        match self.state.bias_counts {
            Some(bias) => Some((f32::from(count) - bias) * self.unit),
            None => {
                self.search(count, still);
                None
            }
        }
    }

    fn search(&mut self, count: i16, still: bool) {
        if !still {
            self.state = State::default();
            return;
        }
        let state = &mut self.state;
        state.samples += 1;
        state.sum += i32::from(count);
        state.squares += i64::from(count) * i64::from(count);
        if state.samples == self.half {
            state.first_sum = state.sum;
        }
        if state.samples < 2 * self.half {
            return;
        }
        let found = self.window_bias();
        self.state = State {
            bias_counts: found.ok(),
            refused: found.err(),
            ..State::default()
        };
    }

    /// Bias of a full window, counts.
    fn window_bias(&self) -> Result<f32, Refused> {
        let state = &self.state;
        let n = state.samples as f32;
        let sum = i64::from(state.sum);
        // Integer arithmetic: no cancellation.
        let spread = i64::from(state.samples) * state.squares - sum * sum;
        let noise = sqrt(spread as f32) / n * self.unit.abs();
        let second = state.sum - state.first_sum;
        let drift = (second - state.first_sum) as f32 / self.half as f32 * self.unit.abs();
        let mean = state.sum as f32 / n;
        if !(noise <= self.max_noise) {
            Err(Refused::Noisy)
        } else if !(drift.abs() <= self.max_drift) {
            Err(Refused::Drifting)
        } else if !((mean * self.unit).abs() <= self.max_bias) {
            Err(Refused::Offset)
        } else {
            Ok(mean)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::testing::Random;

    const PER_COUNT: f64 = core::f64::consts::PI / 180.0 / 131.0;

    /// Feeds one window of the yaw rate `rate(k)`, with noise of 0.001 rad/s and a bias of 0.0087 rad/s.
    fn window(channel: &mut Channel, random: &mut Random, rate: impl Fn(usize) -> f64) {
        for k in 0..1000 {
            let value = rate(k) + 0.0087 + 0.001 * random.normal();
            assert_eq!(channel.step((value / PER_COUNT).round() as i16, true), None);
        }
    }

    #[test]
    fn bias_found_at_rest_is_subtracted() {
        let mut channel = Config::GYRO.build().unwrap();
        let mut random = Random::new(5);
        window(&mut channel, &mut random, |_| 0.0);
        assert!(channel.is_zeroed());
        for rate in [-4.0, -0.1, 0.0, 1.0, 4.2] {
            let count = ((rate + 0.0087) / PER_COUNT).round() as i16;
            let read = channel.step(count, false).unwrap();
            // Tolerance: half a count, and five standard deviations of the mean.
            let error = f64::from(read) - rate;
            assert!(error.abs() < 0.5 * PER_COUNT + 1.6e-4, "{rate} {read}");
        }
        assert_eq!(channel.step(i16::MAX, false), None);
        assert!(channel.is_zeroed());
    }

    #[test]
    fn window_with_motion_is_rejected_with_its_reason() {
        let mut random = Random::new(6);
        type Motion = fn(usize) -> f64;
        let moves: [(Motion, Refused); 3] = [
            (|k| 0.02 * (k as f64 * 0.3).sin(), Refused::Noisy),
            (|k| if k < 500 { 0.0 } else { 0.004 }, Refused::Drifting),
            (|_| 0.1, Refused::Offset),
        ];
        for (rate, reason) in moves {
            let mut channel = Config::GYRO.build().unwrap();
            window(&mut channel, &mut random, rate);
            assert!(!channel.is_zeroed());
            assert_eq!(channel.refused(), Some(reason));
            // The next window at rest is accepted.
            window(&mut channel, &mut random, |_| 0.0);
            assert!(channel.is_zeroed() && channel.refused().is_none());
        }
    }

    #[test]
    fn motors_on_prevent_a_bias_estimate() {
        let mut channel = Config::ACCELEROMETER.build().unwrap();
        for k in 0..10_000 {
            assert_eq!(channel.step(10, k % 999 != 0), None);
        }
        assert!(!channel.is_zeroed());
        crate::config::refusal_of(Config::GYRO, |c| c.build())
            .names(&[("unit_per_count", |c| c.unit_per_count = 0.0)]);
    }
}
