use super::*;
use crate::fusion::testing::{
    Matrix, Pose, Random, cholesky, compose, covariance_error, inverse, quadratic,
    random_covariance, relative, transpose, wide, wrap,
};

const BEAM_SIGMAS: [f32; 3] = [5e-5, 5e-5, 2e-4];
const MODES: [Mode; 4] = [
    Mode::Odometry,
    Mode::Intersection,
    Mode::IntersectionIpec,
    Mode::Joint,
];

fn fusion(mode: Mode) -> RobotFusion {
    Config {
        mode,
        ..Config::default()
    }
    .build()
    .unwrap()
}

fn straight() -> Estimate {
    Estimate::with_sigmas(Posture::new(0.37, 0.0, 0.0), BEAM_SIGMAS)
}

fn start(fusion: &RobotFusion, robot: Posture) -> State {
    let robot = Estimate::with_sigmas(robot, [5e-3, 5e-3, 1e-2]);
    let frame = Estimate::with_sigmas(straight().posture, Config::default().frame_sigmas);
    fusion.start(&robot, &frame, 0.015)
}

fn forward() -> Increment {
    Increment::new(Posture::new(0.0025, 0.0, 0.0), [[0.0; 3]; 3])
}

fn rest() -> Increment {
    Increment::new(Posture::ORIGIN, [[0.0; 3]; 3])
}

/// Inputs with the increment `moved` of both axles.
fn inputs(moved: Increment, beam: Option<Estimate>) -> Inputs {
    Inputs {
        front: Some(moved),
        rear: Some(moved),
        beam,
        ..Inputs::default()
    }
}

/// Conditioning the covariance ahead of a tick gives the same outputs as conditioning it in the tick.
#[test]
fn prepare_ahead_of_the_tick_leaves_every_output_the_same() {
    for mode in MODES {
        let fusion = fusion(mode);
        let mut late = start(&fusion, Posture::new(0.1, -0.2, 0.3));
        let mut ahead = late;
        let mut repairs = 0;
        for tick in 0..400u16 {
            let noise = matrix::diagonal([1e-9, 1e-9, 1e-8]);
            let moved = Increment::new(Posture::new(2e-3, 0.0, 1e-3), noise);
            let inputs = inputs(moved, (tick % 3 != 0).then(straight));
            let [a, b] = [&mut ahead, &mut late].map(|state| fusion.step(state, &inputs));
            assert_eq!(a, b);
            let before = ahead;
            fusion.prepare(&mut ahead);
            repairs += u32::from(ahead != before);
            fusion.prepare(&mut ahead);
        }
        assert_eq!(repairs, if mode == Mode::Joint { 6 } else { 0 });
    }
}

#[test]
fn straight_drive_arrives_in_every_mode() {
    for mode in MODES {
        let fusion = fusion(mode);
        let ahead = core::f32::consts::FRAC_PI_2;
        let mut state = start(&fusion, Posture::new(-1.0, 0.5, ahead));
        let mut output = Output::default();
        for _ in 0..400 {
            output = fusion.step(&mut state, &inputs(forward(), Some(straight())));
        }
        let o = output.robot.posture;
        let error = o.minus(Posture::new(-1.0, 1.5, ahead));
        assert!(error.iter().all(|e| e.abs() < 1e-4), "{mode:?} {error:?}");
        assert!((output.front.posture.y - 1.685).abs() < 1e-4, "{mode:?}");
        assert!((output.rear.posture.y - 1.315).abs() < 1e-4, "{mode:?}");
        for estimate in [output.front, output.rear, output.robot] {
            assert!(matrix::cholesky(&estimate.covariance).is_some(), "{mode:?}");
        }
    }
}

#[test]
fn creep_measured_by_the_beam_is_shared_by_both_axles() {
    // A bent frame relaxes while the wheels stand still: both axles turn, O does not.
    let shape = |heading: f32| {
        let (sin, cos) = crate::math::trig::sin_cos(0.5 * heading);
        Estimate::with_sigmas(Posture::new(0.37 * cos, 0.37 * sin, heading), BEAM_SIGMAS)
    };
    let robot = Estimate::with_sigmas(Posture::ORIGIN, [1e-3; 3]);
    let outputs = [Mode::Joint, Mode::IntersectionIpec, Mode::Odometry].map(|mode| {
        let fusion = fusion(mode);
        let mut state = fusion.start(&robot, &shape(0.3), 0.01);
        let mut output = Output::default();
        for tick in 0..500 {
            let heading = 0.3 * crate::math::trig::exp(-0.01 * 0.01 * tick as f32);
            output = fusion.step(&mut state, &inputs(rest(), Some(shape(heading))));
        }
        output
    });
    let half = 0.15 * crate::math::trig::exp(-0.01 * 4.99);
    for output in &outputs[..2] {
        assert!((output.front.posture.phi - half).abs() < 2e-3, "{output:?}");
        assert!((output.rear.posture.phi + half).abs() < 2e-3, "{output:?}");
        assert!(output.robot.posture.phi.abs() < 1e-3, "{output:?}");
    }
    assert!((outputs[2].front.posture.phi - 0.15).abs() < 1e-5);
}

