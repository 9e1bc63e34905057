use super::*;
use crate::fusion::testing::{
    self, Matrix, cholesky, covariance_error, inverse, product, transpose, wrap,
};
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

fn wide(m: &M) -> Wide33 {
    m.map(|row| row.map(|x| TwoFloat::from_sum(x as f32, (x - x as f32 as f64) as f32)))
}

fn exact(m: &Wide33) -> M {
    m.map(|row| row.map(|x| x.high as f64 + x.low as f64))
}

fn extended(posture: [f32; 3], covariance: &M) -> ExtendedEstimate {
    ExtendedEstimate {
        posture: posture.map(TwoFloat::from_f32),
        covariance: wide(covariance),
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

/// One case against `f64`: weight, covariance and position.
fn check(criterion: Criterion, a: &M, b: &M) -> Result<(), TestCaseError> {
    let (ea, eb) = (
        extended([1.0, -2.0, 3.0], a),
        extended([1.1, -2.3, -3.1], b),
    );
    let (a, b) = (exact(&ea.covariance), exact(&eb.covariance));
    let fused = by(criterion).fuse_extended(&ea, &eb).unwrap();
    let omega = match criterion {
        Criterion::Determinant => reference_determinant(&a, &b),
        Criterion::Trace => reference_trace(&a, &b, [1.0, 1.0, 0.2f32 as f64 * 0.2f32 as f64]),
    };
    prop_assert!(
        (fused.omega as f64 - omega).abs() < 5e-6,
        "{} {omega}",
        fused.omega
    );
    let p = fused_covariance(&a, &b, omega);
    let d = covariance_error(&fused.estimate.covariance, &p);
    prop_assert!(d < 1e-5, "{d:e}");
    let gain = product(&a, &inverse(&blend(&a, &b, omega)));
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

    #[test]
    fn never_claims_more_than_either_input_by_its_own_criterion(
        a in covariance(1.5), b in covariance(1.5),
    ) {
        // Any ω gives a consistent estimate, so the best one is at least as good as both ends.
        let fused = by(Criterion::Trace)
            .fuse_extended(&extended([0.0; 3], &a), &extended([0.0; 3], &b))
            .unwrap();
        let cost = |p: &M| p[0][0] + p[1][1] + 0.04 * p[2][2];
        let p = testing::wide(&fused.estimate.covariance);
        prop_assert!(cost(&p) <= cost(&a).min(cost(&b)) * (1.0 + 1e-6));
        // And no direction is better than what both together could know.
        let sum = gap(&inverse(&a).map(|row| row.map(|x| -x)), &inverse(&b));
        let floor = inverse(&sum);
        for i in 0..3 {
            prop_assert!(p[i][i] >= floor[i][i] * (1.0 - 1e-6));
        }
    }
}

#[test]
fn a_dominating_input_is_taken_alone() {
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
fn mirrored_inputs_share_alike() {
    let a = Estimate::with_sigmas(Posture::ORIGIN, [0.1, 0.3, 0.2]);
    let b = Estimate::with_sigmas(Posture::new(0.1, 0.1, 0.0), [0.3, 0.1, 0.2]);
    let fused = by(Criterion::Determinant).fuse(&a, &b).unwrap();
    assert!((fused.omega - 0.5).abs() < 1e-7);
    // P⁻¹ = (100 + 100/9)/2.
    assert!((fused.estimate.covariance[0][0] - 0.018).abs() < 1e-8);
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
    for value in [f32::NAN, f32::INFINITY] {
        let mut bad = good;
        bad.posture.y = value;
        assert!(ci.fuse(&good, &bad).is_none());
        assert!(ci.fuse(&bad, &good).is_none());
    }
    crate::config::refusal_of(Config::default(), |c| c.build())
        .names(&[("heading_length_m", |c| c.heading_length_m = f32::NAN)]);
}

#[test]
fn headings_many_turns_apart_are_the_same_heading() {
    let a = Estimate::with_sigmas(Posture::new(0.0, 0.0, 0.3), [0.1; 3]);
    let turns = 5.0 * core::f64::consts::TAU + 0.3;
    let b = Estimate::with_sigmas(Posture::new(0.0, 0.0, turns as f32), [0.1; 3]);
    let fused = by(Criterion::Determinant).fuse(&a, &b).unwrap();
    assert!((fused.estimate.posture.phi - 0.3).abs() < 2e-6);
}
