//! Effects of the robot's imperfections, compared with analytic results.

#![allow(
    clippy::disallowed_methods,
    reason = "a test compares with another implementation"
)]

use declare::Allowed;
use plant::{Brush, Creep, Plant, PlantConfig, TICK_S, Tyre};

const GRAVITY: f64 = 9.806_65;

fn brush() -> PlantConfig {
    PlantConfig {
        tyre: Tyre::Brush(Brush::default()),
        ..PlantConfig::default()
    }
}

/// Robot with all imperfections, larger than in a real robot.
fn imperfect_robot() -> PlantConfig {
    PlantConfig {
        friction: 0.6,
        static_excess: 0.2,
        rolling_resistance: 0.03,
        tyre: Tyre::Brush(Brush {
            slip_stiffness: [[15.0, 25.0], [28.0, 12.0]].into(),
            ..Brush::default()
        }),
        side_slip: [0.01, -0.02].into(),
        carpet_drift: [0.02, -0.01],
        radius_load_sensitivity: 0.01,
        payload_kg: [0.8, 1.5].into(),
        payload_position_m: [[0.05, 0.04], [-0.06, 0.08]].into(),
        center_of_mass_height_m: 0.08,
        backlash_rad: [[0.01, 0.02], [0.0, 0.015]].into(),
        cogging_torque_n_m: 0.03,
        cogging_phase_rad: [[0.3, 1.2], [2.0, -1.0]].into(),
        rigid_root_m: 0.005,
        rigid_tip_m: 0.008,
        clamp_angle_root_rad: 0.02,
        clamp_angle_tip_rad: -0.03,
        ..brush()
    }
}

/// Robot with brush tyres and a strip that is straight when unloaded.
fn straight() -> PlantConfig {
    PlantConfig {
        natural_slope_rad: 0.0,
        ..brush()
    }
}

fn build(config: &PlantConfig) -> Plant {
    config.build(2).expect("the configuration is valid")
}

fn run(plant: &mut Plant, steps: usize, torque: [[f64; 2]; 2]) {
    for _ in 0..steps {
        plant.step(&torque);
    }
}

fn wave(k: usize, amplitude: f64) -> [[f64; 2]; 2] {
    let t = k as f64 * 1e-3;
    let one = |rate: f64| amplitude * (rate * t).sin();
    [[one(2.1), one(3.7)], [one(4.3), one(1.3)]]
}

fn drive(plant: &mut Plant, steps: usize, amplitude: f64) {
    for k in 0..steps {
        plant.step(&wave(k, amplitude));
    }
}

/// The robot rolls down a slope with its motors off. An accelerometer reads the acceleration minus gravity along the
/// floor.
#[test]
fn robot_on_a_slope_accelerates_like_a_rolling_body() {
    let config = PlantConfig {
        slope_rad: 5f64.to_radians(),
        downhill_rad: std::f64::consts::PI,
        ..straight()
    };
    let mut plant = build(&config);
    let weight: f64 = plant.axles().iter().flat_map(|axle| axle.load).sum();
    let mass = 2.0 * 4.76 + 0.6;
    assert!((weight - mass * GRAVITY * 5f64.to_radians().cos()).abs() < 1e-9);
    run(&mut plant, 500, [[0.0; 2]; 2]);
    let downhill = GRAVITY * 5f64.to_radians().sin();
    let rolling = mass + 4.0 * 0.004 / 0.073f64.powi(2);
    let expected = -downhill * mass / rolling;
    for axle in plant.axles() {
        // The tyres creep, so the robot is slightly slower.
        let speed = axle.velocity[0] / (0.5 * expected);
        assert!((speed - 1.0).abs() < 5e-3, "{speed}");
        let felt = axle.acceleration[0] - (expected + downhill);
        assert!(felt.abs() < 5e-3, "{felt}");
    }
}

