//! Axle-level filter: an extended Kalman filter of seven states (paper eq. 16–19).
//!
//! State x, y, φ, v, φ̇, v̇, φ̈: posture of the axle's midpoint in the global frame (m, m, rad), its
//! forward speed and yaw rate (m/s, rad/s) and their derivatives (m/s², rad/s²), counter-clockwise
//! positive. Motion model over one period T, constant accelerations, midpoint heading:
//! ds = v T + v̇ T²/2, dφ = φ̇ T + φ̈ T²/2, position advanced by ds along φ + dφ/2, φ += dφ,
//! v += v̇ T, φ̇ += φ̈ T; P = A P Aᵀ + Q (eq. 17).
//!
//! Measurements (eq. 18), one file each, any of them absent at any step: [`wheels`], [`gyro`], [`accelerometer`], and
//! a posture fix ([`fix`]); [`rates`] takes wheels and gyro together. Updates are scalar and sequential. The posture
//! is kept in two floats. [`factors`] describes the covariance, and why an update costs no more than in a filter of
//! four states.
//!
//! **Guards.** A measurement that is not finite is counted and ignored. If [`Config::innovation_gate`] is set, a
//! measurement whose normalised innovation squared (NIS) exceeds the gate is counted and ignored too. After
//! [`Config::gate_patience`] such rejections in a row the next measurement is accepted, so that a diverged filter can
//! recover.
//!
//! **Between axles.** [`State::take_increment`] ends an interval for the lead node's fusion: it returns the odometric
//! posture and takes the covariance added in this interval out of the filter.
//!
//! [`Config::build`] validates; after it nothing fails or panics.
//!
//! # Example
//!
//! ```
//! use core_algos::fusion::Estimate;
//! use core_algos::fusion::ekf::{Config, Measurements, State, Verdict};
//! use core_algos::math::Posture;
//!
//! let filter = Config::default().build()?;
//! let start = Estimate::with_sigmas(Posture::ORIGIN, [1e-3; 3]);
//! let mut state = State::at_rest(&start, [0.3, 0.6, 1.0, 1.0]);
//! // Two seconds at 0.2 m/s and 0.25 rad/s; the gyro gives nothing in every third tick.
//! for tick in 0..2000 {
//!     filter.step(&mut state, &Measurements {
//!         left_m_s: Some(0.2 - 0.25 * 0.162),
//!         right_m_s: Some(0.2 + 0.25 * 0.162),
//!         gyro_rad_s: (tick % 3 != 0).then_some(0.25),
//!         acceleration_m_s2: None,
//!     });
//! }
//! let posture = state.posture();
//! let arc = [0.8 * f32::sin(0.5), 0.8 * (1.0 - f32::cos(0.5)), 0.5];
//! assert!((posture.x - arc[0]).abs() < 2e-3);
//! assert!((posture.y - arc[1]).abs() < 2e-3);
//! assert!((posture.phi - arc[2]).abs() < 2e-3);
//!
//! let bad = Measurements { gyro_rad_s: Some(f32::NAN), ..Measurements::default() };
//! assert_eq!(filter.step(&mut state, &bad).gyro, Verdict::Invalid);
//! assert!(state.is_finite());
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

pub mod accelerometer;
pub mod factors;
pub mod fix;
pub mod gyro;
pub mod rates;
pub mod wheels;

mod config;

pub use config::{Config, Densities, ProcessNoise};

pub use factors::Covariance;
pub use fix::Fix;

use self::factors::{ACCELERATION, M, Motion, SPEED, YAW_ACCELERATION, YAW_RATE};
use super::Estimate;
use crate::math::matrix::{self, Mat};
use crate::math::trig::{sin_cos, wrap_angle};
use crate::math::{Posture, Twist, TwoFloat};

/// Number of states.
pub const N: usize = 7;
pub(super) const X: usize = 0;
pub(super) const Y: usize = 1;
pub(super) const PHI: usize = 2;
/// Index of the first motion state.
pub(super) const V: usize = 3;

/// Period of the covariance upkeep, steps. Each step runs one part of `Covariance::keep_up`, so that no step takes
/// much longer than another.
const UPKEEP_INTERVAL: u8 = 64;
/// Share of the posture's own covariance that an increment takes out. The rest stays for the next increment and keeps
/// the matrix well conditioned.
const HANDED_OUT: f32 = 0.9375;

/// Process noise ready to add.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Noise {
    /// Constant Q, factorised.
    Fixed(Mat<N, N>),
    Densities {
        /// Variances of slip along the heading, across it and in heading, per metre.
        per_m: [f32; 3],
        /// Variances of slip along the heading, across it and in heading, per step.
        per_step: [f32; 3],
        /// Variance of the change of v̇ in a step; the jerk is constant over the step.
        jerk: f32,
        /// Variance of the change of φ̈ in a step.
        yaw_jerk: f32,
    },
}

