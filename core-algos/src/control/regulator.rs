//! Posture regulator: law, funnel, planner and stop rule as one state machine.
//!
//! Brings the robot's midpoint O to a goal posture and to rest. Two strategies:
//!
//! - [`Strategy::Funnel`] (default) regulates from any start. It plans up to two segments of constant curvature into
//!   the funnel, steers at rest, drives the segments with feedback on the path, then follows the approach law. It
//!   checks the posture at rest, and plans anew if the funnel was left or the goal missed.
//! - [`Strategy::PaperLaw`] is equation 4 alone with a stop rule, its goal led by the rest distance `r√(2ε)` so that
//!   O itself stops on the goal. Starts close to the goal with a large heading error stall, and the regulator gives
//!   up. It also gives up if the frame, bent by axles that have drifted apart, does not turn the robot as commanded.
//!
//! # Phases
//!
//! Stop → Plan → (Steer → Segment → Stop)… → Steer → Approach → Hold → Done. The end of the segments, Approach and
//! Hold can return to Plan; so can Done, if the robot is pushed away.
//!
//! # Sans-IO
//!
//! [`Regulator::tick`] takes the estimated posture of O, speed and steering as the governor last commanded them, and
//! the goal; it returns the commanded motion of O, before the governor.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; nothing else can fail. A posture or goal that is not finite counts as absent: the
//! command is a stop with the steering held, and the state does not change.

mod config;
mod state;

pub use config::{Config, Strategy};
use state::Next;
pub use state::{Phase, State};

use super::funnel;
use super::kinematic::{Command, Direction, Law, Limits, PolarError, curvature_of_steering};
use super::planner::{self, Plan, Planner, Progress};
use super::stuck::STUCK_S;
use crate::math::trig::{clamp, cos, sin, sin_cos, sqrt};
use crate::math::{Posture, Steering};
use crate::time::EPOCH_S;

/// Input of the regulator at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Input {
    /// Estimated posture of O.
    pub posture: Posture,
    /// Steering angle that the governor commands now. Not the estimate, whose offset would affect the start of a
    /// segment.
    pub steering: Steering,
    /// Velocity of O that the governor commands now, m/s.
    pub speed_m_s: f32,
    /// Goal posture of O, in the coordinates of `posture`.
    pub goal: Posture,
    /// Tolerance of the goal.
    pub within: Tolerance,
}

/// Tolerance of a goal.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Tolerance {
    /// Tolerance of the position, m.
    pub position_m: f32,
    /// Tolerance of the heading, rad.
    pub heading_rad: f32,
}

impl Default for Tolerance {
    /// Tolerance of 10 cm and 5°.
    fn default() -> Self {
        Self {
            position_m: 0.1,
            heading_rad: 0.0873,
        }
    }
}

impl Tolerance {
    /// True if both tolerances are positive numbers.
    pub fn is_valid(&self) -> bool {
        self.position_m > 0.0
            && self.heading_rad > 0.0
            && (self.position_m + self.heading_rad).is_finite()
    }

    /// True if a posture is within the tolerance of a goal; false for NaN.
    pub fn is_near(&self, posture: Posture, goal: Posture) -> bool {
        let [_, _, turn] = posture.minus(goal);
        self.holds([posture.distance(goal), turn.abs()])
    }

    /// True if errors of position (m) and heading (rad) are within the tolerance; false for NaN.
    pub fn holds(&self, [position, heading]: [f32; 2]) -> bool {
        position <= self.position_m && heading <= self.heading_rad
    }

    /// This tolerance, wider by 60 % for each of `attempts` but at most that of the task, then `factor` times as wide.
    pub(super) fn widened(&self, task: &Self, attempts: u8, factor: f32) -> Self {
        let bound = |own: f32, task: f32| {
            let mut bound = own;
            for _ in 0..attempts {
                bound *= WIDENING;
            }
            factor * bound.min(task.max(own))
        };
        Self {
            position_m: bound(self.position_m, task.position_m),
            heading_rad: bound(self.heading_rad, task.heading_rad),
        }
    }
}

/// Commanded motion, before the governor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// Velocity and curvature of O within the limits.
    pub command: Command,
    /// End of the robot that goes first; valid also at v = 0.
    pub direction: Direction,
    /// Phase of the regulator.
    pub phase: Phase,
    /// True if the robot is to stand still: `command.v` is 0 on purpose and does not just pass zero.
    pub feed_stop: bool,
    /// True if the robot is at rest on the goal.
    pub done: bool,
}

