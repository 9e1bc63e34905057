//! State of the regulator.

use crate::control::planner::{Plan, Search};
use crate::control::stuck::Stuck;
use crate::math::Posture;

/// Phase of the regulator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Phase {
    /// Coming to rest, steering held.
    #[default]
    Stop,
    /// At rest, searching for a plan.
    Plan,
    /// At or near rest, steering to the next curvature.
    Steer,
    /// Driving a segment of the plan.
    Segment,
    /// Following the law to the goal.
    Approach,
    /// At the goal, coming to rest; the posture is then compared with the goal.
    Hold,
    /// At rest on the goal.
    Done,
    /// At rest off the goal after the last attempt.
    GaveUp,
}

/// Action of the regulator once the phase Stop or Steer ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Next {
    /// A new plan.
    #[default]
    Plan,
    /// Segment of this index, or the approach after the last segment.
    Step(u8),
}

/// What the regulator keeps from one tick to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    pub(super) phase: Phase,
    pub(super) goal: Option<Posture>,
    pub(super) search: Option<Search>,
    /// Number of candidate postures of the next tick's budget that are already evaluated.
    pub(super) ahead: u32,
    pub(super) plan: Plan,
    pub(super) next: Next,
    /// Start of the present segment.
    pub(super) origin: Posture,
    /// Posture of the robot at the previous tick.
    pub(super) last: Posture,
    /// Time for which the robot has been commanded to drive without moving.
    pub(super) stuck: Stuck,
    /// Posture where the robot was last stuck, at first the posture at the start; `None` before the start.
    pub(super) stuck_at: Option<Posture>,
    /// True if the robot gave up because it cannot move.
    pub(super) blocked: bool,
    /// Distance driven along the present segment, m.
    pub(super) progress: f32,
    /// Curvature of the final arc, 1/m, positive to the left of the robot's heading; `None` until the approach follows
    /// the arc.
    pub(super) final_curvature: Option<f32>,
    /// Curvature that is held at standstill, 1/m.
    pub(super) kappa: f32,
    /// Time in the present phase, s.
    pub(super) elapsed: f32,
    /// Time of consecutive ticks outside the funnel or without commanded motion, s.
    pub(super) no_progress_s: f32,
    /// Renewed attempts at the present goal.
    pub(super) attempts: u8,
}

impl State {
    /// Phase of the regulator.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// True if the robot gave up because it was commanded to move and did not.
    pub fn is_blocked(&self) -> bool {
        self.blocked
    }

    /// Discards the goal, so that the next input restarts the regulator.
    pub fn forget_goal(&mut self) {
        self.goal = None;
    }

    /// Renewed attempts at the present goal.
    pub fn attempts(&self) -> u8 {
        self.attempts
    }

    pub(super) fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.final_curvature = None;
        self.elapsed = 0.0;
        self.no_progress_s = 0.0;
        self.stuck.reset();
    }

    pub(super) fn stop_then(&mut self, next: Next) {
        self.next = next;
        self.enter(Phase::Stop);
    }
}
