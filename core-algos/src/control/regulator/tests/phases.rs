//! Limits, gains and transitions of the phases, each on both sides of its limit.

use super::*;
use crate::control::planner::Segment;

const GOAL: Posture = Posture::ORIGIN;

fn plain() -> Regulator {
    Config::default().build().unwrap()
}

/// Input of a robot at rest with straight steering.
fn at(x: f32, y: f32, phi: f32) -> Input {
    Input {
        posture: Posture::new(x, y, phi),
        goal: GOAL,
        ..Input::default()
    }
}

/// State in a phase of the present goal.
fn state(phase: Phase) -> State {
    State {
        phase,
        goal: Some(GOAL),
        ..State::default()
    }
}

#[test]
fn tolerance_holds_up_to_both_bounds() {
    let within = Tolerance {
        position_m: 0.1,
        heading_rad: 0.05,
    };
    let nan = f32::NAN;
    for (position, heading, holds) in [
        (0.1, 0.05, true),
        (0.1f32.next_up(), 0.05, false),
        (0.1, 0.05f32.next_up(), false),
        (nan, 0.0, false),
        (0.0, nan, false),
    ] {
        assert_eq!(
            within.holds([position, heading]),
            holds,
            "{position} {heading}"
        );
    }
    for (x, y, phi, near) in [
        (0.0, -0.099, 0.049, true),
        (0.0, 0.0, -0.051, false),
        (-0.08, 0.08, 0.0, false),
        (nan, 0.0, 0.0, false),
    ] {
        let found = within.is_near(Posture::new(x, y, phi), GOAL);
        assert_eq!(found, near, "{x} {y} {phi}");
    }
    for (position_m, heading_rad, valid) in [
        (1e-6, 1e-6, true),
        (0.0, 0.1, false),
        (0.1, 0.0, false),
        (-0.1, 0.1, false),
        (nan, 0.1, false),
        (0.1, nan, false),
        (f32::INFINITY, 0.1, false),
        (0.1, f32::INFINITY, false),
    ] {
        let within = Tolerance {
            position_m,
            heading_rad,
        };
        assert_eq!(within.is_valid(), valid, "{within:?}");
    }
}

/// In y'' = −y/λ² − 2 y'/λ the gains are 25/m² and 10/m for λ = 0.2 m.
#[test]
fn path_feedback_has_the_gains_of_critical_decay() {
    for (y, phi, sign, kappa) in [
        (0.01, 0.0, 1.0, -0.25),
        (-0.01, 0.0, 1.0, 0.25),
        (0.01, 0.0, -1.0, -0.25),
        (0.0, 0.02, 1.0, -0.2),
        (0.0, 0.02, -1.0, 0.2),
        (0.01, 0.02, 1.0, -0.45),
    ] {
        let found = path_feedback(Posture::new(0.3, y, phi), sign, 0.2);
        assert!((found - kappa).abs() < 1e-6, "{y} {phi} {sign}: {found}");
    }
}

#[test]
fn goal_that_moves_by_more_than_1_cm_or_20_mrad_restarts_the_regulator() {
    let regulator = plain();
    for (x, y, phi, same) in [
        (0.0099, 0.0, 0.0, true),
        (0.0, -0.0099, 0.0199, true),
        (0.0101, 0.0, 0.0, false),
        (0.0, 0.0101, 0.0, false),
        (0.0, -0.0101, 0.0, false),
        (0.008, 0.008, 0.0, false),
        (0.0, 0.0, 0.0201, false),
        (0.0, 0.0, -0.0201, false),
    ] {
        let mut state = State {
            attempts: 3,
            kappa: 0.5,
            ..state(Phase::GaveUp)
        };
        let goal = Posture::new(x, y, phi);
        let input = Input {
            goal,
            ..at(-1.0, 0.0, 0.0)
        };
        regulator.tick(&mut state, &input);
        let expected = if same { 3 } else { 0 };
        assert_eq!(state.attempts, expected, "{goal:?}");
        assert_eq!(state.goal, Some(if same { GOAL } else { goal }));
        assert_eq!(state.kappa, 0.5);
    }
    for lost in [0, 1] {
        let mut input = at(-1.0, 0.0, 0.0);
        let posture = [&mut input.posture, &mut input.goal];
        posture.into_iter().nth(lost).unwrap().phi = f32::NAN;
        let mut found = state(Phase::Hold);
        regulator.tick(&mut found, &input);
        assert_eq!(found, state(Phase::Hold));
    }
    let mut found = state(Phase::Done);
    found.forget_goal();
    assert_eq!(found.goal, None);
}

