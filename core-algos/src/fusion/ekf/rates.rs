//! Joint use of the sensors that measure speed and yaw rate: both wheels and the gyro.
//!
//! Least squares, with weights fixed at configuration, first reduce the sensors present to two uncorrelated
//! measurements: v and φ̇ − c v. For wheels of equal noise c is 0, and each measures one state. With a gyro this
//! saves an update; the result equals the batch update.

use super::factors::{ACCELERATION, Covariance, M, SPEED, YAW_ACCELERATION, YAW_RATE};
use super::{AxleFilter, State, Verdict};

/// Least squares over a subset of (left, right, gyro) that determines both v and φ̇.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Reduction {
    /// Weights of the innovations of left, right and gyro in the innovation of v.
    speed_weights: [f32; 3],
    /// Noise variance of the measured v.
    speed_variance: f32,
    /// c: covariance of φ̇ and v over the variance of v.
    coupling: f32,
    /// Weights of the innovations of left, right and gyro in the innovation of φ̇ − c v.
    yaw_weights: [f32; 3],
    /// Noise variance of the measured φ̇ − c v.
    yaw_variance: f32,
}

impl Reduction {
    /// `information` is the inverse variance of left, right and gyro, 0 for an absent sensor; at least two are
    /// present.
    pub(super) fn new(half_track: f32, information: [f32; 3]) -> Self {
        let h = half_track;
        let [left, right, gyro] = information;
        // Each pair of sensors determines v. Its weight is its squared determinant times both informations (Cauchy
        // and Binet), so that no difference is formed.
        let wheels = 4.0 * h * h * left * right;
        let (with_left, with_right) = (left * gyro, right * gyro);
        let total = wheels + with_left + with_right;
        let yaw = h * h * (left + right) + gyro;
        Self {
            speed_weights: [
                (0.5 * wheels + with_left) / total,
                (0.5 * wheels + with_right) / total,
                h * (with_left - with_right) / total,
            ],
            speed_variance: yaw / total,
            coupling: h * (left - right) / yaw,
            yaw_weights: [-h * left / yaw, h * right / yaw, gyro / yaw],
            yaw_variance: 1.0 / yaw,
        }
    }

    /// True if the measurement of φ̇ − c v depends on v (c ≠ 0).
    pub(super) fn couples(&self) -> bool {
        self.coupling != 0.0
    }

    /// Change of the motion states due to the innovations of the sensors and of the acceleration, if neither the
    /// measurements nor the covariance correlate (v, v̇) with (φ̇, φ̈).
    pub(super) fn change_by_pairs(
        &self,
        p: &mut Covariance,
        innovations: &[f32; 3],
        acceleration: f32,
        acceleration_noise: f32,
    ) -> [f32; M] {
        let forward = weigh(&self.speed_weights, innovations);
        let yaw = weigh(&self.yaw_weights, innovations);
        let [v, v_dot] = p.observe_first::<SPEED, ACCELERATION>(self.speed_variance);
        let rest = acceleration - v_dot * forward;
        let [v_more, v_dot_more] = p.observe_second::<SPEED, ACCELERATION>(acceleration_noise);
        let [omega, omega_dot] = p.observe_first::<YAW_RATE, YAW_ACCELERATION>(self.yaw_variance);
        [
            v * forward + v_more * rest,
            omega * yaw,
            v_dot * forward + v_dot_more * rest,
            omega_dot * yaw,
        ]
    }
}

/// `Σ weight · innovation`.
fn weigh(weights: &[f32; 3], innovations: &[f32; 3]) -> f32 {
    weights[0] * innovations[0] + weights[1] * innovations[1] + weights[2] * innovations[2]
}

impl AxleFilter {
    /// The reductions for all subsets of two or three sensors: both wheels, left and gyro, right
    /// and gyro, all.
    pub(super) fn reductions(half_track: f32, variances: [f32; 3]) -> [Reduction; 4] {
        let [left, right, gyro] = variances.map(|variance| 1.0 / variance);
        [
            Reduction::new(half_track, [left, right, 0.0]),
            Reduction::new(half_track, [left, 0.0, gyro]),
            Reduction::new(half_track, [0.0, right, gyro]),
            Reduction::new(half_track, [left, right, gyro]),
        ]
    }

    /// Update by wheel speeds (m/s) and yaw rate (rad/s), each of which may be absent.
    pub fn update_rates(
        &self,
        state: &mut State,
        left: Option<f32>,
        right: Option<f32>,
        gyro: Option<f32>,
    ) -> [Verdict; 3] {
        let [(left, left_innovation), (right, right_innovation)] =
            self.wheel_verdicts(state, left, right);
        let (gyro, gyro_innovation) = self.gyro_verdict(state, gyro);
        let innovations = [left_innovation, right_innovation, gyro_innovation];
        let h = self.half_track;
        let [pair, left_gyro, right_gyro, all] = &self.reductions;
        let used = [left, right, gyro].map(|verdict| verdict == Verdict::Used);
        match used {
            [false, false, false] => {}
            [false, false, true] => {
                let gain = state.covariance.observe::<YAW_RATE>(self.gyro_variance);
                state.correct(&gain.map(|gain| gain * gyro_innovation));
            }
            [true, false, false] => {
                let p = &mut state.covariance;
                let gain = p.observe_rates(1.0, -h, self.left_variance);
                state.correct(&gain.map(|gain| gain * left_innovation));
            }
            [false, true, false] => {
                let p = &mut state.covariance;
                let gain = p.observe_rates(1.0, h, self.right_variance);
                state.correct(&gain.map(|gain| gain * right_innovation));
            }
            [true, true, false] => Self::update_reduced(state, pair, &innovations),
            [true, false, true] => Self::update_reduced(state, left_gyro, &innovations),
            [false, true, true] => Self::update_reduced(state, right_gyro, &innovations),
            [true, true, true] => Self::update_reduced(state, all, &innovations),
        }
        [left, right, gyro]
    }

    /// Update by v, then by φ̇ − c v.
    fn update_reduced(state: &mut State, reduction: &Reduction, innovations: &[f32; 3]) {
        let change = Self::change_by_rates(state, reduction, innovations);
        state.correct(&change);
    }

    /// Updates the covariance by v, then by φ̇ − c v; returns the change of the motion states.
    pub(super) fn change_by_rates(
        state: &mut State,
        reduction: &Reduction,
        innovations: &[f32; 3],
    ) -> [f32; M] {
        let forward = weigh(&reduction.speed_weights, innovations);
        let yaw = weigh(&reduction.yaw_weights, innovations);
        let p = &mut state.covariance;
        let first = p.observe::<SPEED>(reduction.speed_variance);
        // Part of the second innovation that the first update does not explain.
        let c = reduction.coupling;
        let yaw = yaw - (first[YAW_RATE] - c * first[SPEED]) * forward;
        let second = if c == 0.0 {
            p.observe::<YAW_RATE>(reduction.yaw_variance)
        } else {
            p.observe_rates(-c, 1.0, reduction.yaw_variance)
        };
        let mut change = [0.0; M];
        for k in 0..M {
            change[k] = first[k] * forward + second[k] * yaw;
        }
        change
    }
}
