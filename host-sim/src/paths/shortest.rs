//! Shortest path of bounded curvature, forward and in reverse (Reeds and Shepp, 1990): what the
//! length of a driven path is reported against.
//!
//! All 48 words in the five families CSC, CCC, CCCC, CCSC and CCSCC are tried; each formula holds
//! for one word and is mirrored in time (drive it backwards) and space (swap left and right).

use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// A turn at the curvature bound or a straight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Curvature +1.
    Left,
    /// Curvature 0.
    Straight,
    /// Curvature −1.
    Right,
}

use Turn::{Left as L, Right as R, Straight as S};

/// A path in units of the turning radius: turn and signed length (negative in reverse) of each
/// piece; pieces of length 0 pad it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Path {
    /// The pieces in order.
    pub pieces: [(Turn, f64); 5],
}

impl Path {
    /// Length over all pieces, in turning radii.
    pub fn length(&self) -> f64 {
        self.pieces.iter().map(|(_, length)| length.abs()).sum()
    }
}

/// Angle in [−π, π].
fn wrap(angle: f64) -> f64 {
    let reduced = angle % TAU;
    if reduced < -PI {
        reduced + TAU
    } else if reduced > PI {
        reduced - TAU
    } else {
        reduced
    }
}

fn polar(x: f64, y: f64) -> (f64, f64) {
    (x.hypot(y), y.atan2(x))
}

const ZERO: f64 = 1e-12;

fn not_negative(x: f64) -> bool {
    x >= -ZERO
}

fn not_positive(x: f64) -> bool {
    x <= ZERO
}

type Lengths = Option<[f64; 3]>;

/// L+ S+ L+.
fn lsl(x: f64, y: f64, phi: f64) -> Lengths {
    let (u, t) = polar(x - phi.sin(), y - 1.0 + phi.cos());
    let v = wrap(phi - t);
    (not_negative(t) && not_negative(v)).then_some([t, u, v])
}

/// L+ S+ R+.
fn lsr(x: f64, y: f64, phi: f64) -> Lengths {
    let (distance, angle) = polar(x + phi.sin(), y - 1.0 - phi.cos());
    let square = distance * distance - 4.0;
    if square < 0.0 {
        return None;
    }
    let u = square.sqrt();
    let t = wrap(angle + 2f64.atan2(u));
    let v = wrap(t - phi);
    (not_negative(t) && not_negative(v)).then_some([t, u, v])
}

/// L+ R− L(v).
fn lrl(x: f64, y: f64, phi: f64) -> Lengths {
    let (distance, angle) = polar(x - phi.sin(), y - 1.0 + phi.cos());
    if distance > 4.0 {
        return None;
    }
    let u = -2.0 * (0.25 * distance).asin();
    let t = wrap(angle + 0.5 * u + PI);
    let v = wrap(phi - t + u);
    (not_negative(t) && not_positive(u)).then_some([t, u, v])
}

fn tau_omega(u: f64, v: f64, xi: f64, eta: f64, phi: f64) -> (f64, f64) {
    let delta = wrap(u - v);
    let a = u.sin() - delta.sin();
    let b = u.cos() - delta.cos() - 1.0;
    let t1 = (eta * a - xi * b).atan2(xi * a + eta * b);
    let t2 = 2.0 * (delta.cos() - v.cos() - u.cos()) + 3.0;
    let tau = if t2 < 0.0 { wrap(t1 + PI) } else { wrap(t1) };
    (tau, wrap(tau - u + v - phi))
}

/// L+ R(u) L(−u) R−.
fn lrlr_inner_opposed(x: f64, y: f64, phi: f64) -> Lengths {
    let (xi, eta) = (x + phi.sin(), y - 1.0 - phi.cos());
    let rho = 0.25 * (2.0 + xi.hypot(eta));
    if rho > 1.0 {
        return None;
    }
    let u = rho.acos();
    let (t, v) = tau_omega(u, -u, xi, eta, phi);
    (not_negative(t) && not_positive(v)).then_some([t, u, v])
}

