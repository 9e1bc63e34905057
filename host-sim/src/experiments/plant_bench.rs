//! Speed of the plant alone, on one core, and its accuracy against the explicit reference.

use crate::base::error::Error;
use crate::base::numbers::{number, whole};
use crate::base::stopwatch::{self, Speed};
use crate::base::table::Table;
use crate::experiments::result::{JsonArgs, Provenance};
use crate::plant::reference::Reference;
use crate::plant::{Health, Plant, PlantConfig, PlantError, Tyre};
use clap::Args;
use serde::Serialize;

/// Arguments of `plant-bench`.
#[derive(Clone, Debug, Args)]
pub struct PlantBenchArgs {
    /// Simulated time of one run, s
    #[arg(long, default_value_t = 20.0, value_name = "S", value_parser = number)]
    pub duration: f64,
    /// Number of runs of each drive; the result is the median
    #[arg(long, default_value_t = 7, value_parser = whole::<u32>(1..=1000))]
    pub repeats: u32,
    /// Compare with an explicit reference at 20 µs over this time, s; about real time
    #[arg(long, default_value_t = 0.0, value_name = "S", value_parser = number)]
    pub accuracy: f64,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
}

/// Options of the measurement.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Simulated time of one run, s.
    pub seconds: f64,
    /// Runs of each drive; the median is reported.
    pub repeats: usize,
    /// Simulated time over which to compare with the reference, s; 0 for no comparison. It runs
    /// at about real time.
    pub accuracy_seconds: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seconds: 20.0,
            repeats: 15,
            accuracy_seconds: 0.0,
        }
    }
}

/// Result of the bench.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Clock of the real-time factors: `"cpu"`, the time of the thread, or `"wall"` if the system
    /// has no such clock.
    pub clock: &'static str,
    /// Each drive.
    pub drives: Vec<Measured>,
}

/// One drive.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Name of the drive.
    pub name: &'static str,
    /// Simulated time over time taken.
    #[serde(flatten)]
    pub speed: Speed,
    /// Step, s.
    pub step_s: f64,
    /// Largest relative heading of the axles, rad.
    pub largest_heading_rad: f64,
    /// Largest force of the frame, N.
    pub largest_force_n: f64,
    /// Counters of one run.
    pub health: Health,
    /// Largest distance between an axle of the plant and of the reference, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_error_m: Option<f64>,
    /// Largest difference of their headings, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heading_error_rad: Option<f64>,
}

/// An open-loop drive: a plant and wheel torques over time.
#[derive(Clone, Copy, Debug)]
pub struct Drive {
    /// Name.
    pub name: &'static str,
    /// Changes of the robot.
    pub robot: fn(&mut PlantConfig),
    /// Amplitude (N m) and rate (rad/s) of the torque common to all wheels.
    pub base: [f64; 2],
    /// Amplitude and rate of the torque that turns the axles against each other.
    pub steer: [f64; 2],
}

/// Speeds to 0.9 m/s with the frame bent to 50°: beyond what the controllers ask for.
pub const NORMAL: Drive = Drive {
    name: "normal",
    robot: |c| (c.tyre, c.creep_velocity_m_s) = (Tyre::Creep, 0.01),
    base: [0.15, 1.3],
    steer: [0.4, 0.9],
};

/// Wheels spinning on stiff tyres, the frame bent to 130° and pulled taut with hundreds of newtons.
pub const HARSH: Drive = Drive {
    name: "harsh",
    robot: |c| (c.tyre, c.creep_velocity_m_s) = (Tyre::Creep, 0.003),
    base: [1.2, 2.0],
    steer: [1.0, 3.1],
};

/// The normal drive on brush tyres.
pub const NORMAL_BRUSH: Drive = Drive {
    name: "normal, brush tyre",
    robot: |c| c.tyre = Tyre::Brush,
    ..NORMAL
};

/// The harsh drive on brush tyres.
pub const HARSH_BRUSH: Drive = Drive {
    name: "harsh, brush tyre",
    robot: |c| c.tyre = Tyre::Brush,
    ..HARSH
};

/// The normal drive with everything that the plant has.
pub const NORMAL_IMPERFECT: Drive = Drive {
    name: "normal, every imperfection",
    robot: |c| {
        *c = PlantConfig {
            tyre: Tyre::Brush,
            friction: 0.6,
            slip_stiffness: [[15.0, 20.0], [26.0, 18.0]],
            static_excess: 0.2,
            rolling_resistance: 0.03,
            side_slip: [0.002, -0.002],
            carpet_drift: [0.005, -0.005],
            radius_load_sensitivity: 1e-3,
            payload_kg: [0.5, 0.3],
            payload_position_m: [[0.02, 0.05], [-0.03, 0.02]],
            center_of_mass_height_m: 0.08,
            backlash_rad: [[5e-3; 2]; 2],
            cogging_torque_n_m: 0.01,
            rigid_root_m: 5e-3,
            rigid_tip_m: 5e-3,
            clamp_angle_root_rad: 0.01,
            clamp_angle_tip_rad: -0.01,
            ..c.clone()
        }
    },
    ..NORMAL
};

impl Drive {
    /// The robot that this drive is for: the configured one with the drive's changes.
    pub fn config(&self, config: &PlantConfig) -> PlantConfig {
        let mut config = config.clone();
        (self.robot)(&mut config);
        config
    }