/// At ψ = 0 a steering error is half the frame's length times the difference in curvature.
#[test]
fn speed_is_unreduced_below_half_the_steering_wait_and_zero_above_it() {
    let regulator = plain();
    for (error, factor) in [
        (0.0, 1.0),
        (0.1, 1.0),
        (0.125, 0.75),
        (0.15, 0.5),
        (0.2, 0.0),
        (0.3, 0.0),
    ] {
        for sign in [1.0, -1.0] {
            let kappa = sign * 2.0 * error / 0.37;
            let found = regulator.patience(kappa, Steering::STRAIGHT);
            assert!((found - factor).abs() < 1e-4, "{error}: {found}");
        }
    }
}

/// The approach may begin in the funnel of the curvature 1.15 κ_max + 0.1 rad/distance.
#[test]
fn approach_region_is_the_funnel_widened_by_its_slack() {
    let regulator = plain();
    let max = regulator.limits.max_curvature();
    for distance in [0.2f32, 0.5, 1.0] {
        let bound = 1.15 * max + 0.1 / distance;
        for (share, within) in [(0.999, true), (1.001, false)] {
            // With the line of sight ahead, the funnel needs 3 |η| / e.
            let eta = share * bound * distance / 3.0;
            let error = PolarError {
                distance_m: distance,
                theta: eta,
                alpha: 0.0,
            };
            assert_eq!(regulator.within_reach(error), within, "{distance} {share}");
        }
    }
}

#[test]
fn goal_is_reached_within_bounds_that_each_attempt_widens_to_the_tolerance() {
    let regulator = plain();
    for (attempts, position, heading) in [
        (0, 0.01f32, 0.026f32),
        (1, 0.016, 0.0416),
        (2, 0.0256, 0.06656),
        (4, 0.065_536, 0.0873),
        (5, 0.1, 0.0873),
        (255, 0.1, 0.0873),
    ] {
        for factor in [1.0, 2.5] {
            let state = State {
                attempts,
                ..State::default()
            };
            let reached = |x, y, phi| regulator.reached(&state, &at(x, y, phi), factor);
            let (d, h) = (factor * position, factor * heading);
            assert!(reached(0.0, 0.999 * d, 0.999 * h), "{attempts}");
            assert!(!reached(0.0, -1.001 * d, 0.0), "{attempts}");
            assert!(!reached(0.0, 0.0, 1.001 * h) && !reached(0.0, 0.0, -1.001 * h));
            assert!(!reached(2.0 * d, 0.0, 2.0 * h));
        }
    }
    // A tolerance below the accepted error has no effect.
    let mut strict = at(0.0099, 0.0, 0.0259);
    (strict.within.position_m, strict.within.heading_rad) = (1e-3, 1e-3);
    for (attempts, x) in [(0, 0.0099), (9, 0.0099), (0, 0.0101), (9, 0.0101)] {
        strict.posture.x = x;
        let state = State {
            attempts,
            ..State::default()
        };
        assert_eq!(regulator.reached(&state, &strict, 1.0), x < 0.01);
    }
}

