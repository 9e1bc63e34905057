//! Curve on which all axles drive: knots at a fixed pitch, from behind the last axle to ahead of the first.
//!
//! The arc length s is counted from the first knot, forward: heading and curvature are those of an axle that faces
//! forward on the curve, also while the robot reverses. Between knots the curvature is linear, so each part is a
//! clothoid; its chord is integrated with two Gauss points (error below 1e-8 m at a pitch of 1 cm and 3 1/m).
//!
//! The knots stand in a ring. A knot appended at one end drops the oldest knot at the other end once the ring is full.
//!
//! # Panic contract
//!
//! Nothing can fail: a place beyond an end of the curve continues straight on, and a curve without knots is the origin.

use super::Direction;
use crate::math::Posture;
use crate::math::trig::{sin_cos, wrap_angle};

/// Number of knots that a curve can hold.
pub const KNOTS: usize = 224;
/// Position of the two Gauss points on [0, 1].
const GAUSS: [f32; 2] = [0.211_324_87, 0.788_675_1];

/// Posture and curvature at a point of a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Knot {
    /// Position (m) and heading (rad, within ±π).
    pub posture: Posture,
    /// Curvature, 1/m, positive to the left.
    pub kappa: f32,
}

impl Knot {
    const BLANK: Self = Self {
        posture: Posture::ORIGIN,
        kappa: 0.0,
    };

    /// The point at the signed distance `ds` (m) along the curve, if the curvature changes at `slope` (1/m²).
    pub fn advance(&self, ds: f32, slope: f32) -> Self {
        let turn = |u: f32| u * (self.kappa + 0.5 * slope * u);
        let (mut x, mut y) = (0.0, 0.0);
        for point in GAUSS {
            let (sin, cos) = sin_cos(self.posture.phi + turn(point * ds));
            x += cos;
            y += sin;
        }
        Self {
            posture: Posture {
                x: self.posture.x + 0.5 * ds * x,
                y: self.posture.y + 0.5 * ds * y,
                phi: wrap_angle(self.posture.phi + turn(ds)),
            },
            kappa: self.kappa + slope * ds,
        }
    }
}

/// Interpolated point of a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Posture and curvature.
    pub knot: Knot,
    /// Rate of curvature along the curve (dκ/ds), 1/m².
    pub slope: f32,
}

/// Curve of at most [`KNOTS`] knots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve {
    knots: [Knot; KNOTS],
    first: u16,
    count: u16,
    pitch: f32,
}

impl Default for Curve {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl Curve {
    /// A curve without knots.
    pub const EMPTY: Self = Self {
        knots: [Knot::BLANK; KNOTS],
        first: 0,
        count: 0,
        pitch: 0.01,
    };

    /// Discards all knots; the curve then has one, at distances of `pitch` (m) from those to come.
    pub fn restart(&mut self, knot: Knot, pitch: f32) {
        (self.first, self.count) = (0, 1);
        self.pitch = pitch;
        if let Some(slot) = self.knots.first_mut() {
            *slot = knot;
        }
    }

    /// True without knots.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Distance of neighbouring knots, m.
    pub fn pitch(&self) -> f32 {
        self.pitch
    }

    /// Arc length at the last knot, m; the first knot is at 0.
    pub fn length(&self) -> f32 {
        f32::from(self.count.saturating_sub(1)) * self.pitch
    }

    fn slot(&self, index: u16) -> usize {
        let place = usize::from(self.first) + usize::from(index);
        if place >= KNOTS { place - KNOTS } else { place }
    }

    fn knot(&self, index: u16) -> Knot {
        let knot = self.knots.get(self.slot(index));
        knot.copied().unwrap_or(Knot::BLANK)
    }

    /// The last knot in the direction of travel.
    pub fn end(&self, direction: Direction) -> Knot {
        match direction {
            Direction::Forward => self.knot(self.count.saturating_sub(1)),
            Direction::Reverse => self.knot(0),
        }
    }

    /// Distance (m) in the direction of travel from the place `s` (m) to the end of the curve.
    pub fn ahead(&self, s: f32, direction: Direction) -> f32 {
        match direction {
            Direction::Forward => self.length() - s,
            Direction::Reverse => s,
        }
    }

    /// Appends a knot of curvature `kappa` at the end in the direction of travel. Returns the change of all arc
    /// lengths, m.
    pub fn extend(&mut self, direction: Direction, kappa: f32) -> f32 {
        let end = self.end(direction);
        let ds = direction.sign() * self.pitch;
        let next = Knot {
            kappa,
            ..end.advance(ds, (kappa - end.kappa) / ds)
        };
        let full = usize::from(self.count) >= KNOTS;
        let last = (KNOTS - 1) as u16;
        let (place, shift) = match direction {
            Direction::Forward => {
                let place = self.slot(self.count);
                if full {
                    self.first = if self.first >= last {
                        0
                    } else {
                        self.first + 1
                    };
                }
                (place, if full { -self.pitch } else { 0.0 })
            }
            Direction::Reverse => {
                self.first = if self.first == 0 {
                    last
                } else {
                    self.first - 1
                };
                (usize::from(self.first), self.pitch)
            }
        };
        if !full {
            self.count += 1;
        }
        if let Some(slot) = self.knots.get_mut(place) {
            *slot = next;
        }
        shift
    }

    /// Drops the knots beyond the place `s` (m) in the direction of travel, except the first of them. Returns the
    /// change of all arc lengths, m.
    pub fn cut(&mut self, s: f32, direction: Direction) -> f32 {
        let mut shift = 0.0;
        // At most KNOTS drops, because each lowers the count.
        while self.count > 2 && self.ahead(s + shift, direction) > self.pitch {
            self.count -= 1;
            if direction == Direction::Reverse {
                self.first = self.slot(1) as u16;
                shift -= self.pitch;
            }
        }
        shift
    }

