//! Desired path of the leader: a leg of a plan, a path of the user, or a curvature.
//!
//! A guide keeps the point of the desired path that is nearest to the end of the curve, and advances with each knot.

use super::Direction;
use super::curve::Knot;
use super::leader::Desired;
use super::planner::Leg;
use crate::control::path::{PathBuffer, PathSample, TrajectoryBuffer};
use crate::math::Posture;
use crate::math::trig::{clamp, sin_cos, wrap_angle};
use core::f32::consts::PI;

/// Path of the user.
pub trait Route {
    /// The path at arc length `s` (m); `None` without points.
    fn at(&self, s: f32) -> Option<PathSample>;
    /// Arc length of the first point held, m.
    fn first(&self) -> f32;
    /// Arc length of the last point held, m.
    fn last(&self) -> f32;
    /// True if no more points will come.
    fn is_complete(&self) -> bool;
}

impl<const N: usize> Route for PathBuffer<N> {
    fn at(&self, s: f32) -> Option<PathSample> {
        self.at(s)
    }

    fn first(&self) -> f32 {
        self.start()
    }

    fn last(&self) -> f32 {
        self.end()
    }

    fn is_complete(&self) -> bool {
        self.is_complete()
    }
}

impl<const N: usize> Route for TrajectoryBuffer<N> {
    fn at(&self, s: f32) -> Option<PathSample> {
        self.at(s)
    }

    fn first(&self) -> f32 {
        self.bounds().map_or(0.0, |[first, _]| first)
    }

    fn last(&self) -> f32 {
        self.bounds().map_or(0.0, |[_, last]| last)
    }

    fn is_complete(&self) -> bool {
        self.is_complete()
    }
}

/// Step of the search for the nearest point of a path, m.
const SEARCH_STEP_M: f32 = 0.02;
/// Rate of curvature along a leg over the largest of plans.
const MARGIN: f32 = 1.2;
/// Weight of a heading error in this search, m².
const HEADING_WEIGHT_M2: f32 = 0.05;

/// A path that continues straight beyond its ends.
pub fn extended(route: &dyn Route, s: f32) -> Option<PathSample> {
    let within = clamp(s, route.first(), route.last());
    let at = route.at(within)?;
    let beyond = s - within;
    if beyond == 0.0 {
        return Some(at);
    }
    let (sin, cos) = sin_cos(at.posture.phi);
    Some(PathSample {
        posture: Posture {
            x: at.posture.x + beyond * cos,
            y: at.posture.y + beyond * sin,
            phi: at.posture.phi,
        },
        kappa: 0.0,
        kappa_slope: 0.0,
    })
}

/// Arc length (m) of the point nearest to `end` in position and heading, within `window` (m) of the first point.
pub fn entry(route: &dyn Route, end: Posture, window: f32) -> f32 {
    let first = route.first();
    let (mut best, mut least) = (first, f32::INFINITY);
    // The conversion saturates.
    for k in 0..=(window / SEARCH_STEP_M) as u8 {
        let s = first + SEARCH_STEP_M * f32::from(k);
        let Some(at) = extended(route, s) else {
            return best;
        };
        let off = end.relative_to(at.posture);
        let square = off.x * off.x + off.y * off.y + HEADING_WEIGHT_M2 * off.phi * off.phi;
        if square < least {
            (best, least) = (s, square);
        }
    }
    best
}

/// The point of a leg nearest to the end of the curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnLeg {
    /// The leg.
    pub leg: Leg,
    /// Posture in the direction of travel and the coordinates of the goal.
    posture: Posture,
    /// Distance from the start of the leg, m.
    pub u: f32,
}

impl OnLeg {
    /// A leg without length.
    pub const NEW: Self = Self {
        leg: Leg::NEW,
        posture: Posture::ORIGIN,
        u: 0.0,
    };

    /// The start of a leg.
    pub fn new(leg: Leg) -> Self {
        Self {
            leg,
            posture: leg.start,
            u: 0.0,
        }
    }

    /// Advances by `du` (m), also backwards.
    pub fn advance(&mut self, du: f32) {
        let (kappa, _) = self.leg.curvature(self.u);
        let (next, _) = self.leg.curvature(self.u + du);
        // A quotient of two tiny numbers may be infinite.
        let slope = if du.abs() > 1e-6 {
            (next - kappa) / du
        } else {
            0.0
        };
        let knot = Knot {
            posture: self.posture,
            kappa,
        };
        self.posture = knot.advance(du, slope).posture;
        self.u += du;
    }

