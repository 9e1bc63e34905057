//! Lead node: estimates in, references out, once an epoch.
//!
//! The step reads in the order of the data: reports → fusion of each pair of neighbouring axles → task → governor →
//! cascade → references. It works at [`LEAD_PHASE`](crate::time::LEAD_PHASE) after the beginning of an epoch on the
//! reports of that epoch. Its references are valid at the beginning of the epoch; the axles extrapolate them to their
//! own time.
//!
//! Reference postures follow at each step from the estimated midpoint and the commanded steering; they are not
//! integrated. So the axles' controllers keep the shape of the robot, and the kinematic controller alone closes the
//! loop over its path.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; nothing else can fail. If reports are older than the timeout, or another condition
//! stops the robot, the mode is [`LeadMode::Idle`]: the axles brake together and switch their motors off.

mod config;
mod frames;
mod fuse;
mod fused;
mod own;
mod pair;
mod path_memory;
mod send;
mod task;
mod track;
mod watch;

pub use config::{
    Algorithms, Config, FUSION_OF_CHAIN, Limits, begin_phase, fusion_fits, order_phase, step_phase,
};
use fuse::Fusing;
use fused::Fused;
pub use fused::MAX_INNER;
pub use own::Own;
use pair::Pair;
pub use task::{Activity, Placement, Task};
use track::AxleTrack;

use core::ops::RangeInclusive;

use super::Outbox;
use super::path_task;
use super::peers::{self, Peers};
use crate::bus::LeadMode;
use crate::control::cascade::{Cascade, Motion};
use crate::control::governor::{self, GovernorInput};
use crate::control::regulator::{self, Phase};
use crate::control::train;
use crate::fusion::robot;
use crate::math::{Posture, Transform, Twist};
use crate::safety::supervisor;
use crate::safety::{Condition, OperatingState, Permit, ramp};
use crate::time::{EPOCH, Micros, epoch_start, seconds, sequence};
use crate::topology::{MAX_AXLES, MAX_FRAMES, Node, Topology};

/// Age above which a report is late: the bus has had a whole epoch for it.
const LATE: Micros = 2 * EPOCH;

/// Time without a used measurement after which the beam counts as lost.
const BEAM_PATIENCE: Micros = 10 * EPOCH;

/// Longest time after a [`Task::Drive`] before the robot stops, µs.
pub const DEAD_MAN: Micros = 200_000;
/// Magnitude of the governor's reference speed below which the robot counts as at rest, m/s.
const REST_M_S: f32 = 4e-3;

/// Motion of a restarted axle relative to the other axle during the restart (m, m, rad), standard deviation: the
/// frame may have straightened. Only the beam can measure this motion.
const RESTART_SIGMAS: [f32; 3] = [0.1, 0.1, 0.3];

/// Time allowed for the axles to arm after the lead node: two transfers on a bus that is 30 ms late, and a few lost
/// frames.
const ARMING: Micros = 300_000;

/// Speed and yaw rate below which an axle counts as at rest before the robot drives, m/s, rad/s.
const STILL: Twist = Twist::new(0.02, 0.1);
/// Difference from the commanded steering angle beyond which an unpowered frame has relaxed, rad.
const RELAXED_RAD: f32 = 0.05;

/// Epochs between the conditionings of two pairs' covariances: each takes a tick.
const CONDITION_SPACING: u8 = 8;

/// Running mean of the beam's normalised innovation squared (NIS): weight of the latest value, largest value that
/// counts, and mean above which the beam is inconsistent. The mean is 0.1 to 0.5, since the beam's covariance is that
/// of its worst posture; with the true covariance it would be 3.
const NIS_SHARE: f32 = 1.0 / 256.0;
const NIS_MOST: f32 = 40.0;
const NIS_LIMIT: f32 = 3.0;