#[test]
fn lost_increment_is_covered_by_the_next_increment() {
    let turn =
        |k: u16| Posture::new(0.0, 0.0, 0.3).advance(0.0025 * f32::from(k), 0.002 * f32::from(k));
    let noise = matrix::diagonal([1e-10, 1e-11, 1e-9]);
    for mode in MODES {
        let fusion = fusion(mode);
        let run = |lost: &dyn Fn(u16, usize) -> bool| {
            let mut state = start(&fusion, Posture::ORIGIN);
            let mut last = [0; 2];
            let mut output = Output::default();
            for k in 1..=300u16 {
                let mut get = |axle: usize| {
                    if lost(k, axle) {
                        return None;
                    }
                    let since = std::mem::replace(&mut last[axle], k);
                    let ticks = k - since;
                    let covariance = matrix::scale(&noise, f32::from(ticks));
                    Some(Increment {
                        ticks,
                        ..Increment::new(turn(k).relative_to(turn(since)), covariance)
                    })
                };
                let inputs = Inputs {
                    front: get(0),
                    rear: get(1),
                    beam: None,
                    ..Inputs::default()
                };
                output = fusion.step(&mut state, &inputs);
            }
            output
        };
        let all = run(&|_, _| false);
        let some =
            run(&|k, axle| k > 0 && k < 298 && (k as usize * 7 + axle * 3).is_multiple_of(5));
        for (a, b) in [(all.front, some.front), (all.rear, some.rear)] {
            let error = a.posture.minus(b.posture);
            assert!(error.iter().all(|e| e.abs() < 1e-5), "{mode:?} {error:?}");
            for i in 0..3 {
                let ratio = b.covariance[i][i] / a.covariance[i][i];
                assert!((ratio - 1.0).abs() < 0.02, "{mode:?} {i} {ratio}");
            }
        }
    }
}

/// The random errors of axles that the beam has updated may be fully correlated, so twice the independent covariance is
/// claimed.
#[test]
fn joined_axles_claim_twice_the_independent_covariance() {
    let exact = |posture| Estimate::new(posture, [[0.0; 3]; 3]);
    let noisy = Increment::new(Posture::ORIGIN, matrix::diagonal([0.01; 3]));
    for (mode, factor) in [(Mode::Odometry, 1.0), (Mode::Intersection, 2.0)] {
        let fusion = fusion(mode);
        let mut state = fusion.start(&exact(Posture::ORIGIN), &exact(straight().posture), 0.0);
        let robot = fusion.step(&mut state, &inputs(noisy, None)).robot;
        let ratio = robot.covariance[0][0] / (factor * 0.5 * 0.01);
        assert!((ratio - 1.0).abs() < 0.02, "{mode:?} {ratio}");
    }
}

#[test]
fn jump_of_the_beam_is_gated_until_patience_ends() {
    for mode in [Mode::Intersection, Mode::IntersectionIpec, Mode::Joint] {
        let config = Config {
            mode,
            ..Config::default()
        };
        let fusion = config.build().unwrap();
        let robot = Estimate::with_sigmas(Posture::ORIGIN, [1e-4, 1e-4, 1e-3]);
        let frame = Estimate::with_sigmas(straight().posture, [2e-4, 2e-4, 1e-3]);
        let mut state = fusion.start(&robot, &frame, 0.01);
        let mut step = |phi: f32| {
            let beam = Estimate::with_sigmas(Posture::new(0.37, 0.0, phi), BEAM_SIGMAS);
            fusion.step(&mut state, &inputs(rest(), Some(beam)))
        };
        for _ in 0..20 {
            assert_eq!(step(0.0).beam.verdict, Verdict::Used, "{mode:?}");
        }
        let leap = step(0.5);
        assert_eq!(leap.beam.verdict, Verdict::Gated, "{mode:?}");
        assert!(leap.front.posture.phi.abs() < 1e-2, "{mode:?}");
        let mut refused = 1;
        while step(0.5).beam.verdict == Verdict::Gated {
            refused += 1;
            assert!(refused < 1000, "{mode:?}");
        }
        assert!(refused <= usize::from(config.gate_patience), "{mode:?}");
    }
}

fn pose(posture: Posture) -> Pose {
    <[f32; 3]>::from(posture).map(f64::from)
}

/// Posture of O from the postures of both axles.
fn middle(front: Pose, rear: Pose) -> Pose {
    let (x, y) = (front[0] - rear[0], front[1] - rear[1]);
    [
        0.5 * (front[0] + rear[0]),
        0.5 * (front[1] + rear[1]),
        y.atan2(x),
    ]
}

fn near(a: Posture, b: Pose, slack: f64) -> bool {
    let a = pose(a);
    (a[0] - b[0]).abs() < slack && (a[1] - b[1]).abs() < slack && wrap(a[2] - b[2]).abs() < slack
}

/// Slip parameters of which each has a visible effect.
fn slipping(mode: Mode) -> Config {
    Config {
        mode,
        period_s: 0.02,
        slip: Slip {
            along_m_per_sqrt_m: 2e-3,
            across_m_per_sqrt_m: 3e-3,
            side_m_per_sqrt_m: 7e-3,
            heading_rad_per_sqrt_m: 5e-3,
            heading_rad_per_sqrt_s: 3e-3,
            creep_per_sqrt_s: 6e-3,
            creep_per_sqrt_m: 1.1e-2,
            position_m_per_sqrt_s: 1.3e-3,
            load_speed_m_s: 2e-3,
        },
        ..Config::default()
    }
}

/// Standard deviations of the constant errors in the modes that do not estimate them.
fn unlearnt_sigmas(config: &Config) -> [f64; constants::COUNT] {
    let joint = config.joint.build(config.period_s).unwrap();
    let mut sigmas = joint.prior_sigmas().map(f64::from);
    // In 30 s a walk turns the heading as a constant bias of this size does.
    let walked = f64::from(config.joint.gyro_bias_walk_rad_s_per_sqrt_s) * 10f64.sqrt();
    for bias in &mut sigmas[constants::GYRO_BIAS..constants::GYRO_BIAS + 2] {
        *bias = bias.hypot(walked);
    }
    let slip = &mut sigmas[constants::COMPLIANCE];
    *slip = slip.hypot(f64::from(joint.tyres().compliance));
    sigmas
}

