//! The frame bent to a circular arc: chord of the arc, and curvature of the path that the robot drives.
//!
//! L is the flexible length, a the rigid section at each end and ψ the steering angle. Half the chord between the
//! axles is `h(ψ) = L/2 sin ψ/ψ + a cos ψ`, and the path of the midpoint has the curvature `κ = tan ψ/h(ψ)`.
//!
//! # Panic contract
//!
//! Nothing here fails. Angles are expected within ±[`super::cascade::MAX_STEERING`].

use crate::math::{Steering, bounded};
use core::hint::cold_path;

/// Most steps of the search for a steering angle.
const MAX_ITERATIONS: usize = 24;
/// Newton step, rad, below which the search ends: the remaining error is less than a third of the step's square.
const SETTLED: f32 = 2e-4;
/// Power series of tan ψ/ψ in ψ², after the leading 1.
const TANGENT: [f32; 4] = [1.0 / 3.0, 2.0 / 15.0, 17.0 / 315.0, 62.0 / 2835.0];

/// Dimensions of the frame, and coefficients of the start value of a steering angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Arc {
    /// Half the flexible length L, m.
    half_length: f32,
    /// Rigid section a at each end, m.
    rigid_end: f32,
    /// Half the chord of the straight frame, h(0), m.
    half_chord: f32,
    /// ψ ≈ r (1 + s₀ r² + s₁ r⁴)/(1 + s₂ r² + s₃ r⁴) with r = κ h(0).
    start: [f32; 4],
}

/// Chord and path curvature of the frame at one steering angle.
pub(super) struct Shape {
    /// 1/cos ψ.
    pub sec: f32,
    /// tan ψ.
    pub tan: f32,
    /// Half the chord, m, and its first two derivatives by ψ.
    pub half: f32,
    pub slope: f32,
    pub second: f32,
    /// Path curvature, 1/m, and its derivative by ψ.
    pub kappa: f32,
    pub kappa_slope: f32,
}

/// Half the chord, and terms of the half chord's derivatives.
struct Half {
    sin: f32,
    cos: f32,
    length: f32,
    slope: f32,
    /// `sinc + 2 sinc'/ψ`: minus sinc''.
    fall: f32,
}

/// cos x and `sinc'(x)/x` from `square` = x² with |x| ≤ 1.5, for sinc x = sin x/x. The closed form of `sinc'(x)/x`
/// loses all digits near zero. The other functions follow without loss of digits: `sinc = cos x − x² slope`,
/// `sin = x sinc`, `sinc'' = −sinc − 2 slope`. Absolute error at most 2e-7 and 1e-7.
///
/// Minimax polynomials on that range (error 3.4e-8 and 4.9e-8 before rounding).
fn cos_and_sinc_slope(square: f32) -> (f32, f32) {
    let y = square;
    let cos = 1.0
        + y * (-4.999_995_2e-1 + y * (4.166_46e-2 + y * (-1.386_113_9e-3 + y * 2.332_569_6e-5)));
    let slope = -3.333_332_8e-1 + y * (3.333_264e-2 + y * (-1.188_93e-3 + y * 2.094_135_6e-5));
    (cos, slope)
}

impl Arc {
    /// The arc of a frame with a flexible length (m) and rigid ends (m).
    pub fn new(length: f32, rigid_end: f32) -> Self {
        let half_chord = 0.5 * length + rigid_end;
        Self {
            half_length: 0.5 * length,
            rigid_end,
            half_chord,
            start: start(rigid_end / half_chord),
        }
    }

    /// Flexible length L, m.
    pub fn length(&self) -> f32 {
        2.0 * self.half_length
    }

    fn half(&self, psi: f32) -> Half {
        let square = psi * psi;
        let (cos, over) = cos_and_sinc_slope(square);
        let sinc = cos - square * over;
        let sin = psi * sinc;
        Half {
            sin,
            cos,
            length: self.half_length * sinc + self.rigid_end * cos,
            slope: self.half_length * (psi * over) - self.rigid_end * sin,
            fall: sinc + 2.0 * over,
        }
    }

    /// Chord and path curvature at a steering angle.
    pub fn bent(&self, psi: Steering) -> Shape {
        let half = self.half(psi.0);
        let sec = 1.0 / half.cos;
        let tan = half.sin * sec;
        let inverse = 1.0 / half.length;
        let kappa = tan * inverse;
        Shape {
            sec,
            tan,
            half: half.length,
            slope: half.slope,
            second: -(self.half_length * half.fall) - self.rigid_end * half.cos,
            kappa,
            kappa_slope: (sec * sec - kappa * half.slope) * inverse,
        }
    }

