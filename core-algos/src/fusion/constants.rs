//! Errors of odometry and beam that stay the same, or nearly so, throughout a drive.
//!
//! They add linearly and white noise cannot stand for them. [`joint`](super::joint) estimates them;
//! [`track`](super::track) keeps what a posture owes to each. Both take from here what they do to
//! an axle's odometric increment and to what the beam says.
//!
//! | index | constant |
//! |---|---|
//! | [`ZERO`] | relative heading that the zeros of the gauges add (rad), and their tilt from root to tip (m) |
//! | [`GAIN`] | gain error of the beam: of the relative heading, and tilt from root to tip a radian of it (m) |
//! | [`DRIFT`] | heading drift per metre of front and rear odometry: unequal wheels (rad/m), which also move the middle of an axle that turns |
//! | [`SCALE`] | scale error of front and rear odometry: wheel size |
//! | [`TURN`] | scale error of the headings that the wheels of front and rear report: track |
//! | [`SIDE`] | way aside of front and rear over their way ahead: axles askew, camber |
//! | [`COMPLIANCE`] | slip of the tyres under the frame's moment beyond [`Tyres`]: mean of the axles and half their difference (rad/m) |
//! | [`UNEVEN`] | slip of the right tyre of front and rear beyond the mean with the left one (rad/m) |
//! | [`GYRO_BIAS`] | what the gyros of front and rear read too little (rad/s) |
//! | [`GYRO_SCALE`] | scale error of the gyros of front and rear |
//!
//! An axle with a gyro turns by it: the wheels' share of the heading is then some thousandths, and
//! with it what slip, unequal wheels and track do to it.
//!
//! **Tyres.** A bent frame turns the front axle back and the rear axle into the curve with the moment
//! M = EI/L·2ψ, which the tyres of an axle hold by opposite forces F = M/2d. A brush tyre under load N
//! slips by F/(NC)/(1 − F/μN) of the way w that it rolls. So an axle yaws by M/(2d²NC) a metre of
//! w̄ = (|w_l| + |w_r|)/2, which its wheels do not see, and advances by the same times
//! d (|w_r| − |w_l|)/2. Of two tyres that differ, sum and difference change places for half their difference.
//!
//! **Beam.** An error of the curvature along the strip moves the tip as seen from the root: its integral
//! turns and moves it as a larger relative heading does, its first moment about the middle moves it across the chord.

use crate::math::matrix::Mat;
use crate::math::trig::{sin_cos, sinc};
use crate::math::{Posture, RelativeHeading};

/// Number of constants.
pub const COUNT: usize = 20;
/// Zeros of the gauges (2).
pub const ZERO: usize = 0;
/// Gains of the gauges (2).
pub const GAIN: usize = 2;
/// Heading drift of front and rear.
pub const DRIFT: usize = 4;
/// Scale error of front and rear.
pub const SCALE: usize = 6;
/// Scale error of the heading by the wheels of front and rear.
pub const TURN: usize = 8;
/// Way aside of front and rear.
pub const SIDE: usize = 10;
/// Slip a metre under the frame's moment: mean and half the difference of front and rear.
pub const COMPLIANCE: usize = 12;
/// Slip a metre of the right tyre beyond the mean of an axle's two, of front and rear.
pub const UNEVEN: usize = 14;
/// Bias of the gyros of front and rear.
pub const GYRO_BIAS: usize = 16;
/// Scale error of the gyros of front and rear.
pub const GYRO_SCALE: usize = 18;
/// Constants that the beam's posture owes something to: [`ZERO`] and [`GAIN`].
pub const OF_BEAM: usize = 4;
/// Constants that the error of an axle's increment depends on beside the compliances, ahead, aside and in
/// heading; of front and rear.
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

/// Error of an increment by the errors `of` the constants: the product with [`Step::by_constants`], of
/// which few entries are not zero.
pub(super) fn error_by<const AXLE: usize>(
    by_constants: &Mat<3, COUNT>,
    of: impl Fn(usize) -> f32,
) -> [f32; 3] {
    let [ahead, aside, heading] = by_constants;
    let sum = |by: &[f32; COUNT], constants: &[usize]| {
        let terms = constants.iter().map(|&k| by[k % COUNT] * of(k));
        terms.fold(0.0, |sum, term| sum + term)
    };
    // The axles' compliances are the mean and half the difference.
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
    /// Slip of an axle a metre rolled and a radian of small relative heading, rad/m.
    pub compliance: f32,
    /// Relative heading at which the tyres slide, rad.
    pub sliding: f32,
}

impl Tyres {
    /// Largest share of the friction that the model is followed to.
    const MAX_SHARE: f32 = 0.7;

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
pub struct Step {
    /// 0 for the front axle, 1 for the rear.
    pub axle: usize,
    /// Posture reached, in the frame of departure (m, m, rad).
    pub moved: Posture,
    /// Heading of the front axle less that of the rear.
    pub relative_heading: RelativeHeading,
    /// Time the increment spans, s.
    pub dt: f32,
    /// Share of the time in which a gyro took part, 0 to 1.
    pub gyro_share: f32,
}

impl Step {
    /// Sign of the turn under the frame's moment: the front axle turns back, the rear axle into the curve.
    fn sign(&self) -> f32 {
        if self.axle == 0 { -1.0 } else { 1.0 }
    }

    /// Share of the heading that comes from the wheels.
    pub fn by_wheels(&self) -> f32 {
        1.0 - self.gyro_share
    }

    /// Ways that the left and the right wheel rolled, without sign, m.
    fn rolled(&self, tyres: &Tyres) -> [f32; 2] {
        let turned = tyres.half_track * self.moved.phi;
        [self.moved.x - turned, self.moved.x + turned].map(f32::abs)
    }

    /// Mean way that the wheels rolled, m.
    pub fn way(&self, tyres: &Tyres) -> f32 {
        let [left, right] = self.rolled(tyres);
        0.5 * (left + right)
    }

    /// Advance and turn (m, rad) by a slip of one radian a metre and radian of relative heading: of both tyres, and of
    /// one tyre more and the other less.
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

    /// Sign of the difference of the axles' compliances.
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

/// Derivative of what the beam says of the front axle (m, m, rad, in the rear axle's frame) by the first
/// [`OF_BEAM`] constants, for the posture `relative`.
///
/// Of an arc, which a strip under pure moments is: for its relative heading φ and its tip (x, y) the tip moves by
/// (x cot φ − x/φ …) with φ; written with half angles nothing is divided by φ.
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