/// Each row is one tick on one side of a limit: of speed, time, posture or attempts.
#[test]
fn phase_transitions_occur_at_their_limits() {
    let regulator = plain();
    let (far, near) = (at(-1.0, 0.0, 0.0), at(0.005, 0.0, 0.0));
    let beside = at(0.0, -0.3, 0.0);
    let direct = Next::Step(0);
    use Phase::{Approach, Done, GaveUp, Hold, Plan, Steer, Stop};
    // Phase, next step, time in the phase, attempts; input, speed; phase and attempts after the tick.
    for (phase, next, elapsed, attempts, input, speed, expected, after) in [
        (Stop, Next::Plan, 0.0, 0, far, 0.0041, Stop, 0),
        (Stop, Next::Plan, 0.0, 0, far, -0.0041, Stop, 0),
        (Stop, Next::Plan, 0.0, 0, far, 0.0039, Plan, 0),
        (Stop, Next::Plan, 0.0, 0, near, -0.0039, Hold, 0),
        (Stop, Next::Plan, 0.0, 0, near, 0.0041, Stop, 0),
        (Stop, direct, 0.0, 0, far, 0.0201, Stop, 0),
        (Stop, direct, 0.0, 0, far, 0.0199, Steer, 0),
        (Stop, direct, 0.0, 0, far, -0.0199, Steer, 0),
        // Outside the funnel a new plan is made, while attempts are left.
        (Stop, direct, 0.0, 0, beside, 0.0, Stop, 1),
        (Stop, direct, 0.0, 19, beside, 0.0, Stop, 20),
        (Stop, direct, 0.0, 20, beside, 0.0, GaveUp, 21),
        (GaveUp, direct, 9.0, 21, near, 0.0, GaveUp, 21),
        (Plan, Next::Plan, 0.0, 0, far, 0.0, Stop, 0),
        // The approach begins after 3 s at any steering error.
        (Steer, direct, 2.985, 0, beside, 0.0, Steer, 0),
        (Steer, direct, 2.995, 0, beside, 0.0, Approach, 0),
        // The posture is compared with the goal after 0.2 s at rest.
        (Hold, Next::Plan, 0.185, 0, near, 0.0, Hold, 0),
        (Hold, Next::Plan, 0.195, 0, near, 0.0039, Done, 0),
        (Hold, Next::Plan, 0.195, 0, near, -0.0039, Done, 0),
        (Hold, Next::Plan, 0.195, 0, near, 0.0041, Hold, 0),
        (Hold, Next::Plan, 0.195, 0, near, -0.0041, Hold, 0),
        (Hold, Next::Plan, 0.195, 0, far, 0.0, Stop, 1),
        (Hold, Next::Plan, 0.195, 20, far, 0.0, GaveUp, 21),
        // The goal is left at 2.5 times the accepted error.
        (Done, Next::Plan, 9.0, 0, at(0.0249, 0.0, 0.0), 0.0, Done, 0),
        (Done, Next::Plan, 9.0, 0, at(0.0251, 0.0, 0.0), 0.0, Stop, 0),
        (Done, Next::Plan, 9.0, 1, at(0.0399, 0.0, 0.0), 0.0, Done, 1),
        (Done, Next::Plan, 9.0, 1, at(0.0401, 0.0, 0.0), 0.0, Stop, 0),
        (Done, Next::Plan, 9.0, 0, at(0.0, 0.0, 0.0649), 0.0, Done, 0),
        (
            Done,
            Next::Plan,
            9.0,
            0,
            at(0.0, 0.0, -0.0651),
            0.0,
            Stop,
            0,
        ),
    ] {
        let mut state = State {
            next,
            elapsed,
            attempts,
            no_progress_s: 0.05,
            ..state(phase)
        };
        let input = Input {
            speed_m_s: speed,
            ..input
        };
        let output = regulator.tick(&mut state, &input);
        let row = std::format!("{phase:?} {next:?} {elapsed} {input:?}");
        assert_eq!((state.phase, state.attempts), (expected, after), "{row}");
        assert_eq!(output.command.v, 0.0, "{row}");
        if phase != expected {
            assert_eq!((state.elapsed, state.no_progress_s), (0.0, 0.0), "{row}");
            let fresh = matches!(expected, Steer | Approach);
            assert!(
                !fresh || (state.origin, state.progress) == (input.posture, 0.0),
                "{row}"
            );
        } else if phase == Hold && speed.abs() > 0.004 {
            assert_eq!(state.elapsed, 0.0, "{row}");
        }
    }
}

