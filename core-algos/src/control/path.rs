//! Paths and trajectories, and the reference that runs along them.
//!
//! # Theory
//!
//! A path is a sequence of points 1 to 2 cm apart, each with posture, curvature and arc length. Points can be
//! streamed while the robot drives ([`PathBuffer`]). Between points, position is the cubic that matches both
//! headings, curvature is linear, and heading is the integral of curvature.
//!
//! **Path following** ([`Follower`]) is time-invariant: the reference is at the point of the path nearest to O, and
//! so waits for the robot. The reference speed is the largest that still allows the robot, with the configured
//! deceleration and reaction time, to meet all limits ahead: steering rate `|dψ/ds| v`, steering acceleration
//! `|d²ψ/ds²| v² + |dψ/ds| v̇`, and the end of the path.
//!
//! **Trajectory tracking** ([`Tracker`]) takes the reference from time instead.
//!
//! In both, law (4) lets O trail its reference by the distance e on the law's manifold, `e = r√2 √(ε + 2 sin²θ)`. On
//! a path of curvature κ_r, with O on the path, `sin θ = −κ_r e/2`, hence `e = r√(2ε)/√(1 − r²κ_r²)`: the paper's
//! distance on a straight line and more on a bend (27 % at r = 0.2 m, κ = 3.1 1/m). The reference is led along the
//! path by this distance, so that O runs on the path and stops at its end. For a robot at y to the left of the path,
//! `sin θ = −(y/e + κ_r e/2)`, and the follower leads by the e of this equation. The reference is then where the
//! robot's circle meets the path, and the robot need not reverse to reach it.
//!
//! With the lead, ε can be chosen freely: on a straight path y decays at the rate `2 v/(r√(2ε))`, which should stay
//! below what steering can follow. At r = 0.2 m and 0.25 m/s, an ε of 0.1 (e = 9 cm) keeps O three times nearer to a
//! curved path than the 1e-3 that suits posture regulation.
//!
//! Paths are driven forward.
//!
//! [`Follower::governor_input`] and [`Tracker::governor_input`] apply law (4) to the reference and give the input of
//! the governor. The heading gain k2 is scaled by |v|/v_0, with v_0 the nominal speed. Heading is then corrected per
//! length and not per time, so that slow driving does not cause sharp bends. At v_0 the law is the paper's.
//!
//! # Panic contract
//!
//! [`Config::build`] validates the limits and the buffers reject invalid points; following and tracking cannot fail.
//! An empty buffer and a posture that is not finite give no reference.

mod buffer;

pub use buffer::{
    Buffer, PathBuffer, PathError, PathPoint, PathSample, Point, TrajectoryBuffer, TrajectoryPoint,
};

use super::cascade::Cascade;
use super::governor::GovernorInput;
use super::kinematic::{Law, Reference};
use crate::config::{Allowed, ConfigError, declare, positive};
use crate::math::trig::{clamp, sqrt};
use crate::math::{Posture, Transform};
use buffer::MAX_BEND_SQUARED;

/// Speed (m/s) of law (4) below which the law's curvature is blended into the path's. The law's curvature is yaw rate
/// over speed and loses its meaning as both vanish.
const SLOW_M_S: f32 = 0.03;
/// Steering error that does not reduce the speed, rad: the lag of the governor where the curvature of a path begins
/// or ceases to grow. The slack costs tenths of a millimetre across the path; waiting would cost several millimetres
/// along a trajectory.
const STEERING_SLACK_RAD: f32 = 0.03;
declare! {
    /// Limits along a path.
    pub struct Config {
        /// Speed without other limits.
        pub max_speed_m_s: f32 = 0.25, "m/s": Positive;
        /// Speed at which law (4) has its configured heading gain k2 (v_0). At other speeds v the gain is k2 |v|/v_0.
        pub nominal_speed_m_s: f32 = 0.25, "m/s": Range(0.01, 2.0);
        /// Deceleration ahead of bends and of the end; somewhat below the governor's.
        pub deceleration_m_s2: f32 = 0.3, "m/s²": Range(0.01, 5.0);
        /// Largest |ψ̇| along the path; somewhat below the governor's.
        pub max_steering_rate_rad_s: f32 = 0.8, "rad/s": Positive;
        /// Largest |ψ̈| along the path; somewhat below the governor's.
        pub max_steering_acceleration_rad_s2: f32 = 6.0, "rad/s²": Positive;
        /// Least speed, kept even where the curvature changes too fast; the governor then makes the speed wait for
        /// steering.
        pub min_speed_m_s: f32 = 0.02, "m/s": Positive;
        /// Delay of the robot's speed behind a falling reference speed.
        pub reaction_time_s: f32 = 0.2, "s": NonNegative;
        /// Length of path ahead of the last position that is searched for the robot.
        pub search_window_m: f32 = 0.1, "m": Positive;
        /// Remaining distance at which the end of the path counts as reached.
        pub end_tolerance_m: f32 = 0.002, "m": Positive;
    }
}

