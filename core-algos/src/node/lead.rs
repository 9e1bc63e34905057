//! Lead node: estimates in, references out, once an epoch.
//!
//! The step reads in the order of the data: reports → fusion of both axles → task → governor →
//! cascade → references. It works at [`LEAD_PHASE`](crate::time::LEAD_PHASE) after the beginning of an epoch on the
//! reports of that epoch; its references hold for the same instant, and the axles move them on to
//! their own time.
//!
//! The reference postures follow from the estimated midpoint and the commanded steering at each step
//! and are not integrated, so the axles' controllers shape the robot while the kinematic
//! controller alone closes the loop over its path.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; nothing else can fail. When reports are older than the timeout, or
//! anything else is wrong, the mode is [`LeadMode::Idle`], on which the axles brake together and
//! switch their motors off.

use super::Outbox;
use super::path_task::{self, PathTask};
use super::peers::{self, Peers};
use crate::bus::codec::wrap_position;
use crate::bus::{LeadMode, Message, layout};
use crate::config::{ConfigError, in_range, positive};
use crate::control::cascade::{self, AxleReference, Cascade, Motion};
use crate::control::governor::{self, Governor, Wish};
use crate::control::regulator::{self, Phase, Regulator};
use crate::fusion::Estimate;
use crate::fusion::ekf::Verdict;
use crate::fusion::robot::{self, Increment, RobotFusion};
use crate::math::matrix::{Mat3, diagonal, scale};
use crate::math::{Posture, RelativeHeading, Transform, Twist, Wrench};
use crate::safety::supervisor::{self, Supervisor};
use crate::safety::{Condition, Conditions, OperatingState, Permit, Request, ramp};
use crate::time::{EPOCH, Micros, Stamped, TICK, epoch_start, seconds, sequence};
use crate::topology::AxleId;
use crate::topology::Node;

/// Age from which a report is late: the bus has had a whole epoch for it.
const LATE: Micros = 2 * EPOCH;

/// Steps of an axle in an epoch.
const TICKS_PER_EPOCH: f32 = (EPOCH / TICK) as f32;

/// Parameters of the lead node.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Config {
    /// Age of an axle's report after which the motors are switched off, s.
    pub report_timeout_s: f32,
    /// Longest time that the motors hold the robot where it is, before a drive or after it, s; then
    /// they are let go until the next command.
    pub hold_s: f32,
    /// Second tier of fusion.
    pub fusion: robot::Config,
    /// Posture regulation.
    pub regulator: regulator::Config,
    /// Path following and trajectory tracking.
    pub course: path_task::Config,
    /// Governor of the midpoint's motion.
    pub governor: governor::Config,
    /// Cascade to the axles.
    pub cascade: cascade::Config,
    /// When the robot stops because something is wrong.
    pub limits: Limits,
    /// How it stops.
    pub stop: ramp::Config,
    /// Supervisor.
    pub supervisor: supervisor::Config,
}

/// Bounds of what a sound robot does; each counts only after the time of its condition.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Limits {
    /// Steering angle of the frame |ψ|, rad.
    #[cfg_attr(feature = "serde", serde(rename = "bend_rad"))]
    pub steering_rad: f32,
    /// Force of the frame on an axle, N.
    pub force_n: f32,
    /// Moment of the frame on an axle, N m.
    pub moment_n_m: f32,
    /// Standard deviation of the position of O, m; not looked at where the fusion is configured
    /// without the relative position sensor.
    pub position_sigma_m: f32,
    /// Standard deviation of the heading of O, rad; likewise.
    pub heading_sigma_rad: f32,
    /// Half axis of the position of O in which a goal counts as reached for certain, with 95 %, m.
    pub goal_position_m: f32,
    /// The same of its heading, rad.
    pub goal_heading_rad: f32,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            steering_rad: 0.7,
            force_n: 25.0,
            moment_n_m: 6.0,
            // What a floor may make of 300 m.
            position_sigma_m: 5.0,
            heading_sigma_rad: 0.5,
            goal_position_m: 0.03,
            goal_heading_rad: 0.052,
        }
    }
}

