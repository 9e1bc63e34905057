//! Planner: a path of the leading axle to the goal, of clothoid turns and straights with at most one cusp.
//!
//! The last part of a plan is *turn, straight, turn* and a run-out as long as the body: the frames end straight. Either
//! end of the robot may lead. A plan with a cusp begins with a *prelude* (turn, straight) led by one end; the
//! other end leads the last part. The other end begins where the prelude has put it: one body behind the leader, on the
//! prelude or on the present curve.
//!
//! # Theory
//!
//! A turn by δ has a chord of the length c(δ) that points along δ/2 ([`super::turn`]). From the posture (p, φ) to the
//! target posture (p', φ'), the straight between the turns δ and δ' = φ' − φ − δ + 2πk is the vector
//!
//! ```text
//! w = p' − p − c(δ) e(φ + δ/2) − c(δ') e(φ' − δ'/2)
//! ```
//!
//! A plan exists where w points along φ + δ. The root of w × e(φ + δ) is bracketed by a scan over δ for k = −1, 0, 1,
//! then bisected. Preludes stand on a grid, which is refined around the best plan.
//!
//! The search is incremental: [`Planner::step`] evaluates a given number of candidates and returns. A candidate costs
//! about 190 instructions, 4 µs on a Cortex-M4F at 168 MHz. A whole search takes at most 33 000 candidates (120 random
//! starts of three axles): 1.3 s at 250 an epoch.
//!
//! # Coordinates
//!
//! Those of the goal, with postures in the direction of travel: in reverse the heading is turned by π and the curvature
//! changes its sign.
//!
//! # Panic contract
//!
//! [`Planner::new`] takes checked limits; nothing can fail. A posture that is not finite yields no plan.

use super::Direction;
use super::curve::{Curve, Knot};
use super::turn::{Piece, Turns};
use crate::math::Posture;
use crate::math::trig::{hypot, sin_cos, wrap_angle};
use core::f32::consts::{PI, TAU};

/// Pieces of a leg: straighten, turn, straight, turn, run-out.
pub const PIECES: usize = 9;
/// Largest angle of a turn in the scan, rad.
const WIDEST: f32 = 5.0;
/// Samples of the scan over the first turn.
const SCAN: u8 = 51;
/// Bisections of a root: 1e-6 rad.
const BISECTIONS: u32 = 17;
/// Turns of the preludes, rad.
const TURNS: [f32; 13] = [
    0.0, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2, 1.6, -1.6, 2.2, -2.2, 2.8, -2.8,
];
/// Straights of the preludes, m.
const STRAIGHTS: [f32; 8] = [0.0, 0.15, 0.3, 0.5, 0.7, 1.0, 1.3, 1.7];
/// Longest step of the integration along a leg, m: error below 1e-6 of the length.
const STRIDE: f32 = 0.15;
/// Refinements of the grid: turn (rad) and straight (m), halved at each level.
const REFINE: (f32, f32) = (0.2, 0.1);
/// Least gain for which a plan replaces the best, m.
const GAIN_M: f32 = 1e-3;
/// Levels of the refinement.
const LEVELS: u8 = 4;

/// Part of a plan between two stops, driven by one end of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    /// End that leads.
    pub direction: Direction,
    /// Posture of the leading axle at the start, in the direction of travel and the coordinates of the goal.
    pub start: Posture,
    /// Pieces in the order of travel.
    pub pieces: [Piece; PIECES],
}

impl Leg {
    /// A leg without length.
    pub const NEW: Self = Self {
        direction: Direction::Forward,
        start: Posture::ORIGIN,
        pieces: [Piece {
            length: 0.0,
            from: 0.0,
            to: 0.0,
        }; PIECES],
    };

    /// Length, m.
    pub fn length(&self) -> f32 {
        self.pieces.iter().map(|piece| piece.length).sum()
    }

    /// Length of the last piece, m.
    pub fn run_out(&self) -> f32 {
        self.pieces.last().map_or(0.0, |piece| piece.length)
    }

    /// Curvature (1/m) after the distance `u` (m), and its rate (1/m²); 0 beyond the ends.
    pub fn curvature(&self, u: f32) -> (f32, f32) {
        let mut left = u;
        for piece in self.pieces {
            let Some(slope) = piece.slope() else {
                continue;
            };
            if left < piece.length {
                return (piece.from + slope * left, slope);
            }
            left -= piece.length;
        }
        (0.0, 0.0)
    }

