use super::*;
use crate::fusion::testing::Random;

const PERIOD: f32 = 1e-3;

/// Root mean square of the error of the bias over many robots, after `ticks` at rest.
fn remaining(ticks: usize) -> (f64, f64) {
    let zeroing = Config::GYRO.build(PERIOD).unwrap();
    let walk = f64::from(Config::GYRO.walk_per_sqrt_s) * f64::from(PERIOD).sqrt();
    let noise = f64::from(Config::GYRO.noise_per_sqrt_hz) * 500f64.sqrt();
    let (mut square, mut claimed) = (0.0, 0.0);
    const ROBOTS: u64 = 300;
    for robot in 0..ROBOTS {
        let mut random = Random::new(robot);
        let mut truth = 4e-3 * random.normal();
        let mut bias = Bias::default();
        for _ in 0..ticks {
            truth += walk * random.normal();
            let reading = truth + noise * random.normal();
            zeroing.step(&mut bias, true, Some(reading as f32));
        }
        square += (f64::from(bias.value()) - truth).powi(2) / ROBOTS as f64;
        claimed += f64::from(bias.variance.unwrap()) / ROBOTS as f64;
    }
    (square.sqrt(), claimed.sqrt())
}

#[test]
fn bias_is_found_as_well_as_claimed() {
    // White noise averaged over T has a bandwidth of 1/(2T); the walk adds little yet.
    let (rms, claimed) = remaining(400);
    let averaged = 4.9e-5 / (2.0f64 * 0.4).sqrt();
    assert!(claimed > averaged && claimed < 1.1 * averaged, "{claimed}");
    assert!((rms / claimed - 1.0).abs() < 0.15, "{rms} {claimed}");
    // In the long run the fourth root of walk² · noise density.
    let (rms, claimed) = remaining(10_000);
    let steady = (5e-5 * 4.9e-5 / 2f64.sqrt()).sqrt() * 1.0f64;
    assert!((claimed / steady - 1.0).abs() < 0.05, "{claimed} {steady}");
    assert!((rms / claimed - 1.0).abs() < 0.15, "{rms} {claimed}");
}

#[test]
fn motion_is_not_taken_for_a_bias() {
    let zeroing = Config::GYRO.build(PERIOD).unwrap();
    let mut bias = Bias::default();
    for _ in 0..1000 {
        zeroing.step(&mut bias, true, Some(0.002));
    }
    let known = bias;
    for _ in 0..1000 {
        assert!(zeroing.step(&mut bias, false, Some(0.03)).is_some());
        assert!(zeroing.step(&mut bias, true, Some(0.5)).is_some());
        assert!(zeroing.step(&mut bias, true, Some(0.002)).is_some());
    }
    assert_eq!(bias.value(), known.value());
    assert!(bias.variance > known.variance);
    assert!((zeroing.step(&mut bias, false, Some(0.302)).unwrap() - 0.3).abs() < 1e-5);
}

#[test]
fn a_bias_beyond_the_limit_is_not_learnt_from_the_outliers_within_it() {
    let config = Config::ACCELEROMETER;
    let zeroing = config.build(PERIOD).unwrap();
    let mut bias = Bias::default();
    let rest = |bias: &mut Bias, reading: f32| zeroing.step(bias, true, Some(reading));
    rest(&mut bias, 0.1);
    let known = bias.value();
    zeroing.step(&mut bias, false, Some(0.1));
    // The axle sets off: the last reading of its rest is within the limit.
    for reading in [-0.6, -0.6, 0.2] {
        rest(&mut bias, reading);
    }
    assert_eq!(bias.value(), known);
    zeroing.step(&mut bias, false, Some(0.1));
    rest(&mut bias, 0.2);
    assert!(bias.value() > known);
}

#[test]
fn a_bias_seen_too_long_ago_withholds_the_reading_until_it_is_seen_again() {
    let config = Config::ACCELEROMETER;
    let zeroing = config.build(PERIOD).unwrap();
    let mut bias = Bias::default();
    for _ in 0..10_000 {
        // Never seen: it counts as none, as it does after the calibration.
        assert_eq!(zeroing.step(&mut bias, false, Some(0.2)), Some(0.2));
    }
    for _ in 0..1000 {
        zeroing.step(&mut bias, true, Some(0.1));
    }
    let at_rest = f64::from(bias.variance.unwrap());
    // A walk's variance grows with time.
    let [largest, walk] = [config.largest_sigma, config.walk_per_sqrt_s].map(f64::from);
    let known_s = (largest * largest - at_rest) / (walk * walk);
    let mut ticks = 0u32;
    while zeroing.step(&mut bias, false, Some(0.1)).is_some() {
        ticks += 1;
        assert!(ticks < 100_000);
    }
    let ratio = f64::from(ticks) * 1e-3 / known_s;
    assert!((ratio - 1.0).abs() < 0.01, "{ticks}");
    // Damage is not withheld but handed on, to be counted.
    let damaged = zeroing.step(&mut bias, false, Some(f32::NAN));
    assert!(damaged.is_some_and(f32::is_nan));
    assert!(zeroing.step(&mut bias, true, Some(0.1)).is_some());
}

