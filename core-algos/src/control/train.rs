//! Control of three to five axles by path memory: every axle drives on the same curve, at its own place along it.
//!
//! # Theory
//!
//! The [`curve`] reaches from behind the last axle to a little ahead of the leading one. The *leader* is the first axle
//! forward, the last axle in reverse. A virtual [`leader`] extends the curve along the desired path, with feedback; in
//! the ideal case the curve is the path. The other axles follow at the distances at which no frame carries an axial
//! force ([`spacing`]). So no axle leaves the trace of the leader, for any number of axles, and a frame carries the
//! force EI κ′ of the curve only.
//!
//! References follow from the places: with the leader at s and its speed v, axle i at s_i(s) drives at v ds_i/ds, turns
//! at κ v_i, and accelerates by the rates of both. At a cusp the places stay and the other end becomes the leader.
//!
//! # Tasks
//!
//! | task | desired path of the leader | speed |
//! |---|---|---|
//! | stop | the last curvature | brakes |
//! | regulate | the plan ([`planner`]), which moves with the goal | configured; stops at cusp and goal |
//! | follow | the path, then straight on for half a body | configured; stops when the middle is at the end |
//! | track | as follow | that of the trajectory at the first axle, plus a correction of the distance |
//! | drive | the commanded curvature | commanded; a change of direction stops first |
//!
//! # Start
//!
//! A state without a curve builds it through the estimated axles (module `rebuild`), a frame an epoch, while the robot stands; what is left between an axle and its place fades with the distance driven.
//!
//! # Behaviour at limits
//!
//! | condition | result |
//! |---|---|
//! | an estimate is not finite | brakes along the curve; standstill without a curve |
//! | neighbouring axles are estimated too close or too far for their frame, without a curve | standstill |
//! | the axles lag behind their references | slows down, and waits at [`Config::wait_m`] |
//! | the robot does not move | stuck; a regulation gives up at the second time in the same place |
//! | the curve is too far from its path, or an axle from its reference | lost, brakes |
//! | the path has no more points, and is not complete | stops at its last point and waits |
//!
//! # Panic contract
//!
//! [`Config::build`] validates; nothing else can fail. Memory: 3.6 KB for the curve, 1.3 KB for the rest. Cost of an
//! epoch: about 15 000 floating-point operations for five axles, and the planner's budget.

mod config;
pub mod curve;
mod guide;
pub mod leader;
pub mod planner;
mod rebuild;
mod regulation;
pub mod spacing;
pub mod speed;
pub mod turn;

pub use config::Config;
pub use guide::Route;

pub use super::kinematic::Direction;

use super::cascade::AxleReference;
use super::path::{PathBuffer, TrajectoryBuffer};
use super::regulator::{Phase, Tolerance};
use super::stuck::{STUCK_S, Stuck};
use crate::math::trig::{atan2, clamp, sqrt};
use crate::math::{Posture, Twist};
use crate::math::{greater, lesser};
use crate::time::EPOCH_S;
use crate::topology::MAX_AXLES;
use curve::Curve;
use leader::{Desired, Leader};
use planner::Planner;
use rebuild::{Measures, Rebuild};
use regulation::Regulation;
use spacing::{Link, Neighbour};
use speed::{Limits, Motion};

/// Knots that the curve reaches beyond the leader.
const AHEAD: f32 = 3.0;
/// Largest number of knots appended in an epoch.
const MOST_KNOTS: usize = 8;
/// Speed above which the robot must move, m/s.
const MOVING_M_S: f32 = 5e-3;
/// Largest distance of neighbouring axles over that on a straight, at which a curve is built.
const LONGEST: f32 = 1.1;
/// Time without motion after which a robot within the tolerance of the end rests, s.
const REST_S: f32 = 1.0;

/// Task of an epoch. `P` and `T` are the sizes of the buffers of path and trajectory.
#[derive(Debug)]
pub enum Task<'a, const P: usize, const T: usize> {
    /// Brake along the curve.
    Stop,
    /// Bring O to a goal posture and to rest.
    Regulate {
        /// Goal posture of O, in the coordinates of the estimates.
        goal: Posture,
        /// Tolerance of the goal.
        within: Tolerance,
    },
    /// Follow a path and rest with the middle of the body at its end. Points behind the leader are dropped.
    Follow {
        /// The path.
        path: &'a mut PathBuffer<P>,
        /// Tolerance of the end.
        within: Tolerance,
    },
    /// Track a trajectory.
    Track {
        /// The trajectory.
        trajectory: &'a mut TrajectoryBuffer<T>,
        /// Time on the trajectory, s.
        time_s: f32,
        /// Tolerance of the end.
        within: Tolerance,
    },
    /// Drive with a speed and a curvature of the leading axle.
    Drive {
        /// Speed, m/s; negative in reverse.
        speed_m_s: f32,
        /// Curvature, 1/m, positive to the left of an axle that faces forward.
        curvature: f32,
    },
}

