//! The paper's relative position sensor: the polynomial through the strains, integrated.
//!
//! - [`piecewise`]: segment by segment, as the paper does it (eq. 14, 15);
//! - [`quadrature`]: the same polynomial integrated to rounding error at a fraction of the cost.
//!
//! Both read an [`Interpolant`], which is valid by construction; nothing fails afterwards.

use super::strip::{GaugeMask, MAX_GAUGES, MIN_GAUGES, RelativePosture, Strip};
use crate::math::Posture;
use crate::math::matrix::Mat;
use crate::math::trig::{sin_cos, sinc};
use crate::math::{greater, small_angle};

/// Number of nodes at which [`quadrature`] evaluates (cos θ, sin θ) of any bend: exact to 1e-8 m.
const NODES: usize = 16;
/// Number of nodes for a gentle bend.
const GENTLE_NODES: usize = 8;
/// Largest number of gauges for the check of gentle bends.
const GENTLE_GAUGES: usize = 5;
/// Largest highest Legendre coefficient of a gentle bend, in units of 1/L: with |θ| up to
/// [`small_angle::LIMIT`], eight nodes then leave 1e-6 L at most.
const GENTLE_HIGHEST: f32 = 0.7;
/// Positive half of the 16-node Gauss–Legendre rule: node and weight.
const GAUSS_16: [(f32, f32); NODES / 2] = [
    (0.095_012_51, 0.189_450_6),
    (0.281_603_54, 0.182_603_42),
    (0.458_016_78, 0.169_156_52),
    (0.617_876_24, 0.149_595_99),
    (0.755_404_4, 0.124_628_97),
    (0.865_631_2, 0.095_158_51),
    (0.944_575, 0.062_253_524),
    (0.989_400_9, 0.027_152_46),
];
/// Positive half of the 8-node rule.
const GAUSS_8: [(f32, f32); GENTLE_NODES / 2] = [
    (0.183_434_64, 0.362_683_78),
    (0.525_532_4, 0.313_706_64),
    (0.796_666_5, 0.222_381_03),
    (0.960_289_84, 0.101_228_535),
];
/// The 4-node rule, exact for the seventh degree: the highest of an interpolant.
const GAUSS_4: [(f32, f32); 4] = [
    (-0.861_136_3, 0.347_854_85),
    (-0.339_981_04, 0.652_145_15),
    (0.339_981_04, 0.652_145_15),
    (0.861_136_3, 0.347_854_85),
];
/// Leading coefficients of the Legendre polynomials.
const LEGENDRE_LEADING: [f32; MAX_GAUGES] = [1.0, 1.0, 1.5, 2.5, 4.375, 7.875, 14.4375, 26.8125];

/// Node `q` and its weight of the rule of which the positive half is given, nodes ascending.
fn node<const HALF: usize>(rule: &[(f32, f32); HALF], q: usize) -> (f32, f32) {
    if q < HALF {
        let (u, w) = rule[HALF - 1 - q];
        (-u, w)
    } else {
        rule[(q - HALF).min(HALF - 1)]
    }
}

/// The polynomial through the gauges of one mask (paper eq. 11, 12), in Lagrange form on positions
/// normalised to [−1, 1].
///
/// Linear in the curvatures, so no system is solved when they change; the Vandermonde matrix of
/// the paper never appears (its condition number is 1.7e4 in metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interpolant {
    mask: GaugeMask,
    u: [f32; MAX_GAUGES],
    /// 1/Π(u_i − u_j) over the other gauges of the mask; 0 for a gauge that is not in it.
    weight: [f32; MAX_GAUGES],
    /// Weight of each gauge in the two highest Legendre coefficients.
    highest: [[f32; MAX_GAUGES]; 2],
}

impl Interpolant {
    /// The interpolant through the gauges of `mask` that the strip has; `None` if fewer than two.
    pub fn new(strip: &Strip, mask: GaugeMask) -> Option<Self> {
        let mask = mask.and(strip.gauges);
        if mask.count() < MIN_GAUGES {
            return None;
        }
        let mut weight = [0.0; MAX_GAUGES];
        for i in 0..MAX_GAUGES {
            if mask.contains(i) {
                let mut product = 1.0;
                for j in 0..MAX_GAUGES {
                    if j != i && mask.contains(j) {
                        product *= strip.u[i] - strip.u[j];
                    }
                }
                weight[i] = 1.0 / product;
            }
        }
        let mut sum = 0.0;
        for i in 0..MAX_GAUGES {
            if mask.contains(i) {
                sum += strip.u[i];
            }
        }
        let degree = mask.count() as usize - 1;
        let mut highest = [[0.0; MAX_GAUGES]; 2];
        for k in 0..MAX_GAUGES {
            for i in 0..MAX_GAUGES {
                if k == degree {
                    highest[0][i] = weight[i] / LEGENDRE_LEADING[k];
                }
                if k + 1 == degree {
                    highest[1][i] = weight[i] * (strip.u[i] - sum) / LEGENDRE_LEADING[k];
                }
            }
        }
        Some(Self {
            mask,
            u: strip.u,
            weight,
            highest,
        })
    }