impl Config {
    /// The path follower for a frame and a law; the error names the invalid field.
    pub fn build(&self, cascade: &Cascade, law: &Law) -> Result<Follower, ConfigError> {
        self.check_ranges()?;
        Allowed::Range(1e-3, self.max_speed_m_s).check("min_speed_m_s", self.min_speed_m_s)?;
        Ok(Follower {
            config: *self,
            steering: SteeringLaw {
                cascade: *cascade,
                law: *law,
                nominal_speed: self.nominal_speed_m_s,
            },
            lead: Lead::of(law),
        })
    }
}

/// Distance by which the reference runs ahead of O along the path, so that O, which trails it, stays on the path.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Lead {
    /// Distance by which O trails a reference on a straight path, r√(2ε), m.
    rest: f32,
    /// Circle radius r of law (4), m.
    radius: f32,
}

impl Lead {
    fn of(law: &Law) -> Self {
        Self {
            rest: law.rest_distance(),
            radius: law.config().circle_radius_m,
        }
    }

    /// Distance along the path from O to the reference on the manifold, m, for a path of curvature
    /// `kappa` (1/m) and O at `lateral` (m) to its left.
    ///
    /// With E = e²: `(1 − r²κ²) E² − (2r²ε + 4r²yκ) E − 4r²y² = 0`.
    fn distance(&self, kappa: f32, lateral: f32) -> f32 {
        let square = self.radius * self.radius;
        let a = 1.0 - (square * kappa * kappa).min(MAX_BEND_SQUARED);
        let b = self.rest * self.rest + 4.0 * square * lateral * kappa;
        let c = 4.0 * square * lateral * lateral;
        let e_squared = (b + sqrt(b * b + 4.0 * a * c)) / (2.0 * a);
        let ahead = e_squared - lateral * lateral;
        sqrt(ahead.max(self.rest * self.rest))
    }
}

/// Law (4) with the frame it steers.
#[derive(Clone, Copy, Debug, PartialEq)]
struct SteeringLaw {
    cascade: Cascade,
    law: Law,
    /// Nominal speed v_0, m/s.
    nominal_speed: f32,
}

impl SteeringLaw {
    /// dκ/dψ at a curvature (1/m), 1/(m rad).
    fn curvature_slope(&self, kappa: f32) -> f32 {
        let [_, slope, _] = self
            .cascade
            .curvature_derivatives(self.cascade.steering(kappa));
        slope
    }

    /// The law's velocity and curvature for `reference`. As the velocity vanishes, the curvature is blended into
    /// `kappa`, the path's curvature at O.
    fn governor_input(
        &self,
        center: &Transform,
        reference: Reference,
        kappa: f32,
        rates: (f32, f32),
    ) -> GovernorInput {
        let (command, by_heading) = self.law.ahead(center, reference);
        let direction = 1.0f32.copysign(command.v);
        let demanded = (command.phi_dot - by_heading) / (direction * command.v.abs().max(1e-3))
            + direction * by_heading / self.nominal_speed;
        let bound = self.cascade.max_curvature();
        let share = (command.v.abs() / SLOW_M_S).min(1.0);
        let curvature = share * clamp(demanded, -bound, bound) + (1.0 - share) * kappa;
        GovernorInput {
            v_rate: rates.0,
            psi_rate: rates.1,
            steering_slack: STEERING_SLACK_RAD,
            ..GovernorInput::from_curvature(&self.cascade, command.v, curvature)
        }
    }
}

/// Progress along a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Arc length of the point of the path nearest to O, m. Never decreases.
    pub s: f32,
    /// True if the robot has been found on the path.
    pub started: bool,
    /// True if the end has been reached; stays true.
    pub finished: bool,
}

/// Reference on a path, and the robot's deviation from the path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathReference {
    /// Reference of law (4), led so that O runs on the path.
    pub reference: Reference,
    /// Target posture of O on the path.
    pub target: Posture,
    /// Curvature of the path at the target, 1/m.
    pub kappa: f32,
    /// Rate of the reference speed while it falls, m/s²: feedforward for the governor.
    pub v_rate: f32,
    /// Rate of curvature along the path at O (dκ/ds), 1/m².
    pub kappa_slope: f32,
    /// Steering rate along the path at the reference speed, rad/s: feedforward for the governor.
    pub psi_rate: f32,
    /// Distance of O to the left of the path, m.
    pub lateral_error_m: f32,
}

