//! Virtual leader: extends the curve along a desired path, within limits of curvature and of its rate.
//!
//! The leader drives ahead of the first axle, knot by knot. The curvature of the next knot is that of the desired path
//! plus a feedback of the deviation of the end of the curve. On the path the curve is the path. If the robot began
//! beside the path, or an estimate was corrected, the curve returns smoothly and all axles follow in its trace.
//!
//! The feedback is y'' = −(2/λ) (y' + y/(2λ)) with the deviation y, its derivative along the path y', and the length
//! constant λ: critically damped. The remaining turn δ bounds the feedback by √(δ κ′_max), so that the curvature can
//! be removed in time within the limit of its rate. The angle y/(2λ) at which the curve approaches the path is limited,
//! so that a large deviation does not turn the curve in a circle.
//!
//! # Panic contract
//!
//! Nothing can fail. A desired path that is not finite gives the limits of the curvature or keeps it.

use super::Direction;
use super::curve::Knot;
use crate::math::Posture;
use crate::math::trig::{clamp, sqrt};
use crate::math::{greater, lesser};

/// Largest angle between curve and desired path, rad.
const APPROACH_RAD: f32 = 0.7;

/// Desired path at the end of the curve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Desired {
    /// Nearest posture of the path, facing forward; `None` if there is only a curvature.
    pub posture: Option<Posture>,
    /// Curvature at the next knot, 1/m, positive to the left of an axle that faces forward.
    pub kappa: f32,
    /// Largest magnitude of the feedback, 1/m.
    pub bound: f32,
    /// Rate of curvature of the path, 1/m².
    pub slope: f32,
}

/// Limits and length constant of the virtual leader.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leader {
    /// Largest curvature, 1/m.
    pub kappa: f32,
    /// Largest rate of curvature of plans and of the feedback, 1/m².
    pub slope: f32,
    /// Largest rate of curvature where the path of the user has it, 1/m².
    pub steepest: f32,
    /// Length constant λ, m.
    pub length: f32,
}

impl Leader {
    /// Curvature (1/m) of the knot that follows `end` at the distance `pitch` (m).
    pub fn next(&self, end: &Knot, pitch: f32, direction: Direction, desired: &Desired) -> f32 {
        let feedback = desired.posture.map_or(0.0, |path| {
            let off = end.posture.relative_to(path);
            let angle = clamp(0.5 * off.y / self.length, -APPROACH_RAD, APPROACH_RAD);
            let turn = direction.sign() * off.phi + angle;
            let feedback = -2.0 / self.length * turn;
            let bound = lesser(desired.bound, sqrt(self.slope * turn.abs()));
            clamp(feedback, -bound, bound)
        });
        let wanted = clamp(desired.kappa + feedback, -self.kappa, self.kappa);
        let own = lesser(desired.slope.abs(), self.steepest);
        let change = greater(own, self.slope) * pitch;
        clamp(wanted, end.kappa - change, end.kappa + change)
    }
}

#[cfg(test)]
mod tests {
    use super::super::curve::Curve;
    use super::*;

    const LEADER: Leader = Leader {
        kappa: 2.3,
        slope: 6.0,
        steepest: 8.0,
        length: 0.25,
    };

    /// Drives beside the x axis from (0, y, phi); returns y and heading after `length` metres, and the largest |y|.
    fn beside(direction: Direction, y: f32, phi: f32, length: f32) -> [f32; 3] {
        let mut curve = Curve::EMPTY;
        let posture = Posture::new(0.0, y, phi);
        let knot = Knot {
            posture,
            kappa: 0.0,
        };
        curve.restart(knot, 0.01);
        let mut largest = 0.0f32;
        for _ in 0..(100.0 * length) as usize {
            let end = curve.end(direction);
            largest = largest.max(end.posture.y.abs());
            let desired = Desired {
                posture: Some(Posture::new(end.posture.x, 0.0, 0.0)),
                kappa: 0.0,
                bound: f32::INFINITY,
                slope: 0.0,
            };
            let kappa = LEADER.next(&end, 0.01, direction, &desired);
            assert!(kappa.abs() <= 2.3 && (kappa - end.kappa).abs() <= 0.060_01);
            curve.extend(direction, kappa);
        }
        let end = curve.end(direction).posture;
        [end.y, end.phi, largest]
    }

    #[test]
    fn deviation_fades_in_both_directions_without_a_circle() {
        for direction in [Direction::Forward, Direction::Reverse] {
            for (y, phi) in [(0.05, 0.0), (-0.3, 0.2), (1.0, -0.5), (0.0, 0.6)] {
                let [left, turn, largest] = beside(direction, y, phi, 4.0);
                assert!(left.abs() < 2e-3 && turn.abs() < 5e-3, "{y} {phi}: {left}");
                assert!(largest < y.abs() + 0.35, "{largest}");
            }
        }
    }

    /// Small deviations: y = y0 (1 + s/λ) e^(−s/λ).
    #[test]
    fn small_deviation_decays_critically_damped() {
        let [y, _, _] = beside(Direction::Forward, 5e-3, 0.0, 0.5);
        let expected = 5e-3 * 3.0 * (-2.0f32).exp();
        assert!((y - expected).abs() < 2e-4, "{y} {expected}");
    }
}
