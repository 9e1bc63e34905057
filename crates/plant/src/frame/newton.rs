//! Newton's method on the frame's equations: the inner loop of the simulation.
//!
//! The code works on four lanes. A [`Column`] holds the unknowns: the coefficients with even slope functions,
//! the coefficients with odd slope functions, the force. A row of the symmetric system has the same three groups of
//! four; its last group holds the columns of the force and, in the two free lanes, two right-hand sides.

use super::super::lanes::{Lanes, Twelve};
use super::super::legendre::{
    BENDING, EVEN, MODES, PRODUCTS, SLOPES, STRAND_RISE, STRAND_SLOPES, STRAND_WEIGHTS,
};
use super::super::sincos::sin_cos;
use super::{Equilibrium, Strip, UNKNOWNS};
use std::ops::{Index, IndexMut};

/// Index of the force along x among the unknowns.
const X: usize = MODES;
/// Index of the force along y among the unknowns.
const Y: usize = MODES + 1;

/// A number for each unknown, in groups of four; the last two numbers are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
pub struct Column(pub [[f64; 4]; 3]);

impl Index<usize> for Column {
    type Output = f64;
    #[inline(always)]
    fn index(&self, i: usize) -> &f64 {
        &self.0[i / 4][i % 4]
    }
}

impl IndexMut<usize> for Column {
    #[inline(always)]
    fn index_mut(&mut self, i: usize) -> &mut f64 {
        &mut self.0[i / 4][i % 4]
    }
}

impl Column {
    /// No change of any unknown.
    pub const ZERO: Self = Self([[0.0; 4]; 3]);

    /// Loads the column into lanes.
    #[inline(always)]
    pub fn load<V: Lanes>(&self) -> Twelve<V> {
        Twelve::load(&self.0)
    }

    /// Column from lanes.
    #[inline(always)]
    pub fn store<V: Lanes>(v: Twelve<V>) -> Self {
        Self(v.store())
    }
}

/// Internal viscosity that holds the shape back while the strip snaps from one branch to another:
/// a departure of the bending strain from `from` meets `ratio` = τ/h times its stiffness.
#[derive(Clone, Copy)]
pub(super) struct Viscous<'a> {
    pub ratio: f64,
    pub from: &'a Column,
}

/// LDLᵀ of the symmetric system: rows right of the diagonal (zero elsewhere), reciprocal pivots.
#[derive(Clone, Debug)]
pub(super) struct Factor {
    row: [Column; UNKNOWNS],
    reciprocal: Column,
    pub negative: u32,
}

impl Factor {
    pub const NONE: Self = Self {
        row: [Column::ZERO; UNKNOWNS],
        reciprocal: Column::ZERO,
        negative: 0,
    };

    /// Solution of the factored system for the right-hand side `r`.
    #[inline(always)]
    fn solve<V: Lanes>(&self, r: Twelve<V>) -> Twelve<V> {
        let mut r = r.0;
        macro_rules! forward {
            ($($k:literal)+) => {
                $({
                    let x = r[$k / 4].spread($k % 4);
                    let next = $k + 1;
                    for c in next / 4..3 {
                        r[c] = r[c] - x * V::load(&self.row[$k].0[c]);
                    }
                })+
            };
        }
        forward!(0 1 2 3 4 5 6 7 8);
        let y = Column::store(Twelve(r) * self.reciprocal.load());
        // Back substitution, from the last unknown to the first. In each row the unknown found last is subtracted last:
        // only its product waits for the unknown.
        let mut x = Column::ZERO;
        macro_rules! backward {
            ($($k:literal)+) => {
                $({
                    let mut v = y[$k];
                    for j in (($k + 1)..UNKNOWNS).rev() {
                        v -= self.row[$k][j] * x[j];
                    }
                    x[$k] = v;
                })+
            };
        }
        backward!(9 8 7 6 5 4 3 2 1 0);
        x.load()
    }
}

/// Integrands along the strip.
pub(super) struct Points<V> {
    pub sin: Twelve<V>,
    pub cos: Twelve<V>,
    /// Force along the strip.
    pub tension: Twelve<V>,
    /// Force across the strip.
    pub shear: Twelve<V>,
    /// Quadrature weight times stretch: length over unstrained length.
    pub length: Twelve<V>,
}

