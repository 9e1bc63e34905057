use super::constants::{COMPLIANCE, DRIFT, GYRO_SCALE, SCALE, SIDE, TURN, UNEVEN};
use super::*;
use crate::fusion::testing::{
    Random, covariance_error, inverse, is_definite, quadratic, random_covariance, wide,
};

/// Relative headings of missing neighbouring frames.
const ALONE: [RelativeHeading; 2] = [RelativeHeading(0.0); 2];

fn start() -> (Joint, State) {
    let joint = Config::default().build(0.01).unwrap();
    let robot = Estimate::with_sigmas(Posture::new(1.0, -0.5, 2.0), [2e-3, 3e-3, 4e-3]);
    let relative = Estimate::with_sigmas(Posture::new(0.36, 0.02, 0.2), [1e-3, 2e-3, 5e-3]);
    let state = joint.start(&robot, &relative, 0.0);
    (joint, state)
}

#[test]
fn start_returns_the_given_posture_and_covariance_of_o() {
    let (_, state) = start();
    let robot = state.estimates().robot;
    let off = robot.posture.minus(Posture::new(1.0, -0.5, 2.0));
    assert!(off.iter().all(|d| d.abs() < 1e-6), "{off:?}");
    let given = Estimate::with_sigmas(Posture::ORIGIN, [2e-3, 3e-3, 4e-3]);
    let error = covariance_error(&robot.covariance, &wide(&given.covariance));
    assert!(error < 1e-4, "{error:e}");
}

/// The derivatives that `error_by` leaves out are zero.
#[test]
fn error_by_leaves_out_only_zero_derivatives() {
    for axle in 0..2 {
        let by = IncrementInputs {
            axle,
            moved: Posture::new(0.3, -0.2, 0.1),
            relative_heading: RelativeHeading(0.4),
            dt: 0.5,
            gyro_share: 0.6,
        }
        .by_constants(&start().0.tyres);
        for constant in 0..constants::COUNT {
            let of = |k: usize| f32::from(k == constant);
            let error = match axle {
                0 => constants::error_by::<0>(&by, of),
                _ => constants::error_by::<1>(&by, of),
            };
            assert_eq!(error, by.map(|row| row[constant]), "{constant}");
        }
    }
}

/// Error of the state `at` relative to the state `of`, in the filter's error coordinates.
fn error(at: &State, of: &State) -> [f64; N] {
    let e = at.rear.relative_to(of.rear);
    let r = at.relative.minus(of.relative);
    let mut out = [0.0; N];
    for (k, x) in [e.x, e.y, e.phi, r[0], r[1], r[2]].into_iter().enumerate() {
        out[k] = f64::from(x);
    }
    for k in 0..constants::COUNT {
        out[FIRST + k] = f64::from(at.constants[k] - of.constants[k]);
    }
    out
}

/// `state` moved by `by` in error coordinate `k`.
fn moved(joint: &Joint, state: &State, k: usize, by: f32) -> State {
    let mut out = *state;
    let mut shift = [0.0; N];
    shift[k] = by;
    joint.shift(&mut out, &shift);
    out
}