/// Path follower: finds O on a path, and leads a reference along the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follower {
    config: Config,
    steering: SteeringLaw,
    lead: Lead,
}

/// Nearest point of the chord from `a` to `b`: its arc length and squared distance.
fn nearest(a: PathPoint, b: PathPoint, at: Posture) -> (f32, f32) {
    let (dx, dy) = (b.posture.x - a.posture.x, b.posture.y - a.posture.y);
    let (px, py) = (at.x - a.posture.x, at.y - a.posture.y);
    let square = (dx * dx + dy * dy).max(1e-12);
    let u = clamp((dx * px + dy * py) / square, 0.0, 1.0);
    let (ex, ey) = (px - u * dx, py - u * dy);
    (a.s + u * (b.s - a.s), ex * ex + ey * ey)
}

impl Follower {
    /// Input of the governor for O at `center`: law (4) on the reference of [`Self::step`], with the
    /// path's deceleration and steering rate as feedforward.
    pub fn governor_input(
        &self,
        center: impl Into<Transform>,
        reference: &PathReference,
    ) -> GovernorInput {
        let rates = (reference.v_rate, reference.psi_rate);
        self.steering
            .governor_input(&center.into(), reference.reference, reference.kappa, rates)
    }

    /// Progress of `center` (the posture of O) along the path. At the first step: the nearest point of the whole path.
    /// Later: the nearest point, ahead of the last point, of the segments that begin within the search window.
    fn progress<const N: usize>(
        &self,
        last: &Progress,
        path: &PathBuffer<N>,
        center: Posture,
    ) -> Progress {
        let (from, window) = if last.started {
            (last.s.max(path.start()), self.config.search_window_m)
        } else {
            (path.start(), f32::INFINITY)
        };
        let (mut s, mut least) = (from, f32::INFINITY);
        for [a, b] in path.segments_from(from) {
            if !(a.s <= from + window) {
                break;
            }
            let (place, square) = nearest(a, b, center);
            if square < least {
                least = square;
                s = place;
            }
        }
        Progress {
            s: s.max(from).min(path.end()),
            started: true,
            finished: last.finished,
        }
    }

    /// Largest speed (m/s) at `distance` (m) before a point with the speed limit `limit` (m/s), and its rate (m/s²)
    /// as the robot approaches this point. The robot brakes at the configured deceleration after the reaction time.
    fn braking(&self, limit: f32, distance: f32) -> (f32, f32) {
        let a = self.config.deceleration_m_s2;
        let delay = a * self.config.reaction_time_s;
        let reach = limit + delay;
        let reach = sqrt(reach * reach + 2.0 * a * distance.max(0.0));
        let speed = (reach - delay).max(0.0);
        // Rate of `speed` along the path: v dv/ds.
        let rate = if distance > 0.0 {
            -a * speed / reach
        } else {
            0.0
        };
        (speed, rate)
    }

    /// Reference speed at arc length `s`, m/s, and its rate while it falls, m/s².
    fn speed<const N: usize>(&self, path: &PathBuffer<N>, s: f32, end: f32) -> (f32, f32) {
        let config = &self.config;
        let top = config.max_speed_m_s;
        let lower = |a: (f32, f32), b: (f32, f32)| if b.0 < a.0 { b } else { a };
        let mut speed = lower((top, 0.0), self.braking(0.0, (end - s).min(1e3)));
        // Points beyond this distance do not limit the speed: even braking to a stop would begin later.
        let horizon = top * config.reaction_time_s + 0.5 * top * top / config.deceleration_m_s2;
        let mut steering = None;
        let mut before: Option<(f32, f32)> = None;
        for [a, b] in path.segments_from(s) {
            if !(a.s - s <= horizon) {
                break;
            }
            let length = (b.s - a.s).max(1e-6);
            let cascade = &self.steering.cascade;
            let from = steering.unwrap_or_else(|| cascade.steering(a.kappa));
            let to = if a.kappa == b.kappa {
                from
            } else {
                cascade.steering(b.kappa)
            };
            steering = Some(to);
            let slope = (to.0 - from.0) / length;
            let mut limit = config.max_steering_rate_rad_s / slope.abs().max(1e-6);
            if let Some((last, last_length)) = before {
                let second = 2.0 * (slope - last).abs() / (last_length + length);
                let left = config.max_steering_acceleration_rad_s2
                    - slope.abs().max(last.abs()) * config.deceleration_m_s2;
                limit = limit.min(sqrt(left.max(0.0) / second.max(1e-6)));
            }
            before = Some((slope, length));
            let limit = limit.max(config.min_speed_m_s);
            // A point whose limit is at least the speed found so far does not reduce this speed.
            if !(limit >= speed.0) {
                speed = lower(speed, self.braking(limit, a.s - s));
            }
        }
        speed
    }

