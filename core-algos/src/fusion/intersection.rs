//! Covariance intersection of two posture estimates whose errors are correlated to an unknown
//! degree (Julier and Uhlmann; paper section VI-B).
//!
//! P⁻¹ = ω A⁻¹ + (1 − ω) B⁻¹ and P⁻¹ x = ω A⁻¹ a + (1 − ω) B⁻¹ b, evaluated without an inverse of A
//! or B: S = ω B + (1 − ω) A, P = A S⁻¹ B, x = a + (1 − ω) A S⁻¹ (b − a), heading difference
//! wrapped. ω = 1 keeps `a`, ω = 0 keeps `b`. The result is consistent for every cross-correlation
//! of two consistent inputs.
//!
//! **Weight.** With A = L D Lᵀ and N = L⁻¹ B L⁻ᵀ let eᵢ be the elementary symmetric functions of the
//! eigenvalues of D⁻¹ N, all positive, and v = 1 − ω. Then
//!
//! - det S = det A · c, c = v³ + e₁ v² ω + e₂ v ω² + e₃ ω³;
//! - P = (v² B + v ω X + ω² e₃ A)/c, X a matrix of sums of positive terms.
//!
//! So the least det P (greatest c) and the least tr(W P) lie at the zero of a polynomial in ω/v, of the second and
//! fourth degree. Newton's method inside a bracket finds it.
//!
//! ω is exactly 0 or 1 if the other input cannot improve the criterion, and 1/2 if both covariances are equal.
//!
//! **Arithmetic.** P is flat in ω, and the inputs may differ in size by many decades. Everything except the search for
//! the zero is therefore computed in `f64`, by software on the board. For standard deviations in a ratio of at most
//! 1000, in any direction, ω is within 5e-6 and the normalised covariance within 1e-5. A board takes 28 000
//! instructions, whatever the inputs.
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
//! // Each coordinate comes from the input that knows it better; no variance is below that of this input.
//! assert!((fused.omega - 0.5).abs() < 1e-3);
//! let Estimate { posture, covariance } = fused.estimate;
//! assert!((posture.x - 1.0).abs() < 5e-3 && (posture.y - 0.1).abs() < 5e-3);
//! assert!(covariance[0][0] > 0.01 * 0.01 && covariance[1][1] > 0.01 * 0.01);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

use super::Estimate;
use crate::config::{ConfigError, declare};
use crate::math::Posture;
use crate::math::trig::wrap_angle_f64;

type Vec3 = [f64; 3];
type Mat3 = [Vec3; 3];

/// Largest number of steps of the search for a weight. The search ends far earlier unless the inputs are extreme.
const MAX_SEARCH: usize = 64;

declare! {
    /// Criterion that the fused covariance minimises.
    pub enum Criterion, default Determinant {
        /// Determinant: independent of the units of position and heading.
        Determinant = "determinant" or "det",
        /// Trace, heading variance weighted by the square of a length.
        Trace = "trace",
    }
}

declare! {
    /// Parameters of covariance intersection.
    pub struct Config {
        /// Criterion that the fused covariance minimises.
        pub criterion: Criterion = Criterion::Determinant;
        /// Length that turns a heading error into a position error in the trace criterion.
        pub heading_length_m: f32 = 0.2, "m": Positive;
    }
}

impl Config {
    /// Builds the intersection; an error names the parameter out of range.
    pub fn build(&self) -> Result<Intersection, ConfigError> {
        self.check_ranges()?;
        let length = self.heading_length_m;
        Ok(Intersection {
            criterion: self.criterion,
            weights: [1.0, 1.0, length * length].map(f64::from),
        })
    }
}

/// Covariance intersection, ready to run. It has no state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intersection {
    criterion: Criterion,
    /// Diagonal of the weight matrix W of the trace criterion.
    weights: Vec3,
}

/// Result of covariance intersection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fused {
    /// Weight ω of the information of `a`, 0 to 1; the information of `b` has the weight 1 − ω.
    pub omega: f32,
    /// The fused estimate.
    pub estimate: Estimate,
}