/// Without a plan into the funnel the law drives alone, with the end nearer to the goal first.
#[test]
fn goal_without_a_plan_is_approached_directly() {
    let regulator = plain();
    for (x, direction) in [(-1.0, Direction::Forward), (1.0, Direction::Reverse)] {
        let mut state = State {
            search: Some(
                regulator
                    .planner
                    .start(Posture::new(f32::NAN, 0.0, 0.0), GOAL),
            ),
            elapsed: 5.0,
            ..state(Phase::Plan)
        };
        let output = regulator.tick(&mut state, &at(x, 0.2, 0.0));
        assert_eq!(
            (state.phase, state.next),
            (Phase::Steer, Next::Step(0)),
            "{x}"
        );
        assert_eq!(
            (state.plan, output.command.v),
            (planner::Plan::direct(direction), 0.0)
        );
        assert_eq!((state.search, state.elapsed), (None, 0.0));
    }
}

/// A segment begins at a steering error of 0.05 rad: at ψ = 0 a curvature of 0.1 rad over the frame's length.
#[test]
fn segment_begins_with_the_steering_near_its_curvature() {
    let regulator = plain();
    for (error, phase) in [(0.0495, Phase::Segment), (0.0505, Phase::Steer)] {
        let mut state = State {
            next: Next::Step(0),
            ..state(Phase::Steer)
        };
        state.plan = planner::Plan::single(Segment {
            curvature: -2.0 * error / 0.37,
            length_m: 0.5,
            ..Segment::default()
        });
        let input = at(-1.0, 0.0, 0.0);
        regulator.tick(&mut state, &input);
        assert_eq!(state.phase, phase, "{error}");
        if phase == Phase::Segment {
            assert_eq!((state.origin, state.last), (input.posture, input.posture));
        }
    }
}

/// Speed on a straight segment with remaining distance s, for a braking deceleration a: the least of √(2 a s), 2.5/s
/// · s + 5 mm/s, and the greatest speed. The segment ends at the stopping distance, at least 2 mm before its end.
#[test]
fn segment_speed_follows_the_remaining_distance_to_the_stopping_distance() {
    for (braking_m_s2, left, speed, expected) in [
        (0.4, 0.02, 0.0, Some(0.055)),
        (0.4, 0.08, 0.0, Some(0.205)),
        (0.4, 0.2, 0.0, Some(0.25)),
        (0.1, 0.1, 0.0, Some(0.141_421)),
        (0.4, 0.0021, 0.0, Some(0.010_25)),
        (0.4, 0.0019, 0.0, None),
        // Stopping distance: 0.06 m/s · 1/6 s = 0.01 m, and at 0.2 m/s ((0.2² − (1/15)²) / 0.8 + 1/90) m.
        (0.4, 0.0101, 0.06, Some(0.030_25)),
        (0.4, 0.0099, 0.06, None),
        (0.4, 0.0557, -0.2, Some(0.144_25)),
        (0.4, 0.0554, -0.2, None),
    ] {
        for (direction, sign) in [(Direction::Forward, 1.0), (Direction::Reverse, -1.0)] {
            let config = Config {
                braking_m_s2,
                ..Config::default()
            };
            let regulator = config.build().unwrap();
            for phi in [0.0f32, 1.0] {
                let begin = Posture::new(-1.0, 0.2, phi);
                let mut state = State {
                    next: Next::Step(0),
                    origin: begin,
                    last: begin.advance(sign * 0.25, 0.0),
                    progress: 0.25,
                    ..state(Phase::Segment)
                };
                state.plan = planner::Plan::single(Segment {
                    direction,
                    curvature: 0.0,
                    length_m: 0.3 + left,
                });
                let mut input = at(0.0, 0.0, 0.0);
                (input.posture, input.speed_m_s) = (begin.advance(sign * 0.3, 0.0), speed);
                let mut turned = (state, input);
                let found = regulator.tick(&mut state, &input).command.v;
                let v = sign * expected.unwrap_or(0.0);
                assert!((found - v).abs() < 1e-4, "{left} {speed} {sign}: {found}");
                let phase = if expected.is_some() {
                    Phase::Segment
                } else {
                    Phase::Stop
                };
                assert_eq!(state.phase, phase, "{left} {speed}");
                if phase == Phase::Stop {
                    assert_eq!(state.next, Next::Step(1));
                }
                // A steering error of 0.15 rad halves the speed.
                turned.1.steering = Steering(0.15);
                let found = regulator.tick(&mut turned.0, &turned.1).command.v;
                assert!(
                    (found - 0.5 * v).abs() < 0.06 * v.abs() + 1e-4,
                    "{found} {v}"
                );
            }
        }
    }
}

