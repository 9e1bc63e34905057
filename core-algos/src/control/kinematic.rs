//! Curvature-based kinematic controller (paper eq. 4).
//!
//! One law for posture regulation (reference at rest), path following and trajectory tracking
//! (reference in motion), in two forms:
//!
//! - [`Law::command`] is equation 4: velocity and yaw rate as functions of time;
//! - [`Law::approach`] is equation 4 for a reference at rest, with the heading gain scaled by `|v|/e`. The path is
//!   then independent of the speed profile: a reduced speed does not change the path.
//!
//! # Panic contract
//!
//! [`Config::build`] and [`LimitsConfig::build`] validate; nothing else can fail. A posture or
//! reference that is not finite gives [`Command::REST`].
//!
//! # Example
//!
//! ```
//! use core_algos::control::kinematic::{Config, PolarError};
//! use core_algos::math::Posture;
//!
//! let law = Config::default().build()?;
//! let (mut robot, goal) = (Posture::new(-1.3, -1.3, 0.0), Posture::ORIGIN);
//! for _ in 0..2000 {
//!     // Steps of 10 ms, without the limits that a robot has.
//!     let command = law.command(PolarError::between(robot, goal), 0.0, 0.0);
//!     robot = robot.advance(0.01 * command.v, 0.01 * command.phi_dot);
//! }
//! let error = PolarError::between(robot, goal);
//! // It rests on the circle manifold, some r√(2ε) short of the goal.
//! assert!(law.manifold_error(error).abs() < 1e-5);
//! assert!(error.distance_m < 0.02 && error.heading().abs() < 0.05);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

use crate::config::{ConfigError, declare};
use crate::math::trig::{atan2, clamp, cos, hypot, sin, sin_cos, sqrt, tanh, wrap_angle};
use crate::math::{Posture, Steering, Transform, greater};
use core::f32::consts::{PI, SQRT_2};
use core::hint::cold_path;

/// Smallest distance e (m) used for `1/e` in [`Law::command`].
pub const MIN_DISTANCE_M: f32 = 1e-6;
/// Smallest magnitude of the denominator of eq. 4, m.
pub const MIN_DENOMINATOR_M: f32 = 1e-9;
/// Smallest speed (m/s) by which the yaw rate is divided for the curvature.
pub const MIN_SPEED_M_S: f32 = 1e-6;

declare! {
    /// Denominator of the velocity in eq. 4.
    pub enum Form, default Derived {
        /// `e s cos α + r√2 sin 2θ sin α`: derived from the Lyapunov condition δ̇ = −k1 tanh δ.
        Derived = "derived",
        /// `e s + r√2 sin 2θ sin α`: as the paper prints it, without `cos α`.
        Printed = "printed",
    }
}

/// End of the robot that leads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "lowercase"))]
pub enum Direction {
    /// Front axle first, v > 0.
    #[default]
    Forward,
    /// Rear axle first, v < 0.
    Reverse,
}

impl Direction {
    /// 1 forward, −1 in reverse: the sign of v.
    pub const fn sign(self) -> f32 {
        match self {
            Self::Forward => 1.0,
            Self::Reverse => -1.0,
        }
    }
}

/// Position error of the robot's midpoint O against its reference R, in polar coordinates.
///
/// With β the direction of the line of sight from O to R: θ = β − φ_r, α = β − φ.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PolarError {
    /// Distance from O to R, m (the paper's e).
    pub distance_m: f32,
    /// Angle of the line of sight against the reference heading, rad in [−π, π] (θ).
    pub theta: f32,
    /// Angle of the line of sight against the robot's heading, rad in [−π, π] (α).
    pub alpha: f32,
}

impl PolarError {
    /// The error of `posture` against `reference`.
    ///
    /// At distance 0 the reference heading replaces the line of sight, so that θ = 0 and α is the heading error.
    pub fn between(posture: Posture, reference: Posture) -> Self {
        let (dx, dy) = (reference.x - posture.x, reference.y - posture.y);
        let distance_m = hypot(dx, dy);
        let terms = if distance_m > 0.0 {
            atan2(dy, dx)
        } else {
            reference.phi
        };
        Self {
            distance_m,
            theta: wrap_angle(terms - reference.phi),
            alpha: wrap_angle(terms - posture.phi),
        }
    }

