//! The plant alone on its drives: real-time factors of 20 s, by the wall clock.
//!
//! With an argument, a table of largest bend and force, and of the error against an explicit
//! reference over this time, s: `cargo run -p plant --release --example drives -- 5`.

use plant::drive::{DRIVES, Drive};
use plant::{PlantConfig, TICK_S};
use std::time::Instant;

const SECONDS: f64 = 20.0;

/// Real-time factor, largest bend (rad) and largest force (N).
fn run(drive: &Drive, config: &PlantConfig) -> [f64; 3] {
    let mut plant = config.build().expect("a valid plant");
    let count = (SECONDS / TICK_S).round() as usize;
    let at = |k: usize| drive.torque(k as f64 * TICK_S);
    let torques: Vec<_> = (0..count).map(at).collect();
    let started = Instant::now();
    torques.iter().for_each(|torque| plant.step(*torque));
    let factor = SECONDS / started.elapsed().as_secs_f64();
    plant.place([0.0; 3]);
    let (mut bend, mut force) = (0.0f64, 0.0f64);
    for torque in torques {
        plant.step(torque);
        bend = bend.max(plant.relative_posture()[2].abs());
        let [x, y] = plant.wrench().force;
        force = force.max(libm::hypot(x, y));
    }
    [factor, bend, force]
}

fn main() {
    let compared = std::env::args().nth(1);
    let compared = compared.map(|text| text.parse().expect("a time in s"));
    if compared.is_some() {
        println!(
            "| drive | largest bend (°) | largest force (N) | error (mm) |\n|---|---|---|---|"
        );
    }
    for drive in DRIVES {
        let config = drive.config(&PlantConfig::default());
        let [factor, bend, force] = run(&drive, &config);
        let Some(seconds) = compared else {
            println!("{}: {factor:.0}", drive.name);
            continue;
        };
        // Loads that move, play and cogging are beyond the reference.
        let error = match config.backlash_rad == [[0.0; 2]; 2] {
            true => {
                let error = drive.error(&config, seconds).expect("a valid plant");
                format!("{:.2}", 1e3 * error[0])
            }
            false => String::new(),
        };
        let bend = bend.to_degrees();
        println!("| {} | {bend:.0} | {force:.0} | {error} |", drive.name);
    }
}
