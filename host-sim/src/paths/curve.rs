//! Paths: built-in shapes, sampled at equal steps of arc length.

use super::limits::{Bounds, PathError, PathPosition, positive};
use super::{MAX_LENGTH_M, SPACING_M};
use core_algos::control::path::PathPoint;
use core_algos::math::Posture;
use std::f64::consts::TAU;

/// One sample of a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Arc length, m.
    pub s: f64,
    /// Position along x, m.
    pub x: f64,
    /// Position along y, m.
    pub y: f64,
    /// Direction of the path, rad in (−π, π].
    pub phi: f64,
    /// Curvature, 1/m, positive to the left.
    pub kappa: f64,
}

impl Sample {
    /// Converts to the robot's single precision.
    pub fn to_point(self) -> PathPoint {
        PathPoint {
            posture: Posture::new(self.x as f32, self.y as f32, self.phi as f32),
            kappa: self.kappa as f32,
            s: self.s as f32,
        }
    }
}

/// A plane curve: position and its first two derivatives with respect to the parameter.
pub(super) type Curve<'a> = dyn Fn(f64) -> [[f64; 2]; 3] + 'a;

/// A path sampled at equal steps of arc length.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    pub(super) samples: Vec<Sample>,
    /// Denser samples, at equal steps of the curve's parameter, so that no peak of curvature is missed.
    dense: Vec<Sample>,
    closed: bool,
    /// Arc length (m) of each waypoint, and its line in the CSV file; `None` for a waypoint from no file.
    pub(super) waypoints: Vec<(f64, Option<u64>)>,
}

fn sample(curve: &Curve, t: f64, s: f64) -> Sample {
    let [[x, y], [dx, dy], [ddx, ddy]] = curve(t);
    let speed = libm::hypot(dx, dy);
    Sample {
        s,
        x,
        y,
        phi: libm::atan2(dy, dx),
        // At a cusp the curvature is infinite, not NaN.
        kappa: if speed > 0.0 {
            (dx * ddy - dy * ddx) / (speed * speed * speed)
        } else {
            f64::INFINITY
        },
    }
}

