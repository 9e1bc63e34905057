use super::*;
use crate::control::cascade;
use proptest::prelude::*;

fn frame() -> Cascade {
    cascade::Config::default().build().unwrap()
}

/// Interval between the steps of most tests, s.
const DT: f32 = 0.01;

fn governor() -> Governor {
    Config::default().build(&frame(), DT).unwrap()
}

fn stepped(governor: &Governor, state: &State, governor_input: &GovernorInput) -> State {
    let mut state = *state;
    governor.step(&mut state, governor_input);
    state
}

fn stopped(governor: &Governor, state: &State) -> State {
    let mut state = *state;
    governor.stop(&mut state);
    state
}

fn governor_input(v: f32, psi: f32) -> GovernorInput {
    GovernorInput {
        v,
        psi: Steering(psi),
        ..GovernorInput::default()
    }
}

/// Circumferential speed of the fastest wheel.
fn fastest_wheel(motion: &Motion, half_track: f32) -> f32 {
    frame()
        .axle_twists(motion)
        .iter()
        .map(|(twist, _)| twist.v.abs() + half_track * twist.omega.abs())
        .fold(0.0, f32::max)
}

fn run(governor: &Governor, mut state: State, governor_input: GovernorInput, time: f32) -> State {
    for _ in 0..(time / DT).round() as usize {
        state = stepped(governor, &state, &governor_input);
    }
    state
}

properties! { cases 200;
    /// All limits hold for any inputs, intervals and stops.
    #[test]
    fn no_limit_is_ever_exceeded(
        wheel in 0.3f32..0.7, max_speed in 0.1f32..1.0, dt in 0.0005f32..0.02,
        inputs in prop::collection::vec(
            (
                (-2.0f32..2.0, -1.0f32..1.0), (-1.0f32..1.0, -3.0f32..3.0), 1usize..60, 0u8..8,
            ),
            1..30,
        ),
    ) {
        let config = Config {
            max_wheel_speed_m_s: wheel, max_speed_m_s: max_speed, ..Config::default()
        };
        let governor = config.build(&frame(), dt).unwrap();
        let mut state = State::default();
        for ((v, v_rate), (psi, psi_rate), steps, kind) in inputs {
            let governor_input = GovernorInput { v, v_rate, psi: Steering(psi), psi_rate, ..GovernorInput::default() };
            for _ in 0..steps {
                let before = state.motion;
                state = match kind {
                    0 => stopped(&governor, &state),
                    1 => stepped(&governor, &state, &GovernorInput { v: f32::NAN, ..governor_input }),
                    _ => stepped(&governor, &state, &governor_input),
                };
                let now = state.motion;
                let acceleration = if kind < 2 { 0.8 } else { 0.4 };
                prop_assert!(now.v.abs() <= max_speed + 1e-6);
                prop_assert!(now.v_rate.abs() <= acceleration * 1.001 + 1e-4, "{}", now.v_rate);
                prop_assert!(now.psi.0.abs() <= 0.5);
                prop_assert!(now.psi_rate.abs() <= 1.0 + 1e-6);
                prop_assert!(now.psi_acceleration.abs() <= 8.01);
                prop_assert!(fastest_wheel(&now, 0.162) <= wheel * 1.0001);
                prop_assert!(before.v * now.v >= 0.0, "direction changes through zero");
                // `v_rate`, `psi_rate` and `psi_acceleration` match the changes of v, ψ and ψ̇.
                prop_assert!((now.v - before.v - now.v_rate * dt).abs() < 1e-6);
                let mean = 0.5 * (before.psi_rate + now.psi_rate);
                prop_assert!((now.psi.0 - before.psi.0 - mean * dt).abs() < 1e-6);
            }
        }
    }

    // Speeds above 0.24 m/s exceed the wheels' limit at the largest steering angle.
    #[test]
    fn a_constant_input_is_reached(v in -0.24f32..0.24, psi in -0.5f32..0.5, from in -0.5f32..0.5) {
        let state = run(&governor(), State::at_rest(Steering(from)), governor_input(v, psi), 6.0);
        prop_assert!((state.motion.v - v).abs() < 1e-4);
        prop_assert!((state.motion.psi.0 - psi).abs() < 1e-4);
    }

    #[test]
    fn no_overshoot_from_rest(psi in -0.5f32..0.5) {
        let (governor, mut state) = (governor(), State::default());
        for _ in 0..300 {
            state = stepped(&governor, &state, &governor_input(0.1, psi));
            prop_assert!(state.motion.psi.0 * psi >= 0.0);
            prop_assert!(state.motion.psi.0.abs() <= psi.abs() + 1e-5);
        }
    }
}

