mod on_plant;

use super::*;
use crate::control::path::PathPoint;

type Order<'a> = Task<'a, 256, 16>;

fn train(axles: u8) -> Train {
    let config = Config {
        axles,
        ..Config::default()
    };
    config.build().unwrap()
}

/// Axles of a straight robot whose first axle is at the origin.
fn straight(axles: u8) -> [Posture; MAX_AXLES] {
    let mut postures = [Posture::ORIGIN; MAX_AXLES];
    for (i, posture) in postures.iter_mut().enumerate().take(axles.into()) {
        posture.x = -0.37 * i as f32;
    }
    postures
}

/// The axles stand at their references: a robot without errors.
fn ideal(step: &Step) -> [Posture; MAX_AXLES] {
    step.references.map(|reference| reference.posture)
}

#[test]
fn references_are_integral_and_derivative_of_their_twists() {
    for axles in 3..=5 {
        let (train, mut state) = (train(axles), State::NEW);
        let mut postures = straight(axles);
        let mut last: Option<Step> = None;
        for epoch in 0..900 {
            let task = Order::Drive {
                speed_m_s: if epoch < 500 { 0.2 } else { -0.2 },
                curvature: if epoch % 200 < 100 { 2.0 } else { -1.0 },
            };
            let step = train.step(&mut state, &postures, task);
            postures = ideal(&step);
            if let Some(last) = last {
                for (a, b) in last.references.iter().zip(&step.references) {
                    let v = 0.5 * (a.twist.v + b.twist.v);
                    let omega = 0.5 * (a.twist.omega + b.twist.omega);
                    let expected = a.posture.advance(v * EPOCH_S, omega * EPOCH_S);
                    assert!(expected.distance(b.posture) < 1e-5, "{epoch} {a:?} {b:?}");
                    let [_, _, turn] = expected.minus(b.posture);
                    assert!(turn.abs() < 3e-4, "{epoch} {turn}");
                    let gained = EPOCH_S * b.acceleration.v;
                    assert!((b.twist.v - a.twist.v - gained).abs() < 2e-4, "{epoch}");
                }
            }
            last = Some(step);
        }
    }
}

#[test]
fn robot_at_its_goal_does_not_move() {
    let (train, mut state) = (train(4), State::NEW);
    let postures = straight(4);
    let goal = Posture::new(-0.555, 0.0, 0.0);
    let mut steps = Vec::new();
    for _ in 0..100 {
        let task = Order::Regulate {
            goal,
            within: Tolerance::default(),
        };
        let step = train.step(&mut state, &postures, task);
        assert!(step.v == 0.0 && !matches!(step.phase, Phase::Plan | Phase::Approach));
        steps.push(step);
    }
    // The time at a cusp, then the time at rest before the posture counts.
    let epochs = |phase| steps.iter().filter(|step| step.phase == phase).count();
    assert!(
        (18..=22).contains(&epochs(Phase::Hold)),
        "{}",
        epochs(Phase::Hold)
    );
    assert!(steps.last().unwrap().done && epochs(Phase::Done) > 50);
    // Another task does not inherit the result.
    let step = train.step(&mut state, &postures, Order::Stop);
    assert!(!step.done && step.phase == Phase::Stop);
}

/// A robot whose axles do not move: the references wait, and the second time in the same place it gives up.
#[test]
fn blocked_robot_waits_and_gives_up() {
    let (train, mut state) = (train(3), State::NEW);
    let postures = straight(3);
    let mut largest = 0.0f32;
    for epoch in 0..3000 {
        let task = Order::Regulate {
            goal: Posture::new(2.0, 0.5, 0.0),
            within: Tolerance::default(),
        };
        let step = train.step(&mut state, &postures, task);
        for (axle, reference) in postures.iter().zip(&step.references) {
            largest = largest.max(axle.distance(reference.posture));
        }
        if step.gave_up {
            assert!(state.is_blocked());
            // The reference waits for the axle at the configured distance, plus the way to brake.
            assert!(largest < 0.08, "{largest}");
            // The place where it began counts as the first.
            assert!(epoch as f32 * EPOCH_S > STUCK_S, "{epoch}");
            return;
        }
    }
    panic!("the robot did not give up");
}

