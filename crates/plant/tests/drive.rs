//! The whole plant against the explicit reference, and against the laws of mechanics.

#![allow(
    clippy::disallowed_methods,
    reason = "a test compares with another implementation"
)]

use plant::drive::{HARSH, NORMAL};
use plant::{Creep, Plant, PlantConfig, Tyre};

fn config() -> PlantConfig {
    PlantConfig::default()
}

fn plant(config: &PlantConfig) -> Plant {
    config.build(2).expect("the configuration is valid")
}

/// Compares the normal and the harsh drive with the explicit reference over 0.6 s, on tyres of two creep velocities.
#[test]
fn postures_follow_the_explicit_reference() {
    for drive in [NORMAL, HARSH] {
        for creep in [0.003, 0.02] {
            let config = PlantConfig {
                tyre: Tyre::Creep(Creep {
                    velocity_m_s: creep,
                }),
                rolling_resistance: 0.01,
                ..config()
            };
            let [position, heading] = drive.error(&config, 2, 0.6).unwrap();
            assert!(position < 5e-5, "{} {creep}: {position} m", drive.name);
            assert!(heading < 3e-4, "{} {creep}: {heading} rad", drive.name);
        }
    }
}

#[test]
fn step_advances_one_tick_for_any_number_of_substeps() {
    let travel = |substeps: u32| {
        let mut plant = plant(&PlantConfig {
            substeps,
            ..config()
        });
        for tick in 0..1000 {
            plant.step(&NORMAL.torque(f64::from(tick) * 1e-3, 2));
        }
        assert!((plant.time() - 1.0).abs() < 1e-12);
        [0, 1].map(|i| plant.axles()[i].wheel_angle)
    };
    let whole = travel(1);
    assert!(whole[0][0].abs() > 0.3, "{whole:?}");
    for substeps in [2, 7, 50] {
        let divided = travel(substeps);
        for (a, b) in whole.as_flattened().iter().zip(divided.as_flattened()) {
            assert!((a - b).abs() < 2e-3, "{substeps}: {whole:?} {divided:?}");
        }
    }
}

#[test]
fn error_falls_with_the_square_of_the_step() {
    let end = |substeps: u32| {
        let config = PlantConfig {
            substeps,
            tolerance_m_s: 1.0,
            ..config()
        };
        let mut plant = plant(&config);
        (0..700).for_each(|tick| plant.step(&NORMAL.torque(f64::from(tick) * 1e-3, 2)));
        plant.axles()[0].posture
    };
    let truth = end(64);
    let error = |substeps: u32| {
        let [x, y, _] = end(substeps);
        (x - truth[0]).hypot(y - truth[1])
    };
    let (coarse, fine) = (error(1), error(2));
    assert!((2.8..5.5).contains(&(coarse / fine)), "{coarse} {fine}");
}

/// A soft strip that the tyres can buckle, driven by varied torques: many snap-throughs, taut pulls at
/// metres per second, turns beyond those of a real robot.
#[test]
fn snap_through_converges_and_keeps_its_energy_bounded() {
    let config = PlantConfig {
        bending_stiffness_n_m2: 0.05,
        ..config()
    };
    let mut snaps = 0;
    for n in 0..12 {
        let phase = |k: usize| (1.7 * n as f64 + 2.3 * k as f64).sin();
        let wave = |k: usize, t: f64| {
            1.6 * phase(k).abs() * ((1.5 + 4.0 * phase(k + 4).abs()) * t + 6.0 * phase(k + 8)).sin()
        };
        let mut plant = plant(&config);
        let mut energy = 0.0f64;
        for k in 0..10_000 {
            let t = k as f64 * 1e-3;
            plant.step(&[[wave(0, t), wave(1, t)], [wave(2, t), wave(3, t)]]);
            energy = energy.max(plant.energy());
        }
        // Kinetic energy of the robot at the no-load speed of its wheels: 13 J.
        assert!(energy < 60.0, "drive {n}: {energy} J");
        let health = plant.health();
        assert_eq!(health.failures, 0, "drive {n}: {health:?}");
        snaps += health.snap_throughs;
    }
    assert!(snaps > 5, "{snaps}");
}