    /// The error for a robot that drives rear first: both headings are turned by π.
    pub fn reversed(self) -> Self {
        Self {
            distance_m: self.distance_m,
            theta: wrap_angle(self.theta + PI),
            alpha: wrap_angle(self.alpha + PI),
        }
    }

    /// The error as seen when driving in `direction`.
    pub fn in_direction(self, direction: Direction) -> Self {
        match direction {
            Direction::Forward => self,
            Direction::Reverse => self.reversed(),
        }
    }

    /// Heading error on arrival by the circular arc towards the reference, η = θ + α, rad in [−π, π]. Equal for both
    /// directions of driving.
    pub fn arrival(self) -> f32 {
        wrap_angle(self.theta + self.alpha)
    }

    /// Heading of the robot against the reference, φ − φ_r = θ − α, rad in [−π, π].
    pub fn heading(self) -> f32 {
        wrap_angle(self.theta - self.alpha)
    }
}

/// Polar error in the terms of eq. 4.
#[derive(Clone, Copy, Debug)]
struct PolarTerms {
    /// e, m. `inverse` is 1/e, 1/m, with an e of at least [`MIN_DISTANCE_M`].
    distance: f32,
    inverse: f32,
    sin_theta: f32,
    cos_theta: f32,
    sin_alpha: f32,
    cos_alpha: f32,
    /// θ + α, rad in [−2π, 2π].
    sum: f32,
}

impl From<PolarError> for PolarTerms {
    fn from(error: PolarError) -> Self {
        let (sin_theta, cos_theta) = sin_cos(error.theta);
        let (sin_alpha, cos_alpha) = sin_cos(error.alpha);
        Self {
            distance: error.distance_m,
            inverse: 1.0 / greater(error.distance_m, MIN_DISTANCE_M),
            sin_theta,
            cos_theta,
            sin_alpha,
            cos_alpha,
            sum: error.theta + error.alpha,
        }
    }
}

impl PolarTerms {
    /// Terms computed from the angles θ and α, for distances near zero.
    #[cold]
    #[inline(never)]
    fn at(posture: Posture, reference: Posture) -> Self {
        PolarError::between(posture, reference).into()
    }

    /// Polar error of `center` against `reference`. The sines and cosines of θ and α follow from those of the
    /// headings.
    #[inline(always)]
    fn between(center: &Transform, reference: &Transform) -> Self {
        let (from, to) = (&center.posture, &reference.posture);
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let distance = hypot(dx, dy);
        if !(distance > MIN_DISTANCE_M) {
            cold_path();
            return Self::at(*from, *to);
        }
        let inverse = 1.0 / distance;
        let (x, y) = (dx * inverse, dy * inverse);
        let terms = atan2(dy, dx);
        Self {
            distance,
            inverse,
            sin_theta: y * reference.cos - x * reference.sin,
            cos_theta: x * reference.cos + y * reference.sin,
            sin_alpha: y * center.cos - x * center.sin,
            cos_alpha: x * center.cos + y * center.sin,
            sum: wrap_angle(terms - to.phi) + wrap_angle(terms - from.phi),
        }
    }
}

/// Commanded motion of the robot's midpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Velocity of O along its heading, m/s; negative in reverse.
    pub v: f32,
    /// Curvature of O's path, 1/m, positive to the left: yaw rate over velocity.
    pub kappa: f32,
    /// Yaw rate, rad/s.
    pub phi_dot: f32,
}

impl Command {
    /// No motion, straight.
    pub const REST: Self = Self {
        v: 0.0,
        kappa: 0.0,
        phi_dot: 0.0,
    };
}

/// A command, and the part of its yaw rate due to the heading error: k2 tanh(θ + α), rad/s.
struct Demand {
    command: Command,
    by_heading: f32,
}