    /// The gauges it goes through.
    pub fn mask(&self) -> GaugeMask {
        self.mask
    }

    /// The Lagrange polynomials at `u`: how much each gauge counts there.
    pub fn basis(&self, u: f32) -> [f32; MAX_GAUGES] {
        let mut basis = self.weight;
        let mut before = 1.0;
        for i in 0..MAX_GAUGES {
            if self.mask.contains(i) {
                basis[i] *= before;
                before *= u - self.u[i];
            }
        }
        let mut after = 1.0;
        for i in (0..MAX_GAUGES).rev() {
            if self.mask.contains(i) {
                basis[i] *= after;
                after *= u - self.u[i];
            }
        }
        basis
    }

    /// The polynomial's value at `u` in [−1, 1] for the values at the gauges.
    pub fn value(&self, u: f32, at_gauges: &[f32; MAX_GAUGES]) -> f32 {
        dot(&self.basis(u), at_gauges)
    }

    /// Magnitude of the polynomial's two highest Legendre coefficients: what the next ones, which
    /// the gauges cannot see, are judged by. Two, because symmetry can make one vanish.
    #[inline(always)]
    fn highest_coefficients<const N: usize>(&self, at_gauges: &[f32; N]) -> f32 {
        let mut sums = [0.0f32; 2];
        for (sum, row) in sums.iter_mut().zip(&self.highest) {
            for i in 0..N.min(MAX_GAUGES) {
                *sum += row[i] * at_gauges[i];
            }
        }
        greater(sums[0].abs(), sums[1].abs())
    }
}

#[inline(always)]
fn dot<const N: usize>(a: &[f32; N], b: &[f32; N]) -> f32 {
    let mut sum = 0.0;
    for i in 0..N {
        sum += a[i] * b[i];
    }
    sum
}

/// Weights of `N` gauges that give the direction θ of the strip at `Q` nodes and at the tip, m.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Angles<const N: usize, const Q: usize> {
    /// θ at node q = Σ `at[q][i]` κ_i.
    at: [[f32; N]; Q],
    tip: [f32; N],
    /// Weight of each node, a share of the strip.
    weight: [f32; Q],
}

impl<const N: usize, const Q: usize> Angles<N, Q> {
    fn new<const HALF: usize>(
        strip: &Strip,
        interpolant: &Interpolant,
        rule: &[(f32, f32); HALF],
    ) -> Self {
        let integral = |end: f32| {
            let half = 0.5 * (end + 1.0);
            let mut sum = [0.0; N];
            for (node, weight) in GAUSS_4 {
                let basis = interpolant.basis(half * node + (half - 1.0));
                for (sum, basis) in sum.iter_mut().zip(basis) {
                    *sum += weight * basis;
                }
            }
            sum.map(|sum| 0.5 * strip.length * half * sum)
        };
        let (mut at, mut weight) = ([[0.0; N]; Q], [0.0; Q]);
        for q in 0..Q {
            let (u, w) = node(rule, q);
            (at[q], weight[q]) = (integral(u), 0.5 * w);
        }
        Self {
            at,
            tip: integral(1.0),
            weight,
        }
    }

    /// End of the strip for curvatures `k`, in units of its length, and the derivatives of its x
    /// and y by them, by the given sine and cosine.
    #[inline(always)]
    fn end(&self, k: &[f32; N], sin_cos: impl Fn(f32) -> (f32, f32)) -> ([f32; 2], [[f32; N]; 2]) {
        let (mut x, mut y) = (0.0, 0.0);
        let (mut x_by, mut y_by) = ([0.0; N], [0.0; N]);
        for q in 0..Q {
            let at = &self.at[q];
            let (s, c) = sin_cos(dot(at, k));
            let (dx, dy) = (self.weight[q] * c, self.weight[q] * s);
            x += dx;
            y += dy;
            for i in 0..N {
                x_by[i] -= dy * at[i];
                y_by[i] += dx * at[i];
            }
        }
        ([x, y], [x_by, y_by])
    }
}

