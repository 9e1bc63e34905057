//! Runs the plant alone on its drives over 20 s and prints the real-time factor of each drive.
//!
//! With a time T (s) as argument, prints a table instead: largest bend and largest force over 20 s, and error against
//! the explicit reference over T: `cargo run -p plant --release --example drives -- 5`. A second argument is the number
//! of axles, by default 2.

use plant::drive::{DRIVES, Drive};
use plant::{PlantConfig, TICK_S};
use std::time::Instant;

const SECONDS: f64 = 20.0;

/// Real-time factor, largest bend (rad) and largest force (N) of a frame.
fn run(drive: &Drive, config: &PlantConfig, axles: usize) -> [f64; 3] {
    let mut plant = config.build(axles).expect("a valid plant");
    let count = (SECONDS / TICK_S).round() as usize;
    let at = |k: usize| drive.torque(k as f64 * TICK_S, axles);
    let torques: Vec<_> = (0..count).map(at).collect();
    let started = Instant::now();
    torques.iter().for_each(|torque| plant.step(torque));
    let factor = SECONDS / started.elapsed().as_secs_f64();
    plant.place([0.0; 3]);
    let (mut bend, mut force) = (0.0f64, 0.0f64);
    for torque in torques {
        plant.step(&torque);
        for frame in 0..plant.frame_count() {
            bend = bend.max(plant.relative_posture(frame)[2].abs());
            let [x, y] = plant.wrench(frame).force;
            force = force.max(libm::hypot(x, y));
        }
    }
    [factor, bend, force]
}

fn main() {
    let argument = |n: usize| std::env::args().nth(n);
    let compared = argument(1).map(|text| text.parse().expect("a time in s"));
    let axles = argument(2).map_or(2, |text| text.parse().expect("a number of axles"));
    if compared.is_some() {
        println!(
            "| drive | largest bend (°) | largest force (N) | error (mm) |\n|---|---|---|---|"
        );
    }
    for drive in DRIVES {
        let config = drive.config(&PlantConfig::default());
        // The drive with imperfections has constants for two axles only.
        if config.for_axles(axles).is_err() {
            continue;
        }
        let [factor, bend, force] = run(&drive, &config, axles);
        let Some(seconds) = compared else {
            println!("{}: {factor:.0}", drive.name);
            continue;
        };
        // No error for a drive with backlash: the reference has no load transfer, backlash or cogging.
        let error = match config
            .backlash_rad
            .entries()
            .iter()
            .all(|both| *both == [0.0; 2])
        {
            true => {
                let error = drive.error(&config, axles, seconds).expect("a valid plant");
                format!("{:.2}", 1e3 * error[0])
            }
            false => String::new(),
        };
        let bend = bend.to_degrees();
        println!("| {} | {bend:.0} | {force:.0} | {error} |", drive.name);
    }
}