impl Limits {
    fn check(&self) -> Result<(), ConfigError> {
        in_range("bend_rad", self.steering_rad, 0.05, 1.5)?;
        positive("force_n", self.force_n)?;
        positive("moment_n_m", self.moment_n_m)?;
        positive("position_sigma_m", self.position_sigma_m)?;
        positive("heading_sigma_rad", self.heading_sigma_rad)?;
        positive("goal_position_m", self.goal_position_m)?;
        positive("goal_heading_rad", self.goal_heading_rad)?;
        Ok(())
    }

    /// Whether the frame pushes, pulls or turns an axle too hard. NaN does.
    fn exceeded_by(&self, wrench: &Wrench) -> bool {
        let force = wrench.force_x * wrench.force_x + wrench.force_y * wrench.force_y;
        !(force <= self.force_n * self.force_n
            && wrench.moment_root.abs() <= self.moment_n_m
            && wrench.moment_end.abs() <= self.moment_n_m)
    }

    /// Whether a goal is reached for certain by this estimate. By NaN it is not.
    fn is_certain(&self, robot: &Estimate) -> bool {
        let [position, heading] = robot.half_axes_95();
        position <= self.goal_position_m && heading <= self.goal_heading_rad
    }

    /// Whether an estimate is too uncertain to drive by.
    fn uncertain(&self, robot: &Estimate) -> bool {
        let p = &robot.covariance;
        let position = self.position_sigma_m * self.position_sigma_m;
        let heading = self.heading_sigma_rad * self.heading_sigma_rad;
        !(p[0][0] <= position && p[1][1] <= position && p[2][2] <= heading)
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            report_timeout_s: layout::timeout_s(layout::id::AXLE_POSTURE),
            hold_s: 60.0,
            fusion: robot::Config::default(),
            regulator: regulator::Config::default(),
            course: path_task::Config::default(),
            governor: governor::Config::default(),
            cascade: cascade::Config::default(),
            limits: Limits::default(),
            stop: ramp::Config::default(),
            supervisor: supervisor::Config::default(),
        }
    }
}

