//! Joint filter of both axles: one extended Kalman filter that keeps the correlation of the axles' errors.
//!
//! The axles' six posture errors are kept as those of the rear axle in its own coordinates and those of the front axle
//! seen from the rear. The beam's measurement is then itself a state. So the update is linear, and the relative
//! posture, known to a millimetre, is never a difference of two postures that drift without bound. The other states are
//! constant or nearly so ([`constants`]):
//!
//! | states | meaning |
//! |---|---|
//! | 0–2 | error of the rear axle's posture along, across its heading, in heading (m, m, rad) |
//! | 3–5 | front axle's posture in the rear axle's coordinates (m, m, rad) |
//! | 6–25 | the constants, in their order |
//!
//! Three more errors move the robot as a whole, and no sensor on board measures them. The grain of the floor
//! displaces both axles per metre they roll, along each of the floor's two axes. Tyres, clamps and axles that differ
//! from the model turn the robot ([`Config::steady_turn_sigma_rad_per_m`]). These errors are considered (Schmidt
//! 1966): not estimated, but contained in every covariance that the filter gives. They do not change the relative
//! posture, so no gain of the beam's update depends on them.
//!
//! A standard deviation of 0 removes a state. The update takes all three components of r with their
//! covariance, gated by the normalised innovation squared (NIS). Nothing here panics.
//!
//! # Example
//!
//! ```
//! use core_algos::fusion::Estimate;
//! use core_algos::fusion::constants;
//! use core_algos::fusion::joint::Config;
//! use core_algos::math::{Posture, RelativeHeading};
//!
//! let filter = Config::default().build(0.01)?;
//! let robot = Estimate::with_sigmas(Posture::ORIGIN, [1e-3, 1e-3, 2e-3]);
//! let frame = Estimate::with_sigmas(Posture::new(0.37, 0.0, 0.0), [1e-3, 1e-3, 4e-3]);
//! let mut state = filter.start(&robot, &frame, 0.005);
//! let step = Estimate::with_sigmas(Posture::new(2e-3, 0.0, 0.0), [5e-5, 2e-5, 1e-4]);
//! let alone = [RelativeHeading(0.0); 2];
//! filter.predict(&mut state, &step, &step, [0.0; 2], alone, 1.0);
//! // The beam measures a left turn of the front axle: a true turn, or the zeros of its gauges.
//! let measured = Estimate::with_sigmas(Posture::new(0.37, 0.001, 0.006), [1e-4, 1e-4, 5e-4]);
//! let update = filter.update(&mut state, &measured, |nis| nis < 40.0);
//! assert!((update.innovation[2] - 0.006).abs() < 1e-6);
//! let turned = state.relative().posture.phi;
//! let zero = state.constants()[constants::ZERO];
//! assert!(turned > 0.0 && zero > turned && turned + zero < 0.006, "{turned} {zero}");
//! assert!(state.estimates().front.covariance[2][2] < frame.covariance[2][2]);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

mod config;
mod inconsistency;
mod motion;

pub use config::Config;
pub use inconsistency::InconsistentSensor;
use motion::{IncrementError, Motion, carried, turned};

use super::constants::{self, GAIN, GYRO_BIAS, IncrementInputs, OF_BEAM, Tyres, ZERO};
use super::covariance::Covariance;
use super::ekf::Verdict;
use super::{Estimate, compound};
use crate::math::matrix::{self, Mat, Mat3};
use crate::math::trig::{sin_cos, sqrt, wrap_angle};
use crate::math::{Posture, RelativeHeading};

/// Number of states.
pub const N: usize = FIRST + constants::COUNT;
const REL: usize = 3;
const REL_PHI: usize = 5;
/// Index of the first constant error among the states.
const FIRST: usize = 6;
/// States that affect the beam's measurement besides the relative posture.
const OF_BEAM_STATES: [usize; OF_BEAM] = [
    FIRST + ZERO,
    FIRST + ZERO + 1,
    FIRST + GAIN,
    FIRST + GAIN + 1,
];

/// Solves L x = b for a lower triangular L.
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

/// Adds the covariance of a posture error `by` · e, with e of the given variance.
fn add_outer(covariance: &mut Mat3, by: &[f32; 3], variance: f32) {
    for i in 0..3 {
        for k in 0..3 {
            covariance[i][k] += variance * (by[i] * by[k]);
        }
    }
}

/// Acceleration of gravity, m/s².
const GRAVITY: f32 = 9.81;