/// The front wheels pull the braked rear wheels. At constant speed each tyre's force is its torque over the radius. Its
/// slip is the force over C·N, enlarged as the force nears the friction limit.
#[test]
fn braked_and_driven_wheels_slip_by_their_stiffness() {
    let stiffness = [17.5, 27.5];
    let config = PlantConfig {
        tyre: Tyre::Brush(Brush {
            slip_stiffness: stiffness.map(|both| [both; 2]).into(),
            ..Brush::default()
        }),
        sensing_mass_kg: 1.0,
        ..straight()
    };
    for torque in [0.05, 0.3, 0.7] {
        let mut plant = build(&config);
        run(&mut plant, 700, [[0.25; 2]; 2]);
        run(&mut plant, 600, [[torque; 2], [-torque; 2]]);
        for (i, axle) in plant.axles().iter().enumerate() {
            let speed = axle.velocity[0];
            let rolling = 0.073 * axle.wheel_speed[0];
            let slip = (rolling - speed) / rolling;
            let force = if i == 0 { torque } else { -torque } / 0.073;
            let load = [4.76, 5.76][i] * GRAVITY / 2.0;
            let share = force.abs() / (0.7 * load);
            let expected = force / (stiffness[i] * load) / (1.0 - share);
            assert!(speed > 0.3);
            let share = slip / expected;
            assert!((share - 1.0).abs() < 0.01, "{torque} {i}: {share}");
        }
    }
}

/// The motors bend the robot, then hold the wheel angles. On tyres of constant creep the frame straightens slowly.
#[test]
fn bent_robot_at_rest_stays_bent_on_brush_tyres() {
    let left = |config: &PlantConfig| {
        let mut plant = build(config);
        for k in 0..1500 {
            let steer = 0.25 * f64::from(k) / 1500.0;
            plant.step(&[[-steer, steer], [steer, -steer]]);
        }
        let held = [0, 1].map(|i| plant.axles()[i].wheel_angle);
        let mut hold = |steps: usize| {
            for _ in 0..steps {
                let axle = plant.axles();
                plant.step(&[0, 1].map(|i| {
                    [0, 1].map(|side| {
                        let error = held[i][side] - axle[i].wheel_angle[side];
                        50.0 * error - 0.4 * axle[i].wheel_speed[side]
                    })
                }));
            }
            plant.relative_posture(0)[2]
        };
        let before = hold(500);
        assert!(before > 0.2, "{before}");
        hold(5000) / before
    };
    let (creeping, brushed) = (left(&PlantConfig::default()), left(&brush()));
    println!("{creeping} {brushed}");
    assert!(creeping < 0.9, "{creeping}");
    assert!(brushed > 0.99, "{brushed}");
}

/// Motors are off. With steps of 1 ms, energy may rise within the step's velocity tolerance as the robot comes to rest.
#[test]
fn energy_never_grows() {
    let config = PlantConfig {
        cogging_torque_n_m: 0.0,
        // No load transfer: its lag is no part of the energy balance.
        center_of_mass_height_m: 0.0,
        ..imperfect_robot()
    };
    for (config, substeps, allowed) in [
        (PlantConfig::default(), 1, 1e-6),
        (brush(), 1, 1e-6),
        (config.clone(), 1, 2e-5),
        (config, 4, 1e-6),
    ] {
        for amplitude in [0.3, 1.5] {
            let mut plant = build(&PlantConfig {
                substeps,
                ..config.clone()
            });
            let count = |seconds: f64| (seconds / TICK_S).round() as usize;
            drive(&mut plant, count(0.9), amplitude);
            let start = plant.energy();
            let mut last = start;
            for _ in 0..count(2.0) {
                plant.step(&[[0.0; 2]; 2]);
                let energy = plant.energy();
                assert!(energy <= last + allowed, "{last} {energy}");
                last = energy;
            }
            assert!(last < start);
        }
    }
}

/// Sums linear and angular momentum of two axles and two payloads.
#[test]
fn momentum_is_conserved_without_friction() {
    conserves_momentum([2.0, 3.0], 1e-3);
    conserves_momentum([0.0; 2], 1e-9);
}

