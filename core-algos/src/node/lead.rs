//! Lead node: estimates in, references out, once an epoch.
//!
//! The step reads in the order of the data: reports → fusion of both axles → task → governor →
//! cascade → references. It works at [`super::LEAD_PHASE`] after the beginning of an epoch on the
//! reports of that epoch; its references hold for the same instant, and the axles move them on to
//! their own time.
//!
//! The reference postures follow from the estimated midpoint and the commanded bend at each step
//! and are not integrated, so the axles' controllers shape the robot while the kinematic
//! controller alone closes the loop over its path.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; nothing else can fail. While reports are missing the governor
//! brakes; when they are older than the timeout the mode is [`LeadMode::Idle`] and the axles
//! switch their motors off.

use super::course::{self, Course};
use super::{EPOCH, Micros, Outbox, Stamped, TICK, epoch_start, seconds, sequence};
use crate::bus::codec::wrap_position;
use crate::bus::{Axle, LeadMode, Message, layout};
use crate::config::{ConfigError, in_range};
use crate::control::cascade::{self, Cascade, Motion};
use crate::control::governor::{self, Governor, Wish};
use crate::control::regulator::{self, Phase, Regulator};
use crate::fusion::Estimate;
use crate::fusion::tandem::{self, Increment, Tandem};
use crate::math::Posture;
use crate::math::matrix::{Mat3, scale};

/// Steps of an axle in an epoch.
const TICKS_PER_EPOCH: f32 = (EPOCH / TICK) as f32;

/// Parameters of the lead node.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Config {
    /// Age of an axle's report after which the motors are switched off, s.
    pub report_timeout_s: f32,
    /// Second tier of fusion.
    pub fusion: tandem::Config,
    /// Posture regulation.
    pub regulator: regulator::Config,
    /// Path following and trajectory tracking.
    pub course: course::Config,
    /// Governor of the midpoint's motion.
    pub governor: governor::Config,
    /// Cascade to the axles.
    pub cascade: cascade::Config,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            report_timeout_s: layout::timeout_s(layout::id::AXLE_POSTURE),
            fusion: tandem::Config::default(),
            regulator: regulator::Config::default(),
            course: course::Config::default(),
            governor: governor::Config::default(),
            cascade: cascade::Config::default(),
        }
    }
}

impl Config {
    /// The node; the error names the parameter that is wrong.
    pub fn build(&self) -> Result<LeadNode, ConfigError> {
        in_range("report_timeout_s", self.report_timeout_s, 0.02, 1.0)?;
        let cascade = self.cascade.build()?;
        Ok(LeadNode {
            report_timeout: (self.report_timeout_s * 1e6) as Micros,
            fusion: self.fusion.build()?,
            regulator: self.regulator.build()?,
            course: self.course.build(&cascade)?,
            governor: self.governor.build(&cascade)?,
            cascade,
            state: State::default(),
        })
    }
}

/// What the robot is to do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Task {
    /// Motors off.
    #[default]
    Idle,
    /// Brake and hold.
    Stop,
    /// Bring the midpoint to a posture and to rest.
    Regulate {
        /// The goal.
        goal: Posture,
    },
    /// Follow the path in the node's buffer from its beginning (see [`LeadNode::course`]), and
    /// rest at its end.
    Follow,
    /// Track the trajectory in the node's buffer, beginning now, and rest at its end.
    Track,
}

/// The latest report of one axle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct AxleReport {
    posture: Option<Stamped<Posture>>,
    uncertainty: Option<Stamped<Mat3>>,
    /// Share of the axle's ticks in which its gyro took part.
    gyro_share: f32,
}

/// One axle as the lead node knows it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct AxleTrack {
    report: AxleReport,
    /// Odometric posture up to which the fused estimate goes.
    odometry: Option<Stamped<Posture>>,
}

impl AxleTrack {
    /// The motion since the last step, however many epochs it spans; `None` if nothing new came.
    fn advance(&mut self) -> Option<Increment> {
        let latest = self.report.posture?;
        let Some(last) = self.odometry else {
            self.odometry = Some(latest);
            return None;
        };
        if latest.time <= last.time {
            return None;
        }
        self.odometry = Some(latest);
        // Positions repeat after a span of the bus, so only their wrapped difference counts.
        let moved = Posture::new(
            wrap_position(latest.value.x - last.value.x),
            wrap_position(latest.value.y - last.value.y),
            latest.value.phi,
        );
        let ticks = ((latest.time - last.time) / EPOCH).min(u64::from(u16::MAX)) as u16;
        // The tier adds slip of its own, so a covariance that never came leaves some.
        let covariance = self.report.uncertainty.map_or([[0.0; 3]; 3], |u| u.value);
        Some(Increment {
            posture: moved.relative_to(Posture::new(0.0, 0.0, last.value.phi)),
            covariance: scale(&covariance, f32::from(ticks)),
            ticks,
            gyro_share: self.report.gyro_share,
        })
    }
}

