//! Internal Posture Error Correction (IPEC): two coupled axles correct each other's odometry (Borenstein; paper
//! section VI-B), with the variance of the correction.
//!
//! A bump under one wheel, slip or a wrong radius changes an axle's odometric heading at once; the lateral position
//! error grows only slowly out of it. Over one short interval, the line between the odometric positions of both axles
//! is therefore known better than either heading from a wheel difference. Each interval:
//!
//! 1. odometry of each axle: ds = (left + right)/2, dθ = (right − left)/track, position advanced
//!    along φ + dθ/2, then φ += dθ;
//! 2. α = atan2(r_y, r_x), the measured direction of axle 2 seen from axle 1; β, the direction from axle 1 to axle 2
//!    by the odometric positions;
//! 3. φ₁ ← β − α, φ₂ ← φ₁ + r_φ;
//! 4. both positions slide along the line, half each, until their distance is |r|;
//! 5. with g₁ = −α, g₂ = r_φ − α, B = |r|, σ_α = σ_ry/B, σ_ds² = σ_wheel²/2:
//!    σ_β² += [sin²g₁ σ_ds² + sin²g₂ σ_ds² + (ds₂ cos g₂)² σ_rφ² +
//!    (ds₁ cos g₁ − ds₂ cos g₂)² σ_α²]/B².
//!
//! Axle 1 is the front axle. r is axle 2's posture in axle 1's frame, the inverse of the beam's measurement.
//! [`Ipec::step`] applies all five steps. [`Ipec::weigh`] serves [`robot`](super::robot): it averages three estimates
//! of the line's direction (positions, front odometry, rear odometry) by inverse variance. An axle whose heading change
//! is implausible (bump, slip) is left out. Constant errors of the beam add up linearly, not in square; the configured
//! drift per √m stands for them.
//!
//! Nothing here panics. A relative posture that is not finite or shorter than
//! [`MIN_BASELINE_M`] leaves the odometry as it is.
//!
//! # Example
//!
//! ```
//! use core_algos::fusion::ipec::{Config, State};
//! use core_algos::math::Posture;
//!
//! let ipec = Config::default().build()?;
//! let (front, rear) = (Posture::new(0.37, 0.0, 0.0), Posture::ORIGIN);
//! let mut state = State::new(front, rear);
//! let relative = rear.relative_to(front);
//! // A bump lengthens the travel of the front axle's right wheel by 2 mm; the frame does not bend.
//! let correction = ipec.step(&mut state, &[0.01, 0.012, 0.01, 0.01], &relative).expect("a direction");
//! let [front, _] = state.postures();
//! assert!(front.phi.abs() < 2e-4, "by its wheels it would have turned by 6.2e-3");
//! assert!((correction.heading[0] + 6.2e-3).abs() < 2e-4);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

use crate::config::{ConfigError, declare};
use crate::math::Posture;
use crate::math::trig::{atan2, hypot, sin_cos, wrap_angle, wrap_angle_f64};

/// Shortest distance between the axles that gives a direction, m.
pub const MIN_BASELINE_M: f32 = 1e-3;

declare! {
    /// Standard deviations of the measurements of one interval.
    pub struct Config {
        /// Standard deviation of one wheel's advance in an interval.
        pub wheel_sigma_m: f32 = 5e-5, "m": NonNegative;
        /// Standard deviation of the beam's lateral position (r_y).
        pub lateral_sigma_m: f32 = 5e-5, "m": NonNegative;
        /// Standard deviation of the beam's heading (r_φ).
        pub heading_sigma_rad: f32 = 2e-4, "rad": NonNegative;
        /// Drift of the line's direction from errors that do not change from interval to interval (beam zero, wheel
        /// radius), as an equivalent random walk.
        pub drift_rad_per_sqrt_m: f32 = 2.5e-3, "rad/√m": NonNegative;
        /// Largest accepted deviation of an axle's heading change, in standard deviations; a larger one counts as a
        /// bump or slip and is left out.
        pub gate_sigmas: f32 = 5.0, "": Positive;
        derived {
            /// Distance between the wheels of an axle.
            pub track_m: f32 = 0.324, "m": Positive;
        }
    }
}

