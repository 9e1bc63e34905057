//! Covariance intersection of two posture estimates whose errors are correlated to an unknown
//! degree (Julier and Uhlmann; paper section VI-B).
//!
//! P⁻¹ = ω A⁻¹ + (1 − ω) B⁻¹ and P⁻¹ x = ω A⁻¹ a + (1 − ω) B⁻¹ b, evaluated without an inverse of A
//! or B: S = ω B + (1 − ω) A, P = A S⁻¹ B, x = a + (1 − ω) A S⁻¹ (b − a), heading difference
//! wrapped. ω = 1 keeps `a`, ω = 0 keeps `b`. The result is consistent for every cross-correlation
//! of two consistent inputs.
//!
//! **Weight.** With A = L D Lᵀ and N = L⁻¹ B L⁻ᵀ, det S = det A · det((1 − ω) I + ω M),
//! M = D⁻¹ N, is a cubic in ω whose Bernstein coefficients are the elementary symmetric functions
//! of M's eigenvalues, all positive. Least det P is greatest det S: a quadratic equation, solved
//! without cancellation. If one input is better by that measure whatever the other adds, ω is
//! exactly 0 or 1. Least tr(W P) is the zero of the derivative of a convex function, found by
//! Newton's method kept inside a bracket.
//!
//! **Arithmetic.** P is flat in ω and the inputs may differ in size by many decades. Inputs that
//! are conditioned well enough, by a check that is part of the computation, are treated in `f32`
//! (`single.rs`; about 600 instructions). For the others the matrices are scaled by A's standard
//! deviations (rounded to powers of two, hence exactly) and the algebra runs in [`TwoFloat`] (about
//! 15 000 for the determinant): the results are good to `f32` rounding for standard deviations in
//! a ratio of 1000, in any direction. Either way ω is within 5e-6 and the normalised covariance within
//! 1e-5. At a ratio of 10⁴ between opposed inputs two floats have too few digits: a variance can be
//! wrong by its own size.
//!
//! Nothing here panics; an input that is not finite or not positive definite gives `None`.
//!
//! # Example
//!
//! ```
//! use core_algos::fusion::Estimate;
//! use core_algos::fusion::intersection::Config;
//! use core_algos::math::Posture;
//!
//! let a = Estimate::with_sigmas(Posture::new(1.0, 0.0, 0.0), [0.01, 0.1, 0.02]);
//! let b = Estimate::with_sigmas(Posture::new(1.2, 0.1, 0.0), [0.1, 0.01, 0.02]);
//! let fused = Config::default().build()?.fuse(&a, &b).expect("both are positive definite");
//! // Each coordinate comes from the one that knows it, and is not claimed to be known better.
//! assert!((fused.omega - 0.5).abs() < 1e-3);
//! let Estimate { posture, covariance } = fused.estimate;
//! assert!((posture.x - 1.0).abs() < 5e-3 && (posture.y - 0.1).abs() < 5e-3);
//! assert!(covariance[0][0] > 0.01 * 0.01 && covariance[1][1] > 0.01 * 0.01);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

use super::Estimate;
use crate::config::{ConfigError, config};
use crate::math::matrix::Mat3;
use crate::math::trig::{sqrt, wrap_angle};
use crate::math::{Posture, TwoFloat};

mod single;

type Wide3 = [TwoFloat; 3];
type Wide33 = [[TwoFloat; 3]; 3];

/// Steps of the search for the weight of least trace; it ends far earlier unless the inputs are
/// extreme.
const MAX_SEARCH: usize = 64;

/// Criterion that the fused covariance minimises.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Criterion {
    /// Determinant: independent of the units of position and heading.
    #[default]
    #[cfg_attr(feature = "serde", serde(alias = "det"))]
    Determinant,
    /// Trace, heading variance weighted by the square of a length.
    Trace,
}

config! {
    /// Parameters of covariance intersection.
    pub struct Config {
        /// Criterion that the fused covariance minimises.
        pub criterion: Criterion = Criterion::Determinant;
        /// Length that turns a heading error into a position error in the trace criterion, m.
        pub heading_length_m: f32 = 0.2, Positive;
    }
}

impl Config {
    /// The ready form; an error names the parameter out of range.
    pub fn build(&self) -> Result<Intersection, ConfigError> {
        self.check_ranges()?;
        let length = self.heading_length_m;
        Ok(Intersection {
            criterion: self.criterion,
            weights: [1.0, 1.0, length * length],
        })
    }
}