/// Output of the lead node at a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Output {
    /// Mode sent to the axles.
    pub mode: LeadMode,
    /// Estimated postures of the axles and the midpoint in the frame `map`, and the beam's update.
    pub fused: robot::Output,
    /// Commanded motion of the midpoint.
    pub motion: Motion,
    /// Phase of the regulator, when regulating.
    pub phase: Phase,
    /// Target posture of the midpoint, on a path or trajectory.
    pub target: Option<Posture>,
    /// True if the task is fulfilled and the robot at rest.
    pub done: bool,
    /// Reason for which the task ended without success: gave up, no progress, or an output of the user's controller
    /// that is not finite.
    pub failed: Option<Condition>,
    /// Operating state of the lead node, and its reason.
    pub supervision: supervisor::Output,
    /// Estimated postures of the axles between the first and the last in the frame `map`, front first.
    pub inner: [Option<Posture>; MAX_INNER],
}

/// What the lead node keeps from one step to the next, except its large parts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    task: Task,
    /// Posture of O in the frame `odom`.
    odom: Option<Posture>,
    /// Posture of O in the frame `map` at the latest estimate.
    map: Option<Posture>,
    regulator: regulator::State,
    /// True if the user's controller has begun the task.
    begun: bool,
    /// True if the latest estimates of the user's estimator are not sound.
    unsound: bool,
    governor: governor::State,
    /// True if the task was fulfilled at the latest step.
    done: bool,
    /// Reason for which the task ended without success; stays until the next task.
    failed: Option<Condition>,
    /// Time since the latest command.
    silent: Micros,
    /// True if the host that gave the task was lost; the robot then stops.
    lost: bool,
    /// Goal of the latest regulation.
    goal: Option<Posture>,
    /// Goal of the regulation, or target on the path at the latest step; `None` for other tasks.
    aim: Option<Posture>,
    /// Time for which the motors have held the robot in place.
    held: Micros,
    /// Time for which the lead node has been armed or active, without a break.
    armed: Micros,
    /// True if the motors have held the robot for the longest allowed time; they stay off until the next command.
    released: bool,
    /// Ramp of the current stop.
    stop: Option<ramp::State>,
    peers: Peers,
    supervisor: supervisor::State,
}

impl State {
    /// True if the commanding host is lost or silent.
    fn is_silent(&self) -> bool {
        self.lost || matches!(self.task, Task::Drive { .. }) && self.silent >= DEAD_MAN
    }

    /// True if the task has ended.
    fn is_over(&self) -> bool {
        self.done || self.failed.is_some()
    }
}

/// Motion and mode that the task demands at a step.
#[derive(Clone, Copy, Debug, Default)]
struct Decision {
    /// Input of the governor; `None` brakes.
    governor_input: Option<GovernorInput>,
    mode: LeadMode,
    phase: Phase,
    target: Option<Posture>,
    done: bool,
    failed: Option<Condition>,
}

/// Mode of a task: the robot holds its posture once done.
fn active_until(done: bool) -> LeadMode {
    if done {
        LeadMode::Hold
    } else {
        LeadMode::Active
    }
}

impl From<path_task::PathStep> for Decision {
    fn from(step: path_task::PathStep) -> Self {
        Self {
            governor_input: step.governor_input,
            mode: active_until(step.done),
            phase: Phase::default(),
            target: step.target,
            done: step.done,
            failed: step.stuck.then_some(Condition::NoProgress),
        }
    }
}

/// Lead node: fuses axles and beam, runs the task and sends the axles their references.
#[derive(Clone, Debug, PartialEq)]
pub struct LeadNode {
    with: Algorithms,
    /// Placement that the user's estimator has not received.
    placement: Option<Placement>,
    // The next five are outside of `state`, which passes over the stack: each is larger than `state`.
    /// Buffers of path and trajectory.
    path_task: path_task::State,
    /// Curve on which three or more axles drive.
    train: train::State,
    /// Reports and odometry of the axles, front first.
    tracks: heapless::Vec<AxleTrack, MAX_AXLES>,
    /// Pairs of neighbouring axles, front first.
    pairs: heapless::Vec<Pair, MAX_FRAMES>,
    /// Reports and estimates of the epoch whose pairs are being fused.
    fusing: Fusing,
    state: State,
}

impl LeadNode {
    /// A node without estimate and without task.
    pub fn new(algorithms: Algorithms) -> Self {
        let mut node = Self::empty(algorithms);
        node.restart();
        node
    }

