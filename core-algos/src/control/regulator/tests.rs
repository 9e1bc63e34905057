use super::*;
use proptest::prelude::{any, prop, prop_assert};

mod phases;

/// A robot without lag, except for limits of 1 rad/s of steering and 0.4 m/s² of acceleration.
struct Robot {
    q: [f64; 3],
    v: f64,
    psi: f64,
}

impl Robot {
    fn at(posture: Posture) -> Self {
        Self {
            q: [posture.x, posture.y, posture.phi].map(f64::from),
            v: 0.0,
            psi: 0.0,
        }
    }

    fn posture(&self) -> Posture {
        let [x, y, phi] = self.q;
        Posture::new(x as f32, y as f32, phi.sin().atan2(phi.cos()) as f32)
    }

    fn apply(&mut self, command: Command) {
        let kappa = |psi: f64| 2.0 * psi / (0.37 * psi.cos());
        let wanted = f64::from(command.kappa);
        // The steering moves towards the wanted curvature by at most 10 mrad a tick.
        for _ in 0..10 {
            let short = wanted - kappa(self.psi);
            self.psi += 1e-3 * (short / 0.005).clamp(-1.0, 1.0);
        }
        self.v += (f64::from(command.v) - self.v).clamp(-0.004, 0.004);
        let turn = 0.01 * self.v * kappa(self.psi);
        let direction = self.q[2] + 0.5 * turn;
        self.q[0] += 0.01 * self.v * direction.cos();
        self.q[1] += 0.01 * self.v * direction.sin();
        self.q[2] += turn;
    }
}

/// Planning ahead gives bit-identical outputs. All parts together use the whole budget of the tick.
#[test]
fn planning_ahead_does_not_change_the_output() {
    let regulator = Config::default().build().unwrap();
    let goal = Posture::ORIGIN;
    for (parts, calls) in [(9, 9), (9, 4), (1, 3), (400, 17)] {
        let start = Posture::new(0.1, -0.4, 2.5);
        let (mut robot, mut state) = (Robot::at(start), State::default());
        let (mut other, mut ahead) = (Robot::at(start), State::default());
        let mut planning = 0;
        for _ in 0..600 {
            for _ in 0..calls {
                regulator.plan_ahead(&mut ahead, parts);
            }
            if ahead.phase == Phase::Plan && parts == calls {
                let budget = regulator.config.planner_budget;
                assert_eq!(ahead.ahead, budget);
                planning += 1;
            }
            let output = regulator.tick(&mut state, &input(&robot, goal));
            assert_eq!(regulator.tick(&mut ahead, &input(&other, goal)), output);
            assert_eq!(ahead, state);
            robot.apply(output.command);
            other.apply(output.command);
        }
        assert!(planning > 3 || parts != calls, "{planning}");
    }
}

fn run(
    regulator: &Regulator,
    state: &mut State,
    robot: &mut Robot,
    goal: Posture,
    ticks: usize,
) -> Output {
    let mut output = regulator.tick(state, &input(robot, goal));
    for _ in 0..ticks {
        robot.apply(output.command);
        output = regulator.tick(state, &input(robot, goal));
        if output.done {
            break;
        }
    }
    output
}

/// Friction holds a robot at a small commanded speed. The robot is done at its posture or gives up; it does not wait
/// forever.
#[test]
fn robot_held_by_friction_before_the_goal_is_done_or_gives_up() {
    for (sticking, expected) in [(0.012, Phase::Done), (0.3, Phase::GaveUp)] {
        let regulator = Config::default().build().unwrap();
        let mut robot = Robot::at(Posture::new(-0.4, 0.02, 0.0));
        let mut state = State::default();
        for _ in 0..20_000 {
            let mut output = regulator.tick(&mut state, &input(&robot, Posture::ORIGIN));
            if output.command.v.abs() < sticking {
                (output.command.v, robot.v) = (0.0, 0.0);
            }
            robot.apply(output.command);
        }
        assert_eq!(state.phase, expected, "{:?}", robot.q);
    }
}

/// The estimate is corrected sideways in every approach. After corrections of 6 cm, within the tolerance of 10 cm, the
/// goal counts as reached. After corrections of 20 cm the regulator gives up.
#[test]
fn corrections_within_the_tolerance_end_at_the_goal() {
    let regulator = Config::default().build().unwrap();
    let most = usize::from(regulator.config.max_attempts);
    for (size, expected) in [(0.06, Phase::Done), (0.2, Phase::GaveUp)] {
        let (mut robot, mut state) = (Robot::at(Posture::new(-0.6, 0.2, 0.3)), State::default());
        let (mut phase, mut offset, mut count) = (Phase::Stop, 0.0, 0);
        let mut corrected = false;
        for _ in 0..200_000 {
            let mut estimated = input(&robot, Posture::ORIGIN);
            estimated.posture.y += offset;
            let output = regulator.tick(&mut state, &estimated);
            phase = output.phase;
            corrected &= phase == Phase::Approach;
            let close = estimated.posture.distance(Posture::ORIGIN) < 0.15;
            if phase == Phase::Approach && close && !corrected {
                corrected = true;
                count += 1;
                offset += if count % 2 == 0 { size } else { -size };
            }
            robot.apply(output.command);
            if matches!(phase, Phase::Done | Phase::GaveUp) {
                break;
            }
        }
        assert_eq!(phase, expected, "after {count} corrections");
        assert!(count <= most + 1, "{count}");
    }
}