/// A reference posture in motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    /// Posture of the reference frame R.
    pub posture: Posture,
    /// Velocity of R along its heading, m/s (v_r); 0 for posture regulation.
    pub v: f32,
    /// Curvature of R's path, 1/m (κ_r).
    pub kappa: f32,
}

declare! {
    /// Gains of the kinematic controller.
    pub struct Config {
        /// Radius of the circular path manifold (r). O comes to rest `r√(2ε)` short of the
        /// reference.
        pub circle_radius_m: f32 = 0.2, "m": Positive;
        /// Perturbation that keeps the manifold smooth at θ = 0 (ε = ζ − 1).
        pub epsilon: f32 = 1e-3, "": Positive;
        /// Commanded speed far from the manifold (k1).
        pub approach_gain_m_s: f32 = 1.5, "m/s": Range(1e-4, 20.0);
        /// Rate at which η = θ + α decays (k2).
        pub heading_gain_rad_s: f32 = 2.0, "rad/s": Range(0.01, 20.0);
        /// Form of the denominator of the velocity in equation 4.
        pub form: Form = Form::Derived;
        /// Positive floor of the derived denominator as a fraction of `e s`; 0 leaves it as derived.
        pub denominator_floor: f32 = 0.3, "": Range(0.0, 1.0);
        /// Decay of η along the path in the approach form: dη/ds = −p η/e (p).
        pub arrival_gain: f32 = 3.0, "": Positive;
        /// Distance below which the approach form reduces its curvature (σ).
        pub softening_m: f32 = 0.03, "m": NonNegative;
    }
}

impl Config {
    /// Builds the validated law; the error names the invalid field.
    pub fn build(self) -> Result<Law, ConfigError> {
        self.check_ranges()?;
        Ok(Law {
            config: self,
            manifold: self.circle_radius_m * SQRT_2,
            twice_manifold: 2.0 * (self.circle_radius_m * SQRT_2),
            floored: self.form == Form::Derived && self.denominator_floor > 0.0,
        })
    }
}

/// The kinematic controller, ready to run. It has no state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    config: Config,
    /// r√2, m. `twice_manifold` is 2r√2, m.
    manifold: f32,
    twice_manifold: f32,
    /// True if the denominator has a positive floor.
    floored: bool,
}

impl Law {
    /// The gains this law was built from.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Distance at which O rests behind (or trails) a reference it has reached, m: `r√(2ε)`.
    pub fn rest_distance(&self) -> f32 {
        self.manifold * sqrt(self.config.epsilon)
    }

    /// `√(ζ − cos 2θ)`, computed as `√(ε + 2 sin²θ)`: the difference would cancel in `f32`.
    fn shape(&self, sin_theta: f32) -> f32 {
        sqrt(self.config.epsilon + 2.0 * sin_theta * sin_theta)
    }

    /// Distance from the circular path manifold, m: δ = e − r√2 √(ζ − cos 2θ).
    pub fn manifold_error(&self, error: PolarError) -> f32 {
        error.distance_m - self.manifold * self.shape(sin(error.theta))
    }

    /// Velocity, curvature and yaw rate of O by equation 4, before limits.
    ///
    /// Metres, radians, seconds; `error` is that of O against the reference posture. Valid for any v_r, stable for
    /// v_r ≥ 0; [`Self::track`] handles a reversing reference.
    ///
    /// Guards, which act near singular points only:
    /// - `1/e` uses a distance of at least [`MIN_DISTANCE_M`];
    /// - the derived denominator is at least `denominator_floor · e s` (positive); with floor 0,
    ///   and for the printed one, its magnitude is at least [`MIN_DENOMINATOR_M`], sign kept;
    /// - the curvature is the yaw rate over a speed of magnitude at least [`MIN_SPEED_M_S`], sign
    ///   kept (+ at v = 0): finite at v = 0, and 0 there if the yaw rate is 0.
    ///
    /// Input that is not finite gives [`Command::REST`].
    pub fn command(&self, error: PolarError, v_r: f32, kappa_r: f32) -> Command {
        self.demand(&error.into(), v_r, kappa_r).command
    }