impl Config {
    /// The algorithms of the node; the error names the parameter that is wrong.
    pub fn build(&self) -> Result<Algorithms, ConfigError> {
        in_range("report_timeout_s", self.report_timeout_s, 0.02, 1.0)?;
        self.limits.check()?;
        let cascade = self.cascade.build()?;
        Ok(Algorithms {
            limits: self.limits,
            ramp: self.stop.build(self.supervisor.stop_timeout_s)?,
            frame_length: self.cascade.frame_length_m,
            supervisor: self.supervisor.build()?,
            report_timeout: (self.report_timeout_s * 1e6) as Micros,
            longest_hold: (in_range("hold_s", self.hold_s, 0.1, 3600.0)? * 1e6) as Micros,
            fusion: self.fusion.build()?,
            regulator: self.regulator.build()?,
            path_task: self.course.build(&cascade)?,
            governor: self.governor.build(&cascade)?,
            cascade,
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
    /// Motors off, and forget latched faults whose causes are gone.
    Clear,
    /// Bring the midpoint to a posture and to rest.
    Regulate {
        /// The goal.
        goal: Posture,
    },
    /// Follow the path in the node's buffer from its beginning (see [`LeadNode::path_task`]), and
    /// rest at its end.
    Follow,
    /// Track the trajectory in the node's buffer, beginning now, and rest at its end.
    Track,
}

/// Time after which the filter of an axle that was restarted on the move, and takes itself to be at
/// rest, has settled.
const SETTLING: Micros = 100_000;
/// Time that is waited for the beam to find a restarted axle by.
const REJOIN_PATIENCE: Micros = 500_000;
/// Standard deviations of what an axle may have moved beside the other one while its board was
/// being restarted (m, m, rad): the frame may have straightened. Only the beam can tell better.
const RESTART_SIGMAS: [f32; 3] = [0.1, 0.1, 0.3];

/// Speed and yaw rate below which an axle counts as at rest before the robot drives, m/s, rad/s.
const STILL: Twist = Twist::new(0.02, 0.1);
/// Difference from the commanded steering angle beyond which a frame without power has let go, rad.
const LET_GO: f32 = 0.05;

/// The latest report of one axle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct AxleReport {
    /// Latest posture and time since the start, maybe not of one epoch.
    posture: Option<Stamped<Posture>>,
    uptime: Option<Stamped<Micros>>,
    /// Latest posture whose time since the start is known: a posture alone does not tell whether
    /// it is still one of the same odometric frame.
    whole: Option<(Stamped<Posture>, Micros)>,
    uncertainty: Option<Stamped<Mat3>>,
    /// Latest speed and yaw rate.
    twist: Twist,
    /// Share of the axle's ticks in which its gyro took part.
    gyro_share: f32,
    gyro_zeroed: bool,
}

impl AxleReport {
    fn pair(&mut self) {
        if let (Some(posture), Some(uptime)) = (self.posture, self.uptime)
            && posture.time == uptime.time
        {
            self.whole = Some((posture, uptime.value));
        }
    }
}

/// How an axle has moved since the last step of the lead node.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Advance {
    /// Nothing new came, or nothing to compare it with.
    Unknown,
    /// By its odometry.
    Moved(Increment),
    /// Its odometry began anew on the way, which took this many epochs.
    Restarted { ticks: u16 },
}

impl Advance {
    /// The motion; that of an axle that was restarted is the `other`'s, give or take the frame.
    fn increment(&self, other: &Self) -> Option<Increment> {
        match (self, other) {
            (Self::Unknown, _) => None,
            (Self::Moved(increment), _) => Some(*increment),
            (Self::Restarted { ticks }, other) => Some(Increment {
                posture: match other {
                    Self::Moved(increment) => increment.posture,
                    _ => Posture::ORIGIN,
                },
                covariance: diagonal(RESTART_SIGMAS.map(|sigma| sigma * sigma)),
                ticks: *ticks,
                gyro_share: 0.0,
                gyro_zeroed: true,
            }),
        }
    }
}

/// One axle as the lead node knows it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct AxleTrack {
    report: AxleReport,
    /// Odometric posture up to which the fused estimate goes.
    odometry: Option<Stamped<Posture>>,
}

impl AxleTrack {
    /// Time since the axle was started, if that was after the last step. After a silence longer than
    /// the time it can tell, it may have been.
    fn restarted(&self) -> Option<Micros> {
        let (latest, uptime) = self.report.whole?;
        (uptime < latest.time.saturating_sub(self.odometry?.time)).then_some(uptime)
    }