#[test]
fn predicted_covariance_equals_propagation_by_central_differences() {
    let (joint, mut state) = start();
    state.constants = [
        5e-4, 1e-4, 1e-2, 2e-4, 3e-3, -4e-3, 2e-3, -1e-3, 3e-3, -2e-3, 2e-3, -3e-3, 0.02, 0.01,
        0.03, -0.02, 1e-3, 2e-3, -4e-3, 5e-3,
    ];
    let shares = [0.3, 0.8];
    // A large first step, so that the covariance has correlations.
    let front = Posture::new(0.05, 0.004, 0.03);
    let rear = Posture::new(0.06, -0.002, -0.04);
    let mut random = Random::new(1);
    let noise1 = random_covariance(&mut random, [3e-4; 3], 0.5);
    let noise2 = random_covariance(&mut random, [3e-4; 3], 0.5);
    let (f1, f2) = (Estimate::new(front, noise1), Estimate::new(rear, noise2));
    joint.predict(&mut state, &f1, &f2, shares, ALONE, 5.0);

    // Derivatives by central differences of the mean alone.
    let go = |s: &State, d1: Posture, d2: Posture| {
        let mut s = *s;
        let [d1, d2] = [d1, d2].map(|d| Estimate::new(d, [[0.0; 3]; 3]));
        joint.predict(&mut s, &d1, &d2, shares, ALONE, 5.0);
        s
    };
    let centre = go(&state, front, rear);
    let h = 4e-3f32;
    let difference = |low: State, high: State| {
        let (a, b) = (error(&low, &centre), error(&high, &centre));
        core::array::from_fn::<f64, N, _>(|i| (b[i] - a[i]) / (2.0 * h as f64))
    };
    let mut columns = Vec::new();
    for k in 0..N {
        let low = go(&moved(&joint, &state, k, -h), front, rear);
        let high = go(&moved(&joint, &state, k, h), front, rear);
        columns.push(difference(low, high));
    }
    // Errors of the increments lie along the headings reached.
    let reach = |d: Posture, k: usize, by: f32| {
        let mut error = [0.0; 3];
        error[k] = by;
        d.compose(Posture::from(error))
    };
    let by_noise = |front_axle: bool| {
        core::array::from_fn::<[f64; N], 3, _>(|k| {
            let at = |by: f32| {
                if front_axle {
                    go(&state, reach(front, k, by), rear)
                } else {
                    go(&state, front, reach(rear, k, by))
                }
            };
            difference(at(-h), at(h))
        })
    };
    let (by_front, by_rear) = (by_noise(true), by_noise(false));

    let before = state.covariance.matrix();
    joint.predict(&mut state, &f1, &f2, shares, ALONE, 5.0);
    let after = state.covariance.matrix();
    for i in 0..N {
        for j in 0..N {
            let mut sum = 0.0;
            for k in 0..N {
                for l in 0..N {
                    sum += columns[k][i] * f64::from(before[k][l]) * columns[l][j];
                }
            }
            for k in 0..3 {
                for l in 0..3 {
                    sum += by_front[k][i] * f64::from(noise1[k][l]) * by_front[l][j]
                        + by_rear[k][i] * f64::from(noise2[k][l]) * by_rear[l][j];
                }
            }
            if i == j && i >= FIRST {
                sum += 5.0 * f64::from(joint.walk[i - FIRST]);
            }
            let scale = f64::from(after[i][i] * after[j][j]).sqrt();
            let error = (f64::from(after[i][j]) - sum).abs();
            assert!(error < 2e-3 * scale, "{i} {j}: {error:e} of {scale:e}");
        }
    }
}