    /// [`Self::new`] in `place`. The lists of axles and pairs are filled there, since the stack of a board has no room
    /// for the node.
    pub(super) fn new_in(place: &mut Option<Self>, algorithms: Algorithms) {
        place.insert(Self::empty(algorithms)).restart();
    }

    /// A node without axles.
    fn empty(algorithms: Algorithms) -> Self {
        Self {
            with: algorithms,
            placement: None,
            path_task: path_task::State::EMPTY,
            train: train::State::NEW,
            tracks: heapless::Vec::new(),
            pairs: heapless::Vec::new(),
            fusing: Fusing::default(),
            state: State::default(),
        }
    }

    /// Resets the node to the state of [`Self::new`].
    pub fn restart(&mut self) {
        self.placement = None;
        self.path_task.clear();
        self.train.forget_curve();
        self.tracks.clear();
        self.pairs.clear();
        for _ in self.with.topology.axles() {
            let _ = self.tracks.push(AxleTrack::EMPTY);
        }
        for _ in self.with.topology.frames() {
            let _ = self.pairs.push(Pair::EMPTY);
        }
        self.fusing = Fusing::default();
        self.state = State::default();
    }

    /// Restarts with the robot at rest at `placement`.
    pub fn initialize(&mut self, placement: &Placement) {
        self.restart();
        let (relative, floor_drift) = (&placement.relative, placement.floor_drift);
        let frames = self.frame_count();
        for (k, pair) in self.pairs.iter_mut().enumerate() {
            // The chain is straight, and O is in its middle.
            let center = match frames {
                1 => placement.center,
                _ => {
                    let ahead = 0.5 * (frames - 1) as f32 - k as f32;
                    placement.center.ahead(ahead * relative.posture.x)
                }
            };
            let mut fusion = self.with.fusion.start(&center, relative, floor_drift);
            fusion.condition_earlier(CONDITION_SPACING * k as u8);
            pair.fusion = Some(fusion);
        }
        self.placement = Some(*placement);
    }

    /// Phases in an epoch, µs: from the first fusion of a pair ([`Self::fuse_ahead`]) to the step.
    pub fn phases(&self) -> RangeInclusive<Micros> {
        self.with.begin_phase..=self.with.step_phase
    }

    /// Topology of the robot.
    pub fn topology(&self) -> Topology {
        self.with.topology()
    }

    /// State of the fusion of the first two axles and their beam; `None` before the start.
    pub fn fusion(&self) -> Option<&robot::State> {
        self.pairs.first()?.fusion.as_ref()
    }

    /// Sets the task, which begins from the current motion.
    pub fn command(&mut self, task: Task) {
        let again = matches!(
            (self.state.task, task),
            (Task::Regulate { .. }, Task::Regulate { .. })
        );
        if !again || self.state.failed.is_some() {
            self.train.restart_task();
        }
        self.state.task = task;
        if let Task::Regulate { goal, .. } = task {
            self.state.goal = Some(goal);
        }
        if self.state.failed.is_some() {
            self.state.regulator.forget_goal();
        }
        (self.state.done, self.state.failed) = (false, None);
        (self.state.silent, self.state.lost) = (0, false);
        self.state.begun = false;
        // A path continues after faults are cleared.
        if !(task.is_on_path() || task == Task::Clear) {
            self.path_task.forget();
        }
        self.state.released = false;
        self.path_task.restart();
    }

    /// Operating state of the node, and its reason.
    pub fn supervision(&self) -> &supervisor::State {
        &self.state.supervisor
    }

    /// Activity of the robot, on which the action of its button depends.
    pub fn activity(&self, now: Micros) -> Activity {
        let (_, failed) = self.state.peers.others(Node::Lead, self.with.topology, now);
        let faulted = failed || self.state.supervisor.operating() == OperatingState::Fault;
        let idle = matches!(self.state.task, Task::Idle | Task::Stop | Task::Clear);
        match idle || self.state.is_over() || self.state.released {
            _ if faulted => Activity::Faulted,
            true => Activity::Resting,
            false => Activity::Busy,
        }
    }

