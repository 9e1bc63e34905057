//! Paths and trajectories for following and tracking, in `f64`: built-in shapes, splines through
//! waypoints, and the time law that makes a trajectory of a path.
//!
//! A path is sampled evenly by arc length. [`Path::check`] holds it against what the frame can
//! bend and names the first place that breaks a bound.

pub mod shortest;

use core_algos::control::path::{PathPoint, TrajectoryPoint};
use core_algos::math::Posture;
use std::f64::consts::{PI, TAU};
use std::fmt;
use std::io::Read;

/// Distance between samples, m.
pub const SPACING_M: f64 = 0.01;
/// Largest coordinate, m: beyond, single precision on the robot is coarser than a tenth of a
/// millimetre.
pub const MAX_COORDINATE_M: f64 = 1000.0;
/// Longest path, m.
pub const MAX_LENGTH_M: f64 = 5000.0;
/// Time to take up a bend before a trajectory starts, beyond what the steering rate needs, s.
const BENDING_S: f64 = 0.8;
/// Waypoints must be this far apart, m.
pub const MIN_SEPARATION_M: f64 = 1e-3;

/// One sample of a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Arc length, m.
    pub s: f64,
    /// Position, m.
    pub x: f64,
    /// Position, m.
    pub y: f64,
    /// Direction, rad in (−π, π].
    pub phi: f64,
    /// Curvature, 1/m, positive to the left.
    pub kappa: f64,
}

impl Sample {
    /// The same in the robot's single precision.
    pub fn to_point(self) -> PathPoint {
        PathPoint {
            posture: Posture::new(self.x as f32, self.y as f32, self.phi as f32),
            kappa: self.kappa as f32,
            s: self.s as f32,
        }
    }
}

/// A point that a path must pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Position, m.
    pub x: f64,
    /// Position, m.
    pub y: f64,
    /// Line of the file it was read from, from 1.
    pub line: Option<u64>,
}

impl From<(f64, f64)> for Waypoint {
    fn from((x, y): (f64, f64)) -> Self {
        Self { x, y, line: None }
    }
}

/// A place on a path, as an error names it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Arc length, m.
    pub s: f64,
    /// Position, m.
    pub x: f64,
    /// Position, m.
    pub y: f64,
    /// Nearest waypoint (from 1) and its line in the file.
    pub waypoint: Option<(usize, Option<u64>)>,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "s = {:.3} m, x = {:.3} m, y = {:.3} m",
            self.s, self.x, self.y
        )?;
        match self.waypoint {
            Some((number, Some(line))) => write!(f, " (near waypoint {number}, line {line})"),
            Some((number, None)) => write!(f, " (near waypoint {number})"),
            None => Ok(()),
        }
    }
}

/// Why there is no path.
#[derive(Clone, Debug, PartialEq)]
pub enum PathError {
    /// A parameter of a shape outside its range.
    Parameter {
        /// Its name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        allowed: &'static str,
    },
    /// A row that is not a waypoint.
    Row {
        /// Line in the file, from 1.
        line: u64,
        /// What is wrong with it.
        problem: String,
    },
    /// The file could not be read.
    Read(String),
    /// A waypoint that cannot be used.
    Waypoint {
        /// Its number, from 1.
        number: usize,
        /// Line in the file, from 1.
        line: Option<u64>,
        /// What is wrong with it.
        problem: String,
    },
    /// Fewer than two waypoints.
    TooFew(usize),
    /// Longer than [`MAX_LENGTH_M`].
    TooLong(f64),
    /// Curvature beyond what the frame can bend to.
    Curvature {
        /// Where.
        place: Place,
        /// The curvature there, 1/m.
        value: f64,
        /// Its bound, 1/m.
        bound: f64,
    },
    /// Curvature that changes faster than the frame can bend even at the least speed.
    SteeringRate {
        /// Where.
        place: Place,
        /// |dψ/ds| there, rad/m.
        value: f64,
        /// Its bound, rad/m.
        bound: f64,
    },
}

impl fmt::Display for PathError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parameter {
                name,
                value,
                allowed,
            } => write!(f, "{name} = {value}: must be {allowed}"),
            Self::Row { line, problem } => write!(f, "line {line}: {problem}"),
            Self::Read(problem) => f.write_str(problem),
            Self::Waypoint {
                number,
                line: Some(line),
                problem,
            } => write!(f, "line {line}, waypoint {number}: {problem}"),
            Self::Waypoint {
                number,
                line: None,
                problem,
            } => write!(f, "waypoint {number}: {problem}"),
            Self::TooFew(count) => {
                write!(f, "{count} waypoint(s): a path needs at least 2")
            }
            Self::TooLong(length) => write!(
                f,
                "the path is {length:.0} m long: must be at most {MAX_LENGTH_M} m"
            ),
            Self::Curvature {
                place,
                value,
                bound,
            } => write!(
                f,
                "curvature {value:.3} 1/m at {place}: the frame allows at most {bound:.3} 1/m"
            ),
            Self::SteeringRate {
                place,
                value,
                bound,
            } => write!(
                f,
                "steering changes by {value:.2} rad/m at {place}: at the least speed the frame \
                 allows at most {bound:.2} rad/m"
            ),
        }
    }
}

