//! The compliant frame: an extensible Kirchhoff rod in the plane, in quasi-static equilibrium.
//!
//! **Model.** Curvature is a Legendre series, κ(s) = Σ aᵢ Pᵢ(2s/L − 1), so that the slope θ(s) is
//! known in closed form and a₀ = θ_end/L follows from the posture of the end. The rest, and the
//! force F on the end, make stationary
//!
//! U = EI/2 ∫(κ − κₙ)² ds − ∫(F·t)²/(2 EA) ds − F·(∫t ds − X),  t = (cos θ, sin θ),
//!
//! X being the end's position in the root frame. Newton's method acts on the symmetric system of
//! all unknowns, factored as LDLᵀ without pivoting. Two negative pivots, no more and no fewer, say
//! that the equilibrium is stable. The end moment (1/L) ∂U/∂a₀ is second order in the error of a.
//!
//! **Frames and signs.** Root frame: x along the strip at its root, y to the left. The wrench
//! (Fx, Fy, M_end) is what the environment exerts on the end; the bending moment is
//! M(s) = M_root + Fx·y(s) − Fy·x(s) with M_root = M_end + x·Fy − y·Fx, positive when the strip
//! bends left. The root support feels (+F, +M_root), the end support (−F, −M_end).
//!
//! Inside this module lengths are in L, forces in EI/L², moments in EI/L.

use super::elastica;
use super::legendre::{
    BENDING, EQUAL, EVEN, MIXED, MODE, NODES, ODD, ORDER, PAIRS, POINTS, SLOPES, WEIGHTS,
    polynomial, slope,
};
use super::sincos::sin_cos;

/// Unknown curvature coefficients.
const MODES: usize = ORDER - 1;
/// Unknowns: coefficients and two components of the force.
pub(super) const UNKNOWNS: usize = MODES + 2;
/// Newton iterations of one solution.
const ITERATIONS: u32 = 4;
/// Error allowed in a force of unit size, for the estimate made from the last correction.
const TOLERANCE: f64 = 1e-6;
/// Largest slope correction in one step of the plant, rad: a longer jump is another branch.
const LONGEST_JUMP: f64 = 0.05;
/// The same where internal viscosity holds the shape back.
const LONGEST_CREEP: f64 = 0.5;

/// Elastic constants of the strip, and its shape when nothing acts on it.
#[derive(Clone, Debug)]
pub struct Strip {
    length: f64,
    bending: f64,
    /// EI / (EA L²).
    stretch: f64,
    /// Unloaded curvature times L, rows as in [`MODE`].
    natural: [f64; MODES],
    /// Wrench of unit size in SI units.
    scale: [f64; 3],
}

/// An equilibrium and its linearisation.
#[derive(Clone, Debug)]
pub struct Equilibrium {
    /// End of the strip in the root frame.
    end: [f64; 3],
    unknowns: [f64; UNKNOWNS],
    moment: f64,
    /// Derivatives of the unknowns with respect to the end.
    sensitivity: [[f64; 3]; UNKNOWNS],
    /// Derivative of the wrench.
    stiffness: [[f64; 3]; 3],
    /// Power dissipated by a unit internal viscosity, as a quadratic form of the end's rate.
    viscosity: [[f64; 3]; 3],
    factor: Factor,
    /// ∂²U/∂a₀∂(unknowns).
    coupling: [f64; UNKNOWNS],
}

/// End and unknowns of an equilibrium.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    end: [f64; 3],
    unknowns: [f64; UNKNOWNS],
}

/// How a solution was reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solved {
    /// Factorisations used.
    pub iterations: u32,
    /// Whether the equilibrium is stable under a held end.
    pub stable: bool,
}

/// Internal viscosity that holds the shape back while the strip snaps from one branch to another:
/// bending strain pays `ratio` = τ/h times its stiffness for each departure from `from`.
#[derive(Clone, Copy)]
struct Viscous<'a> {
    ratio: f64,
    from: &'a [f64; UNKNOWNS],
}

/// LDLᵀ of the symmetric system: unit upper rows and reciprocal pivots.
#[derive(Clone, Debug)]
struct Factor {
    row: [[f64; UNKNOWNS]; UNKNOWNS],
    reciprocal: [f64; UNKNOWNS],
    negative: u32,
}

