use super::*;
use crate::fusion::testing::Random;
use crate::topology::Wheels;

const PERIOD: f32 = 1e-3;

/// Bias error over many robots after `ticks` at rest: root mean square, and claimed standard deviation.
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
fn bias_error_equals_its_claimed_standard_deviation() {
    // White noise averaged over T has a bandwidth of 1/(2T); the walk adds little yet.
    let (rms, claimed) = remaining(400);
    let averaged = 4.9e-5 / (2.0f64 * 0.4).sqrt();
    assert!(claimed > averaged && claimed < 1.1 * averaged, "{claimed}");
    assert!((rms / claimed - 1.0).abs() < 0.15, "{rms} {claimed}");
    // In the long run the standard deviation is the fourth root of walk² · noise²/2.
    let (rms, claimed) = remaining(10_000);
    let steady = (5e-5 * 4.9e-5 / 2f64.sqrt()).sqrt() * 1.0f64;
    assert!((claimed / steady - 1.0).abs() < 0.05, "{claimed} {steady}");
    assert!((rms / claimed - 1.0).abs() < 0.15, "{rms} {claimed}");
}

/// Bias after one second at rest with readings of 0.01, in the sensor's unit.
fn new_bias(zeroing: &Zeroing) -> Bias {
    let mut bias = Bias::default();
    for _ in 0..1000 {
        zeroing.step(&mut bias, true, Some(0.01));
    }
    bias
}

#[test]
fn bias_follows_readings_at_rest_within_the_limit_until_one_is_beyond() {
    for (config, limit) in [(Config::GYRO, 0.05f32), (Config::ACCELEROMETER, 0.5)] {
        let zeroing = config.build(PERIOD).unwrap();
        let beyond = limit.next_up();
        for (at_rest, reading, follows, goes_on) in [
            (true, Some(0.02), true, true),
            (true, Some(limit), true, true),
            (true, Some(-limit), true, true),
            (true, Some(beyond), false, false),
            (true, Some(-beyond), false, false),
            (true, Some(f32::INFINITY), false, false),
            (true, Some(f32::NEG_INFINITY), false, false),
            (true, Some(f32::NAN), false, true),
            (true, None, false, true),
            (false, Some(0.02), false, true),
            (false, Some(beyond), false, true),
            (false, Some(f32::NAN), false, true),
            (false, None, false, true),
        ] {
            let mut bias = new_bias(&zeroing);
            let before = bias;
            let given = zeroing.step(&mut bias, at_rest, reading);
            assert_eq!(bias.value() != before.value(), follows, "{reading:?}");
            assert_eq!(bias.variance > before.variance, !follows, "{reading:?}");
            assert_eq!(
                given.map(f32::to_bits),
                reading.map(|r| (r - bias.value()).to_bits())
            );
            let before = bias.value();
            for _ in 0..10 {
                zeroing.step(&mut bias, true, Some(0.02));
            }
            assert_eq!(bias.value() != before, goes_on, "{reading:?}");
            // The next rest begins anew, whether or not the motion between them had a reading.
            for between in [None, Some(0.02)] {
                let mut bias = bias;
                zeroing.step(&mut bias, false, between);
                zeroing.step(&mut bias, true, Some(0.02));
                assert!(bias.value() != before, "{reading:?} {between:?}");
            }
        }
    }
}