#[test]
fn approach_ends_after_100_ms_outside_the_funnel_or_1_s_without_speed() {
    // These cases have the default law. The cases below have a law that commands almost no speed, inside the funnel.
    let regulator = plain();
    let (inside, outside) = (at(-1.0, 0.0, 0.0), at(-0.2, -0.3, 0.0));
    for (no_progress_s, input, phase, left) in [
        (0.0, outside, Phase::Approach, 0.01),
        (0.085, outside, Phase::Approach, 0.095),
        (0.095, outside, Phase::Stop, 0.0),
        (0.085, inside, Phase::Approach, 0.0),
        (5.0, inside, Phase::Approach, 0.0),
    ] {
        let mut state = State {
            no_progress_s,
            next: Next::Step(0),
            ..state(Phase::Approach)
        };
        regulator.tick(&mut state, &input);
        assert_eq!(state.phase, phase, "{no_progress_s}");
        assert!(
            (state.no_progress_s - left).abs() < 1e-6,
            "{no_progress_s}: {}",
            state.no_progress_s
        );
        assert_eq!(state.attempts, u8::from(phase == Phase::Stop));
    }
    let mut config = Config::default();
    config.approach.approach_gain_m_s = 1e-4;
    let idle = config.build().unwrap();
    for (no_progress_s, phase) in [
        (0.095, Phase::Approach),
        (0.985, Phase::Approach),
        (0.995, Phase::Hold),
    ] {
        let mut state = State {
            no_progress_s,
            next: Next::Step(0),
            ..state(Phase::Approach)
        };
        idle.tick(&mut state, &inside);
        assert_eq!(state.phase, phase, "{no_progress_s}");
    }
}