fn conserves_momentum(payload_kg: [f64; 2], allowed: f64) {
    let config = PlantConfig {
        payload_kg: payload_kg.into(),
        payload_position_m: [[0.06, 0.1], [-0.05, -0.12]].into(),
        clamp_angle_root_rad: 0.1,
        clamp_angle_tip_rad: -0.05,
        rigid_root_m: 0.03,
        rigid_tip_m: 0.05,
        ..brush()
    };
    let mut moving = build(&config);
    drive(&mut moving, 1500, 0.8);
    let mut free = moving.without_friction();
    let momentum = |plant: &Plant| {
        let mut p = [0.0; 3];
        let mut add = |mass: f64, [x, y]: [f64; 2], [vx, vy]: [f64; 2]| {
            p[0] += mass * vx;
            p[1] += mass * vy;
            p[2] += mass * (x * vy - y * vx);
        };
        let mut spin = 0.0;
        for (i, a) in plant.axles().iter().enumerate() {
            let [x, y, phi] = a.posture;
            let [u, v, w] = a.velocity;
            let (s, c) = phi.sin_cos();
            let velocity = [c * u - s * v, s * u + c * v];
            add([4.76, 5.36][i], [x, y], velocity);
            let [ahead, aside] = config.payload_position_m[i];
            let (dx, dy) = (c * ahead - s * aside, s * ahead + c * aside);
            let payload_velocity = [velocity[0] - w * dy, velocity[1] + w * dx];
            add(config.payload_kg[i], [x + dx, y + dy], payload_velocity);
            spin += config.yaw_inertia_kg_m2[i] * w;
        }
        p[2] += spin;
        p
    };
    let (before, energy) = (momentum(&free), free.energy());
    let force = free.wrench(0).force;
    assert!(force[0].hypot(force[1]) > 0.5);
    run(&mut free, 1000, [[0.0; 2]; 2]);
    let after = momentum(&free);
    println!("{before:?} {after:?}");
    assert!(free.axles()[0].velocity[2].abs() > 0.1);
    for (n, allowed) in [allowed, allowed, 2e-3].into_iter().enumerate() {
        assert!((before[n] - after[n]).abs() < allowed, "{n}");
    }
    assert!(free.energy() < energy);
}

#[test]
fn payloads_load_the_wheels_by_the_lever_rule() {
    let config = PlantConfig {
        payload_kg: [0.0, 2.0].into(),
        payload_position_m: [[0.0; 2], [0.185, 0.081]].into(),
        rigid_root_m: 0.02,
        rigid_tip_m: 0.01,
        ..brush()
    };
    let load = [0, 1].map(|i| build(&config).axles()[i].load);
    // Both axles share the payload's weight. The payload is half way to the left wheel: the right wheel bears a
    // quarter.
    let ahead = 2.0 * 0.185 / 0.4;
    let front = 4.76 + ahead;
    let rear = 5.36 + 2.0 - ahead;
    let left = rear / 2.0 + 2.0 * 0.25;
    let expected = [[front / 2.0; 2], [left, rear - left]];
    for i in 0..2 {
        for side in 0..2 {
            assert!((load[i][side] - GRAVITY * expected[i][side]).abs() < 1e-9);
        }
    }
}

#[test]
fn loads_add_up_to_the_weight_with_a_lifted_wheel() {
    let config = PlantConfig {
        center_of_mass_height_m: 0.5,
        friction: 1.5,
        ..imperfect_robot()
    };
    let mut plant = build(&config);
    let weight = (2.0 * 4.76 + 0.6 + 2.3) * GRAVITY;
    let (mut lifted, mut moved) = (0, 0.0f64);
    for k in 0..6000 {
        plant.step(&wave(k, 1.5));
        let load = [0, 1].map(|i| plant.axles()[i].load);
        let sum: f64 = load.iter().flatten().sum();
        assert!((sum - weight).abs() < 1e-9, "{sum} {weight}");
        assert!(load.iter().flatten().all(|l| *l >= 0.0));
        lifted += load.iter().flatten().filter(|l| **l == 0.0).count();
        moved = moved.max((load[0][0] - load[0][1]).abs());
    }
    assert!(lifted > 0 && moved > 5.0, "{lifted} {moved}");
}

#[test]
fn radius_falls_with_the_load() {
    let config = PlantConfig {
        radius_load_sensitivity: 0.02,
        payload_kg: [2.38, 2.68].into(),
        ..brush()
    };
    let mut plant = build(&config);
    run(&mut plant, 1000, [[0.2; 2]; 2]);
    run(&mut plant, 500, [[0.0; 2]; 2]);
    for axle in plant.axles() {
        // Every load is 1.5 times the load without payload.
        let radius = axle.velocity[0] / axle.wheel_speed[0];
        assert!((radius / 0.073 - 0.99).abs() < 5e-5, "{radius}");
    }
}

