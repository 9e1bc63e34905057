//! Tables of the frame's quadrature, computed by the compiler.
//!
//! Gauss–Legendre nodes come in pairs ±ξ, and the slope functions below are even or odd in ξ, so
//! only the positive node of each pair is tabulated: sums over the strip work on the even and the
//! odd part of an integrand, at half the cost.

/// A table of `rows` by `columns`, entry by entry.
macro_rules! table {
    ([$rows:expr, $columns:expr], |$i:ident, $j:ident| $entry:expr) => {{
        let mut table = [[0.0; $columns]; $rows];
        let mut $i = 0;
        while $i < $rows {
            let mut $j = 0;
            while $j < $columns {
                table[$i][$j] = $entry;
                $j += 1;
            }
            $i += 1;
        }
        table
    }};
}

/// Number of curvature polynomials: orders 0 to `ORDER − 1`.
pub const ORDER: usize = 9;
/// Number of polynomials with unknown coefficients: all orders except 0, which the turn of the end gives.
pub const MODES: usize = ORDER - 1;
/// Number of Gauss–Legendre points along the strip.
pub const POINTS: usize = 12;
/// Number of pairs of points.
pub const PAIRS: usize = POINTS / 2;

/// Order of the polynomial in each row of the frame's equations: orders whose slope function is
/// even first, each group from the stiffest down, so that a pivot that may vanish comes late.
pub const MODE: [usize; MODES] = [7, 5, 3, 1, 8, 6, 4, 2];
/// Number of entries of [`MODE`] with an even slope function; as many have an odd slope function.
pub const EVEN: usize = 4;

/// Legendre polynomial P_n(ξ) and its derivative.
const fn legendre(n: usize, x: f64) -> (f64, f64) {
    let (mut before, mut p) = (1.0, x);
    if n == 0 {
        return (1.0, 0.0);
    }
    let mut k = 2;
    while k <= n {
        let next = ((2 * k - 1) as f64 * x * p - (k - 1) as f64 * before) / k as f64;
        before = p;
        p = next;
        k += 1;
    }
    (p, n as f64 * (x * p - before) / (x * x - 1.0))
}

/// Legendre polynomial P_n(ξ).
pub const fn polynomial(n: usize, x: f64) -> f64 {
    legendre(n, x).0
}

/// Slope function of order n: ½ ∫ P_n from −1 to ξ, the slope that curvature P_n gives on a strip
/// of unit length. Even in ξ for odd n, odd for even n > 0; n = 0 gives (1 + ξ)/2.
pub const fn slope(n: usize, x: f64) -> f64 {
    if n == 0 {
        return 0.5 * (1.0 + x);
    }
    0.5 * (legendre(n + 1, x).0 - legendre(n - 1, x).0) / (2 * n + 1) as f64
}

/// Positive Gauss–Legendre nodes, falling, and their weights.
const fn gauss() -> ([f64; PAIRS], [f64; PAIRS]) {
    let (mut nodes, mut weights) = ([0.0; PAIRS], [0.0; PAIRS]);
    let step = 1.0 / 256.0;
    let mut found = 0;
    let mut high = 1.0;
    while found < PAIRS {
        let low = high - step;
        if legendre(POINTS, low).0 * legendre(POINTS, high).0 <= 0.0 {
            let mut x = 0.5 * (low + high);
            let mut k = 0;
            while k < 12 {
                let (p, slope) = legendre(POINTS, x);
                x -= p / slope;
                k += 1;
            }
            let slope = legendre(POINTS, x).1;
            nodes[found] = x;
            weights[found] = 2.0 / ((1.0 - x * x) * slope * slope);
            found += 1;
        }
        high = low;
    }
    (nodes, weights)
}

/// Positive Gauss–Legendre nodes, falling.
pub const NODES: [f64; PAIRS] = gauss().0;
/// Weights for an integral over unit length (they sum to ½ over the positive nodes).
pub const WEIGHTS: [f64; PAIRS] = {
    let mut weights = gauss().1;
    let mut k = 0;
    while k < PAIRS {
        weights[k] *= 0.5;
        k += 1;
    }
    weights
};