/// A robot that friction holds 3 cm from its goal is not blocked: each attempt accepts a larger error.
#[test]
fn robot_held_within_the_tolerance_of_its_goal_is_done() {
    let (train, mut state) = (train(3), State::NEW);
    let (goal, within) = (Posture::new(0.5, 0.0, 0.0), Tolerance::default());
    let mut postures = straight(3);
    for _ in 0..4000 {
        let step = train.step(&mut state, &postures, Order::Regulate { goal, within });
        assert!(!step.gave_up && !step.lost, "{step:?}");
        if goal.distance(midpoint(&postures[..3])) > 0.03 {
            postures = ideal(&step);
        } else if step.done {
            return;
        }
    }
    panic!("not done: {:?}", state.phase());
}

/// Plans keep the largest curvature, which is that of the steering limit or of the planner, whichever is less.
#[test]
fn plan_keeps_the_largest_curvature() {
    for (limit, expected) in [(1.0, 1.0), (3.0, 0.85 / 0.37)] {
        let config = Config {
            max_curvature_per_m: limit,
            ..Config::default()
        };
        let (train, mut state) = (config.build().unwrap(), State::NEW);
        let (goal, within) = (Posture::new(0.5, 1.2, 3.0), Tolerance::default());
        let (mut postures, mut largest, mut done) = (straight(3), 0.0f32, false);
        for _ in 0..6000 {
            let step = train.step(&mut state, &postures, Order::Regulate { goal, within });
            postures = ideal(&step);
            largest = largest.max(step.kappa.abs());
            done = step.done;
        }
        assert!(
            done && (largest / expected - 1.0).abs() < 0.01,
            "{largest} {expected}"
        );
        assert!(postures[0].relative_to(goal).y.abs() < 1e-3);
    }
}

/// The leader keeps up with a trajectory that accelerates.
#[test]
fn leader_keeps_up_with_an_accelerating_trajectory() {
    let (train, mut state) = (train(3), State::NEW);
    let mut trajectory = TrajectoryBuffer::<64>::new();
    // 0.15 m/s² for a second, after a second at rest.
    let law = |t: f32| match t - 1.0 {
        t if t < 0.0 => (0.0, 0.0),
        t if t < 1.0 => (0.075 * t * t, 0.15 * t),
        t => (0.15 * t - 0.075, 0.15),
    };
    for k in 0..60u8 {
        let time_s = 0.05 * f32::from(k);
        let (s, v) = law(time_s);
        let posture = Posture::new(s, 0.0, 0.0);
        let point = PathPoint {
            posture,
            kappa: 0.0,
            s,
        };
        trajectory
            .push(crate::control::path::TrajectoryPoint { time_s, v, point })
            .unwrap();
    }
    trajectory.finish();
    let mut postures = straight(3);
    for epoch in 0..600u16 {
        let time_s = EPOCH_S * f32::from(epoch);
        let task: Task<'_, 256, 64> = Task::Track {
            trajectory: &mut trajectory,
            time_s,
            within: Tolerance::default(),
        };
        let step = train.step(&mut state, &postures, task);
        postures = ideal(&step);
        // Beyond the end, at 2.95 s, the leader goes on at the speed of regulation for half a body.
        let beyond = (0.2 * (time_s - 2.95)).clamp(0.0, 0.37);
        let behind = law(time_s.min(2.95)).0 + beyond - postures[0].x;
        // Where the leader brakes, it is behind.
        let largest = match time_s {
            0.0..3.0 => 4e-3,
            4.65.. => 0.02,
            _ => 6e-3,
        };
        assert!(behind.abs() < largest, "{time_s}: {behind}");
    }
    let left = law(2.95).0 + 0.37 - postures[0].x;
    assert!(left.abs() < 1e-4, "{left}");
}

/// A second path has its own arc length: the robot enters it at its start, not at the length driven so far.
#[test]
fn new_path_is_entered_anew() {
    let (train, mut state) = (train(3), State::NEW);
    let mut postures = straight(3);
    let mut drive = |state: &mut State, kappa: f32, start: Posture, epochs: u16| {
        let mut path = PathBuffer::<256>::new();
        let mut on = Posture::ORIGIN;
        for k in 0..150u8 {
            let s = 0.01 * f32::from(k);
            let posture = start.compose(on);
            path.push(PathPoint { posture, kappa, s }).unwrap();
            on = on.advance(0.01, 0.01 * kappa);
        }
        let mut largest = 0.0f32;
        for _ in 0..epochs {
            let task = Order::Follow {
                path: &mut path,
                within: Tolerance::default(),
            };
            let step = train.step(state, &postures, task);
            postures = ideal(&step);
            largest = largest.max(step.off_path_m.abs());
        }
        (largest, postures[0])
    };
    let (_, reached) = drive(&mut state, 0.0, Posture::ORIGIN, 350);
    assert!((0.4..0.8).contains(&reached.x));
    state.restart_task();
    let (largest, _) = drive(&mut state, 0.5, reached, 250);
    assert!(largest < 0.01, "{largest}");
}