impl std::error::Error for PathError {}

/// What the frame can bend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Flexible length of the frame (L), m.
    pub frame_length_m: f64,
    /// Rigid length at each end of it, m.
    pub rigid_end_m: f64,
    /// Largest steering angle |ψ|, rad.
    pub max_steering_rad: f64,
    /// Largest steering rate |ψ̇|, rad/s.
    pub max_steering_rate_rad_s: f64,
    /// Speed below which the robot will not go for the sake of steering, m/s.
    pub min_speed_m_s: f64,
}

impl Default for Bounds {
    fn default() -> Self {
        Self {
            frame_length_m: 0.37,
            rigid_end_m: 0.0,
            max_steering_rad: 0.5,
            max_steering_rate_rad_s: 1.0,
            min_speed_m_s: 0.05,
        }
    }
}

impl Bounds {
    /// Curvature of the path (1/m) at a steering angle (rad): paper eq. 5, and rigid ends.
    fn curvature(&self, psi: f64) -> f64 {
        let (s, c) = psi.sin_cos();
        let sinc = if psi.abs() < 1e-6 { 1.0 } else { s / psi };
        2.0 * s / c / (self.frame_length_m * sinc + 2.0 * self.rigid_end_m * c)
    }

    /// Largest curvature, 1/m.
    pub fn max_curvature(&self) -> f64 {
        self.curvature(self.max_steering_rad)
    }

    /// Steering angle for a curvature (1/m), rad; monotone over all curvatures.
    pub fn steering(&self, kappa: f64) -> f64 {
        let bend = kappa.abs();
        let length = self.frame_length_m + 2.0 * self.rigid_end_m;
        // ψ ≤ ½ κ (L + 2a) < π/2, and the curvature grows with ψ between.
        let (mut low, mut high) = (0.0, (0.5 * bend * length).min(0.5 * PI));
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if self.curvature(middle) <= bend {
                low = middle;
            } else {
                high = middle;
            }
        }
        (0.5 * (low + high)).copysign(kappa)
    }
}

/// A plane curve: position and first two derivatives by its parameter.
type Curve<'a> = dyn Fn(f64) -> [[f64; 2]; 3] + 'a;

/// A path sampled evenly by arc length.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    samples: Vec<Sample>,
    /// Denser samples in the curve's parameter, so that no peak of curvature falls between.
    dense: Vec<Sample>,
    closed: bool,
    /// Arc length and line of each waypoint.
    waypoints: Vec<(f64, Option<u64>)>,
}

fn sample(curve: &Curve, t: f64, s: f64) -> Sample {
    let [[x, y], [dx, dy], [ddx, ddy]] = curve(t);
    let speed = dx.hypot(dy);
    Sample {
        s,
        x,
        y,
        phi: dy.atan2(dx),
        // At a cusp the curvature is infinite, not NaN.
        kappa: if speed > 0.0 {
            (dx * ddy - dy * ddx) / speed.powi(3)
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
            weight * half * dx.hypot(dy)
        })
        .sum()
}

/// The waypoints of a CSV file: two columns, x and y in metres, with or without the header `x,y`.
/// Empty lines are skipped.
pub fn waypoints(csv: &[u8]) -> Result<Vec<Waypoint>, PathError> {
    let mut waypoints = Vec::new();
    let mut first = true;
    let content = csv.strip_prefix(b"\xef\xbb\xbf").unwrap_or(csv);
    for (row, line) in content.split(|&byte| byte == b'\n').zip(1..) {
        let refuse = |problem: String| PathError::Row { line, problem };
        let row = std::str::from_utf8(row)
            .map_err(|_| refuse("not UTF-8".to_owned()))?
            .trim();
        if row.is_empty() {
            continue;
        }
        let fields: Vec<&str> = row
            .split(',')
            .map(|field| field.trim().trim_matches('"'))
            .collect();
        let &[x, y] = fields.as_slice() else {
            return Err(refuse(format!(
                "{} field(s): must be 2, x and y",
                fields.len()
            )));
        };
        if std::mem::take(&mut first) && x.eq_ignore_ascii_case("x") && y.eq_ignore_ascii_case("y")
        {
            continue;
        }
        let number = |name: &str, text: &str| {
            text.parse::<f64>().map_err(|_| {
                let shown: String = text.chars().take(40).collect();
                refuse(format!("{name} = {shown:?}: must be a number"))
            })
        };
        waypoints.push(Waypoint {
            x: number("x", x)?,
            y: number("y", y)?,
            line: Some(line),
        });
    }
    Ok(waypoints)
}