/// An interpolant with the exact weights that give the direction θ of the strip at the quadrature
/// nodes and at the tip from the curvatures. About 10 000 operations to build, 1000 bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quadrature {
    interpolant: Interpolant,
    any: Angles<MAX_GAUGES, NODES>,
    gentle: Angles<GENTLE_GAUGES, GENTLE_NODES>,
    /// Largest sum of squared curvatures of a gentle bend, 1/m²; negative if there are more gauges
    /// than are looked at.
    gentle_square: f32,
    /// Largest highest Legendre coefficient of one, 1/m.
    gentle_highest: f32,
}

impl Quadrature {
    /// The weights for `interpolant` on `strip`.
    pub fn new(strip: &Strip, interpolant: Interpolant) -> Self {
        let any = Angles::new(strip, &interpolant, &GAUSS_16);
        // |θ| is at most the norm of its weights times that of the curvatures.
        let mut largest = dot(&any.tip, &any.tip);
        for at in &any.at {
            largest = greater(dot(at, at), largest);
        }
        let few = interpolant.mask.and(GaugeMask::first(GENTLE_GAUGES)) == interpolant.mask;
        let gentle_square = small_angle::LIMIT * small_angle::LIMIT / largest;
        Self {
            interpolant,
            any,
            gentle: Angles::new(strip, &interpolant, &GAUSS_8),
            gentle_square: if few { 0.999 * gentle_square } else { -1.0 },
            gentle_highest: GENTLE_HIGHEST / strip.length,
        }
    }

    /// The interpolant.
    pub fn interpolant(&self) -> &Interpolant {
        &self.interpolant
    }

    /// The curvatures of a gentle bend and its highest Legendre coefficient; `None` of another one.
    #[inline(always)]
    fn as_gentle(&self, curvature: &[f32; MAX_GAUGES]) -> Option<([f32; GENTLE_GAUGES], f32)> {
        let k = masked::<GENTLE_GAUGES>(curvature, self.interpolant.mask);
        let highest = self.interpolant.highest_coefficients(&k);
        (dot(&k, &k) <= self.gentle_square && highest <= self.gentle_highest)
            .then_some((k, highest))
    }
}

/// The curvatures of the gauges that count, zero elsewhere (a NaN there must not spread), of the
/// first `N`.
#[inline(always)]
fn masked<const N: usize>(curvature: &[f32; MAX_GAUGES], mask: GaugeMask) -> [f32; N] {
    let mut masked = [0.0; N];
    for i in 0..N.min(MAX_GAUGES) {
        if mask.contains(i) {
            masked[i] = curvature[i];
        }
    }
    masked
}

/// The front axle's posture from the curvatures (1/m) of the gauges; the interpolating polynomial
/// integrated once for θ (exact weights) and by Gauss quadrature for x and y: eight nodes for a
/// bend of at most [`small_angle::LIMIT`] without abrupt changes, as is the rule with the robot,
/// sixteen for any other.
///
/// Within 5e-7 m and 1e-6 rad of exact integration for |κ| ≤ 10 1/m on 0.37 m. The heading is not
/// wrapped. The covariance holds gauge noise, zero and gain errors ([`super::strip::Uncertainty`])
/// and an allowance for the polynomial's error between the gauges. A NaN at a gauge of the mask
/// gives NaN: callers take the mask from usable readings. Cost about 600 operations, 4 000 for a
/// bend that is not gentle.
pub fn quadrature(
    strip: &Strip,
    rule: &Quadrature,
    curvature: &[f32; MAX_GAUGES],
) -> RelativePosture {
    if let Some((k, highest)) = rule.as_gentle(curvature) {
        return finish(strip, &rule.gentle, &k, highest, small_angle::sin_cos);
    }
    let k = masked(curvature, rule.interpolant.mask);
    let highest = rule.interpolant.highest_coefficients::<MAX_GAUGES>(&k);
    finish(strip, &rule.any, &k, highest, sin_cos)
}

#[inline(always)]
fn finish<const N: usize, const Q: usize>(
    strip: &Strip,
    angles: &Angles<N, Q>,
    k: &[f32; N],
    highest: f32,
    sin_cos: impl Fn(f32) -> (f32, f32),
) -> RelativePosture {
    let ([x, y], [x_by, y_by]) = angles.end(k, &sin_cos);
    let phi = dot(&angles.tip, k);
    let (s, c) = sin_cos(phi);
    // Of the rigid tip.
    let lever = (-strip.rigid_tip * s, strip.rigid_tip * c);
    let posture = Posture::new(
        strip.rigid_root + strip.length * x + lever.1,
        strip.length * y - lever.0,
        phi,
    );
    let mut jacobian: Mat<3, N> = [[0.0; N], [0.0; N], angles.tip];
    for i in 0..N {
        jacobian[0][i] = strip.length * x_by[i] + lever.0 * angles.tip[i];
        jacobian[1][i] = strip.length * y_by[i] + lever.1 * angles.tip[i];
    }
    let [covariance, noise] = covariances(strip, highest, k, &jacobian);
    RelativePosture {
        posture,
        covariance,
        noise,
    }
}