    /// Wheel torques at time `t`, N m.
    pub fn torque(&self, t: f64) -> [[f64; 2]; 2] {
        let wave = |[amplitude, rate]: [f64; 2]| amplitude * libm::sin(rate * t);
        let (base, steer) = (wave(self.base), wave(self.steer));
        [[base - steer, base + steer], [base + steer, base - steer]]
    }
}

fn steps(plant: &Plant, seconds: f64) -> usize {
    (seconds / plant.step_s()).round().max(1.0) as usize
}

fn measure(drive: &Drive, config: &PlantConfig, options: &Options) -> Result<Measured, PlantError> {
    let config = drive.config(config);
    let mut plant = config.build()?;
    let count = steps(&plant, options.seconds);
    // Torques are made beforehand: only the plant is timed.
    let torques: Vec<_> = (0..count)
        .map(|k| drive.torque(k as f64 * plant.step_s()))
        .collect();
    let (mut heading, mut force) = (0.0f64, 0.0f64);
    plant.place([0.0; 3]);
    for torque in &torques {
        plant.step(*torque);
        heading = heading.max(plant.relative_posture()[2].abs());
        let [fx, fy] = plant.wrench().force;
        force = force.max(fx.hypot(fy));
    }
    let simulated = count as f64 * plant.step_s();
    let speed = Speed::measure(options.repeats, simulated, || {
        plant.place([0.0; 3]);
        for torque in &torques {
            plant.step(*torque);
        }
    });
    // Loads that move, play and cogging are beyond the reference.
    let comparable = drive.name != NORMAL_IMPERFECT.name;
    let error = (comparable && options.accuracy_seconds > 0.0)
        .then(|| compare(drive, &config, options.accuracy_seconds))
        .transpose()?;
    Ok(Measured {
        name: drive.name,
        speed,
        step_s: plant.step_s(),
        largest_heading_rad: heading,
        largest_force_n: force,
        health: plant.health(),
        position_error_m: error.map(|e| e[0]),
        heading_error_rad: error.map(|e| e[1]),
    })
}

/// Largest difference in position (m) and heading (rad) of an axle between the plant and a
/// reference at 20 µs (8 µs with the brush tyre, stiffer at rest) over a drive. NaN if the reference lost the frame's equilibrium.
pub fn compare(drive: &Drive, config: &PlantConfig, seconds: f64) -> Result<[f64; 2], PlantError> {
    let mut plant = config.build()?;
    let step = plant.step_s();
    let mut reference = Reference::new(config, plant.state().axle.map(|a| a.posture));
    let finest = match config.tyre {
        Tyre::Creep => 20e-6,
        Tyre::Brush => 8e-6,
    };
    let fine = (step / finest).ceil() as usize;
    let mut worst = [0.0f64; 2];
    for k in 0..steps(&plant, seconds) {
        let torque = drive.torque(k as f64 * step);
        plant.step(torque);
        reference.advance(step, fine, torque);
        for (axle, q) in plant.state().axle.iter().zip(reference.postures()) {
            let p = axle.posture;
            worst[0] = worst[0].max((p[0] - q[0]).hypot(p[1] - q[1]));
            worst[1] = worst[1].max((p[2] - q[2]).abs());
        }
    }
    Ok(if reference.lost { [f64::NAN; 2] } else { worst })
}

/// Runs all drives.
pub fn run(config: &PlantConfig, options: &Options) -> Result<Report, PlantError> {
    let drives = [NORMAL, HARSH, NORMAL_BRUSH, HARSH_BRUSH, NORMAL_IMPERFECT]
        .iter()
        .map(|drive| measure(drive, config, options))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Report {
        clock: stopwatch::clock(),
        drives,
    })
}
/// `cfmmr plant-bench`.
pub fn command(args: &PlantBenchArgs) -> Result<(), Error> {
    for (name, seconds, low) in [
        ("--duration", args.duration, 0.1),
        ("--accuracy", args.accuracy, 0.0),
    ] {
        if !(seconds >= low && seconds <= 3600.0) {
            return Err(Error::input(format!(
                "{name} {seconds}: must be a number from {low} to 3600"
            )));
        }
    }
    let options = Options {
        seconds: args.duration,
        repeats: args.repeats as usize,
        accuracy_seconds: args.accuracy,
    };
    args.json.check()?;
    let report = run(&PlantConfig::default(), &options)
        .map_err(|error| Error::input(format!("plant.{error}")))?;
    let mut table = Table::new([
        "drive",
        "real-time factor",
        "slowest",
        "fastest",
        "largest bend (°)",
        "largest force (N)",
        "error (mm)",
    ]);
    for drive in &report.drives {
        table.row([
            drive.name.to_owned(),
            format!("{:.0}", drive.speed.real_time_factor),
            format!("{:.0}", drive.speed.slowest),
            format!("{:.0}", drive.speed.fastest),
            format!("{:.0}", drive.largest_heading_rad.to_degrees()),
            format!("{:.1}", drive.largest_force_n),
            drive
                .position_error_m
                .map_or(String::new(), |error| format!("{:.3}", 1e3 * error)),
        ]);
    }
    args.json.write(&Provenance::default(), &report)?;
    args.json.print(&format!(
        "Plant alone, one core, 1 ms steps, median of {} runs of {} s ({} time)\n\n{table}",
        args.repeats, args.duration, report.clock
    ))
}