fn positive(name: &'static str, value: f64) -> Result<f64, PathError> {
    if value > 0.0 && value <= MAX_COORDINATE_M {
        Ok(value)
    } else {
        Err(PathError::Parameter {
            name,
            value,
            allowed: "a number greater than 0 and at most 1000",
        })
    }
}

impl Path {
    /// Samples `curve` over the knots of its parameter; each interval between knots is smooth.
    fn from_curve(curve: &Curve, knots: &[f64], closed: bool) -> Result<Self, PathError> {
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
                t = (t + gap / dx.hypot(dy).max(1e-9)).clamp(t0, t1);
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

    /// A straight line of `length` (m) from the origin along x.
    pub fn line(length: f64) -> Result<Self, PathError> {
        positive("length", length)?;
        let mut path = Self::from_curve(
            &|t| [[t, 0.0], [1.0, 0.0], [0.0, 0.0]],
            &[0.0, length],
            false,
        )?;
        path.waypoints.clear();
        Ok(path)
    }

    /// A circle of `radius` (m) to the left, from the origin along x; closed.
    pub fn circle(radius: f64) -> Result<Self, PathError> {
        positive("radius", radius)?;
        let curve = |t: f64| {
            let (s, c) = t.sin_cos();
            [
                [radius * s, radius * (1.0 - c)],
                [radius * c, radius * s],
                [-radius * s, radius * c],
            ]
        };
        let knots: Vec<f64> = (0..=8).map(|i| TAU * f64::from(i) / 8.0).collect();
        let mut path = Self::from_curve(&curve, &knots, true)?;
        path.waypoints.clear();
        Ok(path)
    }

    /// A figure eight: Bernoulli's lemniscate of half width `half_width` (m, a), from its crossing
    /// at the origin, turning left first; closed. Its curvature is 3ρ/a² at distance ρ from the
    /// crossing: 0 there, at most 3/a, and as smooth as a circle's everywhere.
    ///
    /// It starts along x, so its axis lies at −45°.
    pub fn figure_eight(half_width: f64) -> Result<Self, PathError> {
        positive("half_width", half_width)?;
        let curve = |t: f64| {
            // ρ² = a² cos 2θ with the crossing at t = 0: x = a sin t/(1 + cos²t), y = x cos t.
            let (s, c) = t.sin_cos();
            let (q, dq, ddq) = (1.0 + c * c, -2.0 * s * c, 2.0 * (s * s - c * c));
            let quotient = |n: f64, dn: f64, ddn: f64| {
                let first = (dn * q - n * dq) / (q * q);
                let second = (ddn - 2.0 * first * dq - n / q * ddq) / q;
                [n / q, first, second]
            };
            let x = quotient(s, c, -s);
            let y = quotient(s * c, c * c - s * s, -4.0 * s * c);
            // The loop of t > 0 turns right from +45°; mirrored and turned by 45° it starts along
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
        let mut path = Self::from_curve(&curve, &knots, true)?;
        path.waypoints.clear();
        Ok(path)
    }

    /// A cubic spline through waypoints, twice continuously differentiable in chord length. Ends
    /// are straight; if the last waypoint is the first again, the path is closed and as smooth
    /// there as elsewhere. Refuses fewer than two waypoints, any that is not finite or too large,
    /// and any that repeats the one before it.
    pub fn through(waypoints: &[Waypoint]) -> Result<Self, PathError> {
        let refuse = |number: usize, problem: String| PathError::Waypoint {
            number: number + 1,
            line: waypoints[number].line,
            problem,
        };
        if waypoints.len() < 2 {
            return Err(PathError::TooFew(waypoints.len()));
        }
        for (i, point) in waypoints.iter().enumerate() {
            for (name, value) in [("x", point.x), ("y", point.y)] {
                if !(value.abs() <= MAX_COORDINATE_M) {
                    return Err(refuse(
                        i,
                        format!("{name} = {value}: must be a number from -1000 to 1000"),
                    ));
                }
            }
        }
        let mut knots = vec![0.0];
        for (i, pair) in waypoints.windows(2).enumerate() {
            let chord = (pair[1].x - pair[0].x).hypot(pair[1].y - pair[0].y);
            if chord < MIN_SEPARATION_M {
                return Err(refuse(
                    i + 1,
                    format!(
                        "repeats waypoint {} (waypoints must be at least 1 mm apart)",
                        i + 1
                    ),
                ));
            }
            knots.push(knots[i] + chord);
        }
        let last = waypoints.len() - 1;
        let gap = (waypoints[last].x - waypoints[0].x).hypot(waypoints[last].y - waypoints[0].y);
        let closed = last >= 3 && gap < MIN_SEPARATION_M;
        let mut values = [
            waypoints.iter().map(|p| p.x).collect::<Vec<_>>(),
            waypoints.iter().map(|p| p.y).collect::<Vec<_>>(),
        ];
        if closed {
            for axis in &mut values {
                axis[last] = axis[0];
            }
        }
        let moments = values
            .each_ref()
            .map(|axis| spline_moments(&knots, axis, closed));
        let curve = |t: f64| {
            let i = knots.partition_point(|&k| k <= t).clamp(1, last) - 1;
            let h = knots[i + 1] - knots[i];
            let (b, a) = ((t - knots[i]) / h, (knots[i + 1] - t) / h);
            let mut result = [[0.0; 2]; 3];
            for axis in 0..2 {
                let (y0, y1) = (values[axis][i], values[axis][i + 1]);
                let (m0, m1) = (moments[axis][i], moments[axis][i + 1]);
                result[0][axis] =
                    a * y0 + b * y1 + ((a * a * a - a) * m0 + (b * b * b - b) * m1) * h * h / 6.0;
                result[1][axis] =
                    (y1 - y0) / h + ((3.0 * b * b - 1.0) * m1 - (3.0 * a * a - 1.0) * m0) * h / 6.0;
                result[2][axis] = a * m0 + b * m1;
            }
            result
        };
        let mut path = Self::from_curve(&curve, &knots, closed)?;
        for (place, waypoint) in path.waypoints.iter_mut().zip(waypoints) {
            place.1 = waypoint.line;
        }
        Ok(path)
    }

    /// A path through the waypoints of a CSV file, see [`waypoints`].
    pub fn from_csv(mut input: impl Read) -> Result<Self, PathError> {
        let mut bytes = Vec::new();
        input
            .read_to_end(&mut bytes)
            .map_err(|error| PathError::Read(error.to_string()))?;
        Self::through(&waypoints(&bytes)?)
    }

    /// The samples, evenly spaced; of a closed path the last is the first again.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Whether the path is a loop.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Length (of a loop: of one lap), m.
    pub fn length(&self) -> f64 {
        self.samples.last().map_or(0.0, |last| last.s)
    }

    /// Largest |curvature|, 1/m.
    pub fn max_curvature(&self) -> f64 {
        self.samples
            .iter()
            .chain(&self.dense)
            .fold(0.0, |most, at| at.kappa.abs().max(most))
    }

    /// The samples in the robot's single precision.
    pub fn points(&self) -> Vec<PathPoint> {
        self.samples.iter().map(|at| at.to_point()).collect()
    }

    fn place(&self, at: &Sample) -> Place {
        let waypoint = self
            .waypoints
            .iter()
            .enumerate()
            .min_by(|(_, a), (_, b)| (a.0 - at.s).abs().total_cmp(&(b.0 - at.s).abs()))
            .map(|(i, (_, line))| (i + 1, *line));
        Place {
            s: at.s,
            x: at.x,
            y: at.y,
            waypoint,
        }
    }

    /// Whether the frame can follow: the error names the place of the greatest excess.
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
                place: self.place(at),
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
                place: self.place(at),
                value,
                bound,
            }),
            _ => Ok(()),
        }
    }

    /// `laps` laps of a closed path as one open path; an open path as it is.
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

    /// The path at arc length `s` (m), limited to its ends: the cubic that keeps the headings of
    /// both neighbouring samples.
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
        let ease = u * u * (3.0 - 2.0 * u);
        let leave = u * (1.0 - u) * (1.0 - u) * h;
        let arrive = -u * u * (1.0 - u) * h;
        let missing = wrapped(b.phi - a.phi) - 0.5 * h * (a.kappa + b.kappa);
        let rise = b.kappa - a.kappa;
        Sample {
            s: a.s + u * h,
            x: a.x + ease * (b.x - a.x) + leave * a.phi.cos() + arrive * b.phi.cos(),
            y: a.y + ease * (b.y - a.y) + leave * a.phi.sin() + arrive * b.phi.sin(),
            phi: wrapped(a.phi + u * h * (a.kappa + 0.5 * u * rise) + u * missing),
            kappa: a.kappa + u * rise,
        }
    }

    /// Arc length (m) of the point of the path nearest to `(x, y)` (m) among those within
    /// `window` (m) of arc length `from` (m).
    pub fn nearest(&self, x: f64, y: f64, from: f64, window: f64) -> f64 {
        let first = self.samples.partition_point(|at| at.s < from - window);
        let (mut best, mut least) = (from, f64::INFINITY);
        for pair in self.samples[first.saturating_sub(1)..].windows(2) {
            let (a, b) = (pair[0], pair[1]);
            if a.s > from + window {
                break;
            }
            let (dx, dy) = (b.x - a.x, b.y - a.y);
            let along = dx * (x - a.x) + dy * (y - a.y);
            let u = (along / (dx * dx + dy * dy).max(1e-18)).clamp(0.0, 1.0);
            let gap = (x - a.x - u * dx).hypot(y - a.y - u * dy);
            if gap < least {
                (best, least) = (a.s + u * (b.s - a.s), gap);
            }
        }
        best
    }
}

fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

/// Second derivatives at the knots of the cubic spline through `values`: natural, or periodic.
fn spline_moments(knots: &[f64], values: &[f64], closed: bool) -> Vec<f64> {
    let n = knots.len() - 1;
    let h = |i: usize| knots[i + 1] - knots[i];
    let slope = |i: usize| (values[i + 1] - values[i]) / h(i);
    if !closed {
        let mut moments = vec![0.0; n + 1];
        if n < 2 {
            return moments;
        }
        let (lower, diagonal, right): (Vec<_>, Vec<_>, Vec<_>) = (1..n)
            .map(|i| {
                (
                    h(i - 1),
                    2.0 * (h(i - 1) + h(i)),
                    6.0 * (slope(i) - slope(i - 1)),
                )
            })
            .collect();
        let upper: Vec<_> = (1..n).map(h).collect();
        moments[1..n].copy_from_slice(&tridiagonal(&lower, &diagonal, &upper, &right));
        return moments;
    }
    // Knot n is knot 0: n unknowns in a ring, by Sherman and Morrison.
    let before = |i: usize| if i == 0 { n - 1 } else { i - 1 };
    let lower: Vec<_> = (0..n).map(|i| h(before(i))).collect();
    let upper: Vec<_> = (0..n).map(h).collect();
    let mut diagonal: Vec<_> = (0..n).map(|i| 2.0 * (h(before(i)) + h(i))).collect();
    let right: Vec<_> = (0..n)
        .map(|i| 6.0 * (slope(i) - slope(before(i))))
        .collect();
    let corner = lower[0];
    let gamma = -diagonal[0];
    diagonal[0] -= gamma;
    diagonal[n - 1] -= corner * corner / gamma;
    let mut edge = vec![0.0; n];
    edge[0] = gamma;
    edge[n - 1] = corner;
    let solution = tridiagonal(&lower, &diagonal, &upper, &right);
    let response = tridiagonal(&lower, &diagonal, &upper, &edge);
    let factor = (solution[0] + corner / gamma * solution[n - 1])
        / (1.0 + response[0] + corner / gamma * response[n - 1]);
    let mut moments: Vec<_> = solution
        .iter()
        .zip(&response)
        .map(|(value, share)| value - factor * share)
        .collect();
    moments.push(moments[0]);
    moments
}

