//! Search for the equilibrium of a given end and curvatures, without a previous equilibrium.

use super::*;

impl Strip {
    #[inline(always)]
    pub(super) fn scaled(&self, end: [f64; 3]) -> [f64; 3] {
        let inverse = 1.0 / self.length;
        [end[0] * inverse, end[1] * inverse, end[2]]
    }

    /// Equilibrium at `end` (m, m, rad; root frame) on the branch of a guess: a curve given by its curvature (1/m) at
    /// fractions of the length. The flag is true if the equilibrium is stable while the end is held. The angle of `end`
    /// is the full turn of the strip, not wrapped. `None` if no equilibrium is found from the guess.
    ///
    /// Newton's method starts from the guess. If the method fails or finds an equilibrium of another branch, it starts
    /// again from the exact elastica fitted to the curvatures. If both starts fail, the end moves in steps from the end
    /// of the guess to `end`. At a fold, a stable and an unstable branch meet. Closer to a fold than the error of the
    /// curvature series, there may be no equilibrium.
    pub fn find(
        &self,
        end: [f64; 3],
        fractions: &[f64],
        curvature: &[f64],
    ) -> Option<(Equilibrium, bool)> {
        let end = self.scaled(end);
        let mut e = self.unloaded();
        self.fit_shape(&mut e.unknowns, end[2], fractions, curvature);
        e.end = end;
        for _ in 0..4 {
            self.fit_load(&mut e, fractions, curvature);
        }
        let own = self.ends(&e.unknowns, end[2]);
        let start = e.clone();
        if let Some(stable) = self.converge(&mut e, 1.0) {
            let deviation = self.deviation(&e, fractions, curvature);
            if deviation < OWN_BRANCH {
                return Some((e, stable));
            }
            // Near a fold two equilibria have the same end, and Newton's method may have found the other equilibrium.
            return match self.start_of_exact(&start, fractions, curvature) {
                Some((own, stable)) if self.deviation(&own, fractions, curvature) < deviation => {
                    Some((own, stable))
                }
                _ => Some((e, stable)),
            };
        }
        if let Some(found) = self.start_of_exact(&start, fractions, curvature) {
            return Some(found);
        }
        let mut e = start;
        let (mut done, mut step, mut stable) = (0.0, 0.125, false);
        e.end = [own[0], own[1], end[2]];
        self.converge(&mut e, 2.0)?;
        while done < 1.0 {
            let mut next = e.clone();
            let to = f64::min(done + step, 1.0);
            for n in 0..2 {
                next.end[n] = own[n] + to * (end[n] - own[n]);
                for i in 0..UNKNOWNS {
                    next.unknowns[i] += e.sensitivity[n][i] * (next.end[n] - e.end[n]);
                }
            }
            match self.converge(&mut next, 0.3) {
                Some(found) => {
                    (e, done, stable) = (next, to, found);
                    step *= 1.5;
                }
                None if step > 1e-4 => step *= 0.25,
                None => return None,
            }
        }
        Some((e, stable))
    }

    /// Equilibrium at the end in `start`, by Newton's method from the exact elastica fitted to `curvature`. `None` if
    /// the fit or Newton's method does not converge.
    fn start_of_exact(
        &self,
        start: &Equilibrium,
        fractions: &[f64],
        curvature: &[f64],
    ) -> Option<(Equilibrium, bool)> {
        let wave = |order| MODE.iter().position(|&mode| mode == order);
        let natural = |order| wave(order).map_or(0.0, |i| self.natural[i]);
        let exact = Elastica {
            length: 1.0,
            bending: 1.0,
            axial: 1.0 / self.stretch,
            waves: [natural(2), natural(3)],
            steps: 400,
        };
        let (fx, fy) = (start.unknowns[MODES], start.unknowns[MODES + 1]);
        let root = self.elastic_curvature(start, 0.0) * self.length;
        let target: Vec<f64> = curvature.iter().map(|k| k * self.length).collect();
        let load = exact.fit([root, fx, fy], fractions, &target)?;
        let mut e = start.clone();
        e.unknowns = self.natural;
        let grid: Vec<f64> = (0..=exact.steps)
            .map(|n| n as f64 / exact.steps as f64)
            .collect();
        for (n, (fraction, bend)) in grid.iter().zip(exact.curvature(load, &grid)).enumerate() {
            // Weights of Simpson's rule on [−1, 1].
            let weight = match n {
                _ if n == 0 || n == exact.steps => 1.0,
                _ if n % 2 == 1 => 4.0,
                _ => 2.0,
            } * 2.0
                / (3 * exact.steps) as f64;
            for i in 0..MODES {
                let scale = (MODE[i] as f64 + 0.5) * weight;
                e.unknowns[i] += scale * bend * polynomial(MODE[i], 2.0 * fraction - 1.0);
            }
        }
        (e.unknowns[MODES], e.unknowns[MODES + 1]) = (load[1], load[2]);
        let stable = self.converge(&mut e, 1.0)?;
        Some((e, stable))
    }

