use super::super::current;
use super::*;
use proptest::prelude::{any, prop_assert};

const SUPPLY: f64 = 12.0;

/// Simulated winding; resistance and torque constant are relative to those of the configured motor.
#[derive(Clone, Copy)]
struct Winding {
    open: bool,
    resistance: f64,
    constant: f64,
}

const SOUND: Winding = Winding {
    open: false,
    resistance: 1.0,
    constant: 1.0,
};
const OPEN: Winding = Winding {
    open: true,
    ..SOUND
};

/// Runs current loop and monitor on a winding in double precision; returns the first period at which the voltage is
/// unexplained.
fn objects_at(
    winding: Winding,
    periods: usize,
    torque: impl Fn(usize) -> f32,
    speed: impl Fn(usize) -> f64,
) -> Option<usize> {
    let config = current::Config::default();
    let current_loop = config.build().unwrap();
    let response = Config::default().build().unwrap();
    let (mut drive, mut state) = (current::State::default(), State::default());
    let resistance = winding.resistance * f64::from(config.resistance_ohm);
    let constant = winding.constant * f64::from(config.torque_constant_nm_a);
    let left = (-resistance * f64::from(config.period_s) / f64::from(config.inductance_h)).exp();
    let mut current = 0.0f64;
    (0..periods).find(|&k| {
        let (current_a, speed_rad_s) = (current as f32, speed(k) as f32);
        let output = current_loop.step(
            &mut drive,
            &current::Input {
                torque_nm: torque(k),
                current_a,
                speed_rad_s,
                supply_v: SUPPLY as f32,
                limit_a: 4.0,
            },
        );
        let voltage = f64::from(output.duty) * SUPPLY;
        response.step(&mut state, voltage as f32, current_a, speed_rad_s);
        let settled = (voltage - constant * speed(k)) / resistance;
        current = match winding.open {
            true => 0.0,
            false => settled + (current - settled) * left,
        };
        state.unexplained()
    })
}

/// Torque and speed of a slow oscillation.
fn swinging(k: usize) -> (f32, f64) {
    let t = k as f64 * 50e-6;
    ((2.0 * (40.0 * t).sin()) as f32, 6.0 * (7.0 * t).sin())
}

#[test]
fn voltage_of_healthy_motor_is_always_explained() {
    // Nominal, hot and cold winding, with the tolerance of the magnets.
    for (resistance, constant) in [(1.0, 1.0), (1.4, 0.95), (0.9, 1.05)] {
        let winding = Winding {
            resistance,
            constant,
            ..SOUND
        };
        let at = objects_at(winding, 40_000, |k| swinging(k).0, |k| swinging(k).1);
        assert_eq!(at, None, "{resistance} {constant}");
        // The wheel turns with or against the torque; the voltage reaches its limit.
        for speed in [14.0, -14.0] {
            assert_eq!(objects_at(winding, 20_000, |_| 2.0, |_| speed), None);
        }
    }
}

/// Any lasting torque reveals an open winding, because the loop keeps raising the voltage.
#[test]
fn an_open_winding_is_found_within_two_windows() {
    for torque in [0.05f32, -0.3, 2.0] {
        for speed in [0.0, 5.0, -5.0] {
            let at = objects_at(OPEN, 4_000, |_| torque, |_| speed);
            assert!(at.is_some_and(|k| k <= 440), "{torque} {speed}: {at:?}");
        }
    }
}

#[test]
fn open_winding_without_torque_command_is_not_found() {
    assert_eq!(objects_at(OPEN, 4_000, |_| 0.0, |_| 3.0), None);
}

/// Windows of 256 periods of 2⁻¹⁴ s, so that their means are exact.
fn exact_windows() -> Config {
    Config {
        period_s: 0.5f32.powi(14),
        window_s: 0.5f32.powi(6),
        ..Config::default()
    }
}