/// Covariance intersection, ready to run. It has no state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intersection {
    criterion: Criterion,
    /// Diagonal of W.
    weights: [f32; 3],
}

/// Result of covariance intersection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fused {
    /// Weight of `a`'s information, 0 to 1; `b`'s is the rest.
    pub omega: f32,
    /// The fused estimate.
    pub estimate: Estimate,
}

/// A posture and covariance with more digits than `f32`, for inputs whose covariance is so nearly
/// singular that rounding it would change the result.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ExtendedEstimate {
    /// Position (m) and heading (rad).
    pub posture: [TwoFloat; 3],
    /// Covariance of (x, y, phi); the lower triangle is read.
    pub covariance: [[TwoFloat; 3]; 3],
}

impl From<&Estimate> for ExtendedEstimate {
    fn from(estimate: &Estimate) -> Self {
        let posture: [f32; 3] = estimate.posture.into();
        Self {
            posture: posture.map(TwoFloat::from_f32),
            covariance: estimate.covariance.map(|row| row.map(TwoFloat::from_f32)),
        }
    }
}

impl Intersection {
    /// The intersection of two estimates in one frame. `None` unless both covariances are positive
    /// definite and all numbers finite.
    pub fn fuse(&self, a: &Estimate, b: &Estimate) -> Option<Fused> {
        let mut gap = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..=i {
                gap[i][j] = b.covariance[i][j] - a.covariance[i][j];
            }
        }
        let inputs = single::Inputs {
            a: &a.covariance,
            b: &b.covariance,
            gap,
            difference: b.posture.minus(a.posture),
        };
        self.fuse_single(a.posture.into(), &inputs)
            .or_else(|| self.fuse_wide(&ExtendedEstimate::from(a), &ExtendedEstimate::from(b)))
    }

    /// [`Self::fuse`] for inputs with more digits than `f32`.
    pub fn fuse_extended(&self, a: &ExtendedEstimate, b: &ExtendedEstimate) -> Option<Fused> {
        let mut gap = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..=i {
                gap[i][j] = b.covariance[i][j].minus(a.covariance[i][j]);
            }
        }
        let nearest = |m: &Wide33| m.map(|row| row.map(|entry| entry.high));
        let inputs = single::Inputs {
            a: &nearest(&a.covariance),
            b: &nearest(&b.covariance),
            gap,
            difference: difference(a, b).map(TwoFloat::value),
        };
        self.fuse_single(a.posture.map(TwoFloat::value), &inputs)
            .or_else(|| self.fuse_wide(a, b))
    }

    /// In `f32`, where that is enough.
    #[inline]
    fn fuse_single(&self, base: [f32; 3], inputs: &single::Inputs<'_>) -> Option<Fused> {
        let ([omega, _], shift, covariance) = single::fuse(inputs, self.criterion, &self.weights)?;
        let x = [base[0] + shift[0], base[1] + shift[1], base[2] + shift[2]];
        let estimate = Estimate::new(Posture::new(x[0], x[1], wrap_angle(x[2])), covariance);
        // What is not finite makes their sum so; that of finite numbers is far from overflow.
        let sum = x[0] + x[1] + x[2] + inputs.difference[0] + inputs.difference[1];
        (sum + inputs.difference[2])
            .is_finite()
            .then_some(Fused { omega, estimate })
    }

    /// In two floats.
    #[cold]
    #[inline(never)]
    fn fuse_wide(&self, a: &ExtendedEstimate, b: &ExtendedEstimate) -> Option<Fused> {
        let pair = Pair::new(a, b)?;
        let omega = match self.criterion {
            Criterion::Determinant => pair.weight_of_least_determinant(),
            Criterion::Trace => pair.weight_of_least_trace(&self.weights),
        };
        Some(Fused {
            omega: omega.value(),
            estimate: pair.combine(omega, TwoFloat::ONE - omega)?,
        })
    }
}

/// b − a, the heading wrapped.
fn difference(a: &ExtendedEstimate, b: &ExtendedEstimate) -> Wide3 {
    let mut difference = [0, 1, 2].map(|i| b.posture[i] - a.posture[i]);
    if !(difference[2].high.abs() <= core::f32::consts::PI) {
        difference[2] = wrap_wide(difference[2]);
    }
    difference
}

