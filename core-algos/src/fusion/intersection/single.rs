//! The intersection in plain `f32`, for inputs that are conditioned well enough: a twentieth of
//! the cost of two floats.
//!
//! With A = L D Lᵀ and the symmetric Γ = D^-½ L⁻¹ (B − A) L⁻ᵀ D^-½,
//!
//! - det S = det A · c(ω), c = 1 + g₁ ω + g₂ ω² + g₃ ω³, gᵢ the elementary symmetric functions of
//!   Γ's eigenvalues: the weight of least determinant solves a quadratic equation;
//! - tr(W P) = tr(W A) + (1 − ω) q(ω)/c(ω), q = t₁ + t₂ ω + t₃ ω² with t₁ = tr(W (B − A)),
//!   t₂ = g₁ t₁ − tr(W (B − A) A⁻¹ (B − A)), t₃ = g₃ tr(W A): the weight of least trace is a zero
//!   of a polynomial, found by Newton's method from one half.
//!
//! Γ comes from the difference of the inputs, not from their quotient, so inputs that are nearly
//! alike lose nothing. Rounding moves the zero by what the rounding of the residual is against
//! its slope, and the entries of P by what cancels in their sums. Where either is too much, or a
//! matrix is too nearly singular, there is no answer, and two floats take over.

use super::Criterion;
use crate::math::greater;
use crate::math::matrix::{Mat3, Vec3};
use crate::math::trig::sqrt;

/// Least pivot of A or S as a share of the variance it belongs to.
const LEAST_PIVOT: f32 = 0.05;
/// The same of B, from which nothing is solved.
const LEAST_PIVOT_OF_B: f32 = 1e-4;
/// Least pivot at all, in squared units: products of smaller ones would lose digits.
const TINY: f32 = 1e-18;
/// Rounding of a residual, in units of the sum of its terms' magnitudes.
const ROUNDING: f32 = 6e-8;
/// Largest error of ω by that estimate as a share of [`Contrast::span`]. The estimate is ten times
/// too high as a rule: of 10⁶ random pairs the worst ω is 1.7e-6 off, the worst entry of P 1.6e-6.
const DETERMINANT_TOLERANCE: f32 = 1e-5;
const TRACE_TOLERANCE: f32 = 5e-5;
/// Largest square of the terms of an entry of P against its value.
const CANCELLATION: f32 = 50.0;
/// Newton steps to the weight of least trace.
const MAX_SEARCH: usize = 10;

/// ω and 1 − ω, x − a and P.
pub(super) type Single = ([f32; 2], Vec3, Mat3);

/// Two covariances (lower triangles are read) and what would be lost by subtracting them here.
pub(super) struct Inputs<'a> {
    pub(super) a: &'a Mat3,
    pub(super) b: &'a Mat3,
    /// B − A, lower triangle.
    pub(super) gap: Mat3,
    /// b − a, heading wrapped.
    pub(super) difference: Vec3,
}

/// `L D Lᵀ` of a symmetric matrix.
struct Factor {
    l10: f32,
    l20: f32,
    l21: f32,
    /// Inverse pivots.
    inverse: Vec3,
    /// Product of the pivots as shares of their variances.
    share: f32,
}

impl Factor {
    /// `None` if a pivot is not above `least` of its variance.
    #[inline(always)]
    fn new(m: &Mat3, least: f32) -> Option<Self> {
        let i0 = 1.0 / m[0][0];
        let (l10, l20) = (m[1][0] * i0, m[2][0] * i0);
        let d1 = m[1][1] - l10 * m[1][0];
        let rest = m[2][1] - l20 * m[1][0];
        let i1 = 1.0 / d1;
        let l21 = rest * i1;
        let d2 = m[2][2] - l20 * m[2][0] - l21 * rest;
        let regular = m[0][0] > TINY && d1 - least * m[1][1] > TINY && d2 - least * m[2][2] > TINY;
        regular.then(|| Self {
            l10,
            l20,
            l21,
            inverse: [i0, i1, 1.0 / d2],
            share: (d1 * d2) / (m[1][1] * m[2][2]),
        })
    }

    /// `L⁻¹ v`.
    #[inline(always)]
    fn lower(&self, v: Vec3) -> Vec3 {
        let x1 = v[1] - self.l10 * v[0];
        [v[0], x1, v[2] - self.l20 * v[0] - self.l21 * x1]
    }

