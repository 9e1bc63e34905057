use super::*;
use crate::fusion::testing::{
    self, Matrix, cholesky, covariance_error, inverse, product, transpose, wrap,
};
use crate::math::matrix;
use proptest::prelude::*;

type M = Matrix<3, 3>;

fn blend(a: &M, b: &M, omega: f64) -> M {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| omega * b[i][j] + (1.0 - omega) * a[i][j]))
}

fn fused_covariance(a: &M, b: &M, omega: f64) -> M {
    product(&product(a, &inverse(&blend(a, b, omega))), b)
}

/// The zero of an increasing function on [0, 1], or the nearer end.
fn bisect(slope: impl Fn(f64) -> f64) -> f64 {
    if slope(0.0) >= 0.0 {
        return 0.0;
    }
    if slope(1.0) <= 0.0 {
        return 1.0;
    }
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if slope(middle) < 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

fn gap(a: &M, b: &M) -> M {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| b[i][j] - a[i][j]))
}

/// −d(log det S)/dω = −tr(S⁻¹ (B − A)).
fn reference_determinant(a: &M, b: &M) -> f64 {
    let gap = gap(a, b);
    bisect(|omega| {
        let m = product(&inverse(&blend(a, b, omega)), &gap);
        -(m[0][0] + m[1][1] + m[2][2])
    })
}

/// d tr(W P)/dω with dP/dω = −P (A⁻¹ − B⁻¹) P.
fn reference_trace(a: &M, b: &M, w: [f64; 3]) -> f64 {
    let gain = gap(&inverse(b), &inverse(a));
    bisect(|omega| {
        let p = fused_covariance(a, b, omega);
        let m = product(&product(&p, &gain), &p);
        -(0..3).map(|k| w[k] * m[k][k]).sum::<f64>()
    })
}

fn rotation(yaw: f64, pitch: f64, roll: f64) -> M {
    let ((s, c), (t, d), (u, e)) = (yaw.sin_cos(), pitch.sin_cos(), roll.sin_cos());
    let z = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]];
    let y = [[d, 0.0, t], [0.0, 1.0, 0.0], [-t, 0.0, d]];
    let x = [[1.0, 0.0, 0.0], [0.0, e, -u], [0.0, u, e]];
    product(&product(&z, &y), &x)
}

fn diagonal(d: [f64; 3]) -> M {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| if i == j { d[i] } else { 0.0 }))
}

/// A covariance whose principal standard deviations span up to `decades`.
fn covariance(decades: f64) -> impl Strategy<Value = M> {
    (
        proptest::array::uniform3(-decades..0.0f64),
        proptest::array::uniform3(-3.0..3.0f64),
    )
        .prop_map(|(sizes, angles)| {
            let r = rotation(angles[0], angles[1], angles[2]);
            let d = diagonal(sizes.map(|size| 100.0f64.powf(size)));
            let m = product(&product(&r, &d), &transpose(&r));
            [0, 1, 2].map(|i| [0, 1, 2].map(|j| 0.5 * (m[i][j] + m[j][i])))
        })
}

fn extended(posture: [f32; 3], covariance: &M) -> ExtendedEstimate {
    ExtendedEstimate {
        posture: posture.map(f64::from),
        covariance: *covariance,
    }
}

fn by(criterion: Criterion) -> Intersection {
    Config {
        criterion,
        ..Config::default()
    }
    .build()
    .unwrap()
}

/// Compares weight, covariance and posture of one case with the `f64` reference.
fn check(criterion: Criterion, a: &M, b: &M) -> Result<(), TestCaseError> {
    let (ea, eb) = (
        extended([1.0, -2.0, 3.0], a),
        extended([1.1, -2.3, -3.1], b),
    );
    let omega = match criterion {
        Criterion::Determinant => reference_determinant(a, b),
        Criterion::Trace => reference_trace(a, b, [1.0, 1.0, 0.2f32 as f64 * 0.2f32 as f64]),
    };
    let fused = by(criterion).fuse_extended(&ea, &eb).unwrap();
    prop_assert!(
        (fused.omega as f64 - omega).abs() < 5e-6,
        "{} {omega}",
        fused.omega
    );
    let p = fused_covariance(a, b, omega);
    let d = covariance_error(&fused.estimate.covariance, &p);
    prop_assert!(d < 1e-5, "{d:e}");
    let gain = product(a, &inverse(&blend(a, b, omega)));
    let difference = [
        1.1f32 as f64 - 1.0,
        -2.3f32 as f64 + 2.0,
        -3.1f32 as f64 - 3.0 + core::f64::consts::TAU,
    ];
    let x: [f32; 3] = fused.estimate.posture.into();
    for i in 0..3 {
        let shift: f64 = (0..3)
            .map(|j| (1.0 - omega) * gain[i][j] * difference[j])
            .sum();
        let error = x[i] as f64 - ([1.0, -2.0, 3.0][i] + shift);
        prop_assert!(wrap(error).abs() < 2e-6 * (1.0 + shift.abs()));
    }
    Ok(())
}