    /// Posture and curvature after the distance `u` (m).
    fn point(&self, u: f32) -> Knot {
        let mut knot = Knot {
            posture: self.start,
            kappa: 0.0,
        };
        let mut left = u;
        for piece in self.pieces {
            let Some(slope) = piece.slope() else {
                continue;
            };
            knot.kappa = piece.from;
            let mut rest = piece.length.min(left);
            left -= rest;
            // At most 30 strides: no piece is longer than a full turn or the longest straight.
            while rest > 0.0 {
                let ds = rest.min(STRIDE);
                knot = knot.advance(ds, slope);
                rest -= ds;
            }
            if !(left > 0.0) {
                return knot;
            }
        }
        knot.advance(left, 0.0)
    }
}

/// A plan: a prelude if there is a cusp, and the leg that ends on the goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Leg before the cusp.
    pub prelude: Option<Leg>,
    /// Leg that ends on the goal.
    pub last: Leg,
    /// Length of the plan with its price, m.
    pub cost_m: f32,
}

/// The robot at rest on its curve.
#[derive(Clone, Copy, Debug)]
pub struct Robot<'a> {
    /// The curve of the axles.
    pub curve: &'a Curve,
    /// Place of the first axle, m.
    pub front: f32,
    /// Place of the last axle, m.
    pub rear: f32,
}

impl Robot<'_> {
    fn place(&self, direction: Direction) -> f32 {
        match direction {
            Direction::Forward => self.front,
            Direction::Reverse => self.rear,
        }
    }
}

/// Outcome of a search so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// The search goes on.
    Working,
    /// The best plan found.
    Found(Plan),
    /// No plan of this kind exists.
    Impossible,
}

/// Prelude under examination: leading end, turn (rad) and straight (m).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Prelude {
    direction: Direction,
    turn: f32,
    straight: f32,
}

/// Stage of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Plans without a cusp, led by this end.
    Direct(Direction),
    /// Plans with a cusp: leading end of the prelude, index of turn and of straight.
    Grid(Direction, u8, u8),
    /// Changes of the best prelude: level, index of the change.
    Refine(u8, u8),
    Finished,
}

/// Scan over the first turn of the last leg.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Scan {
    prelude: Option<Leg>,
    chosen: Prelude,
    /// The last leg, whose turns are sought.
    leg: Leg,
    /// Posture after the first curvature is removed.
    start: Posture,
    /// Cost before the first turn, with the run-out, m.
    spent: f32,
    index: u8,
    /// Values of the last sample for each k.
    before: [Option<Straight>; 3],
}

/// Remaining way and angle from the end of the first turn to the target.
#[derive(Clone, Copy, Debug)]
struct Turned {
    /// Way along the direction after the turn and to its left, m.
    way: [f32; 2],
    /// Angle within ±π less the first turn, rad.
    left: f32,
}

/// The straight between two turns.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Straight {
    /// Distance of the target from the line of the straight, m.
    off: f32,
    /// Length; negative if the straight would be driven backwards, m.
    length: f32,
    /// The second turn, rad.
    second: f32,
}

/// A search in progress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    goal: Posture,
    best: Best,
    stage: Stage,
    scan: Option<Scan>,
    /// Candidates evaluated beyond the budget.
    debt: u32,
}

/// Best plan so far.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Best {
    plan: Option<Plan>,
    /// Its prelude.
    chosen: Prelude,
    /// True if it was found on the present level of the refinement.
    is_new: bool,
}

impl Best {
    /// Cost that a plan must be below, m.
    fn limit(&self) -> f32 {
        self.plan.as_ref().map_or(f32::INFINITY, |plan| plan.cost_m)
    }
}

/// Planner with its limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planner {
    turns: Turns,
    /// Distance of the first axle from the last one on a straight, m.
    body: f32,
    cusp_price: f32,
}

const fn other(direction: Direction) -> Direction {
    match direction {
        Direction::Forward => Direction::Reverse,
        Direction::Reverse => Direction::Forward,
    }
}

/// The same point seen by a robot that drives the other way.
fn reversed(knot: Knot) -> Knot {
    Knot {
        posture: Posture {
            phi: wrap_angle(knot.posture.phi + PI),
            ..knot.posture
        },
        kappa: -knot.kappa,
    }
}

impl Planner {
    /// A planner for turns within limits and a body of the length `body` (m). A cusp costs as much as `cusp_price` (m).
    pub fn new(turns: Turns, body: f32, cusp_price: f32) -> Self {
        Self {
            turns,
            body,
            cusp_price,
        }
    }