/// Motion that a task demands.
#[derive(Clone, Copy, Debug)]
struct Demand {
    direction: Direction,
    /// Speed, m/s, not negative.
    speed: f32,
    /// Distance of the leader to a stop, m.
    distance: f32,
}

impl Demand {
    const fn stop(direction: Direction) -> Self {
        Self {
            direction,
            speed: 0.0,
            distance: f32::INFINITY,
        }
    }
}

/// Distances of the axles from the references of the last epoch.
///
/// A frame keeps the distance of its axles: wheels that correct it only push against each other, and slide. So each
/// axle corrects the mean.
#[derive(Clone, Copy, Debug, Default)]
struct Lags {
    /// Distance of each axle behind its reference, along the axle, m; unused entries are zero.
    own: [f32; MAX_AXLES],
    /// Mean of these, m.
    mean: f32,
    /// Distance of the axle that is farthest from its reference, m.
    farthest: f32,
}

/// Result of an epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// References of the axles, front first; unused entries are zero.
    pub references: [AxleReference; MAX_AXLES],
    /// Velocity of the leader, m/s, negative in reverse.
    pub v: f32,
    /// Rate of this velocity, m/s².
    pub v_rate: f32,
    /// Curvature of the curve at the leader, 1/m.
    pub kappa: f32,
    /// End that leads.
    pub direction: Direction,
    /// Phase of a regulation; [`Phase::Stop`] for other tasks.
    pub phase: Phase,
    /// Posture of O that the references mean.
    pub target: Posture,
    /// Distance of the curve's end from the desired path, m.
    pub off_path_m: f32,
    /// True if the task is complete and the robot at rest.
    pub done: bool,
    /// True if a regulation gave up.
    pub gave_up: bool,
    /// True if the robot should move and did not.
    pub stuck: bool,
    /// True if the robot is too far from its path or an axle from its reference.
    pub lost: bool,
}

/// State of the train between two epochs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    curve: Curve,
    /// Places of the axles on the curve, m, front first.
    places: [f32; MAX_AXLES],
    /// Speeds of the axles over that of the leader.
    ratios: [f32; MAX_AXLES],
    direction: Direction,
    motion: Motion,
    /// Deviations of the axles from a new curve, in the coordinates of the curve at their places.
    offsets: [Posture; MAX_AXLES],
    /// Distance driven on the curve since it was built, m.
    driven: f32,
    regulation: Regulation,
    /// Arc length of the route at the end of the curve, m; `None` before the route is entered.
    on_route: Option<f32>,
    stuck: Stuck,
    resting: bool,
    lost: bool,
    /// Work on the curve, until it passes all axles.
    rebuild: Option<Rebuild>,
}

impl Default for State {
    fn default() -> Self {
        Self::NEW
    }
}

impl State {
    /// No curve, no task.
    pub const NEW: Self = Self {
        curve: Curve::EMPTY,
        places: [0.0; MAX_AXLES],
        ratios: [1.0; MAX_AXLES],
        direction: Direction::Forward,
        motion: Motion { v: 0.0, rate: 0.0 },
        offsets: [Posture::ORIGIN; MAX_AXLES],
        driven: 0.0,
        regulation: Regulation::NEW,
        on_route: None,
        stuck: Stuck::NEW,
        resting: false,
        lost: false,
        rebuild: None,
    };

    /// Discards the curve: the next step builds it through the axles, at rest. To be called while the motors are off.
    pub fn forget_curve(&mut self) {
        // Each step builds the curve first; so without a curve the state is new already.
        if !self.curve.is_empty() {
            *self = Self::NEW;
        }
    }

    /// Begins a new task of the same kind or another; the motion continues.
    pub fn restart_task(&mut self) {
        self.regulation = Regulation::NEW;
        self.on_route = None;
        self.stuck.reset();
        (self.resting, self.lost) = (false, false);
    }

    /// Phase of the regulation.
    pub fn phase(&self) -> Phase {
        self.regulation.phase
    }