/// Sums of four integrands over the strip.
#[inline(always)]
fn integrals<V: Lanes>(a: Twelve<V>, b: Twelve<V>, c: Twelve<V>, d: Twelve<V>) -> [f64; 4] {
    V::sums([a.folded(), b.folded(), c.folded(), d.folded()]).store()
}

/// Even and odd part of `v` over the node pairs 0 to 3, and over the pairs 4 and 5. The second vector holds the pairs 4
/// and 5 twice, in the odd part with both signs.
#[inline(always)]
fn fold<V: Lanes>(v: Twelve<V>) -> ([V; 2], [V; 2]) {
    let v = v.0;
    let mirror = v[1].halves_swapped();
    ([v[0] + v[2], v[1] + mirror], [v[0] - v[2], v[1] - mirror])
}

/// Root of the sum of squares of the coefficients.
#[inline(always)]
fn norm<V: Lanes>(v: Twelve<V>) -> f64 {
    let v = v.0;
    (v[0] * v[0] + v[1] * v[1]).sum().sqrt()
}

impl Strip {
    #[inline(always)]
    pub(super) fn points<V: Lanes>(&self, z: &Column, turn: f64) -> Points<V> {
        let rise = Twelve::load(&STRAND_RISE) * V::splat(turn);
        // The first and the last group of nodes are mirror images: their slopes are the even part plus and minus the
        // odd part.
        let mid = V::splat(0.5 * turn);
        let (mut even, mut odd, mut inner) = (mid, rise.0[0] - mid, rise.0[1]);
        for i in 0..MODES {
            let z = V::splat(z[i]);
            let outer = z * V::load(&STRAND_SLOPES[i][0]);
            if i < EVEN {
                even = even + outer;
            } else {
                odd = odd + outer;
            }
            inner = inner + z * V::load(&STRAND_SLOPES[i][1]);
        }
        let (sin, cos) = sin_cos(Twelve([even + odd, inner, even - odd]));
        let (fx, fy) = (V::splat(z[X]), V::splat(z[Y]));
        let tension = cos * fx + sin * fy;
        let weight = Twelve::load(&STRAND_WEIGHTS);
        Points {
            sin,
            cos,
            tension,
            shear: cos * fy - sin * fx,
            length: weight + weight * (tension * V::splat(self.stretch)),
        }
    }

    /// Bending part of the gradient of U, even and odd coefficients.
    #[inline(always)]
    fn bending<V: Lanes>(&self, z: &Column, viscous: Option<Viscous>) -> [V; 2] {
        let mut out = [V::splat(0.0); 2];
        for g in 0..2 {
            let stiffness = V::load(&BENDING[g]);
            let z = V::load(&z.0[g]);
            out[g] = stiffness * (z - V::load(&self.natural.0[g]));
            if let Some(Viscous { ratio, from }) = viscous {
                let departure = z - V::load(&from.0[g]);
                out[g] = out[g] + V::splat(ratio) * stiffness * departure;
            }
        }
        out
    }

