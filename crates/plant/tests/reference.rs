//! The plant against the explicit reference, with the brush tyre and with the imperfections of the robot.

#![allow(
    clippy::disallowed_methods,
    reason = "a test compares with another implementation"
)]

use plant::drive::{HARSH, NORMAL};
use plant::reference::Reference;
use plant::{Brush, PlantConfig, Tyre};

fn brush(stiffness: f64) -> PlantConfig {
    PlantConfig {
        tyre: Tyre::Brush(Brush {
            slip_stiffness: [[stiffness, 0.8 * stiffness], [1.2 * stiffness, stiffness]].into(),
            ..Brush::default()
        }),
        rolling_resistance: 0.01,
        ..PlantConfig::default()
    }
}

#[test]
fn brush_tyre_follows_the_reference() {
    let normal = [10.0, 20.0, 40.0].map(|stiffness| (NORMAL, stiffness));
    for (drive, stiffness) in normal.into_iter().chain([(HARSH, 20.0)]) {
        let [position, heading] = drive.error(&brush(stiffness), 2, 0.4).unwrap();
        println!("{} {stiffness}: {position} m, {heading} rad", drive.name);
        assert!(position < 5e-5, "{} {stiffness}: {position} m", drive.name);
        assert!(heading < 3e-4, "{} {stiffness}: {heading} rad", drive.name);
    }
}

fn imperfect_robot() -> PlantConfig {
    PlantConfig {
        static_excess: 0.2,
        side_slip: [0.02, -0.01].into(),
        carpet_drift: [0.02, -0.03],
        payload_kg: [0.8, 1.5].into(),
        payload_position_m: [[0.05, 0.04], [-0.06, 0.08]].into(),
        rigid_root_m: 0.03,
        rigid_tip_m: 0.05,
        clamp_angle_root_rad: 0.06,
        clamp_angle_tip_rad: -0.04,
        ..brush(20.0)
    }
}

#[test]
fn robot_with_imperfections_follows_the_reference() {
    for (drive, allowed) in [(NORMAL, [5e-5, 5e-4]), (HARSH, [1.5e-4, 8e-4])] {
        let [position, heading] = drive.error(&imperfect_robot(), 2, 0.4).unwrap();
        println!("{}: {position} m, {heading} rad", drive.name);
        assert!(position < allowed[0], "{}: {position} m", drive.name);
        assert!(heading < allowed[1], "{}: {heading} rad", drive.name);
    }
}

#[test]
fn robot_on_a_slope_follows_the_reference() {
    for downhill_rad in [0.0, 2.0, -2.5] {
        let config = PlantConfig {
            substeps: 4,
            slope_rad: 0.1,
            downhill_rad,
            ..imperfect_robot()
        };
        let [position, heading] = NORMAL.error(&config, 2, 0.4).unwrap();
        assert!(position < 3e-5, "{downhill_rad}: {position} m");
        assert!(heading < 5e-5, "{downhill_rad}: {heading} rad");
    }
}

#[test]
fn comparison_fails_if_an_imperfection_is_left_out() {
    type Remove = fn(&mut PlantConfig);
    let removals: [(&str, Remove); 6] = [
        ("side slip", |c| c.side_slip = [0.0].into()),
        ("carpet", |c| c.carpet_drift = [0.0; 2]),
        ("payload", |c| c.payload_kg = [0.0].into()),
        ("angles", |c| c.clamp_angle_root_rad = 0.0),
        ("lengths", |c| c.rigid_tip_m = 0.0),
        ("stiffness", |c| c.tyre = Tyre::brush(20.0)),
    ];
    let full = imperfect_robot();
    for (name, remove) in removals {
        let mut config = full.clone();
        remove(&mut config);
        let mut plant = config.build(2).unwrap();
        let whole = full.build(2).unwrap();
        let placed = [0, 1].map(|i| whole.axles()[i].posture);
        let mut reference = Reference::new(&full, &placed).unwrap();
        let from = [0, 1].map(|i| plant.axles()[i].posture);
        let start: Vec<_> = reference.postures().collect();
        let mut worst = 0.0f64;
        for k in 0..400 {
            let torque = NORMAL.torque(k as f64 * 1e-3, 2);
            plant.step(&torque);
            reference.advance(1e-3, 100, &torque);
        }
        for (i, q) in reference.postures().enumerate() {
            let p = plant.axles()[i].posture;
            for n in 0..2 {
                worst = worst.max((p[n] - from[i][n] - q[n] + start[i][n]).abs());
            }
        }
        println!("{name}: {worst}");
        assert!(worst > 1e-4, "{name}: {worst}");
    }
}

#[test]
fn chain_of_axles_follows_the_reference() {
    let creep = PlantConfig::default();
    // All constants that the reference covers differ from axle to axle, so that a swapped entry is found.
    let imperfect_robot = PlantConfig {
        tyre: Tyre::Brush(Brush {
            slip_stiffness: [[15.0, 20.0], [26.0, 18.0], [22.0, 30.0], [12.0, 16.0]].into(),
            ..Brush::default()
        }),
        slope_rad: 0.05,
        downhill_rad: 2.0,
        mass_kg: [4.5, 5.0, 4.0, 4.8].into(),
        yaw_inertia_kg_m2: [0.018, 0.02, 0.016, 0.022].into(),
        half_track_m: [0.162, 0.15, 0.17, 0.18].into(),
        wheel_radius_m: [
            [0.073, 0.072],
            [0.074, 0.075],
            [0.071, 0.073],
            [0.072, 0.07],
        ]
        .into(),
        payload_kg: [0.3, 1.5, 0.4, 0.8].into(),
        payload_position_m: [[0.0, 0.02], [0.05, 0.04], [-0.03, 0.0], [0.02, -0.05]].into(),
        rigid_root_m: 0.03,
        rigid_tip_m: 0.02,
        clamp_angle_root_rad: 0.03,
        clamp_angle_tip_rad: -0.04,
        side_slip: [0.01, -0.02, 0.015, 0.0].into(),
        carpet_drift: [0.02, -0.03],
        rolling_resistance: 0.01,
        static_excess: 0.2,
        ..PlantConfig::default()
    };
    for (axles, config, drive, allowed) in [
        (3, &creep, HARSH, [5e-6, 2e-4]),
        (4, &imperfect_robot, HARSH, [5e-5, 2e-4]),
        (5, &creep, NORMAL, [1e-6, 2e-5]),
    ] {
        let [position, heading] = drive.error(config, axles, 0.2).unwrap();
        let found = format!("{axles} axles, {}: {position} m, {heading} rad", drive.name);
        println!("{found}");
        assert!(position < allowed[0], "{found}");
        assert!(heading < allowed[1], "{found}");
    }
}