/// Change of goal (m, rad) above which the regulator restarts. A smaller change moves the goal without a restart.
const NEW_GOAL: (f32, f32) = (0.01, 0.02);

/// True if a goal replaces another without a restart.
pub(super) fn is_same_goal(before: Posture, goal: Posture) -> bool {
    let [dx, dy, turn] = goal.minus(before);
    dx * dx + dy * dy <= NEW_GOAL.0 * NEW_GOAL.0 && turn.abs() <= NEW_GOAL.1
}

/// Time outside the funnel after which the approach ends, s.
const OUTSIDE_S: f32 = 0.1;
/// Time without commanded motion after which the approach ends, s.
const STALL_S: f32 = 1.0;
/// Distance between two postures up to which a robot is stuck in the same place, m.
pub(super) const SAME_PLACE_M: f32 = 0.01;
/// Factor by which each attempt widens the accepted errors.
const WIDENING: f32 = 1.6;
/// Remaining length at which a segment counts as driven, m.
const SEGMENT_END_M: f32 = 2e-3;

/// Feedback curvature (1/m) for a critically damped decay of the deviation `off` from the nearest posture of a path,
/// with length constant λ: y'' = −y/λ² − 2 y'/λ with y' = sign · heading error.
fn path_feedback(off: Posture, sign: f32, length_constant: f32) -> f32 {
    let inverse = 1.0 / length_constant;
    -inverse * inverse * off.y - 2.0 * inverse * sign * off.phi
}

/// Regulator with checked parameters: drives O to a goal posture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regulator {
    config: Config,
    limits: Limits,
    law: Law,
    approach: Law,
    planner: Planner,
}

impl Regulator {
    /// Runs one step; to be called once an epoch ([`EPOCH_S`]).
    pub fn tick(&self, state: &mut State, input: &Input) -> Output {
        if !(input.posture.is_finite() && input.goal.is_finite()) {
            return self.stand(state);
        }
        self.accept_goal(state, input);
        state.elapsed += EPOCH_S;
        if self.is_stuck(state, input) {
            state.blocked = self.is_blocked(state, input);
            state.enter(match state.blocked {
                true => Phase::GaveUp,
                false => Phase::Hold,
            });
        }
        let output = match self.config.strategy {
            Strategy::PaperLaw => self.paper(state, input),
            Strategy::Funnel => match state.phase {
                Phase::Stop => self.stop(state, input),
                Phase::Plan => self.plan(state, input),
                Phase::Steer => self.steer(state, input),
                Phase::Segment => self.segment(state, input),
                Phase::Approach => self.follow_approach(state, input),
                Phase::Hold => self.hold(state, input),
                Phase::Done => self.done(state, input),
                Phase::GaveUp => self.stand(state),
            },
        };
        state.last = input.posture;
        state.kappa = output.command.kappa;
        output
    }

    fn accept_goal(&self, state: &mut State, input: &Input) {
        let goal = input.goal;
        if !state.goal.is_some_and(|before| is_same_goal(before, goal)) {
            let kappa = state.kappa;
            *state = State {
                goal: Some(goal),
                last: input.posture,
                stuck_at: Some(input.posture),
                kappa,
                ..State::default()
            };
        }
    }

    /// True if the robot, commanded to drive, has not moved for [`STUCK_S`]: friction can exceed the torque at a small
    /// speed or with a failed motor.
    fn is_stuck(&self, state: &mut State, input: &Input) -> bool {
        let under_way = matches!(state.phase, Phase::Segment | Phase::Approach);
        let dt = EPOCH_S;
        state.stuck.step(under_way, input.posture, dt) >= STUCK_S
    }

    /// True if the robot is stuck outside the tolerance at the place where it was stuck before, or where the task
    /// began: the obstacle stays.
    fn is_blocked(&self, state: &mut State, input: &Input) -> bool {
        let before = state.stuck_at.replace(input.posture);
        let again = before.is_some_and(|at| input.posture.distance(at) <= SAME_PLACE_M);
        let near = input.within.is_near(input.posture, input.goal);
        again && !(near || self.reached(state, input, 1.0))
    }

    /// Output at standstill with the steering held.
    fn stand(&self, state: &State) -> Output {
        self.output(state, 0.0, state.kappa)
    }

