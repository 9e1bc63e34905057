//! Planner that brings any posture into the funnel of the approach law.
//!
//! Turning needs room: a start close to the goal with a large heading error must first drive away. The planner
//! searches for none, one or two segments of constant curvature (left, straight, right; forward or in reverse) that
//! end in the funnel ([`super::funnel`]), of least estimated length with a price on each cusp and each stop.
//!
//! The search is a branch and bound over segment lengths on a grid, then a refinement of the best lengths. Its bound:
//! length driven so far plus the distance left never falls along a segment, so a branch whose sum exceeds the best
//! plan is cut. The search is incremental: [`Planner::step`] evaluates a given number of candidate postures (about
//! 150 floating-point operations each) and returns, so that each call fits in a control tick. Memory: the fixed-size
//! [`Search`].
//!
//! # Panic contract
//!
//! [`Config::build`] validates; nothing else can fail. A posture that is not finite yields no plan.

mod plan;

pub use plan::{Plan, Segment};

use super::funnel::Candidate;
use super::kinematic::Direction;
use crate::config::{ConfigError, declare, positive};
use crate::math::Posture;
use crate::math::trig::{sin_cos, sinc, sqrt};
use core::f32::consts::TAU;

declare! {
    /// Parameters of the search.
    pub struct Config {
        /// Share of the greatest curvature that funnel and segments use (κ_d over κ_max); the rest is
        /// left to feedback.
        pub curvature_share: f32 = 0.94, "": Range(0.1, 1.0);
        /// Grid step of the segment length in plans of one segment.
        pub single_step_m: f32 = 0.04, "m": Range(5e-3, 1.0);
        /// Grid step of the segment lengths in plans of two segments.
        pub pair_step_m: f32 = 0.08, "m": Range(5e-3, 1.0);
        /// Longest straight segment. An arc is at most one full turn.
        pub max_straight_m: f32 = 3.0, "m": Range(0.1, 100.0);
        /// Least distance from the goal at which the approach law may take over.
        pub min_approach_m: f32 = 0.15, "m": Positive;
        /// Margin to the funnel's bound `κ_d e` at the beginning of the approach: room for errors
        /// of execution.
        pub margin_rad: f32 = 0.05, "rad": NonNegative;
        /// Price of a change of direction.
        pub cusp_price_m: f32 = 0.15, "m": NonNegative;
        /// Price of each segment (the stop at its end and the wait for steering).
        pub stop_price_m: f32 = 0.08, "m": NonNegative;
    }
}

impl Config {
    /// Builds the validated planner; the error names the invalid field. `max_curvature_per_m` is the bound of the robot
    /// (κ_max, 1/m).
    pub fn build(self, max_curvature_per_m: f32) -> Result<Planner, ConfigError> {
        self.check_ranges()?;
        positive("max_curvature_per_m", max_curvature_per_m)?;
        let curvature = self.curvature_share * max_curvature_per_m;
        let steps = |length_m: f32| {
            MOTIONS.map(|(direction, share)| {
                Pose::arc(Segment {
                    direction,
                    curvature: share * curvature,
                    length_m,
                })
            })
        };
        Ok(Planner {
            config: self,
            curvature,
            single_steps: steps(self.single_step_m),
            pair_steps: steps(self.pair_step_m),
        })
    }
}

/// The kinds of segment: direction and curvature over κ_d.
const MOTIONS: [(Direction, f32); 6] = [
    (Direction::Forward, 0.0),
    (Direction::Forward, 1.0),
    (Direction::Forward, -1.0),
    (Direction::Reverse, 0.0),
    (Direction::Reverse, 1.0),
    (Direction::Reverse, -1.0),
];

/// Posture with the heading as a unit vector, so that a step along a segment costs no trigonometry.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Pose {
    x: f32,
    y: f32,
    cos: f32,
    sin: f32,
}

impl Pose {
    fn compose(self, step: Self) -> Self {
        Self {
            x: self.x + self.cos * step.x - self.sin * step.y,
            y: self.y + self.sin * step.x + self.cos * step.y,
            cos: self.cos * step.cos - self.sin * step.sin,
            sin: self.sin * step.cos + self.cos * step.sin,
        }
    }