    /// Posture of the point, facing forward, in the coordinates of `goal`.
    pub fn posture(&self, goal: Posture) -> Posture {
        let at = goal.compose(self.posture);
        match self.leg.direction {
            Direction::Forward => at,
            Direction::Reverse => Posture {
                phi: wrap_angle(at.phi + PI),
                ..at
            },
        }
    }

    /// Finds the point nearest to `end`, and gives the desired path for the next knot. `slope` (1/m²) bounds the
    /// feedback, so that it fades before the run-out.
    pub fn next(&mut self, end: Posture, goal: Posture, pitch: f32, slope: f32) -> Desired {
        let sign = self.leg.direction.sign();
        let ahead = sign * end.relative_to(self.posture(goal)).x;
        self.advance(clamp(ahead, -pitch, pitch));
        let posture = self.posture(goal);
        let left = self.leg.length() - self.leg.run_out() - self.u;
        let (kappa, _) = self.leg.curvature(self.u + pitch);
        self.advance(pitch);
        Desired {
            posture: Some(posture),
            kappa: sign * kappa,
            bound: 0.5 * slope * left.max(0.0),
            // A little more than that of the plan is left to the feedback.
            slope: MARGIN * slope,
        }
    }
}

/// Moves `u` to the point of the route nearest to `end`, and gives the desired path for the next knot. `None` without
/// points.
pub fn along(route: &dyn Route, u: &mut f32, end: Posture, pitch: f32) -> Option<Desired> {
    let ahead = end.relative_to(extended(route, *u)?.posture).x;
    *u += clamp(ahead, -pitch, pitch);
    let posture = extended(route, *u)?.posture;
    *u += pitch;
    let next = extended(route, *u)?;
    Some(Desired {
        posture: Some(posture),
        kappa: next.kappa,
        bound: f32::INFINITY,
        slope: next.kappa_slope,
    })
}

#[cfg(test)]
mod tests {
    use super::super::turn::Piece;
    use super::*;
    use crate::control::path::PathPoint;

    /// A path along the x axis from 5 m to 6 m of arc length.
    fn line() -> PathBuffer<128> {
        let mut path = PathBuffer::new();
        for k in 0..=100u8 {
            let x = 0.01 * f32::from(k);
            path.push(PathPoint {
                posture: Posture::new(x, 0.0, 0.0),
                kappa: 0.0,
                s: 5.0 + x,
            })
            .unwrap();
        }
        path
    }

    #[test]
    fn route_is_straight_beyond_both_ends() {
        let path = line();
        for (s, x) in [(4.5, -0.5), (5.25, 0.25), (6.7, 1.7)] {
            let at = extended(&path, s).unwrap();
            assert!((at.posture.x - x).abs() < 1e-5 && at.posture.y.abs() < 1e-6);
            assert_eq!(at.kappa, 0.0);
        }
        assert!(extended(&PathBuffer::<4>::new(), 0.0).is_none());
    }

    #[test]
    fn route_is_entered_at_the_nearest_point() {
        let path = line();
        for (x, y) in [(0.3, 0.2), (0.0, -0.1), (0.62, 0.0)] {
            let s = entry(&path, Posture::new(x, y, 0.1), 0.7);
            assert!((s - 5.0 - x).abs() < 0.011, "{x}: {s}");
        }
    }

    /// On an arc of 1 m the nearest point is that at the same angle.
    #[test]
    fn curved_route_is_entered_at_the_nearest_point() {
        let mut path = PathBuffer::<128>::new();
        let mut knot = Knot {
            kappa: 1.0,
            ..Knot::default()
        };
        for k in 0..80u8 {
            path.push(PathPoint {
                posture: knot.posture,
                kappa: 1.0,
                s: 0.01 * f32::from(k),
            })
            .unwrap();
            knot = knot.advance(0.01, 0.0);
        }
        for (angle, radius) in [(0.2f32, 1.0f32), (0.5, 0.25), (0.7, 1.2)] {
            let (x, y) = (radius * angle.sin(), 1.0 - radius * angle.cos());
            let s = entry(&path, Posture::new(x, y, angle), 0.8);
            assert!((s - angle).abs() < 0.011, "{angle}: {s}");
        }
    }

