use super::*;
use crate::control::cascade;

const WITHIN: Tolerance = Tolerance {
    position_m: 0.02,
    heading_rad: 0.05,
};

fn task() -> PathTask {
    let cascade = cascade::Config::default().build().unwrap();
    Config::default().build(&cascade).unwrap()
}

fn on_line(s: f32) -> PathPoint {
    PathPoint {
        posture: Posture::new(s, 0.0, 0.0),
        kappa: 0.0,
        s,
    }
}

/// Pushes points a centimetre apart on a line along x.
fn push(state: &mut State, points: core::ops::RangeInclusive<u16>) {
    for i in points {
        let point = on_line(f32::from(i) * 0.01);
        state.push_path_point(point).unwrap();
    }
}

/// Pushes point `number` of a trajectory along x at 0.1 m/s, one point per 50 ms, with the stated speed `v`.
fn push_in_time(state: &mut State, number: u16, v: f32) {
    let time_s = f32::from(number) * 0.05;
    let point = on_line(0.1 * time_s);
    let point = TrajectoryPoint { time_s, v, point };
    state.push_trajectory_point(point).unwrap();
}

fn moving(v: f32) -> Motion {
    Motion {
        v,
        ..Motion::default()
    }
}

#[test]
fn path_of_any_length_streams_through_the_buffer() {
    let (task, mut state) = (task(), State::default());
    let (mut pushed, count) = (0, 2000);
    let mut feed = |state: &mut State| {
        while pushed < count && state.path_room() > 0 {
            push(state, pushed..=pushed);
            pushed += 1;
        }
        if pushed == count {
            state.finish_path();
        }
        usize::from(pushed)
    };
    assert_eq!(feed(&mut state), PATH_POINTS);
    assert_eq!(state.push_path_point(on_line(9.0)), Err(PathError::Full));
    state.restart();
    let mut x = 0.0;
    while x < 19.9 {
        feed(&mut state);
        let step = task.follow(&mut state, Posture::new(x, 0.0, 0.0), &WITHIN, &moving(0.2));
        assert!((step.target.unwrap().x - x).abs() < 1e-4);
        // The stream keeps ahead, so nothing slows the robot down before the end.
        let expected = if x < 19.7 { 0.2 } else { 0.1 };
        assert!(
            step.governor_input.unwrap().v > expected - 1e-3,
            "{x}: {step:?}"
        );
        x += 0.05;
    }
    assert_eq!(feed(&mut state), usize::from(count));
    assert_eq!(state.push_path_point(on_line(99.0)), Err(PathError::Ended));
}

#[test]
fn robot_waits_where_the_stream_breaks_off_and_ends_where_the_path_does() {
    let (task, mut state) = (task(), State::default());
    push(&mut state, 0..=100);
    state.restart();
    let mut x = 0.0;
    let mut drive = |state: &mut State, epochs: usize| {
        let mut last = PathStep::default();
        let mut v = 0.0;
        for _ in 0..epochs {
            last = task.follow(state, Posture::new(x, 0.0, 0.0), &WITHIN, &moving(v));
            v = last
                .governor_input
                .map_or(0.0, |governor_input| governor_input.v);
            x += 0.01 * v;
        }
        (x, last)
    };
    let (x, waiting) = drive(&mut state, 1500);
    assert!((x - 1.0).abs() < 3e-3 && !waiting.done, "{x} {waiting:?}");
    assert!(!waiting.stuck, "the host is to send more");
    push(&mut state, 101..=150);
    state.finish_path();
    let (x, ended) = drive(&mut state, 1500);
    assert!((x - 1.5).abs() < 1e-3 && ended.done, "{x} {ended:?}");
    assert_eq!(ended.governor_input, None);
    // A robot that is pushed away does not start again.
    let pushed = task.follow(
        &mut state,
        Posture::new(1.3, 0.0, 0.0),
        &WITHIN,
        &moving(0.0),
    );
    assert!(pushed.done && pushed.governor_input.is_none());
}

#[test]
fn loop_starts_at_its_first_point() {
    // A circle of 0.3 m radius: its last points are as near to the robot as its first ones.
    let (task, mut state) = (task(), State::default());
    let count = 189;
    for i in 0..=count {
        let turn = core::f32::consts::TAU * i as f32 / count as f32;
        let s = 0.3 * turn;
        let posture = Posture::ORIGIN.advance(s, turn);
        let kappa = 1.0 / 0.3;
        let point = PathPoint { posture, kappa, s };
        state.push_path_point(point).unwrap();
    }
    state.finish_path();
    state.restart();
    let behind = Posture::new(-0.002, 0.0, 0.0);
    let step = task.follow(&mut state, behind, &WITHIN, &moving(0.0));
    assert!(!step.done && step.governor_input.unwrap().v > 0.1);
}

