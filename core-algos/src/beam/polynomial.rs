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
/// Most gauges whose bends are looked at for being gentle.
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
    /// How much each gauge counts in the two highest Legendre coefficients.
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

/// The posture alone; half the cost of [`quadrature`], whose posture it is bit by bit.
pub fn posture(strip: &Strip, rule: &Quadrature, curvature: &[f32; MAX_GAUGES]) -> Posture {
    if let Some((k, _)) = rule.as_gentle(curvature) {
        return end(strip, &rule.gentle, &k, small_angle::sin_cos).0;
    }
    let k = masked(curvature, rule.interpolant.mask);
    end(strip, &rule.any, &k, sin_cos).0
}

/// The posture, with what its covariance is made of: the derivatives of the flexible part and the
/// lever of the rigid tip.
#[inline(always)]
fn end<const N: usize, const Q: usize>(
    strip: &Strip,
    angles: &Angles<N, Q>,
    k: &[f32; N],
    sin_cos: impl Fn(f32) -> (f32, f32),
) -> (Posture, [[f32; N]; 2], (f32, f32)) {
    let ([x, y], derivatives) = angles.end(k, &sin_cos);
    let phi = dot(&angles.tip, k);
    let (s, c) = sin_cos(phi);
    let lever = (-strip.rigid_tip * s, strip.rigid_tip * c);
    let posture = Posture::new(
        strip.rigid_root + strip.length * x + lever.1,
        strip.length * y - lever.0,
        phi,
    );
    (posture, derivatives, lever)
}

#[inline(always)]
fn finish<const N: usize, const Q: usize>(
    strip: &Strip,
    angles: &Angles<N, Q>,
    k: &[f32; N],
    highest: f32,
    sin_cos: impl Fn(f32) -> (f32, f32),
) -> RelativePosture {
    let (posture, [x_by, y_by], lever) = end(strip, angles, k, sin_cos);
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
    /// Variance of a gauge's curvature, what it shares with the others left out, 1/m².
    #[inline(always)]
    pub(super) fn gauge_variance(&self, curvature: f32) -> f32 {
        let gain = self.uncertainty.gain * curvature;
        self.still_variance + gain * gain
    }
}

#[cfg(test)]
mod tests {
    use super::super::reference::{Elastica, Random, integrate, polynomial};
    use super::super::strip::{Config, PerGauge, Uncertainty};
    use super::*;
    use std::vec::Vec;

    const LENGTH: f64 = 0.37;

    fn placements() -> Vec<Vec<f64>> {
        let uniform = |n: usize| {
            (0..n)
                .map(|i| LENGTH * (i as f64 + 0.5) / n as f64)
                .collect()
        };
        let ends = |n: usize| (0..n).map(|i| LENGTH * i as f64 / (n - 1) as f64).collect();
        vec![
            super::super::strip::GAUSS_5
                .iter()
                .map(|f| LENGTH * f64::from(*f))
                .collect(),
            uniform(2),
            uniform(3),
            uniform(5),
            uniform(8),
            ends(4),
            ends(6),
        ]
    }

    fn strip(gauges: &[f64], change: impl Fn(&mut Config)) -> Strip {
        let gauges: Vec<f32> = gauges.iter().map(|g| *g as f32).collect();
        let mut config = Config {
            gauges_m: PerGauge::new(&gauges).unwrap(),
            ..Config::default()
        };
        change(&mut config);
        config.build().unwrap()
    }

    fn rule(strip: &Strip, mask: GaugeMask) -> Quadrature {
        Quadrature::new(strip, Interpolant::new(strip, mask).unwrap())
    }

    fn padded(values: &[f64]) -> [f32; MAX_GAUGES] {
        let values: Vec<f32> = values.iter().map(|v| *v as f32).collect();
        PerGauge::new(&values).unwrap().padded()
    }

