//! Regulation to a goal: plan at rest, drive the legs, compare the posture with the goal, try again.
//!
//! Stop → Plan → (Segment → Stop)? → Approach → Hold → Done. A robot that rests off the goal plans again. Done returns
//! to Stop if the robot is pushed away.

use super::guide::OnLeg;
use super::planner::{Plan, Progress, Robot, Search};
use super::{Demand, State, Train};
use crate::control::regulator::{Phase, SAME_PLACE_M, Tolerance, is_same_goal};
use crate::control::stuck::{STUCK_S, Stuck};
use crate::math::Posture;
use crate::time::EPOCH_S;

/// State of the regulation between two epochs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regulation {
    pub(super) phase: Phase,
    goal: Option<Posture>,
    search: Option<Search>,
    /// Candidates of the next epoch's budget that are evaluated.
    ahead: u32,
    plan: Option<Plan>,
    pub(super) leg: OnLeg,
    elapsed: f32,
    attempts: u8,
    stuck: Stuck,
    stuck_at: Option<Posture>,
    pub(super) blocked: bool,
}

impl Regulation {
    /// No goal.
    pub(super) const NEW: Self = Self {
        phase: Phase::Stop,
        goal: None,
        search: None,
        ahead: 0,
        plan: None,
        leg: OnLeg::NEW,
        elapsed: 0.0,
        attempts: 0,
        stuck: Stuck::NEW,
        stuck_at: None,
        blocked: false,
    };

    /// True once a goal is given.
    pub(super) fn has_goal(&self) -> bool {
        self.goal.is_some()
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.elapsed = 0.0;
        self.stuck.reset();
    }
}

impl Train {
    /// Does `1/parts` of the planner's work of the next epoch ahead. The output of [`Self::step`] does not depend on
    /// these calls.
    pub fn plan_ahead(&self, state: &mut State, parts: u32) {
        let robot = Robot {
            curve: &state.curve,
            front: state.places[0],
            rear: state.place(self.axles.saturating_sub(1)),
        };
        let task = &mut state.regulation;
        if let (Phase::Plan, Some(search)) = (task.phase, task.search.as_mut()) {
            let budget = self.config.planner_budget;
            let share = budget
                .div_ceil(parts.max(1))
                .min(budget.saturating_sub(task.ahead));
            task.ahead += share;
            self.planner.step(search, robot, share);
        }
    }

    /// True if the goal is reached, with bounds widened by `factor`.
    fn reached(
        &self,
        task: &Regulation,
        at: Posture,
        goal: Posture,
        within: &Tolerance,
        factor: f32,
    ) -> bool {
        let accepted = Tolerance {
            position_m: self.config.accept_distance_m,
            heading_rad: self.config.accept_heading_rad,
        };
        let attempts = task.attempts.min(self.config.max_attempts);
        accepted.widened(within, attempts, factor).is_near(at, goal)
    }

    /// Begins another attempt, or gives up after the last.
    fn renew(&self, task: &mut Regulation) {
        task.plan = None;
        task.attempts = task.attempts.saturating_add(1);
        task.enter(match task.attempts > self.config.max_attempts {
            true => Phase::GaveUp,
            false => Phase::Stop,
        });
    }