#[test]
fn update_equals_the_batch_update_in_f64() {
    for seed in 0..30 {
        let (joint, mut state) = start();
        let mut random = Random::new(seed);
        let noise = random_covariance(&mut random, [1e-3; 3], 0.5);
        let step = Estimate::new(Posture::new(0.05, 0.0, 0.1), noise);
        for _ in 0..3 {
            joint.predict(&mut state, &step, &step, [0.5; 2], ALONE, 1.0);
        }
        let r = random_covariance(&mut random, [2e-4; 3], 0.5);
        let innovation = [1e-3, -2e-3, 3e-3];
        state.constants = [1e-3; constants::COUNT];
        let by = constants::beam_by_constants(state.relative);
        let off = by.map(|row| 1e-3 * row.iter().sum::<f32>());
        let measured = Posture::new(
            state.relative.x + innovation[0] + off[0],
            state.relative.y + innovation[1] + off[1],
            state.relative.phi + innovation[2] + off[2],
        );
        let prior = state;
        let outcome = joint.update(&mut state, &Estimate::new(measured, r), |_| true);
        assert_eq!(outcome.verdict, Verdict::Used);

        // Each of the four wheels rolls further than its encoder by the backlash.
        let backlash = f64::from(Config::default().play_sigma_m);
        let d = f64::from(Config::default().half_track_m);
        let relative = prior.relative;
        let (x, y) = (f64::from(relative.x), f64::from(relative.y));
        let (sin, cos) = f64::from(relative.phi).sin_cos();
        let wheels = [-1.0, 1.0].map(|side| {
            let (advance, turn) = (0.5, side * 0.5 / d);
            [
                [advance * cos, advance * sin, turn],
                [advance - y * turn, x * turn, turn],
            ]
        });
        let by_backlash = |i: usize, j: usize| -> f64 {
            let wheels = wheels.as_flattened().iter();
            wheels.map(|by| backlash * backlash * by[i] * by[j]).sum()
        };

        let p = wide(&prior.covariance.matrix());
        let mut rows = [[0.0; N]; 3];
        for i in 0..3 {
            rows[i][REL + i] = 1.0;
            for k in 0..OF_BEAM {
                rows[i][FIRST + k] = f64::from(by[i][k]);
            }
        }
        let ph = rows.map(|row| {
            core::array::from_fn::<f64, N, _>(|i| (0..N).map(|j| row[j] * p[i][j]).sum())
        });
        // Inverse covariance of the innovation.
        let inverse = inverse(&core::array::from_fn(|i| {
            core::array::from_fn(|j| {
                let states = (0..N).map(|k| rows[i][k] * ph[j][k]).sum::<f64>();
                states + f64::from(r[i][j]) + by_backlash(i, j)
            })
        }));
        let exact = outcome.innovation.map(f64::from);
        let nis = quadratic(&inverse, exact);
        assert!((f64::from(outcome.nis) / nis - 1.0).abs() < 1e-3);
        let after = state.covariance.matrix();
        let shift = error(&state, &prior);
        for i in 0..N {
            let gain = |k: usize| -> f64 { (0..3).map(|l| ph[l][i] * inverse[l][k]).sum() };
            let expected: f64 = (0..3).map(|k| gain(k) * exact[k]).sum();
            let sigma = p[i][i].sqrt();
            assert!((shift[i] - expected).abs() < 1e-3 * sigma, "{i}");
            for j in 0..N {
                let fall: f64 = (0..3).map(|k| gain(k) * ph[k][j]).sum();
                let scale = f64::from(after[i][i] * after[j][j]).sqrt();
                let error = (f64::from(after[i][j]) - (p[i][j] - fall)).abs();
                assert!(error < 2e-4 * scale, "{i} {j} {error:e} {scale:e}");
            }
        }
    }
}

#[test]
fn positive_definite_over_a_hundred_thousand_ticks() {
    let (joint, mut state) = start();
    let step = Estimate::with_sigmas(Posture::new(0.0025, 0.0, 0.004), [5e-5, 2e-5, 2e-4]);
    let beam = Estimate::with_sigmas(Posture::new(0.36, 0.02, 0.2), [5e-5, 5e-5, 2e-4]);
    for tick in 0..100_000 {
        joint.predict(&mut state, &step, &step, [0.5; 2], ALONE, 1.0);
        joint.update(&mut state, &beam, |_| true);
        if tick % 64 == 0 {
            joint.condition(&mut state, 64);
        }
        if tick % 997 == 0 {
            assert!(is_definite(&wide(&state.covariance.matrix())), "{tick}");
        }
    }
    let sigma = crate::math::trig::sqrt(state.estimates().rear.covariance[0][0]);
    assert!(sigma > 0.05 && sigma.is_finite());
}

#[test]
fn innovation_beyond_half_a_turn_wraps() {
    let pi = core::f32::consts::PI;
    for (side, zero) in [(1.0, 0.05), (1.0, -0.05), (-1.0, 0.05), (-1.0, -0.05)] {
        let (joint, mut state) = start();
        state.constants[ZERO] = zero;
        let mut measured = state.relative();
        measured.posture.phi += side * (pi - 0.01);
        let turn = joint.update(&mut state, &measured, |_| false).innovation[2];
        let expected = side * (pi - 0.01) - zero;
        assert!(turn.abs() <= pi && (turn - expected).sin().abs() < 1e-5);
    }
}