/// A robot that is to drive and does not move is stuck.
#[test]
fn robot_that_does_not_move_is_stuck_after_its_time() {
    let (train, mut state) = (train(3), State::NEW);
    let task = || Order::Drive {
        speed_m_s: 0.1,
        curvature: 0.0,
    };
    let at = |state: &mut State| (0..1000).find(|_| train.step(state, &straight(3), task()).stuck);
    let epochs = at(&mut state).unwrap();
    let built = 4;
    assert!(
        (0.0..0.05).contains(&(EPOCH_S * (epochs - built) as f32 - STUCK_S)),
        "{epochs}"
    );
}

/// A robot that is beside its goal whenever its posture counts has one attempt and `max_attempts` further ones.
#[test]
fn robot_gives_up_after_the_last_attempt() {
    for max_attempts in [0, 2] {
        let config = Config {
            axles: 3,
            max_attempts,
            ..Config::default()
        };
        let (train, mut state) = (config.build().unwrap(), State::NEW);
        let (goal, within) = (Posture::new(0.5, 0.0, 0.0), Tolerance::default());
        let (mut postures, mut before, mut attempts) = (straight(3), Phase::Stop, 0);
        for _ in 0..20_000 {
            let step = train.step(&mut state, &postures, Order::Regulate { goal, within });
            postures = ideal(&step);
            if step.phase == Phase::Hold {
                for posture in &mut postures {
                    posture.y += 0.15;
                }
                attempts += u8::from(before != Phase::Hold);
            }
            before = step.phase;
            if step.gave_up || step.done {
                break;
            }
        }
        assert_eq!((before, attempts), (Phase::GaveUp, 1 + max_attempts));
    }
}

/// A new curve cannot pass all axles with their headings: the references begin at the axles, and come to the curve.
#[test]
fn what_is_left_between_the_axles_and_a_new_curve_fades_with_the_way() {
    let (train, mut state) = (train(3), State::NEW);
    let mut postures = straight(3);
    postures[1] = Posture::new(-0.368, 0.01, -0.08);
    let mut last = 1.0;
    for epoch in 0..800 {
        let task = Order::Drive {
            speed_m_s: 0.2,
            curvature: 0.0,
        };
        let step = train.step(&mut state, &postures, task);
        if state.rebuild.is_some() {
            continue;
        }
        let at = state.curve.at(state.places[1]).knot.posture;
        let [_, _, turn] = train.reference_posture(&state, 1).minus(at);
        if state.driven == 0.0 {
            let [_, _, first] = postures[1].minus(at);
            assert!((turn - first).abs() < 1e-4 && turn.abs() > 5e-4, "{turn}");
        }
        assert!(turn.abs() <= last, "{epoch}: {turn} {last}");
        last = turn.abs();
        postures = ideal(&step);
    }
    assert!(state.driven > train.config.fade_length_m && last < 1e-6);
}

/// A bent chain is estimated beside its places: ahead at one end, behind at the other. No axle pushes another, since the
/// frames keep the distances, and the robot drives on.
#[test]
fn chain_beside_its_places_corrects_the_mean_distance_alone() {
    for speed_m_s in [0.2, -0.2] {
        let (train, mut state) = (train(5), State::NEW);
        let mut postures = straight(5);
        let task = || Order::Drive {
            speed_m_s,
            curvature: 1.2,
        };
        for _ in 0..1200 {
            postures = ideal(&train.step(&mut state, &postures, task()));
        }
        let beside = Posture::new(0.0, 0.08, 0.0);
        let back = postures[2];
        let postures = postures.map(|it| back.compose(beside.compose(it.relative_to(back))));
        let step = train.step(&mut state, &postures, task());
        let own = step.references.iter().zip(&postures);
        let ahead: Vec<f32> = own.map(|(to, at)| to.posture.relative_to(*at).x).collect();
        let mean = ahead.iter().sum::<f32>() / 5.0;
        for ahead in &ahead {
            assert!((ahead - mean).abs() < 1e-4, "{ahead:?} {mean}");
        }
        let far = |i: usize| postures[i].distance(step.references[i].posture);
        assert!((far(2) - 0.08).abs() < 2e-3, "{}", far(2));
        assert!((step.v - speed_m_s).abs() < 1e-3, "{}", step.v);
    }
}

