//! Second-order tracking observer of a wheel: speed from encoder counts.
//!
//! # Theory
//!
//! Counts differenced over one interval are quantised far too coarsely, and the phase lag of a low-pass filter is
//! more than the axle's controller tolerates. The observer instead models a wheel at constant speed and corrects the
//! model by the error e of each count, `θ' = ω + 2 b e`, `ω' = b² e`: a type-2 loop with both poles at −b. The loop
//! follows constant speed without error, `ω̂(s)/ω(s) = b²/(s + b)²`. In discrete time both poles are at `e^(−b dt)`.
//!
//! The angle is kept as the last count and a remainder of at most a few counts, so that the resolution does not
//! decrease with distance. Differences of counts wrap as the counter does.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; [`WheelObserver::step`] cannot fail.

use crate::config::{ConfigError, declare};
use crate::math::trig::lag_gain;
use crate::time::TICK_S;
use core::f32::consts::TAU;

/// Limit of the counts per revolution: `f32` holds every whole number up to this limit.
const MAX_COUNTS: f32 = 16_777_215.0;

declare! {
    /// Encoder of a wheel, and bandwidth of the observer.
    pub struct Config {
        /// Bandwidth of the observer (b).
        pub bandwidth_rad_s: f32 = 250.0, "rad/s": Range(1.0, 2000.0);
        /// Largest speed of the wheel. A count that differs from the prediction by more than the angle at this speed
        /// since the last count is a jump of the counter.
        pub max_speed_rad_s: f32 = 60.0, "rad/s": Positive;
        derived {
            /// Encoder counts per revolution of the wheel, gear and edges included.
            pub counts_per_revolution: u32 = 20_000, "": Range(4.0, MAX_COUNTS);
        }
    }
}

impl Config {
    /// Builds the validated observer; the error names the invalid field.
    pub fn build(&self) -> Result<WheelObserver, ConfigError> {
        self.check_ranges()?;
        let radians_per_count = TAU / self.counts_per_revolution as f32;
        let decay = self.bandwidth_rad_s * TICK_S;
        let gain = lag_gain(decay);
        Ok(WheelObserver {
            radians_per_count,
            angle_gain: lag_gain(2.0 * decay),
            speed_gain: gain * gain * radians_per_count / TICK_S,
            // Two counts more: quantisation alone is never a jump.
            largest_error: self.max_speed_rad_s * TICK_S / radians_per_count + 2.0,
        })
    }
}

/// State of the observer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Estimated speed of the wheel, rad/s, forward positive.
    pub speed_rad_s: f32,
    /// Estimated angle travelled in the last step, rad.
    pub increment_rad: f32,
    /// True if this step's count was a jump of the counter. The count is the new origin; speed and increment are
    /// predicted.
    pub jumped: bool,
    /// Last count; `None` before the first.
    count: Option<i32>,
    /// Estimated angle less the angle of the last count, counts.
    remainder: f32,
    /// Intervals without a count since the last count, at most 1000.
    missed: f32,
}

/// The observer of one wheel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelObserver {
    radians_per_count: f32,
    angle_gain: f32,
    /// Correction of the speed per count of error, rad/s.
    speed_gain: f32,
    /// Error of a count above which the count is a jump, counts. The bound grows with each interval without a count.
    largest_error: f32,
}

impl WheelObserver {
    /// One interval: takes the encoder's count, which wraps as an `i32`. Without a count, the wheel is predicted at
    /// its speed. The first count is the origin.
    pub fn step(&self, state: &State, count: Option<i32>) -> State {
        let advance = state.speed_rad_s * TICK_S / self.radians_per_count;
        let mut next = State {
            increment_rad: advance * self.radians_per_count,
            jumped: false,
            remainder: state.remainder + advance,
            missed: (state.missed + 1.0).min(1e3),
            ..*state
        };
        let Some(count) = count else {
            return next;
        };
        next.count = Some(count);
        next.missed = 0.0;
        let Some(last) = state.count else {
            return State {
                count: next.count,
                ..State::default()
            };
        };
        let counted = count.wrapping_sub(last);
        let error = counted as f32 - next.remainder;
        if !(error.abs() <= self.largest_error * (1.0 + state.missed)) {
            next.remainder = 0.0;
            next.jumped = true;
            return next;
        }
        next.remainder = (self.angle_gain - 1.0) * error;
        next.speed_rad_s += self.speed_gain * error;
        next.increment_rad += self.angle_gain * error * self.radians_per_count;
        next
    }
}

#[cfg(test)]
mod tests;