    /// Steps of the curve that are longer or shorter than those of the leg keep the nearest point.
    #[test]
    fn point_of_a_leg_stays_beside_the_end_of_the_curve() {
        for direction in [Direction::Forward, Direction::Reverse] {
            let mut leg = Leg {
                direction,
                ..Leg::NEW
            };
            leg.pieces[0] = Piece {
                length: 3.0,
                ..Piece::default()
            };
            let (mut on, goal) = (OnLeg::new(leg), Posture::new(0.4, -0.2, 0.7));
            let start = on.posture(goal);
            for k in 1..200u8 {
                let way = direction.sign() * 0.0108 * f32::from(k);
                let end = start.compose(Posture::new(way, 0.02, 0.0));
                let desired = on.next(end, goal, 0.01, 6.0);
                let off = end.relative_to(desired.posture.unwrap());
                // The first step is longer than the point may move.
                let most = if k > 1 { 1e-4 } else { 1e-3 };
                assert!(off.x.abs() < most && (off.y - 0.02).abs() < 1e-4, "{off:?}");
            }
        }
    }

    /// Curvature of the next knot for an axle that faces forward; the feedback fades before the run-out.
    #[test]
    fn leg_gives_its_curvature_one_knot_ahead_and_less_feedback_towards_the_run_out() {
        const RUN_OUT: f32 = 0.4;
        for direction in [Direction::Forward, Direction::Reverse] {
            let mut leg = Leg {
                direction,
                ..Leg::NEW
            };
            leg.pieces[0] = Piece {
                length: 0.5,
                from: 0.0,
                to: 2.0,
            };
            leg.pieces[1] = Piece {
                length: 0.25,
                from: 2.0,
                to: 0.0,
            };
            *leg.pieces.last_mut().unwrap() = Piece {
                length: RUN_OUT,
                ..Piece::default()
            };
            let (mut on, goal) = (OnLeg::new(leg), Posture::new(-0.2, 0.3, 2.0));
            for k in 0..110u8 {
                let u = 0.01 * f32::from(k);
                let here = on.posture(goal);
                let desired = on.next(here, goal, 0.01, 6.0);
                assert!(desired.posture.unwrap().distance(here) < 1e-6);
                let next = u + 0.01;
                let kappa = (4.0 * next).min(8.0 * (0.75 - next)).max(0.0);
                let expected = direction.sign() * kappa;
                assert!((desired.kappa - expected).abs() < 1e-3, "{u}: {desired:?}");
                // Half of the curvature that can still be removed before the run-out.
                let bound = 3.0 * (0.75 - u).max(0.0);
                assert!((desired.bound - bound).abs() < 1e-3, "{u}: {desired:?}");
                assert!(desired.slope > 6.0 && desired.slope < 8.0);
            }
        }
    }

    /// A clothoid with the curvature s: the nearest point, and the curvature one knot ahead.
    #[test]
    fn point_of_a_path_stays_beside_the_end_of_the_curve() {
        let mut path = PathBuffer::<256>::new();
        let mut knot = Knot::default();
        for k in 0..200u8 {
            let s = 0.01 * f32::from(k);
            path.push(PathPoint {
                posture: knot.posture,
                kappa: knot.kappa,
                s,
            })
            .unwrap();
            knot = knot.advance(0.01, 1.0);
        }
        let mut u = 0.0;
        for k in 1..170u8 {
            // Steps of the end that are longer than a knot.
            let s = 0.0108 * f32::from(k);
            let on = path.at(s).unwrap().posture;
            let end = on.compose(Posture::new(0.0, 0.02, 0.1));
            let desired = along(&path, &mut u, end, 0.01).unwrap();
            let off = end.relative_to(desired.posture.unwrap());
            // The first step is longer than the point may move.
            let most = if k > 1 { 2e-4 } else { 1e-3 };
            assert!(off.x.abs() < most && (off.y - 0.02).abs() < 2e-4, "{off:?}");
            assert!((u - s - 0.01).abs() < 2e-3, "{u} {s}");
            assert!((desired.kappa - s - 0.01).abs() < 2e-3, "{s}: {desired:?}");
            assert_eq!(desired.bound, f32::INFINITY);
        }
    }
}