/// Within its limits the filter of ψ has the continuous step response `1 − (1 + ωt) e^(−ωt)`.
#[test]
fn small_step_follows_the_critically_damped_response() {
    for dt in [0.001f32, 0.01, 0.02] {
        let governor = Config::default().build(&frame(), dt).unwrap();
        let mut state = State::default();
        for i in 1..=(1.0 / dt) as usize {
            let governor_input = governor_input(0.0, 0.1);
            state = stepped(&governor, &state, &governor_input);
            let x = 8.0 * f64::from(dt) * i as f64;
            let exact = 0.1 * (1.0 - (1.0 + x) * (-x).exp());
            // The hold delays the sampled filter by at most half an interval.
            let tolerance = 0.3 * f64::from(dt) * 0.5 + 1e-5;
            assert!((f64::from(state.motion.psi.0) - exact).abs() < tolerance);
        }
    }
}

#[test]
fn known_rate_removes_the_lag() {
    let governor = governor();
    let (mut with, mut without) = (State::default(), State::default());
    for i in 1..=100 {
        let psi = 0.4 * 0.01 * i as f32;
        let governor_input = |psi_rate| GovernorInput {
            v: 0.1,
            psi: Steering(psi),
            psi_rate,
            ..GovernorInput::default()
        };
        with = stepped(&governor, &with, &governor_input(0.4));
        without = stepped(&governor, &without, &governor_input(0.0));
    }
    assert!((with.motion.psi.0 - 0.4).abs() < 0.006);
    // Without the steering rate as feedforward, ψ lags by the time 2/ω.
    assert!((without.motion.psi.0 - (0.4 - 0.4 * 0.25)).abs() < 0.006);
    assert!(with.motion.v > 2.0 * without.motion.v, "speed waits");
}

#[test]
fn known_acceleration_removes_the_lag_of_speed() {
    let governor = governor();
    let mut state = State::default();
    for i in 1..=80 {
        let governor_input = GovernorInput {
            v: 0.25 * 0.01 * i as f32,
            v_rate: 0.25,
            ..GovernorInput::default()
        };
        state = stepped(&governor, &state, &governor_input);
    }
    // The state is that at the end of the step, where a continued input is 0.2025 m/s.
    assert!((state.motion.v - 0.2025).abs() < 1e-4, "{}", state.motion.v);
}

#[test]
fn speed_waits_for_steering() {
    let governor = governor();
    let start = run(&governor, State::default(), governor_input(0.25, 0.0), 3.0);
    let turned = governor_input(0.25, 0.45);
    let mut slowest = f32::MAX;
    let mut state = start;
    for _ in 0..300 {
        state = stepped(&governor, &state, &turned);
        slowest = slowest.min(state.motion.v);
    }
    assert!(start.motion.v > 0.249 && slowest < 0.15);
    assert!(state.motion.v > 0.24, "and goes on");
}

#[test]
fn first_drive_begins_at_once_in_either_direction() {
    for v in [-0.2, 0.2] {
        let state = stepped(&governor(), &State::default(), &governor_input(v, 0.0));
        assert!(state.motion.v * v > 0.0, "{v}");
    }
}

#[test]
fn change_of_direction_rests_at_zero() {
    let governor = governor();
    let governor_input = |v| governor_input(v, 0.0);
    let mut state = run(&governor, State::default(), governor_input(0.2), 3.0);
    let mut resting = 0;
    for _ in 0..300 {
        state = stepped(&governor, &state, &governor_input(-0.2));
        resting += usize::from(state.motion.v == 0.0);
    }
    assert!(state.motion.v < -0.19);
    assert!((10..=12).contains(&resting), "{resting}");
    // After a rest, the next change of direction starts at once.
    state = run(&governor, state, governor_input(0.0), 2.0);
    assert_eq!(state.motion.v, 0.0);
    assert!(stepped(&governor, &state, &governor_input(0.2)).motion.v > 0.0);
}

