use super::super::reference::{Bent, Elastica, Random};
use super::super::strip::{Config, GAUSS_5, PerGauge};
use super::minimum::SUSPICIOUS;
use super::*;
use crate::fusion::testing::{covariance_error, sample_covariance};
use proptest::prelude::*;
use std::vec::Vec;

const LENGTH: f64 = 0.37;

fn solver(at: &[f64], change: impl Fn(&mut Config)) -> Solver {
    let gauges: Vec<f32> = at.iter().map(|f| (LENGTH * f) as f32).collect();
    let mut config = Config {
        gauges_m: PerGauge::new(&gauges).unwrap(),
        uncertainty: crate::beam::strip::Uncertainty::calibrated(),
        ..Config::default()
    };
    change(&mut config);
    Solver::new(config.build().unwrap())
}

fn gauss() -> Vec<f64> {
    GAUSS_5.iter().map(|f| f64::from(*f)).collect()
}

fn uniform(n: usize) -> Vec<f64> {
    (0..n).map(|i| (i as f64 + 0.5) / n as f64).collect()
}

fn ends(n: usize) -> Vec<f64> {
    (0..n)
        .map(|i| 0.02 + 0.96 * i as f64 / (n - 1) as f64)
        .collect()
}

fn curvature(bent: &Bent) -> [f32; MAX_GAUGES] {
    let list = bent.curvature.iter().map(|k| (*k / LENGTH) as f32);
    PerGauge::new(&list.collect::<Vec<_>>()).unwrap().padded()
}

/// A strip with gauges at the Gauss–Legendre nodes, bent and pushed.
fn bent_by(force: [f64; 2]) -> Bent {
    let root_curvature = 2.5;
    let shape = Elastica {
        root_curvature,
        force,
    };
    shape.bent(&gauss())
}

/// (position error m, heading error rad)
fn error(fit: &Fit, bent: &Bent) -> (f64, f64) {
    let p = fit.relative.posture;
    (
        (f64::from(p.x) - LENGTH * bent.end[0]).hypot(f64::from(p.y) - LENGTH * bent.end[1]),
        (f64::from(p.phi) - bent.end[2]).abs(),
    )
}

/// A fit in pieces, each with its bound, ends where the fit at once does; and the next one, of a
/// frame that has moved on a little, starts there and needs no search.
#[test]
fn a_fit_in_pieces_is_the_same_fit_and_its_end_a_good_start() {
    let (at, mut random) = (gauss(), Random(5));
    let solver = solver(&at, |_| {});
    let mask = solver.strip.gauges;
    let mut searched = 0;
    for _ in 0..3000 {
        let shape = Elastica::random(&mut random, 60.0);
        let readings = curvature(&shape.bent(&at));
        let whole = solver.fit(&readings, mask).unwrap();
        let mut search = solver.begin(&readings, mask, (0.0, None), 8).unwrap();
        assert!(search.evaluations <= 6);
        if !search.is_open() {
            let found = solver.finish(&search).unwrap().relative.posture;
            let (a, b) = (found, whole.relative.posture);
            let apart = (a.x - b.x).hypot(a.y - b.y) + (a.phi - b.phi).abs();
            assert!(apart < 1e-4, "{found:?} {whole:?}");
            continue;
        }
        searched += 1;
        while search.is_open() {
            let before = search.evaluations;
            solver.go_on(&mut search, MAX_EVALUATIONS, 5);
            assert!(search.evaluations - before <= 5);
        }
        let found = solver.finish(&search).unwrap();
        assert!(!whole.converged || found.chi_square < whole.chi_square + SUSPICIOUS);
        let Some(start) = search.start().filter(|_| found.converged) else {
            continue;
        };
        let moved = Elastica {
            root_curvature: shape.root_curvature * 1.003,
            ..shape
        };
        let bent = moved.bent(&at);
        let next = solver.begin(&curvature(&bent), mask, (0.0, Some(start)), 8);
        let next = next.unwrap();
        let fit = solver.finish(&next).unwrap();
        assert!(!next.is_open() && fit.evaluations <= 8, "{shape:?}");
        let error = error(&fit, &bent);
        assert!(error.0 < 1e-3 && error.1 < 5e-3, "{error:?}");
    }
    assert!(searched > 10, "{searched}");
}

