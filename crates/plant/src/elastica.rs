//! The exact strip, by shooting: the same extensible Kirchhoff rod as [`super::frame`], integrated
//! along its length from the root with its first variation, the root moment and the end force
//! found by Newton's method. Slow and simple: the reference for the fast solution, and a source of
//! exact shapes for tests of anything that measures the strip.
//!
//! Signs and frames as in [`super::frame`].

/// A strip with constant stiffness. `waves` = (c₂, c₃) is its unloaded curvature times its length
/// in Legendre polynomials of order 2 and 3.
#[derive(Clone, Copy, Debug)]
pub struct Elastica {
    /// Unstrained length, m.
    pub length: f64,
    /// Bending stiffness EI, N m².
    pub bending: f64,
    /// Axial stiffness EA, N; infinite for an inextensible strip.
    pub axial: f64,
    /// Legendre coefficients c₂ and c₃ of the unloaded curvature times length.
    pub waves: [f64; 2],
    /// Number of integration steps along the strip.
    pub steps: usize,
}

/// Root moment (N m) and end force (N, N; root frame), which determine an equilibrium.
pub type Load = [f64; 3];

/// Result of an integration along the strip.
#[derive(Clone, Copy, Debug)]
pub struct Shot {
    /// Position (m, m) and angle (rad) of the end.
    pub end: [f64; 3],
    /// Derivative of the end with respect to the load.
    pub compliance: [[f64; 3]; 3],
    /// ∫ EI κ' κ'ᵀ + (t' t'ᵀ)/EA over the strip, the primes being derivatives of curvature and
    /// tension with respect to the load.
    pub dissipation: [[f64; 3]; 3],
}

/// State along the strip: θ, x, y, their derivatives with respect to the load, and the upper triangle of the
/// dissipation.
type Line = [f64; 18];

impl Elastica {
    /// An unloaded straight strip.
    pub fn straight(length: f64, bending: f64, axial: f64, steps: usize) -> Self {
        Self {
            length,
            bending,
            axial,
            waves: [0.0; 2],
            steps,
        }
    }

    fn natural(&self, s: f64) -> f64 {
        let xi = 2.0 * s / self.length - 1.0;
        let second = 1.5 * xi * xi - 0.5;
        let third = (2.5 * xi * xi - 1.5) * xi;
        (self.waves[0] * second + self.waves[1] * third) / self.length
    }

    /// Curvature at a point (m, m) of the strip minus the unloaded curvature, 1/m.
    fn elastic_curvature(&self, [moment, fx, fy]: Load, x: f64, y: f64) -> f64 {
        (moment + fx * y - fy * x) / self.bending
    }

    fn slope(&self, s: f64, line: &Line, load: Load) -> Line {
        let [_, fx, fy] = load;
        let (theta, x, y) = (line[0], line[1], line[2]);
        let (sin, cos) = libm::sincos(theta);
        let stretch = 1.0 + (fx * cos + fy * sin) / self.axial;
        let mut d = [0.0; 18];
        d[0] = self.elastic_curvature(load, x, y) + self.natural(s);
        d[1] = stretch * cos;
        d[2] = stretch * sin;
        let shear = fy * cos - fx * sin;
        let (direct, tension) = ([1.0, y, -x], [0.0, cos, sin]);
        for p in 0..3 {
            let (dt, dx, dy) = (line[3 + p], line[6 + p], line[9 + p]);
            let give = (tension[p] + shear * dt) / self.axial;
            d[3 + p] = (direct[p] + fx * dy - fy * dx) / self.bending;
            d[6 + p] = give * cos - stretch * sin * dt;
            d[9 + p] = give * sin + stretch * cos * dt;
        }
        let mut n = 12;
        for p in 0..3 {
            for q in p..3 {
                d[n] = self.bending * d[3 + p] * d[3 + q] + tension[p] * tension[q] / self.axial;
                n += 1;
            }
        }
        d
    }

    /// Integrates by the classical fourth-order scheme; `visit` gets the arc length and the state at each grid point.
    fn integrate(&self, load: Load, mut visit: impl FnMut(f64, &Line)) -> Line {
        let h = self.length / self.steps as f64;
        let mut line = [0.0; 18];
        visit(0.0, &line);
        let shifted =
            |line: &Line, k: f64, d: &Line| -> Line { std::array::from_fn(|i| line[i] + k * d[i]) };
        for n in 0..self.steps {
            let s = n as f64 * h;
            let a = self.slope(s, &line, load);
            let b = self.slope(s + 0.5 * h, &shifted(&line, 0.5 * h, &a), load);
            let c = self.slope(s + 0.5 * h, &shifted(&line, 0.5 * h, &b), load);
            let d = self.slope(s + h, &shifted(&line, h, &c), load);
            for i in 0..18 {
                line[i] += h / 6.0 * (a[i] + 2.0 * (b[i] + c[i]) + d[i]);
            }
            visit(s + h, &line);
        }
        line
    }