#[test]
fn slip_adds_variance_with_distance_time_and_relative_heading() {
    let config = slipping(Mode::Joint);
    let (fusion, sigmas) = (config.build().unwrap(), unlearnt_sigmas(&config));
    let given = random_covariance(&mut Random::new(3), [1e-4, 2e-4, 3e-4], 0.4);
    let square = |x: f32| f64::from(x) * f64::from(x);
    let slip = &config.slip;
    for (x, heading, ticks, gyro_share) in [
        (0.3f32, 0.5f32, 3, 0.25f32),
        (-0.02, -0.8, 1, 0.0),
        (0.0, 0.4, 7, 0.5),
        (0.1, 0.0, 0, 1.0),
        (0.1, 0.6, 2, 1.5),
        (0.1, 0.6, 2, -0.5),
    ] {
        let increment = Increment {
            ticks,
            gyro_share,
            ..Increment::new(Posture::new(x, 0.01, 0.2), given)
        };
        let found = fusion.with_slip(
            Some(increment),
            RelativeHeading(heading),
            &Load::default(),
            0.0,
        );
        let (distance, bend) = (f64::from(x.abs()), square(heading));
        let time = f64::from(ticks) * f64::from(config.period_s);
        let gyro = f64::from(gyro_share.clamp(0.0, 1.0));
        let position = square(slip.position_m_per_sqrt_s) * time;
        let side = square(slip.across_m_per_sqrt_m) + bend * square(slip.side_m_per_sqrt_m);
        let per_m = square(slip.heading_rad_per_sqrt_m) + bend * square(slip.creep_per_sqrt_m);
        let per_s = square(slip.heading_rad_per_sqrt_s) + bend * square(slip.creep_per_sqrt_s);
        let mut expected = wide(&given);
        expected[0][0] += square(slip.along_m_per_sqrt_m) * distance + position;
        expected[1][1] += side * distance + position;
        expected[2][2] += (1.0 - gyro) * (per_m * distance + per_s * time);
        let error = covariance_error(&found.estimate.covariance, &expected);
        assert!(error < 1e-5, "{x} {heading}: {error}");
        // Over 1 m (wheels) or 1 s (gyro) a constant error turns the axle as far as a random walk of equal size.
        let by_wheels =
            sigmas[constants::DRIFT].powi(2) + bend * sigmas[constants::COMPLIANCE].powi(2);
        let by_gyro = sigmas[constants::GYRO_BIAS] * gyro;
        let heading_variance =
            expected[2][2] + (1.0 - gyro).powi(2) * by_wheels * distance + by_gyro * by_gyro * time;
        let ratio = f64::from(found.heading_variance) / heading_variance;
        assert!((ratio - 1.0).abs() < 1e-5, "{x} {heading}: {ratio}");
        let passed_on = (found.estimate.posture, found.advance, found.ticks);
        assert_eq!(passed_on, (increment.posture, x, f32::from(ticks)));
        assert_eq!(f64::from(found.gyro_share), gyro);
    }
}

/// Tyres with the slip stiffness C hold a lateral force F on an axle of the weight mg at the slip angle F/(mgC).
#[test]
fn axle_slips_aside_under_a_lateral_force() {
    let config = Config::default();
    let (joint, fusion) = (config.joint, config.build().unwrap());
    let (force_n, weight_n) = (3.0, joint.axle_mass_kg * 9.81);
    let load = Load {
        aside: force_n / joint.frame_moment_n_m,
        ..Load::default()
    };
    for x in [0.4f32, -0.4] {
        let increment = Increment::new(Posture::new(x, 0.01, 0.0), [[0.0; 3]; 3]);
        let found = fusion.with_slip(Some(increment), RelativeHeading(0.3), &load, 0.0);
        let expected = 0.01 + 0.4 * force_n / (weight_n * joint.slip_stiffness);
        let y = found.estimate.posture.y;
        assert!((y - expected).abs() < 1e-6, "{y} {expected}");
    }
}

/// A neighbouring frame that is bent like this one takes the load from the axle between them; one bent the other way
/// doubles it, and with it the slip.
#[test]
fn load_of_an_axle_is_the_difference_of_its_frames() {
    let fusion = slipping(Mode::Joint).build().unwrap();
    let bent = Estimate::with_sigmas(Posture::new(0.36, 0.05, 0.4), BEAM_SIGMAS);
    let robot = Estimate::with_sigmas(Posture::ORIGIN, [1e-6; 3]);
    let variances = |unloaded: [f32; 2]| {
        let mut state = fusion.start(&robot, &bent, 0.015);
        let mut output = Output::default();
        for _ in 0..50 {
            let inputs = Inputs {
                loads: unloaded.map(|bend| Load {
                    unloaded: RelativeHeading(bend),
                    ..Load::default()
                }),
                ..inputs(forward(), None)
            };
            output = fusion.step(&mut state, &inputs);
        }
        [output.front, output.rear].map(|it| it.covariance[1][1])
    };
    let alone = variances([0.0; 2]);
    for (axle, ahead) in [[1.0, 0.0], [0.0, 1.0]].into_iter().enumerate() {
        let same = variances(ahead.map(|share: f32| 0.4 * share))[axle];
        let opposite = variances(ahead.map(|share: f32| -0.4 * share))[axle];
        assert!(
            same < 0.99 * alone[axle] && opposite > 1.01 * alone[axle],
            "{axle}: {same} {alone:?} {opposite}"
        );
    }
}

/// Sum of d dᵀ over the effects `d` of disturbances of one standard deviation, by central differences.
fn covariance_by<const B: usize, D>(
    disturbances: &[D],
    bodies: impl Fn(Option<&D>, f64) -> [Pose; B],
) -> [Matrix<3, 3>; B] {
    let mut sum = [[[0.0; 3]; 3]; B];
    for disturbance in disturbances {
        let [low, high] = [-0.1, 0.1].map(|size| bodies(Some(disturbance), size));
        for (sum, (low, high)) in sum.iter_mut().zip(low.into_iter().zip(high)) {
            let d = [high[0] - low[0], high[1] - low[1], wrap(high[2] - low[2])];
            for (i, k) in (0..9).map(|n| (n / 3, n % 3)) {
                sum[i][k] += d[i] * d[k] / 0.04;
            }
        }
    }
    sum
}

/// Error of one standard deviation somewhere on a drive.
enum Disturbance {
    Robot(Pose),
    Frame(Pose),
    /// Displacement of both axles by the floor per metre rolled, along the axes of the floor.
    Floor([f64; 2]),
    /// Errors of every increment of front and rear, in the axle's coordinates at the start of the increment.
    Steady([Pose; 2]),
    /// Error of one increment, in the axle's coordinates at its end: step, axle and error.
    Noise(usize, usize, Pose),
}