/// The axle filter, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxleFilter {
    t: f32,
    half_t2: f32,
    noise: Noise,
    half_track: f32,
    left_variance: f32,
    right_variance: f32,
    gyro_variance: f32,
    reductions: [rates::Reduction; 4],
    accelerometer_variance: f32,
    /// Inverse variances of left, right, gyro, accelerometer.
    information: [f32; 4],
    /// Bound of the sum of squared innovations over noise variances; up to this sum no gate can reject.
    always_accepted_nis: f32,
    gate: Option<f32>,
    fix_gate: Option<f32>,
    patience: u16,
}

/// Measurements of one axle at one step; `None` where a measurement is missing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Measurements {
    /// Speed of the left wheel over ground, m/s: at the step, or mean of the period.
    pub left_m_s: Option<f32>,
    /// Speed of the right wheel over ground, m/s: at the step, or mean of the period.
    pub right_m_s: Option<f32>,
    /// Yaw rate, rad/s.
    pub gyro_rad_s: Option<f32>,
    /// Acceleration along the heading, m/s².
    pub acceleration_m_s2: Option<f32>,
}

/// Verdict on one measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Verdict {
    /// No measurement.
    #[default]
    Absent,
    /// Used in the update.
    Used,
    /// Rejected: not a finite number (or, for a fix, a covariance that is not positive definite).
    Invalid,
    /// Rejected: NIS above the gate.
    Gated,
}

/// Rejected samples of one sensor since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Refusals {
    /// Samples that were not finite.
    pub invalid: u32,
    /// Samples beyond the innovation gate.
    pub gated: u32,
    /// Samples beyond the gate since the last accepted sample.
    in_a_row: u16,
}

impl Refusals {
    /// Verdict on a sample with the given NIS.
    fn verdict(&mut self, nis: impl FnOnce() -> f32, gate: Option<f32>, patience: u16) -> Verdict {
        if let Some(gate) = gate
            && !(nis() <= gate)
            && self.in_a_row < patience
        {
            self.gated = self.gated.saturating_add(1);
            self.in_a_row = self.in_a_row.saturating_add(1);
            return Verdict::Gated;
        }
        self.in_a_row = 0;
        Verdict::Used
    }

    /// Verdict on a scalar measurement. `noise` is the variance of its noise. `predicted` computes the variance of its
    /// prediction, only if `noise` alone does not decide.
    fn scalar_verdict(
        &mut self,
        innovation: f32,
        noise: f32,
        predicted: impl FnOnce() -> f32,
        gate: Option<f32>,
        patience: u16,
    ) -> Verdict {
        let square = innovation * innovation;
        let nis = || {
            // Upper bound of the NIS: its value if the prediction were exact.
            let most = square / noise;
            match gate {
                Some(gate) if most <= gate => most,
                _ => square / (predicted() + noise),
            }
        };
        self.verdict(nis, gate, patience)
    }

    /// Counts a sample that is not finite.
    fn refuse(&mut self) -> Verdict {
        self.invalid = self.invalid.saturating_add(1);
        Verdict::Invalid
    }
}

/// Verdicts on the measurements of one step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Verdicts {
    /// Verdict on the left wheel's speed.
    pub left: Verdict,
    /// Verdict on the right wheel's speed.
    pub right: Verdict,
    /// Verdict on the gyro's yaw rate.
    pub gyro: Verdict,
    /// Verdict on the accelerometer's acceleration.
    pub accelerometer: Verdict,
}

/// Counters of rejected samples of all sensors of an axle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Rejected speeds of the left wheel.
    pub left: Refusals,
    /// Rejected speeds of the right wheel.
    pub right: Refusals,
    /// Rejected yaw rates of the gyro.
    pub gyro: Refusals,
    /// Rejected accelerations of the accelerometer.
    pub accelerometer: Refusals,
    /// Rejected posture fixes.
    pub fix: Refusals,
}

/// State of an axle filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    posture: [TwoFloat; 3],
    /// Motion states v, φ̇ (m/s, rad/s) and v̇, φ̈ (m/s², rad/s²).
    motion: [f32; M],
    covariance: Covariance,
    /// Number of the last step within the upkeep period.
    upkeep: u8,
    /// Numbers of samples rejected since the start.
    pub counters: Counters,
}

impl Default for State {
    /// An axle at rest at the origin of its odometric frame; this origin is exact by definition.
    fn default() -> Self {
        let start = Estimate::with_sigmas(Posture::ORIGIN, [1e-6; 3]);
        Self::at_rest(&start, [1e-3, 1e-3, 1e-2, 1e-2])
    }
}

