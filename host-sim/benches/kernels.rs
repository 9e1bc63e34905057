//! Times of the host's kernels: `cargo bench`.
//!
//! What the boards run is measured in instructions instead (`tools/scripts/count_instructions.py`); here
//! it shows what a simulation spends on it.

use core_algos::beam::sensor::{Method, PostureSolver};
use core_algos::beam::{MAX_GAUGES, strip};
use core_algos::fusion::ekf::{self, Measurements};
use core_algos::fusion::{Estimate, intersection};
use core_algos::math::{Posture, trig};
use divan::{Bencher, black_box};
use host_sim::plant::drive::{Drive, HARSH, NORMAL};
use host_sim::plant::{Plant, PlantConfig};
use host_sim::run::robot::Robot;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;

fn main() {
    divan::main();
}

/// A robot under way.
fn moving(drive: Drive) -> Plant {
    let config = drive.config(&PlantConfig::default());
    let mut plant = config.build().expect("the defaults are valid");
    for k in 0..500 {
        plant.step(drive.torque(f64::from(k) * 1e-3));
    }
    plant
}

/// 1000 steps of 1 ms.
#[divan::bench(args = ["normal", "harsh", "normal, portable"])]
fn plant_second(bencher: Bencher, drive: &str) {
    let law = if drive == "harsh" { HARSH } else { NORMAL };
    let mut plant = moving(law);
    if drive.ends_with("portable") {
        plant = plant.portable();
    }
    let torque: Vec<_> = (0..1000)
        .map(|k| law.torque(0.5 + f64::from(k) * 1e-3))
        .collect();
    bencher
        .with_inputs(|| plant.clone())
        .bench_local_values(|mut plant| {
            for torque in &torque {
                plant.step(*torque);
            }
            plant
        });
}

#[divan::bench]
fn plant_five_gauges(bencher: Bencher) {
    let plant = moving(NORMAL);
    let places = [0.037, 0.111, 0.185, 0.259, 0.333].map(|s| plant.gauge(s));
    bencher.bench_local(|| {
        let mut sum = 0.0;
        black_box(&plant).gauges(&places, |_, curvature| sum += curvature);
        sum
    });
}

/// 100 ticks of everything: sensors, three boards, bus, plant.
#[divan::bench]
fn closed_loop_100_ticks(bencher: Bencher) {
    let scenario = Scenario::default();
    let mut simulation = Simulation::new(&scenario, 1, 0).expect("the defaults are valid");
    bencher.bench_local(|| {
        for _ in 0..100 {
            simulation
                .step()
                .expect("boards in this process do not fail");
        }
    });
}

#[divan::bench]
fn axle_filter(bencher: Bencher) {
    let filter = ekf::Config::default()
        .build()
        .expect("the defaults are valid");
    let mut covariance = [[0.0; 7]; 7];
    for (i, row) in covariance.iter_mut().enumerate() {
        row[i] = 1e-4;
    }
    let mut state = ekf::State::from_parts([0.0; 7], &covariance);
    let measurements = Measurements {
        left_m_s: Some(0.19),
        right_m_s: Some(0.21),
        gyro_rad_s: Some(0.06),
        acceleration_m_s2: Some(0.01),
    };
    bencher.bench_local(|| filter.step(&mut state, black_box(&measurements)));
}

#[divan::bench(args = ["piecewise", "quadrature", "elastica"])]
fn relative_posture(bencher: Bencher, method: &str) {
    let method = match method {
        "piecewise" => Method::Piecewise,
        "quadrature" => Method::Quadrature,
        _ => Method::Elastica,
    };
    let strip = strip::Config::default();
    let half = strip.half_thickness_m;
    let strip = strip.build().expect("the defaults are valid");
    let solver = PostureSolver::new(strip, method, 100).expect("100 segments are allowed");
    let mut strain = [0.0; MAX_GAUGES];
    for (i, value) in strain.iter_mut().take(5).enumerate() {
        *value = half * (0.3 * i as f32 - 0.2);
    }
    bencher.bench_local(|| solver.solve(black_box(&strain), strip.gauges()));
}

#[divan::bench]
fn covariance_intersection(bencher: Bencher) {
    let law = intersection::Config::default()
        .build()
        .expect("the defaults are valid");
    let a = Estimate::with_sigmas(Posture::new(0.1, 0.2, 0.3), [0.01, 0.02, 0.01]);
    let b = Estimate::with_sigmas(Posture::new(0.11, 0.18, 0.31), [0.02, 0.01, 0.02]);
    bencher.bench_local(|| law.fuse(black_box(&a), black_box(&b)));
}

#[divan::bench]
fn sine_and_cosine(bencher: Bencher) {
    bencher.bench_local(|| trig::sin_cos(black_box(1.234)));
}