    /// Applies one Newton correction at `e.unknowns` for `e.end` and leaves the linearisation in `e`. Returns the size
    /// of the change of the coefficients.
    #[inline(always)]
    #[expect(clippy::too_many_lines, reason = "one formula")]
    pub(super) fn newton<V: Lanes>(&self, e: &mut Equilibrium, viscous: Option<Viscous>) -> f64 {
        let p: Points<V> = self.points(&e.unknowns, e.end[2]);
        let rise = Twelve::load(&STRAND_RISE);
        let none = V::splat(0.0);

        // Integrands of the second derivatives (curvature of the load, force columns, axial give) and of the gradient.
        let give = Twelve::load(&STRAND_WEIGHTS) * V::splat(self.stretch);
        let (x, y, across) = (p.length * p.cos, p.length * p.sin, p.length * p.shear);
        let give_across = give * p.shear;
        let g = p.length * p.tension - give_across * p.shear;
        let cx = y - give_across * p.cos;
        let cy = Twelve([none; 3]) - x - give_across * p.sin;
        let axial = give * p.cos;
        let turn = rise * g;
        let [end_x, end_y, c0x, c0y] = integrals(x, y, rise * cx, rise * cy);
        let [give_xx, give_xy, k00, first] =
            integrals(axial * p.cos, axial * p.sin, rise * turn, rise * across);
        let give_yy = self.stretch - give_xx;

        // Integrals of each slope function times four integrands: force along x, force along y, turn of the end,
        // gradient.
        let (cx, cy) = (fold(cx), fold(cy));
        let (turn, across) = (fold(Twelve([none; 3]) - turn), fold(across));
        let outer = (
            V::transposed([cx.0[0], cy.0[0], turn.0[0], across.0[0]]),
            V::transposed([cx.1[0], cy.1[0], turn.1[0], across.1[0]]),
        );
        let inner = (
            V::transposed([cx.0[1], cy.0[1], turn.0[1], across.0[1]]),
            V::transposed([cx.1[1], cy.1[1], turn.1[1], across.1[1]]),
        );
        let even = [
            outer.0[0], outer.0[1], outer.0[2], outer.0[3], inner.0[0], inner.0[1],
        ];
        let odd = [
            outer.1[0], outer.1[1], outer.1[2], outer.1[3], inner.1[0], inner.1[1],
        ];
        let bend: [V; 2] = self.bending(&e.unknowns, viscous);
        let bend = [bend[0].store(), bend[1].store()];
        let last = V::load(&[0.0, 0.0, 0.0, 1.0]);
        let mut side = [V::splat(0.0); MODES];
        for i in 0..MODES {
            let q = if i < EVEN { &even } else { &odd };
            let mut sum = V::splat(0.0) - last * V::splat(bend[i / 4][i % 4]);
            for k in 0..6 {
                sum = sum + q[k] * V::splat(SLOPES[k][i]);
            }
            side[i] = sum;
        }

        // Second derivatives with respect to the coefficients.
        let (ge, go) = fold(g);
        let ge: [V; 6] = [
            ge[0].spread(0),
            ge[0].spread(1),
            ge[0].spread(2),
            ge[0].spread(3),
            ge[1].spread(0),
            ge[1].spread(1),
        ];
        let go: [V; 6] = [
            go[0].spread(0),
            go[0].spread(1),
            go[0].spread(2),
            go[0].spread(3),
            go[1].spread(0),
            go[1].spread(1),
        ];
        let stiff = match viscous {
            Some(v) => V::splat(1.0 + v.ratio),
            None => V::splat(1.0),
        };
        let mut h = [none; 10];
        for n in 0..10 {
            let mut sum = if n < 6 {
                stiff * V::load(&DIAGONAL[n])
            } else {
                none
            };
            for k in 0..6 {
                let g = if n < 6 { ge[k] } else { go[k] };
                sum = sum + g * V::load(&PRODUCTS[k][n]);
            }
            h[n] = sum;
        }
        let mut a: [[V; 3]; UNKNOWNS] = [
            [h[0], h[6], side[0]],
            [h[1], h[7], side[1]],
            [h[2], h[8], side[2]],
            [h[1].spread(0), h[9], side[3]],
            [none, h[3], side[4]],
            [none, h[4], side[5]],
            [none, h[5], side[6]],
            [none, h[4].spread(0), side[7]],
            [
                none,
                none,
                V::load(&[-give_xx, -give_xy, -c0x, end_x - e.end[0]]),
            ],
            [
                none,
                none,
                V::load(&[-give_xy, -give_yy, -c0y, end_y - e.end[1]]),
            ],
        ];
        let [[.., b0, _], [.., b1, _]] = [
            V::transposed([side[0], side[1], side[2], side[3]]),
            V::transposed([side[4], side[5], side[6], side[7]]),
        ];
        let minus = V::splat(-1.0);
        e.coupling = Column::store(Twelve([
            minus * b0,
            minus * b1,
            V::load(&[c0x, c0y, 0.0, 0.0]),
        ]));

        let (columns, wrench) = factor(&mut e.factor, &mut a, &e.coupling);
        let [k_x, k_y, k_turn, change] = wrench.store();
        let [x, y, turn, correction] = columns;
        e.sensitivity = [Column::store(x), Column::store(y), Column::store(turn)];
        let s = &e.sensitivity;
        let (fx, fy) = ([s[0][X], s[1][X], s[2][X]], [s[0][Y], s[1][Y], s[2][Y]]);
        e.stiffness = [
            [fx[0], fx[1], k_x],
            [fx[1], fy[1], k_y],
            [k_x, k_y, 1.0 + k00 + k_turn],
        ];
        e.viscosity = dissipation(&[x, y, turn], [give_xx, give_xy, give_yy], fx, fy);
        e.unknowns = Column::store(e.unknowns.load() + correction);
        e.moment = e.end[2] - first + change;
        norm(correction)
    }

