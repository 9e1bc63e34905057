//! Constant errors of odometry and beam: the same, or nearly so, throughout a drive.
//!
//! They add linearly, so white noise cannot represent them. [`joint`](super::joint) estimates them;
//! [`track`](super::track) stores a posture's sensitivity to each. This module gives both their effect on an axle's
//! odometric increment and on the beam's posture.
//!
//! | index | constant |
//! |---|---|
//! | [`ZERO`] | relative heading added by the zeros of the gauges (rad), and their tilt from root to tip (m) |
//! | [`GAIN`] | gain error of the beam: of the relative heading, and tilt from root to tip per radian of relative heading (m) |
//! | [`DRIFT`] | heading drift per metre of front and rear odometry: unequal wheels (rad/m), which also move the middle of an axle that turns |
//! | [`SCALE`] | scale error of front and rear odometry: wheel size |
//! | [`TURN`] | scale error of the headings that the wheels of front and rear report: track |
//! | [`SIDE`] | lateral motion per forward motion of front and rear: axles askew, camber |
//! | [`COMPLIANCE`] | slip of the tyres under the frame's moment beyond the model [`Tyres`]: mean of the axles and half their difference (rad/m) |
//! | [`UNEVEN`] | slip of the right tyre beyond the mean of both tyres of an axle, of front and rear (rad/m) |
//! | [`GYRO_BIAS`] | true yaw rate less reading of the gyros of front and rear (rad/s) |
//! | [`GYRO_SCALE`] | scale error of the gyros of front and rear |
//!
//! The heading of an axle with a gyro comes from the gyro. The wheels' share is then a few thousandths, and so is the
//! effect of slip, unequal wheels and track.
//!
//! **Tyres.** A bent frame acts on each axle with the moment M = EI/L·2ψ: it turns the front axle back and the rear
//! axle into the curve. The tyres of an axle hold the moment by opposite forces F = M/2d. A brush tyre under load N
//! that rolls a distance w slips by w·F/(NC)/(1 − F/μN). So an axle yaws by M/(2d²NC) per metre of
//! w̄ = (|w_l| + |w_r|)/2, which its wheels do not measure, and advances by the same factor times
//! d (|w_r| − |w_l|)/2. For half the difference of two unequal tyres, sum and difference of the distances change places.
//!
//! **Beam.** An error of the curvature along the strip moves the tip as seen from the root. The integral of this
//! error acts as a larger relative heading. Its first moment about the middle moves the tip across the chord.

use crate::math::matrix::Mat;
use crate::math::trig::{sin_cos, sinc};
use crate::math::{Posture, RelativeHeading};

/// Number of constant errors.
pub const COUNT: usize = 20;
/// Index of the first of two constants: zeros of the gauges.
pub const ZERO: usize = 0;
/// Index of the first of two constants: gains of the gauges.
pub const GAIN: usize = 2;
/// Index of the heading drift of the front axle; the rear axle's is next.
pub const DRIFT: usize = 4;
/// Index of the scale error of the front axle; the rear axle's is next.
pub const SCALE: usize = 6;
/// Index of the scale error of the heading from the front wheels; that from the rear wheels is next.
pub const TURN: usize = 8;
/// Index of the front axle's lateral motion per forward motion; the rear axle's is next.
pub const SIDE: usize = 10;
/// Index of the mean of the axles' slip per metre under the frame's moment; half the difference, front less rear, is
/// next.
pub const COMPLIANCE: usize = 12;
/// Index of the slip per metre of the front axle's right tyre beyond the mean of its tyres; the rear axle's is next.
pub const UNEVEN: usize = 14;
/// Index of the bias of the front gyro; the rear gyro's is next.
pub const GYRO_BIAS: usize = 16;
/// Index of the scale error of the front gyro; the rear gyro's is next.
pub const GYRO_SCALE: usize = 18;
/// Number of constants that affect the beam's posture: two at [`ZERO`], two at [`GAIN`].
pub const OF_BEAM: usize = 4;
/// Indices of the constants, except the compliances, that affect the advance of the front axle and of the rear axle.
/// `OF_ASIDE` and `OF_HEADING` list those that affect lateral motion and heading.
pub(super) const OF_AHEAD: [[usize; 3]; 2] =
    [[SCALE, DRIFT, UNEVEN], [SCALE + 1, DRIFT + 1, UNEVEN + 1]];