    /// End of the strip under a load.
    pub fn shoot(&self, load: Load) -> Shot {
        let line = self.integrate(load, |_, _| {});
        let mut compliance = [[0.0; 3]; 3];
        compliance[0].copy_from_slice(&line[6..9]);
        compliance[1].copy_from_slice(&line[9..12]);
        compliance[2].copy_from_slice(&line[3..6]);
        let [a, b, c, d, e, f] = [line[12], line[13], line[14], line[15], line[16], line[17]];
        Shot {
            end: [line[1], line[2], line[0]],
            compliance,
            dissipation: [[a, b, c], [b, d, e], [c, e, f]],
        }
    }

    /// Load that brings the end to `end` (m, m, rad), by Newton's method from `start`, with shortened steps where the
    /// error would grow. `None` if the method does not converge.
    pub fn solve(&self, end: [f64; 3], start: Load) -> Option<Load> {
        let mut load = start;
        let miss = |shot: &Shot| -> [f64; 3] {
            [
                end[0] - shot.end[0],
                end[1] - shot.end[1],
                end[2] - shot.end[2],
            ]
        };
        let size =
            |m: &[f64; 3]| (m[0] * m[0] + m[1] * m[1]) / (self.length * self.length) + m[2] * m[2];
        let mut shot = self.shoot(load);
        for _ in 0..100 {
            let error = miss(&shot);
            let step = solve(&shot.compliance, &error)?;
            let mut part = 1.0;
            loop {
                let trial: Load = std::array::from_fn(|i| load[i] + part * step[i]);
                let next = self.shoot(trial);
                if size(&miss(&next)) <= size(&error) || part < 1e-3 {
                    load = trial;
                    shot = next;
                    break;
                }
                part *= 0.5;
            }
            let scale = load.iter().map(|v| v.abs()).fold(0.0, f64::max);
            let change = step.iter().map(|v| v.abs()).fold(0.0, f64::max);
            // Rounding of the end's position changes the force along the strip by up to this value, so no smaller step
            // is required.
            let rounding = 4.0 * f64::EPSILON * self.axial;
            if part == 1.0 && change <= 1e-9 * scale + 1e-13 * self.bending + rounding {
                return Some(load);
            }
        }
        None
    }

    /// Wrench (N, N, N m) of the environment on the end.
    pub fn wrench(&self, load: Load, end: [f64; 3]) -> [f64; 3] {
        let [moment, fx, fy] = load;
        [fx, fy, moment - end[0] * fy + end[1] * fx]
    }

    /// Load whose elastic curvatures (1/m) at fractions of the length are nearest to `curvature`, by Gauss–Newton steps
    /// from `start`; each fraction is rounded to the nearest grid point. `None` if the steps do not converge.
    pub fn fit(&self, start: Load, fractions: &[f64], curvature: &[f64]) -> Option<Load> {
        let mut load = start;
        for _ in 0..20 {
            let (normal, side) = self.normal(load, fractions, curvature);
            let step = solve(&normal, &side)?;
            load = std::array::from_fn(|i| load[i] + step[i]);
            let change = step.iter().map(|v| v.abs()).fold(0.0, f64::max);
            let size = load.iter().map(|v| v.abs()).fold(0.0, f64::max);
            if change <= 1e-9 * size {
                return Some(load);
            }
        }
        None
    }

    /// Normal equations of a Gauss–Newton step of [`Self::fit`].
    fn normal(
        &self,
        load: Load,
        fractions: &[f64],
        curvature: &[f64],
    ) -> ([[f64; 3]; 3], [f64; 3]) {
        let [_, fx, fy] = load;
        let mut rows = Vec::with_capacity(self.steps + 1);
        self.integrate(load, |_, line| {
            let direct = [1.0, line[2], -line[1]];
            let gradient: [f64; 3] = std::array::from_fn(|p| {
                (direct[p] + fx * line[9 + p] - fy * line[6 + p]) / self.bending
            });
            rows.push((self.elastic_curvature(load, line[1], line[2]), gradient));
        });
        let (mut normal, mut side) = ([[0.0; 3]; 3], [0.0; 3]);
        for (f, k) in fractions.iter().zip(curvature) {
            let (found, gradient) = rows[(f * self.steps as f64).round() as usize];
            for i in 0..3 {
                side[i] += gradient[i] * (k - found);
                for j in 0..3 {
                    normal[i][j] += gradient[i] * gradient[j];
                }
            }
        }
        (normal, side)
    }