/// A tick's budget bounds the shapes of an estimate, the refinement among them.
#[test]
fn budget_of_a_tick_bounds_search_and_refinement() {
    let (at, mut random) = (gauss(), Random(8));
    let solver = solver(&at, |_| {});
    let mask = solver.strip.gauges;
    let mut spent = 0;
    for _ in 0..3000 {
        let shape = Elastica::random(&mut random, 60.0);
        let readings = curvature(&shape.bent(&at));
        let near = solver.begin(&readings, mask, (0.0, None), MAX_EVALUATIONS);
        let start = near.and_then(|search| search.best).map(|best| {
            let [middle, fx, fy] = best.parameters;
            Start([middle, 1.1 * fx, fy])
        });
        let search = solver.begin(&readings, mask, (0.0, start), 5).unwrap();
        assert!(search.evaluations <= 3, "{shape:?}");
        if search.evaluations == 3 {
            spent += 1;
            assert!(solver.finish(&search).unwrap().evaluations <= 4);
        }
    }
    assert!(spent > 100, "{spent}");
}

/// Worst position error (m) and heading error (rad) over `count` shapes; with `lose`, one
/// gauge after the other is missing.
fn worst(at: &[f64], load: f64, lose: bool, count: usize) -> (f64, f64) {
    let mut random = Random(3);
    let solver = solver(at, |_| {});
    let mut worst = (0.0f64, 0.0f64);
    for i in 0..count {
        let bent = Elastica::random(&mut random, load).bent(at);
        let mut readings = curvature(&bent);
        let mut mask = solver.strip.gauges;
        if lose {
            mask = mask.without(i % at.len());
            readings[i % at.len()] = 1e3;
        }
        let fit = solver.fit(&readings, mask).unwrap();
        assert!(fit.converged);
        let (m, rad) = error(&fit, &bent);
        worst = (worst.0.max(m), worst.1.max(rad));
    }
    println!("{} gauges, load {load}, lost {lose}: {worst:?}", at.len());
    worst
}

/// Loads up to twice the first buckling load of a clamped strip.
#[test]
fn exact_shapes_are_found_for_any_placement() {
    for at in [
        gauss(),
        uniform(4),
        uniform(5),
        uniform(6),
        uniform(8),
        ends(5),
        ends(8),
    ] {
        let (m, rad) = worst(&at, 85.0, false, 200);
        assert!(m < 2e-5 && rad < 5e-5, "{at:?} {m:e} {rad:e}");
    }
}

#[test]
fn exact_shapes_are_found_with_a_gauge_lost() {
    for at in [gauss(), uniform(5), uniform(6), uniform(8), ends(5)] {
        let (m, rad) = worst(&at, 45.0, true, 200);
        assert!(m < 2e-5 && rad < 1e-4, "{at:?} {m:e} {rad:e}");
    }
}

#[test]
fn wrench_is_that_of_the_shape_and_in_balance() {
    let mut random = Random(5);
    let at = gauss();
    let (root, tip) = (0.02, 0.03);
    let solver = solver(&at, |c| {
        c.rigid_root_m = root as f32;
        c.rigid_tip_m = tip as f32;
    });
    let (force_unit, moment_unit) = (0.833 / (LENGTH * LENGTH), 0.833 / LENGTH);
    for _ in 0..200 {
        let shape = Elastica::random(&mut random, 60.0);
        let bent = shape.bent(&at);
        let fit = solver.fit(&curvature(&bent), solver.strip.gauges);
        let wrench = fit.unwrap().wrench;
        let [fx, fy] = shape.force.map(|f| f * force_unit);
        // The rigid ends are levers for the force at the clamps.
        let root_moment = moment_unit * shape.root_curvature + root * fy;
        let (s, c) = bent.end[2].sin_cos();
        let tip_moment = moment_unit * bent.end_curvature + tip * (fx * s - fy * c);
        for (found, expected, unit) in [
            (wrench.fx, fx, force_unit),
            (wrench.fy, fy, force_unit),
            (wrench.root_moment, root_moment, moment_unit),
            (wrench.tip_moment, tip_moment, moment_unit),
        ] {
            let error = (f64::from(found) - expected).abs();
            assert!(error < 2e-3 * (10.0 * unit + expected.abs()), "{shape:?}");
        }
    }
}