pub(super) const OF_ASIDE: [[usize; 2]; 2] = [[SCALE, SIDE], [SCALE + 1, SIDE + 1]];
pub(super) const OF_HEADING: [[usize; 5]; 2] = [
    [DRIFT, TURN, UNEVEN, GYRO_BIAS, GYRO_SCALE],
    [
        DRIFT + 1,
        TURN + 1,
        UNEVEN + 1,
        GYRO_BIAS + 1,
        GYRO_SCALE + 1,
    ],
];

/// Error of an increment (m, m, rad) if constant k has the error `of(k)`: the product of
/// [`IncrementInputs::by_constants`] and these errors, over the few nonzero entries.
pub(super) fn error_by<const AXLE: usize>(
    by_constants: &Mat<3, COUNT>,
    of: impl Fn(usize) -> f32,
) -> [f32; 3] {
    let [ahead, aside, heading] = by_constants;
    let sum = |by: &[f32; COUNT], constants: &[usize]| {
        let terms = constants.iter().map(|&k| by[k % COUNT] * of(k));
        terms.fold(0.0, |sum, term| sum + term)
    };
    // The compliance of an axle is the mean plus (front) or minus (rear) half the difference.
    let compliance = match AXLE {
        0 => of(COMPLIANCE) + of(COMPLIANCE + 1),
        _ => of(COMPLIANCE) - of(COMPLIANCE + 1),
    };
    [
        sum(ahead, &OF_AHEAD[AXLE]) + ahead[COMPLIANCE] * compliance,
        sum(aside, &OF_ASIDE[AXLE]),
        sum(heading, &OF_HEADING[AXLE]) + heading[COMPLIANCE] * compliance,
    ]
}

/// Model of the tyres of an axle under the frame's moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tyres {
    /// Half the track (the paper's d), m.
    pub half_track: f32,
    /// Slip of an axle per metre rolled and radian of relative heading, for a small relative heading, rad/m.
    pub compliance: f32,
    /// Relative heading at which the tyres slide, rad.
    pub sliding: f32,
}

impl Tyres {
    /// Share of the friction up to which the model holds; beyond it the slip is linear again.
    const MAX_SHARE: f32 = 0.7;

    /// Slip of an axle to its left per metre rolled, for a `force` to its left over EI/L (rad/m): both tyres hold it, so
    /// it is F/(2NC).
    pub(super) fn slip_aside(&self, force: f32) -> f32 {
        self.compliance * self.half_track * self.half_track * force
    }

    /// Relative heading over 1 − F/μN, and its derivative by the relative heading.
    fn load(&self, RelativeHeading(heading): RelativeHeading) -> (f32, f32) {
        let share = (heading.abs() / self.sliding).min(Self::MAX_SHARE);
        let factor = 1.0 / (1.0 - share);
        let slope = if share < Self::MAX_SHARE {
            factor * factor
        } else {
            factor
        };
        (heading * factor, slope)
    }
}

/// Odometric increment of one axle, with the quantities that its errors depend on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IncrementInputs {
    /// 0 for the front axle, 1 for the rear.
    pub axle: usize,
    /// Posture at the end of the increment in the axle's coordinates at its start (m, m, rad).
    pub moved: Posture,
    /// Heading of the front axle less that of the rear.
    pub relative_heading: RelativeHeading,
    /// Time the increment spans, s.
    pub dt: f32,
    /// Share of the time in which the heading came from a gyro, 0 to 1.
    pub gyro_share: f32,
}

impl IncrementInputs {
    /// Sign of the turn under the frame's moment: the front axle turns back, the rear axle into the curve.
    fn sign(&self) -> f32 {
        if self.axle == 0 { -1.0 } else { 1.0 }
    }

    /// Share of the heading that comes from the wheels.
    pub fn by_wheels(&self) -> f32 {
        1.0 - self.gyro_share
    }

    /// Distances rolled by the left and the right wheel, without sign, m.
    fn rolled(&self, tyres: &Tyres) -> [f32; 2] {
        let turned = tyres.half_track * self.moved.phi;
        [self.moved.x - turned, self.moved.x + turned].map(f32::abs)
    }

    /// Mean distance rolled by the wheels, m.
    pub fn mean_distance(&self, tyres: &Tyres) -> f32 {
        let [left, right] = self.rolled(tyres);
        0.5 * (left + right)
    }

    /// Advance (m) and turn (rad) of the axle for a slip of 1 per metre rolled and radian of relative heading. First
    /// row: equal slip of both tyres; second row: opposite slip.
    fn slip(&self, tyres: &Tyres) -> [[f32; 2]; 2] {
        let [left, right] = self.rolled(tyres);
        let half = 0.5 * self.sign();
        let (ahead, turn) = (half * tyres.half_track, half * self.by_wheels());
        let (sum, difference) = (right + left, right - left);
        [
            [ahead * difference, turn * sum],
            [ahead * sum, turn * difference],
        ]
    }