/// A posture and covariance in `f64`, for inputs whose covariance is so nearly singular that
/// rounding it would change the result.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ExtendedEstimate {
    /// Position (m) and heading (rad).
    pub posture: [f64; 3],
    /// Covariance of (x, y, phi); the lower triangle is read.
    pub covariance: [[f64; 3]; 3],
}

impl From<&Estimate> for ExtendedEstimate {
    fn from(estimate: &Estimate) -> Self {
        let posture: [f32; 3] = estimate.posture.into();
        Self {
            posture: posture.map(f64::from),
            covariance: estimate.covariance.map(|row| row.map(f64::from)),
        }
    }
}

impl Intersection {
    /// The intersection of two estimates in one frame. `None` unless both covariances are positive
    /// definite and all numbers finite.
    pub fn fuse(&self, a: &Estimate, b: &Estimate) -> Option<Fused> {
        self.fuse_extended(&a.into(), &b.into())
    }

    /// [`Self::fuse`] for inputs in `f64`.
    pub fn fuse_extended(&self, a: &ExtendedEstimate, b: &ExtendedEstimate) -> Option<Fused> {
        let [m, n] = [a, b].map(|estimate| &estimate.covariance);
        let contrast = Contrast::new(m, n)?;
        let weights = if alike(m, n) {
            [0.5; 2]
        } else {
            match self.criterion {
                Criterion::Determinant => contrast.weights(contrast.slope_of_determinant()),
                Criterion::Trace => contrast.weights(contrast.slope_of_trace(&self.weights, m, n)),
            }
        };
        Some(Fused {
            omega: weights[0] as f32,
            estimate: combine(a, b, weights)?,
        })
    }
}

/// Entry of a symmetric matrix, its lower triangle read.
fn entry(m: &Mat3, i: usize, j: usize) -> f64 {
    m[i.max(j)][i.min(j)]
}

/// Column of a symmetric matrix, its lower triangle read.
fn column(m: &Mat3, j: usize) -> Vec3 {
    [0, 1, 2].map(|i| entry(m, i, j))
}