/// Compares odometry with a drive in `f64` that is disturbed by one error at a time: start, noise, constants, load,
/// floor.
#[test]
fn odometry_covariance_is_the_sum_of_the_effects_of_all_errors() {
    const STEPS: usize = 8;
    let config = slipping(Mode::Odometry);
    let (fusion, sigmas) = (config.build().unwrap(), unlearnt_sigmas(&config));
    let mut random = Random::new(5);
    let robot = Posture::new(0.5, -0.3, 2.9);
    let shape = Posture::new(0.35, 0.06, 0.4);
    let robot_covariance = random_covariance(&mut random, [4e-3, 6e-3, 8e-3], 0.4);
    let frame_covariance = random_covariance(&mut random, [2e-3, 3e-3, 6e-3], 0.4);
    let floor = 0.02f32;
    let (turn, ticks, shares) = (0.06, [1, 2], [0.3, 0.7]);
    let moved = [
        Posture::new(0.03, 0.002, turn),
        Posture::new(-0.025, -0.001, turn),
    ];
    let increments = [0, 1].map(|axle| Increment {
        ticks: ticks[axle],
        gyro_share: shares[axle],
        ..Increment::new(moved[axle], random_covariance(&mut random, [2e-4; 3], 0.4))
    });

    let columns = |covariance: &Mat3| transpose(&cholesky(&wide(covariance)));
    let mut disturbances = Vec::new();
    disturbances.extend(columns(&robot_covariance).map(Disturbance::Robot));
    disturbances.extend(columns(&frame_covariance).map(Disturbance::Frame));
    disturbances.extend([[0.02, 0.0], [0.0, 0.02]].map(Disturbance::Floor));
    let steps = [0, 1].map(|axle| constants::IncrementInputs {
        axle,
        moved: moved[axle],
        relative_heading: RelativeHeading(shape.phi),
        dt: 0.02 * f32::from(ticks[axle]),
        gyro_share: shares[axle],
    });
    let by = steps.map(|step| wide(&step.by_constants(fusion.joint.tyres())));
    for (k, sigma) in sigmas.iter().enumerate() {
        disturbances.push(Disturbance::Steady(
            by.map(|by| by.map(|row| row[k] * sigma)),
        ));
    }
    for (axle, component) in (0..6).map(|n| (n / 3, n % 3)) {
        let dt = 0.02 * f64::from(ticks[axle]);
        let turning = 2e-3 / 0.162 * (1.0 - f64::from(shares[axle]));
        let mut load = [[0.0; 3]; 2];
        load[axle][component] = [2e-3, 2e-3, turning][component] * dt;
        disturbances.push(Disturbance::Steady(load));
    }
    for (step, axle) in (0..2 * STEPS).map(|n| (n / 2, n % 2)) {
        let bend = RelativeHeading(shape.phi);
        let slipped = fusion.with_slip(Some(increments[axle]), bend, &Load::default(), 0.0);
        for column in columns(&slipped.estimate.covariance) {
            disturbances.push(Disturbance::Noise(step, axle, column));
        }
    }

    let add = |pose: Pose, by: &Pose, size: f64| [0, 1, 2].map(|i| pose[i] + size * by[i]);
    let drive = |disturbance: Option<&Disturbance>, size: f64| {
        let (mut o, mut r) = (pose(robot), pose(shape));
        match disturbance {
            Some(Disturbance::Robot(by)) => o = add(o, by, size),
            Some(Disturbance::Frame(by)) => r = add(r, by, size),
            _ => {}
        }
        let rear = compose(o, relative([0.0; 3], middle(r, [0.0; 3])));
        let mut axles = [compose(rear, r), rear];
        for (step, axle) in (0..2 * STEPS).map(|n| (n / 2, n % 2)) {
            let mut by = pose(moved[axle]);
            match disturbance {
                Some(Disturbance::Steady(error)) => by = add(by, &error[axle], size),
                Some(Disturbance::Noise(at, of, error)) if (*at, *of) == (step, axle) => {
                    by = compose(by, error.map(|error| size * error));
                }
                _ => {}
            }
            axles[axle] = compose(axles[axle], by);
            if let Some(Disturbance::Floor(by)) = disturbance {
                let turned = 0.162 * f64::from(turn);
                let x = f64::from(moved[axle].x);
                let distance = 0.5 * ((x - turned).abs() + (x + turned).abs());
                axles[axle] = add(axles[axle], &[by[0], by[1], 0.0], size * distance);
            }
        }
        [axles[0], axles[1], middle(axles[0], axles[1])]
    };

    let [robot, frame] = [(robot, robot_covariance), (shape, frame_covariance)]
        .map(|(posture, covariance)| Estimate::new(posture, covariance));
    let mut state = fusion.start(&robot, &frame, floor);
    let inputs = Inputs {
        front: Some(increments[0]),
        rear: Some(increments[1]),
        beam: None,
        ..Inputs::default()
    };
    let mut output = Output::default();
    for _ in 0..STEPS {
        output = fusion.step(&mut state, &inputs);
    }
    let (bodies, covariances) = (drive(None, 0.0), covariance_by(&disturbances, drive));
    for (k, found) in [output.front, output.rear, output.robot].iter().enumerate() {
        assert!(near(found.posture, bodies[k], 1e-6), "{k}");
        let error = covariance_error(&found.covariance, &covariances[k]);
        assert!(error < 1e-3, "{k}: {error}");
    }
}

/// Tracks of both axles with errors of every kind.
fn tracks(random: &mut Random) -> [Track; 2] {
    [Posture::new(0.4, -0.2, 2.0), Posture::new(0.6, -0.5, 1.8)].map(|posture| Track {
        posture,
        random: random_covariance(random, [1e-3, 2e-3, 3e-3], 0.4),
        constants: [(); 3].map(|()| core::array::from_fn(|_| (1e-3 * random.normal()) as f32)),
    })
}