    #[inline(always)]
    fn demand(&self, terms: &PolarTerms, v_r: f32, kappa_r: f32) -> Demand {
        let c = &self.config;
        let PolarTerms {
            distance,
            inverse,
            sin_theta,
            cos_theta,
            sin_alpha,
            cos_alpha,
            sum,
        } = *terms;
        let s = self.shape(sin_theta);
        let es = distance * s;
        let manifold_sin_2theta = self.twice_manifold * (sin_theta * cos_theta);

        let approach = c.approach_gain_m_s * es * tanh(distance - self.manifold * s);
        let feedforward =
            v_r * (es * cos_theta + manifold_sin_2theta * (sin_theta + kappa_r * distance));
        let by_heading = c.heading_gain_rad_s * tanh(sum);
        let turning = manifold_sin_2theta * sin_alpha;
        let denominator = if self.floored {
            greater(es * cos_alpha + turning, c.denominator_floor * es)
        } else {
            let linear = match c.form {
                Form::Printed => es,
                Form::Derived => es * cos_alpha,
            };
            away_from_zero(linear + turning, MIN_DENOMINATOR_M)
        };
        let v = (approach + feedforward) / denominator;
        let phi_dot =
            by_heading + 2.0 * inverse * (v * sin_alpha - v_r * sin_theta) - v_r * kappa_r;
        let kappa = phi_dot / away_from_zero(v, MIN_SPEED_M_S);
        // If velocity or yaw rate is not finite, the curvature is not finite.
        let command = if kappa.abs() <= f32::MAX {
            Command { v, kappa, phi_dot }
        } else {
            cold_path();
            Command::REST
        };
        Demand {
            command,
            by_heading,
        }
    }

    /// Equation 4 for `center` and a reference that does not reverse, and the part of the yaw rate due to the heading
    /// error: k2 tanh(θ + α), rad/s.
    pub(super) fn ahead(&self, center: &Transform, reference: Reference) -> (Command, f32) {
        let terms = PolarTerms::between(center, &reference.posture.into());
        let demand = self.demand(&terms, reference.v, reference.kappa);
        (demand.command, demand.by_heading)
    }

    /// Equation 4 for `center` and a reference in motion. A reversing reference (v_r < 0) is followed rear first:
    /// both headings are turned by π, and v and κ negated. Followed front first, the heading would be unstable
    /// (θ̇ ≈ −2 v_r θ/e).
    #[inline(always)]
    pub fn track(&self, center: impl Into<Transform>, reference: Reference) -> Command {
        let (center, goal) = (&center.into(), &Transform::from(reference.posture));
        if reference.v < 0.0 {
            let terms = PolarTerms::between(&center.turned(), &goal.turned());
            let command = self.demand(&terms, -reference.v, -reference.kappa).command;
            Command {
                v: -command.v,
                kappa: -command.kappa,
                phi_dot: command.phi_dot,
            }
        } else {
            let terms = PolarTerms::between(center, goal);
            self.demand(&terms, reference.v, reference.kappa).command
        }
    }

    /// Curvature (1/m) of the path towards a reference at rest: `(2 sin α + p η)/e`.
    ///
    /// This is eq. 4 with k2 := p |v| η / (e tanh η). For a robot in reverse, pass the reversed error and negate the
    /// result.
    ///
    /// Near the goal, where bearings lose meaning, `e/(e² + σ²)` replaces `1/e`.
    #[cfg(test)]
    pub(crate) fn approach_curvature(&self, error: PolarError) -> f32 {
        self.arc_curvature(error, sin(error.alpha))
    }

    fn arc_curvature(&self, error: PolarError, sin_alpha: f32) -> f32 {
        let (e, soft) = (error.distance_m, self.config.softening_m);
        let inverse = e / greater(e * e + soft * soft, MIN_DISTANCE_M * MIN_DISTANCE_M);
        (2.0 * sin_alpha + self.config.arrival_gain * error.arrival()) * inverse
    }

