//! Trajectories: the time law along a path.

use super::curve::{Path, Sample, cubic};
use super::limits::{Bounds, PathError, positive};
use crate::base::statistics::square;
use core_algos::control::path::TrajectoryPoint;

/// Waiting time for the frame to bend before a trajectory starts, in addition to angle over steering rate, s.
const BENDING_S: f64 = 0.8;

/// Limits of the time law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeLimits {
    /// Largest allowed speed, m/s.
    pub max_speed_m_s: f64,
    /// Largest allowed acceleration along the path, m/s².
    pub max_acceleration_m_s2: f64,
    /// Largest allowed steering rate, rad/s.
    pub max_steering_rate_rad_s: f64,
    /// Largest allowed steering acceleration, rad/s².
    pub max_steering_acceleration_rad_s2: f64,
    /// Averaging time of the speed, s: acceleration is continuous, and the jerk is at most twice the largest
    /// acceleration over the averaging time.
    pub smoothing_s: f64,
    /// Interval between the points of the trajectory, s.
    pub interval_s: f64,
}

impl Default for TimeLimits {
    fn default() -> Self {
        Self {
            max_speed_m_s: 0.2,
            max_acceleration_m_s2: 0.25,
            max_steering_rate_rad_s: 0.8,
            max_steering_acceleration_rad_s2: 6.0,
            smoothing_s: 0.4,
            interval_s: 0.05,
        }
    }
}

/// A point of a trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TimedSample {
    /// Time since the start of the trajectory, s.
    pub t: f64,
    /// Speed along the path, m/s.
    pub v: f64,
    /// Acceleration along the path, m/s².
    pub a: f64,
    /// Reference posture, arc length and curvature.
    pub sample: Sample,
}

/// A path with a time law, from rest to rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    points: Vec<TimedSample>,
}

impl Trajectory {
    /// The fastest time law along an open path (see [`Path::unrolled`]) that keeps the limits,
    /// averaged over [`TimeLimits::smoothing_s`]. If the path starts with curvature, the trajectory
    /// first waits until the frame is bent.
    pub fn fastest(path: &Path, bounds: &Bounds, limits: &TimeLimits) -> Result<Self, PathError> {
        for (name, value) in [
            ("max_speed_m_s", limits.max_speed_m_s),
            ("max_acceleration_m_s2", limits.max_acceleration_m_s2),
            ("max_steering_rate_rad_s", limits.max_steering_rate_rad_s),
            (
                "max_steering_acceleration_rad_s2",
                limits.max_steering_acceleration_rad_s2,
            ),
            ("smoothing_s", limits.smoothing_s),
            ("interval_s", limits.interval_s),
        ] {
            positive(name, value)?;
        }
        let samples = path.samples();
        let n = samples.len();
        let step = path.length() / (n - 1) as f64;
        let acceleration = limits.max_acceleration_m_s2;

        // Largest speed that steering allows at each sample.
        let psi: Vec<f64> = samples.iter().map(|at| bounds.steering(at.kappa)).collect();
        let allowed: Vec<f64> = (0..n)
            .map(|i| {
                let (low, high) = (i.saturating_sub(1), (i + 1).min(n - 1));
                let slope = (psi[high] - psi[low]) / ((high - low) as f64 * step);
                let second = if high - low == 2 {
                    (psi[high] - 2.0 * psi[i] + psi[low]) / (step * step)
                } else {
                    0.0
                };
                let left = limits.max_steering_acceleration_rad_s2 - slope.abs() * acceleration;
                let by_rate = limits.max_steering_rate_rad_s / slope.abs().max(1e-9);
                let by_acceleration = (left.max(0.0) / second.abs().max(1e-9)).sqrt();
                limits
                    .max_speed_m_s
                    .min(by_rate.min(by_acceleration).max(bounds.min_speed_m_s))
            })
            .collect();
        // Distance over which averaging mixes speeds, samples.
        let reach = (limits.max_speed_m_s * limits.smoothing_s / step).ceil() as usize;
        let mut speed: Vec<f64> = (0..n)
            .map(|i| {
                allowed[i.saturating_sub(reach)..(i + reach + 1).min(n)]
                    .iter()
                    .copied()
                    .fold(f64::INFINITY, f64::min)
            })
            .collect();
        speed[0] = 0.0;
        speed[n - 1] = 0.0;
        for i in 1..n {
            speed[i] = speed[i].min((square(speed[i - 1]) + 2.0 * acceleration * step).sqrt());
        }
        for i in (0..n - 1).rev() {
            speed[i] = speed[i].min((square(speed[i + 1]) + 2.0 * acceleration * step).sqrt());
        }

        let law = TimeLaw::new(samples, &speed, step);
        let window = limits.smoothing_s;
        let rest = match psi[0].abs() {
            bend if bend > 1e-3 => bend / limits.max_steering_rate_rad_s + BENDING_S,
            _ => 0.0,
        };
        let duration = rest + law.duration() + window;
        let count = (duration / limits.interval_s).ceil() as usize;
        let points = (0..=count)
            .map(|i| {
                let t = (i as f64 * limits.interval_s).min(duration);
                let (late, early) = (law.at(t - rest), law.at(t - rest - window));
                TimedSample {
                    t: i as f64 * limits.interval_s,
                    v: (late.s - early.s) / window,
                    a: (late.v - early.v) / window,
                    sample: path.at((late.integral - early.integral) / window),
                }
            })
            .collect();
        Ok(Self { points })
    }