/// Solves a tridiagonal system; `lower[0]` and the last of `upper` are not read.
fn tridiagonal(lower: &[f64], diagonal: &[f64], upper: &[f64], right: &[f64]) -> Vec<f64> {
    let n = diagonal.len();
    let mut ratio = vec![0.0; n];
    let mut solution = vec![0.0; n];
    for i in 0..n {
        let (before, value) = if i == 0 {
            (0.0, 0.0)
        } else {
            (lower[i] * ratio[i - 1], lower[i] * solution[i - 1])
        };
        let pivot = diagonal[i] - before;
        ratio[i] = upper[i] / pivot;
        solution[i] = (right[i] - value) / pivot;
    }
    for i in (0..n.saturating_sub(1)).rev() {
        solution[i] -= ratio[i] * solution[i + 1];
    }
    solution
}

/// Limits of the time law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeLimits {
    /// Largest speed, m/s.
    pub max_speed_m_s: f64,
    /// Largest acceleration along the path, m/s².
    pub max_acceleration_m_s2: f64,
    /// Largest steering rate, rad/s.
    pub max_steering_rate_rad_s: f64,
    /// Largest steering acceleration, rad/s².
    pub max_steering_acceleration_rad_s2: f64,
    /// Time over which speed is averaged, s: acceleration is continuous, its rate at most twice
    /// the acceleration over this.
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
pub struct Timed {
    /// Time, s.
    pub t: f64,
    /// Speed, m/s.
    pub v: f64,
    /// Acceleration along the path, m/s².
    pub a: f64,
    /// Where the reference is.
    pub sample: Sample,
}

/// A path with a time law: from rest to rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    points: Vec<Timed>,
}