    /// The motion since the last step, however many epochs it spans.
    fn advance(&mut self) -> Advance {
        let Some((latest, uptime)) = self.report.whole else {
            return Advance::Unknown;
        };
        let Some(last) = self.odometry else {
            self.odometry = Some(latest);
            return Advance::Unknown;
        };
        if latest.time <= last.time {
            return Advance::Unknown;
        }
        self.odometry = Some(latest);
        let span = latest.time - last.time;
        let ticks = (span / EPOCH).min(u64::from(u16::MAX)) as u16;
        if uptime < span {
            return Advance::Restarted { ticks };
        }
        // Positions repeat after a span of the bus, so only their wrapped difference counts.
        let moved = Posture::new(
            wrap_position(latest.value.x - last.value.x),
            wrap_position(latest.value.y - last.value.y),
            latest.value.phi,
        );
        // The tier adds slip of its own, so a covariance that never came leaves some.
        let covariance = self.report.uncertainty.map_or([[0.0; 3]; 3], |u| u.value);
        Advance::Moved(Increment {
            posture: moved.relative_to(Posture::new(0.0, 0.0, last.value.phi)),
            covariance: scale(&covariance, f32::from(ticks)),
            ticks,
            gyro_share: self.report.gyro_share,
            gyro_zeroed: self.report.gyro_zeroed,
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
    pub fused: robot::Output,
    /// Commanded motion of the midpoint.
    pub motion: Motion,
    /// Phase of the regulator, when regulating.
    pub phase: Phase,
    /// Where the midpoint should be, on a path or trajectory.
    pub target: Option<Posture>,
    /// The task is fulfilled and the robot at rest.
    pub done: bool,
    /// Where the lead node stands, and why.
    pub supervision: supervisor::Output,
}

/// All that changes in the lead node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    task: Task,
    tracks: [AxleTrack; 2],
    beam_posture: Option<Stamped<Posture>>,
    beam_uncertainty: Option<Stamped<Mat3>>,
    fusion: Option<robot::State>,
    regulator: regulator::State,
    governor: governor::State,
    wrench: Option<Stamped<Wrench>>,
    /// The task is fulfilled, as of the last step.
    done: bool,
    /// Time for which the motors have held the robot where it is.
    held: Micros,
    /// They held it for as long as they may: the next command is waited for.
    released: bool,
    /// The stop under way.
    stop: Option<ramp::State>,
    peers: Peers,
    supervisor: supervisor::State,
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

impl From<path_task::Step> for Decision {
    fn from(step: path_task::Step) -> Self {
        Self {
            wish: step.wish,
            mode: active_until(step.done),
            phase: Phase::default(),
            target: step.target,
            done: step.done,
        }
    }
}

/// The algorithms of a lead node, ready to run: all that does not change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Algorithms {
    report_timeout: Micros,
    longest_hold: Micros,
    fusion: RobotFusion,
    regulator: Regulator,
    path_task: PathTask,
    governor: Governor,
    cascade: Cascade,
    limits: Limits,
    ramp: ramp::Ramp,
    frame_length: f32,
    supervisor: Supervisor,
}

/// The lead node.
#[derive(Clone, Debug, PartialEq)]
pub struct LeadNode {
    with: Algorithms,
    /// Beside the state, which passes over the stack: the buffers are three times as large.
    path_task: path_task::State,
    state: State,
}

impl LeadNode {
    /// A node that does not know yet where the robot stands, and has nothing to do.
    pub fn new(algorithms: Algorithms) -> Self {
        Self {
            with: algorithms,
            path_task: path_task::State::EMPTY,
            state: State::default(),
        }
    }

    /// Begins anew, as [`Self::new`] does.
    pub fn restart(&mut self) {
        self.path_task.clear();
        self.state = State::default();
    }

    /// Begins with the robot at rest, its midpoint at `center` and the front axle at `relative` in
    /// the rear axle's frame.
    pub fn initialize(&mut self, center: &Estimate, relative: &Estimate) {
        self.restart();
        self.state.fusion = Some(self.with.fusion.start_at(center, relative));
    }

    /// The second tier of fusion in its present state.
    pub fn fusion(&self) -> Option<&robot::State> {
        self.state.fusion.as_ref()
    }

    /// Gives the robot something to do; the present motion is taken over.
    pub fn command(&mut self, task: Task) {
        self.state.task = task;
        self.state.done = false;
        self.state.released = false;
        self.path_task.restart();
    }

    /// Where the node stands, and why.
    pub fn supervision(&self) -> &supervisor::State {
        &self.state.supervisor
    }

    /// The buffers of path and trajectory, to be filled before [`Task::Follow`] or [`Task::Track`]
    /// and while it runs.
    pub fn path_task(&mut self) -> &mut path_task::State {
        &mut self.path_task
    }

    /// The cascade, with the frame's geometry.
    pub fn cascade(&self) -> &Cascade {
        &self.with.cascade
    }

    /// Takes in a message that arrived at `now`.
    pub fn receive(&mut self, now: Micros, message: &Message) {
        self.state.peers.receive(now, message);
        match *message {
            Message::BeamWrench { sequence, wrench } => {
                self.state.wrench = Some(Stamped::new(wrench, epoch_start(now, sequence)));
            }
            Message::AxlePosture {
                axle,
                sequence,
                posture,
            } => {
                let report = &mut self.state.tracks[axle.index()].report;
                report.posture = Some(Stamped::new(posture, epoch_start(now, sequence)));
                report.pair();
            }
            Message::AxleMotion {
                axle,
                sequence,
                velocity_m_s,
                yaw_rate_rad_s,
                gyro_samples,
                gyro_zeroed,
                uptime,
                ..
            } => {
                let report = &mut self.state.tracks[axle.index()].report;
                let uptime = Micros::from(uptime) * EPOCH;
                report.uptime = Some(Stamped::new(uptime, epoch_start(now, sequence)));
                report.twist = Twist::new(velocity_m_s, yaw_rate_rad_s);
                report.gyro_share = (f32::from(gyro_samples) / TICKS_PER_EPOCH).min(1.0);
                report.gyro_zeroed = gyro_zeroed;
                report.pair();
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

    /// What is done beside, at the ticks that neither begin an epoch nor have a [`Self::step`]: a part
    /// of what the next step needs that is known already. Left out, that step does all of it, with the
    /// same result.
    pub fn prepare(&mut self) {
        if let Some(fusion) = self.state.fusion.as_mut() {
            self.with.fusion.prepare(fusion);
        }
        let ticks = (EPOCH / TICK) as u32 - 2;
        self.with
            .regulator
            .plan_ahead(&mut self.state.regulator, ticks);
    }

    /// One step at `now`; references go to `outbox`.
    pub fn step(&mut self, now: Micros, outbox: &mut Outbox) -> Output {
        let fused = self.fuse(now);
        let supervision = self.supervise(now, fused.as_ref(), outbox);
        let driving = matches!(supervision.permit, Permit::Hold | Permit::Drive);
        let Some(fused) = fused.filter(|_| driving) else {
            return self.idle(now, fused, supervision, outbox);
        };
        let center = Transform::from(fused.robot.posture);
        let dt = seconds(EPOCH);

        // Before it drives the robot holds still: a frame that swings has to come to rest.
        let decision = match supervision.permit {
            Permit::Hold if !self.state.done => Decision {
                mode: LeadMode::Hold,
                ..Decision::default()
            },
            _ => self.decide(now, &center),
        };
        match decision.wish {
            Some(wish) => self.with.governor.step(&mut self.state.governor, &wish, dt),
            None => self.with.governor.stop(&mut self.state.governor, dt),
        }
        let motion = self.state.governor.motion;
        self.state.done = decision.done;
        let references = self.with.cascade.references(center, &motion);
        self.send_references(now, decision.mode, &references, &fused, outbox);
        Output {
            supervision,
            mode: decision.mode,
            fused,
            motion,
            phase: decision.phase,
            target: decision.target,
            done: decision.done,
        }
    }

    /// What the task asks for with O at `center`.
    fn decide(&mut self, now: Micros, center: &Transform) -> Decision {
        let state = &mut self.state;
        let motion = state.governor.motion;
        let active = Decision {
            mode: LeadMode::Active,
            ..Decision::default()
        };
        match state.task {
            Task::Idle | Task::Clear => Decision::default(),
            Task::Stop => active,
            Task::Regulate { goal } => {
                let output = self.with.regulator.tick(
                    &mut state.regulator,
                    &regulator::Input {
                        posture: center.posture,
                        steering: motion.psi,
                        speed_m_s: motion.v,
                        goal,
                    },
                );
                let command = output.command;
                Decision {
                    wish: Some(Wish::from_curvature(
                        &self.with.cascade,
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
                let step = self
                    .with
                    .path_task
                    .follow(&mut self.path_task, *center, &motion);
                Decision::from(step)
            }
            Task::Track => {
                let epoch = epoch_start(now, sequence(now));
                let step = self
                    .with
                    .path_task
                    .track(&mut self.path_task, epoch, *center, &motion);
                Decision::from(step)
            }
        }
    }

    /// Brings the estimate to the present epoch; `None` while reports are missing.
    fn fuse(&mut self, now: Micros) -> Option<robot::Output> {
        let state = &mut self.state;
        let fusion = state.fusion.as_mut()?;
        for track in &state.tracks {
            if track.report.whole?.0.age(now) > self.with.report_timeout {
                return None;
            }
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
        let restarted = state.tracks.each_ref().map(AxleTrack::restarted);
        let patience = match beam.is_none() && self.with.fusion.uses_beam() {
            true => REJOIN_PATIENCE,
            false => SETTLING,
        };
        if restarted.iter().flatten().any(|uptime| *uptime < patience) {
            return None;
        }
        let [front, rear] = state.tracks.each_mut().map(AxleTrack::advance);
        let known = match restarted {
            [None, Some(_)] => Some(AxleId::Front),
            [Some(_), None] => Some(AxleId::Rear),
            _ => None,
        };
        let lost = restarted != [None; 2];
        let inputs = robot::Inputs {
            front: front.increment(&rear),
            rear: rear.increment(&front),
            // The frame may have bent by more than an update of the estimate can follow.
            beam: beam.filter(|_| !lost),
        };
        let output = self.with.fusion.step(fusion, &inputs);
        match (known, beam) {
            (Some(axle), Some(beam)) if self.with.fusion.uses_beam() => {
                Some(self.with.fusion.rejoin(fusion, axle, &output, &beam))
            }
            _ => Some(output),
        }
    }

    /// Decides whether the robot may drive; the heartbeat goes out with it.
    fn supervise(
        &mut self,
        now: Micros,
        fused: Option<&robot::Output>,
        outbox: &mut Outbox,
    ) -> supervisor::Output {
        let motion = self.state.governor.motion;
        let mut input = supervisor::Input {
            conditions: self.watch(now, fused),
            moved_m: motion.v * seconds(EPOCH),
            halted: self.brake(motion),
            ..supervisor::Input::default()
        };
        let mut output = supervisor::Output::default();
        // From rest to driving in one step: ready, arm and start.
        for _ in 0..3 {
            input.request = self.request(fused);
            output = self
                .with
                .supervisor
                .step(&mut self.state.supervisor, now, &input);
            if self.request(fused).is_none() {
                break;
            }
        }
        self.hold(output.state);
        outbox.push(peers::heartbeat(
            Node::Lead,
            now,
            &mut self.state.supervisor,
        ));
        output
    }

    /// Counts how long the robot is held.
    fn hold(&mut self, operating: OperatingState) {
        let state = &mut self.state;
        match operating {
            OperatingState::Armed => state.held += EPOCH,
            _ => state.held = 0,
        }
        state.released |= state.held > self.with.longest_hold;
    }

    /// What the task asks of the supervisor.
    fn request(&self, fused: Option<&robot::Output>) -> Option<Request> {
        let state = &self.state;
        let resting = state.released || matches!(state.task, Task::Idle | Task::Clear);
        match state.supervisor.operating() {
            OperatingState::Boot => Some(Request::Ready),
            OperatingState::Idle if !resting => Some(Request::Arm),
            OperatingState::Armed | OperatingState::Active if resting => Some(Request::Disarm),
            OperatingState::Armed if !state.done && self.still(fused) => Some(Request::Start),
            OperatingState::Active if state.done => Some(Request::Finish),
            OperatingState::Fault if state.task == Task::Clear => Some(Request::Clear),
            _ => None,
        }
    }

    /// Whether the axles are at rest and the beam agrees with them.
    fn still(&self, fused: Option<&robot::Output>) -> bool {
        let at_rest = |track: &AxleTrack| {
            let Twist { v, omega } = track.report.twist;
            v.abs() <= STILL.v && omega.abs() <= STILL.omega
        };
        self.state.tracks.iter().all(at_rest)
            && fused.is_some_and(|fused| fused.beam.verdict != Verdict::Gated)
    }

    /// What is wrong at this step; `fused` is there if the axles' reports are.
    fn watch(&self, now: Micros, fused: Option<&robot::Output>) -> Conditions {
        let state = &self.state;
        let axles = [Node::FrontAxle, Node::RearAxle];
        let powered = state.supervisor.operating().permit() != Permit::Off;
        let lost = axles.iter().any(|&node| state.peers.lost(node, now));
        let failed = axles.iter().any(|&node| state.peers.failed(node, now));
        let fresh = |time: Micros| now.saturating_sub(time) <= self.with.report_timeout;
        let reports = state.tracks.iter().map(|track| track.report.whole);
        let late = powered
            && reports
                .flatten()
                .any(|(posture, _)| posture.age(now) > LATE);
        let beam = state.beam_posture.filter(|posture| fresh(posture.time));
        let strained = state.wrench.is_some_and(|wrench| {
            fresh(wrench.time) && self.with.limits.exceeded_by(&wrench.value)
        });
        // The beam's measurement counts most; without it, the estimates of the axles.
        let heading = beam
            .map(|posture| RelativeHeading(posture.value.phi))
            .or(fused.map(robot::Output::relative_heading));
        let bent = heading
            .is_some_and(|heading| !(heading.steering().0.abs() <= self.with.limits.steering_rad));
        let unsound = fused.is_some_and(|fused| !fused.robot.posture.is_finite());
        // Without the sensor the operator has chosen to drive by ever less.
        let uncertain = fused.is_some_and(|fused| {
            let vague = self.with.fusion.uses_beam() && self.with.limits.uncertain(&fused.robot);
            // Wheels may slip while a swinging frame is brought to rest, before the drive.
            let refused = fused.beam.verdict == Verdict::Gated;
            vague || (refused && state.supervisor.operating() == OperatingState::Active)
        });
        let certain = |fused: &robot::Output| self.with.limits.is_certain(&fused.robot);
        let doubtful = state.done && fused.is_some_and(|fused| !certain(fused));
        Conditions::NONE
            .with(
                Condition::NeighbourLost,
                lost || (powered && fused.is_none()),
            )
            .with(Condition::NeighbourFault, powered && failed)
            .with(
                Condition::BeamLost,
                self.with.fusion.uses_beam() && beam.is_none(),
            )
            .with(Condition::MessageLost, late)
            .with(Condition::FrameBent, bent)
            .with(Condition::WrenchHigh, strained)
            .with(Condition::NotANumber, unsound)
            .with(Condition::EstimateInconsistent, uncertain)
            .with(Condition::ReachedUncertain, doubtful)
    }

    /// Runs the time of a stop; whether it is over.
    fn brake(&mut self, motion: Motion) -> bool {
        let state = &mut self.state;
        if state.supervisor.operating() != OperatingState::SafeStop {
            state.stop = None;
            return false;
        }
        let (ramp, length) = (&self.with.ramp, self.with.frame_length);
        let stop = state
            .stop
            .get_or_insert_with(|| ramp.begin(Posture::ORIGIN, motion.v, motion.psi, length));
        ramp.step(stop, seconds(EPOCH)).halted
    }

    /// Without power the frame leaves the commanded steering angle: the next drive begins with the
    /// estimated one.
    fn settle(&mut self, fused: &robot::Output) {
        let steering = fused.relative_heading().steering();
        if !((steering.0 - self.state.governor.motion.psi.0).abs() <= LET_GO) {
            self.state.governor = governor::State::at_rest(steering);
        }
    }

    fn idle(
        &mut self,
        now: Micros,
        fused: Option<robot::Output>,
        supervision: supervisor::Output,
        outbox: &mut Outbox,
    ) -> Output {
        let dt = seconds(EPOCH);
        self.with.governor.stop(&mut self.state.governor, dt);
        if let (Permit::Off, Some(fused)) = (supervision.permit, &fused) {
            self.settle(fused);
        }
        let motion = self.state.governor.motion;
        let mode = match self.state.task {
            Task::Clear => LeadMode::Clear,
            _ => LeadMode::Idle,
        };
        outbox.push(Message::LeadStatus {
            sequence: sequence(now),
            mode,
            steering_rad: motion.psi.0,
            velocity_m_s: motion.v,
        });
        Output {
            mode,
            fused: fused.unwrap_or_default(),
            motion,
            supervision,
            ..Output::default()
        }
    }

    fn send_references(
        &self,
        now: Micros,
        mode: LeadMode,
        references: &[AxleReference; 2],
        fused: &robot::Output,
        outbox: &mut Outbox,
    ) {
        let sequence = sequence(now);
        let motion = &self.state.governor.motion;
        outbox.push(Message::LeadStatus {
            sequence,
            mode,
            steering_rad: motion.psi.0,
            velocity_m_s: motion.v,
        });
        let axles = [fused.front.posture, fused.rear.posture];
        for axle in AxleId::BOTH {
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

#[cfg(test)]
mod tests;