#[test]
fn beam_nis_includes_constants_and_fusion_uses_values_before_the_update() {
    let open = |mode| Config {
        mode,
        beam_gate: None,
        ..Config::default()
    };
    for seed in 0..20 {
        let mut random = Random::new(seed);
        let config = open(Mode::Intersection);
        let (fusion, sigmas) = (config.build().unwrap(), unlearnt_sigmas(&config));
        let before = tracks(&mut random);
        let [front, rear] = before.map(|track| pose(track.posture));
        let mut measured = relative(front, rear);
        measured[2] += 5e-3;
        let posture = Posture::from(measured.map(|x| x as f32));
        let beam = Estimate::new(posture, random_covariance(&mut random, [1e-3; 3], 0.4));
        let (mut output, mut after) = (Output::default(), before);
        let mut beam_state = start(&fusion, Posture::ORIGIN).beam;
        let [f, r] = &mut after;
        let idle = Slipping::default();
        fusion.join(&mut beam_state, [f, r], &beam, [&idle, &idle], &mut output);

        let derivative = |axle: usize| -> Matrix<3, 3> {
            transpose(&[0, 1, 2].map(|k| {
                let at = |by: f64| {
                    let mut axles = [front, rear];
                    axles[axle][k] += by;
                    relative(axles[0], axles[1])
                };
                let (low, high) = (at(-1e-4), at(1e-4));
                [0, 1, 2].map(|i| (high[i] - low[i]) / 2e-4)
            }))
        };
        let by = [0, 1].map(derivative);
        let by_beam = constants::beam_by_constants(posture);
        // Effect of constant `k` on component `i` of the true less the estimated relative posture. The constants of the
        // beam add to the beam's reading.
        let owed = |i: usize, k: usize| -> f64 {
            let of_axles =
                (0..6).map(|n| by[n / 3][i][n % 3] * f64::from(before[n / 3].constants[n % 3][k]));
            let own = k.wrapping_sub(track::SHARED);
            let of_beam = match own < constants::OF_BEAM {
                true => f64::from(by_beam[i][own]) * sigmas[own],
                false => 0.0,
            };
            of_axles.sum::<f64>() + of_beam
        };
        let spread: Matrix<3, 3> = core::array::from_fn(|i| {
            core::array::from_fn(|j| {
                let mut sum = f64::from(beam.covariance[i][j]);
                for (by, track) in by.iter().zip(&before) {
                    for (k, l) in (0..9).map(|n| (n / 3, n % 3)) {
                        sum += 2.0 * by[i][k] * f64::from(track.random[k][l]) * by[j][l];
                    }
                }
                sum + (0..track::CONSTANTS)
                    .map(|k| owed(i, k) * owed(j, k))
                    .sum::<f64>()
            })
        });
        let innovation = output.beam.innovation.map(f64::from);
        assert!((innovation[2] - 5e-3).abs() < 1e-6);
        let nis = quadratic(&inverse(&spread), innovation);
        assert!(
            (f64::from(output.beam.nis) / nis - 1.0).abs() < 5e-3,
            "{nis}"
        );

        let relative = fusion.beam_track(&beam);
        let chains = [
            Chain::front_from_rear(before[1].posture, beam.posture),
            Chain::rear_from_front(before[0].posture, beam.posture),
        ];
        for axle in 0..2 {
            let other = before[1 - axle].propagated(&chains[axle], &relative);
            let (fused, omega) = before[axle]
                .intersect(&other, &fusion.intersection)
                .unwrap();
            assert_eq!(after[axle], fused);
            assert_eq!(output.omega.unwrap()[axle], omega);
        }
        assert!(output.ipec.is_none());

        // After IPEC the relative posture equals the beam's.
        let fusion = open(Mode::IntersectionIpec).build().unwrap();
        let mut after = before;
        let [f, r] = &mut after;
        fusion.join(&mut beam_state, [f, r], &beam, [&idle, &idle], &mut output);
        let apart = after[0].posture.relative_to(after[1].posture);
        assert!(near(apart, pose(posture), 2e-6), "{apart:?}");
        assert!(output.ipec.is_some());
    }
}

#[test]
fn midpoint_follows_the_axle_with_the_small_covariance() {
    let fusion = fusion(Mode::Intersection);
    let of = |x, sigma| Track::random(Estimate::with_sigmas(Posture::new(x, 0.0, 0.0), [sigma; 3]));
    for sigmas in [[1e-4, 0.1], [0.1, 1e-4]] {
        let [front, rear] = [of(0.37, sigmas[0]), of(0.0, sigmas[1])];
        let exact = Estimate::with_sigmas(straight().posture, [1e-5; 3]);
        let covariance = fusion.middle(&front, &rear, &exact).covariance;
        assert!(
            covariance[0][0] < 1e-6 && covariance[1][1] < 1e-5,
            "{covariance:?}"
        );
    }
    // Zero covariances have no intersection: O is halfway, and the beam has no effect.
    let [front, rear] = [of(0.4, 0.0), of(0.0, 0.0)];
    let exact = Estimate::new(straight().posture, [[0.0; 3]; 3]);
    let middle = fusion.middle(&front, &rear, &exact).posture;
    assert!(near(middle, [0.2, 0.0, 0.0], 1e-6), "{middle:?}");
}

#[test]
fn reported_motion_of_o_is_by_odometry_alone() {
    let increments = [
        Posture::new(2e-3, 1e-4, 3e-3),
        Posture::new(2.2e-3, -1e-4, 2.5e-3),
    ];
    for mode in MODES {
        let fusion = fusion(mode);
        let mut state = start(&fusion, Posture::new(1.0, -2.0, 2.8));
        let mut before = fusion.step(&mut state, &Inputs::default());
        let [front, rear] = increments.map(|d| Some(Increment::new(d, [[0.0; 3]; 3])));
        for _ in 0..3 {
            let inputs = Inputs {
                front,
                rear,
                beam: Some(straight()),
                ..Inputs::default()
            };
            let output = fusion.step(&mut state, &inputs);
            let (heading, moved) = state.moved();
            assert_eq!(heading, before.robot.posture.phi);
            let [f, r] = [before.front, before.rear].map(|axle| pose(axle.posture));
            let [further_f, further_r] = [(f, increments[0]), (r, increments[1])]
                .map(|(axle, increment)| compose(axle, pose(increment)));
            let (from, to) = (middle(f, r), middle(further_f, further_r));
            let expected = [0, 1, 2].map(|k| wrap(to[k] - from[k]));
            assert!(
                near(moved, expected, 1e-5),
                "{mode:?} {moved:?} {expected:?}"
            );
            before = output;
        }
    }
}

