//! Joint filter of both axles: one extended Kalman filter whose covariance knows how the axles'
//! errors are correlated.
//!
//! The axles' six posture errors are kept as the error of the rear axle in its own frame and of the
//! front axle as seen from the rear. What the beam measures is then a state itself: the update is
//! linear, and the drift of the whole robot, which grows without bound, never meets the millimetre
//! accuracy between the axles in one difference. The other states hold what is constant or nearly so
//! ([`constants`]):
//!
//! | states | meaning |
//! |---|---|
//! | 0–2 | error of the rear axle's posture along, across its heading, in heading (m, m, rad) |
//! | 3–5 | front axle's posture in the rear axle's frame (m, m, rad) |
//! | 6–25 | the constants, in their order |
//!
//! Three more errors move the robot as a whole, and nothing on board tells of them: the grain of a floor
//! takes both axles along for each metre they roll, along the floor's own axes (two), and tyres under load
//! turn both axles steadily. They are considered (Schmidt 1966): not estimated, but their share is in every
//! covariance that is given out ([`Config::floor_drift_sigma`], [`Config::steady_slip_sigma_rad_per_m`]).
//! They do not change the relative posture, so no gain of the beam's update depends on them.
//!
//! A standard deviation of 0 removes a state. The update takes all three components of r with their
//! covariance, gated by the NIS. Nothing here panics; see [`Joint`].
//!
//! # Example
//!
//! ```
//! use core_algos::fusion::Estimate;
//! use core_algos::fusion::constants;
//! use core_algos::fusion::joint::Config;
//! use core_algos::math::Posture;
//!
//! let filter = Config::default().build(0.01)?;
//! let robot = Estimate::with_sigmas(Posture::ORIGIN, [1e-3, 1e-3, 2e-3]);
//! let frame = Estimate::with_sigmas(Posture::new(0.37, 0.0, 0.0), [1e-3, 1e-3, 4e-3]);
//! let mut state = filter.start(&robot, &frame);
//! let step = Estimate::with_sigmas(Posture::new(2e-3, 0.0, 0.0), [5e-5, 2e-5, 1e-4]);
//! filter.predict(&mut state, &step, &step, [0.0; 2], 1.0);
//! // The beam sees the front axle turned to the left: that may be so, or the zeros of its gauges.
//! let seen = Estimate::with_sigmas(Posture::new(0.37, 0.001, 0.006), [1e-4, 1e-4, 5e-4]);
//! let update = filter.update(&mut state, &seen, |nis| nis < 40.0);
//! assert!((update.innovation[2] - 0.006).abs() < 1e-6);
//! let turned = state.relative().posture.phi;
//! let zero = state.constants()[constants::ZERO];
//! assert!(turned > 0.001 && zero > 0.001 && turned + zero < 0.006, "{turned} {zero}");
//! assert!(state.estimates().front.covariance[2][2] < frame.covariance[2][2]);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

use super::constants::{
    self, COMPLIANCE, DRIFT, GAIN, GYRO_BIAS, GYRO_SCALE, OF_BEAM, SCALE, SIDE, Step, TURN, Tyres,
    UNEVEN, ZERO,
};
use super::covariance::Covariance;
use super::ekf::Verdict;
use super::{Estimate, compound};
use crate::beam::strip::{self, PostureSigmas};
use crate::config::{ConfigError, in_range, non_negative, positive};
use crate::math::matrix::{self, Mat, Mat3};
use crate::math::trig::{sin_cos, sqrt, wrap_angle};
use crate::math::{Posture, RelativeHeading};

/// Number of states.
pub const N: usize = FIRST + constants::COUNT;
const REL: usize = 3;
const REL_PHI: usize = 5;
/// The first of the constants.
const FIRST: usize = 6;
/// States that what the beam says depends on beside the relative posture.
const OF_BEAM_STATES: [usize; OF_BEAM] = [
    FIRST + ZERO,
    FIRST + ZERO + 1,
    FIRST + GAIN,
    FIRST + GAIN + 1,
];

