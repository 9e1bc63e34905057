//! Tests against textbook circuits and the figures of the data sheet.

use super::super::motor::MotorConfig;
use super::*;

const MS: u64 = 1_000_000_000;
const NS: u64 = 1_000;

fn ideal() -> DriverConfig {
    DriverConfig {
        propagation: Time(0),
        dead: Time(0),
        ..DriverConfig::default()
    }
}

/// A driver that is awake from 1 ms on.
fn awake(config: DriverConfig, motor: MotorConfig) -> Drv8874 {
    let mut driver = Drv8874::new(config, Motor::new(motor), 12.0);
    driver.awake(true, Time(0));
    driver.advance(Time(MS));
    driver
}

/// Runs PWM periods of 50 µs with `duty`; returns the lowest and the highest current of the last period, A.
fn run(driver: &mut Drv8874, from: Time, periods: u64, duty: f64) -> (f64, f64) {
    let period = Time::from_micros(50);
    let on = Time((period.0 as f64 * duty) as u64);
    let (mut low, mut high) = (0.0, 0.0);
    for k in 0..periods {
        let at = Time(from.0 + k * period.0);
        driver.enable(true, at);
        low = driver.current(at);
        driver.enable(false, at + on);
        high = driver.current(at + on);
    }
    driver.advance(Time(from.0 + periods * period.0));
    (low, high)
}

#[test]
fn current_ripple_and_mean_match_the_rl_circuit() {
    let motor = MotorConfig::default();
    let mut driver = awake(ideal(), motor);
    driver.phase(true, Time(MS));
    driver.speed(3.0, Time(MS));
    run(&mut driver, Time(MS), 400, 0.4);
    driver.take_work(Time(21 * MS));
    let (low, high) = run(&mut driver, Time(21 * MS), 20, 0.4);
    // Steady state of an R-L circuit switched between 12 V and 0.
    let ohms = motor.resistance_ohm + 0.2;
    let tau = motor.inductance_h / ohms;
    let emf = motor.constant_nm_a * 3.0 / ohms;
    let (on, off) = (20e-6 / tau, 30e-6 / tau);
    let peak = 12.0 / ohms * (1.0 - (-on).exp()) / (1.0 - (-on - off).exp()) - emf;
    let valley = (peak + emf) * (-off).exp() - emf;
    assert!((high - peak).abs() < 1e-9, "{high} {peak}");
    assert!((low - valley).abs() < 1e-9, "{low} {valley}");
    let mean = driver.take_work(Time(22 * MS)).mean_current_a();
    let expected = (0.4 * 12.0 - motor.constant_nm_a * 3.0) / ohms;
    assert!((mean - expected).abs() < 1e-9, "{mean} {expected}");
}

#[test]
fn dead_time_lowers_the_voltage_and_propagation_does_not() {
    let motor = MotorConfig::default();
    let mut driver = awake(DriverConfig::default(), motor);
    driver.phase(true, Time(MS));
    run(&mut driver, Time(MS), 400, 0.5);
    driver.take_work(Time(21 * MS));
    run(&mut driver, Time(21 * MS), 20, 0.5);
    let work = driver.take_work(Time(22 * MS));
    // In each period, both edges have 300 ns at −0.9 V; the dead time of the rising edge shortens the pulse.
    let ohms = motor.resistance_ohm + 0.2;
    let volts = (12.0 * (25.0 - 0.3) - 0.9 * 0.6) / 50.0;
    let expected = volts / ohms;
    let mean = work.mean_current_a();
    assert!((mean - expected).abs() < 3e-3, "{mean} {expected}");
    // The supply delivers current only during the pulse.
    let share = work.mean_supplied_a() / mean;
    assert!((share - 0.494).abs() < 2e-3, "{share}");
}

#[test]
fn driver_wakes_and_sleeps_after_1_ms() {
    let motor = Motor::new(MotorConfig::default());
    let mut driver = Drv8874::new(DriverConfig::default(), motor, 12.0);
    driver.phase(true, Time(0));
    driver.enable(true, Time(0));
    driver.awake(true, Time(5 * MS));
    assert_eq!(driver.current(Time(6 * MS - 1)), 0.0);
    assert_eq!(driver.due, Time(6 * MS));
    assert!(driver.current(Time(6 * MS + 100_000 * NS)) > 0.4);
    driver.awake(false, Time(7 * MS));
    assert!(driver.current(Time(8 * MS - 1)) > 2.0);
    // With the bridge off, the current decays against 12 V and two diodes, then stays 0.
    assert_eq!(driver.current(Time(9 * MS)), 0.0);
    let work = driver.take_work(Time(9 * MS));
    assert!(work.supplied_as < work.charge_as);
    driver.awake(true, Time(9 * MS));
    driver.awake(false, Time(9 * MS + 1));
    assert_eq!(driver.due, Time::NEVER);
}

#[test]
fn coasting_current_ends_at_the_time_of_the_closed_form() {
    let motor = MotorConfig::default();
    let mut driver = awake(ideal(), motor);
    driver.phase(true, Time(MS));
    driver.enable(true, Time(MS));
    driver.awake(false, Time(MS));
    let start = driver.current(Time(2 * MS));
    // i(t) = (i₀ + V/R) e^(−t/τ) − V/R, with V = 12 V + 2·0.9 V and R of the motor alone.
    let (ohms, volts) = (motor.resistance_ohm, 13.8);
    let end = motor.inductance_h / ohms * (1.0 + start * ohms / volts).ln();
    let end_ps = (end * 1e12) as u64;
    assert!(driver.current(Time(2 * MS + end_ps - 1000 * NS)) > 0.0);
    assert_eq!(driver.current(Time(2 * MS + end_ps + NS)), 0.0);
}