    /// Begins the search for a plan that brings the midpoint of the robot to `goal`.
    pub fn start(&self, goal: Posture) -> Search {
        Search {
            goal,
            best: Best {
                plan: None,
                chosen: Prelude::default(),
                is_new: false,
            },
            stage: match goal.is_finite() {
                true => Stage::Direct(Direction::Forward),
                false => Stage::Finished,
            },
            scan: None,
            debt: 0,
        }
    }

    /// Evaluates about `budget` candidates for the robot at rest; the robot must not have moved since the start.
    pub fn step(&self, search: &mut Search, robot: Robot<'_>, budget: u32) -> Progress {
        // The last candidates of a call may exceed the budget: the next call has less.
        let mut left = budget.saturating_sub(search.debt);
        search.debt = search.debt.saturating_sub(budget);
        while left > 0 && search.stage != Stage::Finished {
            let cost = match &mut search.scan {
                Some(scan) if scan.index < SCAN => self.sample(scan, &mut search.best),
                _ => self.next(search, robot),
            };
            search.debt += cost.saturating_sub(left);
            left = left.saturating_sub(cost);
        }
        match search.stage {
            Stage::Finished => search
                .best
                .plan
                .map_or(Progress::Impossible, Progress::Found),
            _ => Progress::Working,
        }
    }

    /// Point at the place `s` of the curve, in coordinates of the goal and the direction of travel.
    fn on_curve(&self, search: &Search, robot: Robot<'_>, s: f32, direction: Direction) -> Knot {
        let knot = robot.curve.at(s).knot;
        let knot = Knot {
            posture: knot.posture.relative_to(search.goal),
            ..knot
        };
        match direction {
            Direction::Forward => knot,
            Direction::Reverse => reversed(knot),
        }
    }

    /// Posture of the leader, in the direction of travel, where the run-out to the goal begins.
    fn target(&self, direction: Direction) -> Posture {
        match direction {
            Direction::Forward => Posture::new(-0.5 * self.body, 0.0, 0.0),
            Direction::Reverse => Posture::new(0.5 * self.body, 0.0, PI),
        }
    }

    /// Begins the next scan; returns the number of candidates that it costs.
    fn next(&self, search: &mut Search, robot: Robot<'_>) -> u32 {
        let (chosen, stage) = match search.stage {
            Stage::Direct(direction) => {
                let from = self.on_curve(search, robot, robot.place(direction), direction);
                search.stage = match direction {
                    Direction::Forward => Stage::Direct(Direction::Reverse),
                    Direction::Reverse => Stage::Grid(Direction::Forward, 0, 1),
                };
                self.scan(search, from, direction, None, Prelude::default());
                return 2;
            }
            Stage::Grid(direction, turn, straight) => {
                let (Some(&angle), Some(&length)) = (
                    TURNS.get(usize::from(turn)),
                    STRAIGHTS.get(usize::from(straight)),
                ) else {
                    search.stage = match (direction, usize::from(turn) >= TURNS.len()) {
                        (_, false) => Stage::Grid(direction, turn + 1, 0),
                        (Direction::Forward, true) => Stage::Grid(Direction::Reverse, 0, 1),
                        (Direction::Reverse, true) => Stage::Refine(0, 0),
                    };
                    return 1;
                };
                let chosen = Prelude {
                    direction,
                    turn: angle,
                    straight: length,
                };
                (chosen, Stage::Grid(direction, turn, straight + 1))
            }
            Stage::Refine(level, change) => {
                let best = &mut search.best;
                let direct = best.plan.as_ref().is_none_or(|plan| plan.prelude.is_none());
                if level >= LEVELS || direct {
                    search.stage = Stage::Finished;
                    return 1;
                }
                let share = 1.0 / f32::from(1u8 << level.min(7));
                best.is_new &= change > 0;
                let mut chosen = best.chosen;
                match change {
                    0 => chosen.turn += share * REFINE.0,
                    1 => chosen.turn -= share * REFINE.0,
                    2 => chosen.straight += share * REFINE.1,
                    3 => chosen.straight -= share * REFINE.1,
                    _ => {
                        search.stage = Stage::Refine(level + u8::from(!best.is_new), 0);
                        return 1;
                    }
                }
                chosen.straight = chosen.straight.max(0.0);
                (chosen, Stage::Refine(level, change + 1))
            }
            Stage::Finished => return 1,
        };
        search.stage = stage;
        self.prelude(search, robot, chosen);
        10
    }