    /// The approach form towards a reference at rest, driving in `direction`; `error` is the robot's, not reversed.
    /// Before limits.
    ///
    /// The velocity is that of eq. 4. Near the goal, from four softening lengths down to two, a factor of
    /// `max(0, cos α)` is blended in, so that the robot stops abeam of the goal instead of circling it. The velocity
    /// never opposes `direction`. Input that is not finite gives [`Command::REST`].
    pub fn approach(&self, error: PolarError, direction: Direction) -> Command {
        let directed = error.in_direction(direction);
        let terms = PolarTerms::from(directed);
        let kappa = direction.sign() * self.arc_curvature(directed, terms.sin_alpha);
        let soft = greater(self.config.softening_m, MIN_DISTANCE_M);
        let far = clamp(0.5 * directed.distance_m / soft - 1.0, 0.0, 1.0);
        let slow = far + (1.0 - far) * greater(terms.cos_alpha, 0.0);
        let v = self.demand(&terms, 0.0, 0.0).command.v;
        let v = direction.sign() * greater(v, 0.0) * slow;
        if kappa.is_finite() && v.is_finite() {
            Command {
                v,
                kappa,
                phi_dot: v * kappa,
            }
        } else {
            Command::REST
        }
    }
}

/// `x` with a magnitude of at least `least`, sign kept (+ at 0).
fn away_from_zero(x: f32, least: f32) -> f32 {
    if x.abs() < least {
        cold_path();
        if x < 0.0 { -least } else { least }
    } else {
        x
    }
}

/// Curvature (1/m) of O's path when the axles are steered by `psi` against a frame of length
/// `frame_length_m`: κ = 2ψ/(L cos ψ) (paper eq. 5). Monotone and finite for |ψ| < π/2.
pub fn curvature_of_steering(Steering(psi): Steering, frame_length_m: f32) -> f32 {
    2.0 * psi / (frame_length_m * cos(psi))
}

declare! {
    /// Bounds of the commanded motion.
    pub struct LimitsConfig {
        /// Greatest speed of O, both directions.
        pub max_speed_m_s: f32 = 0.25, "m/s": Positive;
        /// Greatest steering angle of an axle against the frame's chord (|ψ|).
        pub max_steering_rad: f32 = 0.5, "rad": Range(0.01, 1.4);
        /// Frame length (L).
        pub frame_length_m: f32 = 0.37, "m": Positive;
    }
}

impl LimitsConfig {
    /// Builds the validated bounds; the error names the invalid field.
    pub fn build(self) -> Result<Limits, ConfigError> {
        self.check_ranges()?;
        Ok(Limits {
            max_speed: self.max_speed_m_s,
            max_curvature: curvature_of_steering(
                Steering(self.max_steering_rad),
                self.frame_length_m,
            ),
        })
    }
}

/// Bounds of speed and curvature. A command that is slowed to the speed bound keeps its path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    max_speed: f32,
    max_curvature: f32,
}

impl Limits {
    /// Greatest curvature, 1/m.
    pub fn max_curvature(&self) -> f32 {
        self.max_curvature
    }

    /// Greatest speed, m/s.
    pub fn max_speed(&self) -> f32 {
        self.max_speed
    }

    /// `command` within the bounds. A velocity beyond its bound is scaled together with the yaw rate, so that the
    /// path is kept. A curvature beyond its bound is limited, and the yaw rate with it. A command that is not finite
    /// gives [`Command::REST`].
    pub fn limit(&self, command: Command) -> Command {
        if !(command.v.is_finite() && command.kappa.is_finite()) {
            return Command::REST;
        }
        let v = clamp(command.v, -self.max_speed, self.max_speed);
        let kappa = clamp(command.kappa, -self.max_curvature, self.max_curvature);
        Command {
            v,
            kappa,
            phi_dot: v * kappa,
        }
    }
}

#[cfg(test)]
mod tests;