    /// Smooth bends up to 10 1/m whose end angle is at most 1.5 rad.
    fn smooth(random: &mut Random, gauges: &[f64]) -> Vec<f64> {
        loop {
            let amplitude = random.between(0.5, 5.0);
            let (a, b, w, p) = (
                random.between(-1.0, 1.0),
                random.between(-1.0, 1.0),
                random.between(0.0, 5.0),
                random.between(0.0, 6.3),
            );
            let k: Vec<f64> = gauges
                .iter()
                .map(|g| amplitude * (a + b * (w * g / LENGTH + p).sin()))
                .collect();
            let end = integrate(LENGTH, 40, |s| polynomial(gauges, &k, s));
            if end[2].abs() < 1.5 {
                return k;
            }
        }
    }

    #[test]
    fn both_methods_match_the_same_polynomial_in_f64() {
        let mut random = Random(1);
        let (mut worst_m, mut worst_rad) = (0.0f64, 0.0f64);
        for gauges in placements() {
            let strip = strip(&gauges, |_| {});
            let rule = rule(&strip, strip.gauges);
            for _ in 0..60 {
                let k = smooth(&mut random, &gauges);
                let fast = quadrature(&strip, &rule, &padded(&k)).posture;
                let exact = integrate(LENGTH, 400, |s| polynomial(&gauges, &k, s));
                let pieces = piecewise(&strip, &rule, &padded(&k), 100).posture;
                // The same arcs in f64, in the paper's form with its division.
                let (mut x, mut y, mut phi) = (0.0, 0.0, 0.0f64);
                for i in 0..100 {
                    let d_length = LENGTH / 100.0;
                    let rho = 1.0 / polynomial(&gauges, &k, (i as f64 + 0.5) * d_length);
                    let d_phi = d_length / rho;
                    let (dx, dy) = (rho * d_phi.sin(), rho * (1.0 - d_phi.cos()));
                    x += phi.cos() * dx - phi.sin() * dy;
                    y += phi.sin() * dx + phi.cos() * dy;
                    phi += d_phi;
                }
                for (found, expected) in [(fast, exact), (pieces, [x, y, phi])] {
                    worst_m = worst_m
                        .max((f64::from(found.x) - expected[0]).abs())
                        .max((f64::from(found.y) - expected[1]).abs());
                    worst_rad = worst_rad.max((f64::from(found.phi) - expected[2]).abs());
                }
            }
        }
        println!("worst {worst_m:e} m, {worst_rad:e} rad");
        assert!(
            worst_m < 5e-7 && worst_rad < 1.2e-6,
            "{worst_m:e} {worst_rad:e}"
        );
    }

    /// Eight nodes where they are enough: for any readings at all that pass, and for the shapes of
    /// a robot, which pass.
    #[test]
    fn gentle_bends_lose_nothing_and_are_the_rule() {
        let mut random = Random(9);
        for gauges in placements() {
            let strip = strip(&gauges, |c| c.rigid_tip_m = 0.02);
            let rule = rule(&strip, strip.gauges);
            let mut passed = 0;
            for _ in 0..3000 {
                let size = random.between(0.1, 4.0);
                let rough = random.between(0.0, 2.0);
                let k: Vec<f64> = gauges
                    .iter()
                    .map(|_| size + rough * random.normal())
                    .collect();
                let both = quadrature(&strip, &rule, &padded(&k)).posture;
                assert_eq!(posture(&strip, &rule, &padded(&k)), both);
                if rule.as_gentle(&padded(&k)).is_none() {
                    continue;
                }
                passed += 1;
                let [x, y, phi] = integrate(LENGTH, 100, |s| polynomial(&gauges, &k, s));
                let (x, y) = (x + 0.02 * phi.cos(), y + 0.02 * phi.sin());
                let error = (f64::from(both.x) - x).hypot(f64::from(both.y) - y);
                assert!(error < 3e-7, "{gauges:?} {k:?}: {error:e}");
            }
            assert!(passed > 100 || gauges.len() > GENTLE_GAUGES, "{passed}");
            if gauges.len() != GENTLE_GAUGES {
                continue;
            }
            let at: Vec<f64> = gauges.iter().map(|g| g / LENGTH).collect();
            for _ in 0..500 {
                let bent = Elastica::random(&mut random, 6.0).bent(&at);
                let k: Vec<f64> = bent.curvature.iter().map(|k| k / LENGTH).collect();
                let small = bent.end[2].abs() < 1.2 && k.iter().all(|k| k.abs() < 3.0);
                assert!(!small || rule.as_gentle(&padded(&k)).is_some(), "{k:?}");
            }
        }
    }