/// Arc length of `curve` from `from` to `to`: Gauss–Legendre, five nodes.
fn arc(curve: &Curve, from: f64, to: f64) -> f64 {
    const NODES: [(f64, f64); 5] = [
        (0.0, 0.568_888_888_888_888_9),
        (0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
        (-0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
        (0.906_179_845_938_664, 0.236_926_885_056_189_1),
        (-0.906_179_845_938_664, 0.236_926_885_056_189_1),
    ];
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    NODES
        .iter()
        .map(|(node, weight)| {
            let [_, [dx, dy], _] = curve(middle + half * node);
            weight * half * libm::hypot(dx, dy)
        })
        .sum()
}

impl Path {
    /// Samples `curve` over the knots of its parameter; `curve` is smooth between knots.
    pub(super) fn from_curve(
        curve: &Curve,
        knots: &[f64],
        closed: bool,
    ) -> Result<Self, PathError> {
        const PIECES: usize = 24;
        let mut table = vec![(knots[0], 0.0)];
        let mut dense = vec![sample(curve, knots[0], 0.0)];
        let mut waypoints = vec![(0.0, None)];
        let mut s = 0.0;
        for pair in knots.windows(2) {
            for i in 0..PIECES {
                let at = |i: usize| pair[0] + (pair[1] - pair[0]) * i as f64 / PIECES as f64;
                s += arc(curve, at(i), at(i + 1));
                if s > MAX_LENGTH_M {
                    return Err(PathError::TooLong(s));
                }
                table.push((at(i + 1), s));
                dense.push(sample(curve, at(i + 1), s));
            }
            waypoints.push((s, None));
        }
        let count = ((s / SPACING_M).round() as usize).max(2);
        let mut samples = Vec::with_capacity(count + 1);
        let mut piece = 0;
        for i in 0..=count {
            let target = s * i as f64 / count as f64;
            while piece + 2 < table.len() && table[piece + 1].1 < target {
                piece += 1;
            }
            let ((t0, s0), (t1, s1)) = (table[piece], table[piece + 1]);
            let mut t = t0 + (t1 - t0) * (target - s0) / (s1 - s0).max(1e-12);
            for _ in 0..4 {
                let [_, [dx, dy], _] = curve(t);
                let gap = target - s0 - arc(curve, t0, t);
                t = (t + gap / libm::hypot(dx, dy).max(1e-9)).clamp(t0, t1);
            }
            samples.push(sample(curve, t, target));
        }
        Ok(Self {
            samples,
            dense,
            closed,
            waypoints,
        })
    }

    /// A built-in shape, without waypoints.
    fn shape(curve: &Curve, knots: &[f64], closed: bool) -> Result<Self, PathError> {
        let mut path = Self::from_curve(curve, knots, closed)?;
        path.waypoints.clear();
        Ok(path)
    }

    /// A straight line of `length` (m) from the origin along x.
    pub fn line(length: f64) -> Result<Self, PathError> {
        positive("length", length)?;
        let curve = |t: f64| [[t, 0.0], [1.0, 0.0], [0.0, 0.0]];
        Self::shape(&curve, &[0.0, length], false)
    }

    /// A circle of `radius` (m) to the left, from the origin along x; closed.
    pub fn circle(radius: f64) -> Result<Self, PathError> {
        positive("radius", radius)?;
        let curve = |t: f64| {
            let (s, c) = libm::sincos(t);
            [
                [radius * s, radius * (1.0 - c)],
                [radius * c, radius * s],
                [-radius * s, radius * c],
            ]
        };
        let knots: Vec<f64> = (0..=8).map(|i| TAU * f64::from(i) / 8.0).collect();
        Self::shape(&curve, &knots, true)
    }

    /// A figure eight: Bernoulli's lemniscate of half width `half_width` (m, a), from its crossing
    /// at the origin, turning left first; closed. Its curvature is 3ρ/a² at distance ρ from the
    /// crossing: 0 at the crossing, at most 3/a, smooth everywhere.
    ///
    /// The path starts along x, so the axis of the lemniscate lies at −45°.
    pub fn figure_eight(half_width: f64) -> Result<Self, PathError> {
        positive("half_width", half_width)?;
        let curve = |t: f64| {
            // ρ² = a² cos 2θ with the crossing at t = 0: x = a sin t/(1 + cos²t), y = x cos t.
            let (s, c) = libm::sincos(t);
            let (q, dq, ddq) = (1.0 + c * c, -2.0 * s * c, 2.0 * (s * s - c * c));
            let quotient = |n: f64, dn: f64, ddn: f64| {
                let first = (dn * q - n * dq) / (q * q);
                let second = (ddn - 2.0 * first * dq - n / q * ddq) / q;
                [n / q, first, second]
            };
            let x = quotient(s, c, -s);
            let y = quotient(s * c, c * c - s * s, -4.0 * s * c);
            // The loop of t > 0 turns right from +45°. Mirrored and rotated by 45°, the loop starts along
            // x and turns left.
            let h = 0.5f64.sqrt();
            [0, 1, 2].map(|k| {
                [
                    half_width * h * (x[k] + y[k]),
                    half_width * h * (x[k] - y[k]),
                ]
            })
        };
        let knots: Vec<f64> = (0..=16).map(|i| TAU * f64::from(i) / 16.0).collect();
        Self::shape(&curve, &knots, true)
    }

    /// The path rotated and shifted so that its origin lies at a posture (m, m, rad).
    #[must_use]
    pub fn placed(&self, [x, y, phi]: [f64; 3]) -> Self {
        let (s, c) = libm::sincos(phi);
        let mut path = self.clone();
        for at in path.samples.iter_mut().chain(&mut path.dense) {
            (at.x, at.y) = (x + c * at.x - s * at.y, y + s * at.x + c * at.y);
            at.phi += phi - TAU * ((at.phi + phi) / TAU).round();
        }
        path
    }

    /// Samples at equal steps; the last sample of a closed path repeats the first.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// True if the path is closed.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Length, m; the length of one lap if the path is closed.
    pub fn length(&self) -> f64 {
        self.samples.last().map_or(0.0, |last| last.s)
    }

    /// Largest |curvature| of the path, 1/m.
    pub fn max_curvature(&self) -> f64 {
        self.samples
            .iter()
            .chain(&self.dense)
            .fold(0.0, |most, at| at.kappa.abs().max(most))
    }

    /// Samples in the robot's single precision.
    pub fn points(&self) -> Vec<PathPoint> {
        self.samples.iter().map(|at| at.to_point()).collect()
    }

    fn position_of(&self, at: &Sample) -> PathPosition {
        let waypoint = self
            .waypoints
            .iter()
            .enumerate()
            .min_by(|(_, a), (_, b)| (a.0 - at.s).abs().total_cmp(&(b.0 - at.s).abs()))
            .map(|(i, (_, line))| (i + 1, *line));
        PathPosition {
            s: at.s,
            x: at.x,
            y: at.y,
            waypoint,
        }
    }

    /// Checks curvature and steering rate against the frame's limits; the error names the place of the largest value.
    pub fn check(&self, bounds: &Bounds) -> Result<(), PathError> {
        let bound = bounds.max_curvature();
        let worst = self
            .samples
            .iter()
            .chain(&self.dense)
            .max_by(|a, b| a.kappa.abs().total_cmp(&b.kappa.abs()));
        if let Some(at) = worst
            && !(at.kappa.abs() <= bound * (1.0 + 1e-9))
        {
            return Err(PathError::Curvature {
                place: self.position_of(at),
                value: at.kappa,
                bound,
            });
        }
        let bound = bounds.max_steering_rate_rad_s / bounds.min_speed_m_s;
        let mut worst = (0.0, None);
        for pair in self.samples.windows(2) {
            let change = bounds.steering(pair[1].kappa) - bounds.steering(pair[0].kappa);
            let slope = change.abs() / (pair[1].s - pair[0].s);
            if !(slope <= worst.0) {
                worst = (slope, Some(&pair[1]));
            }
        }
        match worst {
            (value, Some(at)) if !(value <= bound) => Err(PathError::SteeringRate {
                place: self.position_of(at),
                value,
                bound,
            }),
            _ => Ok(()),
        }
    }

    /// `laps` laps of a closed path as one open path; an open path is unchanged.
    pub fn unrolled(&self, laps: u32) -> Self {
        let mut path = self.clone();
        if self.closed {
            let (length, last) = (self.length(), self.samples.len() - 1);
            for lap in 1..laps.max(1) {
                let shifted = self.samples[1..=last].iter().map(|at| Sample {
                    s: at.s + f64::from(lap) * length,
                    ..*at
                });
                path.samples.extend(shifted);
            }
            path.closed = false;
        }
        path
    }

    /// The path at arc length `s` (m), limited to the ends of the path. Positions follow the cubic with the headings
    /// of both neighbouring samples.
    pub fn at(&self, s: f64) -> Sample {
        let last = self.samples.len() - 1;
        let i = self
            .samples
            .partition_point(|at| at.s <= s)
            .clamp(1, last.max(1))
            - 1;
        let (a, b) = (self.samples[i], self.samples[(i + 1).min(last)]);
        let h = b.s - a.s;
        let u = ((s - a.s) / h).clamp(0.0, 1.0);
        let [ease, leave, arrive] = cubic(u, h);
        let missing = wrapped(b.phi - a.phi) - 0.5 * h * (a.kappa + b.kappa);
        let rise = b.kappa - a.kappa;
        Sample {
            s: a.s + u * h,
            x: a.x + ease * (b.x - a.x) + leave * libm::cos(a.phi) + arrive * libm::cos(b.phi),
            y: a.y + ease * (b.y - a.y) + leave * libm::sin(a.phi) + arrive * libm::sin(b.phi),
            phi: wrapped(a.phi + u * h * (a.kappa + 0.5 * u * rise) + u * missing),
            kappa: a.kappa + u * rise,
        }
    }

    /// Arc length (m) of the point of the path nearest to `(x, y)` (m) among the points within `window` (m) of arc
    /// length `from` (m).
    pub fn nearest(&self, x: f64, y: f64, from: f64, window: f64) -> f64 {
        let first = self.samples.partition_point(|at| at.s < from - window);
        let (mut best, mut least) = (from, f64::INFINITY);
        for pair in self.samples[first.saturating_sub(1)..].windows(2) {
            let (a, b) = (pair[0], pair[1]);
            if a.s > from + window {
                break;
            }
            let (dx, dy) = (b.x - a.x, b.y - a.y);
            let projection = dx * (x - a.x) + dy * (y - a.y);
            let u = (projection / (dx * dx + dy * dy).max(1e-18)).clamp(0.0, 1.0);
            let gap = libm::hypot(x - a.x - u * dx, y - a.y - u * dy);
            if gap < least {
                (best, least) = (a.s + u * (b.s - a.s), gap);
            }
        }
        best
    }
}

/// Weights of the cubic Hermite interpolation between two points `h` apart, at `u` from 0 to 1: of the difference
/// between the points, of the slope at the first and of the slope at the second point.
pub(super) fn cubic(u: f64, h: f64) -> [f64; 3] {
    [
        u * u * (3.0 - 2.0 * u),
        u * (1.0 - u) * (1.0 - u) * h,
        -u * u * (1.0 - u) * h,
    ]
}

/// The angle wrapped to ±π, rad.
pub(super) fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}