properties! {
    #[test]
    fn matches_f64_for_moderate_inputs(a in covariance(1.0), b in covariance(1.0)) {
        check(Criterion::Determinant, &a, &b)?;
        check(Criterion::Trace, &a, &b)?;
    }

    #[test]
    fn matches_f64_for_sigma_ratios_up_to_a_thousand(a in covariance(3.0), b in covariance(3.0)) {
        check(Criterion::Determinant, &a, &b)?;
        check(Criterion::Trace, &a, &b)?;
    }

    /// For every true cross-correlation A^½ K B^½ᵀ with |K| ≤ 1 the claimed covariance is at
    /// least the true one.
    #[test]
    fn consistent_for_any_cross_correlation(
        a in covariance(1.5),
        b in covariance(1.5),
        angles in proptest::array::uniform3(-3.0..3.0f64),
        more in proptest::array::uniform3(-3.0..3.0f64),
        singular in proptest::array::uniform3(-1.0..1.0f64),
        trace in proptest::bool::ANY,
    ) {
        let criterion = if trace { Criterion::Trace } else { Criterion::Determinant };
        let fused = by(criterion)
            .fuse_extended(&extended([0.0; 3], &a), &extended([0.0; 3], &b))
            .unwrap();
        let omega = fused.omega as f64;
        // Gains of a and b in x.
        let s = inverse(&blend(&a, &b, omega));
        let gain_b = product(&a, &s).map(|row| row.map(|g| (1.0 - omega) * g));
        let gain_a = product(&b, &s).map(|row| row.map(|g| omega * g));
        let (u, v) = (rotation(angles[0], angles[1], angles[2]), rotation(more[0], more[1], more[2]));
        let k = product(&product(&u, &diagonal(singular)), &v);
        let cross = product(&product(&cholesky(&a), &k), &transpose(&cholesky(&b)));
        // True error covariance of the fused estimate.
        let part = |g: &M, m: &M, h: &M| product(&product(g, m), &transpose(h));
        let (aa, bb) = (part(&gain_a, &a, &gain_a), part(&gain_b, &b, &gain_b));
        let ab = part(&gain_a, &cross, &gain_b);
        let claimed = fused.estimate.covariance;
        let slack = [0, 1, 2].map(|i| [0, 1, 2].map(|j| {
            let rounding = if i == j { 1e-5 * claimed[i][i] as f64 } else { 0.0 };
            claimed[i][j] as f64 + rounding - (aa[i][j] + bb[i][j] + ab[i][j] + ab[j][i])
        }));
        let pivots = cholesky(&slack);
        prop_assert!((0..3).all(|i| pivots[i][i] >= 0.0), "{pivots:?}");
    }

}

#[test]
fn dominating_input_is_returned_unchanged() {
    let good = Estimate::with_sigmas(Posture::new(1.0, 2.0, 0.5), [0.01, 0.02, 0.005]);
    let bad = Estimate::with_sigmas(Posture::new(1.5, 2.5, 0.7), [0.1, 0.1, 0.1]);
    for criterion in [Criterion::Determinant, Criterion::Trace] {
        let first = by(criterion).fuse(&good, &bad).unwrap();
        assert_eq!(first.omega, 1.0);
        assert_eq!(first.estimate, good);
        let second = by(criterion).fuse(&bad, &good).unwrap();
        assert_eq!(second.omega, 0.0);
        assert_eq!(second.estimate, good);
        let both = by(criterion).fuse(&good, &good).unwrap();
        assert_eq!(both.omega, 0.5);
        assert_eq!(both.estimate, good);
    }
}