#[test]
fn reading_is_withheld_above_the_largest_sigma_unless_the_bias_was_never_measured() {
    let still = Config {
        walk_per_sqrt_s: 0.0,
        ..Config::ACCELEROMETER
    };
    let zeroing = still.build(PERIOD).unwrap();
    let largest = 0.03f32 * 0.03;
    for (variance, given) in [
        (None, true),
        (Some(largest), true),
        (Some(largest.next_up()), false),
    ] {
        let (value, beyond) = (0.0, false);
        for reading in [0.1, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut bias = Bias {
                value,
                variance,
                beyond,
            };
            let found = zeroing.step(&mut bias, false, Some(reading));
            let expected = (given || !reading.is_finite()).then_some(reading);
            assert_eq!(found.map(f32::to_bits), expected.map(f32::to_bits));
        }
    }
    // The variance grows up to that of an unknown bias, (0.5/√3)².
    let fast = Config {
        walk_per_sqrt_s: 1.0,
        largest_sigma: 0.29,
        ..Config::ACCELEROMETER
    };
    for (largest_sigma, given) in [(0.28, false), (0.29, true)] {
        let config = Config {
            largest_sigma,
            ..fast
        };
        let zeroing = config.build(PERIOD).unwrap();
        let mut bias = new_bias(&zeroing);
        for _ in 0..1000 {
            assert_eq!(zeroing.step(&mut bias, true, None), None);
        }
        assert_eq!(zeroing.step(&mut bias, false, Some(0.1)).is_some(), given);
    }
}

