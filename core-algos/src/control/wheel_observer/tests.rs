use super::*;
use proptest::prelude::*;

const DT: f64 = 1e-3;

fn observer() -> WheelObserver {
    Config::default().build().unwrap()
}

fn counts(angle: f64) -> i64 {
    (angle * 20_000.0 / std::f64::consts::TAU).floor() as i64
}

/// States of the observer for a given motion; the counter starts at `origin`.
fn observe(origin: i32, angle: impl Fn(f64) -> f64, steps: usize) -> Vec<State> {
    let observer = observer();
    let mut state = State::default();
    (0..steps)
        .map(|i| {
            let count = origin.wrapping_add(counts(angle(i as f64 * DT)) as i32);
            state = observer.step(&state, Some(count));
            state
        })
        .collect()
}

#[test]
fn constant_speed_is_followed_without_error_in_speed_or_angle() {
    for speed in [-12.0, 0.7, 12.0] {
        let states = observe(7, |t| speed * t, 400);
        let observer = observer();
        let mut travelled = 0.0;
        for (i, state) in states.iter().enumerate() {
            travelled += f64::from(state.increment_rad);
            if i < 100 {
                continue;
            }
            // One count of quantisation q causes a speed error of at most b q/e.
            let quantum = 250.0 * std::f64::consts::TAU / 20_000.0 / std::f64::consts::E;
            assert!((f64::from(state.speed_rad_s) - speed).abs() < quantum);
            let gap = travelled - speed * i as f64 * DT;
            assert!(gap.abs() < 2.0 * f64::from(observer.radians_per_count));
        }
    }
}

#[test]
fn start_of_motion_is_the_response_of_a_double_pole() {
    let states = observe(0, |t| 10.0 * t, 40);
    for (i, state) in states.iter().enumerate().skip(1) {
        let x = 250.0 * DT * i as f64;
        let exact = 10.0 * (1.0 - (1.0 + x) * (-x).exp());
        // The held sample delays the sampled loop by at most half an interval.
        let tolerance = 10.0 * 250.0 * 0.37 * 0.5 * DT + 0.05;
        assert!((f64::from(state.speed_rad_s) - exact).abs() < tolerance);
    }
}

#[test]
fn sine_has_the_gain_and_phase_of_a_double_pole() {
    let (amplitude, frequency) = (1.5, 40.0);
    let states = observe(0, |t| amplitude * (frequency * t).sin(), 4000);
    // Correlate with the true speed, A f cos(f t), over whole periods.
    let period = std::f64::consts::TAU / frequency;
    let last = (20.0 * period / DT).round() as usize;
    let (mut in_phase, mut quadrature) = (0.0, 0.0);
    for (i, state) in states.iter().enumerate().skip(300).take(last) {
        let phase = frequency * i as f64 * DT;
        in_phase += f64::from(state.speed_rad_s) * phase.cos();
        quadrature += f64::from(state.speed_rad_s) * phase.sin();
    }
    let scale = 2.0 / last as f64 / (amplitude * frequency);
    let gain = scale * in_phase.hypot(quadrature);
    let lag = quadrature.atan2(in_phase);
    let ratio: f64 = frequency / 250.0;
    assert!((gain - 1.0 / (1.0 + ratio * ratio)).abs() < 0.01, "{gain}");
    let error = lag - 2.0 * ratio.atan();
    assert!(error.abs() < frequency * 0.6 * DT, "{lag}");
}

#[test]
fn missing_count_is_bridged_at_constant_speed() {
    let observer = observer();
    let mut state = State::default();
    for i in 0..500i64 {
        let count = counts(8.0 * i as f64 * DT) as i32;
        let present = !(200..230).contains(&i);
        state = observer.step(&state, present.then_some(count));
        assert!(!state.jumped);
        if i > 150 {
            assert!((state.speed_rad_s - 8.0).abs() < 0.05);
        }
    }
}

#[test]
fn counter_jump_is_reported_and_does_not_change_the_speed() {
    let observer = observer();
    let (mut state, mut jumps, mut travelled) = (State::default(), 0, 0.0);
    for i in 0..400i64 {
        let offset = if i >= 300 { 100_000 } else { 0 };
        state = observer.step(&state, Some((counts(5.0 * i as f64 * DT) + offset) as i32));
        jumps += u32::from(state.jumped);
        travelled += state.increment_rad;
        if i > 150 {
            assert!((state.speed_rad_s - 5.0).abs() < 0.05);
        }
    }
    assert_eq!(jumps, 1);
    assert!((travelled - 5.0 * 0.399).abs() < 2e-3);
}

#[test]
fn bad_configuration_is_named() {
    crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
        ("counts_per_revolution", |c| c.counts_per_revolution = 0),
        ("bandwidth_rad_s", |c| c.bandwidth_rad_s = 2500.0),
    ]);
}

properties! {
    /// The counter starts at any count, also near its wrap.
    #[test]
    fn origin_of_the_count_does_not_matter(origin: i32, speed in -20.0f64..20.0) {
        let near_wrap = i32::MAX.wrapping_add(origin % 500);
        let reference = observe(0, |t| speed * t, 200);
        for start in [origin, near_wrap] {
            let shifted = observe(start, |t| speed * t, 200);
            for (a, b) in reference.iter().zip(&shifted) {
                prop_assert_eq!(a.speed_rad_s, b.speed_rad_s);
                prop_assert_eq!(a.increment_rad, b.increment_rad);
            }
        }
    }

    #[test]
    fn any_counts_leave_finite_estimates(counts in prop::collection::vec(any::<Option<i32>>(), 1..200)) {
        let observer = observer();
        let mut state = State::default();
        for count in counts {
            state = observer.step(&state, count);
            prop_assert!(state.speed_rad_s.is_finite());
            prop_assert!(state.increment_rad.is_finite());
        }
    }
}

/// The bound of a jump grows with each interval without a count, up to a thousand intervals.
#[test]
fn bound_of_a_jump_grows_with_missing_counts() {
    let observer = WheelObserver {
        largest_error: 10.0,
        ..observer()
    };
    for (missing, largest) in [
        (0, 10),
        (1, 20),
        (7, 80),
        (999, 10_000),
        (1000, 10_010),
        (5000, 10_010),
    ] {
        for (change, jumped) in [(largest, false), (largest + 1, true)] {
            for sign in [1, -1] {
                let mut state = observer.step(&State::default(), Some(40));
                for _ in 0..missing {
                    state = observer.step(&state, None);
                }
                state = observer.step(&state, Some(40 + sign * change));
                assert_eq!(state.jumped, jumped, "{missing} {change}");
                // A count ends the gap: the intervals without a count do not widen the next bound.
                let next = observer.step(&state, Some(40 + sign * (change + 1000)));
                assert!(next.jumped);
            }
        }
    }
}
