//! Second tier of fusion: both axles and the beam between them (paper section VI-B, figure 6), run
//! on the lead node at a fixed tick.
//!
//! In: an odometric increment of each axle since the last tick, and the beam's relative posture
//! (front axle in the rear axle's coordinates); any may be absent. Out: posture and covariance of both
//! axles and of the robot's midpoint O in global coordinates.
//!
//! | mode | method |
//! |---|---|
//! | [`Mode::Odometry`] | sum of the increments, without the beam |
//! | [`Mode::Intersection`] | method of the paper: each axle's posture is intersected with the other axle's posture seen through the beam; both use the values before the update |
//! | [`Mode::IntersectionIpec`] | [`ipec`] corrects headings and distance, then covariance intersection follows |
//! | [`Mode::Joint`] | one filter of both axles ([`joint`]) |
//!
//! **Constant errors.** Errors of wheel radii, of the beam's zero, of the start and of tyre creep under the frame's
//! moment stay the same throughout a drive. Their effect grows with the distance, not with its root, and part of it
//! is equal or opposite in both axles. The joint filter estimates these errors. The other modes store each posture's
//! sensitivity to each of them ([`track`]), so that the claimed covariance contains them. Covariance intersection
//! then finds the axle whose error has grown: it follows the axles in turn, and their opposite yaw cancels.
//!
//! **Noise.** The configured slip, which the wheels do not measure, is added to each increment's covariance. Slip
//! grows with distance, with time and with the relative heading: a bent frame turns the axles against each other even
//! at standstill. On [uneven ground](ground) the joint filter adds noise, seen by the beam's innovations.
//!
//! **Lost messages.** An axle sends its odometric posture, not its last step, so a lost message delays motion and
//! loses none. While one axle's increment is missing, the beam is not used: it measures motion that odometry has yet
//! to report.
//!
//! [`Config::build`] validates; after it nothing fails or panics. Inputs that are not finite count as absent.
//!
//! # Example
//!
//! ```
//! use core_algos::fusion::Estimate;
//! use core_algos::fusion::robot::{Config, Increment, Inputs, Output};
//! use core_algos::math::{Posture, matrix};
//!
//! let fusion = Config::default().build()?;
//! let placed = Estimate::with_sigmas(Posture::ORIGIN, [3e-3, 3e-3, 5e-3]);
//! let straight = Estimate::with_sigmas(Posture::new(0.37, 0.0, 0.0), [1e-4, 1e-4, 1e-3]);
//! let mut state = fusion.start(&placed, &straight, 0.005);
//! let moved = |turn| Increment::new(Posture::new(2e-3, 0.0, turn), matrix::diagonal([1e-9; 3]));
//! let mut output = Output::default();
//! for _ in 0..100 {
//!     // By the wheels the axles turn against each other, by the beam they do not.
//!     output = fusion.step(&mut state, &Inputs {
//!         front: Some(moved(1e-4)),
//!         rear: Some(moved(-1e-4)),
//!         beam: Some(straight),
//!         ..Inputs::default()
//!     });
//! }
//! let apart = output.front.posture.phi - output.rear.posture.phi;
//! assert!(apart.abs() < 2e-3, "by the wheels it would be 0.02");
//! assert!((output.robot.posture.x - 0.2).abs() < 2e-3);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

mod config;
pub mod ground;
mod slip;

pub use config::{Config, Mode, Slip};
use slip::Slipping;

use super::compound::Chain;
use super::ekf::Verdict;
use super::track::{self, Sensitivity, Track};
use super::{Estimate, constants, intersection, ipec, joint};
use crate::math::matrix::{self, Mat3};
use crate::math::trig::{sqrt, wrap_angle};
use crate::math::{Posture, RelativeHeading};

/// Distance over which a constant error of odometry and a random walk of equal size have the same effect, m; for the
/// weights of IPEC.
const REFERENCE_WAY_M: f32 = 1.0;
/// Time over which a constant error of a gyro and a random walk of equal size have the same effect, s; for the weights
/// of IPEC.
const REFERENCE_TIME_S: f32 = 1.0;
/// Duration of a drive up to which a constant bias covers the random walk of a gyro's bias, s.
const WALK_TIME_S: f32 = 30.0;
/// Largest NIS of the beam's posture that counts for the unevenness of the ground.
const MOST_NIS: f32 = 40.0;
/// Ticks between two times that the joint filter's covariance is conditioned.
const CONDITION_INTERVAL: u8 = 64;

