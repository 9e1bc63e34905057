//! Turns of the plan: the curvature ramps up at its limit, stays, and ramps down to 0.
//!
//! A turn by δ starts and ends straight. Up to |δ| = κ_max²/κ′_max it is two ramps with the peak √(|δ| κ′_max); beyond,
//! an arc of κ_max stands between the ramps. A turn is symmetric, so its chord points along δ/2 and only the chord's
//! length is needed:
//!
//! ```text
//! c = 2ℓ ∫₀¹ cos(½ δ (1 − u²)) du,  ℓ = √(δ/κ′)                        without arc
//! c = 2 [A cos ½δ + B sin ½δ] + (2/κ) sin(½δ − δ_ramp)                 with arc
//! ```
//!
//! with A, B = ∫ (cos, sin)(½κ′s²) ds over a ramp and its angle δ_ramp = ½ κ²/κ′. The first integral is a power series
//! in δ², exact to rounding for a full turn.
//!
//! # Panic contract
//!
//! [`Turns::new`] takes checked limits; nothing can fail. Cost of a chord: about 50 floating-point operations.

use crate::math::trig::{sin_cos, sqrt};

/// Four Gauss points on [0, 1] and their weights.
const POINTS: [(f32, f32); 4] = [
    (0.069_431_84, 0.173_927_42),
    (0.330_009_5, 0.326_072_58),
    (0.669_990_52, 0.326_072_58),
    (0.930_568_16, 0.173_927_42),
];

/// Coefficients of the powers of (½δ)² in ∫₀¹ cos(½ δ (1 − u²)) du: (−1)ⁿ/(2n)! times ∫₀¹ (1 − u²)²ⁿ du.
const SERIES: [f32; 9] = [
    1.0,
    -0.266_666_67,
    0.016_931_217,
    -4.736_004_7e-4,
    7.429_027e-6,
    -7.447_646e-8,
    5.180_971e-10,
    -2.646_728_6e-12,
    1.034_889e-14,
];

/// Part of a plan along which the curvature is linear. Curvatures are positive to the left of the direction of travel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Piece {
    /// Length, m.
    pub length: f32,
    /// Curvature at the beginning, 1/m.
    pub from: f32,
    /// Curvature at the end, 1/m.
    pub to: f32,
}

/// Shortest piece that is driven, m: a quotient of two tiny numbers may be infinite.
const SHORTEST_M: f32 = 1e-6;

impl Piece {
    /// Rate of curvature, 1/m²; `None` for a piece too short to be driven.
    pub fn slope(&self) -> Option<f32> {
        (self.length > SHORTEST_M).then(|| (self.to - self.from) / self.length)
    }
}

/// Turns within limits of curvature and of its rate along the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turns {
    kappa: f32,
    slope: f32,
    /// Coefficients of cos ½|δ| and sin ½|δ| in half the chord of a turn with an arc, m.
    arc: [f32; 2],
}

impl Turns {
    /// Turns with the largest curvature `kappa` (1/m) and the largest rate `slope` (1/m²), both positive.
    pub fn new(kappa: f32, slope: f32) -> Self {
        let length = kappa / slope;
        let mut ramp = [0.0; 2];
        for (point, weight) in POINTS {
            let s = point * length;
            let (sin, cos) = sin_cos(0.5 * slope * s * s);
            ramp[0] += weight * length * cos;
            ramp[1] += weight * length * sin;
        }
        let (sin, cos) = sin_cos(0.5 * kappa * length);
        let arc = [ramp[0] - sin / kappa, ramp[1] + cos / kappa];
        Self { kappa, slope, arc }
    }

    /// Largest curvature, 1/m.
    pub fn kappa(&self) -> f32 {
        self.kappa
    }

    /// Ramp from the curvature `kappa` (1/m) to 0.
    pub fn straighten(&self, kappa: f32) -> Piece {
        Piece {
            length: kappa.abs() / self.slope,
            from: kappa,
            to: 0.0,
        }
    }