    /// One step: finds O on the path and returns its reference. `None` if there is no path
    /// or the posture is not finite.
    pub fn step<const N: usize>(
        &self,
        last: &Progress,
        path: &PathBuffer<N>,
        center: Posture,
    ) -> Option<(Progress, PathReference)> {
        if !center.is_finite() {
            return None;
        }
        let mut progress = self.progress(last, path, center);
        let end = path.end();
        let remaining = (end - progress.s).max(0.0);
        progress.finished |= path.is_complete() && remaining <= self.config.end_tolerance_m;
        if progress.finished {
            // The law drives the remaining distance with its reference at rest.
            progress.s = end;
        }
        let here = path.at(progress.s)?;

        let lateral_error_m = center.relative_to(here.posture).y;
        let ahead = progress.s + self.lead.distance(here.kappa, lateral_error_m);
        let led = path.at(ahead)?;
        let (v, v_rate) = if progress.finished {
            (0.0, 0.0)
        } else {
            self.speed(path, progress.s, end)
        };
        let by_psi = self.steering.curvature_slope(here.kappa);
        Some((
            progress,
            PathReference {
                reference: Reference {
                    posture: led.posture,
                    v,
                    kappa: led.kappa,
                },
                target: here.posture,
                kappa: here.kappa,
                v_rate,
                kappa_slope: here.kappa_slope,
                psi_rate: here.kappa_slope * v / by_psi,
                lateral_error_m,
            },
        ))
    }
}

/// Reference on a trajectory at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrajectoryReference {
    /// Reference of law (4), led so that O runs on the trajectory.
    pub reference: Reference,
    /// Target posture of O.
    pub target: Posture,
    /// Curvature of the path at the target, 1/m.
    pub kappa: f32,
    /// Acceleration along the path, m/s².
    pub acceleration: f32,
    /// Steering rate along the trajectory, rad/s: feedforward for the governor.
    pub psi_rate: f32,
    /// True if the last known point has been reached.
    pub finished: bool,
}

/// Trajectory tracker: leads a reference along a trajectory by time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tracker {
    steering: SteeringLaw,
    lead: Lead,
}

impl Tracker {
    /// The tracker for a frame, a law and the nominal speed of the trajectories (m/s).
    pub fn new(cascade: &Cascade, law: &Law, nominal_speed_m_s: f32) -> Result<Self, ConfigError> {
        Ok(Self {
            steering: SteeringLaw {
                cascade: *cascade,
                law: *law,
                nominal_speed: positive("nominal_speed_m_s", nominal_speed_m_s)?,
            },
            lead: Lead::of(law),
        })
    }

    /// Input of the governor for O at `center`: law (4) on the reference of [`Self::at`], with the
    /// trajectory's acceleration and steering rate as feedforward.
    pub fn governor_input(
        &self,
        center: impl Into<Transform>,
        reference: &TrajectoryReference,
    ) -> GovernorInput {
        let rates = (reference.acceleration, reference.psi_rate);
        self.steering
            .governor_input(&center.into(), reference.reference, reference.kappa, rates)
    }

    /// The reference at `time` (s). `None` if there is no trajectory or the time is NaN.
    pub fn at<const N: usize>(
        &self,
        trajectory: &TrajectoryBuffer<N>,
        time: f32,
    ) -> Option<TrajectoryReference> {
        if time.is_nan() {
            return None;
        }
        let [s, v, acceleration] = trajectory.time_law(time)?;
        let here = trajectory.at(s)?;
        let led = trajectory.at(s + self.lead.distance(here.kappa, 0.0))?;
        let by_psi = self.steering.curvature_slope(here.kappa);
        Some(TrajectoryReference {
            reference: Reference {
                posture: led.posture,
                v,
                kappa: led.kappa,
            },
            target: here.posture,
            kappa: here.kappa,
            acceleration,
            psi_rate: here.kappa_slope * v / by_psi,
            finished: time >= trajectory.end(),
        })
    }
}

#[cfg(test)]
mod tests;