/// Two estimates brought to the coordinates in which they are compared.
pub(super) struct Pair {
    /// a, and b − a in scaled coordinates with the heading wrapped.
    base: Wide3,
    difference: Wide3,
    /// Powers of two near A's standard deviations.
    scale: [f32; 3],
    /// Unit lower factor and pivots of the scaled A, and the pivots of N.
    lower: Wide33,
    pivots: Wide3,
    n_pivots: Wide3,
    /// L⁻¹ B L⁻ᵀ.
    n: Wide33,
}

impl Pair {
    pub(super) fn new(a: &ExtendedEstimate, b: &ExtendedEstimate) -> Option<Self> {
        let mut scale = [1.0; 3];
        let mut difference = difference(a, b);
        for i in 0..3 {
            scale[i] = power_of_two_below(sqrt(a.covariance[i][i].high))?;
            difference[i] = scaled(difference[i], 1.0 / scale[i]);
        }
        let in_scale = |m: &Wide33| {
            let mut out = *m;
            for i in 0..3 {
                for j in 0..3 {
                    out[i][j] = scaled(
                        scaled(m[i.max(j)][i.min(j)], 1.0 / scale[i]),
                        1.0 / scale[j],
                    );
                }
            }
            out
        };
        let (lower, pivots) = factor(&in_scale(&a.covariance))?;
        // Columns of B, then rows: N = L⁻¹ (L⁻¹ B)ᵀ.
        let mut half = in_scale(&b.covariance);
        for row in &mut half {
            *row = solve_lower(&lower, row);
        }
        let mut n = [[TwoFloat::ZERO; 3]; 3];
        for j in 0..3 {
            n[j] = solve_lower(&lower, &[half[0][j], half[1][j], half[2][j]]);
        }
        let (_, n_pivots) = factor(&n)?;
        Some(Self {
            base: a.posture,
            difference,
            scale,
            lower,
            pivots,
            n_pivots,
            n,
        })
    }

    /// Elementary symmetric functions of M's eigenvalues: sum, sum of pairs, product, for M
    /// divided by κ = tr M/3, which is the last number.
    fn symmetric_functions(&self) -> ([TwoFloat; 3], TwoFloat) {
        let (n, d) = (&self.n, &self.pivots);
        let sum = n[0][0] / d[0] + n[1][1] / d[1] + n[2][2] / d[2];
        let kappa = sum / TwoFloat::from_f32(3.0);
        let minor = |[a, d_a]: [TwoFloat; 2], [b, d_b]: [TwoFloat; 2], cross: TwoFloat| {
            (a * b - cross * cross) / (d_a * kappa) / (d_b * kappa)
        };
        let [first, second, third] = [[n[0][0], d[0]], [n[1][1], d[1]], [n[2][2], d[2]]];
        let pairs = minor(first, second, n[0][1])
            + minor(first, third, n[0][2])
            + minor(second, third, n[1][2]);
        let mut product = TwoFloat::ONE;
        for i in 0..3 {
            product = product * (self.n_pivots[i] / (d[i] * kappa));
        }
        ([TwoFloat::from_f32(3.0), pairs, product], kappa)
    }

    /// The ω in [0, 1] of least det P; 1/2 if both covariances are alike.
    fn weight_of_least_determinant(&self) -> TwoFloat {
        let three = TwoFloat::from_f32(3.0);
        let ([e1, e2, e3], kappa) = self.symmetric_functions();
        let inverse = TwoFloat::ONE / kappa;
        // Bernstein coefficients of d(det S)/dω over 3, for the variable τ = κ ω/(1 − ω).
        let start = (e1 / three - inverse).value();
        let middle = ((e2 - e1 * inverse) / three).value();
        let end = (e3 - e2 * inverse / three).value();
        if start == 0.0 && middle == 0.0 && end == 0.0 {
            return TwoFloat::from_f32(0.5);
        }
        // det S is log-concave: its slope changes sign at most once, from + to −.
        if !(start > 0.0) {
            return TwoFloat::ZERO;
        }
        if !(end < 0.0) {
            return TwoFloat::ONE;
        }
        // start + 2 middle τ + end τ² = 0, root > 0, as a quotient of two positive numbers.
        let root = sqrt(middle * middle - start * end);
        let (above, below) = if middle >= 0.0 {
            (middle + root, -end)
        } else {
            (start, root - middle)
        };
        let above = TwoFloat::from_f32(above);
        above / (above + TwoFloat::from_f32(below) * kappa)
    }