/// L+ R(u) L(u) R+ with u < 0.
fn lrlr_inner_alike(x: f64, y: f64, phi: f64) -> Lengths {
    let (xi, eta) = (x + phi.sin(), y - 1.0 - phi.cos());
    let rho = (20.0 - xi * xi - eta * eta) / 16.0;
    if !(0.0..=1.0).contains(&rho) {
        return None;
    }
    let u = -rho.acos();
    if u < -FRAC_PI_2 {
        return None;
    }
    let (t, v) = tau_omega(u, u, xi, eta, phi);
    (not_negative(t) && not_negative(v)).then_some([t, u, v])
}

/// L+ R(−π/2) S− L−.
fn lrsl(x: f64, y: f64, phi: f64) -> Lengths {
    let (distance, angle) = polar(x - phi.sin(), y - 1.0 + phi.cos());
    if distance < 2.0 {
        return None;
    }
    let r = (distance * distance - 4.0).sqrt();
    let u = 2.0 - r;
    let t = wrap(angle + r.atan2(-2.0));
    let v = wrap(phi - FRAC_PI_2 - t);
    (not_negative(t) && not_positive(u) && not_positive(v)).then_some([t, u, v])
}

/// L+ R(−π/2) S− R−.
fn lrsr(x: f64, y: f64, phi: f64) -> Lengths {
    let (xi, eta) = (x + phi.sin(), y - 1.0 - phi.cos());
    let (distance, t) = polar(-eta, xi);
    if distance < 2.0 {
        return None;
    }
    let u = 2.0 - distance;
    let v = wrap(t + FRAC_PI_2 - phi);
    (not_negative(t) && not_positive(u) && not_positive(v)).then_some([t, u, v])
}

/// L+ R(−π/2) S− L(−π/2) R+.
fn lrslr(x: f64, y: f64, phi: f64) -> Lengths {
    let (xi, eta) = (x + phi.sin(), y - 1.0 - phi.cos());
    let (distance, _) = polar(xi, eta);
    if distance < 2.0 {
        return None;
    }
    let u = 4.0 - (distance * distance - 4.0).sqrt();
    if !not_positive(u) {
        return None;
    }
    let t = wrap(((4.0 - u) * xi - 2.0 * eta).atan2(-2.0 * xi + (u - 4.0) * eta));
    let v = wrap(t - phi);
    (not_negative(t) && not_negative(v)).then_some([t, u, v])
}

/// Map from the three free lengths of a formula to the pieces of its word.
type Fill = fn([f64; 3]) -> [f64; 5];
type Formula = fn(f64, f64, f64) -> Lengths;

/// Formula, its word, how it is filled, and whether the word driven from the end is another one.
const FAMILIES: [(Formula, [Turn; 5], Fill, bool); 8] = [
    (lsl, [L, S, L, S, S], |[t, u, v]| [t, u, v, 0.0, 0.0], false),
    (lsr, [L, S, R, S, S], |[t, u, v]| [t, u, v, 0.0, 0.0], false),
    (lrl, [L, R, L, S, S], |[t, u, v]| [t, u, v, 0.0, 0.0], true),
    (
        lrlr_inner_opposed,
        [L, R, L, R, S],
        |[t, u, v]| [t, u, -u, v, 0.0],
        false,
    ),
    (
        lrlr_inner_alike,
        [L, R, L, R, S],
        |[t, u, v]| [t, u, u, v, 0.0],
        false,
    ),
    (
        lrsl,
        [L, R, S, L, S],
        |[t, u, v]| [t, -FRAC_PI_2, u, v, 0.0],
        true,
    ),
    (
        lrsr,
        [L, R, S, R, S],
        |[t, u, v]| [t, -FRAC_PI_2, u, v, 0.0],
        true,
    ),
    (
        lrslr,
        [L, R, S, L, R],
        |[t, u, v]| [t, -FRAC_PI_2, u, -FRAC_PI_2, v],
        false,
    ),
];

