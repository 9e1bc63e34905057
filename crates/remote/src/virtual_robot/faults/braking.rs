//! Emergency stops on the level and on a slope: time to rest, speed of creep on the slope, and the drivers' state.

use super::Campaign;
use super::bench::FaultBench;
use super::entry::{BoardTrial, Entry, entries};
use crate::virtual_robot::Options;
use core_algos::topology::Role;
use host_sim::base::error::Error;

/// Time of driving before the emergency stop, ms.
const DRIVE_MS: u64 = 1_600;
/// Time from the press of the button to the removal of the chock, ms.
const CHOCK_MS: u64 = 150;
/// Time of observation after the stop, ms.
const OBSERVATION_MS: u64 = 3_000;
/// Speed that the robot must have reached before the stop, m/s.
const DRIVEN_M_S: f64 = 0.1;
/// Speed below which the robot counts as at rest, m/s; from this speed the robot rolls 2 mm further.
const REST_M_S: f64 = 1e-2;
/// Limit of the time from the stop to rest on the level, ms.
const REST_WITHIN_MS: u64 = 500;
/// Upper limit of the speed of a braked robot on a slope, m/s.
const CREEP_M_S: f64 = 0.1;
/// Time from the stop after which `CREEP_M_S` applies, ms.
const CREEP_AFTER_MS: u64 = 500;
/// Lower limit of the speed of a braked robot on a slope at the end of the observation, m/s.
const CREEP_AT_LEAST_M_S: f64 = 0.02;
/// Angle of the slope, °.
const SLOPE_DEG: f64 = 5.0;

/// Speed of the robot, m/s, and true if the drivers of both axles are awake: one sample before the stop, then one per
/// millisecond.
fn speeds(campaign: &Campaign, seed: u64, slope_deg: f64) -> Result<Vec<(f64, bool)>, Error> {
    let mut campaign = campaign.clone();
    let world = &mut campaign.scenario.world;
    world.plant.slope_rad = slope_deg.to_radians();
    // Inertial sensors are not fitted: they could not determine their biases while the chocked robot creeps.
    (
        world.sensors.gyro.fitted,
        world.sensors.accelerometer.fitted,
    ) = (false, false);
    let mut bench = FaultBench::new(&campaign, Options::default(), seed)?;
    // A chock at one wheel keeps the robot from rolling down the slope until it drives.
    bench.robot.blocked = Some((0, 0));
    bench.robot.boot(&Options::default())?;
    bench.press();
    bench.run_for(CHOCK_MS);
    bench.robot.blocked = None;
    bench.run_for(DRIVE_MS);
    let robot = bench.robot.topology;
    let mut samples = Vec::new();
    for ms in 0..=OBSERVATION_MS {
        if ms == 1 {
            for role in robot.axles().map(Role::Axle) {
                bench.axle(role, |axle, now| axle.stop(true, now));
            }
        }
        bench.run_for(1);
        let axles = bench.robot.plant.axles();
        let sum: f64 = axles.iter().map(|axle| axle.velocity[0]).sum();
        let speed = sum.abs() / axles.len() as f64;
        let mut awake = true;
        for role in robot.axles().map(Role::Axle) {
            bench.axle(role, |axle, _| awake &= axle.is_awake());
        }
        samples.push((speed, awake));
    }
    Ok(samples)
}

/// Emergency stop on the level: one case, or the first violated limit.
fn on_the_level(campaign: &Campaign, seed: u64) -> Result<Result<usize, String>, Error> {
    let samples = speeds(campaign, seed, 0.0)?;
    let rest = samples.iter().rposition(|(speed, _)| *speed > REST_M_S);
    let rest = rest.map_or(0, |last| last as u64 + 1);
    let asleep = samples.last().is_some_and(|(_, awake)| !awake);
    let before = samples.first().map_or(0.0, |(speed, _)| *speed);
    Ok(if before < DRIVEN_M_S {
        Err(format!(
            "{before:.3} m/s before the stop: must be at least {DRIVEN_M_S} m/s"
        ))
    } else if rest > REST_WITHIN_MS {
        Err(format!(
            "rests {rest} ms after the stop: must be at most {REST_WITHIN_MS} ms"
        ))
    } else if !asleep {
        Err("drivers awake although the robot rests".to_owned())
    } else {
        Ok(1)
    })
}

/// Emergency stop on a slope: one case, or the first violated limit.
fn on_a_slope(campaign: &Campaign, seed: u64) -> Result<Result<usize, String>, Error> {
    let samples = speeds(campaign, seed, SLOPE_DEG)?;
    for (ms, (speed, awake)) in samples.iter().enumerate() {
        if ms as u64 >= CREEP_AFTER_MS && *speed > CREEP_M_S {
            return Ok(Err(format!(
                "{speed:.3} m/s {ms} ms after the stop: must be at most {CREEP_M_S} m/s"
            )));
        }
        if *speed > 0.01 && !awake {
            return Ok(Err(format!(
                "drivers asleep at {speed:.3} m/s, {ms} ms after the stop"
            )));
        }
    }
    let last = samples.last().map_or(0.0, |(speed, _)| *speed);
    Ok(match last > CREEP_AT_LEAST_M_S {
        true => Ok(1),
        false => Err(format!(
            "{last:.3} m/s at the end: the slope does not move the robot"
        )),
    })
}

pub fn entries() -> Vec<Entry> {
    const LEVEL: BoardTrial = on_the_level;
    const SLOPE: BoardTrial = on_a_slope;
    entries! {
        "emergency stop on the level: at rest within 0.5 s", "contact", board_trial(LEVEL);
        "emergency stop on a slope of 5°: braked to 0.1 m/s", "contact", board_trial(SLOPE);
    }
}