/// Pairs that condition in different ticks still do after an axle of both has restarted.
#[test]
fn restarted_pair_keeps_its_turn_of_conditioning() {
    let fusion = fusion(Mode::Joint);
    let turn = |restarts: bool| {
        let mut state = start(&fusion, Posture::ORIGIN);
        let turns = (0..200u8).filter(|tick| {
            let last = fusion.step(&mut state, &inputs(forward(), Some(straight())));
            if restarts && *tick == 20 {
                fusion.rejoin(&mut state, PairAxle::Front, &last, &straight());
            }
            fusion.prepare(&mut state)
        });
        turns.collect::<Vec<_>>()
    };
    assert_eq!(turn(true), turn(false));
    assert_eq!(turn(true).len(), 3);
}

#[test]
fn robot_restarts_from_one_axle_and_the_beam() {
    let shape = Posture::new(0.35, 0.06, 0.3);
    let beam = Estimate::new(
        shape,
        random_covariance(&mut Random::new(2), [1e-3; 3], 0.4),
    );
    for (mode, known) in MODES.into_iter().flat_map(|mode| [(mode, 0), (mode, 1)]) {
        let fusion = fusion(mode);
        let mut state = start(&fusion, Posture::new(1.0, -2.0, 2.8));
        let last = fusion.step(&mut state, &inputs(forward(), None));
        let (kept, id) = [(last.front, PairAxle::Front), (last.rear, PairAxle::Rear)][known];
        let output = fusion.rejoin(&mut state, id, &last, &beam);
        let again = [output.front, output.rear][known];
        assert!(
            near(again.posture, pose(kept.posture), 1e-6),
            "{mode:?} {known}"
        );
        let apart = output.front.posture.relative_to(output.rear.posture);
        assert!(near(apart, pose(shape), 1e-6), "{mode:?} {known}");
        assert_eq!(state.floor_drift, 0.015);

        let mut disturbances = Vec::new();
        let whole = fusion.beam_track(&beam).estimate().covariance;
        for (which, covariance) in [kept.covariance, whole].into_iter().enumerate() {
            let columns = transpose(&cholesky(&wide(&covariance)));
            disturbances.extend(columns.map(|column| (which, column)));
        }
        let [expected] = covariance_by(&disturbances, |disturbance, size| {
            let mut poses = [pose(kept.posture), pose(shape)];
            if let Some((which, by)) = disturbance {
                poses[*which] = [0, 1, 2].map(|k| poses[*which][k] + size * by[k]);
            }
            let [axle, r] = poses;
            let other = match known {
                0 => compose(axle, relative([0.0; 3], r)),
                _ => compose(axle, r),
            };
            let [front, rear] = if known == 0 {
                [axle, other]
            } else {
                [other, axle]
            };
            [middle(front, rear)]
        });
        let error = covariance_error(&output.robot.covariance, &expected);
        assert!(error < 1e-3, "{mode:?} {known}: {error}");
    }
}

#[test]
fn start_covariance_that_is_not_positive_definite_keeps_its_variances() {
    let fusion = fusion(Mode::Odometry);
    for variance in [0.0, -1e-9] {
        let known = matrix::diagonal([4e-6, variance, 1e-6]);
        let robot = Estimate::new(Posture::ORIGIN, known);
        let frame = Estimate::new(straight().posture, [[0.0; 3]; 3]);
        let mut state = fusion.start(&robot, &frame, 0.0);
        let found = fusion.step(&mut state, &Inputs::default()).robot.covariance;
        for k in 0..3 {
            assert!(
                (found[k][k] - known[k][k].max(0.0)).abs() < 1e-8,
                "{found:?}"
            );
        }
    }
}

#[test]
fn beam_is_accepted_up_to_the_gate_or_after_patience_and_counted() {
    let [closed, open] = [Some(40.0), None].map(|beam_gate| {
        let config = Config {
            beam_gate,
            gate_patience: 3,
            ..Config::default()
        };
        config.build().unwrap()
    });
    let beam_state = |rejected_in_a_row| Beam {
        relative: straight(),
        rejected_in_a_row,
    };
    for (fusion, nis, rejected, accepted) in [
        (&closed, 40.0f32, 0, true),
        (&closed, 40.0f32.next_up(), 0, false),
        (&closed, 40.0f32.next_up(), 2, false),
        (&closed, 40.0f32.next_up(), 3, true),
        (&closed, f32::NAN, 2, false),
        (&open, 1e30, 0, true),
        (&open, f32::INFINITY, 9, false),
    ] {
        assert_eq!(
            fusion.accepts(&beam_state(rejected), nis),
            accepted,
            "{nis} {rejected}"
        );
    }
    let newer = Estimate::with_sigmas(Posture::new(0.36, 0.0, 0.1), BEAM_SIGMAS);
    for (verdict, rejected, relative) in [
        (Verdict::Used, 0, newer),
        (Verdict::Gated, 3, straight()),
        (Verdict::Invalid, 2, straight()),
        (Verdict::Absent, 2, straight()),
    ] {
        let mut beam = beam_state(2);
        closed.count(&mut beam, verdict, &newer);
        assert_eq!(
            (beam.rejected_in_a_row, beam.relative),
            (rejected, relative)
        );
    }
}