    /// One correction of `z` with the factors in `e`. Returns the size of the correction and the end moment.
    #[inline(always)]
    pub(super) fn polish<V: Lanes>(
        &self,
        e: &Equilibrium,
        z: &mut Column,
        end: &[f64; 3],
        viscous: Option<Viscous>,
    ) -> (f64, f64) {
        let p: Points<V> = self.points(z, end[2]);
        let across = p.length * p.shear;
        let [x, y, first, _] = integrals(
            p.length * p.cos,
            p.length * p.sin,
            Twelve::load(&STRAND_RISE) * across,
            Twelve([V::splat(0.0); 3]),
        );
        let (even, odd) = fold(across);
        let bend: [V; 2] = self.bending(z, viscous);
        let (mut r, none) = ([V::splat(0.0); 2], V::splat(0.0));
        for g in 0..2 {
            let part = if g == 0 { even } else { odd };
            let mut sum = none - bend[g];
            for k in 0..6 {
                sum = sum + part[k / 4].spread(k % 4) * slopes(k, g);
            }
            r[g] = sum;
        }
        let force = V::load(&[x - end[0], y - end[1], 0.0, 0.0]);
        let correction = e.factor.solve(Twelve([r[0], r[1], force]));
        *z = Column::store(z.load() + correction);
        let change = (e.coupling.load() * correction).folded().sum();
        let moment = end[2] - first + change;
        (norm(correction), moment)
    }
}

/// Bending stiffness on the diagonal, arranged as the first rows of [`PRODUCTS`].
const DIAGONAL: [[f64; 4]; 6] = {
    let mut table = [[0.0; 4]; 6];
    let mut g = 0;
    while g < 2 {
        let b = &BENDING[g];
        table[3 * g] = [b[0], 0.0, 0.0, 0.0];
        table[3 * g + 1] = [b[3], b[1], 0.0, 0.0];
        table[3 * g + 2] = [0.0, 0.0, b[2], 0.0];
        g += 1;
    }
    table
};

/// Slope functions at the positive node `k`: even functions if `g` = 0, else odd functions.
#[inline(always)]
fn slopes<V: Lanes>(k: usize, g: usize) -> V {
    let s = &SLOPES[k];
    V::load(&[s[4 * g], s[4 * g + 1], s[4 * g + 2], s[4 * g + 3]])
}