    /// Largest angle of a turn without an arc, rad.
    fn knee(&self) -> f32 {
        self.kappa * self.kappa / self.slope
    }

    /// Length of a turn by `angle` (rad), m.
    pub fn length(&self, angle: f32) -> f32 {
        let angle = angle.abs();
        if angle <= self.knee() {
            2.0 * sqrt(angle / self.slope)
        } else {
            angle / self.kappa + self.kappa / self.slope
        }
    }

    /// Chord of a turn by `angle` (rad, at most a full turn) along its first direction and across it, m. In the
    /// coordinates of the last direction the second component has the other sign.
    pub fn chord(&self, angle: f32) -> [f32; 2] {
        let half = 0.5 * angle;
        let (sin, cos) = sin_cos(half);
        let size = angle.abs();
        let length = if size <= self.knee() {
            let square = half * half;
            let mean = SERIES.iter().rev().fold(0.0, |sum, c| sum * square + c);
            2.0 * sqrt(size / self.slope) * mean
        } else {
            let [along, across] = self.arc;
            2.0 * (along * cos + across * sin.abs())
        };
        [length * cos, length * sin]
    }

    /// The pieces of a turn by `angle` (rad): ramp, arc, ramp.
    pub fn pieces(&self, angle: f32) -> [Piece; 3] {
        let size = angle.abs();
        let knee = self.knee();
        let (peak, arc) = if size <= knee {
            (sqrt(size * self.slope), 0.0)
        } else {
            (self.kappa, (size - knee) / self.kappa)
        };
        let length = peak / self.slope;
        let peak = peak.copysign(angle);
        [
            Piece {
                length,
                from: 0.0,
                to: peak,
            },
            Piece {
                length: arc,
                from: peak,
                to: peak,
            },
            Piece {
                length,
                from: peak,
                to: 0.0,
            },
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// End of a turn (x, y, heading) by fine integration of its pieces in f64.
    fn integrated(turns: &Turns, angle: f32) -> [f64; 3] {
        let (mut x, mut y, mut phi) = (0.0, 0.0, 0.0f64);
        for piece in turns.pieces(angle) {
            let n = 20_000;
            let h = f64::from(piece.length) / f64::from(n);
            let rise = f64::from(piece.to - piece.from);
            for i in 0..n {
                let kappa = f64::from(piece.from) + rise * (f64::from(i) + 0.5) / f64::from(n);
                let middle = phi + 0.5 * h * kappa;
                x += h * middle.cos();
                y += h * middle.sin();
                phi += h * kappa;
            }
        }
        [x, y, phi]
    }

    #[test]
    fn chord_and_length_match_fine_integration() {
        // The second has turns of two ramps up to a full turn.
        let limits = [Turns::new(2.3, 6.0), Turns::new(2.3, 0.8)];
        let angles = [1e-4f32, 0.05, 0.5, 0.88, 0.885, 1.5, 3.0, 4.7, 6.2];
        for (turns, angle) in limits.iter().flat_map(|it| angles.map(|angle| (it, angle))) {
            for angle in [angle, -angle] {
                let [x, y, phi] = integrated(turns, angle);
                let chord = turns.chord(angle).map(f64::from);
                assert!((phi - f64::from(angle)).abs() < 3e-6, "{angle}: {phi}");
                assert!((x - chord[0]).abs() < 3e-6, "{angle}: {x}");
                assert!((y - chord[1]).abs() < 3e-6, "{angle}: {y}");
                let pieces = turns.pieces(angle).map(|piece| piece.length);
                let length: f32 = pieces.iter().sum();
                assert!((length - turns.length(angle)).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn turn_keeps_both_limits() {
        let turns = Turns::new(2.3, 6.0);
        for angle in [0.0f32, 0.1, 0.8, 2.0, -5.0] {
            for piece in turns.pieces(angle) {
                assert!(piece.from.abs().max(piece.to.abs()) <= 2.3);
                assert!((piece.to - piece.from).abs() <= 6.001 * piece.length);
            }
        }
    }
}