    /// True increment less the odometric one (m, m, rad), and its derivative by the relative heading.
    pub fn error(
        &self,
        tyres: &Tyres,
        by_constants: &Mat<3, COUNT>,
        constants: &[f32; COUNT],
    ) -> ([f32; 3], [f32; 3]) {
        let (load, slope) = tyres.load(self.relative_heading);
        let of = |k: usize| constants[k % COUNT];
        let mut error = match self.axle {
            0 => error_by::<0>(by_constants, of),
            _ => error_by::<1>(by_constants, of),
        };
        let [[ahead, turn], [ahead_uneven, turn_uneven]] = self.slip(tyres);
        error[0] += tyres.compliance * load * ahead;
        error[2] += tyres.compliance * load * turn;
        let own = self.difference_sign() * constants[COMPLIANCE + 1];
        let compliance = tyres.compliance + constants[COMPLIANCE] + own;
        let uneven = constants[UNEVEN + self.axle.min(1)];
        let by_heading = [
            slope * (compliance * ahead + uneven * ahead_uneven),
            0.0,
            slope * (compliance * turn + uneven * turn_uneven),
        ];
        (error, by_heading)
    }

    /// Sign of half the difference of the compliances in an axle's compliance: + front, − rear.
    fn difference_sign(&self) -> f32 {
        -self.sign()
    }

    /// Derivative of the true increment (m, m, rad) by the constants.
    pub fn by_constants(&self, tyres: &Tyres) -> Mat<3, COUNT> {
        let p = self.moved;
        let axle = self.axle.min(1);
        let mut by = [[0.0; COUNT]; 3];
        by[0][SCALE + axle] = p.x;
        by[0][DRIFT + axle] = tyres.half_track * tyres.half_track * p.phi;
        by[1][SCALE + axle] = p.y;
        by[1][SIDE + axle] = p.x;
        by[2][DRIFT + axle] = self.by_wheels() * p.x;
        by[2][TURN + axle] = self.by_wheels() * p.phi;
        let (load, _) = tyres.load(self.relative_heading);
        let [[ahead, turn], [ahead_uneven, turn_uneven]] = self.slip(tyres);
        let difference = self.difference_sign();
        by[0][COMPLIANCE] = load * ahead;
        by[0][COMPLIANCE + 1] = difference * load * ahead;
        by[2][COMPLIANCE] = load * turn;
        by[2][COMPLIANCE + 1] = difference * load * turn;
        by[0][UNEVEN + axle] = load * ahead_uneven;
        by[2][UNEVEN + axle] = load * turn_uneven;
        by[2][GYRO_BIAS + axle] = self.gyro_share * self.dt;
        by[2][GYRO_SCALE + axle] = self.gyro_share * p.phi;
        by
    }
}

/// Derivative of the beam's posture (m, m, rad; front axle in the rear axle's coordinates) by the first [`OF_BEAM`]
/// constants, at the posture `relative`.
///
/// The strip is taken as an arc, its shape under pure moments. Half angles avoid a division by its relative heading.
pub fn beam_by_constants(relative: Posture) -> Mat<3, OF_BEAM> {
    let heading = relative.phi;
    let (sin, cos) = sin_cos(0.5 * heading);
    // The chord c = L sinc(φ/2) lies at φ/2: d(x, y)/dφ = c'(cos, sin) + c/2 (−sin, cos).
    let chord = relative.x * cos + relative.y * sin;
    let shortened = chord * shortening(0.5 * heading);
    let by_heading = [
        shortened * cos - 0.5 * chord * sin,
        shortened * sin + 0.5 * chord * cos,
        1.0,
    ];
    let by_tilt = [sin, -cos, 0.0];
    core::array::from_fn(|i| {
        [
            by_heading[i],
            by_tilt[i],
            heading * by_heading[i],
            heading * by_tilt[i],
        ]
    })
}

/// Half the logarithmic derivative of sinc at `a`: (cot a − 1/a)/2.
fn shortening(a: f32) -> f32 {
    let square = a * a;
    if square < 0.5 {
        // cot a − 1/a = −a/3 − a³/45 − 2a⁵/945 − a⁷/4725 …
        -0.5 * a * (1.0 / 3.0 + square * (1.0 / 45.0 + square * (2.0 / 945.0 + square / 4725.0)))
    } else {
        let (_, cos) = sin_cos(a);
        0.5 * (cos / sinc(a) - 1.0) / a
    }
}

#[cfg(test)]
mod tests;