impl Config {
    /// Builds the correction; an error names the parameter out of range.
    pub fn build(&self) -> Result<Ipec, ConfigError> {
        self.check_ranges()?;
        let square = |x: f32| x * x;
        Ok(Ipec {
            inverse_track: 1.0 / self.track_m,
            step_variance: 0.5 * square(self.wheel_sigma_m),
            lateral_variance: square(self.lateral_sigma_m),
            heading_variance: square(self.heading_sigma_rad),
            drift_variance: square(self.drift_rad_per_sqrt_m),
            gate: square(self.gate_sigmas),
        })
    }
}

/// The correction, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ipec {
    inverse_track: f32,
    /// Variance of an axle's advance in an interval, σ_ds², m².
    step_variance: f32,
    lateral_variance: f32,
    heading_variance: f32,
    drift_variance: f32,
    gate: f32,
}

/// Postures of both axles, and variance of the direction of the line between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Position and heading of axle 1 and axle 2, in `f64` as they are long sums of small increments.
    axles: [[f64; 3]; 2],
    /// σ_β², variance of the line's direction, rad².
    pub variance: f32,
}

impl State {
    /// State from the postures of axle 1 (front) and axle 2 (rear).
    pub fn new(axle1: Posture, axle2: Posture) -> Self {
        let wide = |p: Posture| <[f32; 3]>::from(p).map(f64::from);
        Self {
            axles: [wide(axle1), wide(axle2)],
            variance: 0.0,
        }
    }

    /// Postures of axle 1 and axle 2.
    pub fn postures(&self) -> [Posture; 2] {
        self.axles
            .map(|axle| Posture::from(axle.map(|entry| entry as f32)))
    }

    /// Postures of axle 1 and axle 2 in double precision.
    pub fn precise_postures(&self) -> [[f64; 3]; 2] {
        self.axles
    }
}

/// Advance of the wheels in one interval, m: left and right of axle 1, left and right of axle 2.
pub type WheelAdvance = [f32; 4];

/// Correction of one interval.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Correction {
    /// Heading correction of axle 1 and axle 2, rad.
    pub heading: [f32; 2],
    /// Variance of axle 1's corrected heading, σ_β² + σ_α², rad².
    pub heading_variance: f32,
    /// True for an axle whose own heading change was implausible (bump, slip) and left out.
    pub gated: [bool; 2],
}

impl Ipec {
    /// Runs one interval: odometry by the `advance` of the wheels, then correction by `r` (axle 2 in axle 1's frame).
    /// `None` if `r` or the odometric positions give no direction; the state then holds plain odometry.
    pub fn step(
        &self,
        state: &mut State,
        advance: &WheelAdvance,
        r: &Posture,
    ) -> Option<Correction> {
        let [left1, right1, left2, right2] = *advance;
        let (ds1, turn1) = (
            0.5 * (left1 + right1),
            (right1 - left1) * self.inverse_track,
        );
        let (ds2, turn2) = (
            0.5 * (left2 + right2),
            (right2 - left2) * self.inverse_track,
        );
        for (axle, (ds, turn)) in state.axles.iter_mut().zip([(ds1, turn1), (ds2, turn2)]) {
            let (sin, cos) = sin_cos(axle[2] as f32 + 0.5 * turn);
            axle[0] += f64::from(ds * cos);
            axle[1] += f64::from(ds * sin);
            axle[2] = wrap_angle_f64(axle[2] + f64::from(turn));
        }
        let chord = Direction::of(r)?;
        let [front, rear] = &mut state.axles;
        let (x, y) = ((rear[0] - front[0]) as f32, (rear[1] - front[1]) as f32);
        let length = hypot(x, y);
        if !(length >= MIN_BASELINE_M) {
            return None;
        }
        let beta = atan2(y, x);
        let first = wrap_angle_f64(f64::from(beta) - f64::from(chord.alpha));
        let second = wrap_angle_f64(first + f64::from(r.phi));
        let heading = [
            wrap_angle((first - front[2]) as f32),
            wrap_angle((second - rear[2]) as f32),
        ];
        (front[2], rear[2]) = (first, second);
        let half = 0.5 * (chord.baseline - length) / length;
        for (k, by) in [half * x, half * y].into_iter().enumerate() {
            front[k] -= f64::from(by);
            rear[k] += f64::from(by);
        }
        state.variance += self.growth(&chord, r, [ds1, ds2]);
        Some(Correction {
            heading,
            heading_variance: state.variance + chord.variance(self.lateral_variance),
            gated: [false; 2],
        })
    }