#[test]
fn braking_current_is_the_back_emf_over_the_resistance() {
    let motor = MotorConfig::default();
    let mut driver = awake(ideal(), motor);
    driver.speed(10.0, Time(MS));
    let expected = -motor.constant_nm_a * 10.0 / (motor.resistance_ohm + 0.2);
    assert!((driver.current(Time(101 * MS)) - expected).abs() < 1e-9);
    // If the back EMF exceeds the supply, a sleeping bridge rectifies.
    driver.awake(false, Time(101 * MS));
    driver.speed(30.0, Time(110 * MS));
    let charging = -(0.6 * 30.0 - 13.8) / motor.resistance_ohm;
    assert!((driver.current(Time(200 * MS)) - charging).abs() < 1e-9);
    driver.take_work(Time(200 * MS));
    let work = driver.take_work(Time(201 * MS));
    assert!((work.mean_supplied_a() - charging).abs() < 1e-9);
}

#[test]
fn over_current_shuts_down_and_retries_after_2_ms() {
    let stalled = MotorConfig {
        resistance_ohm: 0.5,
        ..MotorConfig::default()
    };
    let config = DriverConfig {
        trip_a: 100.0,
        ..ideal()
    };
    let mut driver = awake(config, stalled);
    driver.phase(true, Time(MS));
    driver.enable(true, Time(MS));
    // 8 A with 12 V over 0.7 Ω is reached after −τ ln(1 − 8·0.7/12); the deglitch time adds 3 µs.
    let tau = 2.3e-3 / 0.7;
    let trips = -tau * (1.0f64 - 8.0 * 0.7 / 12.0).ln() + 3e-6;
    let at = Time(MS + (trips * 1e12) as u64);
    driver.advance(at - Time(10 * NS));
    assert_eq!(driver.fault_pin(), Drive::Open);
    driver.advance(at + Time(10 * NS));
    assert_eq!(driver.fault_pin(), Drive::Low);
    driver.advance(at + Time(2 * MS - 20 * NS));
    assert_eq!(driver.fault_pin(), Drive::Low);
    assert_eq!(driver.current_slope(), 0.0);
    driver.advance(at + Time(2 * MS + 20 * NS));
    assert_eq!(driver.fault_pin(), Drive::Open);
    assert!(driver.current_slope() > 0.0);
}

#[test]
fn regulation_holds_the_current_near_its_limit_without_fault() {
    let config = DriverConfig {
        trip_a: 2.0,
        ..ideal()
    };
    let mut driver = awake(config, MotorConfig::default());
    driver.phase(true, Time(MS));
    driver.enable(true, Time(MS));
    // The limit is reached after −τ ln(1 − 2·3.08/12) = 0.537 ms. The bridge brakes for 25 µs, which lowers the current
    // by 0.067 A.
    let (mut smallest, mut largest) = (2.0f64, 0.0f64);
    for k in 0..2000 {
        let current = driver.current(Time(2 * MS + k * 1000 * NS));
        (smallest, largest) = (smallest.min(current), largest.max(current));
    }
    assert!(largest <= 2.0 + 1e-6, "{largest}");
    assert!((1.93..1.94).contains(&smallest), "{smallest}");
    assert_eq!(driver.fault_pin(), Drive::Open);
}

#[test]
fn undervoltage_lockout_has_hysteresis() {
    let mut driver = awake(ideal(), MotorConfig::default());
    for (volts, low) in [(5.0, false), (4.3, true), (4.4, true), (4.5, false)] {
        driver.supply(volts, Time(2 * MS));
        assert_eq!(driver.fault_pin() == Drive::Low, low, "{volts}");
    }
}

#[test]
fn injected_faults_have_their_effect() {
    let mut driver = awake(ideal(), MotorConfig::default());
    driver.phase(true, Time(MS));
    driver.force_fault(Time(2 * MS), Time(3 * MS));
    driver.enable(true, Time(MS));
    for (at, low) in [(1999, false), (2001, true), (2999, true), (3001, false)] {
        driver.advance(Time(at * MS / 1000));
        assert_eq!(driver.fault_pin() == Drive::Low, low, "{at}");
    }
    driver.set_motor_open(true, Time(4 * MS));
    assert_eq!(driver.current(Time(5 * MS)), 0.0);
    driver.set_motor_open(false, Time(5 * MS));
    assert!(driver.current(Time(6 * MS)) > 1.0);
    // The upper transistor of OUT1 is stuck on. Braking is then a short, which the driver shuts down. In sleep mode no
    // current flows through the motor, because OUT2 is off.
    driver.set_stuck(Half::One, Some(true), Time(6 * MS));
    driver.enable(false, Time(7 * MS));
    driver.advance(Time(7 * MS + 3001 * NS));
    assert_eq!(driver.fault_pin(), Drive::Low);
    driver.awake(false, Time(8 * MS));
    assert_eq!(driver.current(Time(20 * MS)), 0.0);
    // Transistors of both halves are stuck on: the motor cannot be switched off.
    driver.set_stuck(Half::Two, Some(false), Time(20 * MS));
    assert!((driver.current(Time(40 * MS)) - 12.0 / 3.08).abs() < 1e-6);
}
