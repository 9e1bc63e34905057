use super::*;
use proptest::prelude::*;

/// The winding in double precision, exact for a voltage held over a period.
struct Motor {
    current: f64,
    speed: f64,
}

impl Motor {
    /// Motor without current, at constant speed.
    fn at(speed: f64) -> Self {
        let current = 0.0;
        Self { current, speed }
    }

    /// Input of the loop for a torque (N m) and a limit (A).
    fn input(&self, torque_nm: f32, limit_a: f32) -> Input {
        Input {
            torque_nm,
            current_a: self.current as f32,
            speed_rad_s: self.speed as f32,
            supply_v: SUPPLY as f32,
            limit_a,
        }
    }

    fn step(&mut self, config: &Config, voltage: f64) {
        let (r, l) = (
            f64::from(config.resistance_ohm),
            f64::from(config.inductance_h),
        );
        let settled = (voltage - f64::from(config.torque_constant_nm_a) * self.speed) / r;
        let left = (-r * f64::from(config.period_s) / l).exp();
        self.current = settled + (self.current - settled) * left;
    }
}

const SUPPLY: f64 = 12.0;

/// Runs the loop; `delay` periods pass until a voltage takes effect.
fn run(
    config: &Config,
    motor: &mut Motor,
    steps: usize,
    delay: usize,
    mut torque: impl FnMut(usize) -> f32,
) -> Vec<f64> {
    let current_loop = config.build().unwrap();
    let mut state = State::default();
    let mut pending = std::collections::VecDeque::from(vec![0.0; delay]);
    (0..steps)
        .map(|k| {
            let output = current_loop.step(&mut state, &motor.input(torque(k), 10.0));
            assert!(output.valid && output.duty.abs() <= config.max_duty * 1.000_001);
            pending.push_back(f64::from(output.duty) * SUPPLY);
            let voltage = pending.pop_front().unwrap();
            motor.step(config, voltage);
            motor.current
        })
        .collect()
}

#[test]
fn step_response_is_the_exponential_of_the_bandwidth() {
    let config = Config::default();
    for speed in [0.0, 8.0, -8.0] {
        let mut motor = Motor::at(speed);
        let response = run(&config, &mut motor, 200, 0, |_| 0.3);
        let bandwidth = f64::from(config.bandwidth_rad_s) * f64::from(config.period_s);
        for (k, current) in response.iter().enumerate() {
            let expected = 0.5 * (1.0 - (-bandwidth * (k + 1) as f64).exp());
            let error = current - expected;
            assert!(error.abs() < 1e-4, "{k}: {current} {expected}");
        }
    }
}

#[test]
fn a_voltage_one_period_late_does_not_overshoot() {
    let mut config = Config::default();
    config.bandwidth_rad_s = 5700.0;
    let mut motor = Motor::at(0.0);
    let response = run(&config, &mut motor, 400, 1, |_| 0.3);
    let peak = response.iter().fold(0.0f64, |a, &b| a.max(b));
    assert!(peak < 0.5 + 1e-4, "{peak}");
    assert!((response[399] - 0.5).abs() < 1e-4);
    // After 1.5 ms the current is within 2 % of its reference.
    assert!((response[30] - 0.5).abs() < 0.01, "{}", response[30]);
}

#[test]
fn wrong_motor_parameters_leave_no_steady_error() {
    let configured = Config::default();
    let real = Config {
        resistance_ohm: 3.6,
        inductance_h: 3.0e-3,
        torque_constant_nm_a: 0.54,
        ..configured
    };
    let current_loop = configured.build().unwrap();
    let (mut state, mut voltage) = (State::default(), 0.0);
    let mut motor = Motor::at(6.0);
    for _ in 0..1000 {
        let input = motor.input(0.9, 10.0);
        motor.step(&real, voltage);
        voltage = f64::from(current_loop.step(&mut state, &input).duty) * SUPPLY;
    }
    assert!((motor.current - 1.5).abs() < 1e-3, "{}", motor.current);
}

/// After long saturation, the loop follows a smaller reference at once.
#[test]
fn saturation_does_not_wind_up() {
    let config = Config::default();
    // At this speed the supply cannot drive 2 A.
    let mut motor = Motor::at(18.0);
    let response = run(&config, &mut motor, 3000, 1, |k| {
        if k < 2000 { 1.2 } else { 0.15 }
    });
    let stuck = (0.98 * SUPPLY - 0.6 * 18.0) / 2.88;
    assert!((response[1999] - stuck).abs() < 1e-3, "{}", response[1999]);
    // 2 ms are ten time constants of the loop.
    assert!((response[2040] - 0.25).abs() < 2e-3, "{}", response[2040]);
    let lowest = response[2000..].iter().fold(1.0f64, |a, &b| a.min(b));
    assert!(lowest > 0.24, "{lowest}");
}

#[test]
fn current_stays_within_the_lesser_limit() {
    let config = Config::default();
    let current_loop = config.build().unwrap();
    for (limit, expected) in [(10.0, 4.0), (1.5, 1.5), (0.0, 0.0)] {
        let mut state = State::default();
        let mut motor = Motor::at(-2.0);
        for _ in 0..500 {
            let output = current_loop.step(&mut state, &motor.input(100.0, limit));
            assert!(output.limited && output.reference_a == expected);
            motor.step(&config, f64::from(output.duty) * SUPPLY);
            assert!(motor.current < f64::from(expected) + 1e-3);
        }
        assert!((motor.current - f64::from(expected)).abs() < 1e-3);
    }
}