#[test]
fn placed_robot_stays_at_rest() {
    let mut plant = plant(&config());
    plant.place([-1.342, -1.342, 2.0]);
    for _ in 0..2000 {
        plant.step(&[[0.0; 2]; 2]);
    }
    let [x, y, phi] = plant.midpoint();
    assert!((x + 1.342).abs() < 1e-9 && (y + 1.342).abs() < 1e-9 && (phi - 2.0).abs() < 1e-9);
    let wrench = plant.wrench(0);
    assert!(wrench.force[0].abs() < 1e-6 && wrench.force[1].abs() < 1e-9);
    assert!((plant.time() - 2.0).abs() < 1e-12);
    let [dx, dy, turn] = plant.relative_posture(0);
    assert!((dx - 0.37).abs() < 1e-6 && dy.abs() < 1e-6 && turn.abs() < 1e-9);
}

#[test]
fn mirrored_torques_give_mirrored_motion() {
    let config = PlantConfig {
        natural_slope_rad: 0.0,
        ..config()
    };
    let (mut one, mut other) = (plant(&config), plant(&config));
    for k in 0..3000 {
        let torque = NORMAL.torque(k as f64 * 1e-3, 2);
        one.step(&torque);
        let swapped: Vec<_> = torque.iter().map(|[left, right]| [*right, *left]).collect();
        other.step(&swapped);
    }
    let (a, b) = (one.midpoint(), other.midpoint());
    assert!((a[0] - b[0]).abs() < 1e-7 && (a[1] + b[1]).abs() < 1e-7 && (a[2] + b[2]).abs() < 1e-7);
    assert!(a[1].abs() > 1e-3);
    assert!((one.curvature(0, 0.1) + other.curvature(0, 0.1)).abs() < 1e-6);
}

#[test]
fn motion_does_not_depend_on_the_start_posture() {
    let (mut one, mut other) = (plant(&config()), plant(&config()));
    let place = [3.0, -2.0, 1.1];
    other.place(place);
    for k in 0..2000 {
        let torque = NORMAL.torque(k as f64 * 1e-3, 2);
        one.step(&torque);
        other.step(&torque);
    }
    let ([x, y, phi], q) = (one.midpoint(), other.midpoint());
    let (s, c) = place[2].sin_cos();
    assert!((place[0] + c * x - s * y - q[0]).abs() < 1e-6);
    assert!((place[1] + s * x + c * y - q[1]).abs() < 1e-6);
    assert!((place[2] + phi - q[2]).abs() < 1e-6);
}

/// Full torque on a straight run ends at the no-load speed, reduced by rolling resistance.
#[test]
fn top_speed_lies_on_the_speed_torque_line() {
    let config = PlantConfig {
        rolling_resistance: 0.02,
        ..config()
    };
    let mut plant = plant(&config);
    for _ in 0..30_000 {
        plant.step(&[[10.0; 2]; 2]);
    }
    let mass = 2.0 * 4.76 + 0.6;
    let resisting = 0.02 * mass * 9.806_65 * 0.073 / 4.0;
    // The frame couples the axles, so the wheel speeds differ slightly; their mean is unchanged.
    let axles = plant.axles().iter();
    let mean = axles.flat_map(|a| a.wheel_speed).sum::<f64>() / 4.0;
    let expected = 20.0 * (1.0 - resisting / 2.5);
    assert!((mean - expected).abs() < 1e-3, "{mean} {expected}");
}

/// Acceleration shifts load to the rear axle, a left turn to the right wheels.
#[test]
fn wheel_loads_shift_with_acceleration() {
    let config = PlantConfig {
        center_of_mass_height_m: 0.06,
        ..config()
    };
    let mut plant = plant(&config);
    let weight: f64 = plant.axles().iter().flat_map(|a| a.load).sum();
    assert!((weight - (2.0 * 4.76 + 0.6) * 9.806_65).abs() < 1e-9);
    for _ in 0..400 {
        plant.step(&[[0.3; 2]; 2]);
    }
    let a = plant.axles()[1].acceleration[0];
    let shifted: f64 = plant.axles()[1].load.iter().sum::<f64>() - (4.76 + 0.6) * 9.806_65;
    let expected = (2.0 * 4.76 + 0.6) * a * 0.06 / 0.37;
    assert!(a > 0.5 && (shifted - expected).abs() < 0.02 * expected);
    for _ in 0..300 {
        plant.step(&[[-0.3, 0.3], [0.3, -0.3]]);
    }
    let axle = plant.axles()[0];
    assert!(axle.acceleration[1] > 0.2 && axle.load[1] > axle.load[0]);
    let total: f64 = plant.axles().iter().flat_map(|a| a.load).sum();
    assert!((total - weight).abs() < 1e-9);
}