    /// Goal of the latest regulation since the node was initialised.
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

    /// Computes ahead those parts of the next step that are known already. To be called at the ticks that neither
    /// begin an epoch nor run [`Self::step`]. Without this call the next step does all of the work, with the same
    /// result.
    pub fn prepare(&mut self) {
        for pair in &mut self.pairs {
            let fusion = pair.fusion.as_mut();
            if fusion.is_some_and(|fusion| self.with.fusion.prepare(fusion)) {
                return;
            }
        }
        let ticks = self.with.planning_ticks;
        match &self.with.train {
            Some(train) => train.plan_ahead(&mut self.train, ticks),
            None => {
                let state = &mut self.state.regulator;
                self.with.regulator.plan_ahead(state, ticks);
            }
        }
    }

    /// Runs one step at `now`; references go to `outbox`.
    pub fn step(&mut self, now: Micros, outbox: &mut Outbox) -> Output {
        self.step_with(now, outbox, &mut Own::default())
    }

    /// [`Self::step`] with parts of the user. Every step takes the same parts.
    // Not inlined: every tick of the board would have the stack of this step.
    #[inline(never)]
    pub fn step_with(&mut self, now: Micros, outbox: &mut Outbox, own: &mut Own<'_>) -> Output {
        self.begin(own);
        self.state.silent = self.state.silent.saturating_add(EPOCH);
        let fused = self.fuse(now, own);
        if let Some(fused) = &fused {
            // A robot that stops on its path keeps `odom`.
            let waits = self.state.task.is_on_path() && !self.state.is_over();
            let moving = waits || self.state.governor.motion.v.abs() > REST_M_S;
            let map = fused.robot().posture;
            let still = (map.phi, Posture::ORIGIN);
            let moved = self.moved(map).unwrap_or(still);
            self.state.odom = Some(frames::step(self.state.odom, moved, map, moving));
            self.state.map = Some(map);
        }
        let supervision = self.supervise(now, fused.as_ref(), outbox);
        let driving = matches!(supervision.permit, Permit::Hold | Permit::Drive);
        let Some(fused) = fused.as_ref().filter(|_| driving) else {
            return self.idle(now, fused.as_ref(), supervision, outbox);
        };
        if let Some(train) = self.with.train {
            return self.step_train(now, &train, fused, supervision, outbox);
        }
        let center = Transform::from(fused.robot().posture);
        let driven = self.state.odom.unwrap_or(center.posture);

        // Before it drives the robot holds still, so that a swinging frame comes to rest.
        let decision = match supervision.permit {
            Permit::Hold if !self.state.is_over() => Decision {
                mode: LeadMode::Hold,
                ..Decision::default()
            },
            _ if self.state.failed.is_some() => self.give_up(),
            _ => {
                let decision = self.decide(now, &Transform::from(driven), own);
                self.at_end(decision, fused.robot().posture)
            }
        };
        match decision.governor_input {
            Some(governor_input) => self
                .with
                .governor
                .step(&mut self.state.governor, &governor_input),
            None => self.with.governor.stop(&mut self.state.governor),
        }
        let motion = self.state.governor.motion;
        let references = self.with.cascade.references(center, &motion);
        self.send_references(now, decision.mode, &references, fused, outbox);
        self.conclude(&decision, fused, supervision)
    }

    /// Output of a step that drives.
    fn conclude(
        &mut self,
        decision: &Decision,
        fused: &Fused,
        supervision: supervisor::Output,
    ) -> Output {
        let state = &mut self.state;
        (state.done, state.failed) = (decision.done, decision.failed);
        state.aim = match state.task {
            Task::Regulate { goal, .. } => Some(goal),
            _ => decision.target,
        };
        Output {
            supervision,
            mode: decision.mode,
            fused: fused.estimates,
            motion: state.governor.motion,
            phase: decision.phase,
            target: decision.target,
            done: decision.done && !state.lost,
            failed: decision.failed,
            inner: fused.inner,
        }
    }