    /// Posture at the end of a segment that starts at the origin.
    fn arc(segment: Segment) -> Self {
        let ds = segment.direction.sign() * segment.length_m;
        let turn = ds * segment.curvature;
        let (half_sin, half_cos) = sin_cos(0.5 * turn);
        let chord = ds * sinc(0.5 * turn);
        let (sin, cos) = sin_cos(turn);
        Self {
            x: chord * half_cos,
            y: chord * half_sin,
            cos,
            sin,
        }
    }
}

/// Stage of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Plans of one segment: index of the segment's motion in [`MOTIONS`], and its length in grid steps.
    Single { motion: u8, steps: u16 },
    /// Plans of two segments: length of the first in grid steps (lengthened for all motions together), index of the
    /// first motion, index of the second, length of the second in grid steps.
    Pair {
        first_steps: u16,
        first: u8,
        second: u8,
        steps: u16,
    },
    /// Refinement of the best plan's lengths: index of the next change to try, size of a change (m), and true if a
    /// change of this size lowered the cost.
    Refine {
        change: u8,
        step_m: f32,
        helped: bool,
    },
    /// The search is complete.
    Finished,
}

impl Stage {
    const fn pair(first_steps: u16, first: u8, second: u8, steps: u16) -> Self {
        Self::Pair {
            first_steps,
            first,
            second,
            steps,
        }
    }

    const fn refine(change: u8, step_m: f32, helped: bool) -> Self {
        Self::Refine {
            change,
            step_m,
            helped,
        }
    }
}

/// Result of a call of [`Planner::step`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// The search goes on.
    Working,
    /// The best plan of the grid, refined.
    Found(Plan),
    /// No plan of at most two segments leads into the funnel.
    Impossible,
}

/// A search in progress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    start: Pose,
    best: Option<Plan>,
    stage: Stage,
    /// For each motion: end of a first segment of the current length, and true if a plan that begins with this segment
    /// may still be better than the best.
    middle: [(Pose, bool); 6],
    here: Pose,
    evaluated: u32,
}

impl Search {
    /// Stores the plan of these segments, with the cost and direction of approach in `found`. Does nothing without
    /// `found`.
    fn improve(
        &mut self,
        (first, second): (Option<Segment>, Option<Segment>),
        found: Option<(f32, Direction)>,
    ) {
        if let Some((cost_m, approach)) = found {
            self.best = Some(Plan {
                first,
                second,
                approach,
                cost_m,
            });
        }
    }
}

/// The planner, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planner {
    config: Config,
    /// κ_d, 1/m.
    curvature: f32,
    /// Change of posture in one grid step of each motion, so that a candidate costs no trigonometry. `single_steps` is
    /// for plans of one segment, `pair_steps` for plans of two.
    single_steps: [Pose; MOTIONS.len()],
    pair_steps: [Pose; MOTIONS.len()],
}

impl Planner {
    /// Curvature of funnel and segments, 1/m (κ_d).
    pub fn curvature(&self) -> f32 {
        self.curvature
    }

    /// A search from `posture` (m, rad) to `goal`, both in the same frame.
    pub fn start(&self, posture: Posture, goal: Posture) -> Search {
        let relative = posture.relative_to(goal);
        let (sin, cos) = sin_cos(relative.phi);
        let start = Pose {
            x: relative.x,
            y: relative.y,
            cos,
            sin,
        };
        let mut search = Search {
            start,
            best: None,
            stage: Stage::Finished,
            middle: [(start, true); 6],
            here: start,
            evaluated: 0,
        };
        if !relative.is_finite() {
            return search;
        }
        // A start in the funnel has a plan without segments; the search may find a segment that shortens the path.
        search.improve((None, None), self.evaluate(start, 0.0, None, None).1);
        let (motion, steps) = (0, 0);
        search.stage = Stage::Single { motion, steps };
        search
    }

    /// Evaluates up to `budget` candidate postures.
    pub fn step(&self, search: &mut Search, budget: u32) -> Progress {
        for _ in 0..budget {
            match search.stage {
                Stage::Single { motion, steps } => self.single(search, motion, steps),
                Stage::Pair {
                    first_steps,
                    first,
                    second,
                    steps,
                } => self.pair(search, first_steps, first, second, steps),
                Stage::Refine {
                    change,
                    step_m,
                    helped,
                } => self.refine(search, change, step_m, helped),
                Stage::Finished => break,
            }
            search.evaluated = search.evaluated.saturating_add(1);
        }
        match (search.stage, search.best) {
            (Stage::Finished, Some(plan)) => Progress::Found(plan),
            (Stage::Finished, None) => Progress::Impossible,
            _ => Progress::Working,
        }
    }