#[test]
fn bending_left_by_moments_pushes_nothing() {
    let solver = solver(&gauss(), |_| {});
    let fit = solver.fit(&[2.0; MAX_GAUGES], solver.strip.gauges).unwrap();
    let phi = 2.0 * LENGTH;
    let p = fit.relative.posture;
    assert!((f64::from(p.phi) - phi).abs() < 1e-6);
    assert!((f64::from(p.x) - phi.sin() / 2.0).abs() < 1e-6);
    assert!((f64::from(p.y) - (1.0 - phi.cos()) / 2.0).abs() < 1e-6);
    assert!(fit.wrench.fx.abs() < 1e-3 && fit.wrench.fy.abs() < 1e-3);
    assert!((fit.wrench.root_moment - 1.666).abs() < 1e-4);
    assert!((fit.wrench.tip_moment - 1.666).abs() < 1e-4);
}

/// Spread of the fit under the errors its covariance claims, and of its residual.
#[test]
fn covariance_and_residual_match_monte_carlo() {
    let solver = solver(&gauss(), |c| {
        c.rigid_tip_m = 0.04;
        c.rigid_root_m = 0.03;
        let u = &mut c.uncertainty;
        u.noise_strain = 3e-6;
        u.offset_strain = 4e-6;
        u.common_offset_strain = 4e-6;
        u.common_gain = 4e-3;
        u.position_m = 1e-6;
        u.heading_rad = 1e-6;
    });
    // A bend with enough shape to tell all three parameters.
    let truth = curvature(&bent_by([-9.0, 5.0]));
    let mut random = Random(11);
    let n = 3000;
    let (mut postures, mut wrenches) = (Vec::new(), Vec::new());
    let mut chi_square = 0.0;
    for _ in 0..n {
        let offset = 4e-6 / 0.5e-3 * random.normal();
        let gain = 4e-3 * random.normal();
        let readings = truth.map(|k| {
            let own = (3e-6f64.hypot(4e-6)) / 0.5e-3 * random.normal();
            let k = f64::from(k);
            (k * (1.0 + gain + 3e-3 * random.normal()) + offset + own) as f32
        });
        let fit = solver.fit(&readings, solver.strip.gauges).unwrap();
        chi_square += f64::from(fit.chi_square) / f64::from(n);
        let p = fit.relative.posture;
        let w = fit.wrench;
        postures.push([p.x, p.y, p.phi].map(f64::from));
        wrenches.push([w.fx, w.fy, w.root_moment].map(f64::from));
    }
    let fit = solver.fit(&truth, solver.strip.gauges).unwrap();
    assert!((chi_square / f64::from(fit.degrees_of_freedom) - 1.0).abs() < 0.1);
    for (samples, found) in [
        (postures, fit.relative.covariance),
        (wrenches, fit.wrench.covariance),
    ] {
        let error = covariance_error(&found, &sample_covariance(&samples));
        assert!(error < 0.12, "{error}");
    }
}

#[test]
fn force_of_a_straight_strip_stays_near_zero_under_noise() {
    let solver = solver(&gauss(), |_| {});
    let mut random = Random(2);
    for _ in 0..500 {
        let noise: [f32; MAX_GAUGES] =
            core::array::from_fn(|_| (1.4e-6 / 0.5e-3 * random.normal()) as f32);
        let wrench = solver.fit(&noise, solver.strip.gauges).unwrap().wrench;
        let sigma = wrench.covariance[0][0].sqrt();
        assert!(wrench.fx.abs() < 40f32.min(2.0 * sigma), "{wrench:?}");
        assert!(wrench.fy.abs() < 1.0);
    }
}

/// Zeros that have walked make a straight strip look buckled. Told so, the fit vouches for no force;
/// not told, it finds some that are large.
#[test]
fn walked_zeros_of_a_straight_strip_are_no_force() {
    let solver = solver(&gauss(), |_| {});
    let all = solver.strip.gauges;
    let mut random = Random(7);
    let (mut trusting, mut told) = (0, 0);
    for _ in 0..400 {
        let zeros: [f32; MAX_GAUGES] =
            core::array::from_fn(|_| (4e-6 / 0.5e-3 * random.normal()) as f32);
        let large = |wrench: Wrench| usize::from(wrench.fx.hypot(wrench.fy) > 25.0);
        trusting += large(solver.fit(&zeros, all).unwrap().wrench);
        let fit = solver
            .fit_within(&zeros, all, 16e-12, MAX_EVALUATIONS)
            .unwrap();
        let vouched = fit.wrench.vouched(fit.relative.posture);
        told += large(vouched);
        // A line through the gauges' readings: about their mean, 0.7 mrad a microstrain.
        assert!(fit.relative.posture.phi.abs() < 0.02);
    }
    assert!(trusting > 40 && told == 0, "{trusting} {told}");
}

