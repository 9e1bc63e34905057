//! The paper's relative position sensor: integral of the polynomial through the strains.
//!
//! - [`piecewise`]: segment by segment, as the paper does it (eq. 14, 15);
//! - [`quadrature`]: the same polynomial integrated to rounding error at a fraction of the cost.
//!
//! Both use a [`Quadrature`] with its [`Interpolant`], which are valid by construction. Neither method fails.

use super::strip::{GaugeMask, MAX_GAUGES, MIN_GAUGES, RelativePosture, Strip};
use crate::math::Posture;
use crate::math::greater;
use crate::math::matrix::Mat;
use crate::math::trig::{sin_cos, sinc};

/// Number of nodes at which [`quadrature`] evaluates (cos θ, sin θ): exact to 1e-8 m.
const NODES: usize = 16;
/// Gauss–Legendre rule of [`NODES`] nodes: node and weight.
const GAUSS_16: [(f32, f32); NODES] = [
    (-0.989_400_9, 0.027_152_46),
    (-0.944_575, 0.062_253_524),
    (-0.865_631_2, 0.095_158_51),
    (-0.755_404_4, 0.124_628_97),
    (-0.617_876_24, 0.149_595_99),
    (-0.458_016_78, 0.169_156_52),
    (-0.281_603_54, 0.182_603_42),
    (-0.095_012_51, 0.189_450_6),
    (0.095_012_51, 0.189_450_6),
    (0.281_603_54, 0.182_603_42),
    (0.458_016_78, 0.169_156_52),
    (0.617_876_24, 0.149_595_99),
    (0.755_404_4, 0.124_628_97),
    (0.865_631_2, 0.095_158_51),
    (0.944_575, 0.062_253_524),
    (0.989_400_9, 0.027_152_46),
];
/// 4-node rule, exact to degree 7, the highest degree of an interpolant.
const GAUSS_4: [(f32, f32); 4] = [
    (-0.861_136_3, 0.347_854_85),
    (-0.339_981_04, 0.652_145_15),
    (0.339_981_04, 0.652_145_15),
    (0.861_136_3, 0.347_854_85),
];
/// Leading coefficients of the Legendre polynomials.
const LEGENDRE_LEADING: [f32; MAX_GAUGES] = [1.0, 1.0, 1.5, 2.5, 4.375, 7.875, 14.4375, 26.8125];

/// The polynomial through the gauges of one mask (paper eq. 11, 12), in Lagrange form on positions
/// normalised to [−1, 1].
///
/// The interpolant is linear in the curvatures, so that no system is solved when they change; the Vandermonde matrix
/// of the paper never appears (its condition number is 1.7e4 in metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interpolant {
    mask: GaugeMask,
    u: [f32; MAX_GAUGES],
    /// 1/Π(u_i − u_j) over the other gauges of the mask; 0 for a gauge outside the mask.
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

    /// Gauges of the interpolant.
    pub fn mask(&self) -> GaugeMask {
        self.mask
    }

    /// The Lagrange polynomials at `u`: weight of each gauge.
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

    /// Larger magnitude of the polynomial's two highest Legendre coefficients. An estimate of the next coefficients,
    /// which the gauges do not measure. Symmetry can make one of the two vanish.
    fn highest_coefficients(&self, at_gauges: &[f32; MAX_GAUGES]) -> f32 {
        let [last, before] = &self.highest;
        greater(dot(last, at_gauges).abs(), dot(before, at_gauges).abs())
    }
}

fn dot(a: &[f32; MAX_GAUGES], b: &[f32; MAX_GAUGES]) -> f32 {
    let mut sum = 0.0;
    for i in 0..MAX_GAUGES {
        sum += a[i] * b[i];
    }
    sum
}

/// An interpolant with the exact weights that give the direction θ of the strip at the quadrature
/// nodes and at the tip from the curvatures. About 7 000 operations to build, 700 bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quadrature {
    interpolant: Interpolant,
    /// θ at node q = Σ `at[q][i]` κ_i, m.
    at: [[f32; MAX_GAUGES]; NODES],
    /// Weights of θ at the tip, m.
    tip: [f32; MAX_GAUGES],
}

impl Quadrature {
    /// The weights for `interpolant` on `strip`.
    pub fn new(strip: &Strip, interpolant: Interpolant) -> Self {
        let integral = |end: f32| {
            let half = 0.5 * (end + 1.0);
            let mut sum = [0.0; MAX_GAUGES];
            for (node, weight) in GAUSS_4 {
                let basis = interpolant.basis(half * node + (half - 1.0));
                for (sum, basis) in sum.iter_mut().zip(basis) {
                    *sum += weight * basis;
                }
            }
            sum.map(|sum| 0.5 * strip.length * half * sum)
        };
        Self {
            interpolant,
            at: GAUSS_16.map(|(node, _)| integral(node)),
            tip: integral(1.0),
        }
    }

    /// Interpolant that this quadrature integrates.
    pub fn interpolant(&self) -> &Interpolant {
        &self.interpolant
    }

    /// End (x, y) of the strip for curvatures `k`, in units of its length, and the derivatives of x and y by `k`.
    fn end(&self, k: &[f32; MAX_GAUGES]) -> ([f32; 2], [[f32; MAX_GAUGES]; 2]) {
        let (mut x, mut y) = (0.0, 0.0);
        let (mut x_by, mut y_by) = ([0.0; MAX_GAUGES], [0.0; MAX_GAUGES]);
        for (at, (_, weight)) in self.at.iter().zip(GAUSS_16) {
            let (s, c) = sin_cos(dot(at, k));
            let (dx, dy) = (0.5 * weight * c, 0.5 * weight * s);
            x += dx;
            y += dy;
            for i in 0..MAX_GAUGES {
                x_by[i] -= dy * at[i];
                y_by[i] += dx * at[i];
            }
        }
        ([x, y], [x_by, y_by])
    }
}