    /// True if the regulation gave up because the robot was commanded to move and did not.
    pub fn is_blocked(&self) -> bool {
        self.regulation.blocked
    }

    /// The curve on which the axles drive.
    pub fn curve(&self) -> &Curve {
        &self.curve
    }

    /// Places of the axles on the curve, m, front first.
    pub fn places(&self) -> &[f32; MAX_AXLES] {
        &self.places
    }

    fn place(&self, axle: usize) -> f32 {
        self.places.get(axle).copied().unwrap_or(0.0)
    }

    fn shift(&mut self, shift: f32) {
        for place in &mut self.places {
            *place += shift;
        }
    }

    /// Place of the leading axle, m.
    fn leader(&self, train: &Train) -> f32 {
        self.place(train.leading(self.direction))
    }

    /// Makes the end of the robot in `direction` the leader, at rest, and drops the curve beyond.
    fn lead(&mut self, train: &Train, direction: Direction) {
        self.direction = direction;
        let shift = self.curve.cut(self.leader(train), direction);
        self.shift(shift);
    }
}

/// Controller of a robot of up to [`MAX_AXLES`] axles, with checked parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Train {
    config: Config,
    axles: usize,
    link: Link,
    /// Distance of the first axle from the last one on a straight, m.
    body: f32,
    pitch: f32,
    planner: Planner,
    leader: Leader,
    limits: Limits,
}

/// Posture of O: mean of the middles between neighbouring axles, heading from the last axle to the first.
pub fn midpoint(axles: &[Posture]) -> Posture {
    let (Some(first), Some(last)) = (axles.first(), axles.last()) else {
        return Posture::ORIGIN;
    };
    let (mut x, mut y, mut count) = (0.0, 0.0, 0.0);
    for pair in axles.windows(2) {
        let &[a, b] = pair else { continue };
        x += 0.5 * (a.x + b.x);
        y += 0.5 * (a.y + b.y);
        count += 1.0;
    }
    let share = 1.0 / greater(count, 1.0);
    Posture::new(
        x * share,
        y * share,
        atan2(first.y - last.y, first.x - last.x),
    )
}

impl Train {
    /// Lengths of a frame.
    pub fn frame(&self) -> &Link {
        &self.link
    }

    /// Number of axles.
    pub fn axles(&self) -> usize {
        self.axles
    }

    fn leading(&self, direction: Direction) -> usize {
        match direction {
            Direction::Forward => 0,
            Direction::Reverse => self.axles.saturating_sub(1),
        }
    }

    /// Runs one epoch with the estimated postures of the axles, front first.
    pub fn step<const P: usize, const T: usize>(
        &self,
        state: &mut State,
        axles: &[Posture; MAX_AXLES],
        mut task: Task<'_, P, T>,
    ) -> Step {
        let own = axles.get(..self.axles).unwrap_or(axles);
        let sound = own.iter().all(Posture::is_finite);
        if state.curve.is_empty() {
            // Estimates that no frame allows are no start.
            let straight = self.link.straight();
            let joined = own.windows(2).all(|pair| match pair {
                [a, b] => (0.5 * straight..=LONGEST * straight).contains(&a.distance(*b)),
                _ => false,
            });
            if sound && joined {
                *state = State::NEW;
                state.rebuild = Some(Rebuild::new(&mut state.curve, own, self.measures()));
            }
            return self.conclude(state, own, 0.0, false, &Lags::default());
        }
        if state.rebuild.is_some() {
            self.rebuild(state);
            return self.conclude(state, own, 0.0, false, &Lags::default());
        }
        let center = midpoint(own);
        let mut demand = Demand::stop(state.direction);
        let mut off = 0.0;
        if !matches!(task, Task::Regulate { .. }) && state.regulation.has_goal() {
            state.regulation = Regulation::NEW;
        }
        if sound && !state.lost {
            self.enter(state, &mut task);
            demand = self.demand(state, center, &mut task);
        }
        // A change of direction stops first.
        if demand.direction != state.direction {
            match state.motion.v == 0.0 {
                true => state.lead(self, demand.direction),
                false => demand = Demand::stop(state.direction),
            }
        }
        self.extend(state, &mut task, &mut off);
        let moving = demand.speed > MOVING_M_S && demand.distance > MOVING_M_S;
        let lags = match sound {
            true => self.lags(state, own),
            false => Lags {
                farthest: f32::INFINITY,
                ..Lags::default()
            },
        };
        // Zero for a wish that is not a number.
        let wanted = greater(demand.speed * self.patience(state, &lags), 0.0);
        let wanted = self.by_wheels(state, wanted);
        let driven = self.limits.step(&mut state.motion, wanted, demand.distance);
        state.driven += driven;
        self.advance(state, driven);

        let still = state.stuck.step(moving, center, EPOCH_S);
        self.finish(state, center, &demand, &task, still);
        let step = self.conclude(state, own, off, still >= STUCK_S, &lags);
        let most = self.config.max_deviation_m;
        let far = off.abs() > most || lags.farthest > most;
        state.lost |= far && !state.resting;
        if let Task::Follow { path, .. } = task
            && let Some(end) = state.on_route
        {
            path.discard_before(end - state.curve.ahead(state.leader(self), state.direction));
        }
        let lost = state.lost;
        Step { lost, ..step }
    }