#[test]
fn stop_is_a_ramp_to_rest() {
    let governor = governor();
    let turning = governor_input(0.25, 0.4);
    let moving = run(&governor, State::default(), turning, 0.4);
    assert!(moving.motion.v > 0.01 && moving.motion.psi_rate > 0.1);
    let braking = stopped(&governor, &moving).motion.v_rate;
    assert!((braking + 0.8).abs() < 1e-4, "{braking}");
    let mut state = moving;
    let steps = (moving.motion.v / 0.8 / 0.01).ceil() as usize;
    for _ in 0..steps.max(13) {
        state = stopped(&governor, &state);
    }
    assert_eq!((state.motion.v, state.motion.psi_rate), (0.0, 0.0));
    let held = stopped(&governor, &state).motion.psi;
    assert_eq!(held, state.motion.psi);
}

#[test]
fn absent_input_brakes() {
    let governor = governor();
    let governor_input = governor_input(0.2, 0.1);
    let moving = run(&governor, State::default(), governor_input, 2.0);
    for bad in [f32::NAN, f32::INFINITY] {
        let absent = GovernorInput {
            psi: Steering(bad),
            ..governor_input
        };
        let braking = stopped(&governor, &moving);
        for absent in [absent, GovernorInput::from_curvature(&frame(), 0.2, bad)] {
            assert_eq!(stepped(&governor, &moving, &absent), braking);
        }
    }
}

#[test]
fn input_beyond_the_curvature_of_the_frame_is_its_largest_steering() {
    for (kappa, psi) in [(3.0f32, 0.491_6f32), (3.2, 0.5), (1e30, 0.5), (-1e30, -0.5)] {
        let found = GovernorInput::from_curvature(&frame(), 0.1, kappa).psi.0;
        assert!((found - psi).abs() < 2e-3, "{kappa}: {found}");
    }
}

#[test]
fn steering_rate_is_limited_by_the_braking_of_the_speed() {
    let config = Config {
        max_wheel_speed_m_s: 0.35,
        max_speed_m_s: 1.0,
        max_acceleration_m_s2: 0.1,
        ..Config::default()
    };
    let governor = config.build(&frame(), DT).unwrap();
    let limit = |psi| f64::from(governor.speed_limit(Steering(psi)));
    let slopes = (1..5000).map(|i| (limit(1e-4 * i as f32 - 1e-4) - limit(1e-4 * i as f32)) / 1e-4);
    let steepest = slopes.fold(0.0, f64::max);
    let rate = 0.1 / steepest;
    let found = f64::from(governor.max_steering_rate);
    assert!(found < rate && found > 0.9 * rate, "{found} {rate}");
}

#[test]
fn input_to_slow_down_at_rest_does_not_reverse_the_robot() {
    let governor_input = GovernorInput {
        v: 1e-4,
        v_rate: -0.3,
        ..GovernorInput::default()
    };
    let state = stepped(&governor(), &State::default(), &governor_input);
    assert_eq!((state.motion.v, state.direction), (0.0, 0.0));
}

#[test]
fn each_change_of_direction_has_its_own_rest() {
    let governor = governor();
    let mut state = State::default();
    for v in [0.1, -0.1, 0.1] {
        let before = state.rest_s;
        state = run(&governor, state, governor_input(v, 0.0), 2.0);
        assert!(state.motion.v * v > 0.0 && before == 0.0);
        assert_eq!(state.rest_s, 0.0, "in motion");
    }
}

#[test]
fn stop_may_be_as_gentle_as_braking() {
    let config = Config {
        stop_deceleration_m_s2: Config::default().max_acceleration_m_s2,
        ..Config::default()
    };
    assert!(config.build(&frame(), DT).is_ok());
}

#[test]
fn impossible_limits_are_named() {
    crate::config::refusal_of(Config::default(), |c| c.build(&frame(), DT)).names(&[
        ("max_wheel_speed_m_s", |c| c.max_wheel_speed_m_s = 0.1),
        ("max_steering_rad", |c| c.max_steering_rad = 0.6),
        ("stop_deceleration_m_s2", |c| c.stop_deceleration_m_s2 = 0.1),
    ]);
    for interval in [f32::NAN, 0.0, -1.0, 1.0] {
        let refused = Config::default().build(&frame(), interval).unwrap_err();
        assert_eq!(refused.field, "interval_s");
    }
}