/// Fusion of both axles and the beam on the lead node, with checked parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotFusion {
    mode: Mode,
    per_m: [f32; 3],
    /// Variance of slip across the heading, per metre and squared relative heading.
    side_per_m: f32,
    position_per_tick: f32,
    heading_per_tick: f32,
    creep_per_tick: f32,
    creep_per_m: f32,
    period: f32,
    /// Standard deviations of the constant errors.
    constants: [f32; constants::COUNT],
    /// Standard deviation of the slip speed under an unmeasured load of the frame: along, across (m/s), in heading
    /// (rad/s).
    load: [f32; 3],
    ground: ground::Ground,
    beam_gate: Option<f32>,
    patience: u16,
    intersection: intersection::Intersection,
    ipec: ipec::Ipec,
    joint: joint::Joint,
}

/// Motion of one axle by its own odometry.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Increment {
    /// Posture reached, in the axle's coordinates at the start of the increment (m, m, rad).
    pub posture: Posture,
    /// Covariance of the error: along and across the heading reached, in heading.
    pub covariance: Mat3,
    /// Ticks that the increment spans.
    pub ticks: u16,
    /// Share of the time in which the heading came from a gyro, 0 to 1.
    pub gyro_share: f32,
    /// True if the gyro was zeroed at rest; the estimate of its bias is then void.
    pub gyro_zeroed: bool,
}

impl Increment {
    /// An increment over one tick, by wheels alone.
    pub const fn new(posture: Posture, covariance: Mat3) -> Self {
        Self {
            posture,
            covariance,
            ticks: 1,
            gyro_share: 0.0,
            gyro_zeroed: false,
        }
    }

    fn is_finite(&self) -> bool {
        self.posture.is_finite()
            && matrix::is_finite(&self.covariance)
            && self.gyro_share.is_finite()
    }
}

/// Axle of a pair of neighbouring axles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PairAxle {
    /// Front axle.
    Front,
    /// Rear axle.
    Rear,
}

/// Load of an axle by all of its frames, besides that of its pair's frame in pure bending.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Part of the pair's relative heading that does not load the axle.
    pub unloaded: RelativeHeading,
    /// Force of the frames on the axle, to its left, over EI/L, rad/m.
    pub aside: f32,
}

/// Odometry and beam measurement that arrived since the last tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Odometry of the front axle.
    pub front: Option<Increment>,
    /// Odometry of the rear axle.
    pub rear: Option<Increment>,
    /// Front axle's posture in the rear axle's coordinates, measured by the beam, with the covariance of
    /// its noise.
    pub beam: Option<Estimate>,
    /// Loads of the front and the rear axle besides the pair's own pure bending; zero for a robot of two axles.
    pub loads: [Load; 2],
}

/// Fused postures after a tick, and what the fusion did with the beam's measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Output {
    /// Front axle (axle 1), global coordinates.
    pub front: Estimate,
    /// Rear axle (axle 2), global coordinates.
    pub rear: Estimate,
    /// Midpoint O, heading from rear to front, global coordinates.
    pub robot: Estimate,
    /// The beam's update: verdict, innovation and NIS.
    pub beam: joint::BeamUpdate,
    /// Correction by IPEC, in the mode that runs it.
    pub ipec: Option<ipec::Correction>,
    /// Weights of covariance intersection for front and rear: 1 keeps the axle's own estimate.
    pub omega: Option<[f32; 2]>,
}

impl Output {
    /// Heading of the front axle against the rear axle, within ±π.
    pub fn relative_heading(&self) -> RelativeHeading {
        RelativeHeading(wrap_angle(self.front.posture.phi - self.rear.posture.phi))
    }
}

/// Estimates of both axles, or the joint filter.
// The larger variant cannot be boxed without a heap.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Copy, Debug, PartialEq)]
enum Tracks {
    Separate { front: Track, rear: Track },
    Joint(joint::State),
}

