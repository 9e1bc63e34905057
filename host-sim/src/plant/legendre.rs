//! Tables of the frame's quadrature, computed by the compiler.
//!
//! Gauss–Legendre nodes come in pairs ±ξ, and the slope functions below are even or odd in ξ, so
//! only the positive node of each pair is tabulated: sums over the strip work on the even and the
//! odd part of an integrand, at half the cost.

/// Curvature polynomials, orders 0 to `ORDER − 1`.
pub const ORDER: usize = 9;
/// Gauss–Legendre points along the strip.
pub const POINTS: usize = 12;
/// Pairs of points.
pub const PAIRS: usize = POINTS / 2;

/// Order of the polynomial in each row of the frame's equations: orders whose slope function is
/// even first, each group from the stiffest down, so that a pivot that may vanish comes late.
pub const MODE: [usize; ORDER - 1] = [7, 5, 3, 1, 8, 6, 4, 2];
/// How many of [`MODE`] have an even slope function.
pub const EVEN: usize = 4;
/// How many have an odd one.
pub const ODD: usize = 4;

/// P_n(ξ) and its derivative.
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

/// P_n(ξ).
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

/// Positive nodes.
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

/// Slope functions at the positive nodes, in the order of [`MODE`] (a zero fills the last place).
pub const SLOPES: [[f64; ORDER]; PAIRS] = {
    let mut table = [[0.0; ORDER]; PAIRS];
    let mut k = 0;
    while k < PAIRS {
        let mut i = 0;
        while i < ORDER - 1 {
            table[k][i] = slope(MODE[i], NODES[k]);
            i += 1;
        }
        k += 1;
    }
    table
};

/// Products of slope functions of equal parity: 10 pairs of the even group row by row, 10 of the odd.
pub const EQUAL: [[f64; 20]; PAIRS] = {
    let mut table = [[0.0; 20]; PAIRS];
    let mut k = 0;
    while k < PAIRS {
        let mut n = 0;
        let mut i = 0;
        while i < EVEN + ODD {
            let end = if i < EVEN { EVEN } else { EVEN + ODD };
            let mut j = i;
            while j < end {
                table[k][n] = SLOPES[k][i] * SLOPES[k][j];
                n += 1;
                j += 1;
            }
            i += 1;
        }
        k += 1;
    }
    table
};

/// Products of an even with an odd slope function, row by row.
pub const MIXED: [[f64; 16]; PAIRS] = {
    let mut table = [[0.0; 16]; PAIRS];
    let mut k = 0;
    while k < PAIRS {
        let mut i = 0;
        while i < EVEN {
            let mut j = 0;
            while j < ODD {
                table[k][i * ODD + j] = SLOPES[k][i] * SLOPES[k][EVEN + j];
                j += 1;
            }
            i += 1;
        }
        k += 1;
    }
    table
};

/// Bending stiffness of each row, 1/(2n + 1), on a strip of unit length and stiffness.
pub const BENDING: [f64; ORDER - 1] = {
    let mut table = [0.0; ORDER - 1];
    let mut i = 0;
    while i < ORDER - 1 {
        table[i] = 1.0 / (2 * MODE[i] + 1) as f64;
        i += 1;
    }
    table
};

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