    /// The knot at or before `s` and the distance (m) from there; and the slope of curvature.
    // Inlined: the heading needs a part of it, and is asked for most often.
    #[inline(always)]
    fn cell(&self, s: f32) -> (Knot, f32, f32) {
        let last = self.count.saturating_sub(1);
        let place = s / self.pitch;
        if !(place >= 0.0) {
            return (self.straight(0), s.min(0.0), 0.0);
        }
        // The conversion saturates.
        let index = place as u16;
        if index >= last {
            return (self.straight(last), s - f32::from(last) * self.pitch, 0.0);
        }
        let (a, b) = (self.knot(index), self.knot(index + 1));
        let slope = (b.kappa - a.kappa) / self.pitch;
        (a, s - f32::from(index) * self.pitch, slope)
    }

    fn straight(&self, index: u16) -> Knot {
        Knot {
            kappa: 0.0,
            ..self.knot(index)
        }
    }

    /// The curve at the place `s` (m).
    pub fn at(&self, s: f32) -> Sample {
        let (knot, ds, slope) = self.cell(s);
        Sample {
            knot: knot.advance(ds, slope),
            slope,
        }
    }

    /// Heading at the place `s` (m), rad, not wrapped. Costs no sine.
    pub fn heading(&self, s: f32) -> f32 {
        let (knot, ds, slope) = self.cell(s);
        knot.posture.phi + ds * (knot.kappa + 0.5 * slope * ds)
    }

    /// Curvature at the place `s` (m), 1/m.
    pub fn kappa(&self, s: f32) -> f32 {
        let (knot, ds, slope) = self.cell(s);
        knot.kappa + slope * ds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Drives a curve of κ = 2 sin(3 u) from the origin in one direction, with `count` knots.
    fn wavy(direction: Direction, count: u16) -> (Curve, f32) {
        let mut curve = Curve::EMPTY;
        curve.restart(Knot::default(), 0.01);
        let mut shift = 0.0;
        for k in 1..=count {
            shift += curve.extend(direction, 2.0 * (0.03 * f32::from(k)).sin());
        }
        (curve, shift)
    }

    /// Integral of the heading in f64 with a thousand steps a cell, curvature linear between knots.
    fn integrated(distance: f64, sign: f64) -> [f64; 3] {
        let kappa = |k: f64| 2.0 * f64::from((0.03 * k as f32).sin());
        let (mut x, mut y, mut phi, steps) = (0.0, 0.0, 0.0f64, (distance * 1e5) as usize);
        let h = 1e-5;
        for i in 0..steps {
            let u = (i as f64 + 0.5) * h / 0.01;
            let at = kappa(u.floor()) * (1.0 - u.fract()) + kappa(u.floor() + 1.0) * u.fract();
            let half = 0.5 * sign * h * at;
            x += sign * h * (phi + half).cos();
            y += sign * h * (phi + half).sin();
            phi += 2.0 * half;
        }
        [x, y, phi]
    }

    #[test]
    fn curve_is_the_integral_of_its_curvature_in_both_directions() {
        for direction in [Direction::Forward, Direction::Reverse] {
            let (curve, shift) = wavy(direction, 180);
            for distance in [0.004f32, 0.5, 1.2345, 1.7] {
                let s = shift + direction.sign() * distance;
                let [x, y, phi] = integrated(distance.into(), direction.sign().into());
                let found = curve.at(s).knot.posture;
                assert!((f64::from(found.x) - x).abs() < 2e-6, "{found:?} {x}");
                assert!((f64::from(found.y) - y).abs() < 2e-6, "{found:?} {y}");
                assert!((f64::from(found.phi) - phi).abs() < 3e-6);
                assert!((curve.heading(s) - found.phi).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn full_ring_drops_the_oldest_knot_and_places_keep_their_points() {
        for direction in [Direction::Forward, Direction::Reverse] {
            let (mut curve, _) = wavy(direction, 200);
            let mut s = 0.5 * curve.length();
            let before = curve.at(s);
            for _ in 0..50 {
                s += curve.extend(direction, 1.0);
            }
            let [dx, dy, turn] = curve.at(s).knot.posture.minus(before.knot.posture);
            assert!(dx.abs() + dy.abs() + turn.abs() < 2e-6);
            assert!((curve.length() - 2.23).abs() < 1e-5);
        }
    }

    #[test]
    fn cut_keeps_one_knot_beyond_the_place() {
        for direction in [Direction::Forward, Direction::Reverse] {
            let (mut curve, _) = wavy(direction, 150);
            let s = 0.7321;
            let before = curve.at(s);
            let s = s + curve.cut(s, direction);
            let left = curve.ahead(s, direction);
            assert!((0.0..=0.0101).contains(&left), "{left}");
            let [dx, dy, turn] = curve.at(s).knot.posture.minus(before.knot.posture);
            assert!(dx.abs() + dy.abs() + turn.abs() < 2e-6);
        }
    }

    #[test]
    fn curve_is_straight_beyond_its_ends_and_nan_is_its_beginning() {
        let (curve, _) = wavy(Direction::Forward, 20);
        for (s, end, beyond) in [(-0.5, 0.0, -0.5), (0.7, 0.2, 0.5), (f32::NAN, 0.0, 0.0)] {
            let end = curve.at(end).knot.posture;
            let expected = end.compose(Posture::new(beyond, 0.0, 0.0));
            let found = curve.at(s).knot;
            assert!(found.posture.distance(expected) < 1e-6, "{s}: {found:?}");
            assert!(s.is_nan() || found.kappa == 0.0);
        }
        assert_eq!(Curve::EMPTY.at(0.3).knot.posture.x, 0.3);
    }
}