/// Parameters of the joint filter beside those of the tier around it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Config {
    /// What zeros and gains of the gauges make of the beam's posture.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub beam: PostureSigmas,
    /// Half the track (the paper's d), m.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub half_track_m: f32,
    /// Moment of the frame on an axle a radian of relative heading, EI/L, N m.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub frame_moment_n_m: f32,
    /// Mass that the wheels of an axle carry, kg.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub axle_mass_kg: f32,
    /// Slip stiffness of the tyres over their load (C): rubber on a firm floor 10 to 40.
    pub slip_stiffness: f32,
    /// Friction coefficient of the tyres.
    pub friction: f32,
    /// Standard deviation of the slip of all tyres, relative: what floor and rubber make of it.
    pub slip_sigma: f32,
    /// Standard deviation of that of each tyre, relative.
    pub tyre_slip_sigma: f32,
    /// Standard deviation of an axle's heading drift, rad/m: relative difference of its wheel radii
    /// over the track.
    pub heading_drift_sigma_rad_per_m: f32,
    /// Standard deviation of an axle's scale error (relative error of the mean wheel radius).
    pub scale_sigma: f32,
    /// Standard deviation of the scale error of the headings that the wheels report: relative error
    /// of an axle's track.
    pub turn_scale_sigma: f32,
    /// Standard deviation of the way aside that an axle rolls, over its way ahead.
    pub side_slip_sigma: f32,
    /// Standard deviation of a gyro's bias when the robot sets off, rad/s.
    pub gyro_bias_sigma_rad_s: f32,
    /// Random walk of a gyro's bias, rad/s/√s.
    pub gyro_bias_walk_rad_s_per_sqrt_s: f32,
    /// Standard deviation of a gyro's scale error.
    pub gyro_scale_sigma: f32,
    /// Standard deviation of the heading that each metre adds to both axles, rad/m, because tyres
    /// slip sideways steadily; it cannot be told from a common bias of the gyros, so it is not learnt,
    /// only taken into account.
    pub steady_slip_sigma_rad_per_m: f32,
    /// Time in which what tyres, wheels and gains have been learnt to be is another again, s.
    pub constancy_s: f32,
    /// Standard deviation of the way of a wheel that its encoder tells and the floor does not see, or the
    /// other way round, because of the play of its gear, m: beam and odometry disagree by so much.
    pub play_sigma_m: f32,
    /// Standard deviation of the way that the floor takes the robot, over the way it rolls, along each
    /// axis of the floor; nothing on board tells it, so it is only taken into account.
    pub floor_drift_sigma: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            // Those of the default strip.
            beam: strip::Config::default().sigmas(),
            half_track_m: 0.162,
            frame_moment_n_m: 0.833 / 0.37,
            axle_mass_kg: 4.76,
            slip_stiffness: 20.0,
            friction: 0.7,
            slip_sigma: 0.5,
            tyre_slip_sigma: 0.3,
            // Radii of each wheel known to 0.4 %, 0.324 m apart.
            heading_drift_sigma_rad_per_m: 1.75e-2,
            scale_sigma: 2.8e-3,
            turn_scale_sigma: 1.25e-2,
            side_slip_sigma: 3e-3,
            // Zeroed over 0.4 s at rest: 4.9e-5 rad/s/√Hz of noise leave 5.5e-5 rad/s.
            gyro_bias_sigma_rad_s: 6e-5,
            gyro_bias_walk_rad_s_per_sqrt_s: 5e-5,
            gyro_scale_sigma: 5e-3,
            // Some 10 µm/s between axles 0.37 m apart at 0.12 m/s.
            steady_slip_sigma_rad_per_m: 3e-4,
            constancy_s: 3600.0,
            // Evenly spread over 5 mrad of a wheel of 73 mm.
            play_sigma_m: 1.1e-4,
            floor_drift_sigma: 1.5e-2,
        }
    }
}