/// The fading of an estimated constant is a first-order process whose stationary variance is the prior.
#[test]
fn estimated_constants_fade_to_their_priors() {
    let (joint, mut state) = start();
    state.constants = [1e-3; constants::COUNT];
    for k in 0..constants::COUNT {
        state.covariance.upper[FIRST + k][FIRST + k] = 0.25 * joint.prior[k];
    }
    // A fifth of the time constant.
    let ticks = 0.2 * f64::from(Config::default().constancy_s) / 0.01;
    for _ in 0..(ticks / 64.0) as u32 {
        joint.condition(&mut state, 64);
    }
    for k in (0..constants::COUNT).filter(|&k| joint.walk[k] == 0.0 && joint.prior[k] > 0.0) {
        let share = f64::from(state.covariance.upper[FIRST + k][FIRST + k] / joint.prior[k]);
        let expected = 1.0 - 0.75 * (-0.4f64).exp();
        assert!((share - expected).abs() < 0.01, "{k} {share}");
        let left = f64::from(state.constants[k]) / 1e-3;
        assert!((left - (-0.2f64).exp()).abs() < 0.01, "{k} {left}");
    }
}

#[test]
fn bad_measurement_changes_nothing() {
    let (joint, before) = start();
    for k in 0..2 {
        let mut beam = Estimate::with_sigmas(Posture::new(0.36, 0.02, 0.2), [1e-4; 3]);
        if k == 0 {
            beam.posture.phi = f32::NAN;
        } else {
            beam.covariance[1][1] = -1.0;
        }
        let mut state = before;
        let outcome = joint.update(&mut state, &beam, |_| true);
        assert_eq!(outcome.verdict, Verdict::Invalid);
        assert_eq!(state, before);
    }
    crate::config::refusal_of(Config::default(), |c| c.build(0.01))
        .names(&[("scale_sigma", |c| c.scale_sigma = f32::NAN)]);
}

#[test]
fn forgetting_a_gyro_bias_resets_that_bias_alone() {
    let (joint, mut state) = start();
    let moved = Estimate::with_sigmas(Posture::new(0.002, 0.0, 0.003), [1e-5; 3]);
    for _ in 0..300 {
        joint.predict(&mut state, &moved, &moved, [1.0; 2], ALONE, 1.0);
        let relative = state.relative();
        let measured = Posture::new(relative.posture.x, 0.02, 0.2);
        let beam = Estimate::with_sigmas(measured, [1e-4, 1e-4, 2e-4]);
        joint.update(&mut state, &beam, |_| true);
    }
    let before = state;
    let learnt = before.constants()[GYRO_BIAS];
    assert!(learnt.abs() > 1e-6, "{learnt}");
    joint.forget_gyro_bias(&mut state, 0);
    assert_eq!(state.constants()[GYRO_BIAS], 0.0);
    let sigma = state.constant_sigmas()[GYRO_BIAS];
    assert!((sigma / Config::default().gyro_bias_sigma_rad_s - 1.0).abs() < 1e-5);
    let forgotten = FIRST + GYRO_BIAS;
    let (now, then) = (state.covariance().matrix(), before.covariance().matrix());
    for i in 0..N {
        for j in 0..N {
            match (i == forgotten, j == forgotten) {
                (false, false) => assert_eq!(now[i][j], then[i][j]),
                (true, true) => {}
                _ => assert_eq!(now[i][j], 0.0),
            }
        }
    }
    assert_eq!(state.estimates().robot, before.estimates().robot);
    let others = [&state, &before].map(|state| state.constants()[GYRO_BIAS + 1]);
    assert_eq!(others[0], others[1]);
}

const BODIES: [fn(&State) -> Estimate; 3] = [
    |state| state.estimates().rear,
    |state| state.estimates().front,
    |state| state.estimates().robot,
];

