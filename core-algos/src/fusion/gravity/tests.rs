use super::*;

const PERIOD: f32 = 1e-3;

fn high_pass() -> HighPass {
    Config::default().build(PERIOD).unwrap()
}

#[test]
fn constant_gravity_is_removed_from_the_first_reading_on() {
    let mut gravity = None;
    for tick in 0..1000 {
        let motion = 0.02 * (tick % 7) as f32;
        let found = high_pass().step(&mut gravity, Some(0.33 + motion), motion);
        assert!((found.unwrap() - motion).abs() < 1e-6, "{tick}");
    }
}

/// The response to a step of the pitch is the exponential with the time constant of 0.1 s.
#[test]
fn step_of_gravity_fades_with_the_time_constant() {
    let mut gravity = None;
    high_pass().step(&mut gravity, Some(0.0), 0.0);
    for tick in 1..=500 {
        let found = f64::from(high_pass().step(&mut gravity, Some(0.3), 0.0).unwrap());
        let expected = 0.3 * (-f64::from(tick) * 1e-3 / 0.1).exp();
        assert!((found - expected).abs() < 2e-3, "{tick}: {found}");
    }
}

#[test]
fn bad_reading_changes_nothing_and_is_passed_on() {
    let mut gravity = Some(0.2);
    for reading in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let found = high_pass().step(&mut gravity, Some(reading), 0.0).unwrap();
        assert_eq!(found.to_bits(), reading.to_bits());
    }
    high_pass().step(&mut gravity, Some(0.1), f32::NAN);
    assert_eq!(high_pass().step(&mut gravity, None, 0.0), None);
    assert_eq!(gravity, Some(0.2));
    // A huge reading, first or later, is forgotten within 0.6 s: 12 exp(-6) = 0.03.
    for mut gravity in [None, Some(0.0)] {
        high_pass().step(&mut gravity, Some(-1e30), 0.0);
        for _ in 0..600 {
            high_pass().step(&mut gravity, Some(0.0), 0.0);
        }
        assert!(gravity.unwrap().abs() < 0.04, "{gravity:?}");
    }
}

#[test]
fn configuration_is_checked() {
    crate::config::refusal_of(Config::default(), |c| c.build(PERIOD)).names(&[
        ("time_s", |c| c.time_s = 0.0),
        ("time_s", |c| c.time_s = 5e-3),
    ]);
}