impl Config {
    /// The ready form for one tick of `period_s`; an error names the parameter out of range.
    pub fn build(&self, period_s: f32) -> Result<Joint, ConfigError> {
        let t = positive("period_s", period_s)?;
        macro_rules! variance {
            ($($field:ident).+) => {{
                let sigma = non_negative(stringify!($($field).+), self.$($field).+)?;
                sigma * sigma
            }};
        }
        let half_track = positive("half_track_m", self.half_track_m)?;
        let moment = positive("frame_moment_n_m", self.frame_moment_n_m)?;
        let wheel_load = 0.5 * GRAVITY * positive("axle_mass_kg", self.axle_mass_kg)?;
        let stiffness = in_range("slip_stiffness", self.slip_stiffness, 1.0, 1e4)?;
        let tyres = Tyres {
            half_track,
            compliance: moment / (2.0 * half_track * half_track * wheel_load * stiffness),
            sliding: 2.0 * half_track * positive("friction", self.friction)? * wheel_load / moment,
        };
        let compliance = tyres.compliance * tyres.compliance;
        // Of two tyres an axle and two axles.
        let of_tyres = 0.25 * variance!(tyre_slip_sigma);
        let mut prior = [0.0; constants::COUNT];
        let mut walk = [0.0; constants::COUNT];
        prior[ZERO] = variance!(beam.zero_rad);
        prior[ZERO + 1] = variance!(beam.zero_tilt_m);
        prior[GAIN] = variance!(beam.gain);
        prior[GAIN + 1] = variance!(beam.gain_tilt_m);
        prior[COMPLIANCE] = compliance * (variance!(slip_sigma) + of_tyres);
        prior[COMPLIANCE + 1] = compliance * of_tyres;
        for (first, variance) in [
            (DRIFT, variance!(heading_drift_sigma_rad_per_m)),
            (SCALE, variance!(scale_sigma)),
            (TURN, variance!(turn_scale_sigma)),
            (SIDE, variance!(side_slip_sigma)),
            (UNEVEN, 2.0 * compliance * of_tyres),
            (GYRO_BIAS, variance!(gyro_bias_sigma_rad_s)),
            (GYRO_SCALE, variance!(gyro_scale_sigma)),
        ] {
            prior[first] = variance;
            prior[first + 1] = variance;
        }
        walk[ZERO] = t * variance!(beam.walk_rad_per_sqrt_s);
        walk[ZERO + 1] = t * variance!(beam.walk_tilt_m_per_sqrt_s);
        walk[GYRO_BIAS] = t * variance!(gyro_bias_walk_rad_s_per_sqrt_s);
        walk[GYRO_BIAS + 1] = walk[GYRO_BIAS];
        let floor = variance!(floor_drift_sigma);
        let play = variance!(play_sigma_m);
        Ok(Joint {
            t,
            play_heading: 0.5 * play / (half_track * half_track),
            play_way: 0.5 * play,
            tyres,
            prior,
            kept: 1.0 - t / in_range("constancy_s", self.constancy_s, 10.0 * t, 1e7)?,
            walk,
            considered: [variance!(steady_slip_sigma_rad_per_m), floor, floor],
        })
    }
}

/// L⁻¹ b of a lower triangle L.
fn solve_lower(l: &Mat3, b: &[f32; 3]) -> [f32; 3] {
    let mut x = *b;
    for i in 0..3 {
        for k in 0..i {
            x[i] -= l[i][k] * x[k];
        }
        x[i] /= l[i][i];
    }
    x
}

/// Adds the share of an error with this variance, by which a posture changes so much.
fn add_outer(covariance: &mut Mat3, by: &[f32; 3], variance: f32) {
    for i in 0..3 {
        for k in 0..3 {
            covariance[i][k] += variance * (by[i] * by[k]);
        }
    }
}

/// Acceleration of gravity, m/s².
const GRAVITY: f32 = 9.81;

