//! Independent `f64` references for the tests of this module. Polynomial: Newton's divided differences and Simpson's
//! rule. Elastica: fourth-order Runge–Kutta method from the root on (θ, κ, x, y).

use std::vec::Vec;

// The attribute marks an import of a test: `fusion` is a layer above `beam`.
#[cfg(test)]
pub(super) use crate::fusion::testing::Random;

/// Value at `s` of the polynomial through (`at`, `values`).
pub fn polynomial(at: &[f64], values: &[f64], s: f64) -> f64 {
    let n = at.len();
    let mut d = values.to_vec();
    for order in 1..n {
        for i in (order..n).rev() {
            d[i] = (d[i] - d[i - 1]) / (at[i] - at[i - order]);
        }
    }
    (0..n).rev().fold(0.0, |sum, i| sum * (s - at[i]) + d[i])
}

/// End posture of a strip whose curvature is `curvature(s)`: θ and (x, y) by Simpson's rule on
/// `n` intervals.
pub fn integrate(length: f64, n: usize, curvature: impl Fn(f64) -> f64) -> [f64; 3] {
    let h = length / n as f64;
    let (mut theta, mut x, mut y) = (0.0, 0.0, 0.0);
    for i in 0..n {
        let s = i as f64 * h;
        let k = [0.0, 0.25, 0.5, 0.75, 1.0].map(|f| curvature(s + f * h));
        let middle = theta + h / 12.0 * (k[0] + 4.0 * k[1] + k[2]);
        let end = theta + h / 6.0 * (k[0] + 4.0 * k[2] + k[4]);
        x += h / 6.0 * (theta.cos() + 4.0 * middle.cos() + end.cos());
        y += h / 6.0 * (theta.sin() + 4.0 * middle.sin() + end.sin());
        theta = end;
    }
    [x, y, theta]
}

/// An elastica of unit length and unit stiffness, clamped at the root along x.
#[derive(Clone, Copy, Debug)]
pub struct Elastica {
    pub root_curvature: f64,
    pub force: [f64; 2],
}

/// True shape of a strip under an end force, for comparison with a fit.
#[derive(Clone, Debug)]
pub struct Bent {
    /// Curvature at each place of `at`.
    pub curvature: Vec<f64>,
    pub end: [f64; 3],
    pub end_curvature: f64,
    pub largest_angle: f64,
    pub largest_curvature: f64,
}

impl Elastica {
    /// Marches from the root through the ascending places `at` (0 to 1) to the tip.
    pub fn bent(&self, at: &[f64]) -> Bent {
        let [fx, fy] = self.force;
        let rate = |q: [f64; 4]| {
            let (s, c) = q[0].sin_cos();
            [q[1], fx * s - fy * c, c, s]
        };
        let plus = |q: [f64; 4], d: [f64; 4], h: f64| {
            [
                q[0] + h * d[0],
                q[1] + h * d[1],
                q[2] + h * d[2],
                q[3] + h * d[3],
            ]
        };
        let mut q = [0.0, self.root_curvature, 0.0, 0.0];
        let mut bent = Bent {
            curvature: Vec::new(),
            end: [0.0; 3],
            end_curvature: 0.0,
            largest_angle: 0.0,
            largest_curvature: self.root_curvature.abs(),
        };
        let mut from = 0.0;
        for (i, to) in at.iter().copied().chain([1.0]).enumerate() {
            let n = ((to - from) * 400.0).ceil() as usize + 1;
            let h = (to - from) / n as f64;
            for _ in 0..n {
                let k1 = rate(q);
                let k2 = rate(plus(q, k1, 0.5 * h));
                let k3 = rate(plus(q, k2, 0.5 * h));
                let k4 = rate(plus(q, k3, h));
                for j in 0..4 {
                    q[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j]);
                }
                bent.largest_angle = bent.largest_angle.max(q[0].abs());
                bent.largest_curvature = bent.largest_curvature.max(q[1].abs());
            }
            from = to;
            if i < at.len() {
                bent.curvature.push(q[1]);
            }
        }
        bent.end = [q[2], q[3], q[0]];
        bent.end_curvature = q[1];
        bent
    }

    /// A random shape that a strip between two axles can take: directions within 1.6 rad of the root's,
    /// |curvature| × length within 8, compression up to `load` (EI/L²; a clamped strip buckles at 39.5), tension up
    /// to a quarter of `load`, lateral force up to a third of `load`.
    pub fn random(random: &mut Random, load: f64) -> Self {
        loop {
            let shape = Self {
                root_curvature: random.between(-8.0, 8.0),
                force: [
                    random.between(-load, load / 4.0),
                    random.between(-load / 3.0, load / 3.0),
                ],
            };
            let bent = shape.bent(&[]);
            if bent.largest_angle < 1.6 && bent.largest_curvature < 8.0 {
                return shape;
            }
        }
    }
}