/// Slope functions at the positive nodes, in the order of [`MODE`].
pub const SLOPES: [[f64; MODES]; PAIRS] = table!([PAIRS, MODES], |k, i| slope(MODE[i], NODES[k]));

/// Twelve values along the strip, in lanes: at the four outermost positive nodes; at the two innermost positive nodes
/// and their mirrors; at the mirrors of the four outermost.
pub type Strand = [[f64; 4]; 3];

/// Number of the positive node in each lane of a [`Strand`], and the sign of the lane's node.
pub const LANES: [[(usize, f64); 4]; 3] = [
    [(0, 1.0), (1, 1.0), (2, 1.0), (3, 1.0)],
    [(4, 1.0), (5, 1.0), (4, -1.0), (5, -1.0)],
    [(0, -1.0), (1, -1.0), (2, -1.0), (3, -1.0)],
];

/// Quadrature weights at the twelve places of a [`Strand`].
pub const STRAND_WEIGHTS: Strand = table!([3, 4], |g, n| WEIGHTS[LANES[g][n].0]);

/// Slope function of order 0, (1 + ξ)/2, at the twelve places of a [`Strand`].
pub const STRAND_RISE: Strand = table!([3, 4], |g, n| {
    let (node, side) = LANES[g][n];
    0.5 * (1.0 + side * NODES[node])
});

/// Slope functions along the first eight values of a [`Strand`], in the order of [`MODE`]; the
/// last four follow by parity.
pub const STRAND_SLOPES: [[[f64; 4]; 2]; MODES] = {
    let mut all = [[[0.0; 4]; 2]; MODES];
    let mut i = 0;
    while i < MODES {
        all[i] = table!([2, 4], |g, n| {
            let (node, side) = LANES[g][n];
            (if i < EVEN { 1.0 } else { side }) * SLOPES[node][i]
        });
        i += 1;
    }
    all
};

/// Products of slope functions at each positive node, in lanes. Rows 0 to 2: products of the even functions with each
/// other, without a fourth row. The last entry of the fourth row replaces the first entry of row 1; its other entries
/// follow by symmetry. Rows 3 to 5: the odd functions, arranged as the even functions. Rows 6 to 9: products of even
/// and odd functions.
pub const PRODUCTS: [[[f64; 4]; 10]; PAIRS] = {
    let mut all = [[[0.0; 4]; 10]; PAIRS];
    let mut k = 0;
    while k < PAIRS {
        let s = &SLOPES[k];
        all[k] = table!([10, 4], |row, n| match row {
            0..3 => s[row] * s[n],
            3..6 => s[EVEN + row - 3] * s[EVEN + n],
            _ => s[row - 6] * s[EVEN + n],
        });
        all[k][1][0] = s[3] * s[3];
        all[k][4][0] = s[EVEN + 3] * s[EVEN + 3];
        k += 1;
    }
    all
};

/// Bending stiffness of each order n of [`MODE`], 1/(2n + 1), on a strip of unit length and stiffness. The first group
/// has even slope functions, the second odd.
pub const BENDING: [[f64; 4]; 2] = table!([2, 4], |g, n| 1.0 / (2 * MODE[4 * g + n] + 1) as f64);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadrature_integrates_monomials_up_to_its_degree() {
        for degree in (0..2 * POINTS).step_by(2) {
            let sum: f64 = (0..PAIRS)
                .map(|k| 2.0 * WEIGHTS[k] * NODES[k].powi(degree as i32))
                .sum();
            assert!((sum - 1.0 / (degree + 1) as f64).abs() < 1e-15, "{degree}");
        }
    }

    #[test]
    fn slope_is_the_integral_of_the_polynomial() {
        for n in 0..ORDER {
            for end in [-0.7, 0.1, 0.9] {
                let steps = 4000;
                let width = (end + 1.0) / steps as f64;
                let sum: f64 = (0..steps)
                    .map(|k| polynomial(n, -1.0 + (k as f64 + 0.5) * width))
                    .sum();
                assert!((0.5 * sum * width - slope(n, end)).abs() < 1e-6);
            }
        }
    }
}
