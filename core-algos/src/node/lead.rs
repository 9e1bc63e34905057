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

mod config;
mod send;
mod track;
mod watch;

pub use config::{Algorithms, Config, Limits};
use track::{AxleTrack, SETTLING};

use super::Outbox;
use super::path_task;
use super::peers::{self, Peers};
use crate::bus::{LeadMode, Message};
use crate::control::cascade::{Cascade, Motion};
use crate::control::controller::{KinematicController, Memory, Own};
use crate::control::governor::{self, Wish};
use crate::control::regulator::{self, Phase};
use crate::fusion::Estimate;
use crate::fusion::robot;
use crate::math::matrix::Mat3;
use crate::math::{Posture, Transform, Twist, Wrench};
use crate::safety::supervisor;
use crate::safety::{OperatingState, Permit, ramp};
use crate::time::{EPOCH, Micros, Stamped, TICK, epoch_start, seconds, sequence};
use crate::topology::{AxleId, Node};

/// Age from which a report is late: the bus has had a whole epoch for it.
const LATE: Micros = 2 * EPOCH;

/// Steps of an axle in an epoch.
const TICKS_PER_EPOCH: f32 = (EPOCH / TICK) as f32;

/// Task of the robot.
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
    /// Drive with this speed and curvature. The robot stops if the task is not given again within [`DEAD_MAN`].
    Drive {
        /// Speed of O, m/s.
        speed_m_s: f32,
        /// Curvature of its path, 1/m.
        curvature: f32,
    },
}

/// Activity of the robot, as its button sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activity {
    /// Stopped by a fault that [`Task::Clear`] has to clear.
    Faulted,
    /// Under way with a task.
    Busy,
    /// Without a task, or done with it.
    Resting,
}

/// Time after the latest [`Task::Drive`] at which the robot stops.
pub const DEAD_MAN: Micros = 200_000;
/// Speed below which the robot counts as at rest after a stop, m/s.
const REST_M_S: f32 = 1e-3;

/// Time that is waited for the beam to find a restarted axle by.
const REJOIN_PATIENCE: Micros = 500_000;
/// Standard deviations of what an axle may have moved beside the other one while its board was
/// being restarted (m, m, rad): the frame may have straightened. Only the beam can tell better.
const RESTART_SIGMAS: [f32; 3] = [0.1, 0.1, 0.3];

/// Speed and yaw rate below which an axle counts as at rest before the robot drives, m/s, rad/s.
const STILL: Twist = Twist::new(0.02, 0.1);
/// Difference from the commanded steering angle beyond which a frame without power has let go, rad.
const LET_GO: f32 = 0.05;

/// Output of the lead node at a step.
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
    /// Target posture of the midpoint, on a path or trajectory.
    pub target: Option<Posture>,
    /// The task is fulfilled and the robot at rest.
    pub done: bool,
    /// Operating state of the lead node, and its reason.
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
    /// Memory of the controller of the user.
    memory: Memory,
    governor: governor::State,
    wrench: Option<Stamped<Wrench>>,
    /// The task is fulfilled, as of the last step.
    done: bool,
    /// The regulator gave up, as of the last step.
    gave_up: bool,
    /// Time since the latest command.
    silent: Micros,
    /// The host that gave the task was lost: the robot stops.
    lost: bool,
    /// Goal of the latest regulation.
    goal: Option<Posture>,
    /// Time for which the motors have held the robot where it is.
    held: Micros,
    /// They held it for as long as they may: the next command is waited for.
    released: bool,
    /// The stop under way.
    stop: Option<ramp::State>,
    peers: Peers,
    supervisor: supervisor::State,
}

impl State {
    /// True if the host that drives the robot is silent.
    fn is_silent(&self) -> bool {
        self.lost || matches!(self.task, Task::Drive { .. }) && self.silent >= DEAD_MAN
    }
}

/// Decision of the task at a step.
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

/// The lead node.
#[derive(Clone, Debug, PartialEq)]
pub struct LeadNode {
    with: Algorithms,
    own: Own,
    /// Beside the state, which passes over the stack: the buffers are three times as large.
    path_task: path_task::State,
    state: State,
}

impl LeadNode {
    /// A node that does not know yet where the robot stands, and has nothing to do.
    pub fn new(algorithms: Algorithms) -> Self {
        Self {
            with: algorithms,
            own: Own::default(),
            path_task: path_task::State::EMPTY,
            state: State::default(),
        }
    }

    /// Regulates with a controller of the user in place of the regulator.
    pub fn set_controller(&mut self, controller: &'static dyn KinematicController) {
        self.own = Own(Some(controller));
    }