/// Calls a function with each row as a constant, so that its loops have constant bounds and are
/// laid out flat: rolled up, their counters would cost as much as the arithmetic.
macro_rules! unrolled {
    (eliminate, $factor:expr, $sides:expr) => {
        unrolled!(@ eliminate, $factor, $sides, 0 1 2 3 4 5 6 7 8 9)
    };
    (substitute, $factor:expr, $sides:expr) => {
        unrolled!(@ substitute, $factor, $sides, 9 8 7 6 5 4 3 2 1 0)
    };
    (@ $step:ident, $factor:expr, $sides:expr, $($k:literal)+) => {
        $($step::<$k, _>($factor, $sides);)+
    };
}

/// Eliminates unknown `K` from the rows below and from all right-hand sides.
#[inline(always)]
fn eliminate<const K: usize, const N: usize>(
    factor: &mut Factor,
    sides: &mut [[f64; N]; UNKNOWNS],
) {
    let Factor {
        row,
        reciprocal,
        negative,
    } = factor;
    let pivot = row[K];
    *negative += u32::from(pivot[K] < 0.0);
    let inverse = 1.0 / pivot[K];
    reciprocal[K] = inverse;
    let side = sides[K];
    for i in K + 1..UNKNOWNS {
        let l = pivot[i] * inverse;
        // The part below the diagonal is worked on too, unread: whole rows suit vector registers.
        for j in K + 1..UNKNOWNS {
            row[i][j] -= l * pivot[j];
        }
        for n in 0..N {
            sides[i][n] -= l * side[n];
        }
        row[K][i] = l;
    }
}

/// Finds unknown `K` from those after it.
#[inline(always)]
fn substitute<const K: usize, const N: usize>(factor: &Factor, sides: &mut [[f64; N]; UNKNOWNS]) {
    let mut x = sides[K].map(|v| v * factor.reciprocal[K]);
    for j in K + 1..UNKNOWNS {
        for n in 0..N {
            x[n] -= factor.row[K][j] * sides[j][n];
        }
    }
    sides[K] = x;
}

/// Forward part of a solution for one right-hand side.
#[inline(always)]
fn forward<const K: usize, const N: usize>(factor: &Factor, sides: &mut [[f64; N]; UNKNOWNS]) {
    let side = sides[K];
    for i in K + 1..UNKNOWNS {
        for n in 0..N {
            sides[i][n] -= factor.row[K][i] * side[n];
        }
    }
}

impl Factor {
    /// Solves for one right-hand side.
    #[inline(always)]
    fn solve(&self, x: [f64; UNKNOWNS]) -> [f64; UNKNOWNS] {
        let mut x = x.map(|v| [v]);
        unrolled!(@ forward, self, &mut x, 0 1 2 3 4 5 6 7 8 9);
        unrolled!(substitute, self, &mut x);
        x.map(|[v]| v)
    }
}

/// Integrands at the quadrature points, positive nodes first.
struct Points {
    sin: [f64; POINTS],
    cos: [f64; POINTS],
    /// Force along the strip.
    tension: [f64; POINTS],
    /// Force across it.
    shear: [f64; POINTS],
    /// Length over unstrained length.
    stretch: [f64; POINTS],
}

/// Even and odd part over the node pairs.
#[inline(always)]
fn fold(v: &[f64; POINTS]) -> ([f64; PAIRS], [f64; PAIRS]) {
    let (mut even, mut odd) = ([0.0; PAIRS], [0.0; PAIRS]);
    for k in 0..PAIRS {
        even[k] = v[k] + v[k + PAIRS];
        odd[k] = v[k] - v[k + PAIRS];
    }
    (even, odd)
}

/// Integral of an integrand against each slope function, rows as in [`MODE`].
#[inline(always)]
fn project(even: &[f64; PAIRS], odd: &[f64; PAIRS]) -> [f64; ORDER] {
    let mut sum = [0.0; ORDER];
    for k in 0..PAIRS {
        for i in 0..EVEN {
            sum[i] += even[k] * SLOPES[k][i];
        }
        for i in EVEN..ORDER {
            sum[i] += odd[k] * SLOPES[k][i];
        }
    }
    sum
}