/// Shortest path from the origin (heading 0) to `(x, y, phi)`, lengths in turning radii.
pub fn shortest_unit(x: f64, y: f64, phi: f64) -> Path {
    // Driving the word from its end: the start as seen from the end, headings kept.
    let back = (
        x * phi.cos() + y * phi.sin(),
        x * phi.sin() - y * phi.cos(),
        phi,
    );
    let mut best: Option<Path> = None;
    for (formula, word, fill, has_reversal) in FAMILIES {
        for from_end in [false, true] {
            if from_end && !has_reversal {
                continue;
            }
            let (x, y, phi) = if from_end { back } else { (x, y, phi) };
            for time in [1.0, -1.0] {
                for mirror in [1.0, -1.0] {
                    let Some(lengths) = formula(time * x, mirror * y, time * mirror * phi) else {
                        continue;
                    };
                    let lengths = fill(lengths);
                    let mut pieces = [(S, 0.0); 5];
                    for ((piece, turn), length) in pieces.iter_mut().zip(word).zip(lengths) {
                        let turn = match (turn, mirror < 0.0) {
                            (L, true) => R,
                            (R, true) => L,
                            (turn, _) => turn,
                        };
                        *piece = (turn, time * length);
                    }
                    if from_end {
                        pieces.reverse();
                    }
                    let path = Path { pieces };
                    if best.is_none_or(|best| path.length() < best.length()) {
                        best = Some(path);
                    }
                }
            }
        }
    }
    best.unwrap_or(Path {
        pieces: [(S, f64::NAN); 5],
    })
}