#[test]
fn increment_not_finite_counts_as_absent_and_unusable_beam_as_invalid() {
    let beams: [fn(&mut Estimate, f32); 3] = [
        |beam, bad| beam.posture.phi = bad,
        |beam, bad| beam.covariance[0][2] = bad,
        |beam, _| beam.covariance[1][1] = -1e-9,
    ];
    let increments: [fn(&mut Increment, f32); 3] = [
        |moved, bad| moved.posture.phi = bad,
        |moved, bad| moved.covariance[0][2] = bad,
        |moved, bad| moved.gyro_share = bad,
    ];
    for (mode, bad) in MODES
        .into_iter()
        .flat_map(|mode| [(mode, f32::NAN), (mode, f32::INFINITY)])
    {
        let fusion = fusion(mode);
        let fresh = start(&fusion, Posture::ORIGIN);
        let step = |front, rear, beam| {
            fusion.step(
                &mut fresh.clone(),
                &Inputs {
                    front,
                    rear,
                    beam,
                    ..Inputs::default()
                },
            )
        };
        let (sound, beam) = (Some(forward()), Some(straight()));
        for spoil in increments {
            let mut moved = forward();
            spoil(&mut moved, bad);
            let given = [
                step(Some(moved), sound, beam),
                step(sound, Some(moved), beam),
            ];
            assert_eq!(given, [step(None, sound, beam), step(sound, None, beam)]);
            assert_eq!(
                given.map(|output| output.beam.verdict),
                [Verdict::Absent; 2]
            );
        }
        for spoil in beams {
            let mut beam = straight();
            spoil(&mut beam, bad);
            let mut expected = step(sound, sound, None);
            if mode != Mode::Odometry {
                expected.beam.verdict = Verdict::Invalid;
            }
            assert_eq!(
                step(sound, sound, Some(beam)),
                expected,
                "{mode:?} {beam:?}"
            );
        }
    }
}

#[test]
fn bias_walk_spans_the_longer_increment_and_loading_stays_while_one_is_missing() {
    let fusion = fusion(Mode::Joint);
    let fresh = start(&fusion, Posture::ORIGIN);
    let bias = constants::GYRO_BIAS;
    let variance = |state: &State| {
        let sigma = f64::from(state.joint().unwrap().constant_sigmas()[bias]);
        sigma * sigma
    };
    let turned = |ticks| Increment {
        ticks,
        ..Increment::new(Posture::new(0.0, 0.0, 0.01), [[0.0; 3]; 3])
    };
    let walk = f64::from(Config::default().joint.gyro_bias_walk_rad_s_per_sqrt_s);
    for (front, rear, ticks) in [
        (Some(5), Some(1), 5),
        (Some(1), Some(5), 5),
        (None, Some(4), 4),
        (Some(4), None, 4),
        (None, None, 0),
    ] {
        let mut state = fresh;
        let inputs = Inputs {
            front: front.map(turned),
            rear: rear.map(turned),
            beam: None,
            ..Inputs::default()
        };
        fusion.step(&mut state, &inputs);
        let walked = walk * walk * 0.01 * f64::from(ticks);
        let error = variance(&state) - variance(&fresh) - walked;
        assert!(error.abs() < 1e-3 * walk * walk * 0.01, "{ticks} {error:e}");
        // The relative heading changes only if exactly one axle has turned.
        let [before, after] = [fresh, state].map(|state| *state.joint().unwrap());
        let one_turned = front.is_some() != rear.is_some();
        assert_eq!(
            after.relative_posture().phi != before.relative_posture().phi,
            one_turned
        );
        assert_eq!(after.loading(), before.loading());
    }
    let mut state = fresh;
    let inputs = Inputs {
        front: Some(turned(1)),
        rear: Some(rest()),
        beam: None,
        ..Inputs::default()
    };
    fusion.step(&mut state, &inputs);
    let joint = state.joint().unwrap();
    assert_eq!(joint.loading().0, joint.relative_posture().phi);
    assert!(joint.loading().0 > 5e-3);
}

#[test]
fn zeroed_gyro_loses_its_bias_estimate_and_the_other_keeps_it() {
    let fusion = fusion(Mode::Joint);
    for (front, rear) in [(None, None), (None, Some(true)), (Some(true), Some(false))]
        .into_iter()
        .chain([(Some(false), Some(true)), (Some(true), Some(true))])
    {
        let mut state = start(&fusion, Posture::ORIGIN);
        for axle in 0..2 {
            state.set_constant(constants::GYRO_BIAS + axle, 1e-4);
        }
        let inputs = [front, rear].map(|zeroed| {
            zeroed.map(|gyro_zeroed| Increment {
                gyro_zeroed,
                ..rest()
            })
        });
        let inputs = Inputs {
            front: inputs[0],
            rear: inputs[1],
            beam: None,
            ..Inputs::default()
        };
        fusion.step(&mut state, &inputs);
        let left = state.joint().unwrap().constants();
        for (axle, zeroed) in [front, rear].into_iter().enumerate() {
            let expected = if zeroed == Some(true) { 0.0 } else { 1e-4 };
            assert_eq!(
                left[constants::GYRO_BIAS + axle],
                expected,
                "{front:?} {rear:?}"
            );
        }
    }
}

#[test]
fn relative_heading_is_front_minus_rear_wrapped() {
    for (front, rear, expected) in [(0.3, -0.4, 0.7), (3.0, -3.0, 6.0 - core::f32::consts::TAU)] {
        let at = |phi| Estimate::new(Posture::new(0.0, 0.0, phi), [[0.0; 3]; 3]);
        let output = Output {
            front: at(front),
            rear: at(rear),
            ..Output::default()
        };
        assert!((output.relative_heading().0 - expected).abs() < 1e-6);
    }
}