#[inline(always)]
fn sum(v: &[f64; POINTS]) -> f64 {
    let mut lane = [0.0; 4];
    for k in 0..POINTS / 4 {
        for i in 0..4 {
            lane[i] += v[4 * k + i];
        }
    }
    (lane[0] + lane[1]) + (lane[2] + lane[3])
}

#[inline(always)]
fn largest(v: &[f64; UNKNOWNS]) -> f64 {
    let mut m = 0.0;
    for i in 0..MODES {
        // A NaN must win.
        let a = v[i].abs();
        m = if a <= m { m } else { a };
    }
    m
}

impl Strip {
    /// A strip of `length` (m), bending stiffness EI (N m²) and axial stiffness EA (N), all
    /// positive. `natural_slope` (rad) is the amplitude of a slight waviness of the unloaded strip
    /// that leaves its ends aligned; it decides which way a perfectly straight strip buckles.
    pub fn new(length: f64, bending: f64, axial: f64, natural_slope: f64) -> Self {
        let mut natural = [0.0; MODES];
        for i in 0..MODES {
            // Orders 2 and 3 break both symmetries of the straight strip. 0.096 and 0.073 are the
            // largest slopes of curvature P_2 and P_3.
            natural[i] = match MODE[i] {
                2 => natural_slope / 0.096_225,
                3 => 0.5 * natural_slope / 0.073_193,
                _ => 0.0,
            };
        }
        let force = bending / (length * length);
        Self {
            length,
            bending,
            stretch: force / axial,
            natural,
            scale: [force, force, force * length],
        }
    }

    /// Unstrained length, m.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// The strip with nothing acting on it.
    pub fn unloaded(&self) -> Equilibrium {
        let mut unknowns = [0.0; UNKNOWNS];
        unknowns[..MODES].copy_from_slice(&self.natural);
        let p = self.points(&unknowns, 0.0);
        let (mut x, mut y) = (0.0, 0.0);
        for k in 0..POINTS {
            x += WEIGHTS[k % PAIRS] * p.cos[k];
            y += WEIGHTS[k % PAIRS] * p.sin[k];
        }
        let mut equilibrium = Equilibrium {
            end: [x, y, 0.0],
            unknowns,
            moment: 0.0,
            sensitivity: [[0.0; 3]; UNKNOWNS],
            stiffness: [[0.0; 3]; 3],
            viscosity: [[0.0; 3]; 3],
            factor: Factor {
                row: [[0.0; UNKNOWNS]; UNKNOWNS],
                reciprocal: [0.0; UNKNOWNS],
                negative: 0,
            },
            coupling: [0.0; UNKNOWNS],
        };
        self.iterate(&mut equilibrium, None, LONGEST_JUMP);
        equilibrium
    }

    #[inline(always)]
    fn points(&self, z: &[f64; UNKNOWNS], turn: f64) -> Points {
        let mut angle = [0.0; POINTS];
        for k in 0..PAIRS {
            let (mut even, mut odd) = (0.5 * turn, 0.5 * turn * NODES[k]);
            for i in 0..EVEN {
                even += z[i] * SLOPES[k][i];
            }
            for i in EVEN..MODES {
                odd += z[i] * SLOPES[k][i];
            }
            angle[k] = even + odd;
            angle[k + PAIRS] = even - odd;
        }
        let (sin, cos) = sin_cos(&angle);
        let (fx, fy) = (z[MODES], z[MODES + 1]);
        let mut p = Points {
            sin,
            cos,
            tension: [0.0; POINTS],
            shear: [0.0; POINTS],
            stretch: [0.0; POINTS],
        };
        for k in 0..POINTS {
            p.tension[k] = fx * cos[k] + fy * sin[k];
            p.shear[k] = fy * cos[k] - fx * sin[k];
            p.stretch[k] = 1.0 + self.stretch * p.tension[k];
        }
        p
    }

