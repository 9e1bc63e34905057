//! Gravity along the heading in the readings of an accelerometer.
//!
//! An axle that pitches by θ measures g sin θ besides its acceleration: 0.33 m/s² at 34 mrad, more than most
//! accelerations of a drive. Neither pitch nor the sensor's bias is known, but both change slowly. The wheels measure the
//! axle's acceleration without bias. So gravity and bias together are the slow part of the difference between reading
//! and acceleration by the axle filter, and the rest of the reading serves for slip, which lasts for a shorter time.
//!
//! | condition | reaction |
//! |---|---|
//! | first reading | taken as gravity and bias beyond the acceleration known |
//! | reading finite | gravity follows with [`Config::time_s`] |
//! | reading not finite | reading passed on; the receiver counts it |
//! | no reading | none passed on, gravity stays |
//!
//! [`Config::build`] validates; after it nothing fails or panics. Cost per tick: one multiplication.

use crate::config::{ConfigError, declare, in_range};

/// Largest gravity and bias along the heading, m/s². Without a limit a single huge reading would count for seconds.
const LARGEST: f32 = 12.0;

declare! {
    /// Parameters of the removal of gravity.
    pub struct Config {
        /// Time constant with which gravity and bias are followed.
        // Longer than the axle filter needs to follow the wheels, 15 ms. A sudden pitch of 34 mrad moves the estimate of
        // an axle at rest by 0.3 mm.
        pub time_s: f32 = 0.1, "s": Positive;
    }
}

impl Config {
    /// Builds the removal for one sample every `period_s`; an error names the parameter out of range.
    pub fn build(&self, period_s: f32) -> Result<HighPass, ConfigError> {
        self.check_ranges()?;
        let time = in_range("time_s", self.time_s, 10.0 * period_s, 1e3)?;
        Ok(HighPass {
            share: period_s / time,
        })
    }
}

/// Removal of gravity with checked parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HighPass {
    /// Share of a difference that is taken over per sample.
    share: f32,
}

impl HighPass {
    /// Takes one sample. `gravity` is the state, `None` before the first reading; `acceleration` is the axle's
    /// acceleration as the filter knows it, m/s². Returns the reading less gravity and bias.
    pub fn step(
        &self,
        gravity: &mut Option<f32>,
        reading: Option<f32>,
        acceleration: f32,
    ) -> Option<f32> {
        let reading = reading?;
        let beyond = reading - acceleration;
        if !beyond.is_finite() {
            return Some(reading);
        }
        let before = gravity.unwrap_or(beyond);
        let after = before + self.share * (beyond - before);
        let after = after.clamp(-LARGEST, LARGEST);
        *gravity = Some(after);
        Some(reading - after)
    }
}

#[cfg(test)]
mod tests;