fn dot(a: &Vec3, b: &Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `L D Lᵀ` of a symmetric matrix, L unit lower.
struct Factor {
    l10: f64,
    l20: f64,
    l21: f64,
    /// Diagonal of D; `inverse` holds the reciprocals.
    pivots: Vec3,
    inverse: Vec3,
}

impl Factor {
    /// Factors of `m`; `None` unless `m` is positive definite. The lower triangle is read.
    fn new(m: &Mat3) -> Option<Self> {
        let d0 = m[0][0];
        let i0 = 1.0 / d0;
        let (l10, l20) = (m[1][0] * i0, m[2][0] * i0);
        let d1 = m[1][1] - l10 * m[1][0];
        let i1 = 1.0 / d1;
        let rest = m[2][1] - l20 * m[1][0];
        let l21 = rest * i1;
        let d2 = m[2][2] - l20 * m[2][0] - l21 * rest;
        let pivots = [d0, d1, d2];
        let definite = pivots.iter().all(|&pivot| pivot > 0.0 && pivot < f64::MAX);
        definite.then(|| Self {
            l10,
            l20,
            l21,
            pivots,
            inverse: [i0, i1, 1.0 / d2],
        })
    }

    /// `L⁻¹ v`.
    fn lower(&self, v: Vec3) -> Vec3 {
        let x1 = v[1] - self.l10 * v[0];
        [v[0], x1, v[2] - self.l20 * v[0] - self.l21 * x1]
    }

    /// `D⁻¹ v`.
    fn weighed(&self, v: Vec3) -> Vec3 {
        [0, 1, 2].map(|i| v[i] * self.inverse[i])
    }
}

/// Covariance B relative to covariance A, scaled by κ so that e₁ of M = (κ D)⁻¹ N is 3.
struct Contrast {
    /// Factor of κ A, κ = e₁/3.
    a: Factor,
    /// κ and 1/κ.
    kappa: f64,
    inverse: f64,
    /// N = L⁻¹ B L⁻ᵀ.
    n: Mat3,
    /// Principal minors of M; minor k leaves out row and column k.
    minors: Vec3,
    /// e₂ and e₃ of M; e₁ is 3.
    e2: f64,
    e3: f64,
}

impl Contrast {
    /// Contrast of the covariances `b` and `a`; `None` unless both are positive definite.
    fn new(a: &Mat3, b: &Mat3) -> Option<Self> {
        let a = Factor::new(a)?;
        let half = [0, 1, 2].map(|j| a.lower(column(b, j)));
        let n = [0, 1, 2].map(|j| a.lower([half[0][j], half[1][j], half[2][j]]));
        let b = Factor::new(&n)?;
        let kappa = dot(&[n[0][0], n[1][1], n[2][2]], &a.inverse) * (1.0 / 3.0);
        let inverse = 1.0 / kappa;
        let a = Factor {
            pivots: a.pivots.map(|pivot| pivot * kappa),
            inverse: a.inverse.map(|entry| entry * inverse),
            ..a
        };
        let minor = |i: usize, j: usize| {
            (n[i][i] * n[j][j] - n[j][i] * n[j][i]) * (a.inverse[i] * a.inverse[j])
        };
        let minors = [minor(1, 2), minor(0, 2), minor(0, 1)];
        let shares = a.weighed(b.pivots);
        Some(Self {
            a,
            kappa,
            inverse,
            n,
            minors,
            e2: minors[0] + minors[1] + minors[2],
            e3: shares[0] * shares[1] * shares[2],
        })
    }

    /// Weights ω and v at the minimum of a function. `slope` holds the coefficients, by ascending powers, of a
    /// polynomial in κ ω/v that has the sign of the function's slope; the sign changes at most once, from − to +.
    /// Forming the coefficients takes `f64`, finding the zero only `f32`.
    fn weights<const N: usize>(&self, slope: [f64; N]) -> [f64; 2] {
        if !(slope[0] < 0.0) {
            return [0.0, 1.0];
        }
        if !(slope[N - 1] > 0.0) {
            return [1.0, 0.0];
        }
        let largest = slope.iter().fold(0.0, |most: f64, c| most.max(c.abs()));
        let scale = 1.0 / largest;
        let ratio = f64::from(zero(&slope.map(|coefficient| (coefficient * scale) as f32)));
        let scale = 1.0 / (ratio + self.kappa);
        [ratio * scale, self.kappa * scale]
    }

    /// Slope of −c over ω, by powers of κ ω/v.
    fn slope_of_determinant(&self) -> Vec3 {
        let inverse = self.inverse;
        [
            3.0 * inverse - 3.0,
            2.0 * (3.0 * inverse - self.e2),
            self.e2 * inverse - 3.0 * self.e3,
        ]
    }

    /// Numerator of the slope of tr(W P), by powers of κ ω/v.
    fn slope_of_trace(&self, weights: &Vec3, a: &Mat3, b: &Mat3) -> [f64; 5] {
        let trace = |m: &Mat3| dot(weights, &[m[0][0], m[1][1], m[2][2]]);
        let (e2, e3, inverse) = (self.e2, self.e3, self.inverse);
        let [s0, s1, s2] = self.slope_of_determinant();
        // tr(W P) = (b v² + x v ω + a ω²)/c, and the numerator's slope p v + q ω.
        let (b, x, a) = (
            trace(b),
            self.mixed_trace(weights),
            self.kappa * e3 * trace(a),
        );
        let (p, q) = (x - 2.0 * b * inverse, 2.0 * a - x * inverse);
        [
            p + b * s0,
            3.0 * p + q + x * s0 + b * s1,
            e2 * p + 3.0 * q + a * s0 + x * s1 + b * s2,
            e3 * p + e2 * q + a * s1 + x * s2,
            e3 * q + a * s2,
        ]
    }

    /// tr(W X), X = L Y Lᵀ.
    fn mixed_trace(&self, weights: &Vec3) -> f64 {
        let (a, n, [m0, m1, m2]) = (&self.a, &self.n, self.minors);
        let y00 = a.pivots[0] * (m1 + m2);
        let y11 = a.pivots[1] * (m0 + m2);
        let y22 = a.pivots[2] * (m0 + m1);
        let y10 = (n[1][0] * n[2][2] - n[2][0] * n[2][1]) * a.inverse[2];
        let y20 = (n[2][0] * n[1][1] - n[1][0] * n[2][1]) * a.inverse[1];
        let y21 = (n[2][1] * n[0][0] - n[1][0] * n[2][0]) * a.inverse[0];
        let x11 = y11 + a.l10 * (2.0 * y10 + a.l10 * y00);
        let x22 = y22
            + a.l20 * (2.0 * (y20 + a.l21 * y10) + a.l20 * y00)
            + a.l21 * (2.0 * y21 + a.l21 * y11);
        dot(weights, &[y00, x11, x22])
    }
}

/// The positive zero of a polynomial that changes its sign once, from − to +; coefficients by
/// ascending powers.
fn zero<const N: usize>(coefficients: &[f32; N]) -> f32 {
    let (mut low, mut high, mut x) = (0.0, f32::INFINITY, 1.0);
    for _ in 0..MAX_SEARCH {
        let (mut value, mut rate) = (0.0, 0.0);
        for coefficient in coefficients.iter().rev() {
            rate = rate * x + value;
            value = value * x + coefficient;
        }
        if value < 0.0 {
            low = x;
        } else {
            high = x;
        }
        let next = x - value / rate;
        if (next - x).abs() <= 1e-7 * x {
            break;
        }
        x = if next > low && next < high {
            next
        } else if high < f32::INFINITY {
            0.5 * (low + high)
        } else {
            4.0 * x
        };
    }
    x
}

/// True if both are the same matrix, the lower triangles read.
fn alike(a: &Mat3, b: &Mat3) -> bool {
    (0..3).all(|i| (0..=i).all(|j| a[i][j] == b[i][j]))
}

/// The estimate with P⁻¹ = ω A⁻¹ + (1 − ω) B⁻¹; `None` unless it is finite.
fn combine(a: &ExtendedEstimate, b: &ExtendedEstimate, [omega, v]: [f64; 2]) -> Option<Estimate> {
    let mut s = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in 0..=i {
            s[i][j] = omega * b.covariance[i][j] + v * a.covariance[i][j];
        }
    }
    let s = Factor::new(&s)?;
    // P = (L⁻¹ A)ᵀ D⁻¹ (L⁻¹ B), x − a = v (L⁻¹ A)ᵀ D⁻¹ L⁻¹ (b − a), L and D those of S.
    let by_a = [0, 1, 2].map(|j| s.lower(column(&a.covariance, j)));
    let mut covariance = [[0.0; 3]; 3];
    for j in 0..3 {
        let by_b = s.weighed(s.lower(column(&b.covariance, j)));
        for i in j..3 {
            let entry = dot(&by_a[i], &by_b) as f32;
            covariance[i][j] = entry;
            covariance[j][i] = entry;
        }
    }
    let difference = difference(a, b);
    let weighted = s.weighed(s.lower(difference));
    let mut x = [0, 1, 2].map(|i| a.posture[i] + v * dot(&by_a[i], &weighted));
    x[2] = wrap_angle_f64(x[2]);
    let estimate = Estimate::new(Posture::from(x.map(|x| x as f32)), covariance);
    estimate.is_finite().then_some(estimate)
}

/// b − a, the heading wrapped.
fn difference(a: &ExtendedEstimate, b: &ExtendedEstimate) -> Vec3 {
    let mut difference = [0, 1, 2].map(|i| b.posture[i] - a.posture[i]);
    difference[2] = wrap_angle_f64(difference[2]);
    difference
}

#[cfg(test)]
mod tests;