/// Side slip: motion aside per motion ahead. Carpet drift: displacement along the floor per distance rolled.
#[test]
fn side_slip_and_carpet_drift_are_shares_of_the_distance() {
    let aside = PlantConfig {
        side_slip: [0.004; 2].into(),
        ..straight()
    };
    let mut plant = build(&aside);
    run(&mut plant, 2000, [[0.1; 2]; 2]);
    let [x, y, phi] = plant.midpoint();
    assert!(x > 0.5 && phi.abs() < 1e-4, "{x} {phi}");
    assert!((y / x - 0.004).abs() < 4e-5, "{}", y / x);

    let flat = straight();
    let carpet = PlantConfig {
        carpet_drift: [0.006, -0.003],
        ..flat.clone()
    };
    for (heading, torque) in [(0.0, 0.1), (1.3, 0.1), (1.3, -0.1), (-2.5, 0.1)] {
        // The same drive on a floor without drift gives the loss due to driving slip, which is subtracted.
        let [[x, y], [u, v]] = [&carpet, &flat].map(|config| {
            let mut plant = build(config);
            plant.place([0.0, 0.0, heading]);
            run(&mut plant, 2000, [[torque; 2]; 2]);
            let rolled = 0.073 * plant.axles()[1].wheel_angle[0];
            assert!(rolled.abs() > 0.5);
            let [x, y, _] = plant.midpoint();
            let (s, c) = heading.sin_cos();
            [x - c * rolled, y - s * rolled].map(|way| way / rolled.abs())
        });
        // Carpet drift fades below 0.05 rad/s of wheel speed, so a little drift is missing after the start.
        assert!((x - u - 0.006).abs() < 1e-4, "{heading} {}", x - u);
        assert!((y - v + 0.003).abs() < 1e-4, "{heading} {}", y - v);
    }
}

/// Unloaded, the strip is straight, and the clamps set the angles of the axles.
#[test]
fn clamps_set_the_unloaded_posture() {
    let config = PlantConfig {
        rigid_root_m: 0.02,
        rigid_tip_m: 0.03,
        clamp_angle_root_rad: 0.05,
        clamp_angle_tip_rad: -0.02,
        ..straight()
    };
    let mut plant = build(&config);
    plant.place([0.5, -0.2, 2.0]);
    let [x, y, turn] = plant.relative_posture(0);
    assert!((x - 0.42 * 0.05f64.cos()).abs() < 1e-9 && (y - 0.42 * 0.05f64.sin()).abs() < 1e-9);
    assert!((turn - 0.07).abs() < 1e-12);
    run(&mut plant, 500, [[0.0; 2]; 2]);
    let [x, y, phi] = plant.midpoint();
    assert!((x - 0.5).abs() < 1e-9 && (y + 0.2).abs() < 1e-9 && (phi - 2.0).abs() < 1e-9);
    let force = plant.wrench(0).force;
    assert!(force[0].hypot(force[1]) < 1e-6);
    for s in [0.0, 0.1, 0.37] {
        assert!(plant.curvature(0, s).abs() < 1e-9);
    }
    // Aligned axles bend the strip by the difference of the clamp angles. The outline ends at the axles.
    drive(&mut plant, 1500, 0.5);
    let mut curve = [[0.0; 2]; 50];
    plant.draw(&plant.outline(0, 50), &mut curve);
    let [front, rear] = [0, 1].map(|i| plant.axles()[i].posture);
    assert!((curve[0][0] - rear[0]).abs() < 1e-12 && (curve[0][1] - rear[1]).abs() < 1e-12);
    assert!((curve[49][0] - front[0]).hypot(curve[49][1] - front[1]) < 1e-6);
    let sum: f64 = (0..2000)
        .map(|k| plant.curvature(0, (f64::from(k) + 0.5) * 0.37 / 2000.0) * 0.37 / 2000.0)
        .sum();
    let turn = plant.relative_posture(0)[2];
    assert!(turn.abs() > 0.1 && (sum - turn + 0.07).abs() < 1e-4);
}

