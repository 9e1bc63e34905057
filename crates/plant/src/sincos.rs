//! Sine and cosine of all quadrature angles at once.

use super::lanes::{Lanes, Twelve};

const S: [f64; 6] = [
    -1.666_666_666_666_663_2e-1,
    8.333_333_333_322_49e-3,
    -1.984_126_982_985_795e-4,
    2.755_731_370_707_006_8e-6,
    -2.505_076_025_340_686_3e-8,
    1.589_690_995_211_55e-10,
];
const C: [f64; 6] = [
    4.166_666_666_666_66e-2,
    -1.388_888_888_887_411e-3,
    2.480_158_728_947_673e-5,
    -2.755_731_435_139_066_3e-7,
    2.087_572_321_298_175e-9,
    -1.135_964_755_778_819_5e-11,
];

/// Largest angle of the fast path, rad.
const FAST: f64 = 3.1;

/// `(sin, cos)` of each angle, to about 4e-16.
///
/// A quarter of the angle goes through the polynomials of the classic kernels (|x| ≤ π/4), then
/// two doublings: no branch and no table. Angles beyond ±3.1 rad (or NaN) go one by one through
/// `libm`. The bits do not depend on the machine.
#[inline(always)]
pub fn sin_cos<V: Lanes>(angle: Twelve<V>) -> (Twelve<V>, Twelve<V>) {
    let ([a, b, c], [x, y, z]) = (
        angle.0,
        [angle.0[0].abs(), angle.0[1].abs(), angle.0[2].abs()],
    );
    if !(x.all_at_most(FAST) && y.all_at_most(FAST) && z.all_at_most(FAST)) {
        let [sin, cos] = each(&angle.store());
        return (Twelve::load(&sin), Twelve::load(&cos));
    }
    let (a, b, c) = (near(a), near(b), near(c));
    (Twelve([a.0, b.0, c.0]), Twelve([a.1, b.1, c.1]))
}

/// Largest angle of [`directions`] that is reduced here, rad.
const TURNS: f64 = 1e5;
/// 2π in two parts: the first has zeros at its end, so that its multiples up to 2²⁰ are exact.
const WHOLE_TURN: [f64; 2] = [6.283_185_306_936_502_5, 2.430_840_202_602_477e-10];
/// Adding and subtracting this number rounds to the nearest integer.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// `(sin, cos)` of four angles of any size, to about 1e-15 up to 1e5 rad.
#[inline(always)]
pub fn directions<V: Lanes>(angle: V) -> (V, V) {
    if !angle.abs().all_at_most(TURNS) {
        let [sin, cos] = each(&[angle.store()]);
        return (V::load(&sin[0]), V::load(&cos[0]));
    }
    let round = V::splat(ROUND);
    let turns = (angle * V::splat(1.0 / std::f64::consts::TAU) + round) - round;
    near(angle - turns * V::splat(WHOLE_TURN[0]) - turns * V::splat(WHOLE_TURN[1]))
}

#[inline(always)]
fn near<V: Lanes>(angle: V) -> (V, V) {
    let (one, two) = (V::splat(1.0), V::splat(2.0));
    let x = V::splat(0.25) * angle;
    let z = x * x;
    let w = z * z;
    let s = polynomial(&S, z, w);
    let c = polynomial(&C, z, w);
    let (s, c) = (x + x * z * s, one - V::splat(0.5) * z + w * c);
    let (s, c) = (two * s * c, one - two * s * s);
    (two * s * c, one - two * s * s)
}

/// Σ kᵢ zⁱ, w = z².
#[inline(always)]
fn polynomial<V: Lanes>(k: &[f64; 6], z: V, w: V) -> V {
    let (a, b, c) = (
        V::splat(k[0]) + z * V::splat(k[1]),
        V::splat(k[2]) + z * V::splat(k[3]),
        V::splat(k[4]) + z * V::splat(k[5]),
    );
    a + w * (b + w * c)
}

#[cold]
#[inline(never)]
fn each<const N: usize>(angle: &[[f64; 4]; N]) -> [[[f64; 4]; N]; 2] {
    [
        angle.map(|a| a.map(libm::sin)),
        angle.map(|a| a.map(libm::cos)),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::lanes::Narrow;
    use super::*;

    #[test]
    fn sine_and_cosine_agree_with_the_standard_library() {
        for k in 0..100_000 {
            let x = (k as f64 - 5e4) * 1e-4;
            let angle: [[f64; 4]; 3] = std::array::from_fn(|i| {
                std::array::from_fn(|j| x * (1.0 - 0.07 * (4 * i + j) as f64))
            });
            let (sin, cos) = sin_cos(Twelve::<Narrow>::load(&angle));
            for i in 0..12 {
                let a = angle[i / 4][i % 4];
                assert!((sin.0[i / 4].lane(i % 4) - a.sin()).abs() < 2e-15, "{a}");
                assert!((cos.0[i / 4].lane(i % 4) - a.cos()).abs() < 2e-15, "{a}");
            }
        }
    }

    #[test]
    fn directions_agree_with_the_standard_library() {
        let mut largest = 0.0f64;
        for k in 0..400_000 {
            let x = (k as f64 - 2e5) * 1.000_1e-3;
            let angle = [x, 10.0 * x, 700.0 * x, std::f64::consts::PI * (k as f64)];
            let (sin, cos) = directions(Narrow::load(&angle));
            for (i, a) in angle.iter().enumerate() {
                // Up to `TURNS` the error is below 1e-15. Above, the angles go through `libm`.
                let allowed = 1e-15 + 1e-16 * if a.abs() <= TURNS { 0.0 } else { 10.0 };
                let error = (sin.lane(i) - a.sin())
                    .abs()
                    .max((cos.lane(i) - a.cos()).abs());
                assert!(error < allowed, "{a}: {error}");
                largest = largest.max(error);
            }
        }
        assert!(largest > 0.0);
    }

    #[test]
    fn sine_and_cosine_of_nan_and_infinity_are_nan() {
        for i in 0..12 {
            for bad in [f64::NAN, f64::INFINITY, -f64::INFINITY] {
                let mut angle = [[0.3; 4]; 3];
                angle[i / 4][i % 4] = bad;
                let (sin, cos) = sin_cos(Twelve::<Narrow>::load(&angle));
                assert!(sin.0[i / 4].lane(i % 4).is_nan() && cos.0[i / 4].lane(i % 4).is_nan());
                let other = (i + 1) % 12;
                assert!((sin.0[other / 4].lane(other % 4) - 0.3f64.sin()).abs() < 1e-15);
            }
        }
    }
}
