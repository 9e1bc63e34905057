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

/// A bent strip under an end force, with gauges at the Gauss–Legendre nodes.
fn bent_by(force: [f64; 2]) -> Bent {
    let root_curvature = 2.5;
    let shape = Elastica {
        root_curvature,
        force,
    };
    shape.bent(&gauss())
}

/// Position error, m, and heading error, rad, of a fit.
fn error(fit: &Fit, bent: &Bent) -> (f64, f64) {
    let p = fit.relative.posture;
    (
        (f64::from(p.x) - LENGTH * bent.end[0]).hypot(f64::from(p.y) - LENGTH * bent.end[1]),
        (f64::from(p.phi) - bent.end[2]).abs(),
    )
}

/// Other tests draw their random shapes from the domain that this test checks.
#[test]
fn random_shapes_fill_their_domain() {
    let (mut random, mut forces) = (Random(21), Vec::new());
    for _ in 0..2000 {
        let shape = Elastica::random(&mut random, 60.0);
        let bent = shape.bent(&[]);
        assert!(bent.largest_angle < 1.6 && bent.largest_curvature < 8.0);
        assert!(
            bent.largest_angle >= bent.end[2].abs()
                && bent.largest_curvature >= bent.end_curvature.abs()
        );
        forces.push([shape.root_curvature, shape.force[0], shape.force[1]]);
    }
    for (i, (low, high)) in [(-8.0, 8.0), (-60.0, 15.0), (-20.0, 20.0)]
        .into_iter()
        .enumerate()
    {
        let ends = forces.iter().fold([0.0f64; 2], |[a, b], force| {
            [a.min(force[i]), b.max(force[i])]
        });
        assert!(low <= ends[0] && ends[0] < 0.8 * low, "{ends:?}");
        assert!(high >= ends[1] && ends[1] > 0.8 * high, "{ends:?}");
    }
}

/// Curvature of a shape at each of the ascending places `at`, then x, y, direction and curvature at the root and at
/// the tip, in the frame of the middle. Each half is computed as a strip clamped at the middle; the half at the root
/// is mirrored.
fn exact(at: &[f64], [middle, fx, fy]: [f64; 3]) -> Vec<f64> {
    let half = |sign: f64| {
        let shape = Elastica {
            root_curvature: 0.5 * middle,
            force: [0.25 * fx, 0.25 * sign * fy],
        };
        let mut places: Vec<f64> = at.iter().map(|at| sign * (2.0 * at - 1.0)).collect();
        places.retain(|at| *at > 0.0 || (*at == 0.0 && sign > 0.0));
        places.sort_by(f64::total_cmp);
        let bent = shape.bent(&places);
        let [x, y, theta] = bent.end;
        let end = [
            0.5 * sign * x,
            0.5 * y,
            sign * theta,
            2.0 * bent.end_curvature,
        ];
        (bent.curvature, end)
    };
    let ((behind, root), (ahead, tip)) = (half(-1.0), half(1.0));
    let curvatures = behind.iter().rev().chain(&ahead).map(|k| 2.0 * k);
    curvatures.chain(root).chain(tip).collect()
}

/// Derivatives of [`exact`] with respect to each parameter, by central differences.
fn exact_gradient(at: &[f64], parameters: [f64; 3]) -> [Vec<f64>; 3] {
    const STEP: f64 = 1e-4;
    core::array::from_fn(|j| {
        let [low, high] = [-STEP, STEP].map(|step| {
            let mut moved = parameters;
            moved[j] += step;
            exact(at, moved)
        });
        let pairs = high.iter().zip(low);
        pairs
            .map(|(high, low)| (high - low) / (2.0 * STEP))
            .collect()
    })
}

/// Random parameters, exact in `f32`, of shapes from buckled to tensioned.
fn some_parameters(random: &mut Random) -> [f64; 3] {
    [(-6.0, 6.0), (-60.0, 20.0), (-20.0, 20.0)]
        .map(|(low, high)| f64::from(random.between(low, high) as f32))
}

fn assert_near(found: impl IntoIterator<Item = f32>, expected: &[f64], tolerance: f64) {
    for (i, (found, expected)) in found.into_iter().zip(expected).enumerate() {
        let error = (f64::from(found) - expected).abs();
        assert!(
            error <= tolerance * (1.0 + expected.abs()),
            "{i}: {found} {expected}"
        );
    }
}