/// At a reversal the motor crosses the backlash under its torque alone while the wheel rolls on.
#[test]
fn reversed_motor_crosses_its_backlash() {
    let (backlash, torque) = (0.02f64, 0.3);
    let config = PlantConfig {
        backlash_rad: [[backlash; 2]; 2].into(),
        ..brush()
    };
    let mut plant = build(&config);
    run(&mut plant, 600, [[torque; 2]; 2]);
    let gap = |plant: &Plant| {
        let axle = plant.axles()[0];
        axle.motor_angle[0] - axle.wheel_angle[0]
    };
    assert!((gap(&plant) - 0.5 * backlash).abs() < 1e-9);
    let speed = plant.axles()[0].wheel_speed[0];
    let mut crossing = 0;
    let mut rolling = speed;
    while gap(&plant) > -0.5 * backlash + 1e-9 {
        // The wheel is not driven: its speed changes only by recovery of the tyre's slip.
        assert!((rolling - speed).abs() < 0.2, "{rolling} {speed}");
        plant.step(&[[-torque; 2]; 2]);
        rolling = plant.axles()[0].wheel_speed[0];
        crossing += 1;
        assert!(crossing < 100);
    }
    let expected = 1e3 * (2.0 * backlash * 0.003 / torque).sqrt();
    let late = f64::from(crossing) - expected;
    assert!(late.abs() < 2.5, "{crossing} {expected}");
    // After the backlash, motor and wheel turn together on the other flank.
    run(&mut plant, 300, [[-torque; 2]; 2]);
    assert!((gap(&plant) + 0.5 * backlash).abs() < 1e-9);
}

/// Motor and wheel together gain the impulse of the motor's torque, with teeth in contact or apart.
#[test]
fn backlash_conserves_angular_momentum() {
    let config = PlantConfig {
        backlash_rad: [[0.03, 0.01], [0.02, 0.0]].into(),
        ..brush()
    };
    let mut plant = build(&config).without_friction();
    let mut given = [[0.0; 2]; 2];
    let mut apart = 0;
    for k in 0..4000 {
        plant.step(&wave(k, 0.05));
        for (i, axle) in plant.axles().iter().enumerate() {
            for side in 0..2 {
                given[i][side] += 1e-3 * axle.torque[side];
                let has = 0.003 * axle.motor_speed[side] + 0.001 * axle.wheel_speed[side];
                assert!((has - given[i][side]).abs() < 1e-9, "{k} {has} {given:?}");
                let gap = axle.motor_angle[side] - axle.wheel_angle[side];
                assert!(gap.abs() <= 0.5 * config.backlash_rad[i][side] + 1e-12);
                apart += usize::from(axle.motor_speed[side] != axle.wheel_speed[side]);
            }
        }
    }
    assert!(apart > 100, "{apart}");
}

/// Over whole periods cogging does no work. Cogging faster than the steps averages out.
#[test]
fn mean_of_the_cogging_is_zero() {
    let config = PlantConfig {
        cogging_torque_n_m: 0.02,
        cogging_periods: 30.0,
        cogging_phase_rad: [[0.0, 1.0], [2.0, 3.0]].into(),
        ..brush()
    };
    let mut plant = build(&config);
    run(&mut plant, 300, [[0.1; 2]; 2]);
    let turn = std::f64::consts::TAU;
    let first = plant.axles()[0].wheel_angle[0];
    let (mut work, mut largest) = (0.0, 0.0f64);
    while plant.axles()[0].wheel_angle[0] < first + turn {
        let before = plant.axles()[0].wheel_angle[0];
        plant.step(&[[0.1; 2]; 2]);
        let axle = plant.axles()[0];
        let cogging = axle.torque[0] - 0.1;
        work += cogging * (axle.wheel_angle[0] - before);
        largest = largest.max(cogging.abs());
    }
    assert!((0.0195..=0.02).contains(&largest), "{largest}");
    assert!(work.abs() < 0.01 * 0.02 * turn, "{work}");

    let fast = PlantConfig {
        cogging_periods: 20_000.0,
        ..config
    };
    let mut plant = build(&fast);
    run(&mut plant, 1000, [[0.1; 2]; 2]);
    let axle = plant.axles()[0];
    assert!(0.001 * 20_000.0 * axle.wheel_speed[0] > turn);
    assert!((axle.torque[0] - 0.1).abs() < 0.005);
}

