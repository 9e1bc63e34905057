//! Fit of the elastica against independent reference shapes, computed by shooting in `f64`.
//!
//! A strip clamped at the root is loaded at its tip by a force and turned there to an angle. Its shape solves
//! EI κ' = F_x sin θ − F_y cos θ with θ(0) = 0 and θ(L) given. The root's curvature is found by Newton's method, with
//! the force raised from zero in steps. The noise-free strains of the shape are fitted without a start from an
//! earlier fit.

#![allow(
    clippy::disallowed_methods,
    reason = "a test compares with another implementation"
)]

use core_algos::beam::elastica::Solver;
use core_algos::beam::sensor::PostureSolver;
use core_algos::beam::strip::Config;
use core_algos::beam::{GaugeMask, MAX_GAUGES, Method, PerGauge, RelativePosture};

/// Flexible length, m.
const LENGTH: f64 = 0.36;
/// EI, N m².
const STIFFNESS: f64 = 0.833;
/// Half the thickness, m.
const HALF_THICKNESS: f64 = 0.5e-3;
/// Limit of the end force of a random shape, N.
const FORCE: f64 = 25.0;
/// Limit of the end angle of a random shape, rad.
const ANGLE: f64 = 1.2;
/// Number of shapes per seed.
const SHAPES: usize = 500;
/// Steps of the integration from the root or a gauge to the next gauge or the tip.
const STEPS: usize = 60;

/// All five gauges.
const ALL: GaugeMask = GaugeMask(0b11111);

/// A bent strip.
struct Shape {
    strain: [f64; 5],
    /// x, y and heading of the tip.
    tip: [f64; 3],
}

/// The five Gauss–Legendre nodes on [0, 1].
fn nodes() -> [f64; 5] {
    let near = (5.0 - 2.0 * (10.0f64 / 7.0).sqrt()).sqrt() / 3.0;
    let far = (5.0 + 2.0 * (10.0f64 / 7.0).sqrt()).sqrt() / 3.0;
    [-far, -near, 0.0, near, far].map(|u| 0.5 + 0.5 * u)
}

/// State at a point of the strip: θ, κ, x, y, and the derivatives of θ and κ by the root's curvature.
type Point = [f64; 6];

/// Derivative of the state by the arc length.
fn rate(p: &Point, [fx, fy]: [f64; 2]) -> Point {
    let (s, c) = p[0].sin_cos();
    let bend = (fx * s - fy * c) / STIFFNESS;
    [p[1], bend, c, s, p[5], (fx * c + fy * s) / STIFFNESS * p[4]]
}