/// State of the fusion of both axles and the beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    tracks: Tracks,
    /// Displacement of the robot by the floor per metre rolled, standard deviation.
    floor_drift: f32,
    until_condition: u8,
    /// Posture of O.
    robot: Posture,
    /// Heading of O before the last tick.
    heading: f32,
    /// Motion of O in the last tick by odometry alone, along the global axes.
    moved: Posture,
    /// Unevenness of the ground.
    unevenness: ground::Unevenness,
    beam: Beam,
}

/// Latest accepted measurement of the beam, and number of measurements rejected after it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Beam {
    /// Last accepted relative posture.
    relative: Estimate,
    rejected_in_a_row: u16,
}

impl State {
    /// Heading of O before the last tick, and motion of O in that tick by odometry alone (m, m, rad; global axes).
    pub fn moved(&self) -> (f32, Posture) {
        (self.heading, self.moved)
    }

    /// Conditions the covariance `ticks` earlier than otherwise, so that the states of several pairs take turns.
    pub fn condition_earlier(&mut self, ticks: u8) {
        self.until_condition = self.until_condition.saturating_sub(ticks);
    }

    /// State of the joint filter; `None` in the other modes.
    pub fn joint(&self) -> Option<&joint::State> {
        match &self.tracks {
            Tracks::Joint(joint) => Some(joint),
            Tracks::Separate { .. } => None,
        }
    }
}

impl RobotFusion {
    /// Starts from O's posture and the front axle's posture in the rear axle's coordinates, each with its covariance.
    /// `floor_drift` is the displacement by the floor per metre rolled, standard deviation along each of the floor's
    /// axes.
    pub fn start(&self, robot: &Estimate, relative: &Estimate, floor_drift: f32) -> State {
        let tracks = match self.mode {
            Mode::Joint => Tracks::Joint(self.joint.start(robot, relative, floor_drift)),
            _ => {
                let (r, o) = (relative.posture, robot.posture);
                let begin = |chain: Chain| {
                    let by_robot = matrix::multiply(&chain.by_base, &spread(&robot.covariance));
                    let by_frame =
                        matrix::multiply(&chain.by_relative, &spread(&relative.covariance));
                    let mut constants: Sensitivity = [[0.0; track::CONSTANTS]; 3];
                    for i in 0..3 {
                        for k in 0..3 {
                            constants[i][track::START + k] = by_robot[i][k];
                            constants[i][track::START + 3 + k] = by_frame[i][k];
                        }
                    }
                    Track::new(chain.posture, constants)
                };
                Tracks::Separate {
                    front: begin(Chain::front_from_midpoint(o, r)),
                    rear: begin(Chain::rear_from_midpoint(o, r)),
                }
            }
        };
        State {
            tracks,
            floor_drift,
            until_condition: CONDITION_INTERVAL,
            robot: robot.posture,
            heading: robot.posture.phi,
            moved: Posture::ORIGIN,
            unevenness: ground::Unevenness::default(),
            beam: Beam {
                relative: *relative,
                rejected_in_a_row: 0,
            },
        }
    }

    /// Conditions the joint filter's covariance if this is due, ahead of the next tick, so that the tick is short.
    /// The outputs of [`Self::step`] are the same without this call. True if conditioning was due.
    pub fn prepare(&self, state: &mut State) -> bool {
        let (0, Tracks::Joint(joint)) = (state.until_condition, &mut state.tracks) else {
            return false;
        };
        state.until_condition = CONDITION_INTERVAL;
        self.joint.condition(joint, CONDITION_INTERVAL);
        true
    }