    /// The ω in [0, 1] of least Σ wᵢ Pᵢᵢ; 1/2 if both covariances are alike.
    fn weight_of_least_trace(&self, weights: &[f32; 3]) -> TwoFloat {
        let half = TwoFloat::from_f32(0.5);
        let slope_at = |omega| self.trace_slope(omega, weights);
        let (at_start, at_end) = (slope_at(TwoFloat::ZERO), slope_at(TwoFloat::ONE));
        match (at_start, at_end) {
            (Some((start, _)), Some((end, _))) if start == 0.0 && end == 0.0 => return half,
            (Some((start, _)), _) if start >= 0.0 => return TwoFloat::ZERO,
            (_, Some((end, _))) if end <= 0.0 => return TwoFloat::ONE,
            (Some(_), Some(_)) => {}
            _ => return half,
        }
        let (mut low, mut high, mut omega) = (TwoFloat::ZERO, TwoFloat::ONE, half);
        for _ in 0..MAX_SEARCH {
            let Some((slope, curvature)) = slope_at(omega) else {
                break;
            };
            if slope < 0.0 {
                low = omega;
            } else {
                high = omega;
            }
            let step = -slope / curvature;
            let margin = omega.high.min((TwoFloat::ONE - omega).high);
            if step.abs() <= 1e-5 * margin {
                // Newton's next step is as small against this one as this one is against ω.
                omega = omega.plus(step);
                break;
            }
            let mut next = omega.plus(step);
            // `!(…)` also catches a step that is not a number.
            if !(next.high > low.high && next.high < high.high) {
                next = (low + high) * half;
            }
            if !(next.high > low.high && next.high < high.high) {
                break;
            }
            omega = next;
        }
        omega
    }

    /// First and second derivative of Σ wᵢ Pᵢᵢ with respect to ω:
    /// dP/dω = −B S⁻¹ (B − A) S⁻¹ A, d²P/dω² = 2 B S⁻¹ (B − A) S⁻¹ (B − A) S⁻¹ A.
    fn trace_slope(&self, omega: TwoFloat, weights: &[f32; 3]) -> Option<(f32, f32)> {
        let (t_lower, t_pivots) = factor(&self.mixture(omega, TwoFloat::ONE - omega))?;
        let solve = |v: &Wide3| solve_factored(&t_lower, &t_pivots, v);
        // N − D.
        let apply_gap = |v: &Wide3| {
            let mut out = apply(&self.n, v);
            for i in 0..3 {
                out[i] = out[i] - self.pivots[i] * v[i];
            }
            out
        };
        let (mut slope, mut curvature) = (TwoFloat::ZERO, TwoFloat::ZERO);
        for k in 0..3 {
            let row = &self.lower[k];
            let weight = TwoFloat::from_f32(weights[k])
                * TwoFloat::from_f32(self.scale[k])
                * TwoFloat::from_f32(self.scale[k]);
            let by_a = apply_gap(&solve(&[0, 1, 2].map(|i| self.pivots[i] * row[i])));
            let by_b = solve(&apply(&self.n, row));
            slope = slope - weight * dot(&by_b, &by_a);
            let twice = apply_gap(&solve(&by_a));
            curvature = curvature + weight * dot(&by_b, &twice);
        }
        Some((slope.value(), 2.0 * curvature.value()))
    }

    /// `weight_b D + weight_a N`: S seen through L.
    fn mixture(&self, weight_a: TwoFloat, weight_b: TwoFloat) -> Wide33 {
        let mut t = [[TwoFloat::ZERO; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                t[i][j] = weight_a * self.n[i][j];
            }
            t[i][i] = t[i][i] + weight_b * self.pivots[i];
        }
        t
    }

