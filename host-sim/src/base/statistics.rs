//! Summaries of trials and bounds for consistency tests.
//!
//! All functions take results in the order of their trials, so that no result depends on which thread finished first.

use core_algos::fusion::Estimate;
use serde::{Deserialize, Serialize};

/// Expected mean of the beam's normalised innovation squared (NIS). The mean is below the three degrees of freedom,
/// because the beam board reports the covariance of the worst posture.
pub const NIS_EXPECTED: &str = "0.1 to 0.5";

/// Mean, spread and mean magnitude of a sample; NaN where the sample is too small.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Arithmetic mean.
    pub mean: f64,
    /// Standard deviation, n − 1 in the denominator.
    pub sd: f64,
    /// Mean of the magnitudes.
    pub mean_abs: f64,
}

impl Summary {
    /// Summary of `values`.
    pub fn of(values: &[f64]) -> Self {
        Self {
            mean: mean(values),
            sd: standard_deviation(values),
            mean_abs: mean_abs(values),
        }
    }
}

impl Summary {
    /// Summary of angles, rad: circular mean and standard deviation √(−2 ln R) (Mardia and Jupp,
    /// Directional Statistics, 2000, section 2.3).
    pub fn of_angles(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let sin = sum(values.iter().map(|&angle| libm::sin(angle))) / n;
        let cos = sum(values.iter().map(|&angle| libm::cos(angle))) / n;
        let spread = (-2.0 * libm::log(libm::hypot(sin, cos).min(1.0))).sqrt();
        Self {
            mean: libm::atan2(sin, cos),
            // Factor for n − 1 in the denominator: for small angles the sample standard deviation.
            sd: if values.len() < 2 {
                f64::NAN
            } else {
                spread * (n / (n - 1.0)).sqrt()
            },
            mean_abs: mean_abs(values),
        }
    }
}

/// Compensated sum (Neumaier): accurate to about the last bit, whatever the magnitudes of the terms.
pub fn sum(values: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sum, mut lost) = (0.0f64, 0.0f64);
    for value in values {
        let next = sum + value;
        lost += if sum.abs() >= value.abs() {
            (sum - next) + value
        } else {
            (value - next) + sum
        };
        sum = next;
    }
    // After an overflow `lost` may be NaN.
    if sum.is_finite() { sum + lost } else { sum }
}

/// Arithmetic mean; NaN for no values.
pub fn mean(values: &[f64]) -> f64 {
    sum(values.iter().copied()) / values.len() as f64
}

/// Mean of the magnitudes; NaN for no values.
pub fn mean_abs(values: &[f64]) -> f64 {
    sum(values.iter().map(|value| value.abs())) / values.len() as f64
}

/// Standard deviation with n − 1 in the denominator; NaN for less than two values.
pub fn standard_deviation(values: &[f64]) -> f64 {
    if values.len() < 2 {
        return f64::NAN;
    }
    let mean = mean(values);
    let square = sum(values.iter().map(|value| (value - mean) * (value - mean)));
    (square / (values.len() - 1) as f64).sqrt()
}

/// Percentile of the sample, linear between the sorted values: `share` 0 gives the least value, 1 the greatest.
/// NaN for no values; NaN sorts as greatest.
pub fn percentile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else {
        return f64::NAN;
    };
    let place = share.clamp(0.0, 1.0) * last as f64;
    let (low, high) = (place.floor() as usize, place.ceil() as usize);
    let part = place - low as f64;
    if low == high {
        sorted[low]
    } else {
        sorted[low] * (1.0 - part) + sorted[high] * part
    }
}

/// Square, bit-identical on every machine: `powi` does not guarantee the order of its products.
pub fn square(x: f64) -> f64 {
    x * x
}

/// Share of the values for which `holds` is true; NaN for no values.
pub fn share(values: &[f64], holds: impl Fn(f64) -> bool) -> f64 {
    values.iter().filter(|value| holds(**value)).count() as f64 / values.len() as f64
}

/// Regularised lower incomplete gamma function P(a, x), a > 0, x ≥ 0: a series below x = a + 1, a continued fraction
/// above (Abramowitz and Stegun 6.5.29, 6.5.31). Relative error of P below and of 1 − P above: 1e-12 for a ≤ 1e4.
fn gamma_p(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    let factor = libm::exp(a * libm::log(x) - x - libm::lgamma(a));
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > f64::EPSILON * sum {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        return factor * sum;
    }
    // Continued fraction by the modified Lentz method.
    let mut b = x + 1.0 - a;
    let mut d = 1.0 / b;
    let (mut c, mut fraction, mut k) = (f64::MAX, d, 0.0);
    loop {
        k += 1.0;
        let numerator = k * (a - k);
        b += 2.0;
        d = 1.0 / (b + numerator * d);
        c = b + numerator / c;
        fraction *= c * d;
        if (c * d - 1.0).abs() <= 4.0 * f64::EPSILON {
            return 1.0 - factor * fraction;
        }
    }
}

/// Quantile of the χ² distribution with `degrees` degrees of freedom.
///
/// Bisection of the regularised incomplete gamma function. `probability` in (0, 1), `degrees` > 0.
pub fn chi_square_quantile(probability: f64, degrees: f64) -> f64 {
    let below = |x: f64| gamma_p(0.5 * degrees, 0.5 * x) < probability;
    let (mut low, mut high) = (0.0, degrees.max(1.0));
    while below(high) {
        low = high;
        high *= 2.0;
    }
    // The bisection ends at neighbouring floating-point numbers.
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return middle;
        }
        if below(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
}

