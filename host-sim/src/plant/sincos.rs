//! Sine and cosine of all quadrature angles at once.

use super::legendre::POINTS;

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
/// two doublings: no branch and no table, so the loop runs in vector registers. Angles beyond
/// ±3.1 rad (or NaN) go one by one through `libm`. The bits do not depend on the machine.
#[inline(always)]
pub fn sin_cos(angle: &[f64; POINTS]) -> ([f64; POINTS], [f64; POINTS]) {
    let (mut sin, mut cos) = ([0.0; POINTS], [0.0; POINTS]);
    let mut fast = true;
    for k in 0..POINTS {
        fast &= angle[k].abs() <= FAST;
        let x = 0.25 * angle[k];
        let z = x * x;
        let w = z * z;
        let s = x + x * z * ((S[0] + z * S[1]) + w * ((S[2] + z * S[3]) + w * (S[4] + z * S[5])));
        let c = 1.0 - 0.5 * z
            + w * ((C[0] + z * C[1]) + w * ((C[2] + z * C[3]) + w * (C[4] + z * C[5])));
        let (s, c) = (2.0 * s * c, 1.0 - 2.0 * s * s);
        sin[k] = 2.0 * s * c;
        cos[k] = 1.0 - 2.0 * s * s;
    }
    if !fast {
        return far(angle);
    }
    (sin, cos)
}

#[cold]
#[inline(never)]
fn far(angle: &[f64; POINTS]) -> ([f64; POINTS], [f64; POINTS]) {
    (angle.map(libm::sin), angle.map(libm::cos))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_standard_library() {
        for k in 0..100_000 {
            let x = (k as f64 - 5e4) * 1e-4;
            let angle = std::array::from_fn(|i| x * (1.0 - 0.07 * i as f64));
            let (sin, cos) = sin_cos(&angle);
            for i in 0..POINTS {
                assert!((sin[i] - angle[i].sin()).abs() < 2e-15, "{}", angle[i]);
                assert!((cos[i] - angle[i].cos()).abs() < 2e-15, "{}", angle[i]);
            }
        }
    }
}
