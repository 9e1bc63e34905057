//! Curve through axles at rest, from their postures alone.
//!
//! While the motors are off the frames straighten and the axles leave the curve that they drove on. Before the next
//! drive the curve is built anew through the axles.
//!
//! Curvature is linear between the axles and the middles of the frames. Over a frame of length S, with the turn Δφ and
//! the offset y of its front axle in the coordinates of its rear axle, small angles give
//!
//! ```text
//! κ_front = κ_rear + 6 Δφ/S − 12 y/S²        κ_middle = 6 y/S² − Δφ/S − κ_rear
//! ```
//!
//! so one curvature, that at the last axle, is free: the least squares of all curvatures choose it. Each frame is then
//! integrated, and its y and S corrected by what the small angles left; Δφ is exact. Beyond the ends the curvature
//! fades to 0.
//!
//! # Panic contract
//!
//! Nothing can fail. Cost of a frame: about 15 000 floating-point operations; the frames are done one by one.

use super::Direction;
use super::curve::{Curve, Knot};
use super::spacing::Link;
use crate::math::Posture;
use crate::math::trig::{atan2, clamp, wrap_angle};
use crate::topology::MAX_AXLES;

/// Corrections of offset and length of each frame.
const CORRECTIONS: usize = 3;
/// Parts of a frame in the integration of its corrections.
const PARTS: u16 = 8;
/// Knots beyond each end of the body.
const BEYOND: u16 = 4;

/// Curvatures (1/m) at the rear axle, at the middle and at the front axle of a frame.
#[derive(Clone, Copy)]
struct Bend {
    rear: f32,
    middle: f32,
    front: f32,
}

impl Bend {
    fn new(rear: f32, turn: f32, offset: f32, length: f32) -> Self {
        let turn = turn / length;
        let offset = offset / (length * length);
        Self {
            rear,
            middle: 6.0 * offset - turn - rear,
            front: rear + 6.0 * turn - 12.0 * offset,
        }
    }

    /// Curvature at the distance `u` (m) from the rear axle.
    fn at(&self, u: f32, length: f32) -> f32 {
        let share = clamp(2.0 * u / length, 0.0, 2.0);
        if share < 1.0 {
            self.rear + share * (self.middle - self.rear)
        } else {
            self.middle + (share - 1.0) * (self.front - self.middle)
        }
    }
}

/// Turn (rad), offset (m) and length of the curve (m) to `front` from `rear`.
fn measured(rear: Posture, front: Posture) -> [f32; 3] {
    let to = front.relative_to(rear);
    let chord = atan2(to.y, to.x);
    let (a, b) = (-chord, wrap_angle(to.phi - chord));
    let length = front.distance(rear) * (1.0 + (2.0 * a * a - a * b + 2.0 * b * b) / 30.0);
    [to.phi, to.y, length]
}

/// Curve under construction, from the last axle to the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rebuild {
    axles: [Posture; MAX_AXLES],
    places: [f32; MAX_AXLES],
    /// Number of frames that the curve does not pass yet.
    frames_left: usize,
    /// End of the part that is built: posture, and curvature at the axle there.
    at: Knot,
    /// Arc length of this end, m.
    passed: f32,
}

/// Lengths of the frames and of a cell of the curve, and the rate of curvature beyond the ends.
#[derive(Clone, Copy)]
pub(super) struct Measures {
    pub link: Link,
    /// Distance of the knots, m.
    pub pitch: f32,
    /// Rate at which the curvature falls beyond the ends, 1/m².
    pub slope: f32,
}

impl Measures {
    /// Length of a frame's curve (m), so that the curve has room for all frames.
    fn bounded(&self, length: f32) -> f32 {
        let straight = self.link.straight();
        clamp(length, 0.5 * straight, 1.25 * straight)
    }
}

impl Rebuild {
    /// Begins the curve at the last of `axles`, which stand front first.
    pub(super) fn new(curve: &mut Curve, axles: &[Posture], by: Measures) -> Self {
        let mut all = [Posture::ORIGIN; MAX_AXLES];
        for (to, from) in all.iter_mut().zip(axles) {
            *to = *from;
        }
        // Curvatures as functions of the first: κ0 + c at axles, d − κ0 at middles. The mean of c and −d is removed.
        let (mut sum, mut count, mut c) = (0.0, 1.0, 0.0);
        for pair in axles.windows(2).rev() {
            let &[front, rear] = pair else { continue };
            let [turn, offset, length] = measured(rear, front);
            let bend = Bend::new(c, turn, offset, by.bounded(length));
            sum += bend.front - bend.middle;
            count += 2.0;
            c = bend.front;
        }
        let at = Knot {
            posture: axles.last().copied().unwrap_or(Posture::ORIGIN),
            kappa: -sum / count,
        };
        curve.restart(at, by.pitch);
        Self {
            axles: all,
            places: [0.0; MAX_AXLES],
            frames_left: axles.len().saturating_sub(1),
            at,
            passed: 0.0,
        }
    }

    /// The axles that the curve passes, front first.
    pub(super) fn axles(&self) -> &[Posture; MAX_AXLES] {
        &self.axles
    }

    /// Leads the curve along the next frame. After the last frame, extends it beyond the ends and returns the places of
    /// the axles, m.
    pub(super) fn step(&mut self, curve: &mut Curve, by: Measures) -> Option<[f32; MAX_AXLES]> {
        let Some(axle) = self.frames_left.checked_sub(1) else {
            let shift = extend_beyond_ends(curve, by);
            return Some(self.places.map(|place| place + shift));
        };
        self.frames_left = axle;
        let front = self.axles.get(axle).copied()?;
        self.pass(curve, front, by);
        if let Some(place) = self.places.get_mut(axle) {
            *place = self.passed;
        }
        None
    }