#[test]
fn bias_measured_too_long_ago_withholds_readings_until_it_is_measured_again() {
    let config = Config::ACCELEROMETER;
    let zeroing = config.build(PERIOD).unwrap();
    let mut bias = Bias::default();
    for _ in 0..10_000 {
        // A bias that was never measured is taken as 0, as after calibration.
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
    // A reading that is not finite is passed on, to be counted.
    let damaged = zeroing.step(&mut bias, false, Some(f32::NAN));
    assert!(damaged.is_some_and(f32::is_nan));
    assert!(zeroing.step(&mut bias, true, Some(0.1)).is_some());
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

/// Counts, motors on, and reading of the gyro.
type Inputs = ([Option<i32>; 2], bool, Option<f32>);
const LEFT: Option<i32> = Some(5);
const RIGHT: Option<i32> = Some(-7);
const RESTING: Inputs = ([LEFT, RIGHT], false, Some(0.0));

fn step(detector: &mut RestDetector, (counts, motors_on, gyro): Inputs, times: &RestTimes) -> Rest {
    detector.step(counts.into(), motors_on, gyro, times)
}

/// Detector after 20 ticks of rest. It reports rest from the fourth tick on, because the first tick has no earlier
/// counts.
fn rested(times: &RestTimes) -> RestDetector {
    let mut detector = RestDetector::default();
    for tick in 1..=20 {
        let expected = if tick >= 4 { BOTH } else { Rest::default() };
        assert_eq!(step(&mut detector, RESTING, times), expected, "{tick}");
    }
    detector
}

/// Each combination of counts, motors and gyro reading is disturbed for one tick, with several values.
#[test]
fn rest_ends_with_any_disturbance_and_returns_after_its_whole_time() {
    let spread = 0.01f32;
    let readings = [spread.next_up(), -spread.next_up(), f32::NAN, f32::INFINITY];
    for (set, settle) in (0..16u8).flat_map(|set| [0, 2, 3, 4, 10].map(|settle| (set, settle))) {
        let times = RestTimes { settle, ..TIMES };
        let [left, right, motors_on, turns] = [1, 2, 4, 8].map(|bit| set & bit != 0);
        for (moved, reading) in [Some(6), None]
            .into_iter()
            .flat_map(|moved| readings.map(|reading| (moved, reading)))
        {
            let counts = [
                if left { moved } else { LEFT },
                if right { moved } else { RIGHT },
            ];
            let gyro = Some(if turns { reading } else { 0.0 });
            let disturbed = (counts, motors_on, gyro);
            let mut detector = rested(&times);
            let (wheels, axle) = (!(left || right), set == 0);
            assert_eq!(
                step(&mut detector, disturbed, &times),
                Rest { wheels, axle }
            );
            // At the next tick the counts change back, which is a change too.
            let wheels_after = if wheels { 0 } else { 4 };
            let gyro_after = if turns { 3 } else { 0 };
            let motors_after = if motors_on { settle.max(3) } else { 0 };
            let axle_after = wheels_after.max(gyro_after).max(motors_after);
            for tick in 1..=15 {
                let (wheels, axle) = (tick >= wheels_after, tick >= axle_after);
                let found = step(&mut detector, RESTING, &times);
                assert_eq!(found, Rest { wheels, axle }, "{disturbed:?} {tick}");
            }
        }
    }
}

#[test]
fn rest_does_not_return_while_the_disturbance_lasts() {
    let none = Rest::default();
    for (inputs, expected) in [
        (([None, RIGHT], false, Some(0.0)), none),
        (([LEFT, None], false, Some(0.0)), none),
        (([None, None], false, Some(0.0)), none),
        (([LEFT, RIGHT], true, Some(0.0)), WHEELS),
        (([LEFT, RIGHT], false, Some(f32::NAN)), WHEELS),
        (([LEFT, RIGHT], false, None), BOTH),
    ] {
        let times = RestTimes { settle: 0, ..TIMES };
        let mut detector = rested(&times);
        for _ in 0..20 {
            assert_eq!(step(&mut detector, inputs, &times), expected, "{inputs:?}");
        }
    }
    // An axle without a gyro rests after the same time.
    let mut detector = RestDetector::default();
    let rests = [(); 5].map(|()| step(&mut detector, ([LEFT, RIGHT], false, None), &TIMES).axle);
    assert_eq!(rests, [false, false, false, true, true]);
}

#[test]
fn gyro_spread_covers_the_whole_rest() {
    for sign in [1.0, -1.0] {
        let mut detector = rested(&TIMES);
        for (reading, expected) in [
            (0.004f32, BOTH),
            (0.01, BOTH),
            (0.0, BOTH),
            (0.0101, WHEELS),
            // A new rest begins here.
            (0.02, WHEELS),
            (0.029, WHEELS),
            (0.021, BOTH),
            (0.0195, BOTH),
            (0.0185, WHEELS),
        ] {
            let inputs = ([LEFT, RIGHT], false, Some(sign * reading));
            assert_eq!(step(&mut detector, inputs, &TIMES), expected, "{reading}");
        }
    }
    // The first reading of a gyro within a rest is compared with no earlier reading.
    let mut detector = rested(&TIMES);
    step(&mut detector, ([LEFT, RIGHT], true, Some(9.0)), &TIMES);
    for (ticks, gyro) in [(20, None), (1, Some(5.0)), (1, None), (1, Some(5.005))] {
        let rests = (0..ticks).map(|_| step(&mut detector, ([LEFT, RIGHT], false, gyro), &TIMES));
        assert_eq!(rests.last(), Some(BOTH), "{gyro:?}");
    }
    // 14 standard deviations of 4.9e-5 rad/s/√Hz over 500 Hz.
    let spread = Config::GYRO.build(PERIOD).unwrap().spread();
    assert!((spread - 0.01534).abs() < 1e-5, "{spread}");
}

#[test]
fn longest_hold_is_reached_and_kept() {
    let times = RestTimes {
        hold: u16::MAX,
        ..TIMES
    };
    let mut detector = RestDetector::default();
    for tick in 1..=70_000u32 {
        let expected = if tick > 65_535 { BOTH } else { Rest::default() };
        assert_eq!(step(&mut detector, RESTING, &times), expected);
    }
}

#[test]
fn swinging_frame_is_not_at_rest_despite_constant_counts() {
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
            let rest = detector.step(Wheels::both(count), false, Some(rate as f32), &times);
            longest += i32::from(rest.axle);
        }
        longest
    };
    // At the turning points the counts stay the same for 0.1 s.
    assert_eq!(settled(0.03, 20), 0);
    assert!(settled(1e-5, 20) > 17_000);
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
        let rest = detector.step(Wheels::both(Some(1)), false, Some(reading), &times);
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
