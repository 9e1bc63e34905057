//! The plant's strip against the exact elastica.

#![allow(
    clippy::disallowed_methods,
    reason = "a test compares with another implementation"
)]

use plant::elastica::{Elastica, Load};
use plant::frame::Strip;

const LENGTH: f64 = 0.37;
const BENDING: f64 = 0.833;
const AXIAL: f64 = 1e7;
const PLACES: [f64; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];

fn exact() -> Elastica {
    Elastica::straight(LENGTH, BENDING, AXIAL, 400)
}

fn strip() -> Strip {
    Strip::new(LENGTH, BENDING, AXIAL, 0.0)
}

/// Relative errors of wrench and gauge curvature; the flag is true if the plant's strip is stable.
fn compare(strip: &Elastica, load: Load) -> (f64, f64, bool) {
    let end = strip.shoot(load).end;
    let seed = strip.curvature(load, &PLACES);
    let fast = self::strip();
    let found = fast.find(end, &PLACES, &seed);
    let (found, stable) = found.unwrap_or_else(|| panic!("no equilibrium for {load:?}"));
    let (a, b) = (strip.wrench(load, end), fast.wrench(&found));
    // A moment counts as moment divided by length.
    let unit = [1.0, 1.0, 1.0 / LENGTH];
    let norm = |v: [f64; 3]| (0..3).map(|i| (v[i] * unit[i]).powi(2)).sum::<f64>().sqrt();
    let wrench = norm([a[0] - b[0], a[1] - b[1], a[2] - b[2]]) / norm(a);
    let largest = seed.iter().fold(0.0, |m: f64, k| m.max(k.abs()));
    let strain = PLACES.iter().zip(&seed).fold(0.0, |worst: f64, (f, k)| {
        let error = fast.elastic_curvature(&found, f * LENGTH) - k;
        worst.max(error.abs() / largest)
    });
    (wrench, strain, stable)
}

/// A repeatable sequence in [−1, 1).
struct Sequence(u64);