    /// Gradient of U with respect to the unknowns, and the end moment.
    #[inline(always)]
    fn residual(
        &self,
        p: &Points,
        z: &[f64; UNKNOWNS],
        end: &[f64; 3],
        viscous: Option<Viscous>,
    ) -> ([f64; UNKNOWNS], f64) {
        let (mut load, mut x, mut y) = ([0.0; POINTS], [0.0; POINTS], [0.0; POINTS]);
        for k in 0..POINTS {
            let w = WEIGHTS[k % PAIRS] * p.stretch[k];
            load[k] = w * p.shear[k];
            x[k] = w * p.cos[k];
            y[k] = w * p.sin[k];
        }
        let (even, odd) = fold(&load);
        let projected = project(&even, &odd);
        let mut r = [0.0; UNKNOWNS];
        for i in 0..MODES {
            r[i] = BENDING[i] * (z[i] - self.natural[i]) - projected[i];
        }
        if let Some(Viscous { ratio, from }) = viscous {
            for i in 0..MODES {
                r[i] += ratio * BENDING[i] * (z[i] - from[i]);
            }
        }
        r[MODES] = end[0] - sum(&x);
        r[MODES + 1] = end[1] - sum(&y);
        let mut first = [0.0; PAIRS];
        for k in 0..PAIRS {
            first[k] = even[k] + NODES[k] * odd[k];
        }
        let first = (first[0] + first[1]) + (first[2] + first[3]) + (first[4] + first[5]);
        (r, end[2] - 0.5 * first)
    }

    /// One Newton correction at `e.unknowns` for `e.end`, applied, with the linearisation left in
    /// `e`. Returns the largest change of a coefficient.
    #[inline(always)]
    fn newton(&self, e: &mut Equilibrium, viscous: Option<Viscous>) -> f64 {
        const X: usize = MODES;
        const Y: usize = MODES + 1;
        let p = self.points(&e.unknowns, e.end[2]);
        let (r, moment) = self.residual(&p, &e.unknowns, &e.end, viscous);

        // Second derivatives, by integrand: curvature of the load, force columns, axial give.
        let (mut g, mut cx, mut cy) = ([0.0; POINTS], [0.0; POINTS], [0.0; POINTS]);
        let (mut sxx, mut sxy) = ([0.0; POINTS], [0.0; POINTS]);
        for k in 0..POINTS {
            let w = WEIGHTS[k % PAIRS];
            let ws = w * self.stretch;
            let we = w * p.stretch[k];
            let wsn = ws * p.shear[k];
            g[k] = we * p.tension[k] - wsn * p.shear[k];
            cx[k] = wsn * p.cos[k] - we * p.sin[k];
            cy[k] = wsn * p.sin[k] + we * p.cos[k];
            sxx[k] = ws * p.cos[k] * p.cos[k];
            sxy[k] = ws * p.cos[k] * p.sin[k];
        }
        let (give_xx, give_xy) = (sum(&sxx), sum(&sxy));
        let give_yy = self.stretch - give_xx;
        let (ge, go) = fold(&g);
        let (cxe, cxo) = fold(&cx);
        let (cye, cyo) = fold(&cy);
        // Order 0 has slope (1 + ξ)/2: its products are found from the same folds.
        let (mut pe, mut po) = ([0.0; PAIRS], [0.0; PAIRS]);
        let (mut k00, mut c0x, mut c0y) = (0.0, 0.0, 0.0);
        for k in 0..PAIRS {
            pe[k] = 0.5 * (ge[k] + NODES[k] * go[k]);
            po[k] = 0.5 * (go[k] + NODES[k] * ge[k]);
            k00 += 0.5 * (pe[k] + NODES[k] * po[k]);
            c0x += 0.5 * (cxe[k] + NODES[k] * cxo[k]);
            c0y += 0.5 * (cye[k] + NODES[k] * cyo[k]);
        }
        let (bx, by) = (project(&cxe, &cxo), project(&cye, &cyo));
        let b0 = project(&pe, &po);
        let (mut equal, mut mixed) = ([0.0; 20], [0.0; 16]);
        for k in 0..PAIRS {
            for n in 0..20 {
                equal[n] += ge[k] * EQUAL[k][n];
            }
            for n in 0..16 {
                mixed[n] += go[k] * MIXED[k][n];
            }
        }

        let a = &mut e.factor.row;
        for i in 0..EVEN {
            for j in i..EVEN {
                a[i][j] = equal[i * EVEN - i * (i + 1) / 2 + j];
            }
            for j in 0..ODD {
                a[i][EVEN + j] = mixed[i * ODD + j];
            }
        }
        for i in 0..ODD {
            for j in i..ODD {
                a[EVEN + i][EVEN + j] = equal[10 + i * ODD - i * (i + 1) / 2 + j];
            }
        }
        let stiff = 1.0 + viscous.map_or(0.0, |v| v.ratio);
        for i in 0..MODES {
            a[i][i] += stiff * BENDING[i];
            a[i][X] = -bx[i];
            a[i][Y] = -by[i];
            e.coupling[i] = b0[i];
        }
        a[X][X] = -give_xx;
        a[X][Y] = -give_xy;
        a[Y][Y] = -give_yy;
        e.coupling[X] = -c0x;
        e.coupling[Y] = -c0y;

        // Right-hand sides: end x, end y, end angle, residual.
        let mut s = [[0.0; 4]; UNKNOWNS];
        for i in 0..UNKNOWNS {
            s[i][2] = -e.coupling[i];
            s[i][3] = -r[i];
        }
        s[X][0] = -1.0;
        s[Y][1] = -1.0;
        e.factor.negative = 0;
        unrolled!(eliminate, &mut e.factor, &mut s);
        unrolled!(substitute, &e.factor, &mut s);

        let (mut kx, mut ky, mut km, mut dm) = (0.0, 0.0, 1.0 + k00, 0.0);
        let mut v = [[0.0; 3]; 3];
        v[2][2] = 1.0;
        let mut correction = [0.0; UNKNOWNS];
        for i in 0..UNKNOWNS {
            kx += e.coupling[i] * s[i][0];
            ky += e.coupling[i] * s[i][1];
            km += e.coupling[i] * s[i][2];
            dm += e.coupling[i] * s[i][3];
            correction[i] = s[i][3];
            e.sensitivity[i] = [s[i][0], s[i][1], s[i][2]];
        }
        for i in 0..MODES {
            for m in 0..3 {
                let t = BENDING[i] * s[i][m];
                for n in m..3 {
                    v[m][n] += t * s[i][n];
                }
            }
        }
        let (fx, fy) = (&e.sensitivity[X], &e.sensitivity[Y]);
        for m in 0..3 {
            let tx = give_xx * fx[m] + give_xy * fy[m];
            let ty = give_xy * fx[m] + give_yy * fy[m];
            for n in m..3 {
                v[m][n] += tx * fx[n] + ty * fy[n];
            }
        }
        e.stiffness = [[fx[0], fx[1], kx], [fx[1], fy[1], ky], [kx, ky, km]];
        e.viscosity = [
            v[0],
            [v[0][1], v[1][1], v[1][2]],
            [v[0][2], v[1][2], v[2][2]],
        ];
        for i in 0..UNKNOWNS {
            e.unknowns[i] += correction[i];
        }
        e.moment = moment + dm;
        largest(&correction)
    }

