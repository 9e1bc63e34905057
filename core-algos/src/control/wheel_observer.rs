//! Second-order tracking observer of a wheel: speed and angle from encoder counts.
//!
//! # Theory
//!
//! Counts differenced over one interval are quantised far too coarsely, and a low-pass filter
//! behind them costs phase that the axle's controller does not have. The observer instead carries
//! a wheel that turns at constant speed and corrects it by the error of each count,
//! `θ' = ω + 2 b e`, `ω' = b² e`: a type-2 loop with both poles at −b. It follows constant speed
//! without error, `ω̂(s)/ω(s) = b²/(s + b)²`. Sampled, both poles are placed at `e^(−b dt)`.
//!
//! The angle is kept as the last count and a remainder of at most a few counts, so resolution does
//! not fade with distance, and differences of counts wrap as the counter does.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; [`WheelObserver::step`] cannot fail.

use crate::config::{Allowed, ConfigError, in_range, positive, require};
use crate::math::trig::{exp, wrap_angle};
use core::f32::consts::TAU;
use core::num::NonZeroU32;

/// Encoder and bandwidth.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Config {
    /// Encoder counts per revolution of the wheel, gear and edges included.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub counts_per_revolution: u32,
    /// Bandwidth of the observer (b), rad/s.
    pub bandwidth_rad_s: f32,
    /// Interval between samples, s.
    pub interval_s: f32,
    /// Largest speed the wheel can have, rad/s; a count further from the prediction than this
    /// speed reaches in one interval is not a motion of the wheel.
    pub max_speed_rad_s: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            counts_per_revolution: 20_000,
            bandwidth_rad_s: 250.0,
            interval_s: 1e-3,
            max_speed_rad_s: 60.0,
        }
    }
}

impl Config {
    /// The ready-to-run form; the error names the field that is wrong.
    pub fn build(&self) -> Result<WheelObserver, ConfigError> {
        let interval = in_range("interval_s", self.interval_s, 1e-5, 0.1)?;
        let bandwidth = positive("bandwidth_rad_s", self.bandwidth_rad_s)?;
        require(
            bandwidth * interval <= 2.0,
            "bandwidth_rad_s",
            bandwidth,
            Allowed::Condition("at most 2 divided by interval_s"),
        )?;
        let counts = require_counts(self.counts_per_revolution)?;
        let radians_per_count = TAU / counts.get() as f32;
        let pole = exp(-bandwidth * interval);
        Ok(WheelObserver {
            counts_per_revolution: counts,
            radians_per_count,
            interval,
            angle_gain: 1.0 - pole * pole,
            speed_gain: (1.0 - pole) * (1.0 - pole) * radians_per_count / interval,
            // A count or two more: quantisation alone must never look like a jump.
            largest_error: positive("max_speed_rad_s", self.max_speed_rad_s)? * interval
                / radians_per_count
                + 2.0,
        })
    }
}

/// A count from 4 to 2^24, which single precision holds exactly.
fn require_counts(counts: u32) -> Result<NonZeroU32, ConfigError> {
    const MAX: u32 = 1 << 24;
    match NonZeroU32::new(counts) {
        Some(valid) if (4..=MAX).contains(&counts) => Ok(valid),
        _ => Err(ConfigError {
            field: "counts_per_revolution",
            value: counts as f32,
            allowed: Allowed::Range(4.0, MAX as f32),
        }),
    }
}

/// Everything that changes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Estimated speed of the wheel, rad/s, forward positive.
    pub speed_rad_s: f32,
    /// Estimated angle travelled in the last step, rad.
    pub increment_rad: f32,
    /// Whether the last count was too far off to be a motion of the wheel. It became the new
    /// origin; speed and increment are those predicted.
    pub jumped: bool,
    /// The last count taken in; `None` before the first.
    count: Option<i32>,
    /// The last count within its revolution, from 0.
    within_turn: u32,
    /// Estimated angle less that of the last count, counts.
    remainder: f32,
    /// Intervals since the last count.
    missed: f32,
}

/// The observer of one wheel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelObserver {
    counts_per_revolution: NonZeroU32,
    radians_per_count: f32,
    interval: f32,
    angle_gain: f32,
    /// rad/s per count of error.
    speed_gain: f32,
    /// Counts.
    largest_error: f32,
}