    /// Begins the scan after the prelude `chosen`.
    fn prelude(&self, search: &mut Search, robot: Robot<'_>, chosen: Prelude) {
        let Prelude {
            direction,
            turn,
            straight,
        } = chosen;
        let place = robot.place(direction);
        let from = self.on_curve(search, robot, place, direction);
        let [up, arc, down] = self.turns.pieces(turn);
        let mut leg = Leg {
            direction,
            start: from.posture,
            ..Leg::NEW
        };
        let ahead = Piece {
            length: straight,
            ..Piece::default()
        };
        let pieces = [self.turns.straighten(from.kappa), up, arc, down, ahead];
        for (slot, piece) in leg.pieces.iter_mut().zip(pieces) {
            *slot = piece;
        }
        let length = leg.length();
        let back = robot.front - robot.rear - length;
        let then = other(direction);
        let begin = if back > 0.0 {
            self.on_curve(search, robot, place - direction.sign() * back, then)
        } else {
            reversed(leg.point(-back))
        };
        self.scan(search, begin, then, Some(leg), chosen);
    }

    /// Begins the scan over the first turn of a last leg that starts at `from`, unless it cannot be the best.
    fn scan(
        &self,
        search: &mut Search,
        from: Knot,
        direction: Direction,
        prelude: Option<Leg>,
        chosen: Prelude,
    ) {
        let straighten = self.turns.straighten(from.kappa);
        let mut leg = Leg {
            direction,
            start: from.posture,
            ..Leg::NEW
        };
        if let Some(first) = leg.pieces.first_mut() {
            *first = straighten;
        }
        let start = leg.point(straighten.length).posture;
        let before = prelude.map_or(0.0, |leg| leg.length() + self.cusp_price);
        let spent = before + straighten.length + self.body;
        let target = self.target(direction);
        let way = hypot(target.x - start.x, target.y - start.y);
        if !(spent + way < search.best.limit()) {
            return;
        }
        search.scan = Some(Scan {
            prelude,
            chosen,
            leg,
            start,
            spent,
            index: 0,
            before: [None; 3],
        });
    }

    /// The way to the target after the first turn `first` (rad).
    fn turned(&self, scan: &Scan, first: f32) -> Turned {
        let target = self.target(scan.leg.direction);
        let (sin, cos) = sin_cos(scan.start.phi + first);
        let (x, y) = (target.x - scan.start.x, target.y - scan.start.y);
        let [along, across] = self.turns.chord(first);
        Turned {
            way: [cos * x + sin * y - along, cos * y - sin * x + across],
            left: wrap_angle(target.phi - scan.start.phi) - first,
        }
    }

    /// The straight before a second turn that differs by 2πk from the angle that is left.
    fn straight(&self, turned: &Turned, k: f32) -> Option<Straight> {
        let second = turned.left + TAU * k;
        if !(second.abs() <= TAU) {
            return None;
        }
        let [along, across] = self.turns.chord(second);
        let [x, y] = turned.way;
        Some(Straight {
            off: y - across,
            length: x - along,
            second,
        })
    }

    /// Samples the scan at its next turn and solves the brackets found; returns the number of candidates evaluated.
    fn sample(&self, scan: &mut Scan, best: &mut Best) -> u32 {
        let step = 2.0 * WIDEST / f32::from(SCAN - 1);
        let first = step * f32::from(scan.index) - WIDEST;
        scan.index += 1;
        let mut cost = 0;
        let before = scan.before;
        let turned = self.turned(scan, first);
        for (i, (k, last)) in [-1.0, 0.0, 1.0].into_iter().zip(before).enumerate() {
            let now = self.straight(&turned, k);
            cost += 1;
            if let Some(slot) = scan.before.get_mut(i) {
                *slot = now;
            }
            let (Some(last), Some(now)) = (last, now) else {
                continue;
            };
            // A root with a straight of length 0 may lie between a positive and a negative length.
            let bracketed = (last.off <= 0.0) != (now.off <= 0.0);
            if !bracketed || !(last.length.max(now.length) >= 0.0) {
                continue;
            }
            let least = scan.spent
                + self
                    .turns
                    .length(first)
                    .min(self.turns.length(first - step))
                + self
                    .turns
                    .length(now.second)
                    .min(self.turns.length(last.second))
                + last.length.min(now.length).max(0.0);
            if least < best.limit() + 0.1 {
                cost += BISECTIONS;
                self.solve(best, scan, [first - step, first], last.off <= 0.0, k);
            }
        }
        cost
    }

