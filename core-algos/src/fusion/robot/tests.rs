use super::*;

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

/// Both axles moved alike.
fn inputs(moved: Increment, beam: Option<Estimate>) -> Inputs {
    Inputs {
        front: Some(moved),
        rear: Some(moved),
        beam,
    }
}

/// Repairing the covariance ahead of the next tick gives every output of repairing it then.
#[test]
fn preparing_changes_nothing_but_when_it_is_done() {
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
fn opposite_creep_is_seen_by_the_beam_and_shared_by_both_axles() {
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
fn a_lost_message_only_delays() {
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

#[test]
fn what_is_not_finite_counts_as_absent() {
    for mode in MODES {
        let fusion = fusion(mode);
        let fresh = start(&fusion, Posture::ORIGIN);
        for bad in [f32::NAN, f32::INFINITY, -1e-9] {
            let mut state = fresh;
            let mut increment = forward();
            increment.posture.y = bad;
            let mut beam = straight();
            beam.covariance[0][0] = bad;
            let mut one_axle = inputs(increment, Some(beam));
            one_axle.rear = None;
            assert!(fusion.step(&mut state, &one_axle).robot.is_finite());
            let output = fusion.step(&mut state, &inputs(rest(), Some(beam)));
            assert!(output.front.is_finite() && output.rear.is_finite());
            let expected = match mode {
                Mode::Odometry => Verdict::Absent,
                _ => Verdict::Invalid,
            };
            assert_eq!(output.beam.verdict, expected);
        }
    }
}

/// The random errors of joined axles may be fully correlated: twice the independent covariance.
#[test]
fn joined_axles_claim_twice_the_independent_covariance() {
    let exact = |posture| Estimate::new(posture, [[0.0; 3]; 3]);
    let noisy = |sigma: f32| {
        let covariance = matrix::diagonal([sigma * sigma; 3]);
        Some(Increment::new(Posture::ORIGIN, covariance))
    };
    let step = |mode, front, rear, beam| {
        let fusion = fusion(mode);
        let mut state = fusion.start(&exact(Posture::ORIGIN), &exact(straight().posture), 0.0);
        fusion.step(&mut state, &Inputs { front, rear, beam })
    };
    for (mode, factor) in [(Mode::Odometry, 1.0), (Mode::Intersection, 2.0)] {
        let robot = step(mode, noisy(0.1), noisy(0.1), None).robot;
        let ratio = robot.covariance[0][0] / (factor * 0.5 * 0.01);
        assert!((ratio - 1.0).abs() < 0.02, "{mode:?} {ratio}");
    }
    let turned = Estimate::with_sigmas(Posture::new(0.37, 0.0, 0.2), BEAM_SIGMAS);
    let update = step(Mode::Intersection, noisy(0.1), noisy(1e-3), Some(turned)).beam;
    assert!((update.nis / (0.04 / (2.0 * 0.01)) - 1.0).abs() < 0.02);
}

#[test]
fn a_leaping_beam_is_gated_until_it_insists() {
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

#[test]
fn bent_frame_creeps_at_standstill_in_the_covariance() {
    for mode in [Mode::Odometry, Mode::Joint] {
        let growth = |heading: f32| {
            let mut config = Config {
                mode,
                ..Config::default()
            };
            // Without a beam a load of the frame that nobody knows of would hide it.
            config.slip.load_speed_m_s = 0.0;
            let fusion = config.build().unwrap();
            let bent = Posture::new(0.36, 0.18 * heading, heading);
            let relative = Estimate::with_sigmas(bent, [1e-3; 3]);
            let robot = Estimate::with_sigmas(Posture::ORIGIN, [1e-3; 3]);
            let mut state = fusion.start(&robot, &relative, 0.01);
            let inputs = inputs(rest(), None);
            let first = fusion.step(&mut state, &inputs).front.covariance[2][2];
            let mut last = first;
            for _ in 0..200 {
                last = fusion.step(&mut state, &inputs).front.covariance[2][2];
            }
            last - first
        };
        assert!(growth(0.5) > 10.0 * growth(0.0), "{mode:?}");
        assert!(growth(0.0) > 0.0, "{mode:?}");
    }
}

#[test]
fn configuration_is_checked() {
    crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
        ("period_s", |c| c.period_s = f32::NAN),
        ("creep_per_sqrt_s", |c| c.slip.creep_per_sqrt_s = -1.0),
        ("frame_sigmas", |c| c.frame_sigmas[1] = 0.0),
        ("scale_sigma", |c| c.joint.scale_sigma = f32::INFINITY),
    ]);
}

impl State {
    /// Sets a constant of the joint filter as if it had been learnt.
    pub(crate) fn set_constant(&mut self, constant: usize, value: f32) {
        let Tracks::Joint(joint) = &mut self.tracks else {
            panic!("no joint filter");
        };
        joint.set_constant(constant, value);
    }
}