    #[test]
    fn an_arc_ends_where_a_circle_does_and_rigid_ends_extend_it() {
        let (root, tip) = (0.02f64, 0.03f64);
        for gauges in placements() {
            let strip = strip(&gauges, |c| {
                c.rigid_root_m = root as f32;
                c.rigid_tip_m = tip as f32;
            });
            let rule = rule(&strip, strip.gauges);
            for k in [-4.0f64, -1.0, -1e-4, 1e-4, 0.7, 4.0] {
                let phi = k * LENGTH;
                let expected = [
                    root + phi.sin() / k + tip * phi.cos(),
                    (1.0 - phi.cos()) / k + tip * phi.sin(),
                    phi,
                ];
                for found in [
                    quadrature(&strip, &rule, &[k as f32; MAX_GAUGES]).posture,
                    piecewise(&strip, &rule, &[k as f32; MAX_GAUGES], 7).posture,
                ] {
                    let found: [f32; 3] = found.into();
                    for i in 0..3 {
                        assert!((f64::from(found[i]) - expected[i]).abs() < 1e-6);
                    }
                }
            }
            let flat = quadrature(&strip, &rule, &[0.0; MAX_GAUGES]).posture;
            assert!((flat.x - 0.42).abs() < 1e-6 && flat.y == 0.0 && flat.phi == 0.0);
        }
    }

    #[test]
    fn piecewise_converges_to_quadrature_with_the_square_of_the_segment() {
        let gauges = &placements()[0];
        let strip = strip(gauges, |_| {});
        let rule = rule(&strip, strip.gauges);
        let k = padded(&[6.0, 4.0, -1.0, -3.0, 2.0]);
        let limit = quadrature(&strip, &rule, &k).posture;
        let error = |n| piecewise(&strip, &rule, &k, n).posture.distance(limit);
        assert!((error(10) / error(20) - 4.0).abs() < 0.5);
        assert!((error(20) / error(40) - 4.0).abs() < 0.5);
        assert!(error(10_000) < 4e-7);
    }

    #[test]
    fn bending_left_leads_left() {
        let strip = Config::default().build().unwrap();
        let rule = rule(&strip, strip.gauges);
        let curvature = strip.curvature(&[5e-4; MAX_GAUGES]);
        assert_eq!(curvature[0], 1.0);
        let p = quadrature(&strip, &rule, &curvature).posture;
        assert!(p.y > 0.06 && p.phi > 0.36);
    }

    #[test]
    fn a_lost_gauge_leaves_the_polynomial_of_the_rest() {
        let gauges = &placements()[3];
        let strip = strip(gauges, |_| {});
        let rest: Vec<f64> = [0, 1, 3, 4].map(|i| gauges[i]).to_vec();
        let values = [1.0, 2.0, 2.5, 1.0];
        let mut k = padded(&[1.0, 2.0, 0.0, 2.5, 1.0]);
        k[2] = f32::NAN;
        let rule = rule(&strip, strip.gauges.without(2));
        let found = quadrature(&strip, &rule, &k);
        let expected = integrate(LENGTH, 400, |s| polynomial(&rest, &values, s));
        assert!(found.is_sound());
        assert!((f64::from(found.posture.y) - expected[1]).abs() < 1e-6);
        assert!((f64::from(found.posture.phi) - expected[2]).abs() < 2e-6);
        assert!(Interpolant::new(&strip, GaugeMask(0b1)).is_none());
    }