/// Length (m) of the shortest path between two postures `[x, y, phi]` when |curvature| is at most
/// `max_curvature` (1/m).
pub fn length(from: [f64; 3], to: [f64; 3], max_curvature: f64) -> f64 {
    let (s, c) = from[2].sin_cos();
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let x = (c * dx + s * dy) * max_curvature;
    let y = (-s * dx + c * dy) * max_curvature;
    shortest_unit(x, y, wrap(to[2] - from[2])).length() / max_curvature
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Drives a path in small steps.
    fn drive(path: &Path) -> [f64; 3] {
        let mut q = [0.0f64; 3];
        for (turn, length) in path.pieces {
            let kappa = match turn {
                L => 1.0,
                S => 0.0,
                R => -1.0,
            };
            let n = 4000;
            let h = length / n as f64;
            for _ in 0..n {
                let middle = q[2] + 0.5 * h * kappa;
                q[0] += h * middle.cos();
                q[1] += h * middle.sin();
                q[2] += h * kappa;
            }
        }
        q
    }

    properties! { cases 300;
        #[test]
        fn path_ends_at_the_goal(x in -6.0..6.0f64, y in -6.0..6.0f64, phi in -3.1..3.1f64) {
            let q = drive(&shortest_unit(x, y, phi));
            prop_assert!((q[0] - x).abs() < 1e-5 && (q[1] - y).abs() < 1e-5, "{q:?}");
            prop_assert!(wrap(q[2] - phi).abs() < 1e-8);
        }

        /// A distance on postures: symmetric, at least Euclid's and at least the turn at the bound.
        #[test]
        fn length_is_a_distance(
            a in prop::array::uniform3(-3.0..3.0f64),
            b in prop::array::uniform3(-3.0..3.0f64),
            c in prop::array::uniform3(-3.0..3.0f64),
            bound in 0.5..4.0f64,
        ) {
            let ab = length(a, b, bound);
            prop_assert!((ab - length(b, a, bound)).abs() < 1e-8);
            prop_assert!(ab >= (a[0] - b[0]).hypot(a[1] - b[1]) - 1e-9);
            prop_assert!(ab >= wrap(a[2] - b[2]).abs() / bound - 1e-9);
            prop_assert!(ab <= length(a, c, bound) + length(c, b, bound) + 1e-8);
        }

        /// No path of the stated kind beats it: random words of up to five pieces, driven, and the
        /// shortest path to where they end.
        #[test]
        fn nothing_driven_is_shorter(
            turns in prop::array::uniform5(0..3usize),
            lengths in prop::array::uniform5(-2.0..2.0f64),
        ) {
            let mut pieces = [(S, 0.0); 5];
            for k in 0..5 {
                pieces[k] = ([L, S, R][turns[k]], lengths[k]);
            }
            let driven = Path { pieces };
            let [x, y, phi] = drive(&driven);
            prop_assert!(shortest_unit(x, y, wrap(phi)).length() <= driven.length() + 1e-5);
        }
    }

    #[test]
    fn known_lengths() {
        let cases = [
            // Straight, both ways.
            ([3.0, 0.0, 0.0], 3.0),
            ([-2.0, 0.0, 0.0], 2.0),
            // A quarter circle, and half of one.
            ([1.0, 1.0, FRAC_PI_2], FRAC_PI_2),
            ([0.0, 2.0, PI], PI),
            // Turning on the spot: three arcs of 60° each.
            ([0.0, 0.0, PI], PI),
        ];
        for ([x, y, phi], expected) in cases {
            let length = shortest_unit(x, y, phi).length();
            assert!((length - expected).abs() < 1e-9, "{x} {y} {phi}: {length}");
        }
    }

    /// Brute force: the least length over a lattice of three-piece words that ends within reach of
    /// the goal is never below the formula by more than the lattice's resolution, and close above.
    #[test]
    fn agrees_with_a_numeric_search() {
        let goals = [[0.3, 0.5, 0.4], [-0.5, 0.2, 2.0], [0.1, 1.2, -1.0]];
        for [x, y, phi] in goals {
            let formula = shortest_unit(x, y, phi).length();
            let mut best = f64::INFINITY;
            let motions: Vec<(Turn, f64)> = [L, S, R]
                .into_iter()
                .flat_map(|turn| [(turn, 1.0), (turn, -1.0)])
                .collect();
            // Any two pieces, then a third solved in closed form: the rest of the way as a piece
            // of the needed heading change.
            let end = |q: [f64; 3], turn: Turn, s: f64| -> [f64; 3] {
                let k = match turn {
                    L => 1.0,
                    S => 0.0,
                    R => -1.0,
                };
                let chord = if k == 0.0 { s } else { 2.0 * (0.5 * s).sin() };
                let direction = q[2] + 0.5 * k * s;
                [
                    q[0] + chord * direction.cos(),
                    q[1] + chord * direction.sin(),
                    q[2] + k * s,
                ]
            };
            let step = 0.02;
            for &(a, sa) in &motions {
                for i in 0..110 {
                    let qa = end([0.0; 3], a, sa * step * f64::from(i));
                    for &(b, sb) in &motions {
                        for j in 0..110 {
                            let qb = end(qa, b, sb * step * f64::from(j));
                            for (c, k) in [(L, 1.0), (R, -1.0)] {
                                let rest = wrap(phi - qb[2]) * k;
                                let qc = end(qb, c, rest);
                                let miss = (qc[0] - x).hypot(qc[1] - y);
                                let total = step * f64::from(i + j) + rest.abs();
                                if miss < 0.02 && total < best {
                                    best = total;
                                }
                            }
                        }
                    }
                }
            }
            // Words of four and five pieces may be shorter than any of three.
            assert!(formula <= best + 0.06, "{formula} {best}");
            if shortest_unit(x, y, phi)
                .pieces
                .iter()
                .filter(|(_, length)| length.abs() > 1e-9)
                .count()
                <= 3
            {
                assert!(best <= formula + 0.06, "{formula} {best}");
            }
        }
    }
}