/// A held bend: the strains and the wrench agree with the shape of the frame.
#[test]
fn gauges_root_moment_and_shape_agree() {
    let config = PlantConfig {
        rigid_root_m: 0.02,
        rigid_tip_m: 0.03,
        ..config()
    };
    let mut plant = plant(&config);
    for k in 0..1500 {
        let steer = 0.25 * (k as f64 / 1200.0).min(1.0);
        plant.step(&[[-steer, steer], [steer, -steer]]);
    }
    let wrench = plant.elastic_wrench(0);
    let [x, y, turn] = plant.relative_posture(0);
    assert!(turn > 0.3, "{turn}");
    let balance = wrench.end_moment + x * wrench.force[1] - y * wrench.force[0];
    assert!((wrench.root_moment - balance).abs() < 1e-9);
    // Curvature at the strip's root, from the moment there.
    let at_strip = wrench.root_moment - 0.02 * wrench.force[1];
    assert!((plant.curvature(0, 0.0) - at_strip / 0.833).abs() < 1e-9);
    // The angle that the curvature adds up to is the turn between the axles.
    let n = 2000;
    let sum: f64 = (0..n)
        .map(|k| plant.curvature(0, (k as f64 + 0.5) * 0.37 / n as f64) * 0.37 / n as f64)
        .sum();
    assert!((sum - turn).abs() < 1e-4, "{sum} {turn}");
    // The curve runs from axle to axle and is as long as the frame.
    let mut curve = [[0.0; 2]; 400];
    plant.draw(&plant.outline(0, 400), &mut curve);
    let [front, rear] = [0, 1].map(|i| plant.axles()[i].posture);
    let last = curve[curve.len() - 1];
    assert!((curve[0][0] - rear[0]).abs() < 1e-12 && (curve[0][1] - rear[1]).abs() < 1e-12);
    assert!((last[0] - front[0]).hypot(last[1] - front[1]) < 1e-6);
    let length: f64 = curve
        .windows(2)
        .map(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1]))
        .sum();
    assert!((length - 0.42).abs() < 1e-4, "{length}");
}

/// Compares the curvatures computed for all gauges at once with the curvature at each single place, also under large
/// bends and forces.
#[test]
fn prepared_gauge_places_agree_with_single_places() {
    for (drive, allowed) in [(NORMAL, 1e-10), (HARSH, 1e-6)] {
        let mut plant = plant(&drive.config(&config()));
        let places: Vec<f64> = (0..9).map(|i| 0.37 * f64::from(i) / 8.0).collect();
        let stations: Vec<_> = places.iter().map(|s| plant.gauge(0, *s)).collect();
        let (mut worst, mut largest) = (0.0f64, 0.0f64);
        for k in 0..6000 {
            plant.step(&drive.torque(f64::from(k) * 1e-3, 2));
            if k % 20 == 0 {
                plant.gauges(0, &stations, |i, curvature| {
                    let exact = plant.curvature(0, places[i]);
                    worst = worst.max((curvature - exact).abs());
                    largest = largest.max(exact.abs());
                });
            }
        }
        let name = drive.name;
        assert!(worst <= allowed * largest, "{name}: {worst} {largest}");
        assert!(largest > 1.0);
    }
}

#[test]
fn command_that_is_not_finite_counts_as_zero() {
    let (mut one, mut other) = (plant(&config()), plant(&config()));
    for _ in 0..100 {
        one.step(&[[0.2, f64::NAN], [f64::INFINITY, 0.2]]);
        other.step(&[[0.2, 0.0], [0.0, 0.2]]);
    }
    assert_eq!(one.axles(), other.axles());
}