/// What the lead node did at a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Output {
    /// Mode sent to the axles.
    pub mode: LeadMode,
    /// Estimated postures of the axles and the midpoint, and what the beam added.
    pub fused: tandem::Output,
    /// Commanded motion of the midpoint.
    pub motion: Motion,
    /// Phase of the regulator, when regulating.
    pub phase: Phase,
    /// Where the midpoint should be, on a path or trajectory.
    pub target: Option<Posture>,
    /// The task is fulfilled and the robot at rest.
    pub done: bool,
}

/// All that changes in the lead node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    task: Task,
    tracks: [AxleTrack; 2],
    beam_posture: Option<Stamped<Posture>>,
    beam_uncertainty: Option<Stamped<Mat3>>,
    fusion: Option<tandem::State>,
    regulator: regulator::State,
    course: course::State,
    governor: governor::State,
}

/// What the task asks for at a step.
#[derive(Clone, Copy, Debug, Default)]
struct Decision {
    /// Wish for the governor; none: brake.
    wish: Option<Wish>,
    mode: LeadMode,
    phase: Phase,
    target: Option<Posture>,
    done: bool,
}

/// A robot that is done keeps its posture.
fn active_until(done: bool) -> LeadMode {
    if done {
        LeadMode::Hold
    } else {
        LeadMode::Active
    }
}

impl From<course::Step> for Decision {
    fn from(step: course::Step) -> Self {
        Self {
            wish: step.wish,
            mode: active_until(step.done),
            phase: Phase::default(),
            target: step.target,
            done: step.done,
        }
    }
}

/// The lead node.
#[derive(Clone, Debug, PartialEq)]
pub struct LeadNode {
    report_timeout: Micros,
    fusion: Tandem,
    regulator: Regulator,
    course: Course,
    governor: Governor,
    cascade: Cascade,
    state: State,
}

impl LeadNode {
    /// Begins with the robot at rest, its midpoint at `center` and the front axle at `relative` in
    /// the rear axle's frame.
    pub fn initialize(&mut self, center: &Estimate, relative: &Estimate) {
        self.state = State {
            fusion: Some(self.fusion.start_at(center, relative)),
            ..State::default()
        };
    }

    /// The second tier of fusion in its present state.
    pub fn fusion(&self) -> Option<&tandem::State> {
        self.state.fusion.as_ref()
    }

    /// Gives the robot something to do; the present motion is taken over.
    pub fn command(&mut self, task: Task) {
        self.state.task = task;
        self.state.course.restart();
    }

    /// The buffers of path and trajectory, to be filled before [`Task::Follow`] or [`Task::Track`]
    /// and while it runs.
    pub fn course(&mut self) -> &mut course::State {
        &mut self.state.course
    }

    /// The cascade, with the frame's geometry.
    pub fn cascade(&self) -> &Cascade {
        &self.cascade
    }

    /// Takes in a message that arrived at `now`.
    pub fn receive(&mut self, now: Micros, message: &Message) {
        match *message {
            Message::AxlePosture {
                axle,
                sequence,
                posture,
            } => {
                let report = &mut self.state.tracks[axle.index()].report;
                report.posture = Some(Stamped::new(posture, epoch_start(now, sequence)));
            }
            Message::AxleMotion {
                axle, gyro_samples, ..
            } => {
                let report = &mut self.state.tracks[axle.index()].report;
                report.gyro_share = (f32::from(gyro_samples) / TICKS_PER_EPOCH).min(1.0);
            }
            Message::AxleUncertainty {
                axle,
                sequence,
                covariance,
            } => {
                let report = &mut self.state.tracks[axle.index()].report;
                report.uncertainty = Some(Stamped::new(covariance, epoch_start(now, sequence)));
            }
            Message::BeamPosture {
                sequence,
                posture,
                gauges,
            } if gauges > 0 => {
                self.state.beam_posture = Some(Stamped::new(posture, epoch_start(now, sequence)));
            }
            Message::BeamUncertainty {
                sequence,
                covariance,
            } => {
                self.state.beam_uncertainty =
                    Some(Stamped::new(covariance, epoch_start(now, sequence)));
            }
            _ => {}
        }
    }