    fn segment(&self, motion: u8, length_m: f32) -> Option<Segment> {
        let &(direction, share) = MOTIONS.get(usize::from(motion))?;
        Some(Segment {
            direction,
            curvature: share * self.curvature,
            length_m,
        })
    }

    fn longest(&self, segment: &Segment) -> f32 {
        if segment.curvature == 0.0 {
            self.config.max_straight_m
        } else {
            TAU / self.curvature
        }
    }

    /// Evaluates a posture reached after `spent` metres (prices included), the last segment in direction `last`.
    /// Returns a lower bound of the plan's cost. If the posture is in the funnel and the plan costs less than `best`,
    /// also returns the plan's cost and the direction of approach.
    fn evaluate(
        &self,
        pose: Pose,
        spent: f32,
        last: Option<Direction>,
        best: Option<f32>,
    ) -> (f32, Option<(f32, Direction)>) {
        let e = sqrt(pose.x * pose.x + pose.y * pose.y);
        let least = spent + e;
        let best = best.unwrap_or(f32::INFINITY);
        if !(e >= self.config.min_approach_m && least < best) {
            return (least, None);
        }
        // No approach is shorter than the line of sight. A direction that costs too much at this length is not
        // evaluated.
        let cusps = [Direction::Forward, Direction::Reverse].map(|approach| match last {
            Some(direction) if direction != approach => self.config.cusp_price_m,
            _ => 0.0,
        });
        let wanted = cusps.map(|cusp| least + cusp < best);
        // Line of sight in the goal's frame: (cos θ, sin θ).
        let (cos_theta, sin_theta) = (-pose.x / e, -pose.y / e);
        let cos_alpha = pose.cos * cos_theta + pose.sin * sin_theta;
        let sin_alpha = pose.cos * sin_theta - pose.sin * cos_theta;
        let candidate = Candidate {
            distance_m: e,
            cos_alpha,
            sin_alpha,
            cos_eta: cos_theta * cos_alpha - sin_theta * sin_alpha,
            sin_eta: sin_theta * cos_alpha + cos_theta * sin_alpha,
        };
        let lengths = candidate.lengths(self.curvature, self.config.margin_rad, wanted);
        let mut found = None;
        let mut limit = best;
        for (i, approach) in [Direction::Forward, Direction::Reverse]
            .into_iter()
            .enumerate()
        {
            let Some(length) = lengths[i] else { continue };
            let cost = spent + length + cusps[i];
            if cost < limit {
                limit = cost;
                found = Some((cost, approach));
            }
        }
        (least, found)
    }

    fn single(&self, search: &mut Search, motion: u8, steps: u16) {
        let (Some(unit), Some(&step)) = (
            self.segment(motion, self.config.single_step_m),
            self.single_steps.get(usize::from(motion)),
        ) else {
            search.stage = Stage::pair(0, MOTIONS.len() as u8, 0, 0);
            search.middle = [(search.start, true); 6];
            return;
        };
        if steps == 0 {
            search.here = search.start;
        }
        search.here = search.here.compose(step);
        let length = f32::from(steps + 1) * self.config.single_step_m;
        let spent = length + self.config.stop_price_m;
        let best = search.best.map(|plan| plan.cost_m);
        let (least, found) = self.evaluate(search.here, spent, Some(unit.direction), best);
        search.improve((Some(unit.with_length(length)), None), found);
        let exhausted = length >= self.longest(&unit) || best.is_some_and(|best| least >= best);
        let (motion, steps) = match exhausted {
            true => (motion + 1, 0),
            false => (motion, steps + 1),
        };
        search.stage = Stage::Single { motion, steps };
    }

