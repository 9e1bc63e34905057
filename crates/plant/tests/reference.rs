//! The plant against the explicit reference, with the brush tyre and with everything that makes the
//! robot other than its drawing.

use plant::reference::Reference;
use plant::{PlantConfig, Tyre};

/// Torques of a drive: amplitudes (N m) and rates (rad/s) of what is common to all wheels and of
/// what turns the axles against each other.
type Drive = [[f64; 2]; 2];
const NORMAL: Drive = [[0.15, 1.3], [0.4, 0.9]];
const HARSH: Drive = [[1.2, 2.0], [1.0, 3.1]];

fn torque([base, steer]: Drive, t: f64) -> [[f64; 2]; 2] {
    let wave = |[amplitude, rate]: [f64; 2]| amplitude * (rate * t).sin();
    let (base, steer) = (wave(base), wave(steer));
    [[base - steer, base + steer], [base + steer, base - steer]]
}

/// Largest distance (m) and difference of heading (rad) over `steps` of 1 ms, the reference taking
/// `fine` steps in each.
fn compare(drive: Drive, config: &PlantConfig, steps: usize, fine: usize) -> [f64; 2] {
    let mut plant = config.build().unwrap();
    let mut reference = Reference::new(config, plant.state().axle.map(|a| a.posture));
    let mut worst = [0.0f64; 2];
    for k in 0..steps {
        let torque = torque(drive, k as f64 * 1e-3);
        plant.step(torque);
        reference.advance(1e-3, fine, torque);
        for (axle, q) in plant.state().axle.iter().zip(reference.postures()) {
            let p = axle.posture;
            worst[0] = worst[0].max((p[0] - q[0]).hypot(p[1] - q[1]));
            worst[1] = worst[1].max((p[2] - q[2]).abs());
        }
    }
    assert!(!reference.lost);
    worst
}

fn brush(stiffness: f64) -> PlantConfig {
    PlantConfig {
        tyre: Tyre::Brush,
        slip_stiffness: [[stiffness, 0.8 * stiffness], [1.2 * stiffness, stiffness]],
        rolling_resistance: 0.01,
        ..PlantConfig::default()
    }
}

#[test]
fn brush_tyre_follows_the_reference() {
    for (drive, stiffness) in [
        (NORMAL, 10.0),
        (NORMAL, 20.0),
        (NORMAL, 40.0),
        (HARSH, 20.0),
    ] {
        let [position, heading] = compare(drive, &brush(stiffness), 400, 100);
        println!("{drive:?} {stiffness}: {position} m, {heading} rad");
        assert!(position < 5e-5, "{drive:?} {stiffness}: {position} m");
        assert!(heading < 3e-4, "{drive:?} {stiffness}: {heading} rad");
    }
}

fn crooked() -> PlantConfig {
    PlantConfig {
        static_excess: 0.2,
        side_slip: [0.02, -0.01],
        carpet_drift: [0.02, -0.03],
        payload_kg: [0.8, 1.5],
        payload_position_m: [[0.05, 0.04], [-0.06, 0.08]],
        rigid_root_m: 0.03,
        rigid_tip_m: 0.05,
        clamp_angle_root_rad: 0.06,
        clamp_angle_tip_rad: -0.04,
        ..brush(20.0)
    }
}

#[test]
fn a_crooked_robot_follows_the_reference() {
    for (drive, allowed) in [(NORMAL, [5e-5, 5e-4]), (HARSH, [1.5e-4, 8e-4])] {
        let [position, heading] = compare(drive, &crooked(), 400, 100);
        println!("{drive:?}: {position} m, {heading} rad");
        assert!(position < allowed[0], "{drive:?}: {position} m");
        assert!(heading < allowed[1], "{drive:?}: {heading} rad");
    }
}

/// Each of them matters to that comparison: left out of the plant, it fails.
#[test]
fn the_reference_sees_each_imperfection() {
    type Mend = fn(&mut PlantConfig);
    let mended: [(&str, Mend); 6] = [
        ("side slip", |c| c.side_slip = [0.0; 2]),
        ("carpet", |c| c.carpet_drift = [0.0; 2]),
        ("payload", |c| c.payload_kg = [0.0; 2]),
        ("angles", |c| c.clamp_angle_root_rad = 0.0),
        ("lengths", |c| c.rigid_tip_m = 0.0),
        ("stiffness", |c| c.slip_stiffness = [[20.0; 2]; 2]),
    ];
    let full = crooked();
    for (name, mend) in mended {
        let mut config = full.clone();
        mend(&mut config);
        let mut plant = config.build().unwrap();
        let mut reference =
            Reference::new(&full, full.build().unwrap().state().axle.map(|a| a.posture));
        let from = plant.state().axle.map(|a| a.posture);
        let start = reference.postures();
        let mut worst = 0.0f64;
        for k in 0..400 {
            let torque = torque(NORMAL, k as f64 * 1e-3);
            plant.step(torque);
            reference.advance(1e-3, 100, torque);
        }
        for i in 0..2 {
            let (p, q) = (plant.state().axle[i].posture, reference.postures()[i]);
            for n in 0..2 {
                worst = worst.max((p[n] - from[i][n] - q[n] + start[i][n]).abs());
            }
        }
        println!("{name}: {worst}");
        assert!(worst > 1e-4, "{name}: {worst}");
    }
}