    /// Steering angle for the path curvature `kappa` (1/m), which must be below the curvature at `limit` (rad). The
    /// angle is the root of `sin ψ − κ cos ψ h(ψ)`, which grows with |ψ| for |ψ| < π/2. The result is at most `limit`
    /// in magnitude, apart from rounding.
    pub fn steering(&self, kappa: f32, limit: f32) -> Steering {
        let reach = kappa * self.half_chord;
        let square = reach * reach;
        let [s0, s1, s2, s3] = self.start;
        let start =
            reach * (1.0 + square * (s0 + square * s1)) / (1.0 + square * (s2 + square * s3));
        let step = self.newton(start, kappa);
        // Up to half a radian one step is enough. A start beyond the limit may be near another root.
        if step.abs() <= SETTLED && start.abs() <= limit + SETTLED {
            Steering(start - step)
        } else {
            cold_path();
            Steering(self.search(bounded(start - step, limit), kappa, limit))
        }
    }

    /// Newton step from `psi` to the root.
    fn newton(&self, psi: f32, kappa: f32) -> f32 {
        let half = self.half(psi);
        let value = half.sin - kappa * (half.cos * half.length);
        let rate = half.cos + kappa * (half.sin * half.length - half.cos * half.slope);
        value / rate
    }

    /// Newton's method between bounds that close in. Without bounds the iteration may cycle if rigid ends are most of
    /// the frame.
    #[cold]
    fn search(&self, start: f32, kappa: f32, limit: f32) -> f32 {
        let sign = 1.0f32.copysign(kappa);
        let (kappa, mut psi) = (kappa.abs(), sign * start);
        let (mut low, mut high) = (0.0, limit);
        for _ in 0..MAX_ITERATIONS {
            if !(psi >= low && psi <= high) {
                psi = 0.5 * (low + high);
            }
            let step = self.newton(psi, kappa);
            if step > 0.0 {
                high = psi;
            } else {
                low = psi;
            }
            psi -= step;
            if step.abs() <= SETTLED {
                break;
            }
        }
        sign * bounded(psi, limit)
    }
}