    fn measures(&self) -> Measures {
        Measures {
            link: self.link,
            pitch: self.pitch,
            slope: self.leader.slope,
        }
    }

    /// Leads a new curve along the next frame. Behind the last frame, stores what is left between the axles and their
    /// places.
    fn rebuild(&self, state: &mut State) {
        let Some(work) = &mut state.rebuild else {
            return;
        };
        let Some(places) = work.step(&mut state.curve, self.measures()) else {
            return;
        };
        let axles = *work.axles();
        (state.places, state.rebuild) = (places, None);
        self.advance(state, 0.0);
        for (i, axle) in axles.iter().enumerate().take(self.axles) {
            let at = state.curve.at(state.place(i)).knot.posture;
            if let Some(offset) = state.offsets.get_mut(i) {
                *offset = axle.relative_to(at);
            }
        }
    }

    /// Advances the leader by `driven` (m), and with it the other axles.
    fn advance(&self, state: &mut State, driven: f32) {
        let State {
            curve,
            places,
            ratios,
            direction,
            ..
        } = state;
        let mut last: Option<Neighbour> = None;
        for behind in 0..self.axles {
            let axle = match direction {
                Direction::Forward => behind,
                Direction::Reverse => self.axles - 1 - behind,
            };
            let (Some(place), Some(ratio)) = (places.get_mut(axle), ratios.get_mut(axle)) else {
                continue;
            };
            *place += direction.sign() * driven;
            let own = match (last, &direction) {
                (None, _) => Neighbour {
                    place: *place,
                    ratio: 1.0,
                },
                (Some(last), Direction::Forward) => {
                    last.then(self.link.behind(curve, last.place, *place))
                }
                (Some(last), Direction::Reverse) => {
                    last.then(self.link.ahead(curve, last.place, *place))
                }
            };
            (*place, *ratio) = (own.place, own.ratio);
            last = Some(own);
        }
    }

    /// Enters the route of a task, with the robot on it.
    fn enter<const P: usize, const T: usize>(&self, state: &mut State, task: &mut Task<'_, P, T>) {
        let route: &dyn Route = match task {
            Task::Follow { path, .. } => *path,
            Task::Track { trajectory, .. } => *trajectory,
            _ => {
                state.on_route = None;
                state.resting = false;
                return;
            }
        };
        let ready = state.motion.v == 0.0 || state.direction == Direction::Forward;
        if state.on_route.is_none() && ready && route.at(0.0).is_some() {
            state.lead(self, Direction::Forward);
            let end = state.curve.end(Direction::Forward).posture;
            let window = 0.5 * self.body + 0.3;
            state.on_route = Some(guide::entry(route, end, window));
        }
    }

    /// Motion that the task demands.
    fn demand<const P: usize, const T: usize>(
        &self,
        state: &mut State,
        center: Posture,
        task: &mut Task<'_, P, T>,
    ) -> Demand {
        match task {
            Task::Stop => Demand::stop(state.direction),
            Task::Regulate { goal, within } => self.regulate(state, center, *goal, within),
            Task::Follow { path, .. } => self.on_route(state, *path, self.config.path_speed_m_s),
            Task::Track {
                trajectory, time_s, ..
            } => {
                let speed = trajectory.time_law(*time_s).map_or(0.0, |[s, v, rate]| {
                    let end = state.on_route.unwrap_or(s);
                    let ahead = state.curve.ahead(state.leader(self), state.direction);
                    // After the time of the trajectory the first axle goes on until the middle is at the end.
                    let since = greater(*time_s - trajectory.end(), 0.0);
                    let beyond = lesser(self.config.speed_m_s * since, 0.5 * self.body);
                    let v = match since > 0.0 {
                        true => self.config.speed_m_s,
                        false => v,
                    };
                    // The speed of the leader trails a rising wish by its time constant.
                    let lead = self.config.speed_lag_s * greater(rate, 0.0);
                    v + lead + self.config.trajectory_gain_per_s * (s + beyond - (end - ahead))
                });
                self.on_route(state, *trajectory, greater(speed, 0.0))
            }
            Task::Drive { speed_m_s, .. } => Demand {
                direction: match () {
                    () if *speed_m_s > 0.0 => Direction::Forward,
                    () if *speed_m_s < 0.0 => Direction::Reverse,
                    () => state.direction,
                },
                speed: speed_m_s.abs(),
                distance: f32::INFINITY,
            },
        }
    }

