use super::*;
use crate::drive::NORMAL;

/// A middle axle without mass or ground contact joins two frames into one frame of twice the length.
#[test]
fn two_frames_with_a_free_middle_axle_move_as_one_long_frame() {
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

/// Constants that differ from axle to axle and from wheel to wheel, with every imperfection of the plant.
fn imperfect(axles: usize) -> PlantConfig {
    let wheels = |first: f64, step: f64| {
        let both = |i: usize| [first + step * i as f64, first - step * (i as f64 + 0.5)];
        crate::PerAxle::try_from((0..axles).map(both).collect::<Vec<_>>()).unwrap()
    };
    let each = |first: f64, step: f64| {
        let one = |i: usize| first + step * i as f64;
        crate::PerAxle::try_from((0..axles).map(one).collect::<Vec<_>>()).unwrap()
    };
    PlantConfig {
        tyre: crate::Tyre::Brush(crate::Brush {
            slip_stiffness: wheels(20.0, 1.5),
            ..crate::Brush::default()
        }),
        mass_kg: each(4.76, -0.1),
        yaw_inertia_kg_m2: each(0.0186, 0.001),
        half_track_m: each(0.162, 0.004),
        wheel_radius_m: wheels(0.073, 5e-4),
        static_excess: 0.2,
        rolling_resistance: 0.02,
        side_slip: each(0.002, -0.003),
        carpet_drift: [0.005, -0.005],
        radius_load_sensitivity: 1e-3,
        slope_rad: 0.1,
        downhill_rad: 2.0,
        payload_kg: each(0.2, 0.1),
        payload_position_m: wheels(0.01, 0.005),
        center_of_mass_height_m: 0.08,
        current_loop_time_s: 2e-3,
        backlash_rad: wheels(0.02, 0.002),
        cogging_torque_n_m: 0.02,
        cogging_phase_rad: wheels(0.3, 0.7),
        rigid_root_m: 5e-3,
        rigid_tip_m: 0.01,
        clamp_angle_root_rad: 0.02,
        clamp_angle_tip_rad: -0.03,
        ..PlantConfig::default()
    }
}

/// Weight of the robot into the floor, N.
fn weight(plant: &Plant) -> f64 {
    let mass: f64 = plant.bodies.iter().map(|body| body.mass).sum();
    mass * 9.806_65 * libm::cos(0.1)
}

#[test]
fn chain_with_angled_clamps_is_placed_without_force_at_its_posture() {
    for axles in 2..=MAX_AXLES {
        let config = PlantConfig {
            clamp_angle_root_rad: 0.1,
            clamp_angle_tip_rad: -0.05,
            rigid_root_m: 0.02,
            rigid_tip_m: 0.03,
            ..PlantConfig::default()
        };
        let mut plant = config.build(axles).unwrap();
        let wanted = [1.0, -2.0, 0.7];
        plant.place(wanted);
        let is_there = |plant: &Plant| {
            let found = plant.midpoint();
            (0..3).all(|n| (found[n] - wanted[n]).abs() < 1e-9)
        };
        assert!(is_there(&plant), "{axles} axles: {:?}", plant.midpoint());
        for frame in 0..plant.frame_count() {
            let wrench = plant.wrench(frame);
            let most = wrench.force[0]
                .abs()
                .max(wrench.force[1].abs())
                .max(wrench.root_moment.abs());
            assert!(most < 1e-5, "{axles} axles, frame {frame}: {wrench:?}");
            // The angle between neighbouring axles follows from the clamps.
            assert!((plant.relative_posture(frame)[2] - 0.15).abs() < 1e-9);
        }
        (0..100).for_each(|_| plant.step(&[]));
        assert!(is_there(&plant), "{axles} axles: {:?}", plant.midpoint());
    }
}

#[test]
fn chain_is_bit_identical_without_vector_instructions_and_loads_sum_to_weight() {
    for axles in 2..=MAX_AXLES {
        let mut fast = imperfect(axles).build(axles).unwrap();
        let mut plain = fast.portable();
        for k in 0..500 {
            let torque = NORMAL.torque(k as f64 * TICK_S, axles);
            fast.step(&torque);
            plain.step(&torque);
            assert_eq!(fast.axles(), plain.axles(), "{axles} axles, step {k}");
            let loads = fast.axles().iter().flat_map(|axle| axle.load);
            assert!(
                loads.clone().all(|load| load >= 0.0),
                "{axles} axles, step {k}"
            );
            let (loads, weight) = (loads.sum::<f64>(), weight(&fast));
            assert!(
                (loads - weight).abs() < 1e-9 * weight,
                "{axles} axles, step {k}"
            );
        }
    }
}

/// Solves a linear system by elimination with pivots.
fn dense(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for k in 0..n {
        let pivot = (k..n).max_by(|i, j| a[*i][k].abs().total_cmp(&a[*j][k].abs()));
        a.swap(k, pivot.unwrap());
        b.swap(k, pivot.unwrap());
        for i in k + 1..n {
            let factor = a[i][k] / a[k][k];
            for j in k..n {
                a[i][j] -= factor * a[k][j];
            }
            b[i] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|j| a[k][j] * b[j]).sum();
        b[k] = (b[k] - known) / a[k][k];
    }
    b
}

/// Compares the solution by blocks with the solution of the whole system (M + h·D + Jᵀ·K·J)·x = h·b. A column of J is
/// the rate of the frame's end for a unit velocity of an axle.
fn solution_is_that_of_the_whole_system<const N: usize, const F: usize, const G: usize>() {
    let mut plant = PlantConfig::default().build(N).unwrap();
    for k in 0..700 {
        plant.step(&NORMAL.torque(k as f64 * TICK_S, N));
    }
    let h = GAMMA * TICK_S;
    let (groups, frames): (&[Group; G], &[Frame; F]) = (sized(&plant.groups), sized(&plant.frames));
    let bodies: &[Body; N] = sized(&plant.bodies);
    let contact = |g: usize| {
        let mut v = [[0.0; 3]; N];
        let mut speed = [0.0; 4];
        for (i, axle) in plant.axles.iter().enumerate() {
            v[i] = axle.velocity;
            if i / 2 == g {
                speed[2 * (i % 2)..][..2].copy_from_slice(&axle.wheel_speed);
            }
        }
        let hub = groups[g].wheels.hub(&pair(&v, 2 * g));
        groups[g]
            .wheels
            .contact(&hub, Narrow::load(&speed), &groups[g].conditions)
    };
    let now: [_; G] = std::array::from_fn(contact);
    let implicit = Implicit::<Narrow, N, F, G>::new((groups, bodies, frames), &now, h);
    let geometry: [_; F] = std::array::from_fn(|f| frames[f].geometry);
    let load: [Vec3; N] = std::array::from_fn(|i| [1.0 + i as f64, -0.5, 0.2 * (i as f64 - 1.0)]);
    let found = implicit.solve(&geometry, &load);

    let mut a = vec![vec![0.0; 3 * N]; 3 * N];
    for (i, body) in bodies.iter().enumerate() {
        let damping = groups[i / 2].wheels.damping(&implicit.wheels[i / 2])[i % 2];
        let block = body.with_damping(&damping.map(|d| h * d));
        for m in 0..3 {
            a[3 * i + m][3 * i..3 * i + 3].copy_from_slice(&block[m]);
        }
    }
    for (f, frame) in frames.iter().enumerate() {
        let rate = |n: usize| {
            let mut v = [[0.0; 3]; 2];
            v[n / 3][n % 3] = 1.0;
            frame.geometry.rate(&v)
        };
        let k = frame.response(h);
        for m in 0..6 {
            for n in 0..6 {
                let (left, right) = (rate(m), times(&k, &rate(n)));
                a[3 * f + m][3 * f + n] += (0..3).map(|i| left[i] * right[i]).sum::<f64>();
            }
        }
    }
    let expected = dense(a, load.as_flattened().iter().map(|b| h * b).collect());
    let scale = expected.iter().fold(0.0f64, |most, x| most.max(x.abs()));
    for (found, expected) in found.as_flattened().iter().zip(&expected) {
        assert!(
            (found - expected).abs() < 1e-9 * scale,
            "{N} axles: {found} {expected}"
        );
    }
}

#[test]
fn elimination_of_the_frames_solves_the_whole_system() {
    solution_is_that_of_the_whole_system::<2, 1, 1>();
    solution_is_that_of_the_whole_system::<3, 2, 2>();
    solution_is_that_of_the_whole_system::<4, 3, 2>();
    solution_is_that_of_the_whole_system::<5, 4, 3>();
}

/// The tyres can buckle these soft strips: while one frame creeps, parts of steps are rejected because of another
/// frame.
#[test]
fn chains_snap_through_without_failure_and_keep_their_energy_bounded() {
    let config = PlantConfig {
        bending_stiffness_n_m2: 0.05,
        ..PlantConfig::default()
    };
    for axles in [3, 4, 5] {
        let mut snaps = 0;
        for n in 0..6 {
            let phase = |k: usize| libm::sin(1.7 * n as f64 + 2.3 * k as f64);
            let wave = |k: usize, t: f64| {
                let rate = 1.5 + 4.0 * phase(k + 4).abs();
                1.6 * phase(k).abs() * libm::sin(rate * t + 6.0 * phase(k + 8))
            };
            let mut plant = config.build(axles).unwrap();
            for k in 0..6000 {
                let t = k as f64 * TICK_S;
                let torque: Vec<_> = (0..axles)
                    .map(|i| [wave(2 * i, t), wave(2 * i + 1, t)])
                    .collect();
                plant.step(&torque);
                // Kinetic energy of an axle at the no-load speed of its wheels: 6.5 J.
                assert!(
                    plant.energy() < 30.0 * axles as f64,
                    "{axles} axles, drive {n}"
                );
            }
            let health = plant.health();
            assert_eq!(health.failures, 0, "{axles} axles, drive {n}: {health:?}");
            snaps += health.snap_throughs;
        }
        println!("{axles} axles: {snaps} snap-throughs");
        assert!(snaps > 5, "{axles} axles: {snaps}");
    }
}