    /// Largest deviation of the equilibrium's curvature from `curvature`, as a share of the largest curvature.
    fn deviation(&self, e: &Equilibrium, fractions: &[f64], curvature: &[f64]) -> f64 {
        let (mut deviation, mut largest) = (0.0f64, f64::MIN_POSITIVE);
        for (f, k) in fractions.iter().zip(curvature) {
            let found = self.elastic_curvature(e, f * self.length);
            deviation = deviation.max((found - k).abs());
            largest = largest.max(k.abs());
        }
        deviation / largest
    }

    /// Newton's method down to rounding error. True if the equilibrium is stable. `None` without convergence, or if the
    /// corrections add up to more than `longest`.
    fn converge(&self, e: &mut Equilibrium, longest: f64) -> Option<bool> {
        let mut travelled = 0.0;
        let mut last = f64::INFINITY;
        for _ in 0..30 {
            let (fx, fy) = (e.unknowns[MODES], e.unknowns[MODES + 1]);
            let change = self.newton::<Narrow>(e, None);
            travelled += change;
            if !(travelled <= longest) {
                return None;
            }
            // The signs of the pivots, and so the stability, belong to the force before the correction. Correct again
            // while the force changes.
            let pull = (e.unknowns[MODES] - fx).abs() + (e.unknowns[MODES + 1] - fy).abs();
            if pull > 1e-6 * (1.0 + fx.abs() + fy.abs()) {
                continue;
            }
            if change < 1e-11 || (change < 1e-8 && change >= 0.5 * last) {
                return Some(e.factor.negative == 2);
            }
            last = change;
        }
        None
    }

    /// Fits the curvature coefficients of orders 1 to 4 by least squares; the end's angle gives order 0.
    fn fit_shape(&self, z: &mut Column, turn: f64, fractions: &[f64], curvature: &[f64]) {
        const FITTED: usize = 4;
        let mut normal = [[0.0; FITTED + 1]; FITTED];
        for (f, k) in fractions.iter().zip(curvature) {
            let basis: [f64; FITTED] = std::array::from_fn(|i| polynomial(i + 1, 2.0 * f - 1.0));
            for i in 0..FITTED {
                for j in 0..FITTED {
                    normal[i][j] += basis[i] * basis[j];
                }
                normal[i][FITTED] += basis[i] * (k * self.length - turn);
            }
        }
        for i in 0..FITTED {
            normal[i][i] += 1e-9;
        }
        // The matrix is positive definite, so elimination needs no pivoting.
        for k in 0..FITTED {
            for i in 0..FITTED {
                if i != k {
                    let l = normal[i][k] / normal[k][k];
                    for j in k..=FITTED {
                        normal[i][j] -= l * normal[k][j];
                    }
                }
            }
        }
        for i in 0..MODES {
            z[i] = match MODE[i] {
                n if n <= FITTED => normal[n - 1][FITTED] / normal[n - 1][n - 1],
                _ => 0.0,
            };
        }
    }

    /// Fits root moment and end force to the curvatures by least squares, and sets `e` to the shape under this load.
    /// The points of the strip are those of `e`: at known points, curvature is linear in root moment and force.
    fn fit_load(&self, e: &mut Equilibrium, fractions: &[f64], curvature: &[f64]) {
        let mut normal = [[0.0; 3]; 3];
        let mut side = [0.0; 3];
        for (f, k) in fractions.iter().zip(curvature) {
            let [x, y, _] = self.point(e, f * self.length);
            let row = [1.0, y / self.length, -x / self.length];
            for i in 0..3 {
                for j in 0..3 {
                    normal[i][j] += row[i] * row[j];
                }
                side[i] += row[i] * k * self.length;
            }
        }
        for i in 1..3 {
            // Keeps the matrix regular: the curvatures of a nearly straight strip do not determine the force along it.
            normal[i][i] += 1e-8;
        }
        let Some([moment, fx, fy]) = elastica::solve(&normal, &side) else {
            return;
        };
        let mut coefficients = Column::ZERO;
        for (node, weight) in gauss() {
            let [x, y, _] = self.point(e, 0.5 * (1.0 + node) * self.length);
            let bend = moment + (fx * y - fy * x) / self.length;
            for i in 0..MODES {
                let scale = (2 * MODE[i] + 1) as f64 * weight;
                coefficients[i] += scale * bend * polynomial(MODE[i], node);
            }
        }
        coefficients[MODES] = fx;
        coefficients[MODES + 1] = fy;
        e.unknowns = coefficients;
    }
}