#[test]
fn bad_readings_leave_no_trace() {
    let zeroing = Config::ACCELEROMETER.build(PERIOD).unwrap();
    let mut bias = Bias::default();
    zeroing.step(&mut bias, true, Some(0.1));
    let value = bias.value();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let read = zeroing.step(&mut bias, true, Some(bad)).unwrap();
        assert!(!read.is_finite());
    }
    assert_eq!(zeroing.step(&mut bias, true, None), None);
    assert_eq!(bias.value(), value);
}

const TIMES: RestTimes = RestTimes {
    hold: 3,
    settle: 10,
    spread: 0.01,
};
const WHEELS: Rest = Rest {
    wheels: true,
    axle: false,
};
const BOTH: Rest = Rest {
    wheels: true,
    axle: true,
};

#[test]
fn rest_needs_still_wheels_and_motors_off_for_a_while() {
    let mut detector = RestDetector::default();
    let mut step =
        |count, motors_on| detector.step([Some(count), Some(7)], motors_on, Some(0.003), &TIMES);
    assert_eq!(step(0, false), Rest::default(), "nothing to compare with");
    // Motors that never were on need not settle.
    for tick in 0..5 {
        let expected = if tick >= 2 { BOTH } else { Rest::default() };
        assert_eq!(step(0, false), expected);
    }
    assert_eq!(step(1, false), Rest::default());
    for _ in 0..3 {
        step(1, false);
    }
    assert_eq!(step(1, false), BOTH);
    assert_eq!(step(1, true), WHEELS, "a held bend creeps");
    for tick in 1..20 {
        let expected = if tick >= 10 { BOTH } else { WHEELS };
        assert_eq!(step(1, false), expected, "{tick}");
    }
    for _ in 0..100 {
        let rest = detector.step([None, Some(7)], false, Some(0.003), &TIMES);
        assert_eq!(rest, Rest::default(), "no encoder");
    }
}

#[test]
fn a_frame_that_swings_is_not_at_rest_whatever_the_encoders_say() {
    let settled = |amplitude: f64, periods: i32| {
        let mut detector = RestDetector::default();
        let mut longest = 0;
        for tick in 0..periods * 900 {
            let rate = amplitude * (f64::from(tick) * std::f64::consts::TAU / 900.0).sin();
            // A count is 0.1 mrad of turning.
            let angle = 0.143 * amplitude * (f64::from(tick) * std::f64::consts::TAU / 900.0).cos();
            let count = Some((angle / 1e-4).round() as i32);
            let times = RestTimes {
                hold: 100,
                settle: 0,
                ..TIMES
            };
            let rest = detector.step([count; 2], false, Some(rate as f32), &times);
            longest += i32::from(rest.axle);
        }
        longest
    };
    // At its turning points it rests by the encoders for a tenth of a second.
    assert_eq!(settled(0.03, 20), 0);
    assert!(settled(1e-5, 20) > 17_000);
}

#[test]
fn readings_that_are_none_do_not_rest() {
    let mut detector = RestDetector::default();
    let at = [Some(1), Some(2)];
    for _ in 0..20 {
        assert!(!detector.step(at, false, Some(f32::NAN), &TIMES).axle);
    }
    // No gyro is none that moves.
    let rests = [(); 6].map(|()| detector.step(at, false, None, &TIMES).axle);
    assert_eq!(rests, [false, false, true, true, true, true]);
}

#[test]
fn noise_alone_does_not_end_rest() {
    let zeroing = Config::GYRO.build(PERIOD).unwrap();
    let sigma = 4.9e-5 * 500f64.sqrt();
    let mut random = Random::new(4);
    let mut detector = RestDetector::default();
    let times = RestTimes {
        spread: zeroing.spread(),
        ..TIMES
    };
    let mut rests = 0;
    for _ in 0..100_000 {
        let reading = (0.004 + sigma * random.normal()) as f32;
        let rest = detector.step([Some(1); 2], false, Some(reading), &times);
        rests += i32::from(rest.axle);
    }
    assert_eq!(rests, 100_000 - 3);
}

#[test]
fn configuration_is_checked() {
    crate::config::refusal_of(Config::GYRO, |c| c.build(PERIOD)).names(&[
        ("limit", |c| c.limit = 0.0),
        ("noise_per_sqrt_hz", |c| c.noise_per_sqrt_hz = f32::NAN),
        ("walk_per_sqrt_s", |c| c.walk_per_sqrt_s = -1.0),
        ("largest_sigma", |c| c.largest_sigma = 0.0),
    ]);
}
