use super::super::reference::{Elastica, Random, integrate, polynomial};
use super::super::strip::{Config, GAUSS_5, PerGauge, Uncertainty};
use super::*;
use std::vec::Vec;

const LENGTH: f64 = 0.37;

fn placements() -> Vec<Vec<f64>> {
    let places = |n: usize, at: &dyn Fn(f64) -> f64| -> Vec<f64> {
        (0..n).map(|i| LENGTH * at(i as f64)).collect()
    };
    let uniform = |n: usize| places(n, &|i| (i + 0.5) / n as f64);
    let ends = |n: usize| places(n, &|i| i / (n - 1) as f64);
    vec![
        places(5, &|i| f64::from(GAUSS_5[i as usize])),
        uniform(2),
        uniform(3),
        uniform(5),
        uniform(8),
        ends(4),
        ends(6),
    ]
}

fn strip(gauges: &[f64], change: impl Fn(&mut Config)) -> Strip {
    let gauges: Vec<f32> = gauges.iter().map(|g| *g as f32).collect();
    let mut config = Config {
        gauges_m: PerGauge::new(&gauges).unwrap(),
        ..Config::default()
    };
    change(&mut config);
    config.build().unwrap()
}

fn rule(strip: &Strip, mask: GaugeMask) -> Quadrature {
    Quadrature::new(strip, Interpolant::new(strip, mask).unwrap())
}

fn padded(values: &[f64]) -> [f32; MAX_GAUGES] {
    let values: Vec<f32> = values.iter().map(|v| *v as f32).collect();
    PerGauge::new(&values).unwrap().padded()
}

/// Smooth bends up to 10 1/m whose end angle is at most 1.5 rad.
fn smooth(random: &mut Random, gauges: &[f64]) -> Vec<f64> {
    loop {
        let amplitude = random.between(0.5, 5.0);
        let (a, b, w, p) = (
            random.between(-1.0, 1.0),
            random.between(-1.0, 1.0),
            random.between(0.0, 5.0),
            random.between(0.0, 6.3),
        );
        let k: Vec<f64> = gauges
            .iter()
            .map(|g| amplitude * (a + b * (w * g / LENGTH + p).sin()))
            .collect();
        let end = integrate(LENGTH, 40, |s| polynomial(gauges, &k, s));
        if end[2].abs() < 1.5 {
            return k;
        }
    }
}

#[test]
fn both_methods_match_the_same_polynomial_in_f64() {
    let mut random = Random(1);
    let (mut worst_m, mut worst_rad) = (0.0f64, 0.0f64);
    for gauges in placements() {
        let strip = strip(&gauges, |_| {});
        let rule = rule(&strip, strip.gauges);
        for _ in 0..60 {
            let k = smooth(&mut random, &gauges);
            let fast = quadrature(&strip, &rule, &padded(&k)).posture;
            let exact = integrate(LENGTH, 400, |s| polynomial(&gauges, &k, s));
            let pieces = piecewise(&strip, &rule, &padded(&k), 100).posture;
            // Reference for `piecewise`: the arcs in `f64`, in the paper's form with a division by the curvature.
            let (mut x, mut y, mut phi) = (0.0, 0.0, 0.0f64);
            for i in 0..100 {
                let d_length = LENGTH / 100.0;
                let rho = 1.0 / polynomial(&gauges, &k, (i as f64 + 0.5) * d_length);
                let d_phi = d_length / rho;
                let (dx, dy) = (rho * d_phi.sin(), rho * (1.0 - d_phi.cos()));
                x += phi.cos() * dx - phi.sin() * dy;
                y += phi.sin() * dx + phi.cos() * dy;
                phi += d_phi;
            }
            for (found, expected) in [(fast, exact), (pieces, [x, y, phi])] {
                worst_m = worst_m
                    .max((f64::from(found.x) - expected[0]).abs())
                    .max((f64::from(found.y) - expected[1]).abs());
                worst_rad = worst_rad.max((f64::from(found.phi) - expected[2]).abs());
            }
        }
    }
    println!("worst {worst_m:e} m, {worst_rad:e} rad");
    assert!(worst_m < 5e-7 && worst_rad < 1.2e-6);
}

#[test]
fn constant_curvature_gives_a_circular_arc_extended_by_rigid_ends() {
    let (root, tip) = (0.02f64, 0.03f64);
    for gauges in placements() {
        let strip = strip(&gauges, |c| {
            c.rigid_root_m = root as f32;
            c.rigid_tip_m = tip as f32;
        });
        let rule = rule(&strip, strip.gauges);
        for k in [-4.0f64, -1.0, -1e-4, 1e-4, 0.7, 4.0] {
            let phi = k * LENGTH;
            let expected = [
                root + phi.sin() / k + tip * phi.cos(),
                (1.0 - phi.cos()) / k + tip * phi.sin(),
                phi,
            ];
            for found in [
                quadrature(&strip, &rule, &[k as f32; MAX_GAUGES]).posture,
                piecewise(&strip, &rule, &[k as f32; MAX_GAUGES], 7).posture,
            ] {
                let found: [f32; 3] = found.into();
                for i in 0..3 {
                    assert!((f64::from(found[i]) - expected[i]).abs() < 1e-6);
                }
            }
        }
        let flat = quadrature(&strip, &rule, &[0.0; MAX_GAUGES]).posture;
        assert!((flat.x - 0.42).abs() < 1e-6 && flat.y == 0.0 && flat.phi == 0.0);
    }
}

