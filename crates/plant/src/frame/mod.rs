//! The compliant frame: an extensible Kirchhoff rod in the plane, in quasi-static equilibrium.
//!
//! **Model.** Curvature is a Legendre series, κ(s) = Σ aᵢ Pᵢ(2s/L − 1), so that the slope θ(s) is
//! known in closed form and a₀ = θ_end/L follows from the posture of the end. The other coefficients,
//! and the force F on the end, make stationary
//!
//! U = EI/2 ∫(κ − κₙ)² ds − ∫(F·t)²/(2 EA) ds − F·(∫t ds − X),  t = (cos θ, sin θ),
//!
//! X being the end's position in the root frame. Newton's method acts on the symmetric system of
//! all unknowns, factored as LDLᵀ without pivoting. The equilibrium is stable if exactly two pivots are
//! negative. The end moment (1/L) ∂U/∂a₀ is second order in the error of a.
//!
//! **Frames and signs.** Root frame: x along the strip at its root, y to the left. The wrench
//! (Fx, Fy, M_end) is what the environment exerts on the end; the bending moment is
//! M(s) = M_root + Fx·y(s) − Fy·x(s) with M_root = M_end + x·Fy − y·Fx, positive when the strip
//! bends left. The strip exerts (+F, +M_root) on the root support and (−F, −M_end) on the end support.
//!
//! Inside this module lengths are in L, forces in EI/L², moments in EI/L.

mod find;
mod newton;
mod station;

use super::elastica::{self, Elastica};
use super::lanes::{Lanes, Narrow, Twelve};
use super::legendre::{
    BENDING, MODE, MODES, NODES, PAIRS, STRAND_WEIGHTS, WEIGHTS, polynomial, slope,
};
pub use newton::Column;
use newton::{Factor, Points, Viscous};
pub use station::{Station, Tangents};

/// Unknowns: coefficients and two components of the force.
const UNKNOWNS: usize = MODES + 2;
/// Largest deviation of the curvature at which an equilibrium counts as on the requested branch, as a share of the
/// largest curvature.
const OWN_BRANCH: f64 = 3e-3;
/// Largest number of Newton iterations of one solution.
const ITERATIONS: u32 = 4;
/// Allowed error of the force components, as a share of 1 + |Fx| + |Fy| in units of EI/L². The error is estimated from
/// the last corrections.
const TOLERANCE: f64 = 1e-6;
/// Largest allowed slope correction in one step of the plant, rad: a larger correction may lead to another branch.
const LONGEST_JUMP: f64 = 0.05;
/// Largest allowed slope correction while internal viscosity holds the shape back, rad.
const LONGEST_CREEP: f64 = 0.5;

/// Elastic constants and unloaded shape of the strip.
#[derive(Clone, Debug)]
pub struct Strip {
    length: f64,
    bending: f64,
    /// Axial strain for a unit of force, EI/(EA L²).
    stretch: f64,
    /// Legendre coefficients of the unloaded curvature times L, in the order of [`MODE`].
    natural: Column,
    /// Units of the wrench in SI: EI/L², EI/L², EI/L.
    scale: [f64; 3],
}

/// An equilibrium and its linearisation.
#[derive(Clone, Debug)]
pub struct Equilibrium {
    /// End of the strip in the root frame.
    end: [f64; 3],
    unknowns: Column,
    moment: f64,
    /// Derivatives of the unknowns with respect to the end.
    sensitivity: [Column; 3],
    /// Derivative of the wrench with respect to the end.
    stiffness: [[f64; 3]; 3],
    /// Power dissipated by a unit internal viscosity, as a quadratic form of the end's rate.
    viscosity: [[f64; 3]; 3],
    factor: Factor,
    /// Derivatives of ∂U/∂a₀ with respect to the unknowns.
    coupling: Column,
}

/// End and unknowns of an equilibrium.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    end: [f64; 3],
    unknowns: Column,
}

/// Result of a solution by Newton's method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solved {
    /// Number of factorisations.
    pub iterations: u32,
    /// True if the equilibrium is stable under a held end.
    pub stable: bool,
}