    /// Leads the curve on to the axle at `front`.
    fn pass(&mut self, curve: &mut Curve, front: Posture, by: Measures) {
        let [turn, mut offset, length] = measured(self.at.posture, front);
        let mut length = by.bounded(length);
        let kappa = self.at.kappa;
        let mut bend = Bend::new(kappa, turn, offset, length);
        for _ in 0..CORRECTIONS {
            let mut end = self.at;
            let step = length / f32::from(PARTS);
            for part in 0..PARTS {
                let u = step * f32::from(part);
                end.kappa = bend.at(u, length);
                end = end.advance(step, (bend.at(u + step, length) - end.kappa) / step);
            }
            let missing = front.relative_to(end.posture);
            offset += missing.y;
            length = by.bounded(length + missing.x);
            bend = Bend::new(kappa, turn, offset, length);
        }
        let until = self.passed + length;
        while curve.length() < until {
            let next = curve.length() + by.pitch;
            curve.extend(Direction::Forward, bend.at(next - self.passed, length));
        }
        // What follows starts where the knots have led to.
        self.at = Knot {
            kappa: bend.front,
            ..curve.at(until).knot
        };
        self.passed = until;
    }
}

/// Extends the curve beyond both ends, to a curvature of 0; returns the change of all arc lengths, m.
fn extend_beyond_ends(curve: &mut Curve, by: Measures) -> f32 {
    let most = by.slope * by.pitch;
    let mut shift = 0.0;
    for direction in [Direction::Forward, Direction::Reverse] {
        for _ in 0..BEYOND {
            let kappa = curve.end(direction).kappa;
            shift += curve.extend(direction, kappa - clamp(kappa, -most, most));
        }
    }
    shift
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINK: Link = Link {
        length_m: 0.37,
        rigid_end_m: 0.0,
    };

    /// Axles of a robot whose frames have these relative postures (front axle in the coordinates of the rear axle).
    fn chain(frames: &[Posture]) -> Vec<Posture> {
        let mut axles = vec![Posture::new(0.3, -0.2, 2.9)];
        for frame in frames.iter().rev() {
            let ahead = axles.first().unwrap().compose(*frame);
            axles.insert(0, ahead);
        }
        axles
    }

    const BY: Measures = Measures {
        link: LINK,
        pitch: 0.0085,
        slope: 6.0,
    };

    /// A frame bent to an arc, with the axles turned by `psi` against its chord.
    fn arc(psi: f32) -> Posture {
        let chord = 0.37 * psi.sin() / psi;
        Posture::new(chord * psi.cos(), chord * psi.sin(), 2.0 * psi)
    }

    /// Postures of the axles on a new curve (front first), and the curvatures at the axles and at the middles.
    fn built(frames: &[Posture]) -> (Vec<[Posture; 2]>, Curve, [f32; 2]) {
        let (axles, mut curve) = (chain(frames), Curve::EMPTY);
        let mut work = Rebuild::new(&mut curve, &axles, BY);
        let places = (0..5).find_map(|_| work.step(&mut curve, BY)).unwrap();
        let own = &places[..axles.len()];
        let at_axles = own.iter().map(|s| curve.kappa(*s)).sum();
        let middles = own.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
        let at_middles = middles.map(|s| curve.kappa(s)).sum();
        let on = own.iter().map(|s| curve.at(*s).knot.posture);
        let pairs = axles.iter().zip(on).map(|(axle, on)| [*axle, on]).collect();
        (pairs, curve, [at_axles, at_middles])
    }

    /// The free curvature adds to those at the axles and subtracts from those at the middles, so the least squares make
    /// their sums equal; nearly, because the middles are found by small angles.
    #[test]
    fn curvatures_at_axles_and_middles_have_the_same_sum() {
        let all = [
            vec![arc(0.03), arc(-0.02)],
            vec![Posture::new(0.37, 0.004, 0.0), arc(0.01)],
            vec![arc(0.02), arc(0.01), Posture::new(0.37, -0.003, 0.01)],
        ];
        for frames in all {
            let (_, _, [axles, middles]) = built(&frames);
            assert!(
                (axles - middles).abs() < 5e-3,
                "{frames:?} {axles} {middles}"
            );
        }
    }

    #[test]
    fn curve_passes_through_bent_and_straight_axles() {
        let straight = Posture::new(0.37, 0.0, 0.0);
        let cases = [
            vec![straight; 4],
            vec![arc(0.3), arc(0.3)],
            vec![arc(0.4), arc(-0.4), arc(0.35)],
            vec![arc(0.2), straight, arc(-0.3), arc(0.1)],
            vec![
                Posture::new(0.368, 0.03, 0.0),
                Posture::new(0.36, 0.05, 0.4),
            ],
        ];
        for frames in cases {
            let (axles, curve, _) = built(&frames);
            for [axle, on] in axles {
                let off = on.relative_to(axle);
                assert!(off.x.abs().max(off.y.abs()) < 1.5e-3, "{frames:?} {off:?}");
                assert!(off.phi.abs() < 1.5e-3, "{frames:?} {off:?}");
            }
            for k in 0..150u16 {
                let kappa = curve.kappa(0.01 * f32::from(k));
                assert!(kappa.abs() < 5.0, "{frames:?} {kappa}");
            }
        }
    }
}