/// Drives forward and back with a constant bend of the frame and an extra turn of `turn` per metre. Also returns the
/// rear axle's true posture on a floor that displaces it by `by` per metre.
fn drive([steady, floor_drift]: [f32; 2], turn: f32, by: [f32; 2]) -> (State, Posture) {
    let config = Config {
        steady_turn_sigma_rad_per_m: steady,
        ..Config::default()
    };
    let joint = config.build(0.01).unwrap();
    let robot = Estimate::with_sigmas(Posture::new(1.0, -0.5, 2.0), [1e-4; 3]);
    let shape = Posture::new(0.36, 0.02, 0.2);
    let frame = Estimate::with_sigmas(shape, [1e-4; 3]);
    let mut state = joint.start(&robot, &frame, floor_drift);
    let mut world = state.rear;
    for i in 0..600 {
        let forward = if i < 450 { 2e-3 } else { -2e-3f32 };
        let rear = Posture::new(forward, 0.0, 1e-3 + turn * forward.abs());
        let front = shape.inverse().compose(rear.compose(shape));
        let [front, rear] = [front, rear].map(|d| Estimate::with_sigmas(d, [1e-6; 3]));
        joint.predict(&mut state, &front, &rear, [1.0; 2], ALONE, 1.0);
        world = world.compose(rear.posture);
        world.x += by[0] * forward.abs();
        world.y += by[1] * forward.abs();
    }
    (state, world)
}

/// Asserts that `wider` has the covariance of `plain` plus that of independent errors with standard deviation `sigma`
/// and these derivatives.
fn assert_adds(plain: &Estimate, wider: &Estimate, sigma: f32, derivatives: &[[f32; 3]]) {
    for i in 0..3 {
        for k in 0..3 {
            let added = wider.covariance[i][k] - plain.covariance[i][k];
            let expected: f32 = derivatives.iter().map(|d| d[i] * d[k]).sum();
            let error = added / (sigma * sigma) - expected;
            assert!(error.abs() < 0.02, "{i}{k} {added:e} {expected:e}");
        }
    }
}

/// Reference: derivative of the path by an extra turn per metre, from two drives.
#[test]
fn steady_turn_adds_the_covariance_of_a_turn_per_metre() {
    let sigma = 3e-4;
    let [plain, wider] = [0.0, sigma].map(|steady| drive([steady, 0.0], 0.0, [0.0; 2]).0);
    assert_eq!(plain.rear(), wider.rear());
    assert_eq!(plain.relative().covariance, wider.relative().covariance);
    let [left, right] = [-5e-3, 5e-3].map(|turn| drive([0.0; 2], turn, [0.0; 2]).0);
    for of in BODIES {
        let d = of(&right).posture.minus(of(&left).posture);
        let d = d.map(|d| d / 1e-2);
        assert!((d[2] - 1.2).abs() < 0.01, "{d:?}");
        assert_adds(&of(&plain), &of(&wider), sigma, &[d]);
    }
}

/// Reference: derivative of the path by a displacement per metre along the floor's axes, from two drives.
#[test]
fn floor_drift_adds_the_covariance_of_a_displacement_per_metre() {
    let sigma = 1e-2;
    let [(plain, _), (wider, still)] = [0.0, sigma].map(|floor| drive([0.0, floor], 0.0, [0.0; 2]));
    assert_eq!(plain.relative().covariance, wider.relative().covariance);
    let pushed = [[1e-2, 0.0], [0.0, 1e-2]].map(|by| {
        let (_, world) = drive([0.0; 2], 0.0, by);
        world.minus(still).map(|d| d / 1e-2)
    });
    for of in BODIES {
        assert_adds(&of(&plain), &of(&wider), sigma, &pushed);
    }
}