    /// Begins anew, as [`Self::new`] does, with the same controller.
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
        if let Task::Regulate { goal } = task {
            self.state.goal = Some(goal);
        }
        (self.state.done, self.state.gave_up) = (false, false);
        (self.state.silent, self.state.lost) = (0, false);
        self.state.memory = Memory::default();
        // A path goes on after its faults were cleared.
        if !matches!(task, Task::Follow | Task::Track | Task::Clear) {
            self.path_task.forget();
        }
        self.state.released = false;
        self.path_task.restart();
    }

    /// True if a controller of the user takes the place of the regulator.
    pub fn has_own_controller(&self) -> bool {
        self.own.0.is_some()
    }

    /// Operating state of the node, and its reason.
    pub fn supervision(&self) -> &supervisor::State {
        &self.state.supervisor
    }

    /// Activity of the robot.
    pub fn activity(&self, now: Micros) -> Activity {
        let failed = |node| self.state.peers.failed(node, now);
        let faulted = self.state.supervisor.operating() == OperatingState::Fault
            || [Node::FrontAxle, Node::RearAxle].into_iter().any(failed);
        let idle = matches!(self.state.task, Task::Idle | Task::Stop | Task::Clear);
        match idle || self.state.done || self.state.released {
            _ if faulted => Activity::Faulted,
            true => Activity::Resting,
            false => Activity::Busy,
        }
    }

    /// Goal of the latest regulation since the robot was told where it stands.
    pub fn latest_goal(&self) -> Option<Posture> {
        self.state.goal
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

    /// Works ahead, at the ticks that neither begin an epoch nor have a [`Self::step`], on parts of
    /// the next step that are known already. Without it the next step does all of the work, with
    /// the same result.
    pub fn prepare(&mut self) {
        let fusion = self.state.fusion.as_mut();
        if fusion.is_some_and(|fusion| self.with.fusion.prepare(fusion)) {
            return;
        }
        // One of these ticks may have gone to the fusion.
        let ticks = (EPOCH / TICK) as u32 - 3;
        self.with
            .regulator
            .plan_ahead(&mut self.state.regulator, ticks);
    }

    /// One step at `now`; references go to `outbox`.
    pub fn step(&mut self, now: Micros, outbox: &mut Outbox) -> Output {
        self.state.silent = self.state.silent.saturating_add(EPOCH);
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
        self.state.gave_up = decision.phase == Phase::GaveUp;
        let references = self.with.cascade.references(center, &motion);
        self.send_references(now, decision.mode, &references, &fused, outbox);
        Output {
            supervision,
            mode: decision.mode,
            fused,
            motion,
            phase: decision.phase,
            target: decision.target,
            done: decision.done && !self.state.lost,
        }
    }

    /// Decision of the task with O at `center`.
    fn decide(&mut self, now: Micros, center: &Transform) -> Decision {
        let state = &mut self.state;
        let motion = state.governor.motion;
        let active = Decision {
            mode: LeadMode::Active,
            ..Decision::default()
        };
        match state.task {
            Task::Idle | Task::Clear => Decision::default(),
            Task::Stop => {
                let done = motion.v.abs() < REST_M_S;
                Decision {
                    mode: active_until(done),
                    done,
                    ..active
                }
            }
            Task::Regulate { goal } => {
                let input = regulator::Input {
                    posture: center.posture,
                    steering: motion.psi,
                    speed_m_s: motion.v,
                    goal,
                };
                let (v, kappa, phase, done) = match self.own.0 {
                    None => {
                        let output = self.with.regulator.tick(&mut state.regulator, &input);
                        let command = output.command;
                        (command.v, command.kappa, output.phase, output.done)
                    }
                    Some(controller) => {
                        let wanted = controller.step(&mut state.memory, &input);
                        let phase = [Phase::Approach, Phase::Done][usize::from(wanted.done)];
                        (wanted.v, wanted.kappa, phase, wanted.done)
                    }
                };
                Decision {
                    wish: Some(Wish::from_curvature(&self.with.cascade, v, kappa)),
                    mode: active_until(done),
                    phase,
                    done,
                    ..active
                }
            }
            Task::Drive {
                speed_m_s,
                curvature,
            } => {
                let alive = !state.is_silent();
                let done = !alive && motion.v.abs() < REST_M_S;
                let wish = || Wish::from_curvature(&self.with.cascade, speed_m_s, curvature);
                Decision {
                    wish: alive.then(wish),
                    mode: active_until(done),
                    done,
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
}

#[cfg(test)]
mod tests;