/// Joint filter with checked parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    t: f32,
    tyres: Tyres,
    /// Prior variances of the constant errors.
    prior: [f32; constants::COUNT],
    /// Reciprocal of the size of a constant error at which its sensor is inconsistent; 0 for a constant error that is
    /// not estimated.
    per_limit: [f32; constants::COUNT],
    /// Factor by which the estimate of a constant error fades per tick.
    kept: f32,
    /// Variance added to each constant error per tick.
    walk: [f32; constants::COUNT],
    /// Variance of a constant turn of the whole robot per metre, which the filter considers and does not estimate.
    steady_turn: f32,
    /// Variance of an axle's heading due to backlash, rad².
    backlash_heading: f32,
    /// Variance of an axle's travel due to backlash, m².
    backlash_position: f32,
}

/// Estimate of the joint filter with its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    rear: Posture,
    relative: Posture,
    constants: [f32; constants::COUNT],
    covariance: Covariance<N>,
    /// Relative heading that loads the tyres, from the last tick with the odometry of both axles.
    loading: RelativeHeading,
    /// Derivatives of the rear axle's posture, in its own coordinates (m, m, rad), by the errors that are considered
    /// and not estimated: displacement by the floor per metre along its x and y, and turn per metre.
    by_considered: [[f32; 3]; 3],
    /// Variances of the errors that are considered and not estimated.
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

    /// Motion of O since it was at `before` (m, m, rad, along the global axes). `relative` and `heading` are the
    /// front axle's posture in the rear axle's coordinates and the rear axle's heading at that time.
    pub(super) fn moved(&self, before: Posture, relative: Posture, heading: f32) -> Posture {
        let (r, (sin, cos)) = (self.relative, sin_cos(self.rear.phi));
        let (x, y) = (0.5 * r.x, 0.5 * r.y);
        // The line between the axles turns by a small angle, so the tangent is taken as the angle.
        let cross = relative.x * r.y - relative.y * r.x;
        let dot = relative.x * r.x + relative.y * r.y;
        Posture::new(
            self.rear.x + cos * x - sin * y - before.x,
            self.rear.y + sin * x + cos * y - before.y,
            wrap_angle(self.rear.phi - heading) + cross / dot,
        )
    }

    /// Posture of the front axle in the rear axle's coordinates.
    pub fn relative_posture(&self) -> Posture {
        self.relative
    }

    /// Posture of the front axle in the rear axle's coordinates, with its covariance.
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

    /// Estimates of the constant errors, in the order of [`constants`].
    pub fn constants(&self) -> [f32; constants::COUNT] {
        self.constants
    }

    #[cfg(test)]
    pub(crate) fn constant_sigmas(&self) -> [f32; constants::COUNT] {
        let mut sigmas = [0.0; constants::COUNT];
        for (k, sigma) in sigmas.iter_mut().enumerate() {
            *sigma = sqrt(self.covariance.upper[FIRST + k][FIRST + k]);
        }
        sigmas
    }

    /// The covariance of all states.
    pub fn covariance(&self) -> &Covariance<N> {
        &self.covariance
    }

    /// Rotation from the rear axle's coordinates into global coordinates.
    fn world_from_rear(&self) -> Mat3 {
        let (sin, cos) = sin_cos(self.rear.phi);
        [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]
    }

    /// Postures of both axles and of the robot's midpoint O, with their covariances along the global axes.
    pub fn estimates(&self) -> Estimates {
        let u = &self.covariance.upper;
        let rear = self.covariance.posture();
        let cross = [0, 1, 2].map(|i| [u[i][REL], u[i][REL + 1], u[i][REL + 2]]);
        let relative = self.relative().covariance;
        let (sin, cos) = sin_cos(self.rear.phi);
        let into_world = |q: Posture, mut covariance: Mat3| {
            // `covariance` is along the axes of the rear axle until `turned` rotates it.
            for (by, variance) in self.by_considered.iter().zip(self.considered) {
                add_outer(&mut covariance, &carried(by, q), variance);
            }
            let at = Posture::new(
                self.rear.x + cos * q.x - sin * q.y,
                self.rear.y + sin * q.x + cos * q.y,
                wrap_angle(self.rear.phi + q.phi),
            );
            Estimate::new(at, turned(&covariance, sin, cos))
        };
        // Covariance of a posture `q` in the rear axle's coordinates: the rear axle's error carried to `q`, the error
        // of `q` itself, and their cross-covariance.
        let seen_from_rear = |q: Posture, cross: &Mat3, own: &Mat3| {
            let carry_columns = |by: &Mat3| matrix::transpose(by).map(|column| carried(&column, q));
            // Columns of A P and A C, with A the Jacobian that carries an error of the rear axle to `q`.
            let (moved, common) = (carry_columns(&rear), carry_columns(cross));
            let carried_twice = carry_columns(&moved);
            let mut covariance = *own;
            for i in 0..3 {
                for k in 0..3 {
                    covariance[i][k] += carried_twice[k][i] + (common[k][i] + common[i][k]);
                }
            }
            into_world(q, covariance)
        };
        let (middle, by_relative) = compound::midpoint_seen_from_rear(self.relative);
        let cross_of_middle = matrix::multiply(&cross, &matrix::transpose(&by_relative));
        let own = matrix::propagate(&by_relative, &relative);
        Estimates {
            front: seen_from_rear(self.relative, &cross, &relative),
            rear: into_world(Posture::ORIGIN, rear),
            robot: seen_from_rear(middle, &cross_of_middle, &own),
        }
    }
}