impl Strip {
    /// A strip of `length` (m), bending stiffness EI (N m²) and axial stiffness EA (N), all positive. `natural_slope`
    /// (rad) is the amplitude of a slight waviness of the unloaded strip that leaves its ends aligned; the waviness
    /// decides which way a perfectly straight strip buckles.
    pub fn new(length: f64, bending: f64, axial: f64, natural_slope: f64) -> Self {
        let mut natural = Column::ZERO;
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

    /// Position of the end of an unstretched strip with coefficients `z` and end angle `turn`, in the root frame and in
    /// units of the length.
    fn ends(&self, z: &Column, turn: f64) -> [f64; 2] {
        let p: Points<Narrow> = self.points(z, turn);
        let weights = Twelve::load(&STRAND_WEIGHTS);
        [
            (weights * p.cos).folded().sum(),
            (weights * p.sin).folded().sum(),
        ]
    }

    /// Equilibrium of the unloaded strip.
    pub fn unloaded(&self) -> Equilibrium {
        let [x, y] = self.ends(&self.natural, 0.0);
        let mut equilibrium = Equilibrium {
            end: [x, y, 0.0],
            unknowns: self.natural,
            moment: 0.0,
            sensitivity: [Column::ZERO; 3],
            stiffness: [[0.0; 3]; 3],
            viscosity: [[0.0; 3]; 3],
            factor: Factor::NONE,
            coupling: Column::ZERO,
        };
        self.iterate::<Narrow>(&mut equilibrium, None, LONGEST_JUMP);
        equilibrium
    }

    /// Force error left by two successive corrections: the product of the corrections is a length, which the stiffness
    /// turns into a force.
    #[inline(always)]
    fn remainder(e: &Equilibrium, first: f64, second: f64) -> f64 {
        let k = &e.stiffness;
        0.1 * (k[0][0].abs() + k[1][1].abs()) * first * second
    }

    #[inline(always)]
    fn allowed(e: &Equilibrium) -> f64 {
        TOLERANCE * (1.0 + e.unknowns[MODES].abs() + e.unknowns[MODES + 1].abs())
    }

    /// Newton's method from the coefficients in `e`. `None` if the method does not converge.
    #[inline(always)]
    fn iterate<V: Lanes>(
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
            let first = self.newton::<V>(e, viscous);
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
            let mut z = e.unknowns;
            let (second, moment) = self.polish::<V>(e, &mut z, &e.end, viscous);
            (e.unknowns, e.moment) = (z, moment);
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

    /// Equilibrium at `end` (m, m, rad; root frame), followed from the equilibrium in `e`. `bend` corrects the linear
    /// extrapolation to `end`; it is estimated from [`Self::near`] at half the motion, or zero. `None` if no stable
    /// equilibrium is near; `e` then has the new end, its old unknowns and a changed linearisation.
    #[inline(always)]
    pub fn follow<V: Lanes>(
        &self,
        e: &mut Equilibrium,
        end: [f64; 3],
        bend: &Column,
    ) -> Option<Solved> {
        let from = e.unknowns;
        let end = self.scaled(end);
        e.unknowns = Column::store(e.ahead::<V>(&end) + bend.load());
        e.end = end;
        match self.iterate::<V>(e, None, LONGEST_JUMP) {
            Some(solved) if solved.stable => Some(solved),
            _ => {
                e.unknowns = from;
                None
            }
        }
    }

    /// Equilibrium at the end already in `e`, held back at the previous shape by internal viscosity: `ratio` is τ/h.
    /// `None`, with only the linearisation of `e` changed, if the solution does not converge or is not stable.
    #[cold]
    #[inline(never)]
    pub fn creep(&self, e: &mut Equilibrium, ratio: f64) -> Option<Solved> {
        let from = e.unknowns;
        let viscous = Viscous { ratio, from: &from };
        match self.iterate::<Narrow>(e, Some(viscous), LONGEST_CREEP) {
            Some(solved) if solved.stable => Some(solved),
            _ => {
                e.unknowns = from;
                None
            }
        }
    }

    /// Restores an earlier equilibrium from its shape.
    #[cold]
    #[inline(never)]
    pub fn restore(&self, e: &mut Equilibrium, shape: Shape) {
        e.end = shape.end;
        e.unknowns = shape.unknowns;
        self.newton::<Narrow>(e, None);
    }

    /// Wrench at an `end` near the end of `e`, found with the factored matrix of `e`, and the difference of the
    /// coefficients from their linear prediction. `None` if `end` is too far.
    #[inline(always)]
    pub fn near<V: Lanes>(&self, e: &Equilibrium, end: [f64; 3]) -> Option<([f64; 3], Column)> {
        let end = self.scaled(end);
        let linear = e.ahead::<V>(&end);
        let mut z = Column::store(linear);
        let (mut last, mut moment) = self.polish::<V>(e, &mut z, &end, None);
        let allowed = Self::allowed(e);
        // The relative error of the factors is about the distance between the two ends.
        let off = (end[0] - e.end[0]).abs() + (end[1] - e.end[1]).abs() + (end[2] - e.end[2]).abs();
        if !(Self::remainder(e, last, last + off) <= allowed) {
            let mut rounds = 0;
            loop {
                let (next, m) = self.polish::<V>(e, &mut z, &end, None);
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
        Some((wrench, Column::store(z.load() - linear)))
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

    /// Wrench (N, N, N m) at an `end` close to the end of `e`, to first order.
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
    /// never negative. V is the tangent stiffness without the part that the load contributes, so
    /// damping proportional to V dissipates energy on any branch.
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
            let bend = e.unknowns[i] - self.natural[i];
            u += 0.5 * BENDING[i / 4][i % 4] * (bend * bend);
        }
        let (fx, fy) = (e.unknowns[MODES], e.unknowns[MODES + 1]);
        for (node, weight) in gauss() {
            let (sin, cos) = libm::sincos(self.angle(e, node));
            let pull = fx * cos + fy * sin;
            u += 0.5 * weight * self.stretch * (pull * pull);
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
        for (node, weight) in gauss() {
            let angle = self.angle(e, part * (1.0 + node) - 1.0);
            let (sin, cos) = libm::sincos(angle);
            let w = weight * (1.0 + self.stretch * (fx * cos + fy * sin));
            x += w * cos;
            y += w * sin;
        }
        let l = part * self.length;
        [x * l, y * l, self.angle(e, 2.0 * part - 1.0)]
    }

    /// Bending moment over EI (1/m) at arc length `s` (m), from the balance of moments: an order of magnitude more
    /// accurate than the curvature series. Equals the strain of a gauge bonded to the unloaded strip, divided by the
    /// half thickness.
    pub fn elastic_curvature(&self, e: &Equilibrium, s: f64) -> f64 {
        let [x, y, _] = self.point(e, s);
        let [fx, fy, _] = self.wrench(e);
        (self.root_moment(e) + fx * y - fy * x) / self.bending
    }

    /// Elastic curvature (1/m) from the curvature series, which is also valid while the strip snaps through.
    pub fn series_curvature(&self, e: &Equilibrium, s: f64) -> f64 {
        let xi = 2.0 * (s / self.length).clamp(0.0, 1.0) - 1.0;
        let mut k = e.end[2];
        for i in 0..MODES {
            k += (e.unknowns[i] - self.natural[i]) * polynomial(MODE[i], xi);
        }
        k / self.length
    }
}

/// Nodes on (−1, 1) and their weights for an integral over unit length.
fn gauss() -> impl Iterator<Item = (f64, f64)> {
    (0..PAIRS).flat_map(|k| [(NODES[k], WEIGHTS[k]), (-NODES[k], WEIGHTS[k])])
}

impl Equilibrium {
    /// Unknowns at a nearby end (units of the strip), to first order.
    #[inline(always)]
    fn ahead<V: Lanes>(&self, end: &[f64; 3]) -> Twelve<V> {
        let mut z = self.unknowns.load();
        for n in 0..3 {
            z = z + self.sensitivity[n].load() * V::splat(end[n] - self.end[n]);
        }
        z
    }

    /// End of the strip (m, m, rad) in the root frame.
    pub fn end(&self, strip: &Strip) -> [f64; 3] {
        [
            self.end[0] * strip.length,
            self.end[1] * strip.length,
            self.end[2],
        ]
    }

    /// End and unknowns, which determine the equilibrium.
    #[inline(always)]
    pub fn shape(&self) -> Shape {
        Shape {
            end: self.end,
            unknowns: self.unknowns,
        }
    }
}