    /// Decision of a task that ended without success: brake, then keep the posture.
    fn give_up(&self) -> Decision {
        let at_rest = self.state.governor.motion.v.abs() < REST_M_S;
        let on_path = self.state.task.is_on_path();
        Decision {
            mode: active_until(at_rest),
            phase: if on_path {
                Phase::default()
            } else {
                Phase::GaveUp
            },
            target: self.state.aim.filter(|_| on_path),
            failed: self.state.failed,
            ..Decision::default()
        }
    }

    /// Checks the end of a path by the estimate `map` of O: outside the tolerance the task gives up. Along a path the
    /// robot drives by `odom`, which may differ from the estimate.
    fn at_end(&self, decision: Decision, map: Posture) -> Decision {
        let first = decision.done && !self.state.done && self.state.task.is_on_path();
        let missed = |end| !self.state.task.within().is_near(map, end);
        match first && decision.target.is_none_or(missed) {
            true => Decision {
                mode: active_until(false),
                done: false,
                failed: Some(Condition::GaveUp),
                ..decision
            },
            false => decision,
        }
    }

    /// Motion and mode that the task demands with O at `center`.
    fn decide(&mut self, now: Micros, center: &Transform, own: &mut Own<'_>) -> Decision {
        let state = &mut self.state;
        let motion = state.governor.motion;
        match state.task {
            Task::Idle | Task::Clear => Decision::default(),
            Task::Stop => {
                let done = motion.v.abs() < REST_M_S;
                Decision {
                    mode: active_until(done),
                    done,
                    ..Decision::default()
                }
            }
            Task::Regulate { goal, within } => {
                let input = regulator::Input {
                    posture: center.posture,
                    steering: motion.psi,
                    speed_m_s: motion.v,
                    goal,
                    within,
                };
                if let Some(controller) = own.controller.as_deref_mut() {
                    let output = controller.step(&input);
                    return own::decision(&self.with.cascade, &output, &motion);
                }
                let output = self.with.regulator.tick(&mut state.regulator, &input);
                let regulator::Output {
                    command,
                    phase,
                    done,
                    ..
                } = output;
                let reason = match state.regulator.is_blocked() {
                    true => Condition::NoProgress,
                    false => Condition::GaveUp,
                };
                Decision {
                    governor_input: Some(GovernorInput::from_curvature(
                        &self.with.cascade,
                        command.v,
                        command.kappa,
                    )),
                    mode: active_until(done),
                    phase,
                    done,
                    failed: (phase == Phase::GaveUp).then_some(reason),
                    ..Decision::default()
                }
            }
            Task::Drive {
                speed_m_s,
                curvature,
            } => {
                let alive = !state.is_silent();
                let done = !alive && motion.v.abs() < REST_M_S;
                let governor_input =
                    || GovernorInput::from_curvature(&self.with.cascade, speed_m_s, curvature);
                Decision {
                    governor_input: alive.then(governor_input),
                    mode: active_until(done),
                    done,
                    ..Decision::default()
                }
            }
            Task::Follow { within } => {
                let step =
                    self.with
                        .path_task
                        .follow(&mut self.path_task, *center, &within, &motion);
                Decision::from(step)
            }
            Task::Track { within } => {
                let epoch = epoch_start(now, sequence(now));
                let path = &mut self.path_task;
                let course = &self.with.path_task;
                let step = course.track(path, epoch, *center, &within, &motion);
                Decision::from(step)
            }
        }
    }

    /// Permit of the motors at this step; sends the heartbeat.
    fn supervise(
        &mut self,
        now: Micros,
        fused: Option<&Fused>,
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
        // Up to three requests in one step, so that a robot at rest drives at once: ready, arm, start.
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

    /// Counts the time for which the robot has been held, and the time for which it has been armed or active.
    fn hold(&mut self, operating: OperatingState) {
        let state = &mut self.state;
        match operating {
            OperatingState::Armed => state.held += EPOCH,
            _ => state.held = 0,
        }
        match operating {
            OperatingState::Armed | OperatingState::Active => state.armed += EPOCH,
            _ => state.armed = 0,
        }
        state.released |= state.held > self.with.longest_hold;
    }

    /// Advances the ramp of a stop; true if the stop is over.
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