/// Consistency of a robot on a circle whose front odometry has errors of scale and heading and whose beam has a zero
/// error.
fn inconsistent_sensor_of(scale: f32, turn_scale: f32, zero: f32) -> Option<InconsistentSensor> {
    let joint = Config::default().build(0.01).unwrap();
    let shape = Posture::new(0.36, 0.02, 0.2);
    let placed = Estimate::with_sigmas(Posture::ORIGIN, [2e-3; 3]);
    let mut state = joint.start(&placed, &Estimate::with_sigmas(shape, [1e-3; 3]), 0.0);
    let measured = Posture::new(shape.x, shape.y + 0.5 * zero * shape.x, shape.phi + zero);
    for _ in 0..3000 {
        let rear = Posture::new(2e-3, 0.0, 1e-3);
        let mut front = shape.inverse().compose(rear.compose(shape));
        (front.x, front.phi) = (front.x * (1.0 + scale), front.phi * (1.0 + turn_scale));
        let [front, rear] = [front, rear].map(|d| Estimate::with_sigmas(d, [2e-5, 2e-5, 1e-5]));
        joint.predict(&mut state, &front, &rear, [1.0; 2], ALONE, 1.0);
        let measured = Estimate::with_sigmas(measured, [1e-4, 1e-4, 5e-4]);
        joint.update(&mut state, &measured, |_| true);
    }
    joint.inconsistent_sensor(&state)
}

/// Sets constants in units of their limit. The constants of front and rear count by sum and difference over √2.
#[test]
fn constant_furthest_beyond_its_limit_names_the_part() {
    let (mut joint, mut state) = start();
    joint.per_limit = [0.25; constants::COUNT];
    let mut inconsistent_sensor = |sizes: &[(usize, f32)]| {
        state.constants = [0.0; constants::COUNT];
        for &(k, size) in sizes {
            state.constants[k] = 4.0 * size;
        }
        joint.inconsistent_sensor(&state)
    };
    let wheels = [DRIFT, SCALE, TURN, SIDE, UNEVEN].map(|k| (k, true, InconsistentSensor::Wheels));
    let gyros = [GYRO_BIAS, GYRO_SCALE].map(|k| (k, true, InconsistentSensor::Gyros));
    let single = [
        (COMPLIANCE, InconsistentSensor::Wheels),
        (ZERO, InconsistentSensor::Gauges),
        (GAIN, InconsistentSensor::Gauges),
    ];
    let single = single.map(|(k, part)| (k, false, part));
    for (k, paired, part) in wheels.into_iter().chain(gyros).chain(single) {
        for (a, b, beyond) in [
            (1.5, 0.0, true),
            (0.0, -1.5, true),
            (0.8, 0.8, paired),
            (0.8, -0.8, paired),
            (0.9, 0.0, false),
        ] {
            assert_eq!(
                inconsistent_sensor(&[(k, a), (k + 1, b)]),
                beyond.then_some(part),
                "{k} {a} {b}"
            );
        }
        let at = if paired { [1.0; 2] } else { [1.0, 0.0] };
        for (other, larger) in [
            (DRIFT, InconsistentSensor::Wheels),
            (ZERO, InconsistentSensor::Gauges),
            (GYRO_BIAS, InconsistentSensor::Gyros),
        ] {
            let sizes = [
                (k, 2.0 * at[0]),
                (k + 1, 2.0 * at[1]),
                (other, 9.0),
                (other + 1, 9.0),
            ];
            assert_eq!(inconsistent_sensor(&sizes), Some(larger), "{k} {other}");
        }
    }
    assert_eq!(inconsistent_sensor(&[(ZERO, 1.0)]), None);
    assert_eq!(
        inconsistent_sensor(&[(ZERO, 1.0f32.next_up())]),
        Some(InconsistentSensor::Gauges)
    );
}

