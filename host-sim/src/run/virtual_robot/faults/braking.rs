//! Emergency stops on the level and on a slope: braking distance, and what happens until the robot stands.

use super::Campaign;
use super::bench::Bench;
use super::entry::{Alone, Entry, entries};
use crate::base::error::Error;
use crate::run::robot::Robot;
use crate::run::virtual_robot::Options;
use core_algos::topology::Role;

/// Time that the robot drives before the contact opens, ms.
const DRIVE_MS: u64 = 1_600;
/// Time for which a chock stays after the press of the button, ms.
const CHOCK_MS: u64 = 150;
/// Time for which it is watched afterwards, ms.
const WATCH_MS: u64 = 3_000;
/// Least speed before the stop, m/s.
const DRIVEN_M_S: f64 = 0.1;
/// Speed of a robot that rests, m/s: it goes on for 2 mm.
const REST_M_S: f64 = 1e-2;
/// Longest time to rest on the level, ms.
const REST_WITHIN_MS: u64 = 500;
/// Speed of a braked robot on a slope, m/s, at most, and the time after which it has that, ms.
const CREEP_M_S: f64 = 0.1;
const CREEP_AFTER_MS: u64 = 500;
/// The slope, °.
const SLOPE_DEG: f64 = 5.0;

/// Speed of the robot, m/s, and whether the drivers of both axles are awake, each millisecond after the stop.
fn speeds(campaign: &Campaign, seed: u64, slope_deg: f64) -> Result<Vec<(f64, bool)>, Error> {
    let mut campaign = Campaign {
        scenario: campaign.scenario.clone(),
        images: campaign.images.clone(),
        quick: campaign.quick,
    };
    let world = &mut campaign.scenario.world;
    world.plant.slope_rad = slope_deg.to_radians();
    // With a chock at one wheel the robot creeps, so that no biases are found.
    (
        world.sensors.gyro.fitted,
        world.sensors.accelerometer.fitted,
    ) = (false, false);
    let mut bench = Bench::new(&campaign, Options::default(), seed)?;
    // A chock holds the robot until its motors do: asleep, the drivers would let it roll.
    bench.robot.blocked = Some((0, 0));
    bench.robot.boot(&Options::default())?;
    bench.press();
    bench.pass(CHOCK_MS);
    bench.robot.blocked = None;
    bench.pass(DRIVE_MS);
    for role in [Role::Front, Role::Rear] {
        bench.axle(role, |axle, now| axle.stop(true, now));
    }
    let [front, _] = bench.robot.plant.state().axle;
    if front.velocity[0] < DRIVEN_M_S {
        return Err(Error::Failure(format!(
            "the robot drives at {:.3} m/s before the stop: {:?}",
            front.velocity[0],
            bench.robot.monitor().changes()
        )));
    }
    let mut seen = Vec::new();
    for _ in 0..WATCH_MS {
        bench.pass(1);
        let [front, rear] = bench.robot.plant.state().axle;
        let speed = 0.5 * (front.velocity[0] + rear.velocity[0]).abs();
        let mut awake = true;
        for role in [Role::Front, Role::Rear] {
            bench.axle(role, |axle, _| awake &= axle.is_awake());
        }
        seen.push((speed, awake));
    }
    Ok(seen)
}

/// First violation of a limit, in words.
fn on_the_level(campaign: &Campaign, seed: u64) -> Result<Result<usize, String>, Error> {
    let seen = speeds(campaign, seed, 0.0)?;
    let rest = seen.iter().rposition(|(speed, _)| *speed > REST_M_S);
    let rest = rest.map_or(0, |last| last as u64 + 1);
    let asleep = seen.last().is_some_and(|(_, awake)| !awake);
    Ok(if rest > REST_WITHIN_MS {
        Err(format!(
            "rests {rest} ms after the stop: must be at most {REST_WITHIN_MS} ms"
        ))
    } else if !asleep {
        Err("drivers awake although the robot rests".to_owned())
    } else {
        Ok(1)
    })
}

/// First violation of a limit, in words.
fn on_a_slope(campaign: &Campaign, seed: u64) -> Result<Result<usize, String>, Error> {
    let seen = speeds(campaign, seed, SLOPE_DEG)?;
    for (ms, (speed, awake)) in seen.iter().enumerate() {
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
    Ok(Ok(1))
}

pub fn entries() -> Vec<Entry> {
    const LEVEL: Alone = on_the_level;
    const SLOPE: Alone = on_a_slope;
    entries! {
        "emergency stop on the level: at rest within 0.5 s", "contact", alone(LEVEL);
        "emergency stop on a slope of 5°: braked to 0.1 m/s", "contact", alone(SLOPE);
    }
}