/// Factors the system in `a` and solves it for a unit of each coordinate of the end and for the
/// correction. Returns the four solutions, and the product of `coupling` with each solution.
#[inline(always)]
fn factor<V: Lanes>(
    factor: &mut Factor,
    a: &mut [[V; 3]; UNKNOWNS],
    coupling: &Column,
) -> ([Twelve<V>; 4], V) {
    /// Masks of the lanes right of a diagonal entry.
    const RIGHT: [[f64; 4]; 4] = [
        [0.0, 1.0, 1.0, 1.0],
        [0.0, 0.0, 1.0, 1.0],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 0.0, 0.0],
    ];
    let force = V::load(&[1.0, 1.0, 0.0, 0.0]);
    let sides = V::load(&[0.0, 0.0, 1.0, 1.0]);
    factor.negative = 0;
    let mut scaled = [V::splat(0.0); MODES];
    macro_rules! eliminate {
        ($($k:literal)+) => {
            $({
                let pivot = a[$k][$k / 4].lane($k % 4);
                let inverse = 1.0 / pivot;
                factor.negative += u32::from(pivot < 0.0);
                factor.reciprocal[$k] = inverse;
                let inverse = V::splat(inverse);
                let mut l = [V::splat(0.0); 3];
                for c in $k / 4..3 {
                    l[c] = a[$k][c] * inverse;
                }
                for i in $k + 1..UNKNOWNS {
                    let share = l[i / 4].spread(i % 4);
                    for c in i / 4..3 {
                        a[i][c] = a[i][c] - share * a[$k][c];
                    }
                }
                scaled[$k] = l[2] * sides;
                l[2] = l[2] * force;
                l[$k / 4] = l[$k / 4] * V::load(&RIGHT[$k % 4]);
                factor.row[$k] = Column::store(Twelve(l));
            })+
        };
    }
    eliminate!(0 1 2 3 4 5 6 7);

    let [xx, xy, x_turn, x_rest] = a[X][2].store();
    let [_, yy, y_turn, y_rest] = a[Y][2].store();
    let inverse = 1.0 / xx;
    let share = xy * inverse;
    let rest = yy - share * xy;
    let inverse_rest = 1.0 / rest;
    factor.negative += u32::from(xx < 0.0) + u32::from(rest < 0.0);
    factor.reciprocal[X] = inverse;
    factor.reciprocal[Y] = inverse_rest;
    factor.row[X][Y] = share;
    let share = V::splat(share);
    let x_side = V::load(&[-1.0, 0.0, x_turn, x_rest]);
    let y_side = V::load(&[0.0, -1.0, y_turn, y_rest]);
    let y = (y_side - share * x_side) * V::splat(inverse_rest);
    let x = x_side * V::splat(inverse) - share * y;

    let mut s = [V::splat(0.0); MODES];
    let mut products = V::splat(coupling[X]) * x + V::splat(coupling[Y]) * y;
    macro_rules! substitute {
        ($($k:literal)+) => {
            $({
                let row = &factor.row[$k];
                let mut v = scaled[$k] - V::splat(row[X]) * x - V::splat(row[Y]) * y;
                // The unknown found last is subtracted last: only its product waits for the unknown.
                for j in (($k + 1)..MODES).rev() {
                    v = v - V::splat(row[j]) * s[j];
                }
                products = products + V::splat(coupling[$k]) * v;
                s[$k] = v;
            })+
        };
    }
    substitute!(7 6 5 4 3 2 1 0);
    let even = V::transposed([s[0], s[1], s[2], s[3]]);
    let odd = V::transposed([s[4], s[5], s[6], s[7]]);
    let none = V::splat(0.0);
    let forces = V::transposed([x, y, none, none]);
    (
        [
            Twelve([even[0], odd[0], forces[0]]),
            Twelve([even[1], odd[1], forces[1]]),
            Twelve([even[2], odd[2], forces[2]]),
            Twelve([even[3], odd[3], forces[3]]),
        ],
        products,
    )
}

/// Power dissipated by a unit viscosity of the strip, as a quadratic form of the end's rate.
#[inline(always)]
fn dissipation<V: Lanes>(
    [x, y, turn]: &[Twelve<V>; 3],
    [xx, xy, yy]: [f64; 3],
    fx: [f64; 3],
    fy: [f64; 3],
) -> [[f64; 3]; 3] {
    let none = V::splat(0.0);
    let stiffness = Twelve([V::load(&BENDING[0]), V::load(&BENDING[1]), none]);
    let (wx, wy, wt) = (stiffness * *x, stiffness * *y, stiffness * *turn);
    let mut v = [[0.0; 4]; 2];
    let (a, b) = ((wx * *x).0, (wx * *y).0);
    let (c, d) = ((wx * *turn).0, (wy * *y).0);
    v[0] = V::sums([a[0] + a[1], b[0] + b[1], c[0] + c[1], d[0] + d[1]]).store();
    let (a, b) = ((wy * *turn).0, (wt * *turn).0);
    v[1] = V::sums([a[0] + a[1], b[0] + b[1], none, none]).store();
    // Dissipation by the axial force.
    let (mut ax, mut ay) = ([0.0; 3], [0.0; 3]);
    for n in 0..3 {
        ax[n] = xx * fx[n] + xy * fy[n];
        ay[n] = xy * fx[n] + yy * fy[n];
    }
    let v00 = v[0][0] + (fx[0] * ax[0] + fy[0] * ay[0]);
    let v01 = v[0][1] + (fx[0] * ax[1] + fy[0] * ay[1]);
    let v02 = v[0][2] + (fx[0] * ax[2] + fy[0] * ay[2]);
    let v11 = v[0][3] + (fx[1] * ax[1] + fy[1] * ay[1]);
    let v12 = v[1][0] + (fx[1] * ax[2] + fy[1] * ay[2]);
    let v22 = 1.0 + v[1][1] + (fx[2] * ax[2] + fy[2] * ay[2]);
    [[v00, v01, v02], [v01, v11, v12], [v02, v12, v22]]
}