    /// Noise-free readings of elastica shapes: what is left is the polynomial's own error, which
    /// the allowance must cover.
    #[test]
    fn covariance_covers_the_error_between_the_gauges() {
        let mut random = Random(5);
        for gauges in placements() {
            if gauges.len() < 3 {
                continue;
            }
            let strip = strip(&gauges, |c| {
                let u = &mut c.uncertainty;
                (u.noise_strain, u.offset_strain, u.common_offset_strain) = (1e-7, 0.0, 0.0);
                (u.gain, u.common_gain) = (0.0, 0.0);
            });
            let rule = rule(&strip, strip.gauges);
            let at: Vec<f64> = gauges.iter().map(|g| g / LENGTH).collect();
            let (mut covered, n) = (0, 300);
            let mut worst = [0.0f64; 2];
            for _ in 0..n {
                let bent = Elastica::random(&mut random, 12.0).bent(&at);
                let k: Vec<f64> = bent.curvature.iter().map(|k| k / LENGTH).collect();
                let found = quadrature(&strip, &rule, &padded(&k));
                let p: [f32; 3] = found.posture.into();
                let truth = [LENGTH * bent.end[0], LENGTH * bent.end[1], bent.end[2]];
                let error: [f64; 3] = core::array::from_fn(|i| f64::from(p[i]) - truth[i]);
                worst[0] = worst[0].max(error[0].hypot(error[1]));
                worst[1] = worst[1].max(error[2].abs());
                if (0..3).all(|i| error[i].powi(2) <= 9.0 * f64::from(found.covariance[i][i])) {
                    covered += 1;
                }
            }
            println!("{at:.2?}: covered {covered} of {n}, worst {worst:?}");
            assert!(covered >= n * 95 / 100, "{at:?}: {covered}");
        }
    }

    /// The covariance against the spread of postures from perturbed readings.
    #[test]
    fn covariance_matches_monte_carlo() {
        let gauges = &placements()[0];
        let uncertainty = Uncertainty {
            noise_strain: 6e-6,
            offset_strain: 8e-6,
            common_offset_strain: 5e-6,
            gain: 0.02,
            common_gain: 0.01,
            interpolation: 0.0,
            position_m: 1e-6,
            heading_rad: 1e-6,
            ..Uncertainty::default()
        };
        let strip = strip(gauges, |c| {
            c.uncertainty = uncertainty;
            c.rigid_tip_m = 0.05;
        });
        let rule = rule(&strip, strip.gauges);
        let truth = [2.0, 3.0, 3.5, 2.0, -1.0];
        let mut random = Random(7);
        let n = 20_000;
        let samples: Vec<[f64; 3]> = (0..n)
            .map(|_| {
                let thickness = f64::from(strip.half_thickness);
                let offset = 5e-6 / thickness * random.normal();
                let gain = 0.01 * random.normal();
                let k = truth.map(|k| {
                    let own = (6e-6f64.hypot(8e-6)) / thickness * random.normal();
                    k * (1.0 + gain + 0.02 * random.normal()) + offset + own
                });
                let p: [f32; 3] = quadrature(&strip, &rule, &padded(&k)).posture.into();
                p.map(f64::from)
            })
            .collect();
        let found = quadrature(&strip, &rule, &padded(&truth)).covariance;
        let mean: [f64; 3] =
            core::array::from_fn(|i| samples.iter().map(|p| p[i]).sum::<f64>() / n as f64);
        for r in 0..3 {
            for c in 0..3 {
                let sample: f64 = samples
                    .iter()
                    .map(|p| (p[r] - mean[r]) * (p[c] - mean[c]))
                    .sum::<f64>()
                    / n as f64;
                let scale = f64::from(found[r][r] * found[c][c]).sqrt();
                assert!(
                    (f64::from(found[r][c]) - sample).abs() < 0.05 * scale,
                    "{r}{c}: {} {sample}",
                    found[r][c]
                );
            }
        }
    }
}