    /// Elastic curvature (1/m) at fractions of the length; each fraction is rounded to the nearest grid point.
    pub fn curvature(&self, load: Load, fractions: &[f64]) -> Vec<f64> {
        let mut all = Vec::with_capacity(self.steps + 1);
        self.integrate(load, |_, line| {
            all.push(self.elastic_curvature(load, line[1], line[2]));
        });
        fractions
            .iter()
            .map(|f| all[(f * self.steps as f64).round() as usize])
            .collect()
    }
}

/// Solution of a 3 × 3 system by elimination with row exchange. `None` if the matrix is singular.
pub fn solve(m: &[[f64; 3]; 3], b: &[f64; 3]) -> Option<[f64; 3]> {
    let mut a = [[0.0; 4]; 3];
    for i in 0..3 {
        a[i][..3].copy_from_slice(&m[i]);
        a[i][3] = b[i];
    }
    for k in 0..3 {
        let pivot = (k..3).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs()))?;
        a.swap(k, pivot);
        if !(a[k][k].abs() > 0.0) {
            return None;
        }
        for i in k + 1..3 {
            let l = a[i][k] / a[k][k];
            for j in k..4 {
                a[i][j] -= l * a[k][j];
            }
        }
    }
    let mut x = [0.0; 3];
    for k in (0..3).rev() {
        let known: f64 = (k + 1..3).map(|j| a[k][j] * x[j]).sum();
        x[k] = (a[k][3] - known) / a[k][k];
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pure bending is a circular arc.
    #[test]
    fn pure_moment_bends_into_an_arc() {
        let strip = Elastica::straight(0.37, 0.833, 1e7, 200);
        let turn = 1.3;
        let shot = strip.shoot([0.833 * turn / 0.37, 0.0, 0.0]);
        let radius = 0.37 / turn;
        assert!((shot.end[0] - radius * turn.sin()).abs() < 1e-11);
        assert!((shot.end[1] - radius * (1.0 - turn.cos())).abs() < 1e-11);
        assert!((shot.end[2] - turn).abs() < 1e-11);
    }

    /// Vertical tip load on a cantilever: tip angle and deflection by elliptic integrals, here as
    /// quadratures of the first integral of the elastica: ½θ'² = (P/EI)(sin θ_tip − sin θ).
    #[test]
    fn cantilever_under_a_tip_load_follows_the_first_integral() {
        let (length, bending) = (0.37, 0.833);
        let tip: f64 = 0.9;
        // The substitution θ = arcsin(sin(tip)·(1 − u²)) removes the singularity at the tip.
        let n = 200_000;
        let (mut arc, mut height) = (0.0, 0.0);
        for k in 0..n {
            let u = (k as f64 + 0.5) / n as f64;
            let sin = tip.sin() * (1.0 - u * u);
            let speed = 2.0 * tip.sin().sqrt() / (1.0 - sin * sin).sqrt() / n as f64;
            arc += speed;
            height += sin * speed;
        }
        // Both integrals are scaled: arc is √(2P/EI)·L, height is √(2P/EI) times the deflection.
        let force = bending * (arc / length).powi(2) / 2.0;
        let deflection = height / arc * length;
        let strip = Elastica::straight(length, bending, f64::INFINITY, 400);
        let moment = {
            // ∫ along the first integral also gives the horizontal reach, hence the root moment.
            let reach: f64 = (0..n)
                .map(|k| {
                    let u = (k as f64 + 0.5) / n as f64;
                    2.0 * tip.sin().sqrt() / n as f64 * u / u
                })
                .sum();
            force * reach / arc * length
        };
        let shot = strip.shoot([moment, 0.0, force]);
        assert!((shot.end[2] - tip).abs() < 1e-6, "{}", shot.end[2]);
        assert!((shot.end[1] - deflection).abs() < 1e-7);
    }

    #[test]
    fn compliance_is_the_derivative_of_the_end() {
        let strip = Elastica::straight(0.37, 0.833, 1e4, 100);
        let load = [1.0, -3.0, 2.0];
        let shot = strip.shoot(load);
        for p in 0..3 {
            let (mut up, mut down) = (load, load);
            up[p] += 1e-4;
            down[p] -= 1e-4;
            let (up, down) = (strip.shoot(up), strip.shoot(down));
            for i in 0..3 {
                let difference = (up.end[i] - down.end[i]) / 2e-4;
                assert!((shot.compliance[i][p] - difference).abs() < 1e-8);
            }
        }
    }
}