/// Compares vector and portable code, also during snap-through and stick-slip.
#[test]
fn vector_and_portable_code_agree_to_the_bit() {
    let soft = PlantConfig {
        bending_stiffness_n_m2: 0.05,
        static_excess: 0.2,
        rolling_resistance: 0.01,
        ..PlantConfig::default()
    };
    let mut snaps = 0;
    for (config, amplitude) in [
        (imperfect_robot(), 0.6),
        (PlantConfig::default(), 0.4),
        (soft, 1.6),
    ] {
        let mut one = build(&config);
        let mut other = one.portable();
        for k in 0..8000 {
            let torque = wave(k, amplitude);
            one.step(&torque);
            other.step(&torque);
            assert_eq!(one.axles(), other.axles(), "step {k}");
            assert_eq!(one.wrench(0), other.wrench(0), "step {k}");
        }
        snaps += one.health().snap_throughs;
    }
    assert!(snaps > 0);
}

#[test]
fn copied_plant_and_placed_plant_repeat_to_the_bit() {
    for config in [imperfect_robot(), PlantConfig::default()] {
        let run = |plant: &mut Plant| {
            drive(plant, 1500, 0.6);
            plant.axles().to_vec()
        };
        let mut used = build(&config);
        run(&mut used);
        let mut copy = used.clone();
        assert_eq!(run(&mut used), run(&mut copy));
        used.place([0.0; 3]);
        assert_eq!(run(&mut used), run(&mut build(&config)));
    }
}

#[test]
fn invalid_constant_is_refused_by_name() {
    type Invalidate = fn(&mut PlantConfig);
    let invalid: [(&str, Invalidate); 21] = [
        ("mass_kg[1]", |c| c.mass_kg.entries_mut()[1] = f64::NAN),
        ("strip_length_m", |c| c.strip_length_m = 0.0),
        ("wheel_radius_m[0][1]", |c| {
            c.wheel_radius_m.entries_mut()[0][1] = -0.07
        }),
        ("friction", |c| c.friction = f64::INFINITY),
        ("axial_stiffness_n", |c| c.axial_stiffness_n = 1e8 * 1e9),
        ("substeps", |c| c.substeps = 0),
        ("tyre.brush.slip_stiffness[1][0]", |c| {
            c.tyre = Tyre::Brush(Brush {
                slip_stiffness: [[20.0; 2], [0.0, 20.0]].into(),
                ..Brush::default()
            })
        }),
        ("tyre.brush.rest_velocity_m_s", |c| {
            c.tyre = Tyre::Brush(Brush {
                rest_velocity_m_s: 0.0,
                ..Brush::default()
            })
        }),
        ("tyre.creep.velocity_m_s", |c| {
            c.tyre = Tyre::Creep(Creep {
                velocity_m_s: f64::NAN,
            })
        }),
        ("side_slip[0]", |c| c.side_slip.entries_mut()[0] = 0.5),
        ("carpet_drift[1]", |c| c.carpet_drift[1] = f64::NAN),
        ("radius_load_sensitivity", |c| {
            c.radius_load_sensitivity = -0.1
        }),
        ("payload_kg[0]", |c| c.payload_kg.entries_mut()[0] = -1.0),
        ("payload_position_m[0][1]", |c| {
            c.payload_kg.entries_mut()[0] = 10.0;
            c.payload_position_m.entries_mut()[0][1] = 0.3;
        }),
        ("payload_position_m[1][0]", |c| {
            c.payload_kg.entries_mut()[1] = 10.0;
            c.payload_position_m.entries_mut()[1][0] = 0.6;
        }),
        ("backlash_rad[0][1]", |c| {
            c.backlash_rad.entries_mut()[0][1] = 1.0
        }),
        ("rotor_inertia_share", |c| c.rotor_inertia_share = 1.0),
        ("cogging_torque_n_m", |c| {
            c.cogging_torque_n_m = f64::INFINITY
        }),
        ("cogging_periods", |c| c.cogging_periods = 0.0),
        ("cogging_phase_rad[1][1]", |c| {
            c.cogging_phase_rad.entries_mut()[1][1] = 99.0
        }),
        ("clamp_angle_tip_rad", |c| c.clamp_angle_tip_rad = 0.7),
    ];
    for (field, invalidate) in invalid {
        let mut config = PlantConfig::default().for_axles(2).unwrap();
        invalidate(&mut config);
        let error = config.build(2).unwrap_err();
        let text = error.to_string();
        assert!(text.starts_with(&format!("{field} = ")), "{text}");
        let Allowed::Range(low, high) = error.allowed else {
            panic!("{text}");
        };
        assert!(low < high && !(error.value >= low && error.value <= high));
    }
}