    /// One step at `now`; references go to `outbox`.
    pub fn step(&mut self, now: Micros, outbox: &mut Outbox) -> Output {
        let Some(fused) = self.fuse(now) else {
            return self.idle(now, outbox);
        };
        let center = fused.robot.posture;
        let dt = seconds(EPOCH);

        let decision = self.decide(now, center);
        self.state.governor = match decision.wish {
            Some(wish) => self.governor.step(&self.state.governor, &wish, dt),
            None => self.governor.stop(&self.state.governor, dt),
        };
        let motion = self.state.governor.motion;
        self.send_references(now, decision.mode, &motion, &fused, outbox);
        Output {
            mode: decision.mode,
            fused,
            motion,
            phase: decision.phase,
            target: decision.target,
            done: decision.done,
        }
    }

    /// What the task asks for with O at `center`.
    fn decide(&mut self, now: Micros, center: Posture) -> Decision {
        let state = &mut self.state;
        let motion = state.governor.motion;
        let active = Decision {
            mode: LeadMode::Active,
            ..Decision::default()
        };
        match state.task {
            Task::Idle => Decision::default(),
            Task::Stop => active,
            Task::Regulate { goal } => {
                let output = self.regulator.tick(
                    &mut state.regulator,
                    &regulator::Input {
                        posture: center,
                        steering_rad: motion.psi,
                        speed_m_s: motion.v,
                        goal,
                    },
                );
                let command = output.command;
                Decision {
                    wish: Some(Wish::from_curvature(
                        &self.cascade,
                        command.v,
                        command.kappa,
                    )),
                    mode: active_until(output.done),
                    phase: output.phase,
                    done: output.done,
                    ..active
                }
            }
            Task::Follow => {
                let step = self.course.follow(&mut state.course, center, &motion);
                Decision::from(step)
            }
            Task::Track => {
                let epoch = epoch_start(now, sequence(now));
                let step = self.course.track(&mut state.course, epoch, center, &motion);
                Decision::from(step)
            }
        }
    }

    /// Brings the estimate to the present epoch; `None` while reports are missing.
    fn fuse(&mut self, now: Micros) -> Option<tandem::Output> {
        let state = &mut self.state;
        let fusion = state.fusion.as_mut()?;
        let mut increments = [None; 2];
        for (track, increment) in state.tracks.iter_mut().zip(&mut increments) {
            if track.report.posture?.age(now) > self.report_timeout {
                return None;
            }
            *increment = track.advance();
        }
        // The beam speaks of the same instant as both odometries, or not at all.
        let epoch = epoch_start(now, sequence(now));
        let current = |time: Micros| time == epoch;
        let beam = match (state.beam_posture, state.beam_uncertainty) {
            (Some(posture), Some(covariance))
                if current(posture.time) && current(covariance.time) =>
            {
                Some(Estimate::new(posture.value, covariance.value))
            }
            _ => None,
        };
        let [front, rear] = increments;
        Some(
            self.fusion
                .step(fusion, &tandem::Inputs { front, rear, beam }),
        )
    }

    fn idle(&mut self, now: Micros, outbox: &mut Outbox) -> Output {
        self.state.governor = self.governor.stop(&self.state.governor, seconds(EPOCH));
        let motion = self.state.governor.motion;
        outbox.push(Message::LeadStatus {
            sequence: sequence(now),
            mode: LeadMode::Idle,
            steering_rad: motion.psi,
            velocity_m_s: motion.v,
        });
        Output {
            motion,
            ..Output::default()
        }
    }

    fn send_references(
        &self,
        now: Micros,
        mode: LeadMode,
        motion: &Motion,
        fused: &tandem::Output,
        outbox: &mut Outbox,
    ) {
        let sequence = sequence(now);
        outbox.push(Message::LeadStatus {
            sequence,
            mode,
            steering_rad: motion.psi,
            velocity_m_s: motion.v,
        });
        let references = self.cascade.references(fused.robot.posture, motion);
        let axles = [fused.front.posture, fused.rear.posture];
        for axle in Axle::BOTH {
            let reference = references[axle.index()];
            let Some(odometry) = self.state.tracks[axle.index()].odometry else {
                continue;
            };
            // The same posture relative to the axle, in the axle's own odometric frame.
            let relative = reference.posture.relative_to(axles[axle.index()]);
            outbox.push(Message::ReferencePosture {
                axle,
                sequence,
                posture: odometry.value.compose(relative),
            });
            outbox.push(Message::ReferenceMotion {
                axle,
                sequence,
                velocity_m_s: reference.twist.v,
                yaw_rate_rad_s: reference.twist.omega,
                acceleration_m_s2: reference.acceleration.v,
                yaw_acceleration_rad_s2: reference.acceleration.omega,
            });
        }
    }
}