/// Solution of three equations by Cramer's rule.
fn solved(matrix: [[f64; 3]; 3], right: [f64; 3]) -> [f64; 3] {
    let determinant = |[a, b, c]: [[f64; 3]; 3]| {
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    core::array::from_fn(|j| {
        let mut replaced = matrix;
        for i in 0..3 {
            replaced[i][j] = right[i];
        }
        determinant(replaced) / determinant(matrix)
    })
}

/// Readings of a shape (curvature × length) plus `noise`, with their weights.
fn readings(solver: &Solver, at: &[f64], shape: [f64; 3], noise: impl FnMut() -> f64) -> Readings {
    let mut noise = noise;
    let mut k = [0.0; MAX_GAUGES];
    for (k, exact) in k.iter_mut().zip(exact(at, shape)).take(at.len()) {
        *k = (exact + noise()) as f32;
    }
    Readings {
        k,
        weights: solver.weights(&k, solver.strip.gauges, 0.0),
        drift: 0.0,
        tail: TAIL,
        budget: MAX_EVALUATIONS,
    }
}

#[test]
fn a_shape_and_its_derivatives_are_those_of_the_elastica() {
    let mut random = Random(12);
    for at in [gauss(), uniform(8), ends(4), vec![0.0, 0.3, 1.0]] {
        let solver = solver(&at, |_| {});
        for _ in 0..40 {
            let parameters = some_parameters(&mut random);
            let single = parameters.map(|p| p as f32);
            let shape = solver.shape(single);
            let ends = [shape.root, shape.tip];
            let values = ends.map(|ray| [ray.x, ray.y, ray.theta, ray.curvature(single)]);
            let gauges = shape.curvature[..at.len()].iter().copied();
            assert_near(gauges.chain(values.concat()), &exact(&at, parameters), 3e-5);
            for (j, expected) in exact_gradient(&at, parameters).iter().enumerate() {
                let slopes = ends.map(|ray| {
                    let curvature = ray.curvature_gradient(single)[j];
                    [ray.d_x[j], ray.d_y[j], ray.d_theta[j], curvature]
                });
                let gauges = shape.gradient[..at.len()]
                    .iter()
                    .map(|gradient| gradient[j]);
                assert_near(gauges.chain(slopes.concat()), expected, 1e-4);
            }
        }
    }
}

#[test]
fn a_leg_is_walked_in_the_fewest_steps_of_at_most_a_tenth() {
    for (from, to, count) in [
        (0.0, 1.0, 5),
        (0.0, -1.0, 5),
        (-0.25, -1.0, 4),
        (0.0, 0.1, 1),
        (0.2, 0.62, 3),
        (0.3, 0.3, 0),
        (0.0, 0.2f32.next_up(), 2),
    ] {
        let leg = Leg::new(from, to);
        let length = leg.step * f32::from(leg.count);
        assert!((length - 0.5 * (to - from)).abs() < 1e-7);
        assert_eq!(leg.count, count, "{from} {to}");
        assert!(leg.step.is_finite());
    }
}

/// Reference: half the gradient and half the Hessian of the cost Σ w (k − κ)² + t ln(1 + |f|²/σ²).
#[test]
fn normal_equations_are_those_of_the_cost() {
    let (at, mut random) = (uniform(6), Random(13));
    let solver = solver(&at, |c| c.uncertainty.load_prior = 5.0);
    for _ in 0..40 {
        let parameters = some_parameters(&mut random);
        let other = some_parameters(&mut random);
        let mut readings = readings(&solver, &at, other, || 0.0);
        let drift = 1e-5;
        readings.weights = solver.weights(&readings.k, solver.strip.gauges.without(2), drift);
        let (k, weights) = (readings.k, readings.weights.map(f64::from));
        for i in 0..MAX_GAUGES {
            // 1 µε of noise and 1 µε of offset at 0.5 mm, and 0.3 % of gain.
            let gain = 3e-3 * f64::from(k[i]);
            let variance = 2.0 * (LENGTH * 2e-3).powi(2) + gain * gain + f64::from(drift);
            let expected = if i < 6 && i != 2 { 1.0 / variance } else { 0.0 };
            assert!((weights[i] - expected).abs() <= 1e-4 * expected, "{i}");
        }
        let single = parameters.map(|p| p as f32);
        let normal = solver.normal(&solver.shape(single), single, &readings);
        let (curvature, gradient) = (exact(&at, parameters), exact_gradient(&at, parameters));
        let [_, fx, fy] = parameters;
        let load = fx * fx + fy * fy;
        let prior = f64::from(TAIL) / (25.0 + load);
        let residual = |i: usize| f64::from(k[i]) - curvature[i];
        let weighed =
            |term: &dyn Fn(usize) -> f64| (0..6).map(|i| weights[i] * term(i)).sum::<f64>();
        let chi_square = weighed(&|i| residual(i) * residual(i));
        let cost = chi_square + f64::from(TAIL) * (1.0 + load / 25.0).ln();
        let near = |found: f32, expected: f64, size: f64| {
            assert!(
                (f64::from(found) - expected).abs() < 1e-3 * size,
                "{found} {expected}"
            );
        };
        near(normal.chi_square, chi_square, chi_square);
        near(normal.cost, cost, cost);
        near(normal.prior, prior, prior);
        for r in 0..3 {
            let pull = prior * [0.0, fx, fy][r];
            let size = weighed(&|i| (residual(i) * gradient[r][i]).abs());
            near(
                normal.descent[r],
                weighed(&|i| residual(i) * gradient[r][i]) - pull,
                size,
            );
            for c in 0..3 {
                let own = if r == c && r > 0 { prior } else { 0.0 };
                let size = weighed(&|i| (gradient[r][i] * gradient[c][i]).abs());
                near(
                    normal.hessian[r][c],
                    weighed(&|i| gradient[r][i] * gradient[c][i]) + own,
                    size,
                );
            }
        }
        // With readings of zero weight, only the prior remains.
        let silent = Readings {
            weights: [0.0; MAX_GAUGES],
            ..readings
        };
        let normal = solver.normal(&solver.shape(single), single, &silent);
        assert_near(normal.descent, &[0.0, -prior * fx, -prior * fy], 1e-5);
        assert_near(
            normal.hessian.concat(),
            &[0.0, 0.0, 0.0, 0.0, prior, 0.0, 0.0, 0.0, prior],
            1e-6,
        );
        let expected = f64::from(TAIL) * (1.0 + load / 25.0).ln();
        assert_near([normal.cost, normal.chi_square], &[expected, 0.0], 1e-5);
    }
}

/// With a very weak prior, the start's only error is that of the interpolation between the gauges.
#[test]
fn the_start_of_a_bent_strip_is_near_its_shape() {
    let mut random = Random(14);
    for at in [gauss(), uniform(5), ends(6)] {
        let solver = solver(&at, |c| c.uncertainty.load_prior = 1e3);
        let interpolant = Interpolant::new(&solver.strip, solver.strip.gauges).unwrap();
        for _ in 0..50 {
            let sign = random.normal().signum();
            let shape = [
                sign * random.between(3.0, 5.0),
                random.between(-9.0, 9.0),
                random.between(-9.0, 9.0),
            ];
            let readings = readings(&solver, &at, shape, || 0.0);
            let start = solver.start(&interpolant, &readings.k, &readings.weights);
            for (found, expected) in start.into_iter().zip(shape) {
                assert!(
                    (f64::from(found) - expected).abs() < 0.3,
                    "{start:?} {shape:?}"
                );
            }
        }
    }
}

/// Reference: least squares of a wave at each load, in `f64`, and the three best fits. Equal fits are ordered by
/// load.
#[test]
fn waves_are_the_three_best_small_deflection_fits() {
    let (at, mut random) = (uniform(5), Random(15));
    let solver = solver(&at, |_| {});
    let weights: [f32; MAX_GAUGES] =
        core::array::from_fn(|i| if i < 5 { 1.0 + i as f32 } else { 0.0 });
    let loads = [0.0f64, 5.0, 12.0, 20.0, 30.0, 42.0, 55.0, 70.0, 88.0, 110.0];
    for case in 0..60 {
        let size = [0.0, 3.0, 60.0][case % 3];
        let k: [f32; MAX_GAUGES] = core::array::from_fn(|i| {
            if i < 5 {
                (size * random.normal()) as f32
            } else {
                0.0
            }
        });
        let mut fits: Vec<(f64, [f64; 3])> = loads
            .iter()
            .map(|load| {
                let wave = |i: usize| {
                    let (omega, s) = (load.sqrt(), at[i] - 0.5);
                    let sine = if omega > 0.0 {
                        (omega * s).sin() / omega
                    } else {
                        s
                    };
                    [(omega * s).cos(), sine]
                };
                let sum = |term: &dyn Fn(usize) -> f64| {
                    (0..5).map(|i| f64::from(weights[i]) * term(i)).sum::<f64>()
                };
                let row = |r: usize| {
                    [0, 1].map(|c| {
                        sum(&|i| wave(i)[r] * wave(i)[c]) + if r == c { 1e-3 } else { 0.0 }
                    })
                };
                let right = [0, 1].map(|r| sum(&|i| wave(i)[r] * f64::from(k[i])));
                let matrix = [
                    [row(0)[0], row(0)[1], 0.0],
                    [row(1)[0], row(1)[1], 0.0],
                    [0.0, 0.0, 1.0],
                ];
                let [middle, slope, _] = solved(matrix, [right[0], right[1], 0.0]);
                let residual =
                    |i: usize| f64::from(k[i]) - wave(i)[0] * middle - wave(i)[1] * slope;
                let axial = (load * load - slope * slope).max(0.0).sqrt();
                (
                    sum(&|i| residual(i) * residual(i)),
                    [middle, -axial, -slope],
                )
            })
            .collect();
        fits.sort_by(|a, b| a.0.total_cmp(&b.0));
        let found = solver.waves(&k, &weights);
        for (found, (_, expected)) in found.into_iter().zip(&fits) {
            assert_near(found, expected, 2e-3);
        }
    }
}

#[test]
fn forces_beyond_the_largest_load_keep_their_direction() {
    for (parameters, limited) in [
        ([1.0, 1300.0, -1300.0], [1.0, 1300.0, -1300.0]),
        ([2.0, -2600.0, 130.0], [2.0, -1300.0, 65.0]),
        ([3.0, 130.0, 2600.0], [3.0, 65.0, 1300.0]),
        ([-9e3, 0.0, 0.0], [-9e3, 0.0, 0.0]),
    ] {
        assert_eq!(bounded(parameters), limited);
    }
}

/// Checks a step that computed a shape, in double precision; true if the descent moved.
fn steps_to_a_lower_point(
    solver: &Solver,
    readings: &Readings,
    [before, after]: [&Descent; 2],
    step: [f64; 3],
) -> bool {
    let (from, lowest) = (before.lowest, after.lowest);
    let trial = bounded(core::array::from_fn(|i| {
        (f64::from(from.parameters[i]) + step[i]) as f32
    }));
    let bound = f64::from(from.normal.cost) * (1.0 + 1e-5) + 1e-3;
    if lowest.parameters == from.parameters {
        let cost = f64::from(solver.normal(&solver.shape(trial), trial, readings).cost);
        assert!(!(cost < 0.99 * bound), "{cost} {bound}");
        assert_eq!(after.damping, 10.0 * before.damping + 1e-2);
        assert_eq!(lowest.normal, from.normal);
        return false;
    }
    assert_near(lowest.parameters, &trial.map(f64::from), 2e-2);
    assert!(f64::from(lowest.normal.cost) <= bound * (1.0 + 1e-6));
    let shape = solver.shape(lowest.parameters);
    let normal = solver.normal(&shape, lowest.parameters, readings);
    assert_eq!((lowest.normal, lowest.shape), (normal, shape));
    let less = if before.damping > 1e-3 {
        0.1 * before.damping
    } else {
        0.0
    };
    assert_eq!(after.damping, less);
    true
}

/// Every step of descents from far starts, against the damped normal equations in double precision.
#[test]
fn descent_takes_damped_steps_and_keeps_the_lower_point() {
    let (at, mut random) = (gauss(), Random(16));
    let solver = solver(&at, |_| {});
    let (mut rejected, mut settled, mut left, mut damped) = (0, 0, 0, 0);
    for _ in 0..300 {
        let shape = some_parameters(&mut random);
        let mut noise = Random(random.0);
        let readings = readings(&solver, &at, shape, || 2e-3 * noise.normal());
        let start = some_parameters(&mut random).map(|p| p as f32);
        let mut evaluations = 3;
        let mut descent = solver.start_at(start, &readings, &mut evaluations).unwrap();
        assert_eq!((evaluations, descent.steps, descent.damping), (4, 1, 0.0));
        while !descent.done {
            let (before, count) = (descent, evaluations);
            solver.descend_once(&mut descent, &readings, &mut evaluations);
            if before.steps == 10 {
                let done = true;
                assert_eq!(descent, Descent { done, ..before });
                break;
            }
            assert_eq!(descent.steps, before.steps + 1);
            let from = before.lowest;
            let mut hessian = from.normal.hessian.map(|row| row.map(f64::from));
            for i in 0..3 {
                hessian[i][i] *= 1.0 + f64::from(before.damping);
            }
            let right = from.normal.descent.map(f64::from);
            let step = solved(hessian, right);
            let decrease: f64 = (0..3).map(|i| step[i] * right[i]).sum();
            let near_a_threshold = [1e-2, 4.0]
                .iter()
                .any(|at| (decrease / at - 1.0).abs() < 0.02);
            let leaves = before.damping == 0.0
                && from.parameters[1].abs() <= 12.0
                && decrease < 4.0
                && determines_load(&from.normal);
            if near_a_threshold {
                continue;
            }
            if leaves {
                left += 1;
                assert!(descent.done && descent.lowest.converged && evaluations == count);
                let cost = f64::from(from.normal.cost) - decrease;
                assert!(
                    (f64::from(descent.lowest.normal.cost) - cost).abs() < 1e-2 * (1.0 + decrease)
                );
                assert_eq!(descent.lowest.parameters, from.parameters);
                continue;
            }
            assert_eq!(evaluations, count + 1);
            if steps_to_a_lower_point(&solver, &readings, [&before, &descent], step) {
                damped += usize::from(before.damping > 0.0);
            } else {
                rejected += 1;
            }
            let small = decrease < 1e-2;
            assert_eq!(
                (descent.done, descent.lowest.converged),
                (small, small),
                "{decrease}"
            );
            settled += usize::from(small);
        }
    }
    let counts = [rejected, settled, left, damped];
    assert!(counts.iter().all(|count| *count > 20), "{counts:?}");
}

#[test]
fn a_descent_ends_with_its_budget_and_leaves_a_modest_load_to_the_refinement() {
    let at = gauss();
    let solver = solver(&at, |_| {});
    let begin = |fx: f32| {
        let shape = [5.0, f64::from(fx), 4.0];
        let mut readings = readings(&solver, &at, shape, || 0.0);
        readings.budget = 7;
        let start = shape.map(|p| p as f32);
        (solver.start_at(start, &readings, &mut 6).unwrap(), readings)
    };
    // An axial load is large above three times the prior's scale, which is 4.
    for (fx, evaluations) in [
        (12.0f32, 3),
        (-12.0, 3),
        (12.0f32.next_up(), 4),
        (-12.0f32.next_up(), 4),
    ] {
        let (mut descent, readings) = begin(fx);
        let mut count = 3;
        solver.descend_once(&mut descent, &readings, &mut count);
        assert!(descent.done && descent.lowest.converged);
        assert_eq!(count, evaluations, "{fx}");
    }
    let (begun, readings) = begin(30.0);
    assert!(solver.start_at([0.0; 3], &readings, &mut 7).is_none());
    let mut spent = begun;
    solver.descend_once(&mut spent, &readings, &mut 7);
    assert_eq!(
        spent,
        Descent {
            done: true,
            ..begun
        }
    );
    // With a singular Hessian the damping grows, and no shape is computed.
    let mut flat = begun;
    flat.lowest.normal.hessian = [[0.0; 3]; 3];
    for damping in [1e-3, 10.0 * 1e-3f32 + 1e-3] {
        let before = flat;
        solver.descend_once(&mut flat, &readings, &mut 0);
        let steps = before.steps + 1;
        assert_eq!(
            flat,
            Descent {
                damping,
                steps,
                ..before
            }
        );
    }
}

/// A minimum with the given cost, residual and convergence; the shape does not matter.
fn minimum(cost: f32, chi_square: f32, converged: bool) -> Minimum {
    let solver = solver(&gauss(), |_| {});
    let readings = readings(&solver, &gauss(), [0.0; 3], || 0.0);
    let mut minimum = solver.start_at([0.0; 3], &readings, &mut 0).unwrap().lowest;
    (
        minimum.normal.cost,
        minimum.normal.chi_square,
        minimum.converged,
    ) = (cost, chi_square, converged);
    minimum
}

#[test]
fn lower_minimum_wins_and_the_converged_one_of_two_equal() {
    let beyond = 1.0f32 + 1e-2;
    for (a, b, wins) in [
        ((1.0, true), (0.9, true), true),
        ((1.0, true), (0.995, true), false),
        ((1.0, true), (1.005, true), false),
        ((beyond, true), (beyond - 1e-2, true), false),
        ((1.0, false), (1.005, true), true),
        ((1.0, false), (beyond, true), false),
        ((1.0, false), (beyond.next_down(), true), true),
        ((1.0, false), (1.005, false), false),
        ((1.0, false), (0.995, false), false),
        ((1.0, true), (0.995, false), false),
        ((1.0, true), (0.9, false), true),
    ] {
        let [a, b] = [a, b].map(|(cost, converged)| Some(minimum(cost, 0.0, converged)));
        assert_eq!(lower(a, b), if wins { b } else { a }, "{a:?} {b:?}");
        assert_eq!(
            [lower(a, None), lower(None, b), lower(None, None)],
            [a, b, None]
        );
    }
}

#[test]
fn minimum_is_suspicious_unless_converged_with_a_residual_below_12() {
    for (chi_square, converged, suspicious) in [
        (12.0f32.next_down(), true, false),
        (12.0, true, true),
        (f32::NAN, true, true),
        (0.0, false, true),
        (20.0, false, true),
    ] {
        let minimum = minimum(1.0, chi_square, converged);
        assert_eq!(is_suspicious(Some(&minimum)), suspicious, "{chi_square}");
    }
    assert!(is_suspicious(None));
}

/// Quantiles of χ² with 1 to 5 degrees of freedom at 2.5e-4, from tables.
#[test]
fn residual_below_the_chi_square_quantile_is_exact() {
    for (gauges, limit) in [(4, 1e-7f32), (5, 5e-4), (6, 0.0096), (7, 0.0455), (8, 0.12)] {
        let mask = GaugeMask::first(gauges);
        assert!(
            is_exact(mask, limit.next_down()) && !is_exact(mask, limit),
            "{gauges}"
        );
    }
    for gauges in 0..4 {
        assert!(!is_exact(GaugeMask::first(gauges), 0.0));
    }
}

/// A normal matrix whose inverse and solution are known to the bit.
#[test]
fn load_is_determined_if_the_prior_decides_less_than_a_tenth() {
    let mut normal = minimum(0.0, 0.0, true).normal;
    // The inverse has 0.5 and 0.25 on the diagonal for the forces.
    normal.hessian = [[8.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 4.0]];
    normal.descent = [4.0, -1.0, 8.0];
    assert_eq!(predicted_decrease(&normal), Some(2.0 + 0.5 + 16.0));
    let limit = 0.1f32 / 0.75;
    for (prior, determined) in [(limit * 1.001, false), (limit * 0.999, true), (0.3, false)] {
        normal.prior = prior;
        assert_eq!(
            super::minimum::determines_load(&normal),
            determined,
            "{prior}"
        );
    }
    normal.hessian[2][2] = 2.0;
    for (prior, determined) in [(0.1, false), (0.1f32.next_down(), true)] {
        normal.prior = prior;
        assert_eq!(
            super::minimum::determines_load(&normal),
            determined,
            "{prior}"
        );
    }
    normal.hessian[1][1] = 0.0;
    assert!(!super::minimum::determines_load(&normal) && predicted_decrease(&normal).is_none());
}

/// The prior decides the axial force of a straight strip, both forces under large noise, and no force of a bent
/// strip.
#[test]
fn degrees_of_freedom_include_parameters_decided_by_the_prior() {
    let sure = solver(&gauss(), |_| {});
    let unsure = solver(&gauss(), |c| {
        (c.uncertainty.noise_strain, c.uncertainty.load_prior) = (1e-3, 1e-2);
    });
    let all = sure.strip.gauges;
    let (straight, bent) = ([0.0; MAX_GAUGES], curvature(&bent_by([-9.0, 5.0])));
    for (solver, readings, mask, expected) in [
        (sure, straight, all, 3.0),
        (sure, straight, all.without(4), 2.0),
        (unsure, straight, all, 4.0),
        (sure, bent, all, 2.0),
    ] {
        let found = solver.fit(&readings, mask).unwrap().degrees_of_freedom;
        assert!((found - expected).abs() < 0.02, "{found} {expected}");
    }
}

#[test]
fn a_fit_with_a_number_that_is_not_finite_is_none() {
    let solver = solver(&gauss(), |_| {});
    let readings = readings(&solver, &gauss(), [3.0, -9.0, 5.0], || 0.0);
    let found = solver
        .start_at([3.0, -9.0, 5.0], &readings, &mut 0)
        .unwrap()
        .lowest;
    let result = |solver: &Solver, minimum: &Minimum| {
        solver
            .result(minimum, solver.strip.gauges, &readings, 1)
            .is_some()
    };
    let mut odd = found;
    odd.normal.chi_square = f32::INFINITY;
    let (mut stiff, mut unsure) = (solver, solver);
    stiff.strip.stiffness = f32::MAX;
    unsure.strip.uncertainty.position_m = f32::INFINITY;
    let results = [
        result(&solver, &found),
        result(&solver, &odd),
        result(&stiff, &found),
        result(&unsure, &found),
    ];
    assert_eq!(results, [true, false, false, false]);
}

#[test]
fn a_wrench_is_finite_if_all_its_numbers_are() {
    let finite = Wrench {
        fx: 1.0,
        fy: 1.0,
        root_moment: 1.0,
        tip_moment: 1.0,
        covariance: [[1.0; 3]; 3],
    };
    assert!(finite.is_finite());
    let spoiled: [fn(&mut Wrench); 6] = [
        |w| w.fx = f32::NAN,
        |w| w.fy = f32::INFINITY,
        |w| w.root_moment = f32::NAN,
        |w| w.tip_moment = f32::NEG_INFINITY,
        |w| w.covariance[0][0] = f32::NAN,
        |w| w.covariance[2][1] = f32::INFINITY,
    ];
    for (k, spoil) in spoiled.iter().enumerate() {
        let mut wrench = finite;
        spoil(&mut wrench);
        assert!(!wrench.is_finite(), "{k}");
    }
}

/// The significant part of a force F with variance P is F − 4 P/F.
#[test]
fn significant_force_is_zero_within_two_standard_deviations() {
    let posture = crate::math::Posture::new(0.3, 0.1, 0.5);
    for (force, variance, significant) in [
        (10.0, 9.0, 6.4),
        (-10.0, 9.0, -6.4),
        (6.0, 9.0, 0.0),
        (-5.0, 9.0, 0.0),
        (0.0, 9.0, 0.0),
        (0.0, 0.0, 0.0),
        (3.0, 0.0, 3.0),
    ] {
        let (mut axial, mut lateral) = ([[50.0; 3]; 3], [[50.0; 3]; 3]);
        (axial[0][0], lateral[1][1]) = (variance, variance);
        for (fx, fy, covariance) in [(force, 0.0, axial), (0.0, force, lateral)] {
            let (root_moment, tip_moment) = (0.7, f32::NAN);
            let wrench = Wrench {
                fx,
                fy,
                root_moment,
                tip_moment,
                covariance,
            };
            let found = wrench.significant(posture);
            let (fx, fy) = if fx != 0.0 {
                (significant, 0.0)
            } else {
                (0.0, significant)
            };
            let moment = 0.7 + 0.1 * fx - 0.3 * fy;
            for (found, expected) in [(found.fx, fx), (found.fy, fy), (found.tip_moment, moment)] {
                assert!(
                    (found - expected).abs() < 1e-5,
                    "{force} {variance}: {found} {expected}"
                );
            }
        }
    }
}

/// Four readings determine a shape. Three or two may fit several shapes; so may readings that no strip can give.
#[test]
fn a_search_is_open_as_long_as_a_lower_minimum_may_be_elsewhere() {
    let (at, mut random) = (gauss(), Random(17));
    let solver = solver(&at, |_| {});
    let five = solver.strip.gauges;
    let start = |search: &Search| search.start().map(|Start(parameters)| parameters);
    for _ in 0..40 {
        let shape = [
            random.between(2.0, 5.0),
            random.between(-6.0, 6.0),
            random.between(-6.0, 6.0),
        ];
        let exact = readings(&solver, &at, shape, || 0.0)
            .k
            .map(|k| k / LENGTH as f32);
        let mut odd = exact;
        odd[1] += 3.0;
        let begin = |readings, mask, start| {
            solver
                .begin(readings, mask, (0.0, start), MAX_EVALUATIONS)
                .unwrap()
        };
        for (readings, mask, open) in [
            (&exact, five, false),
            (&exact, five.without(3), false),
            (&exact, five.without(3).without(0), true),
            (&exact, GaugeMask(0b10010), true),
            (&odd, five, true),
        ] {
            let search = begin(readings, mask, None);
            assert_eq!(search.is_open(), open, "{mask:?}");
            assert!(search.is_converged() || is_suspicious(search.best.as_ref()));
            assert_eq!(start(&search), None);
            let mut search = search;
            let before = search;
            if !open {
                assert_eq!(solver.go_on(&mut search, MAX_EVALUATIONS, 7), 7);
                assert_eq!(search, before);
                continue;
            }
            // Computing the starts costs two integrations; a smaller effort leaves the search unchanged.
            assert_eq!(solver.go_on(&mut search, MAX_EVALUATIONS, 1), 0);
            assert_eq!(search, before);
            assert_eq!(solver.go_on(&mut search, MAX_EVALUATIONS, 2), 0);
            assert!(search.starts.is_some() && search.evaluations == before.evaluations);
            for effort in [0, 1, 3] {
                let evaluations = search.evaluations;
                let left = solver.go_on(&mut search, MAX_EVALUATIONS, effort);
                assert_eq!(search.evaluations - evaluations + left, effort);
            }
            let evaluations = search.evaluations;
            let left = solver.go_on(&mut search, MAX_EVALUATIONS, 100);
            assert!(!search.is_open() && search.descent.is_none());
            assert_eq!(search.evaluations - evaluations + left, 100);
            // With two or three readings all starts are tried, with more only until a shape explains the readings.
            let settled = mask.count() > 3 && !is_suspicious(search.best.as_ref());
            assert!(search.tried == 3 || settled, "{mask:?}");
            let [first, last] = [before, search].map(|search| search.best.unwrap());
            assert!(last.normal.cost <= first.normal.cost + 1e-2);
            let elsewhere = (last.parameters != first.parameters).then_some(last.parameters);
            assert_eq!(start(&search), elsewhere);
        }
        // A search that starts from the last fit's result needs no other start.
        let there = Start(begin(&exact, five, None).best.unwrap().parameters);
        let next = begin(&exact, five, Some(there));
        assert!(!next.is_open() && next.is_converged() && next.evaluations <= 2);
        assert_eq!(start(&next), Some(next.best.unwrap().parameters));
        let none = Search { best: None, ..next };
        assert!(!none.is_converged() && start(&none).is_none() && solver.finish(&none).is_none());
    }
}

/// The refinement may use two integrations of the budget, the search at least two.
#[test]
fn a_budget_is_shared_by_search_and_refinement() {
    let budgets = [0, 3, 4, 5, 40, 41].map(before_refinement);
    assert_eq!(budgets, [2, 2, 2, 3, 38, 38]);
}

/// A fit in bounded pieces ends where a whole fit does. The next fit, of a slightly moved frame, starts from this
/// result and needs no search.
#[test]
fn fit_in_pieces_equals_the_whole_fit_and_starts_the_next_fit() {
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

/// The budget of a tick bounds the integrations of the elastica for an estimate, including the refinement.
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

/// Worst position error (m) and heading error (rad) over `count` shapes; with `lose`, each
/// shape lacks one gauge, in turn.
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

/// The compression is up to 85 EI/L², twice the first buckling load of a clamped strip.
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

/// Sample covariance and mean residual of the fit under errors of the stated uncertainties.
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
    // A bend that determines all three parameters.
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

/// Drifted zeros make a straight strip look buckled. A fit that includes the drift has no significant force; without
/// the drift, some forces are large.
#[test]
fn drifted_zeros_of_a_straight_strip_give_no_significant_force() {
    let solver = solver(&gauss(), |_| {});
    let all = solver.strip.gauges;
    let mut random = Random(7);
    let (mut without_drift, mut significant_forces) = (0, 0);
    for _ in 0..400 {
        let zeros: [f32; MAX_GAUGES] =
            core::array::from_fn(|_| (4e-6 / 0.5e-3 * random.normal()) as f32);
        let large = |wrench: Wrench| usize::from(wrench.fx.hypot(wrench.fy) > 25.0);
        without_drift += large(solver.fit(&zeros, all).unwrap().wrench);
        let fit = solver
            .fit_within(&zeros, all, 16e-12, MAX_EVALUATIONS)
            .unwrap();
        let significant = fit.wrench.significant(fit.relative.posture);
        significant_forces += large(significant);
        // The heading error is about 0.7 mrad a microstrain of the mean reading.
        assert!(fit.relative.posture.phi.abs() < 0.02);
    }
    assert!(
        without_drift > 40 && significant_forces == 0,
        "{without_drift} {significant_forces}"
    );
}

/// A bent strip determines its force even with drifted zeros, and the wrench stays in balance.
#[test]
fn force_of_a_bent_strip_is_significant_despite_drifted_zeros() {
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
        let w = fit.wrench.significant(p);
        assert!((f64::from(w.fx) - sign * 40.0).abs() < 12.0, "{w:?}");
        let balance = w.root_moment + w.fx * p.y - w.fy * p.x - w.tip_moment;
        assert!(balance.abs() < 1e-4, "{w:?}");
    }
    assert!((square / claimed).sqrt() < 1.3, "{square} {claimed}");
}

/// The drift of the zeros enlarges the covariance of the wrench, not that of the posture.
#[test]
fn drifted_zeros_leave_the_covariance_of_the_posture_unchanged() {
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
    // Noise 1 µε, zero error 1 µε, drift 5 µε.
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