#[test]
fn estimate_that_is_not_finite_brakes_along_the_curve() {
    let (train, mut state) = (train(3), State::NEW);
    let mut postures = straight(3);
    let task = || Order::Drive {
        speed_m_s: 0.2,
        curvature: 1.0,
    };
    postures[1].y = f32::NAN;
    let step = train.step(&mut state, &postures, task());
    assert!(step.v == 0.0 && state.curve.is_empty());
    postures = straight(3);
    for _ in 0..200 {
        postures = ideal(&train.step(&mut state, &postures, task()));
    }
    postures[2].phi = f32::NAN;
    let mut last = 0.2;
    for _ in 0..40 {
        let step = train.step(&mut state, &postures, task());
        assert!(step.v <= last);
        assert!(
            step.references
                .iter()
                .all(|r| r.posture.is_finite() && r.twist.is_finite())
        );
        last = step.v;
    }
    assert_eq!(last, 0.0);
}

#[test]
fn wish_that_is_not_a_number_stands_and_impossible_axles_build_no_curve() {
    let (train, mut state) = (train(3), State::NEW);
    let mut far = straight(3);
    far[2].x = -3.0e9;
    let task = || Order::Drive {
        speed_m_s: f32::NAN,
        curvature: f32::NAN,
    };
    assert_eq!(train.step(&mut state, &far, task()).v, 0.0);
    assert!(state.curve.is_empty());
    for _ in 0..100 {
        let step = train.step(&mut state, &straight(3), task());
        assert!(step.v == 0.0 && step.kappa == 0.0);
    }
}

#[test]
fn robot_far_from_its_path_is_lost() {
    let (train, mut state) = (train(3), State::NEW);
    let mut path = PathBuffer::<256>::new();
    for k in 0..100u8 {
        let x = 0.01 * f32::from(k);
        path.push(PathPoint {
            posture: Posture::new(x, 0.9, 0.0),
            kappa: 0.0,
            s: x,
        })
        .unwrap();
    }
    let mut step = || {
        let task = Order::Follow {
            path: &mut path,
            within: Tolerance::default(),
        };
        train.step(&mut state, &straight(3), task)
    };
    // The curve is built in two epochs and one more a frame.
    assert!((0..4).all(|_| !step().lost));
    let step = step();
    assert!(step.lost && !step.done);
    state.restart_task();
    assert!(!train.step(&mut state, &straight(3), Order::Stop).lost);
}

#[test]
fn midpoint_is_the_mean_of_the_middles() {
    let axles = [
        Posture::new(1.0, 1.0, 0.0),
        Posture::new(0.5, 0.2, 0.0),
        Posture::new(0.0, 0.0, 0.0),
    ];
    let center = midpoint(&axles);
    assert!((center.x - 0.5).abs() < 1e-6 && (center.y - 0.35).abs() < 1e-6);
    assert!((center.phi - core::f32::consts::FRAC_PI_4).abs() < 1e-6);
}

#[test]
fn planning_ahead_changes_nothing() {
    let run = |ahead: bool| {
        let (train, mut state) = (train(3), State::NEW);
        let mut postures = straight(3);
        let mut steps = Vec::new();
        for _ in 0..400 {
            let task = Order::Regulate {
                goal: Posture::new(0.3, 0.8, 1.0),
                within: Tolerance::default(),
            };
            let step = train.step(&mut state, &postures, task);
            postures = ideal(&step);
            steps.push(step);
            for _ in 0..7 {
                if ahead {
                    train.plan_ahead(&mut state, 7);
                }
            }
        }
        steps
    };
    assert!(run(true) == run(false));
}

#[test]
fn state_fits_its_memory() {
    assert!(size_of::<State>() <= 5700, "{}", size_of::<State>());
}

#[test]
fn invalid_parameters_are_refused_by_name() {
    crate::config::refusal_of(Config::default(), Config::build).names(&[
        ("curvature_share", |c| c.curvature_share = 0.0),
        ("slope_share", |c| c.slope_share = f32::NAN),
        ("length_constant_m", |c| c.length_constant_m = 0.0),
        ("speed_m_s", |c| c.speed_m_s = -0.1),
        ("axles", |c| c.axles = 6),
        ("frame_length_m", |c| c.frame_length_m = 0.0),
    ]);
}