    /// Runs one tick: odometry of both axles, then update by the beam.
    pub fn step(&self, state: &mut State, inputs: &Inputs) -> Output {
        self.prepare(state);
        let front = inputs.front.filter(Increment::is_finite);
        let rear = inputs.rear.filter(Increment::is_finite);
        // The beam's posture is comparable only if both axles have reported their increments.
        let complete = front.is_some() && rear.is_some();
        let heading = RelativeHeading(match &state.tracks {
            Tracks::Separate { front, rear } => wrap_angle(front.posture.phi - rear.posture.phi),
            Tracks::Joint(joint) => joint.relative().posture.phi,
        });
        let uneven = state.unevenness.value;
        // The moment of a frame on its front axle is opposite to its moment on its rear axle.
        let [front_load, rear_load] = &inputs.loads;
        let front = self.with_slip(front, heading, front_load, uneven);
        let rear = self.with_slip(rear, heading, rear_load, uneven);

        let mut output = Output::default();
        let beam = inputs.beam.filter(|_| complete && self.uses_beam());
        let offered = beam.is_some();
        let beam = beam.filter(is_usable);
        if offered && beam.is_none() {
            output.beam.verdict = Verdict::Invalid;
        }
        let State {
            tracks,
            floor_drift,
            until_condition,
            robot,
            heading: before,
            moved,
            unevenness,
            beam: beam_state,
        } = state;
        *before = robot.phi;
        match tracks {
            Tracks::Separate { front: f, rear: r } => {
                let was = Chain::midpoint(f.posture, r.posture).posture;
                self.advance(f, &front, 0, heading, *floor_drift);
                self.advance(r, &rear, 1, heading, *floor_drift);
                let [x, y, phi] = Chain::midpoint(f.posture, r.posture).posture.minus(was);
                *moved = Posture::new(x, y, phi);
                if let Some(beam) = beam {
                    self.join(beam_state, [f, r], &beam, [&front, &rear], &mut output);
                }
                output.front = f.estimate();
                output.rear = r.estimate();
                output.robot = match output.beam.verdict {
                    Verdict::Used => self.middle(f, r, &beam_state.relative),
                    _ => self.middle_without_beam(f, r),
                };
            }
            Tracks::Joint(joint) => {
                let ticks = front.ticks.max(rear.ticks);
                let shares = [front.gyro_share, rear.gyro_share];
                for (axle, increment) in [inputs.front, inputs.rear].iter().enumerate() {
                    if increment.is_some_and(|increment| increment.gyro_zeroed) {
                        self.joint.forget_gyro_bias(joint, axle);
                    }
                }
                let loading = joint.loading();
                let (relative, heading) = (joint.relative_posture(), joint.rear().phi);
                self.joint.predict(
                    joint,
                    &front.estimate,
                    &rear.estimate,
                    shares,
                    inputs.loads.map(|load| load.unloaded),
                    ticks,
                );
                if !complete {
                    self.joint.keep_loading(joint, loading);
                }
                *moved = joint.moved(*robot, relative, heading);
                if let Some(beam) = beam {
                    let spent = self.ground.is_spent(unevenness);
                    output.beam = self
                        .joint
                        .update(joint, &beam, |nis| !spent && self.accepts(beam_state, nis));
                    self.count(beam_state, output.beam.verdict, &beam);
                    let driven = 0.5 * (front.advance.abs() + rear.advance.abs());
                    self.ground
                        .step(unevenness, driven, output.beam.nis, MOST_NIS);
                }
                *until_condition = until_condition.saturating_sub(1);
                let estimates = joint.estimates();
                output.front = estimates.front;
                output.rear = estimates.rear;
                output.robot = estimates.robot;
            }
        }
        *robot = output.robot.posture;
        output
    }

    /// The part of the robot that the other sensors contradict; `None` if there is no such part, or in a mode other
    /// than the joint filter.
    pub fn inconsistent_sensor(&self, state: &State) -> Option<joint::InconsistentSensor> {
        state
            .joint()
            .and_then(|joint| self.joint.inconsistent_sensor(joint))
    }

    /// True if the mode uses the beam.
    pub fn uses_beam(&self) -> bool {
        self.mode != Mode::Odometry
    }