/// Estimated postures of both axles and of O.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimates {
    /// Posture of the front axle.
    pub front: Estimate,
    /// Posture of the rear axle.
    pub rear: Estimate,
    /// Posture of the robot's midpoint O.
    pub robot: Estimate,
}

/// Effect of one measurement of the beam on the filter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BeamUpdate {
    /// Verdict on the measurement.
    pub verdict: Verdict,
    /// Measured minus predicted relative posture (m, m, rad).
    pub innovation: [f32; 3],
    /// Normalised innovation squared, 3 on average if all covariances are true; infinite if the covariance of the
    /// innovation cannot be factored.
    pub nis: f32,
}

impl Joint {
    /// Prior standard deviations of the constant errors.
    pub fn prior_sigmas(&self) -> [f32; constants::COUNT] {
        self.prior.map(sqrt)
    }

    /// Model of the tyres.
    pub fn tyres(&self) -> &Tyres {
        &self.tyres
    }

    /// Starts from O's posture and the front axle's posture in the rear axle's coordinates, with independent
    /// covariances. `floor_drift` is the displacement by the floor per metre rolled, standard deviation along each of
    /// the floor's axes.
    pub fn start(&self, robot: &Estimate, relative: &Estimate, floor_drift: f32) -> State {
        let (q, jacobian) = compound::midpoint_seen_from_rear(relative.posture);
        let back = q.inverse();
        let rear = robot.posture.compose(back);
        // rear = O ⊕ back(r). Its error in the rear axle's coordinates comes from the errors of O and of r.
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
            considered: [
                floor_drift * floor_drift,
                floor_drift * floor_drift,
                self.steady_turn,
            ],
        }
    }

    /// Resets the bias of an axle's gyro (0 front, 1 rear) to its prior, after the gyro was zeroed.
    pub fn forget_gyro_bias(&self, state: &mut State, axle: usize) {
        let k = GYRO_BIAS + axle.min(1);
        let u = &mut state.covariance.upper;
        for i in 0..N {
            u[i.min(FIRST + k)][i.max(FIRST + k)] = 0.0;
        }
        u[FIRST + k][FIRST + k] = self.prior[k];
        state.constants[k] = 0.0;
    }

    /// Time update by odometry. `front` and `rear` are increments in the axles' own coordinates at the start, each with
    /// the covariance of its error in those at the end. `gyro_shares` are the shares of the time in which the heading
    /// came from a gyro; `unloaded` is the part of the relative heading that does not load the front axle, and the rear
    /// axle; `ticks` is the duration of the increments.
    pub fn predict(
        &self,
        state: &mut State,
        front: &Estimate,
        rear: &Estimate,
        gyro_shares: [f32; 2],
        unloaded: [RelativeHeading; 2],
        ticks: f32,
    ) {
        let dt = ticks * self.t;
        let [front_share, rear_share] = gyro_shares;
        let [at_front, at_rear] = unloaded;
        let step = |axle: usize, moved: Posture, gyro_share: f32| IncrementInputs {
            axle,
            moved,
            relative_heading: RelativeHeading(
                state.loading.0 - if axle == 0 { at_front.0 } else { at_rear.0 },
            ),
            dt,
            gyro_share,
        };
        let (d1, front_error) = self.correct(&step(0, front.posture, front_share), state);
        let (d2, rear_error) = self.correct(&step(1, rear.posture, rear_share), state);

        let (sin, cos) = sin_cos(d2.phi);
        let turn_back: Mat3 = [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]];
        // Error of the rear axle's posture: ε' = turn_back (ε + ε_φ × d2) + turn_back e2.
        let carried = [[1.0, 0.0, -d2.y], [0.0, 1.0, d2.x], [0.0, 0.0, 1.0]];
        let by_rear = matrix::multiply(&turn_back, &carried);
        for by in &mut state.by_considered {
            *by = matrix::apply(&by_rear, by);
        }
        let distance = step(1, rear.posture, rear_share).mean_distance(&self.tyres);
        let [[east, minus_north, _], [north, ..], _] = state.world_from_rear();
        let (to_x, to_y) = (east * cos - north * sin, north * cos + east * sin);
        state.by_considered[2][2] += d2.x.abs();
        let floor = [[to_x, -to_y], [to_y, to_x]];
        for (by, direction) in state.by_considered.iter_mut().zip(floor) {
            by[0] += distance * direction[0];
            by[1] += distance * direction[1];
        }
        // Posture of the front axle in the rear axle's coordinates after the motion: ⊖ d2 ⊕ (r ⊕ d1).
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
        // The six rows of F P that differ from those of P.
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

        // Noise of the increments: for the rear axle's posture in the coordinates at the end, for the relative posture
        // turned into those at the start.
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

    /// The increment corrected by the estimated constants, and the derivatives of its error.
    fn correct(&self, step: &IncrementInputs, state: &State) -> (Posture, IncrementError) {
        let by_constants = step.by_constants(&self.tyres);
        let ([x, y, phi], by_heading) = step.error(&self.tyres, &by_constants, &state.constants);
        let p = step.moved;
        let error = IncrementError {
            by_constants,
            by_heading,
        };
        (Posture::new(p.x + x, p.y + y, p.phi + phi), error)
    }

    /// Restores the relative heading that loads the tyres, after a [`Self::predict`] without the odometry of one axle.
    pub fn keep_loading(&self, state: &mut State, loading: RelativeHeading) {
        state.loading = loading;
    }

    /// Update by the beam. `measured` is the front axle's posture in the rear axle's coordinates with the covariance of
    /// its noise. `accept` decides whether a NIS (three degrees of freedom) is acceptable.
    pub fn update(
        &self,
        state: &mut State,
        measured: &Estimate,
        accept: impl FnOnce(f32) -> bool,
    ) -> BeamUpdate {
        let r = &matrix::add(&measured.covariance, &self.backlash(state.relative));
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
        let factors = state
            .covariance
            .innovation_factors(REL, &OF_BEAM_STATES, &by_constants, r);
        let normalised = factors
            .as_ref()
            .map(|(factor, _)| solve_lower(factor, &innovation));
        let nis = normalised.map_or(f32::INFINITY, |normalised| {
            normalised.iter().map(|x| x * x).sum()
        });
        let mut outcome = BeamUpdate {
            verdict: Verdict::Gated,
            innovation,
            nis,
        };
        let (Some((_, root_gain)), Some(normalised), true) = (factors, normalised, accept(nis))
        else {
            return outcome;
        };
        outcome.verdict = Verdict::Used;
        state.covariance.subtract_update(&root_gain);
        let mut shift = [0.0; N];
        for (root_gain, normalised) in root_gain.iter().zip(normalised) {
            for (shift, root_gain) in shift.iter_mut().zip(root_gain) {
                *shift += root_gain * normalised;
            }
        }
        self.shift(state, &shift);
        outcome
    }

    /// Covariance of the relative posture due to backlash in both axles.
    fn backlash(&self, relative: Posture) -> Mat3 {
        let mut covariance = [[0.0; 3]; 3];
        let (sin, cos) = sin_cos(relative.phi);
        for (by, variance) in [
            ([cos, sin, 0.0], self.backlash_position),
            ([0.0, 0.0, 1.0], self.backlash_heading),
            ([1.0, 0.0, 0.0], self.backlash_position),
            ([-relative.y, relative.x, 1.0], self.backlash_heading),
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

    /// Keeps the covariance finite and positive definite, and fades the estimated constants towards their priors. To
    /// be called about every `ticks` ticks, between two steps.
    ///
    /// Constants with a random walk do not fade.
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

#[cfg(test)]
mod tests;