    /// One correction with the factors at hand.
    #[inline(always)]
    fn polish(
        &self,
        factor: &Factor,
        coupling: &[f64; UNKNOWNS],
        z: &mut [f64; UNKNOWNS],
        end: &[f64; 3],
        viscous: Option<Viscous>,
    ) -> (f64, f64) {
        let p = self.points(z, end[2]);
        let (r, mut moment) = self.residual(&p, z, end, viscous);
        let correction = factor.solve(r.map(|v| -v));
        for i in 0..UNKNOWNS {
            z[i] += correction[i];
            moment += coupling[i] * correction[i];
        }
        (largest(&correction), moment)
    }

    /// Force left wrong by a pair of corrections: their product is a length, the stiffness makes
    /// it a force.
    #[inline(always)]
    fn remainder(e: &Equilibrium, first: f64, second: f64) -> f64 {
        let k = &e.stiffness;
        0.1 * (k[0][0].abs() + k[1][1].abs()) * first * second
    }

    #[inline(always)]
    fn allowed(e: &Equilibrium) -> f64 {
        TOLERANCE * (1.0 + e.unknowns[MODES].abs() + e.unknowns[MODES + 1].abs())
    }

    /// Newton's method from the coefficients in `e`. `None` if it does not converge.
    fn iterate(
        &self,
        e: &mut Equilibrium,
        viscous: Option<Viscous>,
        longest: f64,
    ) -> Option<Solved> {
        let mut travelled = 0.0;
        let most = if viscous.is_some() {
            4 * ITERATIONS
        } else {
            ITERATIONS
        };
        for iteration in 1..=most {
            let first = self.newton(e, viscous);
            travelled += first;
            if !(travelled <= longest) {
                return None;
            }
            let solved = Solved {
                iterations: iteration,
                stable: e.factor.negative == 2,
            };
            if Self::remainder(e, first, first) <= Self::allowed(e) {
                return Some(solved);
            }
            let (second, moment) =
                self.polish(&e.factor, &e.coupling, &mut e.unknowns, &e.end, viscous);
            e.moment = moment;
            travelled += second;
            if !(travelled <= longest) {
                return None;
            }
            if Self::remainder(e, first, second) <= Self::allowed(e) {
                return Some(solved);
            }
        }
        None
    }