fn input(robot: &Robot, goal: Posture) -> Input {
    Input {
        posture: robot.posture(),
        steering: Steering(robot.psi as f32),
        speed_m_s: robot.v as f32,
        goal,
        within: Tolerance::default(),
    }
}

fn regulator(strategy: Strategy) -> Regulator {
    Config {
        strategy,
        ..Config::default()
    }
    .build()
    .unwrap()
}

properties! { cases 100;
    #[test]
    fn reaches_the_goal_from_anywhere(
        start in prop::array::uniform3(-2.0f32..2.0), turn in -3.1f32..3.1,
        goal in prop::array::uniform3(-3.0f32..3.0),
    ) {
        let regulator = regulator(Strategy::Funnel);
        let goal = Posture::from(goal);
        let start = goal.compose(Posture::new(start[0], start[1], turn));
        let (mut state, mut robot) = (State::default(), Robot::at(start));
        let output = run(&regulator, &mut state, &mut robot, goal, 12_000);
        prop_assert!(output.done, "{:?}", output.phase);
        let [dx, dy, turn] = robot.posture().minus(goal);
        let widest = WIDENING.powi(state.attempts().into()) + 1e-3;
        let Config { accept_distance_m, accept_heading_rad, .. } = regulator.config;
        prop_assert!(dx.hypot(dy) < widest * accept_distance_m, "{dx} {dy}");
        prop_assert!(turn.abs() < widest * accept_heading_rad, "{turn}");
        prop_assert!(robot.v.abs() < 5e-3);
    }

    /// For any inputs in any order, the command is within the limits.
    #[test]
    fn output_is_always_within_the_limits(
        inputs in prop::collection::vec(
            (prop::array::uniform5(prop::num::f32::ANY), prop::array::uniform3(-3.0f32..3.0), any::<bool>()),
            1..60,
        ),
        paper: bool,
    ) {
        let regulator = regulator(if paper { Strategy::PaperLaw } else { Strategy::Funnel });
        let bound = regulator.limits.max_curvature();
        let mut state = State::default();
        for (wild, tame, is_wild) in inputs {
            let output = regulator.tick(&mut state, &Input {
                posture: if is_wild { Posture::new(wild[0], wild[1], wild[2]) } else { tame.into() },
                steering: Steering(wild[3]),
                speed_m_s: wild[4],
                goal: Posture::ORIGIN,
                within: Tolerance::default(),
            });
            prop_assert!(output.command.v.abs() <= 0.25);
            prop_assert!(output.command.kappa.abs() <= bound);
            prop_assert!(!(output.feed_stop && output.command.v != 0.0));
        }
    }
}

/// Reference: curvatures of eq. 5 at steering angles 10 mrad apart.
#[test]
fn steering_error_matches_the_difference_of_angles() {
    let regulator = Config::default().build().unwrap();
    let length = regulator.config.limits.frame_length_m;
    for psi in [-0.3, -0.1, 0.0, 0.2, 0.3] {
        for error in [-0.01f32, 0.01] {
            let kappa = curvature_of_steering(Steering(psi + error), length);
            let found = regulator.steering_error(kappa, Steering(psi));
            assert!((found - error).abs() < 5e-4, "{psi}: {found}");
        }
    }
}

/// Reference: integrated distance to rest. The deceleration is the smaller of the governor's and that of its lag.
#[test]
fn stopping_distance_is_the_integral_of_the_speed() {
    let regulator = Config::default().build().unwrap();
    let (braking, lag) = (
        f64::from(regulator.config.braking_m_s2),
        f64::from(regulator.config.speed_lag_s),
    );
    for speed in [0.01f32, 0.05, 0.15, 0.25] {
        let (mut v, mut distance) = (f64::from(speed), 0.0);
        while v > 1e-7 {
            distance += 1e-5 * v;
            v -= 1e-5 * braking.min(v / lag);
        }
        let found = f64::from(regulator.stopping_distance(speed));
        assert!(
            (found - distance).abs() < 0.01 * distance,
            "{speed}: {found} {distance}"
        );
    }
}