    /// `D⁻¹ v`.
    #[inline(always)]
    fn weighed(&self, v: Vec3) -> Vec3 {
        let d = &self.inverse;
        [v[0] * d[0], v[1] * d[1], v[2] * d[2]]
    }
}

/// Column `j` of a symmetric matrix.
#[inline(always)]
fn column(m: &Mat3, j: usize) -> Vec3 {
    [m[j][0], m[j.max(1)][j.min(1)], m[2][j]]
}

#[inline(always)]
fn dot(a: &Vec3, b: &Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A symmetric matrix, its lower triangle read.
fn full(m: &Mat3) -> Mat3 {
    [column(m, 0), column(m, 1), column(m, 2)]
}

/// The intersection by `criterion`, `trace_weights` the diagonal of W. `None` where `f32` is not
/// enough, or an input is no covariance.
#[inline(always)]
pub(super) fn fuse(
    inputs: &Inputs<'_>,
    criterion: Criterion,
    trace_weights: &Vec3,
) -> Option<Single> {
    let Inputs {
        a,
        b,
        gap,
        difference,
    } = inputs;
    let factor = Factor::new(a, LEAST_PIVOT)?;
    Factor::new(b, LEAST_PIVOT_OF_B)?;
    let contrast = Contrast::new(&factor, gap);
    let [w, v] = match criterion {
        Criterion::Determinant => contrast.least_determinant(),
        Criterion::Trace => contrast.least_trace(&factor, trace_weights, a, gap),
    }?;
    if v == 0.0 {
        return Some(([w, v], [0.0; 3], full(a)));
    }
    if w == 0.0 {
        return Some(([w, v], *difference, full(b)));
    }
    let mut s = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in 0..=i {
            s[i][j] = w * b[i][j] + v * a[i][j];
        }
    }
    let s = Factor::new(&s, LEAST_PIVOT)?;
    // P = (L⁻¹ A)ᵀ D⁻¹ (L⁻¹ B), x − a = v (L⁻¹ A)ᵀ D⁻¹ L⁻¹ (b − a), L and D those of S.
    let by_a = [
        s.lower(column(a, 0)),
        s.lower(column(a, 1)),
        s.lower(column(a, 2)),
    ];
    let seen = s.weighed(s.lower(*difference));
    let shift = [
        v * dot(&by_a[0], &seen),
        v * dot(&by_a[1], &seen),
        v * dot(&by_a[2], &seen),
    ];
    let mut p = [[0.0; 3]; 3];
    for j in 0..3 {
        let by_b = s.weighed(s.lower(column(b, j)));
        for i in j..3 {
            p[i][j] = dot(&by_a[i], &by_b);
            p[j][i] = p[i][j];
        }
    }
    // The terms of these sums are bounded by those of A S⁻¹ A and B S⁻¹ B.
    let (mut by_a, mut by_b) = (0.0, 0.0);
    for i in 0..3 {
        let scale = 1.0 / p[i][i];
        by_a = greater(by_a, a[i][i] * scale);
        by_b = greater(by_b, b[i][i] * scale);
    }
    (by_a * by_b < CANCELLATION * contrast.shrinking(w, v)).then_some(([w, v], shift, p))
}

/// Difference of B from A, in A's own units.
struct Contrast {
    /// Columns of L⁻¹ (B − A).
    half: [Vec3; 3],
    /// g₁, g₂, g₃.
    symmetric: Vec3,
    /// |Γ|, its Frobenius norm.
    size: f32,
    /// Conditioning of A, at most 1.
    share: f32,
}