    /// Bisects the first turn within a bracket and keeps the plan if it is the best.
    fn solve(&self, best: &mut Best, scan: &Scan, bracket: [f32; 2], below: bool, k: f32) {
        let [mut low, mut high] = bracket;
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            match self.straight(&self.turned(scan, middle), k) {
                Some(straight) if (straight.off <= 0.0) == below => low = middle,
                _ => high = middle,
            }
        }
        let first = 0.5 * (low + high);
        let Some(straight) = self.straight(&self.turned(scan, first), k) else {
            return;
        };
        if !(straight.length >= 0.0) {
            return;
        }
        let turns = self.turns.length(first) + self.turns.length(straight.second);
        let cost_m = scan.spent + turns + straight.length;
        if !(cost_m < best.limit() - GAIN_M) {
            return;
        }
        let mut last = scan.leg;
        let ahead = |length| Piece {
            length,
            ..Piece::default()
        };
        let [a, b, c] = self.turns.pieces(first);
        let [d, e, f] = self.turns.pieces(straight.second);
        let pieces = [a, b, c, ahead(straight.length), d, e, f, ahead(self.body)];
        for (slot, piece) in last.pieces.iter_mut().skip(1).zip(pieces) {
            *slot = piece;
        }
        *best = Best {
            plan: Some(Plan {
                prelude: scan.prelude,
                last,
                cost_m,
            }),
            chosen: scan.chosen,
            is_new: true,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODY: f32 = 0.74;
    const KAPPA: f32 = 2.3;
    const SLOPE: f32 = 6.0;

    fn planner() -> Planner {
        Planner::new(Turns::new(KAPPA, SLOPE), BODY, 0.2)
    }

    /// A straight curve whose middle is at `center`, and the places of the ends.
    fn standing(center: Posture) -> (Curve, [f32; 2]) {
        let mut curve = Curve::EMPTY;
        let posture = center.compose(Posture::new(-0.5 * BODY - 0.02, 0.0, 0.0));
        curve.restart(
            Knot {
                posture,
                kappa: 0.0,
            },
            0.01,
        );
        for _ in 0..80 {
            curve.extend(Direction::Forward, 0.0);
        }
        (curve, [0.02 + BODY, 0.02])
    }

    fn solve(center: Posture, goal: Posture, budget: u32) -> (Option<Plan>, u32) {
        let (curve, [front, rear]) = standing(center);
        let robot = Robot {
            curve: &curve,
            front,
            rear,
        };
        let planner = planner();
        let (mut search, mut calls) = (planner.start(goal), 0);
        loop {
            calls += 1;
            match planner.step(&mut search, robot, budget) {
                Progress::Working => assert!(calls * budget < 60_000, "{center:?} {goal:?}"),
                Progress::Found(plan) => return (Some(plan), calls),
                Progress::Impossible => return (None, calls),
            }
        }
    }

    /// Posture (x, y, heading) of a leg at the distance `until` by fine integration in f64.
    fn integrated(leg: &Leg, until: f64) -> [f64; 3] {
        let [mut x, mut y, mut phi] = [leg.start.x, leg.start.y, leg.start.phi].map(f64::from);
        let mut left = until;
        for piece in leg.pieces {
            let length = f64::from(piece.length).min(left);
            left -= length;
            let n = (length * 5e3) as usize + 1;
            let h = length / n as f64;
            for i in 0..n {
                let share = h * (i as f64 + 0.5) / f64::from(piece.length).max(1e-12);
                let kappa = f64::from(piece.from) + share * f64::from(piece.to - piece.from);
                x += h * (phi + 0.5 * h * kappa).cos();
                y += h * (phi + 0.5 * h * kappa).sin();
                phi += h * kappa;
            }
        }
        [x, y, phi]
    }

    fn within(leg: &Leg) {
        let mut last = leg.pieces[0].from;
        for piece in leg.pieces.iter().filter(|piece| piece.length > 1e-4) {
            assert!(piece.from.abs().max(piece.to.abs()) <= KAPPA);
            assert!((piece.to - piece.from).abs() <= 1.001 * SLOPE * piece.length + 1e-6);
            assert!((piece.from - last).abs() < 1e-3, "{leg:?}");
            last = piece.to;
        }
    }

    /// Differences of position and of heading.
    fn apart(a: [f64; 3], b: [f64; 3]) -> (f64, f64) {
        let turn = a[2] - b[2];
        (
            (a[0] - b[0]).hypot(a[1] - b[1]),
            turn.sin().atan2(turn.cos()).abs(),
        )
    }

    #[test]
    fn every_start_has_a_plan_that_ends_on_the_goal_within_the_limits() {
        let (mut random, mut longest) = (1u32, 0);
        let mut number = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 8) as f32 / (1u32 << 23) as f32 - 1.0
        };
        for _ in 0..120 {
            let center = Posture::new(2.0 * number(), 2.0 * number(), PI * number());
            let goal = Posture::new(0.5 * number(), 0.5 * number(), PI * number());
            let (plan, calls) = solve(center, goal, 100);
            longest = longest.max(100 * calls);
            let plan = plan.unwrap();
            within(&plan.last);
            let sign = f64::from(plan.last.direction.sign());
            let end = integrated(&plan.last, f64::INFINITY);
            let heading = if sign > 0.0 {
                0.0
            } else {
                core::f64::consts::PI
            };
            let goal_end = [sign * 0.5 * f64::from(BODY), 0.0, heading];
            let (off, turn) = apart(end, goal_end);
            assert!(
                off < 2e-4 && turn < 1e-4,
                "{center:?} {goal:?}: {off} {turn}"
            );
            assert_eq!(plan.last.run_out(), BODY);
            // The first leg begins at the end that leads.
            let first = plan.prelude.unwrap_or(plan.last);
            let side = Posture::new(0.5 * first.direction.sign() * BODY, 0.0, 0.0);
            let place = center.compose(side).relative_to(goal);
            assert!(place.distance(first.start) < 1e-5);
            if let Some(prelude) = plan.prelude {
                within(&prelude);
                assert_ne!(prelude.direction, plan.last.direction);
                // One body behind the leader: on the prelude, or on the straight where the robot stood.
                let back = f64::from(prelude.length() - BODY);
                let [x, y, phi] = match back {
                    0.0.. => integrated(&prelude, back),
                    _ => {
                        let [x, y, phi] =
                            [prelude.start.x, prelude.start.y, prelude.start.phi].map(f64::from);
                        [x + back * phi.cos(), y + back * phi.sin(), phi]
                    }
                };
                let start = [plan.last.start.x, plan.last.start.y, plan.last.start.phi];
                let behind = [x, y, phi + core::f64::consts::PI];
                let (off, turn) = apart(start.map(f64::from), behind);
                assert!(off < 1e-4 && turn < 1e-4, "{off} {turn}");
            }
        }
        println!("at most {longest} candidates");
        assert!(longest <= 45_000, "{longest}");
    }

    #[test]
    fn straight_way_to_the_goal_is_the_plan_straight_ahead() {
        for (x, direction) in [(-2.0, Direction::Forward), (1.5, Direction::Reverse)] {
            let plan = solve(Posture::new(x, 0.0, 0.0), Posture::ORIGIN, 400)
                .0
                .unwrap();
            assert_eq!((plan.prelude, plan.last.direction), (None, direction));
            assert!((plan.cost_m - f32::abs(x)).abs() < 2e-3, "{}", plan.cost_m);
        }
    }

    /// A goal a few centimetres beside needs a cusp, and costs a run-out at least.
    #[test]
    fn goal_close_beside_is_reached_by_driving_away() {
        for goal in [
            Posture::new(0.0, 0.05, 0.0),
            Posture::new(0.03, -0.1, 0.1),
            Posture::new(0.05, 0.0, 0.0),
        ] {
            let plan = solve(Posture::ORIGIN, goal, 400).0.unwrap();
            assert!(plan.prelude.is_some() && plan.cost_m > BODY, "{goal:?}");
            assert!(plan.cost_m < 4.5, "{goal:?} {}", plan.cost_m);
        }
    }

    #[test]
    fn search_does_not_depend_on_the_budget_and_nan_has_no_plan() {
        let (center, goal) = (Posture::new(0.4, -0.6, 2.0), Posture::new(0.1, 0.2, 0.3));
        let [(one, many), (other, few)] = [37, 5000].map(|budget| solve(center, goal, budget));
        assert_eq!(one, other);
        // The work is the same, so a small budget takes more calls.
        assert!(many > 50 * few, "{many} {few}");
        let lost = Posture::new(f32::NAN, 0.0, 0.0);
        assert_eq!(solve(center, lost, 400).0, None);
        assert_eq!(solve(lost, goal, 400).0, None);
    }
}