/// The curvatures of the gauges in `mask`; zero elsewhere, so that a NaN does not spread.
fn masked(curvature: &[f32; MAX_GAUGES], mask: GaugeMask) -> [f32; MAX_GAUGES] {
    let mut masked = [0.0; MAX_GAUGES];
    for i in 0..MAX_GAUGES {
        if mask.contains(i) {
            masked[i] = curvature[i];
        }
    }
    masked
}

/// The front axle's posture from the curvatures (1/m) of the gauges; the interpolating polynomial
/// integrated once for θ (exact weights) and by Gauss quadrature for x and y.
///
/// Within 5e-7 m and 1e-6 rad of exact integration for |κ| ≤ 10 1/m on 0.37 m. The heading is not
/// wrapped. The covariance holds gauge noise, zero and gain errors ([`super::strip::Uncertainty`])
/// and an allowance for the polynomial's error between the gauges. A NaN at a gauge of the mask
/// gives NaN: callers take the mask from usable readings. Cost about 2 000 operations.
pub fn quadrature(
    strip: &Strip,
    rule: &Quadrature,
    curvature: &[f32; MAX_GAUGES],
) -> RelativePosture {
    let k = masked(curvature, rule.interpolant.mask);
    let ([x, y], [x_by, y_by]) = rule.end(&k);
    let phi = dot(&rule.tip, &k);
    let (s, c) = sin_cos(phi);
    // Derivatives of x and y by the heading, due to the rigid tip.
    let lever = (-strip.rigid_tip * s, strip.rigid_tip * c);
    let posture = Posture::new(
        strip.rigid_root + strip.length * x + lever.1,
        strip.length * y - lever.0,
        phi,
    );
    let mut jacobian = [[0.0; MAX_GAUGES], [0.0; MAX_GAUGES], rule.tip];
    for i in 0..MAX_GAUGES {
        jacobian[0][i] = strip.length * x_by[i] + lever.0 * rule.tip[i];
        jacobian[1][i] = strip.length * y_by[i] + lever.1 * rule.tip[i];
    }
    let highest = rule.interpolant.highest_coefficients(&k);
    let [covariance, noise] = covariances(strip, highest, &k, &jacobian);
    RelativePosture {
        posture,
        covariance,
        noise,
    }
}

/// The front axle's posture by the paper's piecewise integration (eq. 13–15) in `segments` pieces.
///
/// Each segment is an arc with the curvature at its middle; the curvature at its left end would cost up to 6.7 mm at
/// 100 segments. In half-angle form, d = κ dL, and the chord is dL sinc(d/2) along φ_p + d/2: (14) and (15) without
/// division by a curvature that may be zero. Sums are compensated, so that precision does not depend on the number of
/// segments. 0 segments are taken as 1. Covariance as [`quadrature`], the limit of many segments. Cost about 300
/// operations a segment.
pub fn piecewise(
    strip: &Strip,
    rule: &Quadrature,
    curvature: &[f32; MAX_GAUGES],
    segments: u16,
) -> RelativePosture {
    let curvature = masked(curvature, rule.interpolant.mask);
    let segments = segments.max(1);
    let count = segments as f32;
    let step = strip.length / count;
    let (mut x, mut y, mut phi) = (Sum::default(), Sum::default(), Sum::default());
    for segment in 0..segments {
        // Middle of the segment on [−1, 1], exact up to the division.
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

/// Compensated sum (Neumaier).
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

/// Covariance of a posture, and of its noise. `jacobian` holds the posture's derivatives by the gauges' curvatures. The
/// noise includes the polynomial's error, estimated from `highest`, the larger of its two highest Legendre
/// coefficients.
fn covariances(
    strip: &Strip,
    highest: f32,
    curvature: &[f32; MAX_GAUGES],
    jacobian: &Mat<3, MAX_GAUGES>,
) -> [Mat<3, 3>; 2] {
    let unseen = strip.uncertainty.interpolation * highest;
    let fresh = strip.noise_variance + unseen * unseen;
    let mut lasting = [0.0; MAX_GAUGES];
    for i in 0..MAX_GAUGES {
        lasting[i] = strip.gauge_variance(curvature[i]) - strip.noise_variance;
    }
    let (mut offset, mut gain) = ([0.0; 3], [0.0; 3]);
    for row in 0..3 {
        for i in 0..MAX_GAUGES {
            offset[row] += jacobian[row][i];
        }
        offset[row] *= strip.common_offset;
        gain[row] = strip.uncertainty.common_gain * dot(&jacobian[row], curvature);
    }
    let (mut p, mut noise) = ([[0.0; 3]; 3], [[0.0; 3]; 3]);
    for r in 0..3 {
        let mut weighed = [0.0; MAX_GAUGES];
        for i in 0..MAX_GAUGES {
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
    /// Variance of a gauge's curvature without the errors shared by all gauges, 1/m².
    pub(super) fn gauge_variance(&self, curvature: f32) -> f32 {
        let gain = self.uncertainty.gain * curvature;
        self.still_variance + gain * gain
    }
}

#[cfg(test)]
mod tests;