/// Compares every number of the filter with its definition.
#[test]
fn priors_walks_limits_and_tyres_follow_from_the_configuration() {
    let config = Config {
        beam: crate::beam::strip::PostureSigmas {
            zero_rad: 1e-3,
            zero_tilt_m: 2e-3,
            walk_rad_per_sqrt_s: 3e-4,
            walk_tilt_m_per_sqrt_s: 4e-5,
            gain: 0.05,
            gain_tilt_m: 6e-3,
        },
        turn_scale_sigma: 0.0,
        constancy_s: 500.0,
        ..Config::default()
    };
    let (period, constancy) = (0.02, 500.0);
    let joint = config.build(period as f32).unwrap();
    let [d, moment, mass, stiffness] = [
        config.half_track_m,
        config.frame_moment_n_m,
        config.axle_mass_kg,
        config.slip_stiffness,
    ]
    .map(f64::from);
    // A moment M presses on each wheel with a force of M/2d; its slip is this force over load times C.
    let load = 0.5 * 9.81 * mass;
    let compliance = moment / (2.0 * d) / (load * stiffness) / d;
    let sliding = f64::from(config.friction) * load * 2.0 * d / moment;
    let [slip, tyre] = [config.slip_sigma, config.tyre_slip_sigma].map(f64::from);
    let mut sigmas = [0.0; constants::COUNT];
    sigmas[ZERO..ZERO + 2].copy_from_slice(&[1e-3, 2e-3]);
    sigmas[GAIN..GAIN + 2].copy_from_slice(&[0.05, 6e-3]);
    // Mean and half the difference of two axles, each the mean of two tyres.
    sigmas[COMPLIANCE] = compliance * slip.hypot(tyre / 2.0);
    sigmas[COMPLIANCE + 1] = compliance * tyre / 2.0;
    for (first, sigma) in [
        (DRIFT, f64::from(config.heading_drift_sigma_rad_per_m)),
        (SCALE, f64::from(config.scale_sigma)),
        (TURN, 0.0),
        (SIDE, f64::from(config.side_slip_sigma)),
        (UNEVEN, compliance * tyre / 2f64.sqrt()),
        (GYRO_BIAS, f64::from(config.gyro_bias_sigma_rad_s)),
        (GYRO_SCALE, f64::from(config.gyro_scale_sigma)),
    ] {
        sigmas[first] = sigma;
        sigmas[first + 1] = sigma;
    }
    let mut walks = [0.0; constants::COUNT];
    walks[ZERO..ZERO + 2].copy_from_slice(&[3e-4, 4e-5]);
    walks[GYRO_BIAS..GYRO_BIAS + 2].fill(f64::from(config.gyro_bias_walk_rad_s_per_sqrt_s));
    let alike = |found: f32, exact: f64| (f64::from(found) - exact).abs() <= 1e-5 * exact;
    for k in 0..constants::COUNT {
        assert!(alike(joint.prior[k], sigmas[k] * sigmas[k]), "{k}");
        assert!(alike(joint.walk[k], walks[k] * walks[k] * period), "{k}");
        let walked = sigmas[k].hypot(walks[k] * f64::sqrt(constancy));
        let per_limit = if walked > 0.0 { 0.25 / walked } else { 0.0 };
        assert!(alike(joint.per_limit[k], per_limit), "{k}");
    }
    assert!(alike(joint.tyres.compliance, compliance) && alike(joint.tyres.sliding, sliding));
    // `kept` is 1 − T/constancy, rounded to `f32`.
    assert!((f64::from(1.0 - joint.kept) - period / constancy).abs() < 1e-7);
    for (constancy_s, allowed) in [(5.0f32, true), (5.0f32.next_down(), false), (1e7, true)] {
        let config = Config {
            constancy_s,
            ..config
        };
        assert_eq!(config.build(0.5).is_ok(), allowed, "{constancy_s}");
    }
}

#[test]
fn inconsistent_sensor_is_named() {
    assert_eq!(inconsistent_sensor_of(0.0, 0.0, 0.0), None);
    assert_eq!(inconsistent_sensor_of(0.003, 0.004, 0.003), None);
    assert_eq!(
        inconsistent_sensor_of(0.05, 0.0, 0.0),
        Some(InconsistentSensor::Wheels)
    );
    assert_eq!(
        inconsistent_sensor_of(0.0, 0.05, 0.0),
        Some(InconsistentSensor::Gyros)
    );
    assert_eq!(
        inconsistent_sensor_of(0.0, 0.0, 0.05),
        Some(InconsistentSensor::Gauges)
    );
}

impl State {
    /// Sets a constant as if estimated.
    pub(crate) fn set_constant(&mut self, constant: usize, value: f32) {
        self.constants[constant] = value;
    }
}