/// A strip that is bent tells its force even by zeros that have walked, and stays in balance.
#[test]
fn the_force_of_a_bent_strip_is_vouched_for() {
    let solver = solver(&gauss(), |_| {});
    let mut random = Random(8);
    let unit = 0.833 / (LENGTH * LENGTH);
    let (mut square, mut claimed) = (0.0, 0.0);
    for _ in 0..400 {
        // 40 N push the axles apart or together.
        let sign = random.normal().signum();
        let bent = bent_by([sign * 40.0 / unit, 0.5 * random.normal()]);
        let readings = curvature(&bent).map(|k| {
            let own = 1.4e-6f64.hypot(4e-6) / 0.5e-3 * random.normal();
            let gain = 3e-3 * random.normal();
            (f64::from(k) * (1.0 + gain) + own) as f32
        });
        let fit = solver
            .fit_within(&readings, solver.strip.gauges, 16e-12, MAX_EVALUATIONS)
            .unwrap();
        let error = f64::from(fit.wrench.fx) - sign * 40.0;
        square += error * error / 400.0;
        claimed += f64::from(fit.wrench.covariance[0][0]) / 400.0;
        let p = fit.relative.posture;
        let w = fit.wrench.vouched(p);
        assert!((f64::from(w.fx) - sign * 40.0).abs() < 12.0, "{w:?}");
        let balance = w.root_moment + w.fx * p.y - w.fy * p.x - w.tip_moment;
        assert!(balance.abs() < 1e-4, "{w:?}");
    }
    assert!((square / claimed).sqrt() < 1.3, "{square} {claimed}");
}

/// The walk of the zeros counts in the wrench's covariance, and not in the posture's.
#[test]
fn walked_zeros_leave_the_covariance_of_the_posture() {
    let solver = solver(&gauss(), |c| {
        (c.uncertainty.position_m, c.uncertainty.heading_rad) = (1e-6, 1e-6);
        c.uncertainty.common_offset_strain = 0.0;
        (c.uncertainty.gain, c.uncertainty.common_gain) = (0.0, 0.0);
    });
    let readings = curvature(&bent_by([-9.0, 5.0]));
    let fit = |drift| {
        let all = solver.strip.gauges;
        solver
            .fit_within(&readings, all, drift, MAX_EVALUATIONS)
            .unwrap()
    };
    let (fresh, walked) = (fit(0.0), fit(25e-12));
    // 1 µε of noise and zero each, and 5 µε of walk.
    let ratio = walked.wrench.covariance[0][0] / fresh.wrench.covariance[0][0];
    assert!((ratio / 13.5 - 1.0).abs() < 0.1, "{ratio}");
    for i in 0..3 {
        let ratio = walked.relative.covariance[i][i] / fresh.relative.covariance[i][i];
        assert!((0.9..1.1).contains(&ratio), "{i}: {ratio}");
    }
}

fn reading() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -20.0f32..20.0,
        1 => -140.0f32..140.0,
        1 => proptest::num::f32::ANY,
    ]
}

properties! {
    #[test]
    fn any_readings_give_a_sound_fit_or_none(
        readings in proptest::array::uniform8(reading()),
        bits in proptest::num::u8::ANY,
        count in 2usize..=8,
    ) {
        let solver = solver(&uniform(count), |_| {});
        if let Some(fit) = solver.fit(&readings, GaugeMask(bits)) {
            prop_assert!(fit.relative.is_sound() && fit.wrench.is_finite());
            prop_assert!(fit.chi_square >= 0.0 && fit.degrees_of_freedom >= 0.0);
            prop_assert!(fit.evaluations <= MAX_EVALUATIONS);
        }
    }
}