/// Both axles climb ridges 3 mm longer than their horizontal way, one after the other, at 0.25 m/s with gyros. The beam
/// measures the true posture, a straight frame. Returns the state at the end, the largest unevenness and the largest NIS.
fn over_ridges(ridges: u16, rate_per_m: f32) -> (State, f32, f32) {
    let mut config = Config::default();
    config.ground.rate_per_m = rate_per_m;
    let fusion = config.build().unwrap();
    let mut state = start(&fusion, Posture::ORIGIN);
    let (mut most_uneven, mut most_nis) = (0.0f32, 0.0f32);
    for tick in 0..200 * (ridges + 1) {
        // The front axle climbs after 50 ticks of each ridge, the rear axle after 120, within 20 ticks of 2.5 mm.
        let moved = |at: u16| {
            let climbs = tick / 200 < ridges && (at..at + 20).contains(&(tick % 200));
            Increment {
                posture: Posture::new(2.5e-3 + if climbs { 1.5e-4 } else { 0.0 }, 0.0, 0.0),
                gyro_share: 1.0,
                ..forward()
            }
        };
        let output = fusion.step(
            &mut state,
            &Inputs {
                front: Some(moved(50)),
                rear: Some(moved(120)),
                beam: Some(straight()),
                ..Inputs::default()
            },
        );
        most_uneven = most_uneven.max(state.unevenness.value);
        most_nis = most_nis.max(output.beam.nis);
    }
    (state, most_uneven, most_nis)
}

#[test]
fn climbing_raises_the_unevenness_which_fades_again() {
    let (_, uneven_on_floor, nis) = over_ridges(0, 60.0);
    assert!(
        uneven_on_floor == 0.0 && nis < 0.25,
        "{uneven_on_floor} {nis}"
    );
    let (seen, uneven, nis) = over_ridges(6, 60.0);
    let (blind, none, nis_blind) = over_ridges(6, 0.0);
    assert!(
        uneven > 0.1 && seen.unevenness.value == 0.0 && none == 0.0,
        "{uneven}"
    );
    assert!(nis < nis_blind, "{nis} {nis_blind}");
    // Where the ground was uneven, the claimed position is less certain.
    let sigma = |state: &State| state.joint().unwrap().estimates().robot.covariance[0][0];
    assert!(sigma(&seen) > sigma(&blind));
}

/// Change of the unevenness by its definition: rate · distance · (NIS − usual NIS), between 0 and the largest.
#[test]
fn unevenness_follows_the_nis_within_its_limits() {
    let config = ground::Config {
        most: 8.0,
        ..ground::Config::default()
    };
    let ground = config.build().unwrap();
    let after = |value, driven, nis| {
        let mut state = ground::Unevenness {
            value,
            spent_m: 0.0,
        };
        ground.step(&mut state, driven, nis, 40.0);
        state.value
    };
    assert!((after(1.0, 2e-3, 10.25) - 2.2).abs() < 1e-5);
    assert!((after(1.0, 2e-3, 0.05) - 0.976).abs() < 1e-5);
    assert_eq!(after(0.01, 1.0, 0.0), 0.0);
    assert_eq!(after(1.0, 0.0, 30.0), 1.0, "at rest");
    assert_eq!(after(1.0, 1e-3, 90.0), after(1.0, 1e-3, 40.0));
    for nis in [f32::INFINITY, f32::NAN] {
        assert_eq!(after(0.0, 1.0, nis), config.most);
    }
    let variances = ground.variances(2.0, 0.5, 0.25);
    let expected = [3.6e-5, 6.4e-5, 0.75 * 9e-4 + 0.25 * 1.6e-5];
    for (found, expected) in variances.into_iter().zip(expected) {
        assert!((found / expected - 1.0).abs() < 1e-5, "{found}");
    }
}

#[test]
fn contradiction_all_the_way_spends_the_budget_and_agreement_refills_it() {
    let config = ground::Config::default();
    let ground = config.build().unwrap();
    let mut state = ground::Unevenness::default();
    let mut drive = |millimetres: u16, nis: f32| {
        for _ in 0..millimetres {
            ground.step(&mut state, 1e-3, nis, 40.0);
        }
        ground.is_spent(&state)
    };
    // Each millimetre spends 0.7 mm.
    let budget = (1000.0 * config.budget_m / (1.0 - config.usual_share)) as u16;
    assert!(!drive(budget - 3, 2.0));
    assert!(drive(6, f32::NAN));
    assert!(!drive(20, 1.0));
    assert!(!drive(5000, 1.0));
    // A quarter of the way, in pieces of 60 mm.
    for _ in 0..50 {
        assert!(!drive(60, 20.0));
        assert!(!drive(180, 0.0));
    }
}

#[test]
fn beam_is_refused_while_the_budget_is_spent() {
    let mut config = Config::default();
    config.ground.contrary_nis = 1e-6;
    config.ground.budget_m = 0.02;
    let fusion = config.build().unwrap();
    let mut state = start(&fusion, Posture::ORIGIN);
    let mut offset = 1e-3;
    let verdicts = [(); 40].map(|()| {
        offset = -offset;
        let inputs = Inputs {
            front: Some(forward()),
            rear: Some(forward()),
            beam: Some(Estimate {
                posture: Posture::new(straight().posture.x + offset, 0.0, 0.0),
                ..straight()
            }),
            ..Inputs::default()
        };
        fusion.step(&mut state, &inputs).beam.verdict
    });
    assert_eq!(verdicts[0], Verdict::Used);
    assert!(verdicts.contains(&Verdict::Gated));
}

#[test]
fn configuration_is_checked() {
    crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
        ("period_s", |c| c.period_s = f32::NAN),
        ("creep_per_sqrt_s", |c| c.slip.creep_per_sqrt_s = -1.0),
        ("frame_sigmas", |c| c.frame_sigmas[1] = 0.0),
        ("scale_sigma", |c| c.joint.scale_sigma = f32::INFINITY),
        ("rate_per_m", |c| c.ground.rate_per_m = -1.0),
        ("usual_nis", |c| c.ground.usual_nis = 0.0),
    ]);
}

impl State {
    /// Sets a constant of the joint filter as if estimated.
    pub(crate) fn set_constant(&mut self, constant: usize, value: f32) {
        let Tracks::Joint(joint) = &mut self.tracks else {
            panic!("no joint filter");
        };
        joint.set_constant(constant, value);
    }
}