#[test]
fn piecewise_converges_to_quadrature_with_the_square_of_the_segment() {
    let gauges = &placements()[0];
    let strip = strip(gauges, |_| {});
    let rule = rule(&strip, strip.gauges);
    let k = padded(&[6.0, 4.0, -1.0, -3.0, 2.0]);
    let limit = quadrature(&strip, &rule, &k).posture;
    let error = |n| piecewise(&strip, &rule, &k, n).posture.distance(limit);
    assert!((error(10) / error(20) - 4.0).abs() < 0.5);
    assert!((error(20) / error(40) - 4.0).abs() < 0.5);
    assert!(error(10_000) < 4e-7);
}

#[test]
fn positive_strain_bends_the_strip_to_the_left() {
    let strip = Config::default().build().unwrap();
    let rule = rule(&strip, strip.gauges);
    let curvature = strip.curvature(&[5e-4; MAX_GAUGES]);
    assert_eq!(curvature[0], 1.0);
    let p = quadrature(&strip, &rule, &curvature).posture;
    assert!(p.y > 0.06 && p.phi > 0.36);
}

#[test]
fn lost_gauge_leaves_the_polynomial_of_the_other_gauges() {
    let gauges = &placements()[3];
    let strip = strip(gauges, |_| {});
    let rest: Vec<f64> = [0, 1, 3, 4].map(|i| gauges[i]).to_vec();
    let values = [1.0, 2.0, 2.5, 1.0];
    let mut k = padded(&[1.0, 2.0, 0.0, 2.5, 1.0]);
    k[2] = f32::NAN;
    let rule = rule(&strip, strip.gauges.without(2));
    let found = quadrature(&strip, &rule, &k);
    let expected = integrate(LENGTH, 400, |s| polynomial(&rest, &values, s));
    assert!(found.is_sound());
    assert!((f64::from(found.posture.y) - expected[1]).abs() < 1e-6);
    assert!((f64::from(found.posture.phi) - expected[2]).abs() < 2e-6);
    assert!(Interpolant::new(&strip, GaugeMask(0b1)).is_none());
}

/// Noise-free readings of elastica shapes: the remaining error is the polynomial's, and the covariance must cover it.
#[test]
fn covariance_covers_the_error_between_the_gauges() {
    let mut random = Random(5);
    for gauges in placements() {
        if gauges.len() < 3 {
            continue;
        }
        let strip = strip(&gauges, |c| {
            let u = &mut c.uncertainty;
            (u.noise_strain, u.offset_strain, u.common_offset_strain) = (1e-7, 0.0, 0.0);
            (u.gain, u.common_gain) = (0.0, 0.0);
        });
        let rule = rule(&strip, strip.gauges);
        let at: Vec<f64> = gauges.iter().map(|g| g / LENGTH).collect();
        let (mut covered, n) = (0, 300);
        let mut worst = [0.0f64; 2];
        for _ in 0..n {
            let bent = Elastica::random(&mut random, 12.0).bent(&at);
            let k: Vec<f64> = bent.curvature.iter().map(|k| k / LENGTH).collect();
            let found = quadrature(&strip, &rule, &padded(&k));
            let p: [f32; 3] = found.posture.into();
            let truth = [LENGTH * bent.end[0], LENGTH * bent.end[1], bent.end[2]];
            let error: [f64; 3] = core::array::from_fn(|i| f64::from(p[i]) - truth[i]);
            worst[0] = worst[0].max(error[0].hypot(error[1]));
            worst[1] = worst[1].max(error[2].abs());
            if (0..3).all(|i| error[i].powi(2) <= 9.0 * f64::from(found.covariance[i][i])) {
                covered += 1;
            }
        }
        println!("{at:.2?}: covered {covered} of {n}, worst {worst:?}");
        assert!(covered >= n * 95 / 100, "{at:?}: {covered}");
    }
}

/// Legendre polynomial of degree `n` by the recurrence.
fn legendre(n: usize, u: f64) -> f64 {
    let (mut before, mut value) = (0.0, 1.0);
    for k in 0..n {
        let k = k as f64;
        (before, value) = (
            value,
            ((2.0 * k + 1.0) * u * value - k * before) / (k + 1.0),
        );
    }
    value
}

