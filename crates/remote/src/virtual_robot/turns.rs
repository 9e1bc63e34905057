//! Test of the inertial sensor's driver with the virtual sensor, in fast turns.

use core_algos::acquisition::icm42688::Icm42688 as Driver;
use virtual_board::Time;
use virtual_board::device::{Icm42688, InertialConfig, Motion};

/// Register with the bits of the adaptive full-scale range.
const INTF_CONFIG1: u8 = 0x4d;
const PS_PER_MS: u64 = 1_000_000_000;
/// Yaw rate of a turn, °/s; angular accelerations at the start and the end of a turn, °/s².
const RATE_DEG_S: f64 = 150.0;
const BEGIN_DEG_S2: f64 = 10_000.0;
const END_DEG_S2: f64 = 300.0;
const TURNS: usize = 10;

/// Heading error after the turns, °: integrated rates of the driver less the true heading. Without the remedy,
/// accesses to INTF_CONFIG1 are suppressed.
fn heading_error(with_remedy: bool, config: InertialConfig) -> f64 {
    let mut sensor = Icm42688::new(config, 1);
    let mut driver = Driver::new(1.0, 1.0).unwrap();
    let mut at = Time(2 * PS_PER_MS);
    let (mut truth, mut measured) = (0.0, 0.0);
    let mut step = |rate: f64, slope: f64, still: bool| {
        let mut motion = Motion::default();
        motion.rate[2] = rate.to_radians();
        motion.rate_slope[2] = slope.to_radians();
        motion.force[2] = 9.81;
        sensor.motion(at, motion);
        at = at + Time(PS_PER_MS);
        let reading = driver.step(still, |bytes| {
            if !with_remedy && bytes[0] & 0x7f == INTF_CONFIG1 {
                bytes[1] = 0x51;
                return true;
            }
            sensor.select(true, at);
            for byte in bytes.iter_mut() {
                *byte = sensor.exchange(*byte, at);
            }
            sensor.select(false, at);
            true
        });
        truth += 1e-3 * (rate + 0.5e-3 * slope);
        measured += 1e-3 * f64::from(reading.gyro_rad_s.unwrap_or(0.0)).to_degrees();
        still || reading.gyro_rad_s.is_some()
    };
    (0..1500).for_each(|_| assert!(step(0.0, 0.0, true)));
    for _ in 0..TURNS {
        let mut rate: f64 = 0.0;
        for (slope, ms) in [
            (BEGIN_DEG_S2, 15),
            (0.0, 600),
            (-END_DEG_S2, 500),
            (0.0, 50),
        ] {
            for _ in 0..ms {
                assert!(step(rate, slope, false), "the sensor is lost");
                rate += 1e-3 * slope;
            }
        }
        assert!(rate.abs() < 1e-6 && RATE_DEG_S == 1e-3 * BEGIN_DEG_S2 * 15.0);
    }
    measured - truth
}

#[test]
fn heading_of_fast_turns_is_biased_by_the_adaptive_range_and_unbiased_without() {
    let part = InertialConfig::default();
    let without_stalls = InertialConfig {
        adaptive_stall: Time(0),
        ..part
    };
    let ideal = heading_error(true, without_stalls);
    let (without, with) = (heading_error(false, part), heading_error(true, part));
    assert_eq!(with, ideal);
    // A stall of 2 ms at 10 000 °/s² loses up to ½ · 10 000 °/s² · (2 ms)² = 0.02°.
    let lost = (without - ideal) / TURNS as f64;
    assert!((-0.03..-0.005).contains(&lost), "{lost}");
}