impl Trajectory {
    /// The fastest time law along an open path (see [`Path::unrolled`]) that keeps the limits,
    /// averaged over [`TimeLimits::smoothing_s`]. If the path starts with a bend, the trajectory
    /// first waits for the frame to take it.
    pub fn along(path: &Path, bounds: &Bounds, limits: &TimeLimits) -> Result<Self, PathError> {
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

        // What steering allows at each sample.
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
        // Averaging mixes speeds from this far around.
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
            speed[i] = speed[i].min((speed[i - 1].powi(2) + 2.0 * acceleration * step).sqrt());
        }
        for i in (0..n - 1).rev() {
            speed[i] = speed[i].min((speed[i + 1].powi(2) + 2.0 * acceleration * step).sqrt());
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
                Timed {
                    t: i as f64 * limits.interval_s,
                    v: (late.s - early.s) / window,
                    a: (late.v - early.v) / window,
                    sample: path.at((late.integral - early.integral) / window),
                }
            })
            .collect();
        Ok(Self { points })
    }

    /// The points, evenly spaced in time.
    pub fn points(&self) -> &[Timed] {
        &self.points
    }

    /// Time from start to end, s.
    pub fn duration(&self) -> f64 {
        self.points.last().map_or(0.0, |last| last.t)
    }

    /// Arc length at time `t` (s), m: the cubic through both neighbouring points with their
    /// speeds; before the start and after the end, at rest.
    pub fn arc_length(&self, t: f64) -> f64 {
        let last = self.points.len() - 1;
        let i = self.points.partition_point(|at| at.t <= t).clamp(1, last) - 1;
        let (a, b) = (self.points[i], self.points[i + 1]);
        let span = b.t - a.t;
        let u = ((t - a.t) / span).clamp(0.0, 1.0);
        let ease = u * u * (3.0 - 2.0 * u);
        let leave = u * (1.0 - u) * (1.0 - u) * span;
        let arrive = -u * u * (1.0 - u) * span;
        a.sample.s + ease * (b.sample.s - a.sample.s) + leave * a.v + arrive * b.v
    }

    /// The points in the robot's single precision.
    pub fn to_points(&self) -> Vec<TrajectoryPoint> {
        let mut reached = 0.0f32;
        self.points
            .iter()
            .map(|at| {
                let mut point = at.sample.to_point();
                // Rounding must not let arc length fall.
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

/// Speed, distance and its integral at one time of a piecewise constant acceleration.
#[derive(Clone, Copy)]
struct Moving {
    v: f64,
    s: f64,
    integral: f64,
}

struct TimeLaw {
    /// Start of each piece: time, state, acceleration.
    pieces: Vec<(f64, Moving, f64)>,
    end: (f64, Moving),
}

impl TimeLaw {
    fn new(samples: &[Sample], speed: &[f64], step: f64) -> Self {
        let mut t = 0.0;
        let mut integral = 0.0;
        let mut pieces = Vec::with_capacity(speed.len());
        for (i, pair) in speed.windows(2).enumerate() {
            let span = 2.0 * step / (pair[0] + pair[1]).max(1e-9);
            let a = (pair[1] - pair[0]) / span;
            let start = Moving {
                v: pair[0],
                s: samples[i].s,
                integral,
            };
            pieces.push((t, start, a));
            integral += span * (start.s + span * (start.v / 2.0 + span * a / 6.0));
            t += span;
        }
        let end = Moving {
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

    fn at(&self, t: f64) -> Moving {
        if t <= 0.0 {
            return Moving {
                v: 0.0,
                s: 0.0,
                integral: 0.0,
            };
        }
        let (last, end) = self.end;
        if t >= last {
            return Moving {
                integral: end.integral + end.s * (t - last),
                ..end
            };
        }
        let i = self.pieces.partition_point(|piece| piece.0 <= t).max(1) - 1;
        let (start, from, a) = self.pieces[i];
        let u = t - start;
        Moving {
            v: from.v + a * u,
            s: from.s + u * (from.v + 0.5 * a * u),
            integral: from.integral + u * (from.s + u * (from.v / 2.0 + u * a / 6.0)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::control::path::TrajectoryBuffer;

    /// Distance (m) of a point from the path.
    fn distance(path: &Path, x: f64, y: f64) -> f64 {
        path.samples
            .windows(2)
            .map(|pair| {
                let (dx, dy) = (pair[1].x - pair[0].x, pair[1].y - pair[0].y);
                let (px, py) = (x - pair[0].x, y - pair[0].y);
                let u = ((dx * px + dy * py) / (dx * dx + dy * dy).max(1e-18)).clamp(0.0, 1.0);
                (px - u * dx).hypot(py - u * dy)
            })
            .fold(f64::INFINITY, f64::min)
    }

    fn line_of(points: &[(f64, f64)]) -> Result<Path, PathError> {
        let points: Vec<Waypoint> = points.iter().map(|&p| p.into()).collect();
        Path::through(&points)
    }

    /// Spacing, heading and curvature of the samples against differences of their positions.
    fn assert_consistent(path: &Path) {
        let samples = path.samples();
        let step = path.length() / (samples.len() - 1) as f64;
        for three in samples.windows(3) {
            let [a, b, c] = [three[0], three[1], three[2]];
            let chord = (b.x - a.x).hypot(b.y - a.y);
            let sagged = step * (1.0 - (step * b.kappa).powi(2) / 24.0);
            assert!((chord - sagged).abs() < 3e-6, "{chord} {sagged} {b:?}");
            let direction = (c.y - a.y).atan2(c.x - a.x);
            assert!(wrapped(direction - b.phi).abs() < 1e-3, "{b:?}");
            let turning = wrapped(c.phi - a.phi) / (2.0 * step);
            assert!(
                (turning - b.kappa).abs() < 0.02 * (1.0 + b.kappa.abs()),
                "{b:?}"
            );
        }
    }

    #[test]
    fn built_in_shapes_are_what_they_say() {
        let line = Path::line(2.0).unwrap();
        assert_consistent(&line);
        assert_eq!((line.length(), line.max_curvature()), (2.0, 0.0));

        let circle = Path::circle(0.8).unwrap();
        assert_consistent(&circle);
        assert!((circle.length() - TAU * 0.8).abs() < 1e-9);
        assert!(
            circle
                .samples()
                .iter()
                .all(|at| (at.x.hypot(at.y - 0.8) - 0.8).abs() < 1e-9)
        );
        assert!(
            circle
                .samples()
                .iter()
                .all(|at| (at.kappa - 1.25).abs() < 1e-9)
        );

        let eight = Path::figure_eight(1.2).unwrap();
        assert_consistent(&eight);
        // Bernoulli: 5.244115 a long, 3/a at the tips, |P − F1| |P − F2| = a²/2.
        assert!((eight.length() - 5.244_115_108_58 * 1.2).abs() < 1e-8);
        assert!((eight.max_curvature() - 3.0 / 1.2).abs() < 1e-6);
        let focus = 1.2 / 2.0; // a/√2 along each of x and −y
        for at in eight.samples() {
            let product = (at.x - focus).hypot(at.y + focus) * (at.x + focus).hypot(at.y - focus);
            let mirrored = (at.x - focus).hypot(at.y - focus) * (at.x + focus).hypot(at.y + focus);
            assert!((product - 0.72).abs() < 1e-9 || (mirrored - 0.72).abs() < 1e-9);
        }
        let start = eight.samples()[0];
        assert!(start.x.abs() < 1e-12 && start.y.abs() < 1e-12 && start.phi.abs() < 1e-12);
        assert!(eight.samples()[5].kappa > 0.0, "left first");
    }

    #[test]
    fn spline_passes_its_waypoints_with_continuous_curvature() {
        let points = [(0.0, 0.0), (0.8, 0.1), (1.5, 0.8), (2.5, 0.6), (3.0, -0.4)];
        let path = line_of(&points).unwrap();
        assert_consistent(&path);
        for (x, y) in points {
            assert!(distance(&path, x, y) < 2e-4);
        }
        let step = path.length() / (path.samples().len() - 1) as f64;
        for pair in path.samples().windows(2) {
            assert!((pair[1].kappa - pair[0].kappa).abs() < 20.0 * step);
        }
        assert!(path.samples()[0].kappa.abs() < 1e-9, "straight at its ends");
    }

    #[test]
    fn closed_spline_is_smooth_where_it_closes() {
        let on_circle: Vec<(f64, f64)> = (0..=24)
            .map(|i| (TAU * f64::from(i) / 24.0).sin_cos())
            .collect();
        let path = line_of(&on_circle).unwrap();
        assert!(path.is_closed());
        // Clockwise round the unit circle; a spline errs by h²/12 in curvature.
        for at in path.samples() {
            assert!((at.kappa + 1.0).abs() < 0.007, "{at:?}");
        }
        let (first, last) = (path.samples()[0], *path.samples().last().unwrap());
        assert!((first.kappa - last.kappa).abs() < 1e-9);
        assert!(wrapped(first.phi - last.phi).abs() < 1e-9);
    }

    #[test]
    fn a_path_too_tight_is_refused_with_place_and_value() {
        let bounds = Bounds::default();
        assert!(Path::circle(0.33).unwrap().check(&bounds).is_ok());
        let error = Path::circle(0.3).unwrap().check(&bounds).unwrap_err();
        assert!(error.to_string().starts_with("curvature 3.333 1/m at s = "));
        assert!(error.to_string().ends_with("at most 3.080 1/m"));

        // A corner at the third waypoint.
        let corner = line_of(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 0.3), (2.0, 2.0)]);
        let PathError::Curvature { place, value, .. } = corner.unwrap().check(&bounds).unwrap_err()
        else {
            panic!("not refused for curvature");
        };
        assert!(value > 3.08);
        assert_eq!(place.waypoint, Some((3, None)));
        assert!((place.x - 2.0).hypot(place.y) < 0.1);
    }

    #[test]
    fn curvature_that_changes_too_fast_is_refused() {
        let eight = Path::figure_eight(1.2).unwrap();
        let slow = Bounds {
            max_steering_rate_rad_s: 0.01,
            ..Bounds::default()
        };
        assert!(eight.check(&Bounds::default()).is_ok());
        let error = eight.check(&slow).unwrap_err();
        assert!(
            matches!(error, PathError::SteeringRate { bound, .. } if (bound - 0.2).abs() < 1e-12)
        );
        assert!(error.to_string().contains("rad/m at s = "));
    }

    #[test]
    fn bad_waypoints_are_named() {
        let text = |result: Result<Path, PathError>| result.unwrap_err().to_string();
        let csv = |rows: &str| text(Path::from_csv(rows.as_bytes()));
        assert_eq!(
            text(line_of(&[(0.0, 0.0)])),
            "1 waypoint(s): a path needs at least 2"
        );
        assert_eq!(csv("x,y\n"), "0 waypoint(s): a path needs at least 2");
        assert_eq!(
            csv("x,y\n0,0\n1,a\n"),
            "line 3: y = \"a\": must be a number"
        );
        assert_eq!(
            csv("0,0\n\n1,1,1\n"),
            "line 3: 3 field(s): must be 2, x and y"
        );
        assert!(csv("0,0\n1,NaN\n").starts_with("line 2, waypoint 2: y = NaN: must be"));
        assert!(csv("0,0\ninf,1\n").starts_with("line 2, waypoint 2: x = inf"));
        assert!(csv("0,0\n1,1\n1,1\n2,2\n").starts_with("line 3, waypoint 3: repeats waypoint 2"));
        assert!(csv("0,0\nx,y\n").starts_with("line 2: x = \"x\""));
        let bytes: &[u8] = b"0,0\n\xff,1\n";
        assert!(text(Path::from_csv(bytes)).starts_with("line 2: not UTF-8"));
        assert!(text(Path::circle(f64::NAN)).starts_with("radius = NaN"));
        assert!(text(Path::line(0.0)).starts_with("length = 0"));
    }

    #[test]
    fn header_is_optional() {
        let with = Path::from_csv("X, Y\n0,0\n1,0.1\n2,0\n".as_bytes()).unwrap();
        let without = Path::from_csv("0,0\n1,0.1\n2,0".as_bytes()).unwrap();
        assert_eq!(with.samples(), without.samples());
    }

    #[test]
    fn closed_path_is_unrolled() {
        let circle = Path::circle(0.5).unwrap();
        let twice = circle.unrolled(2);
        assert!(!twice.is_closed());
        assert!((twice.length() - 2.0 * circle.length()).abs() < 1e-9);
        assert_consistent(&twice);
    }

    #[test]
    fn trajectory_keeps_its_limits_and_is_its_own_derivative() {
        let (bounds, limits) = (Bounds::default(), TimeLimits::default());
        for path in [
            Path::line(1.0).unwrap(),
            Path::line(0.03).unwrap(),
            Path::figure_eight(1.0).unwrap().unrolled(2),
            line_of(&[(0.0, 0.0), (1.0, 0.1), (1.8, 0.9), (3.0, 1.0)]).unwrap(),
        ] {
            let trajectory = Trajectory::along(
                &path,
                &bounds,
                &TimeLimits {
                    interval_s: 0.01,
                    ..limits
                },
            )
            .unwrap();
            let points = trajectory.points();
            let (first, last) = (points[0], *points.last().unwrap());
            assert!(first.v.abs() < 1e-9 && last.v.abs() < 1e-9);
            assert!((last.sample.s - path.length()).abs() < 1e-6);
            let mut fastest = 0.0f64;
            for pair in points.windows(2) {
                let [a, b] = [pair[0], pair[1]];
                fastest = fastest.max(b.v);
                assert!(b.v <= limits.max_speed_m_s + 1e-9 && b.v >= -1e-9);
                assert!(b.a.abs() <= limits.max_acceleration_m_s2 + 1e-9);
                assert!((b.sample.s - a.sample.s - 0.005 * (a.v + b.v)).abs() < 1e-5);
                assert!((b.v - a.v - 0.005 * (a.a + b.a)).abs() < 1e-4);
                let jerk = 2.0 * limits.max_acceleration_m_s2 / limits.smoothing_s;
                assert!((b.a - a.a).abs() <= jerk * 0.01 + 1e-9);
                let turn = bounds.steering(b.sample.kappa) - bounds.steering(a.sample.kappa);
                assert!(turn.abs() / 0.01 < limits.max_steering_rate_rad_s);
            }
            assert!(fastest > 0.19 || path.length() < 0.1);
            // On the robot: the same in single precision.
            let mut buffer = TrajectoryBuffer::<8000>::new();
            for point in trajectory.to_points() {
                buffer.push(point).unwrap();
            }
        }
    }
}