#[test]
fn final_arc_begins_at_15_cm_and_ends_3_mm_before_the_goal() {
    let regulator = plain();
    let max = regulator.limits.max_curvature();
    for (direction, sign) in [(Direction::Forward, 1.0f32), (Direction::Reverse, -1.0)] {
        for (x, on_arc) in [(0.1499f32, true), (0.1501, false)] {
            let mut state = State {
                next: Next::Step(0),
                ..state(Phase::Approach)
            };
            state.plan.approach = direction;
            regulator.tick(&mut state, &at(-sign * x, 0.0, 0.0));
            assert_eq!(state.final_curvature.is_some(), on_arc, "{x}");
        }
        // The arc's curvature is 2 sin α / e, positive to the left of the heading, limited to the robot's greatest.
        for (y, wide) in [
            (0.002f32, 0.2f32),
            (-0.002, -0.2),
            (0.06, 9.0),
            (-0.06, -9.0),
        ] {
            let mut state = State {
                next: Next::Step(0),
                ..state(Phase::Approach)
            };
            state.plan.approach = direction;
            regulator.tick(&mut state, &at(-sign * 0.12, y, 0.0));
            let found = state.final_curvature.unwrap();
            let e2 = 0.12f32 * 0.12 + y * y;
            let expected = if wide.abs() < 1.0 {
                -2.0 * y / e2
            } else {
                -max * wide.signum()
            };
            assert!(
                (found - expected).abs() < 1e-4,
                "{direction:?} {y}: {found} {expected}"
            );
        }
        // The speed is 2/s times the remaining distance; deviations from the arc decay critically over 0.06 m.
        for (left, y, curvature, v) in [
            (0.0031f32, 0.0f32, 0.0f32, 0.0062f32),
            (0.0029, 0.0, 0.0, 0.0),
            (0.1, 0.0, 0.0, 0.2),
            (0.1, 0.0002, 0.0, 0.2),
            (0.1, 0.0, 0.4, 0.2),
        ] {
            let mut state = State {
                final_curvature: Some(curvature),
                next: Next::Step(0),
                ..state(Phase::Approach)
            };
            state.plan.approach = direction;
            // `left` metres back along the arc, and `y` beside the arc.
            let turn = -sign * left * curvature;
            let mut input = at(0.0, 0.0, 0.0);
            input.posture = GOAL
                .advance(-sign * left, turn)
                .compose(Posture::new(0.0, y, 0.0));
            let output = regulator.tick(&mut state, &input);
            let patience = regulator.patience(output.command.kappa, Steering::STRAIGHT);
            assert_eq!(patience, 1.0);
            let found = output.command.v;
            assert!((found - sign * v).abs() <= 2e-3 * v, "{left} {y}: {found}");
            let hold = if v == 0.0 {
                Phase::Hold
            } else {
                Phase::Approach
            };
            assert_eq!(state.phase, hold, "{left}");
            if v > 0.0 {
                let kappa = curvature - y / (0.06 * 0.06);
                let found = output.command.kappa;
                assert!((found - kappa).abs() < 2e-3, "{left} {y}: {found} {kappa}");
            }
        }
    }
}

/// Time without motion is counted within a phase: 1.5 s in each of two phases is not 2 s.
#[test]
fn new_phase_restarts_the_time_without_motion() {
    let (regulator, input) = (plain(), at(-1.0, 0.0, 0.0));
    let mut state = State {
        next: Next::Step(0),
        final_curvature: Some(0.0),
        ..state(Phase::Approach)
    };
    for (ticks, phase) in [
        (151, Phase::Approach),
        (199, Phase::Approach),
        (2, Phase::Hold),
    ] {
        for _ in 0..ticks {
            regulator.tick(&mut state, &input);
        }
        assert_eq!(state.phase, phase, "{ticks}");
        if ticks == 151 {
            state.enter(Phase::Approach);
            state.final_curvature = Some(0.0);
        }
    }
}

/// A robot that is stuck twice within 1 cm, outside the goal's tolerance and the accepted error, is blocked.
#[test]
fn robot_stuck_again_in_the_same_place_off_its_goal_is_blocked() {
    let regulator = plain();
    for (x, before, within_m, blocked) in [
        (-1.0, Some(-1.0099), 0.1, true),
        (-1.0, Some(-1.0101), 0.1, false),
        (-1.0, None, 0.1, false),
        (-0.099, Some(-0.099), 0.1, false),
        (-0.101, Some(-0.101), 0.1, true),
        (-0.009, Some(-0.009), 0.001, false),
        (-0.011, Some(-0.011), 0.001, true),
    ] {
        let mut input = at(x, 0.0, 0.0);
        input.within.position_m = within_m;
        let mut state = State {
            next: Next::Step(0),
            stuck_at: before.map(|x| Posture::new(x, 0.0, 0.0)),
            // On the final arc the approach does not end for other reasons.
            final_curvature: Some(0.0),
            ..state(Phase::Approach)
        };
        // The first tick stores the posture.
        for _ in 0..202 {
            if state.phase == Phase::Approach {
                regulator.tick(&mut state, &input);
            }
        }
        let phase = if blocked { Phase::GaveUp } else { Phase::Hold };
        assert_eq!(
            (state.phase, state.is_blocked()),
            (phase, blocked),
            "{x} {before:?}"
        );
        assert_eq!(state.stuck_at, Some(input.posture));
    }
}