/// The joint filter, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    t: f32,
    tyres: Tyres,
    /// Prior variances of the constants.
    prior: [f32; constants::COUNT],
    /// Share of a constant that a tick leaves of it.
    kept: f32,
    /// Variance added to the constants each tick.
    walk: [f32; constants::COUNT],
    /// Variances of the heading that a metre adds, (rad/m)², and of the way that the floor adds to a metre
    /// along its x and y.
    considered: [f32; 3],
    /// Variances of an axle's heading and way by play.
    play_heading: f32,
    play_way: f32,
}

/// All that changes in the joint filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    rear: Posture,
    relative: Posture,
    constants: [f32; constants::COUNT],
    covariance: Covariance<N>,
    /// Relative heading that loads the tyres: of the last tick with the odometry of both axles.
    loading: RelativeHeading,
    /// Derivatives of the rear axle's posture, in its own frame, by the heading that a metre adds
    /// (m², m², m) and by the way that the floor adds to a metre along its x and y (m, m, rad).
    by_considered: [[f32; 3]; 3],
    /// Variances of these.
    considered: [f32; 3],
}

impl State {
    /// The rear axle's posture.
    pub fn rear(&self) -> Posture {
        self.rear
    }

    /// The front axle's posture.
    pub fn front(&self) -> Posture {
        self.rear.compose(self.relative)
    }

    /// The front axle in the rear axle's frame, with its covariance.
    pub fn relative(&self) -> Estimate {
        let u = &self.covariance.upper;
        let mut block = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in i..3 {
                block[i][j] = u[REL + i][REL + j];
                block[j][i] = u[REL + i][REL + j];
            }
        }
        Estimate::new(self.relative, block)
    }

    /// Relative heading that loads the tyres.
    pub fn loading(&self) -> RelativeHeading {
        self.loading
    }

    /// Estimates of the constants.
    pub fn constants(&self) -> [f32; constants::COUNT] {
        self.constants
    }

    #[cfg(test)]
    pub(crate) fn constant_sigmas(&self) -> [f32; constants::COUNT] {
        let mut sigmas = [0.0; constants::COUNT];
        for (k, sigma) in sigmas.iter_mut().enumerate() {
            *sigma = sqrt(self.covariance.upper[FIRST + k][FIRST + k].max(0.0));
        }
        sigmas
    }

    /// The covariance of all states.
    pub fn covariance(&self) -> &Covariance<N> {
        &self.covariance
    }

    /// Turn from the rear axle's frame into the global one.
    fn world_from_rear(&self) -> Mat3 {
        let (sin, cos) = sin_cos(self.rear.phi);
        [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]
    }

    /// Both axles and the robot's midpoint O with their covariances along the global axes.
    pub fn estimates(&self) -> Estimates {
        let into_world = self.world_from_rear();
        let mut p = [[0.0; 6]; 6];
        for i in 0..6 {
            for k in i..6 {
                p[i][k] = self.covariance.upper[i][k];
                p[k][i] = p[i][k];
            }
        }
        let mut rear = matrix::propagate(&into_world, &self.covariance.posture());
        self.add_considered(&mut rear, &into_world);
        // A posture that is `q` in the rear axle's frame, and its derivative by the relative posture.
        let seen_from_rear = |q: Posture, by_relative: &Mat3| {
            let [[cos, minus_sin, _], [sin, ..], _] = into_world;
            let at = Posture::new(
                self.rear.x + cos * q.x + minus_sin * q.y,
                self.rear.y + sin * q.x + cos * q.y,
                wrap_angle(self.rear.phi + q.phi),
            );
            // An error of the rear axle in its own frame carries q along.
            let by_rear = [[1.0, 0.0, -q.y], [0.0, 1.0, q.x], [0.0, 0.0, 1.0]];
            let by_rear = matrix::multiply(&into_world, &by_rear);
            let mut j = [[0.0; 6]; 3];
            for i in 0..3 {
                for k in 0..3 {
                    j[i][k] = by_rear[i][k];
                    j[i][k + 3] = by_relative[i][k];
                }
            }
            let mut covariance = matrix::propagate(&j, &p);
            self.add_considered(&mut covariance, &by_rear);
            Estimate::new(at, covariance)
        };
        let (middle, by_relative) = compound::midpoint_seen_from_rear(self.relative);
        Estimates {
            front: seen_from_rear(self.relative, &into_world),
            rear: Estimate::new(self.rear, rear),
            robot: seen_from_rear(middle, &matrix::multiply(&into_world, &by_relative)),
        }
    }

    /// Adds what the considered errors do to a posture, by its derivative by the rear axle's.
    fn add_considered(&self, covariance: &mut Mat3, by_rear: &Mat3) {
        for (by, variance) in self.by_considered.iter().zip(self.considered) {
            add_outer(covariance, &matrix::apply(by_rear, by), variance);
        }
    }
}