#[test]
fn nothing_moves_without_points() {
    let (task, mut state) = (task(), State::default());
    state.restart();
    let step = task.follow(&mut state, Posture::ORIGIN, &WITHIN, &moving(0.1));
    assert_eq!(step, PathStep::default());
    let step = task.track(&mut state, 10_000, Posture::ORIGIN, &WITHIN, &moving(0.1));
    assert_eq!(step, PathStep::default());
    // The time of the trajectory has not begun.
    assert_eq!(state.start, None);
}

#[test]
fn trajectory_given_again_continues_where_it_stopped() {
    let (task, mut state) = (task(), State::default());
    for i in 0..100 {
        push_in_time(&mut state, i, 0.1);
    }
    state.restart();
    let at = |state: &mut State, epoch: u64| {
        let step = task.track(
            state,
            epoch,
            Posture::new(0.1, 0.0, 0.0),
            &WITHIN,
            &moving(0.1),
        );
        step.target.unwrap().x
    };
    at(&mut state, 1_000_000);
    assert!((at(&mut state, 3_020_000) - 0.202).abs() < 1e-4);
    state.restart();
    // Points are 5 mm apart.
    assert!((at(&mut state, 9_000_000) - 0.2).abs() < 1e-4);
    assert!((at(&mut state, 9_100_000) - 0.21).abs() < 1e-4);
}

#[test]
fn trajectory_begins_with_its_first_epoch_and_ends_at_rest() {
    let (task, mut state) = (task(), State::default());
    let mut pushed = 0;
    let mut feed = |state: &mut State| {
        // 0.1 m/s for 10 s. The steps of the speed at both ends do not matter here.
        while pushed <= 200 && state.trajectory_room() > 0 {
            push_in_time(state, pushed, if pushed < 200 { 0.1 } else { 0.0 });
            pushed += 1;
        }
        if pushed > 200 {
            state.finish_trajectory();
        }
    };
    feed(&mut state);
    assert_eq!(state.trajectory_room(), 0);
    state.restart();
    let begin = 7_770_000;
    let mut last = PathStep::default();
    for epoch in 0..1100u64 {
        feed(&mut state);
        let now = begin + epoch * 10_000;
        let x = (0.001 * epoch as f32).min(1.0);
        let v = if epoch < 1000 { 0.1 } else { 0.0 };
        last = task.track(
            &mut state,
            now,
            Posture::new(x, 0.0, 0.0),
            &WITHIN,
            &moving(v),
        );
        // In the last interval the speed falls to zero at once.
        let tolerance = if epoch < 995 { 2e-4 } else { 5e-3 };
        assert!((last.target.unwrap().x - x).abs() < tolerance, "{epoch}");
    }
    assert!(last.done && last.governor_input.is_none());
}

/// Holds a robot at `at` for 400 epochs. Returns the number of epochs until the task requests no motion, and until it
/// reports a robot that does not move; 400 for never.
fn held(at: Posture) -> (usize, usize) {
    let (task, mut state) = (task(), State::default());
    push(&mut state, 0..=100);
    state.finish_path();
    state.restart();
    // The drive to `at`.
    for number in 0..=100u8 {
        let share = f32::from(number) * 0.01;
        let posture = Posture::new(share * at.x, share * at.y, share * at.phi);
        assert!(
            task.follow(&mut state, posture, &WITHIN, &moving(0.1))
                .governor_input
                .is_some()
        );
    }
    let steps: [PathStep; 400] =
        core::array::from_fn(|_| task.follow(&mut state, at, &WITHIN, &moving(0.0)));
    let first = |is: fn(&PathStep) -> bool| steps.iter().position(is).unwrap_or(steps.len());
    (
        first(|step| step.governor_input.is_none()),
        first(|step| step.stuck),
    )
}

#[test]
fn held_robot_rests_within_the_tolerance_of_the_end_and_is_stuck_outside() {
    // Tolerances of 2 cm and 0.05 rad; a robot rests after 1 s and is stuck after 2 s.
    for (at, rests) in [
        (Posture::new(0.981, 0.0, 0.0), true),
        (Posture::new(0.979, 0.0, 0.0), false),
        (Posture::new(0.985, 0.01, 0.04), true),
        (Posture::new(0.985, 0.01, 0.06), false),
        (Posture::new(0.985, 0.014, 0.0), false),
        (Posture::new(0.3, 0.0, 0.0), false),
    ] {
        let expected = if rests { (100, 400) } else { (400, 200) };
        let (rest, stuck) = held(at);
        let near = |a: usize, b: usize| a.abs_diff(b) <= 2;
        assert!(
            near(rest, expected.0) && near(stuck, expected.1),
            "{at:?}: {rest} {stuck}"
        );
    }
}