impl State {
    /// State of an axle at rest at a known posture. `speed_sigmas` are the standard deviations of v, φ̇, v̇, φ̈.
    pub fn at_rest(start: &Estimate, speed_sigmas: [f32; 4]) -> Self {
        let mut covariance = [[0.0; N]; N];
        for i in 0..3 {
            for j in 0..3 {
                covariance[i][j] = start.covariance[i][j];
            }
        }
        for k in 0..4 {
            covariance[V + k][V + k] = speed_sigmas[k] * speed_sigmas[k];
        }
        let p = start.posture;
        Self::from_parts([p.x, p.y, p.phi, 0.0, 0.0, 0.0, 0.0], &covariance)
    }

    /// State from all seven values and their covariance, which should be symmetric and positive definite; its upper
    /// triangle is read.
    pub fn from_parts(x: [f32; N], covariance: &Mat<N, N>) -> Self {
        Self {
            posture: [x[X], x[Y], wrap_angle(x[PHI])].map(TwoFloat::from),
            motion: [x[V], x[V + 1], x[V + 2], x[V + 3]],
            covariance: Covariance::from_matrix(covariance),
            upkeep: 0,
            counters: Counters::default(),
        }
    }

    /// Posture of the axle's midpoint; heading within [−π, π].
    pub fn posture(&self) -> Posture {
        let [x, y, phi] = self.posture.map(|entry| entry.high);
        Posture::new(x, y, phi)
    }

    /// Posture in double precision.
    pub fn precise_posture(&self) -> [f64; 3] {
        self.posture.map(f64::from)
    }

    /// Forward speed and yaw rate.
    pub fn twist(&self) -> Twist {
        Twist::new(self.motion[SPEED], self.motion[YAW_RATE])
    }

    /// Forward acceleration (m/s²) and yaw acceleration (rad/s²).
    pub fn accelerations(&self) -> [f32; 2] {
        [self.motion[ACCELERATION], self.motion[YAW_ACCELERATION]]
    }

    /// Covariance of all states.
    pub fn covariance(&self) -> &Covariance {
        &self.covariance
    }

    /// Posture with its covariance.
    pub fn estimate(&self) -> Estimate {
        Estimate::new(self.posture(), self.covariance.posture())
    }

    /// True if every number is finite.
    pub fn is_finite(&self) -> bool {
        self.posture.iter().all(|p| p.is_finite())
            && self.motion.iter().all(|m| m.is_finite())
            && self.covariance.is_finite()
    }

    /// Adds a displacement to the posture.
    fn advance(&mut self, mut by: [f32; 3]) {
        // After an accepted outlier the filter may turn by more than one turn per step.
        by[PHI] = wrap_angle(by[PHI]);
        for i in 0..3 {
            self.posture[i] = self.posture[i].advanced(by[i]);
        }
        self.posture[PHI] = self.posture[PHI].wrapped_once();
    }

    /// Moves the origin of the frame: the position grows by `by`, m, and the covariance stays.
    pub fn shift(&mut self, by: [f32; 2]) {
        for (position, by) in self.posture.iter_mut().zip(by) {
            *position = position.advanced(by);
        }
    }

    /// Corrects the motion states by `change`, and the posture by G times `change`.
    fn correct(&mut self, change: &[f32; M]) {
        self.advance(self.covariance.follow(change));
        for k in 0..M {
            self.motion[k] += change[k];
        }
    }

    /// Ends an interval between two increments for the lead node. Returns the odometric posture, which continues across
    /// intervals, and the covariance added in this interval (errors along and across the heading, in heading).
    ///
    /// The posture's error has two parts. One follows the errors of speed and acceleration; later measurements still
    /// reduce it. The other, Pₚₚ − Pₚᵥ Pᵥᵥ⁻¹ Pᵥₚ, is permanent and independent from interval to interval; it is taken
    /// out of the filter here. So the filter goes on smoothing across intervals, the sum of all increments carries the
    /// whole uncertainty, and the covariance stays in the range of `f32`.
    ///
    /// Meant for an axle without posture fixes: a fix moves the posture, not the odometry.
    pub fn take_increment(&mut self) -> Estimate {
        let covariance = self.covariance.take_posture(HANDED_OUT);
        let posture = self.posture();
        let (s, c) = sin_cos(posture.phi);
        let into_body = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]];
        Estimate::new(posture, matrix::propagate(&into_body, &covariance))
    }
}

impl AxleFilter {
    /// Runs one period: motion model, then update by the measurements.
    #[inline]
    pub fn step(&self, state: &mut State, measurements: &Measurements) -> Verdicts {
        let by = self.move_on(state);
        match self.update_all(state, measurements, by) {
            Some(verdicts) => verdicts,
            None => {
                state.advance(by);
                self.update_some(state, measurements)
            }
        }
    }

    /// Time update (eq. 17) by one period.
    pub fn predict(&self, state: &mut State) {
        let by = self.move_on(state);
        state.advance(by);
    }