impl Contrast {
    #[inline(always)]
    fn new(a: &Factor, gap: &Mat3) -> Self {
        let half = [
            a.lower(column(gap, 0)),
            a.lower(column(gap, 1)),
            a.lower(column(gap, 2)),
        ];
        // G = L⁻¹ (B − A) L⁻ᵀ, row by row.
        let [[g00, g10, g20], c1, c2] = half;
        let g11 = c1[1] - a.l10 * g10;
        let g21 = c1[2] - a.l10 * g20;
        let g22 = c2[2] - a.l20 * g20 - a.l21 * g21;
        let [i0, i1, i2] = a.inverse;
        let (u0, u1, u2) = (g00 * i0, g11 * i1, g22 * i2);
        let (h10, h20, h21) = (g10 * i0, g20 * i0, g21 * i1);
        let (q10, q20, q21) = (h10 * (g10 * i1), h20 * (g20 * i2), h21 * (g21 * i2));
        let m01 = u0 * u1 - q10;
        let m12 = u1 * u2 - q21;
        let g2 = m01 + (u0 * u2 - q20) + m12;
        let g3 = u2 * m01 + 2.0 * (h10 * h21) * (g20 * i2) - u0 * q21 - u1 * q20;
        let squares = u0 * u0 + u1 * u1 + u2 * u2 + 2.0 * (q10 + q20 + q21);
        Self {
            half,
            symmetric: [u0 + u1 + u2, g2, g3],
            size: sqrt(squares),
            share: a.share,
        }
    }

    /// The change of ω that changes P by its own size, at least: P hardly feels a small weight
    /// unless B differs much from A.
    #[inline(always)]
    fn span(&self, w: f32, v: f32) -> f32 {
        w * v + 0.25 / (1.0 + 16.0 * self.size * self.size)
    }

    /// Least share of A in A S⁻¹ A, inverted, times that of B in B S⁻¹ B, from the bounds of the
    /// eigenvalues of A⁻¹ B, 1 ± |Γ| and 0.
    #[inline(always)]
    fn shrinking(&self, w: f32, v: f32) -> f32 {
        (v + w * greater(1.0 - self.size, 0.0)) * (w + v / (1.0 + self.size))
    }

    /// Weights of least determinant.
    #[inline(always)]
    fn least_determinant(&self) -> Option<[f32; 2]> {
        let ([g1, g2, g3], size) = (self.symmetric, self.size);
        // Bernstein coefficients of c', which changes its sign at most once, from + to −.
        let (start, middle, end) = (g1, g1 + g2, g1 + 2.0 * g2 + 3.0 * g3);
        let margin = 10.0 * ROUNDING / self.share * size;
        if start < -margin {
            return Some([0.0, 1.0]);
        }
        if end > margin * (1.0 + size) * (1.0 + size) {
            return Some([1.0, 0.0]);
        }
        // start v² + 2 middle v w + end w² = 0 as a quotient of two positive numbers.
        let root = sqrt(middle * middle - start * end);
        let (above, below) = if middle >= 0.0 {
            (middle + root, -end)
        } else {
            (start, root - middle)
        };
        let scale = 1.0 / (above + below);
        let (w, v) = (above * scale, below * scale);
        let terms = v + w * (1.0 + 1.5 * size);
        let rounding = ROUNDING * size * (terms * terms);
        let good = rounding < DETERMINANT_TOLERANCE * self.share * (self.span(w, v) * root)
            && w > 0.0
            && v > 0.0;
        good.then_some([w, v])
    }