/// What the joint filter knows of where the robot is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimates {
    /// The front axle.
    pub front: Estimate,
    /// The rear axle.
    pub rear: Estimate,
    /// The robot's midpoint O.
    pub robot: Estimate,
}

/// Result of the beam's update.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BeamUpdate {
    /// What became of the measurement.
    pub verdict: Verdict,
    /// Measured minus predicted relative posture (m, m, rad).
    pub innovation: [f32; 3],
    /// Normalised innovation squared; 3 on average.
    pub nis: f32,
}

impl Joint {
    /// Prior standard deviations of the constants.
    pub fn prior_sigmas(&self) -> [f32; constants::COUNT] {
        self.prior.map(sqrt)
    }

    /// What the tyres are taken to do.
    pub fn tyres(&self) -> &Tyres {
        &self.tyres
    }

    /// Start: O's posture with its covariance, and the front axle's posture in the rear axle's frame
    /// with its own, independent covariance.
    pub fn start(&self, robot: &Estimate, relative: &Estimate) -> State {
        let (q, jacobian) = compound::midpoint_seen_from_rear(relative.posture);
        let back = q.inverse();
        let rear = robot.posture.compose(back);
        // rear = O ⊕ back(r). In the rear axle's frame: by O's error, carried along, and by r's.
        let (sin, cos) = sin_cos(rear.phi);
        let into_rear = [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]];
        let (by_robot, by_back) = robot.posture.compose_jacobians(back);
        let by_robot = matrix::multiply(&into_rear, &by_robot);
        let by_back = matrix::multiply(&into_rear, &by_back);
        let by_relative = matrix::multiply(
            &by_back,
            &matrix::multiply(&q.inverse_jacobian(), &jacobian),
        );
        let own = matrix::add(
            &matrix::propagate(&by_robot, &robot.covariance),
            &matrix::propagate(&by_relative, &relative.covariance),
        );
        let cross = matrix::multiply(&by_relative, &relative.covariance);
        let mut p = [[0.0; N]; N];
        for i in 0..3 {
            for j in 0..3 {
                p[i][j] = own[i][j];
                p[i][REL + j] = cross[i][j];
                p[REL + i][REL + j] = relative.covariance[i][j];
            }
        }
        for k in 0..constants::COUNT {
            p[FIRST + k][FIRST + k] = self.prior[k];
        }
        State {
            rear,
            relative: relative.posture,
            constants: [0.0; constants::COUNT],
            covariance: Covariance::from_matrix(&p),
            loading: RelativeHeading(relative.posture.phi),
            by_considered: [[0.0; 3]; 3],
            considered: self.considered,
        }
    }

    /// The gyro of an axle (0 front, 1 rear) was zeroed: its bias is another one.
    pub fn forget_gyro_bias(&self, state: &mut State, axle: usize) {
        let k = GYRO_BIAS + axle.min(1);
        let u = &mut state.covariance.upper;
        for i in 0..N {
            u[i.min(FIRST + k)][i.max(FIRST + k)] = 0.0;
        }
        u[FIRST + k][FIRST + k] = self.prior[k];
        state.constants[k] = 0.0;
    }

    /// Odometry: increments of front and rear in the axles' own frames, each with the covariance of
    /// its error in the frame it ends in and the share of the time in which a gyro took part.
    /// `ticks` is the time they span.
    pub fn predict(
        &self,
        state: &mut State,
        front: &Estimate,
        rear: &Estimate,
        gyro_shares: [f32; 2],
        ticks: f32,
    ) {
        let dt = ticks * self.t;
        let [front_share, rear_share] = gyro_shares;
        let step = |axle: usize, moved: Posture, gyro_share: f32| Step {
            axle,
            moved,
            relative_heading: state.loading,
            dt,
            gyro_share,
        };
        let (d1, front_error) = self.correct(&step(0, front.posture, front_share), state);
        let (d2, rear_error) = self.correct(&step(1, rear.posture, rear_share), state);

        let (sin, cos) = sin_cos(d2.phi);
        let turn_back: Mat3 = [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]];
        // Rear: ε' = turn_back (ε + ε_φ × d2) + turn_back e2.
        let carried = [[1.0, 0.0, -d2.y], [0.0, 1.0, d2.x], [0.0, 0.0, 1.0]];
        let by_rear = matrix::multiply(&turn_back, &carried);
        for by in &mut state.by_considered {
            *by = matrix::apply(&by_rear, by);
        }
        state.by_considered[0][2] += sqrt(d2.x * d2.x + d2.y * d2.y);
        let way = step(1, rear.posture, rear_share).way(&self.tyres);
        let [[east, minus_north, _], [north, ..], _] = state.world_from_rear();
        let (to_x, to_y) = (east * cos - north * sin, north * cos + east * sin);
        let floor = [[to_x, -to_y], [to_y, to_x]];
        for (by, direction) in state.by_considered[1..].iter_mut().zip(floor) {
            by[0] += way * direction[0];
            by[1] += way * direction[1];
        }
        // Relative: ⊖ d2 ⊕ (r ⊕ d1).
        let r = state.relative;
        let (relative_sin, relative_cos) = sin_cos(r.phi);
        let onto = [
            [relative_cos, -relative_sin, 0.0],
            [relative_sin, relative_cos, 0.0],
            [0.0, 0.0, 1.0],
        ];
        let [x, y, phi] = matrix::apply(&onto, &[d1.x, d1.y, d1.phi]);
        let tip_by_relative = [[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]];
        let tip = [r.x + x - d2.x, r.y + y - d2.y, r.phi + phi - d2.phi];
        let [x, y, phi] = matrix::apply(&turn_back, &tip);
        state.relative = Posture::new(x, y, wrap_angle(phi));
        let by_base = [[-cos, -sin, y], [sin, -cos, -x], [0.0, 0.0, -1.0]];
        let by_relative = matrix::multiply(&turn_back, &tip_by_relative);
        let by_front = matrix::multiply(&turn_back, &onto);

        let motion = Motion {
            front_error,
            rear_error,
            by_rear,
            turn_back,
            by_relative,
            by_front,
            by_base,
        };
        // Of F P the six rows that are not those of P.
        let u = &mut state.covariance.upper;
        let mut fp: Mat<6, N> = [[0.0; N]; 6];
        let mut column = [0.0; N];
        for j in 0..N {
            for k in 0..j {
                column[k] = u[k][j];
            }
            column[j..].copy_from_slice(&u[j][j..]);
            let moved = motion.apply(&column);
            for i in 0..6 {
                fp[i][j] = moved[i];
            }
        }

        // Noise of the increments: in the end frames for the rear itself, turned back into the
        // frames of departure where the increments are added.
        let (sin1, cos1) = sin_cos(d1.phi);
        let depart1: Mat3 = [[cos1, -sin1, 0.0], [sin1, cos1, 0.0], [0.0, 0.0, 1.0]];
        let depart2 = matrix::transpose(&turn_back);
        let front_noise = matrix::multiply(&by_front, &depart1);
        let rear_noise = matrix::multiply(&by_base, &depart2);
        let relative_noise = matrix::add(
            &matrix::propagate(&front_noise, &front.covariance),
            &matrix::propagate(&rear_noise, &rear.covariance),
        );
        let cross_noise = matrix::multiply(&rear_noise, &rear.covariance);

        for i in 0..6 {
            let moved = motion.apply(&fp[i]);
            u[i][i..6].copy_from_slice(&moved[i..]);
            u[i][FIRST..].copy_from_slice(&fp[i][FIRST..]);
        }
        for i in 0..3 {
            for j in i..3 {
                u[i][j] += rear.covariance[i][j];
                u[REL + i][REL + j] += relative_noise[i][j];
            }
            for j in 0..3 {
                u[i][REL + j] += cross_noise[j][i];
            }
        }
        for k in 0..constants::COUNT {
            u[FIRST + k][FIRST + k] += ticks * self.walk[k];
        }

        state.rear = Posture::new(
            state.rear.x + east * d2.x + minus_north * d2.y,
            state.rear.y + north * d2.x + east * d2.y,
            wrap_angle(state.rear.phi + d2.phi),
        );
        state.loading = RelativeHeading(state.relative.phi);
    }

    /// An increment corrected by what is known of the constants, and what its error depends on.
    fn correct(&self, step: &Step, state: &State) -> (Posture, IncrementError) {
        let by_constants = step.by_constants(&self.tyres);
        let ([x, y, phi], by_heading) = step.error(&self.tyres, &by_constants, &state.constants);
        let p = step.moved;
        let error = IncrementError {
            by_constants,
            by_heading,
        };
        (Posture::new(p.x + x, p.y + y, p.phi + phi), error)
    }

    /// Keeps the relative heading that loads the tyres while the odometry of one axle is missing.
    pub fn keep_loading(&self, state: &mut State, loading: RelativeHeading) {
        state.loading = loading;
    }

    /// The beam: `measured` is the front axle's posture in the rear axle's frame with the covariance
    /// of its noise. `accept` judges the NIS (three degrees of freedom).
    pub fn update(
        &self,
        state: &mut State,
        measured: &Estimate,
        accept: impl FnOnce(f32) -> bool,
    ) -> BeamUpdate {
        let r = &matrix::add(&measured.covariance, &self.play(state.relative));
        let by_constants = constants::beam_by_constants(state.relative);
        let mut innovation = measured.posture.minus(state.relative);
        for (i, by) in by_constants.iter().enumerate() {
            for (by, constant) in by.iter().zip(&state.constants) {
                innovation[i] -= by * constant;
            }
        }
        innovation[2] = wrap_angle(innovation[2]);
        if !measured.is_finite() || matrix::cholesky(&measured.covariance).is_none() {
            return BeamUpdate {
                verdict: Verdict::Invalid,
                ..BeamUpdate::default()
            };
        }
        let seen = state
            .covariance
            .seen(REL, &OF_BEAM_STATES, &by_constants, r);
        let left = seen
            .as_ref()
            .map(|(factor, _)| solve_lower(factor, &innovation));
        let nis = left.map_or(f32::INFINITY, |left| left.iter().map(|x| x * x).sum());
        let mut outcome = BeamUpdate {
            verdict: Verdict::Gated,
            innovation,
            nis,
        };
        let (Some((_, told)), Some(left), true) = (seen, left, accept(nis)) else {
            return outcome;
        };
        outcome.verdict = Verdict::Used;
        state.covariance.take_off(&told);
        let mut shift = [0.0; N];
        for (told, left) in told.iter().zip(left) {
            for (shift, told) in shift.iter_mut().zip(told) {
                *shift += told * left;
            }
        }
        self.shift(state, &shift);
        outcome
    }

    /// Covariance of what play makes of the headings and ways of both axles.
    fn play(&self, relative: Posture) -> Mat3 {
        let mut covariance = [[0.0; 3]; 3];
        let (sin, cos) = sin_cos(relative.phi);
        for (by, variance) in [
            ([cos, sin, 0.0], self.play_way),
            ([0.0, 0.0, 1.0], self.play_heading),
            ([1.0, 0.0, 0.0], self.play_way),
            ([-relative.y, relative.x, 1.0], self.play_heading),
        ] {
            add_outer(&mut covariance, &by, variance);
        }
        covariance
    }

    fn shift(&self, state: &mut State, by: &[f32; N]) {
        state.rear = state.rear.compose(Posture::new(by[0], by[1], by[2]));
        state.relative = Posture::new(
            state.relative.x + by[REL],
            state.relative.y + by[REL + 1],
            wrap_angle(state.relative.phi + by[REL_PHI]),
        );
        state.loading = RelativeHeading(state.relative.phi);
        for k in 0..constants::COUNT {
            state.constants[k] += by[FIRST + k];
        }
    }

    /// Keeps the covariance finite and positive definite, and lets what was learnt of the constants fade
    /// towards what is known of them beforehand; to be called every `ticks` ticks or so, between two steps.
    ///
    /// Constants that have walks of their own do not fade.
    pub fn condition(&self, state: &mut State, ticks: u8) {
        let kept = 1.0 - f32::from(ticks) * (1.0 - self.kept);
        for k in 0..constants::COUNT {
            if self.walk[k] == 0.0 {
                state.constants[k] *= kept;
                let added = (1.0 - kept * kept) * self.prior[k];
                state.covariance.fade(FIRST + k, kept, added);
            }
        }
        state.covariance.condition();
    }
}