#[test]
fn window_is_explained_if_its_residual_is_within_the_tolerance() {
    let config = exact_windows();
    let response = config.build().unwrap();
    let mut random = crate::fusion::testing::Random::new(6);
    let (mut state, mut objected) = (State::default(), 0);
    let mut first = random.between(-4.0, 4.0);
    for window in 0..2000 {
        let level = [14.0, 4.0, 20.0].map(|most| random.between(-most, most));
        let mut sums = [0.0; 3];
        for k in 0..256 {
            let [voltage, current, speed] =
                level.map(|mean| (mean * (1.0 + 0.3 * random.normal())) as f32);
            let current = if k == 0 { first as f32 } else { current };
            let before = state.unexplained();
            response.step(&mut state, voltage, current, speed);
            assert!(k == 0 || state.unexplained() == before, "{window}");
            for (sum, value) in sums.iter_mut().zip([voltage, current, speed]) {
                *sum += f64::from(value) / 256.0;
            }
        }
        let last = random.between(-4.0, 4.0);
        let rise = f64::from(config.inductance_h) * (last - first) * 64.0;
        let drop = f64::from(config.resistance_ohm) * sums[1];
        let left = sums[0] - drop - f64::from(config.torque_constant_nm_a) * sums[2] - rise;
        let allowed = 1.5 + 0.6 * drop.abs();
        // The first period of the next window closes this window.
        let mut closed = state;
        response.step(&mut closed, 0.0, last as f32, 0.0);
        if (left.abs() / allowed - 1.0).abs() > 1e-3 {
            assert_eq!(
                closed.unexplained(),
                left.abs() > allowed,
                "{window}: {left} {allowed}"
            );
        }
        objected += usize::from(closed.unexplained());
        first = last;
    }
    assert!((400..1800).contains(&objected), "{objected}");
}

#[test]
fn a_voltage_of_just_the_tolerance_is_explained() {
    let response = exact_windows().build().unwrap();
    for (voltage, unexplained) in [(1.5, false), (1.5 + 0.5f32.powi(10), true), (-1.5, false)] {
        let mut state = State::default();
        (0..257).for_each(|_| response.step(&mut state, voltage, 0.0, 0.0));
        assert_eq!(state.unexplained(), unexplained, "{voltage}");
    }
}

properties! {
    #[test]
    fn input_that_is_not_finite_is_unexplained_for_its_window(place in 0usize..3, at in 0usize..200, bits: u32) {
        let response = Config::default().build().unwrap();
        let mut state = State::default();
        let bad = f32::from_bits(bits | 0x7f80_0000);
        for k in 0..=200 {
            let mut input = [0.0, 0.0, 0.0];
            if k == at { input[place] = bad; }
            response.step(&mut state, input[0], input[1], input[2]);
        }
        prop_assert!(state.unexplained());
        // The next whole window explains the voltage again.
        for _ in 0..400 {
            response.step(&mut state, 0.0, 0.0, 0.0);
        }
        prop_assert!(!state.unexplained());
    }

    #[test]
    fn no_voltage_is_unexplained_before_a_whole_window(voltage: f32, current in any::<f32>()) {
        let response = Config::default().build().unwrap();
        let mut state = State::default();
        for _ in 0..200 {
            response.step(&mut state, voltage, current, 0.0);
            prop_assert!(!state.unexplained());
        }
    }
}

#[test]
fn bad_parameters_are_named() {
    crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
        ("resistance_ohm", |c| c.resistance_ohm = 0.0),
        ("inductance_h", |c| c.inductance_h = f32::NAN),
        ("torque_constant_nm_a", |c| c.torque_constant_nm_a = -1.0),
        ("period_s", |c| c.period_s = f32::INFINITY),
        ("window_s", |c| c.window_s = 1.99e-4),
        ("window_s", |c| c.window_s = 1.01),
        ("tolerance_v", |c| c.tolerance_v = 0.0),
        ("tolerance_share", |c| c.tolerance_share = -0.1),
    ]);
}