    /// The equilibrium at `end` (m, m, rad; root frame), from the one in `e`. `bend` is the second
    /// difference found by [`Self::near`] half-way, or zero: the start is extrapolated with it.
    /// Returns `None`, with `e` at the new end but otherwise unchanged, if no stable equilibrium
    /// is near.
    #[inline(always)]
    pub fn follow(
        &self,
        e: &mut Equilibrium,
        end: [f64; 3],
        bend: &[f64; UNKNOWNS],
    ) -> Option<Solved> {
        let from = e.unknowns;
        let end = self.scaled(end);
        let step = [end[0] - e.end[0], end[1] - e.end[1], end[2] - e.end[2]];
        for i in 0..UNKNOWNS {
            let d = &e.sensitivity[i];
            e.unknowns[i] += d[0] * step[0] + d[1] * step[1] + d[2] * step[2] + bend[i];
        }
        e.end = end;
        match self.iterate(e, None, LONGEST_JUMP) {
            Some(solved) if solved.stable => Some(solved),
            _ => {
                e.unknowns = from;
                None
            }
        }
    }

    /// The incremental equilibrium at the end already in `e`, held back by internal viscosity.
    /// `None` (and `e` unchanged but for its linearisation) if even that does not converge.
    pub fn creep(&self, e: &mut Equilibrium, ratio: f64) -> Option<Solved> {
        let from = e.unknowns;
        let viscous = Viscous { ratio, from: &from };
        match self.iterate(e, Some(viscous), LONGEST_CREEP) {
            Some(solved) if solved.stable => Some(solved),
            _ => {
                e.unknowns = from;
                None
            }
        }
    }

    /// Returns to an earlier equilibrium.
    #[cold]
    pub fn restore(&self, e: &mut Equilibrium, shape: Shape) {
        e.end = shape.end;
        e.unknowns = shape.unknowns;
        self.newton(e, None);
    }

    /// Wrench at an `end` near that of `e` with the factors of `e`, and the departure of the
    /// coefficients from the linear prediction. `None` if `end` is too far for that.
    #[inline(always)]
    pub fn near(&self, e: &Equilibrium, end: [f64; 3]) -> Option<([f64; 3], [f64; UNKNOWNS])> {
        let end = self.scaled(end);
        let step = [end[0] - e.end[0], end[1] - e.end[1], end[2] - e.end[2]];
        let mut linear = e.unknowns;
        for i in 0..UNKNOWNS {
            let d = &e.sensitivity[i];
            linear[i] += d[0] * step[0] + d[1] * step[1] + d[2] * step[2];
        }
        let mut z = linear;
        let (mut last, mut moment) = self.polish(&e.factor, &e.coupling, &mut z, &end, None);
        let allowed = Self::allowed(e);
        // The factors are off by about the travel between the two ends.
        let off = step[0].abs() + step[1].abs() + step[2].abs();
        if !(Self::remainder(e, last, last + off) <= allowed) {
            let mut rounds = 0;
            loop {
                let (next, m) = self.polish(&e.factor, &e.coupling, &mut z, &end, None);
                moment = m;
                rounds += 1;
                if Self::remainder(e, last, next) <= allowed {
                    break;
                }
                if !(next <= 0.5 * last) || rounds == 6 {
                    return None;
                }
                last = next;
            }
        }
        let wrench = [
            z[MODES] * self.scale[0],
            z[MODES + 1] * self.scale[1],
            moment * self.scale[2],
        ];
        for i in 0..UNKNOWNS {
            z[i] -= linear[i];
        }
        Some((wrench, z))
    }

    fn scaled(&self, end: [f64; 3]) -> [f64; 3] {
        let inverse = 1.0 / self.length;
        [end[0] * inverse, end[1] * inverse, end[2]]
    }