#[test]
fn robot_half_a_metre_from_path_or_trajectory_is_lost_until_the_task_is_given_again() {
    let (task, mut state) = (task(), State::default());
    push(&mut state, 0..=100);
    for number in 0..100 {
        push_in_time(&mut state, number, 0.1);
    }
    for (at, lost) in [
        (Posture::new(0.0, 0.49, 0.0), false),
        (Posture::new(-0.51, 0.0, 0.0), true),
        (Posture::new(0.0, -0.51, 0.0), true),
        // Beside the path, and far from its start.
        (Posture::new(0.8, 0.0, 0.0), true),
    ] {
        state.restart();
        let step = task.follow(&mut state, at, &WITHIN, &moving(0.1));
        assert_eq!(
            (state.is_lost(), step.governor_input.is_none()),
            (lost, lost),
            "{at:?}"
        );
        let back = task.follow(&mut state, Posture::ORIGIN, &WITHIN, &moving(0.1));
        assert_eq!(
            (state.is_lost(), back.governor_input.is_none()),
            (lost, lost),
            "{at:?}"
        );
        state.restart();
        task.track(&mut state, 10_000, at, &WITHIN, &moving(0.1));
        assert_eq!(state.is_lost(), lost, "{at:?}");
    }
}

/// A robot held at the start of a loop is also at its end, but has not driven.
#[test]
fn robot_held_at_the_start_of_a_loop_is_stuck() {
    let (task, mut state) = (task(), State::default());
    for i in 0..=189 {
        let turn = core::f32::consts::TAU * i as f32 / 189.0;
        let (s, kappa) = (0.3 * turn, 1.0 / 0.3);
        let posture = Posture::ORIGIN.advance(s, turn);
        state
            .push_path_point(PathPoint { posture, kappa, s })
            .unwrap();
    }
    state.finish_path();
    state.restart();
    let mut step = PathStep::default();
    for _ in 0..250 {
        step = task.follow(&mut state, Posture::ORIGIN, &WITHIN, &moving(0.0));
        assert!(!step.done && step.governor_input.is_some());
    }
    assert!(step.stuck);
}

/// A trajectory may stand still on its way; when it is over, the robot is to reach its end.
#[test]
fn trajectory_at_rest_is_not_reported_as_stuck() {
    let (task, mut state) = (task(), State::default());
    for number in 0..100u16 {
        let point = TrajectoryPoint {
            time_s: f32::from(number) * 0.05,
            v: 0.0,
            point: on_line(1e-5 * f32::from(number)),
        };
        state.push_trajectory_point(point).unwrap();
    }
    state.finish_trajectory();
    state.restart();
    for epoch in 0..450u64 {
        let now = 10_000 * epoch;
        let step = task.track(&mut state, now, Posture::ORIGIN, &WITHIN, &moving(0.0));
        assert!(!step.stuck, "{epoch}");
    }
}

/// Points pushed after the end was reached begin a new path or trajectory.
#[test]
fn points_pushed_after_the_end_begin_a_new_course() {
    let mut filled = State::default();
    push(&mut filled, 0..=9);
    (0..5).for_each(|number| push_in_time(&mut filled, number, 0.1));
    for (resting, room) in [
        (false, [PATH_POINTS - 11, TRAJECTORY_POINTS - 5]),
        (true, [PATH_POINTS - 1, TRAJECTORY_POINTS]),
    ] {
        let mut state = filled.clone();
        state.resting = resting;
        push(&mut state, 10..=10);
        assert_eq!([state.path_room(), state.trajectory_room()], room);
        let mut state = filled.clone();
        state.resting = resting;
        push_in_time(&mut state, 5, 0.1);
        let room = match resting {
            false => [PATH_POINTS - 10, TRAJECTORY_POINTS - 6],
            true => [PATH_POINTS, TRAJECTORY_POINTS - 1],
        };
        assert_eq!([state.path_room(), state.trajectory_room()], room);
    }
}

#[test]
fn robot_rests_when_input_and_motion_have_faded() {
    let task = task();
    let slow = task.rest_speed;
    for finished in [false, true] {
        for (commanded, driven, faded) in [
            (slow, -slow, true),
            (-slow, slow, true),
            (slow.next_up(), 0.0, false),
            (-slow.next_up(), 0.0, false),
            (0.0, slow.next_up(), false),
            (0.0, -slow.next_up(), false),
        ] {
            let mut state = State::default();
            let course = Course {
                finished,
                end: None,
                asked: true,
            };
            let governor_input = GovernorInput {
                v: commanded,
                ..GovernorInput::default()
            };
            let at = (Posture::ORIGIN, &WITHIN);
            let step = task.conclude(&mut state, &course, at, governor_input, &moving(driven));
            let rests = finished && faded;
            assert_eq!(
                (state.resting, step.governor_input.is_none()),
                (rests, rests),
                "{commanded} {driven}"
            );
            assert!(!step.done, "it still moves");
        }
    }
}

#[test]
fn progress_along_the_path_is_kept() {
    let (task, mut state) = (task(), State::default());
    push(&mut state, 0..=50);
    for x in [0.1f32, 0.2, 0.3] {
        task.follow(&mut state, Posture::new(x, 0.0, 0.0), &WITHIN, &moving(0.1));
        assert!(
            (state.progress.s - x).abs() < 0.02,
            "{x} {}",
            state.progress.s
        );
    }
}