    /// Growth of σ_β² over one interval.
    fn growth(&self, chord: &Direction, r: &Posture, [ds1, ds2]: [f32; 2]) -> f32 {
        let (sin1, cos1) = sin_cos(-chord.alpha);
        let (sin2, cos2) = sin_cos(r.phi - chord.alpha);
        let (along1, along2) = (ds1 * cos1, ds2 * cos2);
        let gap = along1 - along2;
        ((sin1 * sin1 + sin2 * sin2) * self.step_variance
            + along2 * along2 * self.heading_variance
            + gap * gap * chord.variance(self.lateral_variance))
            / (chord.baseline * chord.baseline)
    }

    /// Correction weighted against the axles' own headings.
    ///
    /// `postures` of axle 1 and 2 after odometry; `advance` of their midpoints in the interval (m); `own_variance` of
    /// each axle's own heading change in the interval (rad²); `r` as in [`Self::step`]. Returns the corrected
    /// postures, whose relative posture is exactly `r`, and the correction. `None` if `r` or the positions give no
    /// direction, or if both axles are gated with about the same deviation from the line, so that `r` itself is
    /// suspect.
    pub fn weigh(
        &self,
        postures: [Posture; 2],
        advance: [f32; 2],
        own_variance: [f32; 2],
        r: &Posture,
    ) -> Option<([Posture; 2], Correction)> {
        let chord = Direction::of(r)?;
        let [mut first, mut second] = postures;
        let (x, y) = (second.x - first.x, second.y - first.y);
        if !(hypot(x, y) >= MIN_BASELINE_M) {
            return None;
        }
        let beta = atan2(y, x);
        // Direction of the line by each axle's own heading, less β.
        let deviation = [
            wrap_angle(postures[0].phi + chord.alpha - beta),
            wrap_angle(postures[1].phi - r.phi + chord.alpha - beta),
        ];
        let driven = 0.5 * (advance[0].abs() + advance[1].abs());
        let line_variance = self.growth(&chord, r, advance) + self.drift_variance * driven + 1e-12;
        // Noise of the beam's measurements at both ends of the interval.
        let noise = 2.0 * (chord.variance(self.lateral_variance) + self.heading_variance);
        let mut gated = [false; 2];
        let (mut information, mut sum) = (1.0 / line_variance, 0.0);
        for i in 0..2 {
            let spread = own_variance[i] + line_variance + noise;
            gated[i] = !(deviation[i] * deviation[i] <= self.gate * spread);
            if !gated[i] {
                let weight = 1.0 / (own_variance[i] + 1e-12);
                information += weight;
                sum += weight * deviation[i];
            }
        }
        if gated == [true; 2] {
            let difference = deviation[0] - deviation[1];
            let spread = own_variance[0] + own_variance[1] + noise;
            if !(difference * difference > self.gate * spread) {
                return None;
            }
        }
        let direction = beta + sum / information;
        let (sin, cos) = sin_cos(direction);
        let half = 0.5 * chord.baseline;
        let by = [half * cos - 0.5 * x, half * sin - 0.5 * y];
        (first.x, first.y) = (first.x - by[0], first.y - by[1]);
        (second.x, second.y) = (second.x + by[0], second.y + by[1]);
        first.phi = wrap_angle(direction - chord.alpha);
        second.phi = wrap_angle(direction - chord.alpha + r.phi);
        let heading = [
            wrap_angle(first.phi - postures[0].phi),
            wrap_angle(second.phi - postures[1].phi),
        ];
        let correction = Correction {
            heading,
            heading_variance: 1.0 / information + chord.variance(self.lateral_variance),
            gated,
        };
        Some(([first, second], correction))
    }
}

/// Direction of axle 2 seen from axle 1.
struct Direction {
    baseline: f32,
    alpha: f32,
}

impl Direction {
    fn of(r: &Posture) -> Option<Self> {
        let baseline = hypot(r.x, r.y);
        (baseline >= MIN_BASELINE_M && r.is_finite()).then(|| Self {
            baseline,
            alpha: atan2(r.y, r.x),
        })
    }

    /// Variance of the measured direction, σ_α², rad².
    fn variance(&self, lateral_variance: f32) -> f32 {
        lateral_variance / (self.baseline * self.baseline)
    }
}

#[cfg(test)]
mod tests;