impl Sequence {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// Root moment in EI/L and end force in EI/L², converted to SI units.
fn load([moment, fx, fy]: [f64; 3]) -> Load {
    let unit = BENDING / LENGTH;
    [moment * unit, fx * unit / LENGTH, fy * unit / LENGTH]
}

#[test]
fn wrench_and_strain_follow_the_exact_elastica() {
    let strip = exact();
    let mut random = Sequence(7);
    let mut cases = 0;
    while cases < 400 {
        let load = load([3.0, 8.0, 8.0].map(|size| size * random.next()));
        if strip.shoot(load).end[2].abs() > 1.6 {
            continue;
        }
        cases += 1;
        let (wrench, strain, _) = compare(&strip, load);
        assert!(wrench <= 1e-4, "{load:?}: wrench {wrench:e}");
        assert!(strain <= 5e-4, "{load:?}: strain {strain:e}");
    }
}

/// Load of a strip whose clamped ends are pushed together by a share of the length.
fn buckled(strip: &Elastica, share: f64) -> Load {
    let height = 4.0 * std::f64::consts::PI * share.sqrt();
    let push = 4.0 * std::f64::consts::PI.powi(2) * (1.0 + 0.5 * share);
    let start = load([height, -push, 0.0]);
    strip
        .solve([LENGTH * (1.0 - share), 0.0, 0.0], start)
        .expect("the exact shape is found")
}

#[test]
fn buckled_shapes_follow_the_exact_elastica() {
    let strip = exact();
    for share in [0.001, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6] {
        let load = buckled(&strip, share);
        for sign in [1.0, -1.0] {
            let load = [sign * load[0], load[1], sign * load[2]];
            let (wrench, strain, stable) = compare(&strip, load);
            assert!(wrench <= 5e-4, "{share}: wrench {wrench:e}");
            assert!(strain <= 2.5e-3, "{share}: strain {strain:e}");
            assert!(stable);
        }
    }
}

/// Compares force and moments at small deflections with the force and moments of a clamped beam.
#[test]
fn small_deflections_follow_beam_theory() {
    let strip = strip();
    let (y, angle) = (1e-6, 3e-6);
    let (found, stable) = strip
        .find([LENGTH, y, angle], &PLACES, &[0.0; 5])
        .expect("nearly straight");
    let (l, k) = (LENGTH, BENDING);
    let force = 12.0 * k / l.powi(3) * y - 6.0 * k / l.powi(2) * angle;
    let moment = -6.0 * k / l.powi(2) * y + 4.0 * k / l * angle;
    let root = 6.0 * k / l.powi(2) * y - 2.0 * k / l * angle;
    let wrench = strip.wrench(&found);
    assert!((wrench[1] / force - 1.0).abs() < 1e-5, "{wrench:?}");
    assert!((wrench[2] / moment - 1.0).abs() < 1e-5, "{wrench:?}");
    // The bending moment at the root is the negative of the moment that the root's support exerts.
    assert!((strip.root_moment(&found) / root - 1.0).abs() < 1e-4);
    assert!(stable);
}

#[test]
fn pulled_strip_stretches_like_a_bar() {
    let strip = Strip::new(LENGTH, BENDING, 1e5, 0.0);
    let (found, _) = strip
        .find([1.001 * LENGTH, 0.0, 0.0], &PLACES, &[0.0; 5])
        .expect("straight");
    let [fx, fy, moment] = strip.wrench(&found);
    assert!((fx - 100.0).abs() < 1e-6 && fy.abs() < 1e-9 && moment.abs() < 1e-9);
}

/// By Euler, a straight strip with clamped ends buckles at 4π² EI/L²: its stability must change there.
#[test]
fn straight_strip_loses_stability_at_the_euler_load() {
    let strip = strip();
    let critical = 4.0 * std::f64::consts::PI.powi(2) * BENDING / LENGTH.powi(2);
    for (share, expected) in [(0.5, true), (0.98, true), (1.02, false), (1.9, false)] {
        let x = LENGTH * (1.0 - share * critical / AXIAL);
        let (found, stable) = strip
            .find([x, 0.0, 0.0], &PLACES, &[0.0; 5])
            .expect("straight");
        assert!((strip.wrench(&found)[0] / (share * critical) + 1.0).abs() < 1e-6);
        assert_eq!(stable, expected, "{share} of the Euler load");
    }
}

#[test]
fn tangent_stiffness_is_symmetric_and_the_derivative_of_the_wrench() {
    let exact = exact();
    let strip = strip();
    let mut random = Sequence(3);
    for _ in 0..20 {
        let load = load([2.0, 4.0, 4.0].map(|size| size * random.next()));
        let end = exact.shoot(load).end;
        let seed = exact.curvature(load, &PLACES);
        let (found, _) = strip.find(end, &PLACES, &seed).expect("found");
        let stiffness = strip.stiffness(&found);
        for n in 0..3 {
            let moved = |d: f64| {
                let mut end = end;
                end[n] += d;
                strip.wrench(&strip.find(end, &PLACES, &seed).expect("near").0)
            };
            let (up, down) = (moved(1e-6), moved(-1e-6));
            let size = (0..3).fold(0.0, |m: f64, i| m.max(stiffness[i][n].abs()));
            for i in 0..3 {
                let difference = (up[i] - down[i]) / 2e-6;
                assert!((stiffness[i][n] - difference).abs() < 2e-3 * size);
                assert_eq!(stiffness[i][n], stiffness[n][i]);
            }
        }
    }
}

/// Compares the wrench with differences of the energy between neighbouring ends.
#[test]
fn wrench_is_the_gradient_of_the_energy() {
    let exact = exact();
    let strip = strip();
    let load = load([1.5, -2.0, 1.0]);
    let end = exact.shoot(load).end;
    let seed = exact.curvature(load, &PLACES);
    let energy = |end: [f64; 3]| strip.energy(&strip.find(end, &PLACES, &seed).expect("found").0);
    let wrench = strip.wrench(&strip.find(end, &PLACES, &seed).expect("found").0);
    for n in 0..3 {
        let (mut up, mut down) = (end, end);
        up[n] += 1e-5;
        down[n] -= 1e-5;
        let slope = (energy(up) - energy(down)) / 2e-5;
        assert!((slope - wrench[n]).abs() < 1e-4 * (1.0 + wrench[n].abs()));
    }
}

/// Under the load of a buckled strip, viscosity dissipates energy at every rate of the end.
#[test]
fn viscosity_is_the_stiffness_of_the_unloaded_strip() {
    let strip = strip();
    let rest = strip.unloaded();
    let (k, v) = (strip.stiffness(&rest), strip.viscosity(&rest));
    for m in 0..3 {
        for n in 0..3 {
            let scale = (k[m][m] * k[n][n]).sqrt();
            assert!((k[m][n] - v[m][n]).abs() < 1e-9 * scale);
        }
    }
    let exact = exact();
    for share in [0.01, 0.2] {
        let load = buckled(&exact, share);
        let end = exact.shoot(load).end;
        let (found, _) = strip
            .find(end, &PLACES, &exact.curvature(load, &PLACES))
            .expect("buckled");
        let v = strip.viscosity(&found);
        let mut random = Sequence(5);
        for _ in 0..50 {
            let rate = [LENGTH, LENGTH, 1.0].map(|size| size * random.next());
            let power: f64 = (0..9)
                .map(|k| rate[k / 3] * v[k / 3][k % 3] * rate[k % 3])
                .sum();
            assert!(power > 0.0);
        }
    }
}