    /// Motion along a route at `speed` (m/s).
    fn on_route(&self, state: &State, route: &dyn Route, speed: f32) -> Demand {
        let Some(end) = state.on_route.filter(|_| !state.resting) else {
            return Demand::stop(state.direction);
        };
        let ahead = state.curve.ahead(state.leader(self), Direction::Forward);
        // The curve must not be extended beyond the last known point.
        let beyond = match route.is_complete() {
            true => 0.5 * self.body,
            false => -(AHEAD + 1.0) * self.pitch,
        };
        Demand {
            direction: Direction::Forward,
            speed,
            distance: greater(route.last() + beyond - end + ahead, 0.0),
        }
    }

    /// Extends the curve beyond the leader.
    fn extend<const P: usize, const T: usize>(
        &self,
        state: &mut State,
        task: &mut Task<'_, P, T>,
        off: &mut f32,
    ) {
        let direction = state.direction;
        for _ in 0..MOST_KNOTS {
            let leader = state.leader(self);
            let end = state.curve.end(direction);
            if state.curve.ahead(leader, direction) >= AHEAD * self.pitch {
                break;
            }
            let keep = Desired {
                posture: None,
                kappa: end.kappa,
                bound: 0.0,
                slope: 0.0,
            };
            let desired = match task {
                _ if state.lost => keep,
                Task::Regulate { goal, .. }
                    if matches!(state.regulation.phase, Phase::Segment | Phase::Approach) =>
                {
                    let leg = &mut state.regulation.leg;
                    leg.next(end.posture, *goal, self.pitch, self.leader.slope)
                }
                Task::Follow { path, .. } => {
                    self.next_on(*path, &mut state.on_route, end.posture, keep)
                }
                Task::Track { trajectory, .. } => {
                    self.next_on(*trajectory, &mut state.on_route, end.posture, keep)
                }
                Task::Drive { curvature, .. } if curvature.is_finite() => Desired {
                    kappa: *curvature,
                    ..keep
                },
                _ => keep,
            };
            let kappa = self.leader.next(&end, self.pitch, direction, &desired);
            let shift = state.curve.extend(direction, kappa);
            state.shift(shift);
        }
        let end = state.curve.end(direction).posture;
        let path = match task {
            Task::Regulate { goal, .. }
                if matches!(state.regulation.phase, Phase::Segment | Phase::Approach) =>
            {
                Some(state.regulation.leg.posture(*goal))
            }
            Task::Follow { path, .. } => state
                .on_route
                .and_then(|u| guide::extended(*path, u))
                .map(|at| at.posture),
            Task::Track { trajectory, .. } => state
                .on_route
                .and_then(|u| guide::extended(*trajectory, u))
                .map(|at| at.posture),
            _ => None,
        };
        *off = path.map_or(0.0, |path| end.relative_to(path).y);
    }

    fn next_on(
        &self,
        route: &dyn Route,
        u: &mut Option<f32>,
        end: Posture,
        keep: Desired,
    ) -> Desired {
        let desired = u
            .as_mut()
            .and_then(|u| guide::along(route, u, end, self.pitch));
        desired.unwrap_or(keep)
    }

    /// Distances of the axles, whose estimates are finite, from the references of the last epoch.
    fn lags(&self, state: &State, axles: &[Posture]) -> Lags {
        let mut lags = Lags::default();
        let (mut sum, mut square) = (0.0, 0.0);
        for (i, (lag, axle)) in lags.own.iter_mut().zip(axles).enumerate() {
            let off = self.reference_posture(state, i).relative_to(*axle);
            *lag = off.x;
            sum += off.x;
            square = greater(off.x * off.x + off.y * off.y, square);
        }
        lags.mean = sum / self.axles as f32;
        lags.farthest = sqrt(square);
        lags
    }