    /// Restarts from the beam and the axle whose estimate is still valid, after the other axle has lost its estimate.
    /// `last` is the output of the latest step. Estimates of the constants are lost too.
    pub fn rejoin(
        &self,
        state: &mut State,
        known: PairAxle,
        last: &Output,
        beam: &Estimate,
    ) -> Output {
        let whole = self.beam_track(beam).estimate();
        let (base, chain) = match known {
            PairAxle::Front => (
                &last.front,
                Chain::midpoint_from_front(last.front.posture, beam.posture),
            ),
            PairAxle::Rear => (
                &last.rear,
                Chain::midpoint_from_rear(last.rear.posture, beam.posture),
            ),
        };
        let covariance = matrix::add(
            &matrix::propagate(&chain.by_base, &base.covariance),
            &matrix::propagate(&chain.by_relative, &whole.covariance),
        );
        let robot = Estimate::new(chain.posture, covariance);
        *state = State {
            // The pairs of a chain keep their turns, and this epoch has a second step.
            until_condition: state.until_condition.saturating_add(1),
            ..self.start(&robot, &whole, state.floor_drift)
        };
        self.step(state, &Inputs::default())
    }

    /// Moves an axle (0 front, 1 rear) by its odometry.
    fn advance(
        &self,
        track: &mut Track,
        increment: &Slipping,
        axle: usize,
        heading: RelativeHeading,
        floor_drift: f32,
    ) {
        let moved = into_departure(&increment.estimate);
        let step = constants::IncrementInputs {
            axle,
            moved: moved.posture,
            relative_heading: heading,
            dt: increment.ticks * self.period,
            gyro_share: increment.gyro_share,
        };
        let mut error = Track::random(moved);
        let by_constants = step.by_constants(self.joint.tyres());
        for (row, by) in error.constants.iter_mut().zip(&by_constants) {
            for k in 0..constants::COUNT {
                row[track::SHARED + k] = by[k] * self.constants[k];
            }
        }
        let [forward, lateral, turning] = self.load;
        let first = track::LOAD + if axle == 0 { 0 } else { 3 };
        error.constants[0][first] = forward * step.dt;
        error.constants[1][first + 1] = lateral * step.dt;
        error.constants[2][first + 2] = turning * step.by_wheels() * step.dt;
        // A posture and an increment compose like rear axle and relative posture.
        *track = track.propagated(&Chain::front_from_rear(track.posture, step.moved), &error);
        let drifted = floor_drift * step.mean_distance(self.joint.tyres());
        for k in 0..2 {
            track.constants[k][track::DRIFTED + k] += drifted;
        }
    }

    /// The beam's posture with its sensitivity to zeros and gains of the gauges.
    fn beam_track(&self, beam: &Estimate) -> Track {
        let mut track = Track::random(*beam);
        let by_constants = constants::beam_by_constants(beam.posture);
        for (row, by) in track.constants.iter_mut().zip(&by_constants) {
            for (k, by) in by.iter().enumerate() {
                row[track::SHARED + k] = -by * self.constants[k];
            }
        }
        track
    }

    /// Updates both axles by the beam. Each axle is updated from the other axle's posture before the update.
    fn join(
        &self,
        beam_state: &mut Beam,
        [front, rear]: [&mut Track; 2],
        beam: &Estimate,
        increments: [&Slipping; 2],
        output: &mut Output,
    ) {
        let relative = self.beam_track(beam);
        let predicted = front.posture.relative_to(rear.posture);
        let (by_front, by_rear) = front.posture.relative_jacobians(rear.posture);
        // The correlation of the random parts is unknown, so their sum is doubled below.
        let random = matrix::add(
            &matrix::propagate(&by_front, &front.random),
            &matrix::propagate(&by_rear, &rear.random),
        );
        let constants = matrix::add(
            &matrix::multiply(&by_front, &front.constants),
            &matrix::multiply(&by_rear, &rear.constants),
        );
        let spread = Track {
            posture: predicted,
            random: matrix::add(&matrix::scale(&random, 2.0), &relative.random),
            constants: matrix::add(&constants, &matrix::scale(&relative.constants, -1.0)),
        };
        let spread = spread.estimate().covariance;
        let innovation = beam.posture.minus(predicted);
        let nis = match matrix::cholesky(&spread) {
            Some(factor) => {
                let solved = matrix::cholesky_solve(&factor, &innovation);
                (0..3).map(|k| innovation[k] * solved[k]).sum()
            }
            None => f32::INFINITY,
        };
        output.beam = joint::BeamUpdate {
            verdict: if self.accepts(beam_state, nis) {
                Verdict::Used
            } else {
                Verdict::Gated
            },
            innovation,
            nis,
        };
        self.count(beam_state, output.beam.verdict, beam);
        if output.beam.verdict != Verdict::Used {
            return;
        }
        if self.mode == Mode::IntersectionIpec {
            let rear_from_front = beam.posture.inverse();
            let own = increments.map(|increment| increment.heading_variance);
            let advance = increments.map(|increment| increment.advance);
            let corrected = self.ipec.weigh(
                [front.posture, rear.posture],
                advance,
                own,
                &rear_from_front,
            );
            if let Some(([f, r], correction)) = corrected {
                front.posture = f;
                rear.posture = r;
                output.ipec = Some(correction);
            }
        }
        let link = Chain::front_from_rear(rear.posture, beam.posture);
        let front_by_rear = rear.propagated(&link, &relative);
        let link = Chain::rear_from_front(front.posture, beam.posture);
        let rear_by_front = front.propagated(&link, &relative);
        let fused = [
            front.intersect(&front_by_rear, &self.intersection),
            rear.intersect(&rear_by_front, &self.intersection),
        ];
        if let [Some((f, by_front)), Some((r, by_rear))] = fused {
            *front = f;
            *rear = r;
            output.omega = Some([by_front, by_rear]);
        }
    }