#[test]
fn bad_input_is_refused() {
    let good = Estimate::with_sigmas(Posture::ORIGIN, [0.1; 3]);
    let ci = by(Criterion::Determinant);
    for value in [f32::NAN, f32::INFINITY, 0.0, -1.0] {
        let mut bad = good;
        bad.covariance[1][1] = value;
        assert!(ci.fuse(&good, &bad).is_none());
        assert!(ci.fuse(&bad, &good).is_none());
    }
    // An estimate with a posture that is not finite is refused, even if its weight would be 0.
    for (criterion, size) in [Criterion::Determinant, Criterion::Trace]
        .into_iter()
        .flat_map(|criterion| [0.01, 1.0, 100.0].map(|size| (criterion, size)))
    {
        let ci = by(criterion);
        let other = Estimate::new(good.posture, matrix::scale(&good.covariance, size));
        for (k, value) in (0..3).flat_map(|k| [f32::NAN, f32::INFINITY].map(|value| (k, value))) {
            let mut bad: [f32; 3] = good.posture.into();
            bad[k] = value;
            let bad = Estimate::new(Posture::from(bad), good.covariance);
            for (a, b) in [(&other, &bad), (&bad, &other)] {
                assert!(ci.fuse(a, b).is_none());
                let [a, b] = [a, b].map(ExtendedEstimate::from);
                assert!(ci.fuse_extended(&a, &b).is_none());
            }
        }
    }
    crate::config::refusal_of(Config::default(), |c| c.build())
        .names(&[("heading_length_m", |c| c.heading_length_m = f32::NAN)]);
}

#[test]
fn headings_apart_by_whole_turns_are_the_same_heading() {
    let ci = by(Criterion::Determinant);
    for (from, turns) in [(0.3, 5), (-1.2, -7), (3.1, 1), (-3.1, 0), (0.0, 40)] {
        let to = 0.3 + core::f64::consts::TAU * f64::from(turns);
        let [a, b] = [from, to].map(|phi| ExtendedEstimate {
            posture: [0.0, 0.0, phi],
            covariance: diagonal([0.01; 3]),
        });
        let error = difference(&a, &b)[2] - wrap(0.3 - from);
        assert!(error.abs() < 1e-11, "{from} {turns}: {error:e}");
        let halfway = from + 0.5 * wrap(0.3 - from);
        let [narrow_a, narrow_b] = [from, to]
            .map(|phi| Estimate::with_sigmas(Posture::new(0.0, 0.0, phi as f32), [0.1; 3]));
        for fused in [ci.fuse(&narrow_a, &narrow_b), ci.fuse_extended(&a, &b)] {
            let phi = fused.unwrap().estimate.posture.phi;
            assert!(phi.abs() <= core::f32::consts::PI);
            assert!(wrap(f64::from(phi) - halfway).abs() < 2e-5);
        }
    }
}

#[test]
fn upper_triangles_are_not_read() {
    let mut random = testing::Random::new(4);
    for criterion in [Criterion::Determinant, Criterion::Trace] {
        let ci = by(criterion);
        let of = |covariance| Estimate::new(Posture::new(0.1, 0.2, 0.3), covariance);
        let [a, b] = [(); 2].map(|()| testing::random_covariance(&mut random, [0.1; 3], 0.4));
        let [lower_a, lower_b] = [a, b].map(|mut covariance| {
            for (i, j) in [(0, 1), (0, 2), (1, 2)] {
                covariance[i][j] = f32::NAN;
            }
            of(covariance)
        });
        let (a, b) = (of(a), of(b));
        assert_eq!(ci.fuse(&a, &b), ci.fuse(&lower_a, &lower_b));
        let [a, b, lower_a, lower_b] =
            [a, b, lower_a, lower_b].map(|estimate| ExtendedEstimate::from(&estimate));
        assert!(ci.fuse_extended(&a, &b).is_some());
        assert_eq!(
            ci.fuse_extended(&a, &b),
            ci.fuse_extended(&lower_a, &lower_b)
        );
    }
}