    /// The estimate with P⁻¹ = weight_a A⁻¹ + weight_b B⁻¹.
    pub(super) fn combine(&self, weight_a: TwoFloat, weight_b: TwoFloat) -> Option<Estimate> {
        let (t_lower, t_pivots) = factor(&self.mixture(weight_a, weight_b))?;
        let solve = |v: &Wide3| solve_factored(&t_lower, &t_pivots, v);
        // P = L [D T⁻¹ N] Lᵀ; the bracket is symmetric, so its columns are its rows.
        let inner = [0, 1, 2].map(|j| {
            let column = solve(&self.n[j]);
            [0, 1, 2].map(|i| self.pivots[i] * column[i])
        });
        let mut covariance: Mat3 = [[0.0; 3]; 3];
        let columns = [0, 1, 2].map(|j| apply(&inner, &self.lower[j]));
        for i in 0..3 {
            for j in 0..=i {
                let entry = dot(&self.lower[i], &columns[j]);
                let entry = scaled(scaled(entry, self.scale[i]), self.scale[j]).value();
                covariance[i][j] = entry;
                covariance[j][i] = entry;
            }
        }
        // x − a = weight_b L D T⁻¹ L⁻¹ (b − a).
        let gain = solve(&solve_lower(&self.lower, &self.difference));
        let gain = [0, 1, 2].map(|i| weight_b * self.pivots[i] * gain[i]);
        let mut x = [0.0; 3];
        for i in 0..3 {
            let shift = dot(&self.lower[i], &gain);
            x[i] = (self.base[i] + scaled(shift, self.scale[i])).value();
        }
        x[2] = wrap_angle(x[2]);
        let estimate = Estimate::new(Posture::from(x), covariance);
        estimate.is_finite().then_some(estimate)
    }
}

/// The greatest power of two not above `x`; `None` unless `x` is positive, finite and normal, and
/// of a size that squares can hold.
fn power_of_two_below(x: f32) -> Option<f32> {
    (x > 1e-15 && x < 1e15).then(|| f32::from_bits(x.to_bits() & 0x7f80_0000))
}

/// `x` times a power of two, exactly.
fn scaled(x: TwoFloat, power: f32) -> TwoFloat {
    TwoFloat {
        high: x.high * power,
        low: x.low * power,
    }
}

/// An angle of any size brought into [−π, π].
fn wrap_wide(angle: TwoFloat) -> TwoFloat {
    let wrapped = TwoFloat::from_sum(wrap_angle(angle.high), angle.low);
    // One turn is not a binary number: add what the reduction of `high` took for each turn.
    let turns = libm::roundf((angle.high - wrapped.high) / core::f32::consts::TAU);
    (wrapped - TwoFloat::from_f32(turns * TwoFloat::TAU.low)).wrapped_once()
}

fn dot(a: &Wide3, b: &Wide3) -> TwoFloat {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn apply(m: &Wide33, v: &Wide3) -> Wide3 {
    [dot(&m[0], v), dot(&m[1], v), dot(&m[2], v)]
}

/// `m = L D Lᵀ`, L unit lower; `None` unless `m` is positive definite. The lower triangle is read.
fn factor(m: &Wide33) -> Option<(Wide33, Wide3)> {
    let mut lower = [[TwoFloat::ZERO; 3]; 3];
    let mut pivots = [TwoFloat::ZERO; 3];
    for j in 0..3 {
        let mut pivot = m[j][j];
        for k in 0..j {
            pivot = pivot - lower[j][k] * lower[j][k] * pivots[k];
        }
        if !(pivot.high > 0.0 && pivot.is_finite()) {
            return None;
        }
        pivots[j] = pivot;
        lower[j][j] = TwoFloat::ONE;
        for i in j + 1..3 {
            let mut sum = m[i][j];
            for k in 0..j {
                sum = sum - lower[i][k] * lower[j][k] * pivots[k];
            }
            lower[i][j] = sum / pivot;
        }
    }
    Some((lower, pivots))
}

/// `L⁻¹ v` for a unit lower L.
fn solve_lower(lower: &Wide33, v: &Wide3) -> Wide3 {
    let x0 = v[0];
    let x1 = v[1] - lower[1][0] * x0;
    let x2 = v[2] - lower[2][0] * x0 - lower[2][1] * x1;
    [x0, x1, x2]
}

/// `(L D Lᵀ)⁻¹ v`.
fn solve_factored(lower: &Wide33, pivots: &Wide3, v: &Wide3) -> Wide3 {
    let y = solve_lower(lower, v);
    let x2 = y[2] / pivots[2];
    let x1 = y[1] / pivots[1] - lower[2][1] * x2;
    let x0 = y[0] / pivots[0] - lower[1][0] * x1 - lower[2][0] * x2;
    [x0, x1, x2]
}

#[cfg(test)]
mod tests;