    fn output(&self, state: &State, v: f32, kappa: f32) -> Output {
        let command = self.limits.limit(Command {
            v,
            kappa,
            phi_dot: v * kappa,
        });
        let planned = match state.next {
            Next::Step(index) if matches!(state.phase, Phase::Steer | Phase::Segment) => {
                state.plan.segment(usize::from(index))
            }
            _ => None,
        };
        Output {
            command,
            direction: planned.map_or(state.plan.approach, |segment| segment.direction),
            phase: state.phase,
            feed_stop: !matches!(state.phase, Phase::Segment | Phase::Approach),
            done: state.phase == Phase::Done,
        }
    }

    /// Steering error (rad) for a commanded curvature `kappa`: difference of curvature divided by dκ/dψ, which needs
    /// no inverse of eq. 5.
    fn steering_error(&self, kappa: f32, psi: Steering) -> f32 {
        let length = self.config.limits.frame_length_m;
        let (s, c) = sin_cos(psi.0);
        let slope = 2.0 * (c + psi.0 * s) / (length * c * c).max(1e-6);
        let kappa = self.limits.limit(Command {
            kappa,
            ..Command::REST
        });
        (kappa.kappa - curvature_of_steering(psi, length)) / slope
    }

    /// Factor, 0 to 1, that reduces the speed while the steering error is large.
    fn patience(&self, kappa: f32, psi: Steering) -> f32 {
        let share = self.steering_error(kappa, psi).abs() / self.config.steering_wait_rad;
        clamp(2.0 * (1.0 - share), 0.0, 1.0)
    }

    /// True if the approach may begin or continue from `error`: inside the funnel, widened for errors of execution and
    /// estimate. The commanded curvature stays within its limit.
    fn within_reach(&self, error: PolarError) -> bool {
        let slack = self.config.leave_slack_rad / error.distance_m.max(1e-3);
        let curvature = self.config.leave_factor * self.limits.max_curvature();
        funnel::contains(error, curvature + slack)
    }

    fn at_rest(&self, input: &Input) -> bool {
        input.speed_m_s.abs() <= self.config.rest_speed_m_s
    }

    fn error(&self, input: &Input) -> PolarError {
        PolarError::between(input.posture, input.goal)
    }

    /// True if the goal is reached, with bounds widened by `factor`. Each attempt widens the bounds up to the task's
    /// tolerance, because corrections of the estimate may exceed the accepted errors.
    fn reached(&self, state: &State, input: &Input, factor: f32) -> bool {
        let error = self.error(input);
        let accepted = Tolerance {
            position_m: self.config.accept_distance_m,
            heading_rad: self.config.accept_heading_rad,
        };
        let attempts = state.attempts.min(self.config.max_attempts);
        accepted
            .widened(&input.within, attempts, factor)
            .holds([error.distance_m, error.heading().abs()])
    }

    /// Distance (m) that the governor needs from `speed` to rest once zero is commanded: first at its deceleration,
    /// then along the exponential of its lag.
    fn stopping_distance(&self, speed: f32) -> f32 {
        let (a, lag) = (self.config.braking_m_s2, self.config.speed_lag_s);
        let joint = a * lag;
        if speed > joint {
            (speed * speed - joint * joint) / (2.0 * a) + joint * lag
        } else {
            speed * lag
        }
    }

    fn stop(&self, state: &mut State, input: &Input) -> Output {
        let speed = input.speed_m_s.abs();
        let rest = speed <= self.config.rest_speed_m_s;
        let slow = rest || speed <= self.config.steer_speed_m_s;
        if slow {
            match state.next {
                Next::Plan if !rest => {}
                Next::Plan => {
                    if self.reached(state, input, 1.0) {
                        state.enter(Phase::Hold);
                    } else {
                        state.search = Some(self.planner.start(input.posture, input.goal));
                        state.ahead = 0;
                        state.enter(Phase::Plan);
                    }
                }
                Next::Step(index) => self.proceed(state, input, index),
            }
        }
        self.stand(state)
    }

    /// Does `1/parts` of the planner's work of the next tick ahead, to shorten that tick. The output of
    /// [`Self::tick`] does not depend on these calls.
    pub fn plan_ahead(&self, state: &mut State, parts: u32) {
        if let (Phase::Plan, Some(search)) = (state.phase, state.search.as_mut()) {
            let budget = self.config.planner_budget;
            let share = budget
                .div_ceil(parts.max(1))
                .min(budget.saturating_sub(state.ahead));
            state.ahead += share;
            self.planner.step(search, share);
        }
    }