/// Coefficients of the start value of a steering angle, for a frame with this share of rigid ends. They invert the
/// power series of κ h(0) in ψ by a quotient exact to the ninth power.
fn start(share: f32) -> [f32; 4] {
    // h(ψ)/h(0) = 1 − α ψ² + β ψ⁴ − γ ψ⁶ + δ ψ⁸, and the coefficients of the series of h(0)/h(ψ).
    let alpha = (1.0 + 2.0 * share) / 6.0;
    let beta = (1.0 + 4.0 * share) / 120.0;
    let gamma = (1.0 + 6.0 * share) / 5040.0;
    let delta = (1.0 + 8.0 * share) / 362_880.0;
    let first = alpha;
    let second = alpha * first - beta;
    let third = alpha * second - beta * first + gamma;
    let fourth = alpha * third - beta * second + gamma * first - delta;
    // Series κ h(0) = ψ + a ψ³ + b ψ⁵ + c ψ⁷ + d ψ⁹.
    let [t1, t2, t3, t4] = TANGENT;
    let a = t1 + first;
    let b = t2 + t1 * first + second;
    let c = t3 + t2 * first + t1 * second + third;
    let d = t4 + t3 * first + t2 * second + t1 * third + fourth;
    // Inverse series, with r = κ h(0): ψ = r + f r³ + g r⁵ + h r⁷ + i r⁹.
    let f = -a;
    let g = 3.0 * a * a - b;
    let h = 8.0 * a * b - c - 12.0 * a * a * a;
    let i = 10.0 * a * c + 5.0 * b * b - d + 55.0 * a * a * (a * a - b);
    let whole = g * g - f * h;
    let below = [(f * i - g * h) / whole, (h * h - g * i) / whole];
    let above = [f + below[0], g + f * below[0] + below[1]];
    [above[0], above[1], below[0], below[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// κ(ψ) in `f64`, by the definition.
    fn curvature(length: f64, end: f64, psi: f64) -> f64 {
        psi.tan() / (0.5 * length * psi.sin() / psi + end * psi.cos())
    }

    properties! {
        /// The frame has any rigid share, the steering angle is up to 1.5 rad.
        #[test]
        fn steering_inverts_the_curvature_of_any_frame(
            length in 0.01f32..1.0, end in 0.0f32..1.0, psi in 1e-4f32..1.5,
        ) {
            let arc = Arc::new(length, end);
            let kappa = curvature(length.into(), end.into(), psi.into()) as f32;
            // 1/cos ψ multiplies the rounding of κ and cos ψ.
            let tolerance = 1e-6;
            for sign in [1.0, -1.0] {
                let found = arc.steering(sign * kappa, 1.5);
                prop_assert!((sign * found.0 - psi).abs() < tolerance, "{found:?} {psi}");
                // The search finds the root from any start. Newton's method alone may end at another root.
                for begin in [0.0, 0.3, 0.8, 1.5] {
                    let found = arc.search(sign * begin, sign * kappa, 1.5);
                    prop_assert!((sign * found - psi).abs() < tolerance, "{begin}: {found} {psi}");
                }
            }
        }

        /// Reference: central differences in `f64`.
        #[test]
        fn derivatives_are_those_of_the_chord_and_the_curvature(
            end in 0.0f32..0.2, psi in -1.2f32..1.2,
        ) {
            let arc = Arc::new(0.37, end);
            let shape = arc.bent(Steering(psi));
            let half = |p: f64| {
                let sinc = if p == 0.0 { 1.0 } else { p.sin() / p };
                0.5 * f64::from(0.37f32) * sinc + f64::from(end) * p.cos()
            };
            let (p, h) = (f64::from(psi), 1e-4);
            let kappa = |p: f64| p.tan() / half(p);
            let slope = |f: &dyn Fn(f64) -> f64| (f(p + h) - f(p - h)) / (2.0 * h);
            let second = (half(p + h) - 2.0 * half(p) + half(p - h)) / (h * h);
            prop_assert!((f64::from(shape.half) - half(p)).abs() < 1e-7);
            prop_assert!((f64::from(shape.slope) - slope(&half)).abs() < 1e-7);
            prop_assert!((f64::from(shape.second) - second).abs() < 1e-6);
            let scale = 1.0 + kappa(p).abs();
            prop_assert!((f64::from(shape.kappa) - kappa(p)).abs() < 1e-6 * scale);
            prop_assert!((f64::from(shape.kappa_slope) - slope(&kappa)).abs() < 2e-5 * scale * scale);
        }
    }

    #[test]
    fn cos_sinc_and_slope_of_sinc_match_f64() {
        for i in -150_000..=150_000 {
            let x = i as f32 * 1e-5;
            let (cos, slope) = cos_and_sinc_slope(x * x);
            let sinc = cos - x * x * slope;
            let exact = f64::from(x);
            let (s, c) = exact.sin_cos();
            assert!((f64::from(cos) - c).abs() < 2e-7, "{x}");
            assert!((f64::from(x * sinc) - s).abs() < 3e-7, "{x}");
            // Near zero the closed form loses all digits and the series replaces it.
            let p = exact * exact;
            let expected = if p > 0.01 {
                (c - s / exact) / p
            } else {
                -1.0 / 3.0 + p / 30.0 - p * p / 840.0
            };
            assert!((f64::from(slope) - expected).abs() < 1e-7, "{x}");
        }
        assert_eq!(cos_and_sinc_slope(0.0).0, 1.0);
    }

    /// Up to 0.5 rad, the default limit, one step of Newton's method from the start is enough.
    #[test]
    fn start_needs_one_step_up_to_half_a_radian() {
        for end in [0.0f32, 0.02, 0.1] {
            let arc = Arc::new(0.37, end);
            for i in 1..=100 {
                let psi = 0.005 * i as f32;
                let kappa = curvature(0.37, end.into(), psi.into()) as f32;
                let reach = kappa * arc.half_chord;
                let square = reach * reach;
                let [s0, s1, s2, s3] = arc.start;
                let start = reach * (1.0 + square * (s0 + square * s1))
                    / (1.0 + square * (s2 + square * s3));
                // The quotient is exact to the ninth power.
                let allowed = SETTLED.min(2e-7 + 0.2 * psi.powi(11));
                assert!((start - psi).abs() < allowed, "{end} {psi}: {start}");
            }
        }
    }
}