    /// Posture of O by covariance intersection of two estimates: front axle with beam, and rear axle with beam.
    fn middle(&self, front: &Track, rear: &Track, beam: &Estimate) -> Estimate {
        let relative = self.beam_track(beam);
        let link = Chain::midpoint_from_front(front.posture, beam.posture);
        let by_front = front.propagated(&link, &relative);
        let link = Chain::midpoint_from_rear(rear.posture, beam.posture);
        let by_rear = rear.propagated(&link, &relative);
        match by_front.intersect(&by_rear, &self.intersection) {
            Some((fused, _)) => fused.estimate(),
            None => self.middle_without_beam(front, rear),
        }
    }

    /// Posture of O halfway between the axles, without the beam.
    fn middle_without_beam(&self, front: &Track, rear: &Track) -> Estimate {
        let chain = Chain::midpoint(front.posture, rear.posture);
        let mut middle = front.propagated(&chain, rear);
        if self.mode != Mode::Odometry {
            // Updates by the beam correlate the random parts to an unknown degree, so their covariance is doubled.
            middle.random = matrix::scale(&middle.random, 2.0);
        }
        middle.estimate()
    }

    fn accepts(&self, state: &Beam, nis: f32) -> bool {
        match self.beam_gate {
            Some(gate) => nis <= gate || state.rejected_in_a_row >= self.patience,
            None => nis.is_finite(),
        }
    }

    fn count(&self, state: &mut Beam, verdict: Verdict, beam: &Estimate) {
        match verdict {
            Verdict::Used => {
                state.rejected_in_a_row = 0;
                state.relative = *beam;
            }
            Verdict::Gated => {
                state.rejected_in_a_row = state.rejected_in_a_row.saturating_add(1);
            }
            Verdict::Invalid | Verdict::Absent => {}
        }
    }
}

/// Cholesky factor of a covariance; without correlations if the covariance is not positive definite.
fn spread(covariance: &Mat3) -> Mat3 {
    matrix::cholesky(covariance)
        .unwrap_or_else(|| matrix::diagonal([0, 1, 2].map(|k| sqrt(covariance[k][k].max(0.0)))))
}

/// The increment with its covariance turned into the frame in which the increment starts.
fn into_departure(increment: &Estimate) -> Estimate {
    let (sin, cos) = crate::math::trig::sin_cos(increment.posture.phi);
    let turn = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]];
    Estimate::new(
        increment.posture,
        matrix::propagate(&turn, &increment.covariance),
    )
}

/// True if a relative posture can be used: finite, its covariance positive definite.
fn is_usable(beam: &Estimate) -> bool {
    beam.is_finite() && matrix::cholesky(&beam.covariance).is_some()
}

#[cfg(test)]
mod tests;