#[test]
fn final_arc_leads_through_the_goal() {
    let regulator = Config::default().build().unwrap();
    let mut robot = Robot::at(Posture::new(-0.6, 0.05, 0.0));
    let mut state = State::default();
    let arc = (0..3000).find_map(|_| {
        let output = regulator.tick(&mut state, &input(&robot, Posture::ORIGIN));
        let arc = state
            .final_curvature
            .map(|curvature| (robot.posture(), curvature));
        robot.apply(output.command);
        arc
    });
    let (from, curvature) = arc.unwrap();
    let on_arc = |k: u8| from.advance(1e-3 * f32::from(k), 1e-3 * f32::from(k) * curvature);
    let distances = (0..255).map(|k| on_arc(k).distance(Posture::ORIGIN));
    let nearest = distances.fold(f32::MAX, f32::min);
    assert!(nearest < 6e-4, "{nearest}, {curvature} from {from:?}");
}

/// The approach is slower while the steering error is large.
#[test]
fn approach_waits_for_steering() {
    let regulator = Config::default().build().unwrap();
    let mut robot = Robot::at(Posture::new(-1.0, 0.1, 0.0));
    let mut state = State::default();
    run(&regulator, &mut state, &mut robot, Posture::ORIGIN, 250);
    assert_eq!(state.phase, Phase::Approach);
    let steered = robot.psi;
    let mut speed = |steering: f64| {
        robot.psi = steering;
        let mut state = state;
        let input = input(&robot, Posture::ORIGIN);
        regulator.tick(&mut state, &input).command.v
    };
    let [there, away, far] = [0.0, 0.15, 0.6].map(|by| speed(steered + by));
    assert!(
        there > 0.1 && away < there && far == 0.0,
        "{there} {away} {far}"
    );
}

#[test]
fn papers_law_reaches_the_goal_from_the_papers_start() {
    let regulator = regulator(Strategy::PaperLaw);
    let mut robot = Robot::at(Posture::new(-1.342, -1.342, 0.0));
    let mut state = State::default();
    let output = run(&regulator, &mut state, &mut robot, Posture::ORIGIN, 6000);
    assert!(output.done);
    let [x, y, phi] = robot.q;
    assert!(x.hypot(y) < 0.02 && phi.abs() < 0.05, "{:?}", robot.q);
}

#[test]
fn robot_pushed_off_its_goal_returns() {
    let regulator = regulator(Strategy::Funnel);
    let mut robot = Robot::at(Posture::new(-0.6, 0.05, 0.0));
    let mut state = State::default();
    assert!(run(&regulator, &mut state, &mut robot, Posture::ORIGIN, 6000).done);
    // A small push is within the hysteresis; a larger push is not.
    robot.q[1] += 0.012;
    let output = regulator.tick(&mut state, &input(&robot, Posture::ORIGIN));
    assert!(output.done);
    robot.q[1] += 0.05;
    let output = regulator.tick(&mut state, &input(&robot, Posture::ORIGIN));
    assert_eq!(output.phase, Phase::Stop);
    assert!(run(&regulator, &mut state, &mut robot, Posture::ORIGIN, 12_000).done);
    assert!(robot.q[0].hypot(robot.q[1]) < 0.01);
}

#[test]
fn new_goal_restarts_and_lost_estimate_stops_the_robot() {
    let regulator = regulator(Strategy::Funnel);
    let mut robot = Robot::at(Posture::new(-1.0, 0.0, 0.0));
    let mut state = State::default();
    let output = run(&regulator, &mut state, &mut robot, Posture::ORIGIN, 200);
    assert_eq!(output.phase, Phase::Approach);
    let before = state;
    let mut lost = input(&robot, Posture::ORIGIN);
    lost.posture.x = f32::NAN;
    assert_eq!(regulator.tick(&mut state, &lost).command.v, 0.0);
    assert_eq!(state, before);
    let other = Posture::new(1.0, 1.0, 2.0);
    let output = regulator.tick(&mut state, &input(&robot, other));
    assert_eq!(output.phase, Phase::Stop);
    assert!(run(&regulator, &mut state, &mut robot, other, 12_000).done);
    assert!(robot.posture().distance(other) < 0.01);
}

#[test]
fn bad_parameters_are_named() {
    crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
        ("steering_wait_rad", |c| {
            c.steering_wait_rad = c.steering_tolerance_rad
        }),
        ("accept_distance_m", |c| c.accept_distance_m = f32::NAN),
        ("accept_distance_m", |c| c.accept_distance_m = f32::INFINITY),
        ("accept_distance_m", |c| {
            c.latch_distance_m = c.accept_distance_m.next_up()
        }),
        ("approach.circle_radius_m", |c| c.approach = c.law),
    ]);
    let equal = Config {
        latch_distance_m: Config::default().accept_distance_m,
        ..Config::default()
    };
    assert!(equal.build().is_ok());
}