/// Classical Runge–Kutta steps over `length`.
fn march(mut p: Point, length: f64, force: [f64; 2]) -> Point {
    let h = length / STEPS as f64;
    let plus = |p: &Point, k: &Point, h: f64| core::array::from_fn(|i| p[i] + h * k[i]);
    for _ in 0..STEPS {
        let k1 = rate(&p, force);
        let k2 = rate(&plus(&p, &k1, h / 2.0), force);
        let k3 = rate(&plus(&p, &k2, h / 2.0), force);
        let k4 = rate(&plus(&p, &k3, h), force);
        for i in 0..6 {
            p[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
        }
    }
    p
}

/// States at the five gauges and at the tip, for a strip with the curvature `root` at its root.
fn points(root: f64, force: [f64; 2]) -> [Point; 6] {
    let mut p = [0.0, root, 0.0, 0.0, 0.0, 1.0];
    let mut from = 0.0;
    let [a, b, c, d, e] = nodes();
    [a, b, c, d, e, 1.0].map(|to| {
        p = march(p, (to - from) * LENGTH, force);
        from = to;
        p
    })
}

/// The shape for a force and an end angle. The shape is unique: a force below π² EI/L² (63 N) cannot buckle a strip
/// whose end angles are held.
fn shoot(force: [f64; 2], angle: f64) -> Shape {
    const RISES: i32 = 10;
    let mut root = angle / LENGTH;
    for rise in 1..=RISES {
        let force = force.map(|f| f * f64::from(rise) / f64::from(RISES));
        let mut miss = f64::INFINITY;
        for _ in 0..30 {
            let tip = points(root, force)[5];
            miss = tip[0] - angle;
            if miss.abs() < 1e-13 {
                break;
            }
            root -= miss / tip[4];
        }
        assert!(miss.abs() < 1e-11, "{force:?} {angle} {miss}");
    }
    let [a, b, c, d, e, tip] = points(root, force);
    Shape {
        strain: [a, b, c, d, e].map(|p| p[1] * HALF_THICKNESS),
        tip: [tip[2], tip[3], tip[0]],
    }
}

/// Uniform in [0, 1): the linear congruential generator of Knuth's MMIX.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005);
        self.0 = self.0.wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Random shapes: end angle up to [`ANGLE`] either way, end force up to [`FORCE`] in any direction.
fn random(seed: u64) -> impl Iterator<Item = Shape> {
    let mut random = Random(seed);
    (0..SHAPES).map(move |_| {
        let angle = ANGLE * (2.0 * random.uniform() - 1.0);
        let size = FORCE * random.uniform();
        let (s, c) = (core::f64::consts::TAU * random.uniform()).sin_cos();
        shoot([size * c, size * s], angle)
    })
}

fn config() -> Config {
    Config {
        length_m: LENGTH as f32,
        gauges_m: PerGauge::new(&nodes().map(|u| (u * LENGTH) as f32)).unwrap(),
        ..Config::default()
    }
}

/// Position error, m, and heading error, rad, of a fit.
fn error(found: &RelativePosture, shape: &Shape) -> [f64; 2] {
    let p = found.posture;
    let [x, y, heading] = shape.tip;
    let position = (f64::from(p.x) - x).hypot(f64::from(p.y) - y);
    [position, (f64::from(p.phi) - heading).abs()]
}

/// Largest position and heading error over shapes.
fn worst(
    shapes: impl Iterator<Item = Shape>,
    mut found: impl FnMut(&[f32; MAX_GAUGES]) -> Option<RelativePosture>,
) -> [f64; 2] {
    shapes.fold([0.0, 0.0], |worst, shape| {
        let strain = PerGauge::new(&shape.strain.map(|e| e as f32)).unwrap();
        let found = found(&strain.padded()).unwrap();
        let [position, heading] = error(&found, &shape);
        [worst[0].max(position), worst[1].max(heading)]
    })
}

/// Shapes that the force prior biases most: nearly straight, with the largest force in any direction.
fn hardest() -> impl Iterator<Item = Shape> {
    (-8..=8).flat_map(|turn| {
        (0..24).map(move |direction| {
            let (s, c) = (core::f64::consts::TAU * f64::from(direction) / 24.0).sin_cos();
            shoot([FORCE * c, FORCE * s], 0.02 * f64::from(turn))
        })
    })
}

#[test]
fn posture_of_bent_and_loaded_strip_is_exact() {
    let strip = config().build().unwrap();
    let sensor = PostureSolver::new(strip, Method::Elastica, 100).unwrap();
    let [position, heading] = worst(random(1).chain(hardest()), |strain| {
        let solution = sensor.solve(strain, ALL)?;
        (solution.method == Method::Elastica).then_some(solution.relative)
    });
    assert!(
        position < 2e-4 && heading < 2e-3,
        "{position:e} m {heading:e} rad"
    );
}

/// The estimate of a tick may compute five shapes, including the refinement.
#[test]
fn posture_within_the_budget_of_a_tick_is_exact() {
    let strip = config().build().unwrap();
    let solver = Solver::new(strip);
    let [position, heading] = worst(random(2).chain(hardest()), |strain| {
        let curvature = strip.curvature(strain);
        let search = solver.begin(&curvature, ALL, (0.0, None), 5)?;
        let fit = solver.finish(&search).filter(|fit| fit.evaluations <= 5)?;
        (fit.converged && !search.is_open()).then_some(fit.relative)
    });
    assert!(
        position < 2e-4 && heading < 2e-3,
        "{position:e} m {heading:e} rad"
    );
}