    fn plan(&self, state: &mut State, input: &Input) -> Output {
        let Some(search) = state.search.as_mut() else {
            state.stop_then(Next::Plan);
            return self.stand(state);
        };
        let left = self.config.planner_budget.saturating_sub(state.ahead);
        state.ahead = 0;
        match self.planner.step(search, left) {
            Progress::Working => {}
            Progress::Found(plan) => {
                state.search = None;
                state.plan = plan;
                self.proceed(state, input, 0);
            }
            Progress::Impossible => {
                // No plan: the saturated law approaches the goal as far as it can.
                state.search = None;
                let ahead = cos(self.error(input).alpha) >= 0.0;
                state.plan = Plan::direct(if ahead {
                    Direction::Forward
                } else {
                    Direction::Reverse
                });
                state.next = Next::Step(0);
                state.enter(Phase::Steer);
            }
        }
        self.stand(state)
    }

    /// Before step `index` of the plan, at or near rest: steers for the step, or plans anew if the approach cannot
    /// begin.
    fn proceed(&self, state: &mut State, input: &Input, index: u8) {
        let is_segment = state.plan.segment(usize::from(index)).is_some();
        let directed = self.error(input).in_direction(state.plan.approach);
        if is_segment || self.within_reach(directed) {
            state.next = Next::Step(index);
            state.origin = input.posture;
            state.progress = 0.0;
            state.enter(Phase::Steer);
        } else {
            self.renew(state);
        }
    }

    /// Begins another attempt, or gives up after the last.
    fn renew(&self, state: &mut State) {
        state.attempts = state.attempts.saturating_add(1);
        if state.attempts > self.config.max_attempts {
            state.enter(Phase::GaveUp);
        } else {
            state.stop_then(Next::Plan);
        }
    }

    fn steer(&self, state: &mut State, input: &Input) -> Output {
        let segment = match state.next {
            Next::Step(index) => state.plan.segment(usize::from(index)),
            Next::Plan => None,
        };
        let kappa = match segment {
            Some(segment) => segment.curvature,
            None => {
                self.approach
                    .approach(self.error(input), state.plan.approach)
                    .kappa
            }
        };
        let error = self.steering_error(kappa, input.steering).abs();
        if error <= self.config.steering_tolerance_rad
            || state.elapsed >= self.config.steering_timeout_s
        {
            // Steering at rest may have moved the estimate: the segment begins here.
            state.origin = input.posture;
            state.last = input.posture;
            state.enter(if segment.is_some() {
                Phase::Segment
            } else {
                Phase::Approach
            });
        }
        self.output(state, 0.0, kappa)
    }

    fn segment(&self, state: &mut State, input: &Input) -> Output {
        let Next::Step(index) = state.next else {
            state.stop_then(Next::Plan);
            return self.stand(state);
        };
        let Some(segment) = state.plan.segment(usize::from(index)) else {
            state.stop_then(Next::Plan);
            return self.stand(state);
        };
        let sign = segment.direction.sign();
        let (s, c) = sin_cos(input.posture.phi);
        let (dx, dy) = (
            input.posture.x - state.last.x,
            input.posture.y - state.last.y,
        );
        state.progress += sign * (c * dx + s * dy);
        let left = segment.length_m - state.progress;
        let off = input
            .posture
            .relative_to(segment.posture_at(state.origin, state.progress));
        let kappa =
            segment.curvature + path_feedback(off, sign, self.config.path_length_constant_m);
        if left
            <= self
                .stopping_distance(input.speed_m_s.abs())
                .max(SEGMENT_END_M)
        {
            state.stop_then(Next::Step(index + 1));
            return self.output(state, 0.0, kappa);
        }
        let braking = sqrt(2.0 * self.config.braking_m_s2 * left).min(2.5 * left + 0.005);
        let speed = braking.min(self.limits.max_speed()) * self.patience(kappa, input.steering);
        self.output(state, sign * speed, kappa)
    }