/// Derivatives of the error of an axle's increment.
struct IncrementError {
    by_constants: Mat<3, { constants::COUNT }>,
    by_heading: [f32; 3],
}

impl IncrementError {
    /// The error that errors of the states make; few of the derivatives are not zero.
    #[inline(always)]
    fn of<const AXLE: usize>(&self, states: &[f32; N]) -> [f32; 3] {
        let error = constants::error_by::<AXLE>(&self.by_constants, |k| states[(FIRST + k) % N]);
        core::array::from_fn(|i| error[i] + self.by_heading[i] * states[REL_PHI])
    }
}

/// The linear part of a tick's motion (F), but for the states that stay.
struct Motion {
    front_error: IncrementError,
    rear_error: IncrementError,
    by_rear: Mat3,
    turn_back: Mat3,
    by_relative: Mat3,
    by_front: Mat3,
    by_base: Mat3,
}

impl Motion {
    /// Errors of the rear axle's and of the relative posture after it, from the errors of all states before.
    fn apply(&self, states: &[f32; N]) -> [f32; 6] {
        let front = self.front_error.of::<0>(states);
        let rear = self.rear_error.of::<1>(states);
        let [x, y, phi, ahead, aside, turned, ..] = *states;
        let mut moved = [0.0; 6];
        // The last rows of all these matrices are those of a turn.
        for i in 0..2 {
            moved[i] = along(&self.by_rear[i], &[x, y, phi]) + along(&self.turn_back[i], &rear);
            moved[REL + i] = along(&self.by_relative[i], &[ahead, aside, turned])
                + along(&self.by_front[i], &front)
                + along(&self.by_base[i], &rear);
        }
        moved[2] = phi + rear[2];
        moved[REL_PHI] = turned + front[2] - rear[2];
        moved
    }
}

/// Product of a row and a column.
#[inline(always)]
fn along(row: &[f32; 3], column: &[f32; 3]) -> f32 {
    row[0] * column[0] + row[1] * column[1] + row[2] * column[2]
}

#[cfg(test)]
mod tests;