    /// Time update of all states except the posture; returns the posture's displacement.
    #[inline(always)]
    fn move_on(&self, state: &mut State) -> [f32; 3] {
        let t = self.t;
        let [v, omega, v_dot, omega_dot] = state.motion;
        let ds = v * t + v_dot * self.half_t2;
        let dphi = omega * t + omega_dot * self.half_t2;
        let (sin, cos) = sin_cos(state.posture[PHI].high + 0.5 * dphi);
        let (dx, dy) = (ds * cos, ds * sin);

        state.covariance.propagate(&Motion {
            t,
            half_t2: self.half_t2,
            sin,
            cos,
            dx,
            dy,
        });
        self.add_noise(&mut state.covariance, [sin, cos], ds);
        state.motion[SPEED] = v + v_dot * t;
        state.motion[YAW_RATE] = omega + omega_dot * t;

        state.upkeep = (state.upkeep + 1) % UPKEEP_INTERVAL;
        if usize::from(state.upkeep) <= N {
            state.covariance.keep_up(usize::from(state.upkeep));
        }
        [dx, dy, dphi]
    }

    /// Adds the process noise Q.
    #[inline]
    fn add_noise(&self, p: &mut Covariance, [sin, cos]: [f32; 2], ds: f32) {
        match &self.noise {
            Noise::Fixed(q) => p.add(q),
            Noise::Densities {
                per_m,
                per_step,
                jerk,
                yaw_jerk,
            } => {
                let half_t = 0.5 * self.t;
                let ds = ds.abs();
                let slip = [0, 1, 2].map(|k: usize| per_m[k] * ds + per_step[k]);
                p.add_model_noise(half_t, [*jerk, *yaw_jerk], [cos, sin], slip);
            }
        }
    }

    /// Measurement update (eq. 18) by the measurements present.
    pub fn update(&self, state: &mut State, measurements: &Measurements) -> Verdicts {
        match self.update_all(state, measurements, [0.0; 3]) {
            Some(verdicts) => verdicts,
            None => self.update_some(state, measurements),
        }
    }

    /// Update in the usual case: all sensors present, and innovations so small that no gate can reject. Also moves
    /// the posture by `by`. Otherwise returns `None` and changes nothing.
    #[inline(always)]
    fn update_all(
        &self,
        state: &mut State,
        measurements: &Measurements,
        by: [f32; 3],
    ) -> Option<Verdicts> {
        let [v, omega, v_dot, _] = state.motion;
        let turning = self.half_track * omega;
        let rates = [
            measurements.left_m_s? - (v - turning),
            measurements.right_m_s? - (v + turning),
            measurements.gyro_rad_s? - omega,
        ];
        let acceleration = measurements.acceleration_m_s2? - v_dot;
        let [left, right, gyro, accelerometer] = self.information;
        let nis_bound = rates[0] * rates[0] * left
            + rates[1] * rates[1] * right
            + rates[2] * rates[2] * gyro
            + acceleration * acceleration * accelerometer;
        // No NIS exceeds this sum. The sum is NaN or infinite if a sample is.
        if !(nis_bound <= self.always_accepted_nis) {
            return None;
        }
        let all = &self.reductions[3];
        let noise = self.accelerometer_variance;
        let change = if state.covariance.is_coupled() || all.couples() {
            let mut change = Self::change_by_rates(state, all, &rates);
            let rest = acceleration - change[ACCELERATION];
            let gain = state.covariance.observe::<ACCELERATION>(noise);
            for k in 0..M {
                change[k] += gain[k] * rest;
            }
            change
        } else {
            all.change_by_pairs(&mut state.covariance, &rates, acceleration, noise)
        };
        let follow = state.covariance.follow(&change);
        state.advance([by[X] + follow[X], by[Y] + follow[Y], by[PHI] + follow[PHI]]);
        for k in 0..M {
            state.motion[k] += change[k];
        }
        let counters = &mut state.counters;
        counters.left.in_a_row = 0;
        counters.right.in_a_row = 0;
        counters.gyro.in_a_row = 0;
        counters.accelerometer.in_a_row = 0;
        Some(Verdicts {
            left: Verdict::Used,
            right: Verdict::Used,
            gyro: Verdict::Used,
            accelerometer: Verdict::Used,
        })
    }

    #[inline(never)]
    fn update_some(&self, state: &mut State, measurements: &Measurements) -> Verdicts {
        let [left, right, gyro] = self.update_rates(
            state,
            measurements.left_m_s,
            measurements.right_m_s,
            measurements.gyro_rad_s,
        );
        Verdicts {
            left,
            right,
            gyro,
            accelerometer: self.update_accelerometer(state, measurements.acceleration_m_s2),
        }
    }
}

#[cfg(test)]
mod tests;