    /// Factor, 0 to 1, that reduces the speed while the robot lags behind its references. Waiting brings no axle back
    /// that is beside its place: for that it must drive.
    fn patience(&self, state: &State, lags: &Lags) -> f32 {
        let lag = state.direction.sign() * lags.mean;
        clamp(2.0 * (1.0 - lag / self.config.wait_m), 0.0, 1.0)
    }

    /// Speed `wanted` (m/s) of the leader, reduced for the wheels.
    fn by_wheels(&self, state: &State, wanted: f32) -> f32 {
        let mut speed = wanted;
        for (place, ratio) in state.places.iter().zip(state.ratios).take(self.axles) {
            let kappa = state.curve.kappa(*place);
            speed = lesser(speed, self.limits.by_wheels(kappa, ratio));
        }
        let end = state.curve.end(state.direction);
        lesser(speed, self.limits.by_wheels(end.kappa, 1.0))
    }

    /// Ends a path at rest: at its end, or within the tolerance of the end if friction holds the robot.
    fn finish<const P: usize, const T: usize>(
        &self,
        state: &mut State,
        center: Posture,
        demand: &Demand,
        task: &Task<'_, P, T>,
        still: f32,
    ) {
        let (complete, over, within) = match task {
            Task::Follow { path, within } => (path.is_complete(), true, within),
            Task::Track {
                trajectory,
                time_s,
                within,
            } => {
                let over = *time_s >= trajectory.end();
                (trajectory.is_complete(), over, within)
            }
            _ => return,
        };
        if !(complete && over && state.on_route.is_some()) {
            return;
        }
        let stopped = state.motion.v == 0.0 && demand.distance <= 1e-3;
        let near = demand.distance <= within.position_m && still >= REST_S && center.is_finite();
        state.resting |= stopped || near;
    }

    fn fade(&self, state: &State) -> f32 {
        let share = clamp(state.driven / self.config.fade_length_m, 0.0, 1.0);
        1.0 - share * share * (3.0 - 2.0 * share)
    }

    /// Reference posture of an axle.
    fn reference_posture(&self, state: &State, axle: usize) -> Posture {
        let at = state.curve.at(state.place(axle)).knot.posture;
        let fade = self.fade(state);
        match state.offsets.get(axle) {
            Some(offset) if fade > 0.0 => {
                let Posture { x, y, phi } = *offset;
                at.compose(Posture::new(fade * x, fade * y, fade * phi))
            }
            _ => at,
        }
    }

    /// References and result of the epoch.
    fn conclude(
        &self,
        state: &State,
        axles: &[Posture],
        off: f32,
        stuck: bool,
        lags: &Lags,
    ) -> Step {
        let mut references = [AxleReference::default(); MAX_AXLES];
        let sign = state.direction.sign();
        let (v, v_rate) = (sign * state.motion.v, sign * state.motion.rate);
        let leader = state.leader(self);
        let kappa = state.curve.kappa(leader);
        if state.curve.is_empty() || state.rebuild.is_some() {
            for (reference, axle) in references.iter_mut().zip(axles) {
                if axle.is_finite() {
                    reference.posture = *axle;
                }
            }
        } else {
            let own = state.ratios.iter().enumerate().take(self.axles);
            for ((reference, (i, ratio)), lag) in references.iter_mut().zip(own).zip(lags.own) {
                let sample = state.curve.at(state.place(i));
                let (v, v_rate) = (ratio * v, ratio * v_rate);
                let kappa = sample.knot.kappa;
                *reference = AxleReference {
                    posture: (self.reference_posture(state, i)).compose(Posture::new(
                        lags.mean - lag,
                        0.0,
                        0.0,
                    )),
                    twist: Twist::new(v, kappa * v),
                    acceleration: Twist::new(v_rate, kappa * v_rate + sample.slope * v * v),
                };
            }
        }
        let postures = references.map(|reference| reference.posture);
        let phase = state.regulation.phase;
        Step {
            references,
            v,
            v_rate,
            kappa,
            direction: state.direction,
            phase,
            target: midpoint(postures.get(..self.axles).unwrap_or(&postures)),
            off_path_m: off,
            done: state.motion.v == 0.0 && (phase == Phase::Done || state.resting),
            gave_up: phase == Phase::GaveUp,
            stuck: stuck && !state.resting,
            lost: state.lost,
        }
    }
}

#[cfg(test)]
mod tests;