/// The best weight of these inputs is 0 or 1, or close to 0 or 1, because the criterion's slope at the end is zero or
/// nearly zero.
#[test]
fn weights_at_or_near_zero_and_one_are_exact() {
    let identity = diagonal([1.0; 3]);
    let trace = Config {
        criterion: Criterion::Trace,
        heading_length_m: 0.5,
    };
    for (intersection, b) in [
        (by(Criterion::Determinant), [0.5, 1.0, 1.5]),
        (by(Criterion::Determinant), [0.5, 1.5, 1.0]),
        (trace.build().unwrap(), [0.5, 0.5, 2.0]),
    ] {
        for step in -20..=20 {
            let change = f64::from(step) * if step % 2 == 0 { 6e-8 } else { 1e-5 };
            let a = diagonal([1.0 + change, 1.0, 1.0]);
            let b = diagonal(b);
            let [a, b] =
                [a, b].map(|m| Estimate::new(Posture::ORIGIN, m.map(|r| r.map(|x| x as f32))));
            let [m, n] = [&a, &b].map(|estimate| testing::wide(&estimate.covariance));
            let best = match intersection.criterion {
                Criterion::Determinant => reference_determinant(&m, &n),
                Criterion::Trace => reference_trace(&m, &n, [1.0, 1.0, 0.25]),
            };
            for (fused, expected) in [
                (intersection.fuse(&a, &b), best),
                (intersection.fuse(&b, &a), 1.0 - best),
            ] {
                let omega = f64::from(fused.unwrap().omega);
                assert!(
                    (omega - expected).abs() < 5e-6,
                    "{step}: {omega} {expected}"
                );
                assert!((0.0..=1.0).contains(&omega), "{step}: {omega}");
            }
        }
        let [a, b] = [identity, diagonal(b)].map(|m| extended([0.0; 3], &m));
        assert_eq!(intersection.fuse_extended(&a, &b).unwrap().omega, 0.0);
        assert!(intersection.fuse_extended(&b, &a).unwrap().omega > 0.999_999);
    }
}

/// Two variances of B are half of A's. The third is a million times A's and hardly counts in the weighted trace.
#[test]
fn small_weight_is_found_to_relative_accuracy() {
    for heading_length_m in [1e-5f32, 1e-4, 1e-3] {
        let config = Config {
            criterion: Criterion::Trace,
            heading_length_m,
        };
        let [a, b] = [[1.0; 3], [0.5, 0.5, 1e6]].map(diagonal);
        let square = f64::from(heading_length_m * heading_length_m);
        let omega = reference_trace(&a, &b, [1.0, 1.0, square]);
        let [wide_a, wide_b] = [&a, &b].map(|m| extended([0.0; 3], m));
        let fused = config
            .build()
            .unwrap()
            .fuse_extended(&wide_a, &wide_b)
            .unwrap();
        assert!(
            (f64::from(fused.omega) / omega - 1.0).abs() < 1e-5,
            "{omega}"
        );
        let p = fused_covariance(&a, &b, omega);
        assert!(covariance_error(&fused.estimate.covariance, &p) < 1e-5);
    }
}

#[test]
fn matrices_that_are_not_positive_definite_have_no_factor() {
    for (k, bad) in (0..3).flat_map(|k| [0.0, -1.0, f64::NAN, f64::INFINITY].map(|bad| (k, bad))) {
        let mut m = diagonal([1.0; 3]);
        assert!(Factor::new(&m).is_some());
        m[k][k] = bad;
        assert!(Factor::new(&m).is_none(), "{k} {bad}");
    }
}

/// Variances from 1e-35 to 1e35.
#[test]
fn variances_of_any_size_are_fused() {
    for size in [1e-35f32, 1.0, 1e35] {
        for criterion in [Criterion::Determinant, Criterion::Trace] {
            let of =
                |d: [f32; 3]| Estimate::new(Posture::ORIGIN, matrix::diagonal(d.map(|d| d * size)));
            let fused = by(criterion).fuse(&of([1.0, 4.0, 1.0]), &of([4.0, 1.0, 1.0]));
            let fused = fused.unwrap();
            assert!((fused.omega - 0.5).abs() < 1e-6);
            let variance = fused.estimate.covariance[0][0] / size;
            assert!((variance - 1.6).abs() < 1e-5, "{size:e}: {variance}");
        }
    }
}