    fn follow_approach(&self, state: &mut State, input: &Input) -> Output {
        let error = self.error(input);
        let direction = state.plan.approach;
        let directed = error.in_direction(direction);
        if state.final_curvature.is_none() && error.distance_m <= self.config.final_arc_m {
            let arc = 2.0 * sin(directed.alpha) / error.distance_m.max(1e-3);
            let bound = self.limits.max_curvature();
            state.final_curvature = Some(direction.sign() * clamp(arc, -bound, bound));
        }
        if let Some(curvature) = state.final_curvature {
            return self.final_arc(state, input, curvature);
        }
        let command = self.limits.limit(self.approach.approach(error, direction));
        let outside = !self.within_reach(directed);
        let idle = command.v.abs() < 0.5 * self.config.rest_speed_m_s;
        if outside || idle {
            state.no_progress_s += EPOCH_S;
        } else {
            state.no_progress_s = 0.0;
        }
        if outside && state.no_progress_s >= OUTSIDE_S {
            self.renew(state);
            return self.stand(state);
        }
        if idle && state.no_progress_s >= STALL_S {
            state.enter(Phase::Hold);
            return self.stand(state);
        }
        let v = command.v * self.patience(command.kappa, input.steering);
        self.output(state, v, command.kappa)
    }

    /// End of the approach: drives the arc that ends in the goal posture.
    fn final_arc(&self, state: &mut State, input: &Input, curvature: f32) -> Output {
        let direction = state.plan.approach;
        let sign = direction.sign();
        let arc = planner::Segment {
            direction,
            curvature,
            length_m: self.config.final_arc_m,
        };
        // Projects the posture onto the arc, with one correction: `left` is the remaining distance, `off` the
        // deviation.
        let relative = input.posture.relative_to(input.goal);
        let first = -sign * relative.x;
        let off = input
            .posture
            .relative_to(arc.posture_at(input.goal, -first));
        let left = first - sign * off.x;
        let off = input.posture.relative_to(arc.posture_at(input.goal, -left));
        if left <= self.config.latch_distance_m {
            state.enter(Phase::Hold);
            return self.stand(state);
        }
        let kappa = curvature + path_feedback(off, sign, self.config.final_length_constant_m);
        let v = self.config.approach.approach_gain_m_s * left;
        self.output(
            state,
            sign * v * self.patience(kappa, input.steering),
            kappa,
        )
    }

    fn hold(&self, state: &mut State, input: &Input) -> Output {
        if !self.at_rest(input) {
            state.elapsed = 0.0;
        } else if state.elapsed >= self.config.settle_time_s {
            if self.reached(state, input, 1.0) {
                state.enter(Phase::Done);
            } else {
                self.renew(state);
            }
        }
        self.stand(state)
    }

    fn done(&self, state: &mut State, input: &Input) -> Output {
        if !self.reached(state, input, self.config.release_factor) {
            state.attempts = 0;
            state.stop_then(Next::Plan);
        }
        self.stand(state)
    }

    /// One step of [`Strategy::PaperLaw`].
    fn paper(&self, state: &mut State, input: &Input) -> Output {
        let rest = self.law.rest_distance();
        let led = input.goal.compose(Posture::new(rest, 0.0, 0.0));
        let error = PolarError::between(input.posture, led);
        let command = self.limits.limit(self.law.command(error, 0.0, 0.0));
        let margin = self.config.stop_margin_m;
        match state.phase {
            Phase::Hold | Phase::Done => {
                if error.distance_m > rest + self.config.release_factor * margin {
                    state.enter(Phase::Approach);
                } else {
                    if self.at_rest(input) {
                        state.enter(Phase::Done);
                    }
                    return self.stand(state);
                }
            }
            Phase::GaveUp => return self.stand(state),
            Phase::Approach => {
                let slow = command.v.abs() < self.config.stop_speed_m_s;
                state.no_progress_s = if slow {
                    state.no_progress_s + EPOCH_S
                } else {
                    0.0
                };
                if slow && error.distance_m < rest + margin {
                    state.enter(Phase::Hold);
                    return self.stand(state);
                }
                if state.no_progress_s >= STALL_S {
                    // On the circle manifold with a heading error: eq. 4 commands a turn on the spot, which a bent
                    // frame cannot do.
                    state.enter(Phase::GaveUp);
                    return self.stand(state);
                }
            }
            _ => state.enter(Phase::Approach),
        }
        let direction = if command.v < 0.0 {
            Direction::Reverse
        } else {
            Direction::Forward
        };
        state.plan = Plan::direct(direction);
        self.output(state, command.v, command.kappa)
    }
}

#[cfg(test)]
mod tests;