/// Two-sided band in which the mean of `runs` independent normalised squared errors (NEES or NIS)
/// of `dimension` components lies with `probability` if the estimator is consistent.
pub fn mean_square_band(dimension: usize, runs: usize, probability: f64) -> [f64; 2] {
    let tail = 0.5 * (1.0 - probability);
    let degrees = (dimension * runs) as f64;
    [tail, 1.0 - tail].map(|p| chi_square_quantile(p, degrees) / runs as f64)
}

/// Normalised estimation error squared (NEES), eᵀ P⁻¹ e; infinite if the covariance is not positive definite.
pub fn nees(estimate: &Estimate, truth: [f64; 3]) -> f64 {
    let p = estimate.covariance.map(|row| row.map(f64::from));
    // P = L Lᵀ, then |L⁻¹ e|².
    let mut l = [[0.0; 3]; 3];
    let e = error(estimate, truth);
    let mut y = [0.0; 3];
    for i in 0..3 {
        for j in 0..=i {
            let mut rest = p[i][j];
            for k in 0..j {
                rest -= l[i][k] * l[j][k];
            }
            if i == j {
                if !(rest > 0.0) {
                    return f64::INFINITY;
                }
                l[i][i] = rest.sqrt();
            } else {
                l[i][j] = rest / l[j][j];
            }
        }
        let known: f64 = (0..i).map(|k| l[i][k] * y[k]).sum();
        y[i] = (e[i] - known) / l[i][i];
    }
    y.iter().map(|v| v * v).sum()
}

/// Estimate minus truth; the heading error is wrapped to ±π.
pub fn error(estimate: &Estimate, truth: [f64; 3]) -> [f64; 3] {
    let p = estimate.posture;
    let turn = std::f64::consts::TAU;
    let [x, y, phi] = [p.x, p.y, p.phi].map(f64::from);
    let angle = phi - truth[2];
    [
        x - truth[0],
        y - truth[1],
        angle - turn * (angle / turn).round(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::random::{Stream, generator, normal};
    use proptest::prelude::*;
    use statrs::function::gamma::gamma_lr;

    #[test]
    fn chi_square_matches_printed_tables() {
        // Abramowitz & Stegun, table 26.8 (and R's qchisq for the last three).
        for (probability, degrees, quantile) in [
            (0.95, 1.0, 3.841_46),
            (0.95, 3.0, 7.814_73),
            (0.99, 7.0, 18.475_3),
            (0.025, 3.0, 0.215_795),
            (0.975, 3.0, 9.348_40),
            (0.5, 2.0, 1.386_29),
            (0.005, 10.0, 2.155_86),
            (0.95, 100.0, 124.342),
            (0.025, 600.0, 534.019),
            (0.975, 600.0, 669.769),
        ] {
            let found = chi_square_quantile(probability, degrees);
            assert!(
                (found / quantile - 1.0).abs() < 4e-6,
                "{probability} {degrees}: {found} for {quantile}"
            );
        }
    }

    #[test]
    fn incomplete_gamma_function_matches_statrs() {
        for a in [0.5, 1.0, 1.5, 3.0, 20.0, 300.0, 1e4] {
            for share in [1e-6, 0.1, 0.5, 0.9, 0.99, 1.0, 1.01, 1.1, 1.5, 3.0] {
                let (ours, theirs) = (gamma_p(a, a * share), gamma_lr(a, a * share));
                assert!(
                    (ours - theirs).abs() < 1e-11,
                    "{a} {share}: {ours} {theirs}"
                );
            }
        }
        assert_eq!(gamma_p(2.0, 0.0), 0.0);
    }

    #[test]
    fn mean_square_band_has_the_stated_coverage() {
        let (dimension, runs) = (3, 50);
        let [low, high] = mean_square_band(dimension, runs, 0.9);
        let mut random = generator(1, 2, Stream::Other(3));
        let inside = (0..2000)
            .filter(|_| {
                let squares = (0..dimension * runs).map(|_| normal(&mut random, 1.0).powi(2));
                let mean = squares.sum::<f64>() / runs as f64;
                (low..high).contains(&mean)
            })
            .count();
        assert!((1750..1850).contains(&inside), "{inside}");
    }

    #[test]
    fn statistics_of_small_samples_match_hand_calculation() {
        let values = [-3.0, 1.0, 2.0, 4.0];
        assert_eq!(mean(&values), 1.0);
        assert_eq!(mean_abs(&values), 2.5);
        assert!((standard_deviation(&values) - (26.0f64 / 3.0).sqrt()).abs() < 1e-15);
        assert_eq!(percentile(&values, 0.0), -3.0);
        assert_eq!(percentile(&values, 1.0), 4.0);
        assert_eq!(share(&values, |v| v > 0.0), 0.75);
        assert!(standard_deviation(&[1.0]).is_nan());
        assert!(Summary::of(&[]).mean.is_nan());
        assert!(sum([f64::MAX, f64::MAX]).is_infinite());
    }

    properties! {
        #[test]
        fn sum_is_exact_where_plain_addition_is_not(
            values in prop::collection::vec(-1_000_000i64..1_000_000, 0..200)
        ) {
            let exact: i64 = values.iter().sum();
            // Next to ±1e17 a plain sum loses the low bits.
            let terms = [1e17].into_iter().chain(values.iter().map(|&v| v as f64)).chain([-1e17]);
            prop_assert_eq!(sum(terms), exact as f64);
        }

        #[test]
        fn shift_moves_mean_and_keeps_standard_deviation(
            values in prop::collection::vec(-10.0f64..10.0, 2..50), shift in -1e6f64..1e6
        ) {
            let moved: Vec<f64> = values.iter().map(|v| v + shift).collect();
            let (one, two) = (Summary::of(&values), Summary::of(&moved));
            prop_assert!((two.mean - one.mean - shift).abs() < 1e-9);
            prop_assert!((two.sd - one.sd).abs() < 1e-8);
        }
    }
}