    /// One epoch of the regulation: the motion that it demands with O at `center`.
    pub(super) fn regulate(
        &self,
        state: &mut State,
        center: Posture,
        goal: Posture,
        within: &Tolerance,
    ) -> Demand {
        let before = state.regulation.goal;
        if !before.is_some_and(|before| is_same_goal(before, goal)) {
            state.regulation = Regulation {
                goal: Some(goal),
                stuck_at: Some(center),
                ..Regulation::NEW
            };
        }
        let rests = state.motion.v == 0.0;
        let mut task = state.regulation;
        task.elapsed += EPOCH_S;
        self.watch_progress(&mut task, center, goal, within);
        let mut demand = Demand::stop(state.direction);
        match task.phase {
            Phase::Stop if !rests || task.elapsed < self.config.reversal_hold_s => {}
            Phase::Stop => match task.plan {
                Some(plan) => {
                    self.begin(state, &mut task, plan.prelude.is_none(), &plan);
                    demand = Demand::stop(state.direction);
                }
                None if self.reached(&task, center, goal, within, 1.0) => task.enter(Phase::Hold),
                None => {
                    task.search = Some(self.planner.start(goal));
                    task.enter(Phase::Plan);
                }
            },
            Phase::Plan => self.plan(state, &mut task),
            Phase::Segment | Phase::Approach => demand = self.drive_leg(state, &mut task),
            Phase::Hold if !rests => task.elapsed = 0.0,
            Phase::Hold if task.elapsed >= self.config.settle_time_s => {
                match self.reached(&task, center, goal, within, 1.0) {
                    true => task.enter(Phase::Done),
                    false => self.renew(&mut task),
                }
            }
            Phase::Done => {
                let factor = self.config.release_factor;
                if !self.reached(&task, center, goal, within, factor) {
                    task.attempts = 0;
                    task.plan = None;
                    task.enter(Phase::Stop);
                }
            }
            Phase::Hold | Phase::Steer | Phase::GaveUp => {}
        }
        state.regulation = task;
        demand
    }

    /// Ends a leg on which the robot does not move.
    fn watch_progress(
        &self,
        task: &mut Regulation,
        center: Posture,
        goal: Posture,
        within: &Tolerance,
    ) {
        let under_way = matches!(task.phase, Phase::Segment | Phase::Approach);
        if task.stuck.step(under_way, center, EPOCH_S) < STUCK_S {
            return;
        }
        let before = task.stuck_at.replace(center);
        let again = before.is_some_and(|at| center.distance(at) <= SAME_PLACE_M);
        let near = within.is_near(center, goal) || self.reached(task, center, goal, within, 1.0);
        task.blocked = again && !near;
        task.enter(match task.blocked {
            true => Phase::GaveUp,
            false => Phase::Hold,
        });
    }

    fn plan(&self, state: &State, task: &mut Regulation) {
        let Some(search) = task.search.as_mut() else {
            task.enter(Phase::Stop);
            return;
        };
        let left = self.config.planner_budget.saturating_sub(task.ahead);
        task.ahead = 0;
        let robot = Robot {
            curve: &state.curve,
            front: state.places[0],
            rear: state.place(self.axles.saturating_sub(1)),
        };
        match self.planner.step(search, robot, left) {
            Progress::Working => {}
            Progress::Found(plan) => {
                task.plan = Some(plan);
                task.enter(Phase::Stop);
            }
            Progress::Impossible => self.renew(task),
        }
    }

    /// Begins a leg of the plan; `last` for the leg that ends on the goal.
    fn begin(&self, state: &mut State, task: &mut Regulation, last: bool, plan: &Plan) {
        let leg = match plan.prelude {
            Some(prelude) if !last => prelude,
            _ => plan.last,
        };
        state.lead(self, leg.direction);
        task.leg = OnLeg::new(leg);
        // The curve reaches a little beyond the leader.
        let beyond = state.curve.ahead(state.leader(self), leg.direction);
        task.leg.advance(beyond);
        // After the prelude, only the last leg is left.
        task.plan = Some(Plan {
            prelude: None,
            ..*plan
        });
        task.enter(match last {
            true => Phase::Approach,
            false => Phase::Segment,
        });
    }

    fn drive_leg(&self, state: &State, task: &mut Regulation) -> Demand {
        let OnLeg { leg, u, .. } = task.leg;
        let ahead = state.curve.ahead(state.leader(self), leg.direction);
        let distance = leg.length() - u + ahead;
        if state.motion.v == 0.0 && distance <= 1e-6 {
            task.enter(match task.phase {
                Phase::Segment => Phase::Stop,
                _ => Phase::Hold,
            });
        }
        Demand {
            direction: leg.direction,
            speed: self.config.speed_m_s,
            distance,
        }
    }
}