properties! {
    #[test]
    fn any_input_gives_a_bounded_duty(bits: [u32; 5], rounds in 1usize..20) {
        let config = Config::default();
        let current_loop = config.build().unwrap();
        let mut state = State::default();
        let [torque_nm, current_a, speed_rad_s, supply_v, limit_a] = bits.map(f32::from_bits);
        let input = Input { torque_nm, current_a, speed_rad_s, supply_v, limit_a };
        for _ in 0..rounds {
            let output = current_loop.step(&mut state, &input);
            prop_assert!(output.duty.abs() <= 0.980_001);
            prop_assert!(output.valid || output.duty == 0.0);
        }
        // After any input, the loop accepts valid samples again.
        let sound = Input { torque_nm: 0.0, supply_v: 12.0, limit_a: 1.0, ..Input::default() };
        for _ in 0..2 {
            prop_assert!(current_loop.step(&mut state, &sound).valid);
        }
    }
}

#[test]
fn input_that_is_not_finite_switches_off() {
    let current_loop = Config::default().build().unwrap();
    let good = Motor::at(0.0).input(1.0, 4.0);
    let spoiled: [fn(&mut Input, f32); 5] = [
        |i, x| i.torque_nm = x,
        |i, x| i.current_a = x,
        |i, x| i.speed_rad_s = x,
        |i, x| i.supply_v = x,
        |i, x| i.limit_a = x,
    ];
    for (k, spoil) in spoiled.iter().enumerate() {
        for bad in [f32::NAN, f32::NEG_INFINITY] {
            let mut state = State::default();
            current_loop.step(&mut state, &good);
            let mut input = good;
            spoil(&mut input, bad);
            let output = current_loop.step(&mut state, &input);
            assert_eq!(output, Output::default(), "{k}");
            assert_eq!(state, State::default());
        }
    }
}

#[test]
fn an_integral_that_overflows_switches_off() {
    let current_loop = Config::default().build().unwrap();
    for current_a in [f32::MAX, f32::MIN] {
        let mut state = State { integral_v: 1.0 };
        let input = Input {
            current_a,
            ..Motor::at(0.0).input(1.0, 4.0)
        };
        assert_eq!(current_loop.step(&mut state, &input), Output::default());
        assert_eq!(state, State::default());
    }
}

/// 2.4 N m take the largest current, 4 A; the largest voltage from a supply of 12 V is 11.76 V.
#[test]
fn a_limit_of_current_or_of_voltage_is_reported() {
    let config = Config::default();
    let current_loop = config.build().unwrap();
    for (torque_nm, current_a, speed_rad_s, limited) in [
        (0.3, 0.5, 0.0, false),
        (-2.4, -4.0, 0.0, false),
        (2.5, 4.0, 0.0, true),
        (-2.5, -4.0, 0.0, true),
        (0.3, 0.5, 19.5, false),
        (0.3, 0.5, 19.7, true),
        (0.3, 0.5, -19.7, true),
    ] {
        let input = Input {
            torque_nm,
            current_a,
            speed_rad_s,
            supply_v: 12.0,
            limit_a: 10.0,
        };
        let output = current_loop.step(&mut State::default(), &input);
        assert_eq!(output.limited, limited, "{torque_nm} {speed_rad_s}");
        let voltage = (config.torque_constant_nm_a * speed_rad_s).clamp(-11.76, 11.76);
        assert!(
            (12.0 * output.duty - voltage).abs() < 1e-4,
            "{}",
            output.duty
        );
    }
}

/// The smallest valid supply voltage is the smallest normal `f32`.
#[test]
fn a_supply_above_zero_is_needed() {
    let current_loop = Config::default().build().unwrap();
    for (supply_v, valid) in [
        (f32::MIN_POSITIVE, true),
        (f32::MIN_POSITIVE.next_down(), false),
        (0.0, false),
        (-12.0, false),
    ] {
        let input = Input {
            supply_v,
            ..Motor::at(0.0).input(1.0, 4.0)
        };
        assert_eq!(
            current_loop.step(&mut State::default(), &input).valid,
            valid,
            "{supply_v}"
        );
    }
}

/// 1 − exp(−ω_b T) is a quarter at ω_b T = ln 4/3.
#[test]
fn bandwidth_is_accepted_up_to_a_quarter_of_the_step_per_period() {
    let accepted = |product: f64| {
        let config = Config {
            period_s: 0.5f32.powi(14),
            bandwidth_rad_s: (product * f64::from(1 << 14)) as f32,
            ..Config::default()
        };
        config.build().is_ok()
    };
    let quarter = (4.0f64 / 3.0).ln();
    assert!(accepted(quarter) && !accepted(quarter * (1.0 + 1e-6)));
}

#[test]
fn bad_parameters_are_named() {
    crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
        ("resistance_ohm", |c| c.resistance_ohm = 0.0),
        ("inductance_h", |c| c.inductance_h = f32::NAN),
        ("bandwidth_rad_s", |c| c.bandwidth_rad_s = 6000.0),
        ("torque_constant_nm_a", |c| c.torque_constant_nm_a = -1.0),
        ("max_current_a", |c| c.max_current_a = f32::INFINITY),
        ("max_duty", |c| c.max_duty = 1.5),
    ]);
}