/// The front axle's posture by the paper's piecewise integration (eq. 13–15) in `segments` pieces.
///
/// Each segment is an arc with the curvature at its middle (its left end would cost up to 6.7 mm
/// at 100 segments), in half-angle form: d = κ dL, chord dL sinc(d/2) along φ_p + d/2. That is
/// (14) and (15) without the division by a curvature that may be zero. Sums are compensated, so
/// the number of segments does not cost precision. 0 segments are taken as 1. Covariance as
/// [`quadrature`], the limit of many segments. Cost about 300 operations a segment.
pub fn piecewise(
    strip: &Strip,
    rule: &Quadrature,
    curvature: &[f32; MAX_GAUGES],
    segments: u16,
) -> RelativePosture {
    let curvature = masked::<MAX_GAUGES>(curvature, rule.interpolant.mask);
    let segments = segments.max(1);
    let count = segments as f32;
    let step = strip.length / count;
    let (mut x, mut y, mut phi) = (Sum::default(), Sum::default(), Sum::default());
    for segment in 0..segments {
        // Twice the middle minus one, exact up to the division.
        let u = (2 * i32::from(segment) + 1 - i32::from(segments)) as f32 / count;
        let turn = step * rule.interpolant.value(u, &curvature);
        let chord = step * sinc(0.5 * turn);
        let (s, c) = sin_cos(phi.value() + 0.5 * turn);
        x.add(chord * c);
        y.add(chord * s);
        phi.add(turn);
    }
    let flexible = Posture::new(x.value(), y.value(), phi.value());
    RelativePosture {
        posture: strip.with_rigid_ends(flexible),
        ..quadrature(strip, rule, &curvature)
    }
}

/// A sum that carries its rounding error along (Neumaier).
#[derive(Clone, Copy, Default)]
struct Sum {
    sum: f32,
    lost: f32,
}

impl Sum {
    fn add(&mut self, term: f32) {
        let sum = self.sum + term;
        self.lost += if self.sum.abs() >= term.abs() {
            (self.sum - sum) + term
        } else {
            (term - sum) + self.sum
        };
        self.sum = sum;
    }

    fn value(self) -> f32 {
        self.sum + self.lost
    }
}

/// Covariance of a posture whose derivative with respect to the gauges' curvatures is `jacobian`, and
/// that of its noise, the polynomial's error with it; `highest` is the polynomial's highest Legendre
/// coefficient.
#[inline(always)]
fn covariances<const N: usize>(
    strip: &Strip,
    highest: f32,
    curvature: &[f32; N],
    jacobian: &Mat<3, N>,
) -> [Mat<3, 3>; 2] {
    let unseen = strip.uncertainty.interpolation * highest;
    let fresh = strip.noise_variance + unseen * unseen;
    let mut lasting = [0.0; N];
    for i in 0..N {
        lasting[i] = strip.gauge_variance(curvature[i]) - strip.noise_variance;
    }
    let (mut offset, mut gain) = ([0.0; 3], [0.0; 3]);
    for row in 0..3 {
        for i in 0..N {
            offset[row] += jacobian[row][i];
        }
        offset[row] *= strip.common_offset;
        gain[row] = strip.uncertainty.common_gain * dot(&jacobian[row], curvature);
    }
    let (mut p, mut noise) = ([[0.0; 3]; 3], [[0.0; 3]; 3]);
    for r in 0..3 {
        let mut weighed = [0.0; N];
        for i in 0..N {
            weighed[i] = jacobian[r][i] * lasting[i];
        }
        for c in r..3 {
            let common = offset[r] * offset[c] + gain[r] * gain[c];
            noise[r][c] = fresh * dot(&jacobian[r], &jacobian[c]);
            noise[c][r] = noise[r][c];
            p[r][c] = common + noise[r][c] + dot(&weighed, &jacobian[c]);
            p[c][r] = p[r][c];
        }
    }
    [p, noise].map(|p| strip.with_unseen_error(p))
}

impl Strip {
    /// Variance of a gauge's curvature without errors shared by all gauges, 1/m².
    #[inline(always)]
    pub(super) fn gauge_variance(&self, curvature: f32) -> f32 {
        let gain = self.uncertainty.gain * curvature;
        self.still_variance + gain * gain
    }
}

#[cfg(test)]
mod tests;