/// Each case of equation 4 alone: posture beside the led goal (m, m, rad), phase, time without progress (s), speed
/// (m/s); phase after the tick.
#[test]
fn papers_law_stops_at_its_led_goal_and_gives_up_without_commanded_speed() {
    let regulator = regulator(Strategy::PaperLaw);
    let rest = 0.2 * 2e-3f32.sqrt();
    let command = |posture| {
        let led = Posture::new(rest, 0.0, 0.0);
        let law = regulator
            .law
            .command(PolarError::between(posture, led), 0.0, 0.0);
        regulator.limits.limit(law)
    };
    // Beside the goal on the manifold, across its heading: the law commands a turn on the spot.
    let (mut low, mut high) = (-0.5f32, -0.3);
    let turned = |y| Posture::new(rest, y, 1.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        let same = command(turned(middle)).v * command(turned(low)).v > 0.0;
        *(if same { &mut low } else { &mut high }) = middle;
    }
    let (far, home, stall) = (Posture::new(-1.0, 0.3, 0.4), GOAL, turned(low));
    assert!(command(stall).v.abs() < 0.004, "{:?}", command(stall));
    let at_distance = |metres: f32| Posture::new(-metres, 0.0, 0.0);
    use Phase::{Approach, Done, GaveUp, Hold, Plan, Stop};
    for (posture, phase, no_progress_s, speed, expected) in [
        (far, Stop, 0.0, 0.0, Approach),
        (far, Plan, 0.0, 0.0, Approach),
        (far, Approach, 0.5, 0.0, Approach),
        (Posture::new(0.7, -0.3, 0.4), Approach, 5.0, 0.0, Approach),
        (far, GaveUp, 0.0, 0.0, GaveUp),
        (stall, Approach, 0.985, 0.0, Approach),
        (stall, Approach, 0.995, 0.0, GaveUp),
        (home, Approach, 0.0, 0.1, Hold),
        (home, Hold, 0.0, 0.0041, Hold),
        (home, Hold, 0.0, -0.0039, Done),
        // The robot leaves the goal at 2.5 times the stop margin of 3 cm.
        (at_distance(0.0749), Done, 0.0, 0.0, Done),
        (at_distance(0.0751), Done, 0.0, 0.0, Approach),
        (at_distance(-0.074), Hold, 0.0, 0.1, Hold),
    ] {
        let mut state = State {
            no_progress_s,
            kappa: 0.25,
            ..state(phase)
        };
        let mut input = at(posture.x, posture.y, posture.phi);
        input.speed_m_s = speed;
        let output = regulator.tick(&mut state, &input);
        let row = std::format!("{posture:?} {phase:?} {no_progress_s}");
        assert_eq!(state.phase, expected, "{row}");
        let slow = if posture == stall {
            no_progress_s + 0.01
        } else {
            0.0
        };
        if expected == Approach {
            let limited_command = command(posture);
            assert!(
                (output.command.v - limited_command.v).abs() < 1e-6,
                "{row}: {output:?}"
            );
            assert!(
                (output.command.kappa - limited_command.kappa).abs() < 1e-5,
                "{row}"
            );
            let forward = state.plan.approach == Direction::Forward;
            assert_eq!(forward, limited_command.v > 0.0, "{row}");
        } else {
            assert_eq!(
                (output.command.v, output.command.kappa),
                (0.0, 0.25),
                "{row}"
            );
        }
        if (phase, expected) == (Approach, Approach) {
            assert!(
                (state.no_progress_s - slow).abs() < 1e-6,
                "{row}: {}",
                state.no_progress_s
            );
        }
    }
}