    /// Points at equal steps of time.
    pub fn points(&self) -> &[TimedSample] {
        &self.points
    }

    /// Time from start to end, s.
    pub fn duration(&self) -> f64 {
        self.points.last().map_or(0.0, |last| last.t)
    }

    /// Arc length at time `t` (s), m, by cubic interpolation of the neighbouring points and their speeds. Constant
    /// before the start and after the end.
    pub fn arc_length(&self, t: f64) -> f64 {
        let last = self.points.len() - 1;
        let i = self.points.partition_point(|at| at.t <= t).clamp(1, last) - 1;
        let (a, b) = (self.points[i], self.points[i + 1]);
        let span = b.t - a.t;
        let u = ((t - a.t) / span).clamp(0.0, 1.0);
        let [ease, leave, arrive] = cubic(u, span);
        a.sample.s + ease * (b.sample.s - a.sample.s) + leave * a.v + arrive * b.v
    }

    /// Points in the robot's single precision.
    pub fn to_points(&self) -> Vec<TrajectoryPoint> {
        let mut reached = 0.0f32;
        self.points
            .iter()
            .map(|at| {
                let mut point = at.sample.to_point();
                // Rounding must not decrease the arc length.
                reached = reached.max(point.s);
                point.s = reached;
                TrajectoryPoint {
                    time_s: at.t as f32,
                    v: at.v.max(0.0) as f32,
                    point,
                }
            })
            .collect()
    }
}

/// Speed, distance and integral of distance at one time of a motion with piecewise constant acceleration.
#[derive(Clone, Copy)]
struct MotionState {
    v: f64,
    s: f64,
    integral: f64,
}

struct TimeLaw {
    /// Pieces of constant acceleration: time and state at the start of the piece, acceleration.
    pieces: Vec<(f64, MotionState, f64)>,
    end: (f64, MotionState),
}

impl TimeLaw {
    fn new(samples: &[Sample], speed: &[f64], step: f64) -> Self {
        let mut t = 0.0;
        let mut integral = 0.0;
        let mut pieces = Vec::with_capacity(speed.len());
        for (i, pair) in speed.windows(2).enumerate() {
            let span = 2.0 * step / (pair[0] + pair[1]).max(1e-9);
            let a = (pair[1] - pair[0]) / span;
            let start = MotionState {
                v: pair[0],
                s: samples[i].s,
                integral,
            };
            pieces.push((t, start, a));
            integral += span * (start.s + span * (start.v / 2.0 + span * a / 6.0));
            t += span;
        }
        let end = MotionState {
            v: 0.0,
            s: samples.last().map_or(0.0, |last| last.s),
            integral,
        };
        Self {
            pieces,
            end: (t, end),
        }
    }

    fn duration(&self) -> f64 {
        self.end.0
    }

    fn at(&self, t: f64) -> MotionState {
        if t <= 0.0 {
            return MotionState {
                v: 0.0,
                s: 0.0,
                integral: 0.0,
            };
        }
        let (last, end) = self.end;
        if t >= last {
            return MotionState {
                integral: end.integral + end.s * (t - last),
                ..end
            };
        }
        let i = self.pieces.partition_point(|piece| piece.0 <= t).max(1) - 1;
        let (start, from, a) = self.pieces[i];
        let u = t - start;
        MotionState {
            v: from.v + a * u,
            s: from.s + u * (from.v + 0.5 * a * u),
            integral: from.integral + u * (from.s + u * (from.v / 2.0 + u * a / 6.0)),
        }
    }
}