/// Derivatives of the posture by each curvature, by central differences.
fn derivatives(at: &[f64], k: &[f64]) -> Vec<[f64; 3]> {
    let posture = |k: &[f64]| {
        let [x, y, phi] = integrate(LENGTH, 200, |s| polynomial(at, k, s));
        [x + 0.05 * phi.cos(), y + 0.05 * phi.sin(), phi]
    };
    let by = |i: usize| {
        let [low, high] = [-1e-3, 1e-3].map(|step| {
            let mut moved = k.to_vec();
            moved[i] += step;
            posture(&moved)
        });
        core::array::from_fn(|row| (high[row] - low[row]) / 2e-3)
    };
    (0..k.len()).map(by).collect()
}

/// The larger of the two highest Legendre coefficients, by projection.
fn highest(at: &[f64], k: &[f64]) -> f64 {
    let coefficient = |n: usize| {
        let value = |u: f64| polynomial(at, k, 0.5 * LENGTH * (u + 1.0)) * legendre(n, u);
        let middles = (0..2000).map(|i| value((f64::from(i) + 0.5) / 1000.0 - 1.0));
        (n as f64 + 0.5) * middles.sum::<f64>() / 1000.0
    };
    let [last, before] = [k.len() - 1, k.len() - 2].map(|n| coefficient(n).abs());
    last.max(before)
}

/// Reference: covariances of posture and noise from derivatives by finite differences and the highest Legendre
/// coefficients by projection, with all gauges and with one lost.
#[test]
fn covariances_are_those_of_the_propagated_errors() {
    let uncertainty = Uncertainty {
        noise_strain: 6e-6,
        offset_strain: 8e-6,
        common_offset_strain: 5e-6,
        gain: 0.02,
        common_gain: 0.01,
        interpolation: 0.02,
        position_m: 3e-4,
        heading_rad: 5e-4,
        ..Uncertainty::default()
    };
    let mut random = Random(7);
    let cases = placements()
        .into_iter()
        .flat_map(|gauges| [(gauges.clone(), false), (gauges, true)]);
    for (gauges, lose) in cases.filter(|(gauges, lose)| !lose || gauges.len() > 2) {
        let strip = strip(&gauges, |c| {
            c.uncertainty = uncertainty;
            (c.rigid_root_m, c.rigid_tip_m) = (0.02, 0.05);
        });
        let (mut at, mut mask) = (gauges.clone(), strip.gauges);
        if lose {
            at.remove(1);
            mask = mask.without(1);
        }
        let rule = rule(&strip, mask);
        for _ in 0..4 {
            let k: Vec<f64> = smooth(&mut random, &at)
                .iter()
                .map(|k| f64::from(*k as f32))
                .collect();
            let (by, highest) = (derivatives(&at, &k), highest(&at, &k));
            let thickness = f64::from(strip.half_thickness);
            let fresh = (6e-6 / thickness).powi(2) + (0.02 * highest).powi(2);
            let lasting = |i: usize| (8e-6 / thickness).powi(2) + (0.02 * k[i]).powi(2);
            let sum = |row: usize, each: &dyn Fn(usize) -> f64| {
                (0..k.len()).map(|i| by[i][row] * each(i)).sum::<f64>()
            };
            let mut readings = padded(&k);
            if lose {
                readings.copy_within(1..MAX_GAUGES - 1, 2);
                readings[1] = f32::NAN;
            }
            let found = quadrature(&strip, &rule, &readings);
            let unseen = |r: usize, c: usize| {
                if r == c {
                    [3e-4f64, 3e-4, 5e-4][r].powi(2)
                } else {
                    0.0
                }
            };
            let noise = |r: usize, c: usize| fresh * sum(r, &|i| by[i][c]);
            let all = |r: usize, c: usize| {
                let common = [
                    (5e-6 / thickness, &(|_| 1.0) as &dyn Fn(usize) -> f64),
                    (0.01, &|i| k[i]),
                ];
                let common =
                    common.map(|(sigma, each)| sigma * sigma * sum(r, each) * sum(c, each));
                noise(r, c) + sum(r, &|i| lasting(i) * by[i][c]) + common[0] + common[1]
            };
            let figures: [(_, &dyn Fn(usize, usize) -> f64); 2] =
                [(found.noise, &noise), (found.covariance, &all)];
            for (found, expected) in figures {
                let expected = |r: usize, c: usize| expected(r, c) + unseen(r, c);
                for (r, c) in (0..9).map(|i| (i / 3, i % 3)) {
                    let error = f64::from(found[r][c]) - expected(r, c);
                    let size = (expected(r, r) * expected(c, c)).sqrt();
                    assert!(
                        error.abs() < 2e-3 * size,
                        "{gauges:?} {k:?} {lose}: {r} {c}: {error:e} {size:e}"
                    );
                }
            }
        }
    }
}