    /// Weights of least trace, for tr(W A) and tr(W (B − A)).
    #[inline(always)]
    fn least_trace(&self, a: &Factor, weights: &Vec3, m: &Mat3, gap: &Mat3) -> Option<[f32; 2]> {
        let ([g1, g2, g3], size) = (self.symmetric, self.size);
        let trace = |m: &Mat3| dot(weights, &[m[0][0], m[1][1], m[2][2]]);
        let (of_a, t1) = (trace(m), trace(gap));
        let first = weights[0] * gap[0][0].abs()
            + weights[1] * gap[1][1].abs()
            + weights[2] * gap[2][2].abs();
        let mut squared = 0.0;
        for i in 0..3 {
            let column = self.half[i];
            squared += weights[i] * dot(&column, &a.weighed(column));
        }
        let (t2, t3) = (g1 * t1 - squared, g3 * of_a);
        // Slope of the trace at both ends; it rises from one to the other.
        let higher = squared + size * (first + size * size * of_a);
        let rounding = ROUNDING * (first + higher / self.share);
        let at_end = t1 + t2 + t3;
        if t1 + squared < -10.0 * rounding {
            return Some([0.0, 1.0]);
        }
        if at_end > 10.0 * rounding * (1.0 + size) * (1.0 + size) {
            return Some([1.0, 0.0]);
        }
        let mut w = 0.5;
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..MAX_SEARCH {
            let v = 1.0 - w;
            // q, c, their derivatives, and the slope's numerator v (q' c − q c') − q c.
            let q = t1 + w * (t2 + w * t3);
            let q1 = t2 + 2.0 * w * t3;
            let c = 1.0 + w * (g1 + w * (g2 + w * g3));
            let c1 = g1 + w * (2.0 * g2 + 3.0 * w * g3);
            let slope = v * (q1 * c - q * c1) - q * c;
            // Of the slope itself, slope/c²: its derivative times c².
            let rise = v * (2.0 * t3 * c - q * (2.0 * g2 + 6.0 * w * g3))
                - 2.0 * (q1 * c + slope * c1 / c);
            let step = -slope / rise;
            if slope < 0.0 {
                low = w;
            } else {
                high = w;
            }
            let mut next = w + step;
            if !(next > low && next < high) {
                next = 0.5 * (low + high);
            } else if step.abs() <= 3e-4 * self.span(w, v) {
                let v = 1.0 - next;
                let terms = 1.0 + next * size;
                let rounding = rounding * (terms * terms * terms);
                return (rounding < TRACE_TOLERANCE * self.span(next, v) * rise && v > 0.0)
                    .then_some([next, v]);
            }
            w = next;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Config, ExtendedEstimate};
    use super::*;
    use crate::fusion::Estimate;
    use crate::fusion::testing::{self, Random, covariance_error, is_definite};
    use crate::math::Posture;
    use crate::math::matrix::propagate;

    /// Covariances of the robot's size: lateral error and heading correlated.
    fn covariance(random: &mut Random, spread: f64) -> Mat3 {
        let mut root = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..i {
                root[i][j] = (0.5 * spread * random.normal()) as f32;
            }
            root[i][i] = (spread * random.normal()).exp() as f32;
        }
        let size = [[1e-3, 0.0, 0.0], [0.0, 2e-3, 0.0], [0.0, 0.0, 5e-3]];
        propagate(&size, &propagate(&root, &crate::math::matrix::identity()))
    }