impl WheelObserver {
    /// One interval: takes in the encoder's count (which wraps as an `i32`), or none if it is
    /// missing, in which case the wheel goes on at its speed. The first count is the origin.
    pub fn step(&self, state: &State, count: Option<i32>) -> State {
        let advance = state.speed_rad_s * self.interval / self.radians_per_count;
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
        let turned = counted.unsigned_abs() % self.counts_per_revolution;
        next.within_turn = if counted < 0 {
            state.within_turn + self.counts_per_revolution.get() - turned
        } else {
            state.within_turn + turned
        } % self.counts_per_revolution;
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

    /// Estimated angle of the wheel since the first count, rad, in [−π, π].
    pub fn angle(&self, state: &State) -> f32 {
        wrap_angle((state.within_turn as f32 + state.remainder) * self.radians_per_count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DT: f64 = 1e-3;

    fn observer() -> WheelObserver {
        Config::default().build().unwrap()
    }

    fn counts(angle: f64) -> i64 {
        (angle * 20_000.0 / std::f64::consts::TAU).floor() as i64
    }

    /// Speeds seen for a given motion, counting from `origin`.
    fn observe(origin: i32, angle: impl Fn(f64) -> f64, steps: usize) -> Vec<State> {
        let observer = observer();
        let mut state = State::default();
        (0..steps)
            .map(|i| {
                let count = origin.wrapping_add(counts(angle(i as f64 * DT)) as i32);
                state = observer.step(&state, Some(count));
                state
            })
            .collect()
    }

    #[test]
    fn constant_speed_is_followed_without_error_in_speed_or_angle() {
        for speed in [-12.0, 0.7, 12.0] {
            let states = observe(7, |t| speed * t, 400);
            let observer = observer();
            for (i, state) in states.iter().enumerate().skip(100) {
                // One count of quantisation q shows as at most b q/e in speed.
                let quantum = 250.0 * std::f64::consts::TAU / 20_000.0 / std::f64::consts::E;
                assert!((f64::from(state.speed_rad_s) - speed).abs() < quantum);
                let exact = wrap_angle((speed * i as f64 * DT) as f32);
                let gap = wrap_angle(observer.angle(state) - exact);
                assert!(gap.abs() < 2.0 * observer.radians_per_count);
            }
        }
    }

    #[test]
    fn start_of_motion_is_the_response_of_a_double_pole() {
        let states = observe(0, |t| 10.0 * t, 40);
        for (i, state) in states.iter().enumerate().skip(1) {
            let x = 250.0 * DT * i as f64;
            let exact = 10.0 * (1.0 - (1.0 + x) * (-x).exp());
            // The held sample delays the sampled loop by at most half an interval.
            let tolerance = 10.0 * 250.0 * 0.37 * 0.5 * DT + 0.05;
            assert!((f64::from(state.speed_rad_s) - exact).abs() < tolerance);
        }
    }

    #[test]
    fn sine_has_the_gain_and_phase_of_a_double_pole() {
        let (amplitude, frequency) = (1.5, 40.0);
        let states = observe(0, |t| amplitude * (frequency * t).sin(), 4000);
        // Correlate with the true speed, A f cos(f t), over whole periods.
        let period = std::f64::consts::TAU / frequency;
        let last = (20.0 * period / DT).round() as usize;
        let (mut in_phase, mut quadrature) = (0.0, 0.0);
        for (i, state) in states.iter().enumerate().skip(300).take(last) {
            let phase = frequency * i as f64 * DT;
            in_phase += f64::from(state.speed_rad_s) * phase.cos();
            quadrature += f64::from(state.speed_rad_s) * phase.sin();
        }
        let scale = 2.0 / last as f64 / (amplitude * frequency);
        let gain = scale * in_phase.hypot(quadrature);
        let lag = quadrature.atan2(in_phase);
        let ratio: f64 = frequency / 250.0;
        assert!((gain - 1.0 / (1.0 + ratio * ratio)).abs() < 0.01, "{gain}");
        assert!(
            (lag - 2.0 * ratio.atan()).abs() < frequency * 0.6 * DT,
            "{lag}"
        );
    }

    #[test]
    fn a_missing_count_is_bridged_at_speed() {
        let observer = observer();
        let mut state = State::default();
        for i in 0..500i64 {
            let count = counts(8.0 * i as f64 * DT) as i32;
            let present = !(200..230).contains(&i);
            state = observer.step(&state, present.then_some(count));
            assert!(!state.jumped);
            if i > 150 {
                assert!((state.speed_rad_s - 8.0).abs() < 0.05);
            }
        }
    }

    #[test]
    fn a_jump_of_the_counter_is_told_and_kept_out_of_the_speed() {
        let observer = observer();
        let (mut state, mut jumps, mut travelled) = (State::default(), 0, 0.0);
        for i in 0..400i64 {
            let offset = if i >= 300 { 100_000 } else { 0 };
            state = observer.step(&state, Some((counts(5.0 * i as f64 * DT) + offset) as i32));
            jumps += u32::from(state.jumped);
            travelled += state.increment_rad;
            if i > 150 {
                assert!((state.speed_rad_s - 5.0).abs() < 0.05);
            }
        }
        assert_eq!(jumps, 1);
        assert!((travelled - 5.0 * 0.399).abs() < 2e-3);
    }

    #[test]
    fn bad_configuration_is_named() {
        let name = |config: Config| config.build().unwrap_err().field;
        let default = Config::default();
        assert_eq!(
            name(Config {
                counts_per_revolution: 0,
                ..default
            }),
            "counts_per_revolution"
        );
        assert_eq!(
            name(Config {
                bandwidth_rad_s: 2500.0,
                ..default
            }),
            "bandwidth_rad_s"
        );
        assert_eq!(
            name(Config {
                interval_s: f32::NAN,
                ..default
            }),
            "interval_s"
        );
    }

    properties! {
        /// The counter may stand anywhere, its own wrap included.
        #[test]
        fn origin_of_the_count_does_not_matter(origin: i32, speed in -20.0f64..20.0) {
            let near_wrap = i32::MAX.wrapping_add(origin % 500);
            let reference = observe(0, |t| speed * t, 200);
            for start in [origin, near_wrap] {
                let shifted = observe(start, |t| speed * t, 200);
                for (a, b) in reference.iter().zip(&shifted) {
                    prop_assert_eq!(a.speed_rad_s, b.speed_rad_s);
                    prop_assert_eq!(observer().angle(a), observer().angle(b));
                }
            }
        }

        #[test]
        fn any_counts_leave_finite_estimates(counts in prop::collection::vec(any::<Option<i32>>(), 1..200)) {
            let observer = observer();
            let mut state = State::default();
            for count in counts {
                state = observer.step(&state, count);
                prop_assert!(state.speed_rad_s.is_finite());
                prop_assert!(observer.angle(&state).abs() <= core::f32::consts::PI);
            }
        }
    }
}
