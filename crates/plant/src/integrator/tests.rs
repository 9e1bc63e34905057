use super::*;
use crate::drive::NORMAL;

/// A middle axle without wheels on the ground and almost without mass joins two frames to one of the whole length.
#[test]
fn two_frames_with_a_free_middle_move_as_one_of_the_whole_length() {
    let whole = PlantConfig {
        sensing_mass_kg: 0.0,
        natural_slope_rad: 0.0,
        ..PlantConfig::default()
    };
    let halves = PlantConfig {
        strip_length_m: 0.5 * whole.strip_length_m,
        mass_kg: [4.76, 1e-6, 4.76].into(),
        yaw_inertia_kg_m2: [0.0186, 1e-9, 0.0186].into(),
        ..whole.clone()
    };
    let mut one = Plant::new(&whole.for_axles(2).unwrap());
    let mut two = Plant::new(&halves.for_axles(3).unwrap());
    (0..2).for_each(|side| two.lift_wheel(1, side));
    two.place([0.0; 3]);
    one.place([0.0; 3]);
    let mut worst = 0.0f64;
    let mut bend = 0.0f64;
    for k in 0..5000 {
        let torque = NORMAL.torque(k as f64 * TICK_S, 2);
        one.step(&torque);
        two.step(&[torque[0], [0.0; 2], torque[1]]);
        for (a, b) in [(0, 0), (1, 2)] {
            let (p, q) = (one.axles()[a].posture, two.axles()[b].posture);
            worst = worst.max(libm::hypot(p[0] - q[0], p[1] - q[1]));
            worst = worst.max(0.1 * (p[2] - q[2]).abs());
        }
        bend = bend.max(one.relative_posture(0)[2].abs());
    }
    println!("{worst} m, largest bend {bend} rad");
    assert!(bend > 0.8, "{bend}");
    assert!(worst < 2e-4, "{worst}");
}

#[test]
fn a_chain_steps_alike_with_and_without_vector_instructions() {
    for axles in 2..=MAX_AXLES {
        let mut fast = PlantConfig::default().build(axles).unwrap();
        let mut plain = fast.portable();
        for k in 0..500 {
            let torque = NORMAL.torque(k as f64 * TICK_S, axles);
            fast.step(&torque);
            plain.step(&torque);
            assert_eq!(fast.axles(), plain.axles(), "{axles} axles, step {k}");
        }
    }
}