    /// The equilibrium at `end` (m, m, rad; root frame) on the branch of a shape known by its
    /// curvature (1/m) at some fractions of the length, and whether it is stable under a held end.
    /// The angle of `end` is the whole turn of the strip, not wrapped. `None` if no equilibrium
    /// can be reached from that shape.
    ///
    /// Newton's method from the shape; if that leads far from it, by steps from the end that the
    /// shape itself has.
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
        let p = self.points(&e.unknowns, end[2]);
        let own: [f64; 2] =
            [&p.cos, &p.sin].map(|v| (0..POINTS).map(|k| WEIGHTS[k % PAIRS] * v[k]).sum::<f64>());
        let start = e.clone();
        if let Some(stable) = self.converge(&mut e, 1.0) {
            return Some((e, stable));
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
                    next.unknowns[i] += e.sensitivity[i][n] * (next.end[n] - e.end[n]);
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

    /// Newton's method to rounding error.
    fn converge(&self, e: &mut Equilibrium, longest: f64) -> Option<bool> {
        let mut travelled = 0.0;
        let mut last = f64::INFINITY;
        for _ in 0..30 {
            let (fx, fy) = (e.unknowns[MODES], e.unknowns[MODES + 1]);
            let change = self.newton(e, None);
            travelled += change;
            if !(travelled <= longest) {
                return None;
            }
            // The signs of the pivots belong to the force before the correction.
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

    /// Least-squares coefficients of orders 1 to 4; the end's angle gives order 0.
    fn fit_shape(&self, z: &mut [f64; UNKNOWNS], turn: f64, fractions: &[f64], curvature: &[f64]) {
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
        // Positive definite: no pivoting.
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

    /// Load that best explains the curvatures on the shape in `e`, and the shape under that load:
    /// curvature is linear in root moment and force once the positions are known.
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
            // A nearly straight shape says nothing of the force along it.
            normal[i][i] += 1e-8;
        }
        let Some([moment, fx, fy]) = elastica::solve(&normal, &side) else {
            return;
        };
        let mut coefficients = [0.0; MODES];
        for k in 0..POINTS {
            let node = if k < PAIRS {
                NODES[k]
            } else {
                -NODES[k - PAIRS]
            };
            let [x, y, _] = self.point(e, 0.5 * (1.0 + node) * self.length);
            let bend = moment + (fx * y - fy * x) / self.length;
            for i in 0..MODES {
                let scale = (2 * MODE[i] + 1) as f64 * WEIGHTS[k % PAIRS];
                coefficients[i] += scale * bend * polynomial(MODE[i], node);
            }
        }
        e.unknowns[..MODES].copy_from_slice(&coefficients);
        e.unknowns[MODES..].copy_from_slice(&[fx, fy]);
    }

    /// Wrench (N, N, N m) of the environment on the end.
    #[inline(always)]
    pub fn wrench(&self, e: &Equilibrium) -> [f64; 3] {
        [
            e.unknowns[MODES] * self.scale[0],
            e.unknowns[MODES + 1] * self.scale[1],
            e.moment * self.scale[2],
        ]
    }

    /// Wrench (N, N, N m) at an `end` close to that of `e`, to first order.
    pub fn linear_wrench(&self, e: &Equilibrium, end: [f64; 3]) -> [f64; 3] {
        let end = self.scaled(end);
        let mut wrench = [e.unknowns[MODES], e.unknowns[MODES + 1], e.moment];
        for m in 0..3 {
            for n in 0..3 {
                wrench[m] += e.stiffness[m][n] * (end[n] - e.end[n]);
            }
            wrench[m] *= self.scale[m];
        }
        wrench
    }

    /// Tangent stiffness ∂(Fx, Fy, M_end)/∂(x, y, angle), SI units, symmetric.
    #[inline(always)]
    pub fn stiffness(&self, e: &Equilibrium) -> [[f64; 3]; 3] {
        self.in_si(&e.stiffness)
    }

    /// Matrix V with Vẋ·ẋ = ∫ EI κ̇² ds + ∫ EA ε̇² ds for an end rate ẋ, SI units: symmetric and
    /// never negative. It is the tangent stiffness without the part that the load contributes, so
    /// damping in proportion to it takes energy out on any branch.
    #[inline(always)]
    pub fn viscosity(&self, e: &Equilibrium) -> [[f64; 3]; 3] {
        self.in_si(&e.viscosity)
    }

    #[inline(always)]
    fn in_si(&self, k: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
        let (f, m) = (self.scale[0], self.scale[2]);
        let l = f / self.length;
        [
            [k[0][0] * l, k[0][1] * l, k[0][2] * f],
            [k[1][0] * l, k[1][1] * l, k[1][2] * f],
            [k[2][0] * f, k[2][1] * f, k[2][2] * m],
        ]
    }

    /// Elastic energy, J.
    pub fn energy(&self, e: &Equilibrium) -> f64 {
        let mut u = 0.5 * e.end[2] * e.end[2];
        for i in 0..MODES {
            u += 0.5 * BENDING[i] * (e.unknowns[i] - self.natural[i]).powi(2);
        }
        let p = self.points(&e.unknowns, e.end[2]);
        for k in 0..POINTS {
            u += 0.5 * WEIGHTS[k % PAIRS] * self.stretch * p.tension[k].powi(2);
        }
        u * self.scale[2]
    }

    /// Moment at the root, N m.
    pub fn root_moment(&self, e: &Equilibrium) -> f64 {
        let (fx, fy) = (e.unknowns[MODES], e.unknowns[MODES + 1]);
        (e.moment + e.end[0] * fy - e.end[1] * fx) * self.scale[2]
    }

    fn angle(&self, e: &Equilibrium, xi: f64) -> f64 {
        let mut angle = e.end[2] * slope(0, xi);
        for i in 0..MODES {
            angle += e.unknowns[i] * slope(MODE[i], xi);
        }
        angle
    }

    /// Point of the strip (m) at arc length `s` (m, clamped to the strip) and its angle (rad), in
    /// the root frame.
    pub fn point(&self, e: &Equilibrium, s: f64) -> [f64; 3] {
        let part = (s / self.length).clamp(0.0, 1.0);
        let (fx, fy) = (e.unknowns[MODES], e.unknowns[MODES + 1]);
        let (mut x, mut y) = (0.0, 0.0);
        for k in 0..POINTS {
            let node = if k < PAIRS {
                NODES[k]
            } else {
                -NODES[k - PAIRS]
            };
            let angle = self.angle(e, part * (1.0 + node) - 1.0);
            let (sin, cos) = libm::sincos(angle);
            let w = WEIGHTS[k % PAIRS] * (1.0 + self.stretch * (fx * cos + fy * sin));
            x += w * cos;
            y += w * sin;
        }
        let l = part * self.length;
        [x * l, y * l, self.angle(e, 2.0 * part - 1.0)]
    }

    /// Bending moment over EI (1/m) at arc length `s` (m), from the balance of moments: an order
    /// of magnitude more accurate than the series. What a gauge bonded to the unloaded strip sees,
    /// divided by the half thickness.
    pub fn elastic_curvature(&self, e: &Equilibrium, s: f64) -> f64 {
        let [x, y, _] = self.point(e, s);
        let [fx, fy, _] = self.wrench(e);
        (self.root_moment(e) + fx * y - fy * x) / self.bending
    }

    /// The same by the series, which also holds while the strip snaps.
    pub fn series_curvature(&self, e: &Equilibrium, s: f64) -> f64 {
        let xi = 2.0 * (s / self.length).clamp(0.0, 1.0) - 1.0;
        let mut k = e.end[2];
        for i in 0..MODES {
            k += (e.unknowns[i] - self.natural[i]) * polynomial(MODE[i], xi);
        }
        k / self.length
    }
}

impl Equilibrium {
    /// End of the strip (m, m, rad) in the root frame.
    pub fn end(&self, strip: &Strip) -> [f64; 3] {
        [
            self.end[0] * strip.length,
            self.end[1] * strip.length,
            self.end[2],
        ]
    }

    /// What determines it: end and unknowns.
    #[inline(always)]
    pub fn shape(&self) -> Shape {
        Shape {
            end: self.end,
            unknowns: self.unknowns,
        }
    }

    /// No departure from the linear prediction.
    pub const STRAIGHT_ON: [f64; UNKNOWNS] = [0.0; UNKNOWNS];
}