    /// L D Lᵀ is the matrix; each pivot has to exceed its least share by more than the tiniest.
    #[test]
    fn factor_is_refused_for_a_pivot_at_its_bound() {
        for (diagonal, below, least, regular) in [
            ([1.0, 2.0, 3.0], [0.5, 0.3, -0.4], 0.05, true),
            ([TINY, 1.0, 1.0], [0.0; 3], 0.0, false),
            ([1.0, TINY, 1.0], [0.0; 3], 0.0, false),
            ([1.0, 1.0, TINY], [0.0; 3], 0.0, false),
            ([TINY.next_up(); 3], [0.0; 3], 0.0, true),
            // Pivots of 0.75 and 0.4375 of the variance.
            ([1.0, 4.0, 9.0], [1.0, 0.0, 0.0], 0.5, true),
            ([1.0, 4.0, 9.0], [1.5, 0.0, 0.0], 0.5, false),
            ([1.0, 4.0, 9.0], [0.0, 1.5, 0.0], 0.5, true),
            ([1.0, 4.0, 9.0], [0.0, 2.25, 0.0], 0.5, false),
            ([1.0, 4.0, 9.0], [0.0, 0.0, 3.0], 0.5, true),
            ([1.0, 4.0, 9.0], [0.0, 0.0, 4.5], 0.5, false),
            ([1.0, -4.0, 9.0], [0.0; 3], 0.5, false),
            ([1.0, 4.0, -9.0], [0.0; 3], 0.5, false),
            ([1.0, 4.0, f32::NAN], [0.0; 3], 0.5, false),
        ] {
            let [d0, d1, d2] = diagonal;
            let [m10, m20, m21] = below;
            let m = [
                [d0, f32::NAN, f32::NAN],
                [m10, d1, f32::NAN],
                [m20, m21, d2],
            ];
            let factor = Factor::new(&m, least);
            assert_eq!(factor.is_some(), regular, "{diagonal:?} {below:?}");
            let Some(factor) = factor.filter(|_| least > 0.0) else {
                continue;
            };
            let l = [
                [1.0, 0.0, 0.0],
                [factor.l10, 1.0, 0.0],
                [factor.l20, factor.l21, 1.0],
            ];
            let d = crate::math::matrix::diagonal(factor.inverse.map(|inverse| 1.0 / inverse));
            let found = propagate(&l, &d);
            for (i, j) in [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)] {
                assert!((found[i][j] - m[i][j]).abs() < 2e-6, "{i} {j}");
            }
            let share = d[1][1] * d[2][2] / (m[1][1] * m[2][2]);
            assert!((factor.share / share - 1.0).abs() < 1e-6);
        }
    }

    /// Newton's method from one half leaves [0, 1] for these variances of B, A's being one, and weights of the trace.
    #[test]
    fn weight_of_least_trace_is_found_where_a_step_leaves_the_bracket() {
        for (b, weights) in [
            ([0.803, 4.08, 1.84], [7.04, 0.11, 0.111]),
            ([1.1, 1.01, 0.29], [2.77, 1.02, 0.15]),
            ([1.01, 0.8, 4.3], [0.06, 8.71, 0.17]),
            ([0.96, 1.35, 0.23], [0.37, 2.37, 0.3]),
        ] {
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..40 {
                let omega = 0.5 * (low + high);
                let slope: f64 = (0..3)
                    .map(|k| {
                        let (b, s) = (f64::from(b[k]), 1.0 + omega * (f64::from(b[k]) - 1.0));
                        f64::from(weights[k]) * b * (1.0 - b) / (s * s)
                    })
                    .sum();
                *if slope < 0.0 { &mut low } else { &mut high } = omega;
            }
            let inputs = Inputs {
                a: &crate::math::matrix::identity(),
                b: &crate::math::matrix::diagonal(b),
                gap: crate::math::matrix::diagonal(b.map(|b| b - 1.0)),
                difference: [0.0; 3],
            };
            let ([omega, _], ..) = fuse(&inputs, Criterion::Trace, &weights).unwrap();
            assert!(
                (f64::from(omega) - low).abs() < 3e-6,
                "{b:?}: {omega} {low}"
            );
        }
    }

    /// Answers in `f32` equal those of two floats; few cases are left to two floats where neither
    /// input is much worse and errors are hardly correlated.
    #[test]
    fn answers_are_those_of_two_floats() {
        let mut random = Random::new(1);
        for criterion in [Criterion::Determinant, Criterion::Trace] {
            let intersection = Config {
                criterion,
                ..Config::default()
            };
            let intersection = intersection.build().unwrap();
            for (spread, least) in [(0.1, 0.85), (0.3, 0.7), (0.8, 0.1)] {
                let (mut answered, n) = (0, 2000);
                for _ in 0..n {
                    let a = Estimate::new(Posture::ORIGIN, covariance(&mut random, spread));
                    let b = covariance(&mut random, spread);
                    let b = Estimate::new(Posture::new(2e-3, -3e-3, 8e-3), b);
                    let mut gap = b.covariance;
                    for i in 0..3 {
                        for j in 0..3 {
                            gap[i][j] -= a.covariance[i][j];
                        }
                    }
                    let inputs = Inputs {
                        a: &a.covariance,
                        b: &b.covariance,
                        gap,
                        difference: b.posture.into(),
                    };
                    let wide = (ExtendedEstimate::from(&a), ExtendedEstimate::from(&b));
                    let exact = intersection.fuse_wide(&wide.0, &wide.1).unwrap();
                    let Some(([w, v], shift, p)) = fuse(&inputs, criterion, &intersection.weights)
                    else {
                        continue;
                    };
                    answered += 1;
                    assert!(is_definite(&testing::wide(&p)));
                    assert!((w - exact.omega).abs() < 3e-6 && (w + v - 1.0).abs() < 1e-6);
                    let x: Vec3 = exact.estimate.posture.into();
                    let q = &exact.estimate.covariance;
                    for i in 0..3 {
                        assert!((shift[i] - x[i]).abs() < 1e-5 * sqrt(q[i][i]) + 3e-6 * x[i].abs());
                    }
                    let error = covariance_error(&p, &testing::wide(q));
                    assert!(error < 3e-6, "{error:e}");
                }
                let share = f64::from(answered) / f64::from(n);
                println!("{criterion:?}, spread {spread}: {share}");
                assert!(share > least, "{criterion:?}, spread {spread}: {share}");
            }
        }
    }
}