    /// Lengthens the first segment of each motion by a step, once all second segments are tried.
    fn lengthen_first(&self, search: &mut Search, first_steps: u16, best: Option<f32>) {
        let step_m = self.config.pair_step_m;
        let length = f32::from(first_steps + 1) * step_m;
        let mut alive = false;
        for (motion, ((pose, open), &step)) in
            search.middle.iter_mut().zip(&self.pair_steps).enumerate()
        {
            let Some(unit) = self.segment(motion as u8, step_m) else {
                continue;
            };
            *pose = pose.compose(step);
            let least =
                length + 2.0 * self.config.stop_price_m + sqrt(pose.x * pose.x + pose.y * pose.y);
            *open = *open && length <= self.longest(&unit) && best.is_none_or(|best| least < best);
            alive |= *open;
        }
        search.stage = if alive {
            Stage::pair(first_steps + 1, 0, 0, 0)
        } else if search.best.is_some() {
            Stage::refine(0, 0.5 * step_m, false)
        } else {
            Stage::Finished
        };
    }

    fn pair(&self, search: &mut Search, first_steps: u16, first: u8, second: u8, steps: u16) {
        let step_m = self.config.pair_step_m;
        let best = search.best.map(|plan| plan.cost_m);
        if usize::from(first) >= MOTIONS.len() {
            self.lengthen_first(search, first_steps, best);
            return;
        }
        let next_first = Stage::pair(first_steps, first + 1, 0, 0);
        let next_second = Stage::pair(first_steps, first, second + 1, 0);
        let (Some(one), Some(two), Some(&step), Some(&(middle, open))) = (
            self.segment(first, f32::from(first_steps) * step_m),
            self.segment(second, step_m),
            self.pair_steps.get(usize::from(second)),
            search.middle.get(usize::from(first)),
        ) else {
            search.stage = next_first;
            return;
        };
        if !open {
            search.stage = next_first;
            return;
        }
        if one.curvature == two.curvature {
            // Both segments are on one circle: a single segment is enough.
            search.stage = next_second;
            return;
        }
        if steps == 0 {
            search.here = middle;
        }
        search.here = search.here.compose(step);
        let length = f32::from(steps + 1) * step_m;
        let spent = one.length_m + length + self.prices(one.direction, two.direction);
        let (least, found) = self.evaluate(search.here, spent, Some(two.direction), best);
        search.improve((Some(one), Some(two.with_length(length))), found);
        let exhausted = length >= self.longest(&two) || best.is_some_and(|best| least >= best);
        search.stage = match exhausted {
            true => next_second,
            false => Stage::pair(first_steps, first, second, steps + 1),
        };
    }

    /// Prices of two segments in these directions.
    fn prices(&self, one: Direction, two: Direction) -> f32 {
        let cusp = if one == two {
            0.0
        } else {
            self.config.cusp_price_m
        };
        2.0 * self.config.stop_price_m + cusp
    }

    fn refine(&self, search: &mut Search, change: u8, step_m: f32, helped: bool) {
        let Some(plan) = search.best else {
            search.stage = Stage::Finished;
            return;
        };
        let (da, db) = match change {
            0 => (-step_m, 0.0),
            1 => (step_m, 0.0),
            2 => (0.0, -step_m),
            3 => (0.0, step_m),
            4 => (-step_m, step_m),
            5 => (step_m, -step_m),
            6 => (-step_m, -step_m),
            _ => (step_m, step_m),
        };
        let lengthen = |segment: Option<Segment>, by: f32| {
            segment.map(|segment| segment.with_length(segment.length_m + by))
        };
        let (first, second) = (lengthen(plan.first, da), lengthen(plan.second, db));
        let allowed =
            |segment: Option<Segment>| segment.is_none_or(|segment| segment.length_m > 0.0);
        let improved = if allowed(first) && allowed(second) {
            let mut pose = search.start;
            let mut spent = 0.0;
            let mut last = None;
            for segment in first.into_iter().chain(second) {
                pose = pose.compose(Pose::arc(segment));
                spent += segment.length_m + self.config.stop_price_m;
                if last.is_some_and(|last| last != segment.direction) {
                    spent += self.config.cusp_price_m;
                }
                last = Some(segment.direction);
            }
            self.evaluate(pose, spent, last, Some(plan.cost_m)).1
        } else {
            None
        };
        search.improve((first, second), improved);
        let helped = helped || improved.is_some();
        search.stage = if change < 7 {
            Stage::refine(change + 1, step_m, helped)
        } else if helped {
            Stage::refine(0, step_m, false)
        } else if step_m > 2e-3 {
            Stage::refine(0, 0.5 * step_m, false)
        } else {
            Stage::Finished
        };
    }
}

#[cfg(test)]
mod tests;
