//! Speed of the whole closed loop on one core: plant, sensors, the nodes of all three boards at
//! their full rate, and the bus.

use crate::base::error::Error;
use crate::base::numbers::whole;
use crate::base::stopwatch::{self, Speed};
use crate::base::table::Table;
use crate::experiments::arguments::WorldChoice;
use crate::experiments::result::{JsonArgs, Provenance};
use crate::recording::{About, Session, csv};
use crate::run::regulate::{regulate, regulate_on};
use crate::run::robot::Record;
use crate::run::simulation::Simulation;
use crate::scenario::Scenario;
use crate::targets;
use clap::Args;
use serde::Serialize;

/// Arguments of `loop-bench`.
#[derive(Clone, Debug, Args)]
pub struct LoopBenchArgs {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Number of runs; the result is the median
    #[arg(long, default_value_t = 7, value_parser = whole::<u32>(1..=1000))]
    pub repeats: u32,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
}

/// Result of the bench.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// World of the runs.
    pub world: String,
    /// As in [`stopwatch::clock`].
    pub clock: &'static str,
    /// Without a log, with a table of the epochs, and with everything the boards got and did.
    pub loops: Vec<Measured>,
}

/// One way of running the loop.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Name.
    pub name: &'static str,
    /// Simulated time over time taken.
    #[serde(flatten)]
    pub speed: Speed,
    /// Simulated time of one run, s.
    pub simulated_s: f64,
    /// Bytes of the log.
    pub log_bytes: usize,
}

/// Runs the scenario's first trial `repeats` times each way.
pub fn measure(scenario: &Scenario, seed: u64, repeats: usize) -> Result<Report, Error> {
    // The same trial takes the same simulated time in every run.
    let mut epochs: u64 = 0;
    regulate(scenario, seed, 0, |_| epochs += 1)?;
    let simulated_s = epochs as f64 * core_algos::time::EPOCH as f64 * 1e-6;
    let (mut failed, mut log_bytes, mut recorded_bytes) = (None, 0, 0);
    let plain = Speed::measure(repeats, simulated_s, || {
        failed = regulate(scenario, seed, 0, |_| ()).err();
    });
    let logged = Speed::measure(repeats, simulated_s, || {
        let mut records: Vec<Record> = Vec::new();
        failed = regulate(scenario, seed, 0, |record| records.push(*record)).err();
        log_bytes = csv::of_records(&records).into_bytes().len();
    });
    let recorded = Speed::measure(repeats, simulated_s, || {
        let about = About {
            command: "loop-bench",
            seed,
            trial: 0,
            scenario,
        };
        let run = || {
            let session = Session::counted(&about)?;
            let targets = session.tap(targets::in_process(), scenario);
            let mut simulation = Simulation::on(targets, scenario, seed, 0)?;
            simulation.observe(Box::new(session.clone()));
            regulate_on(&mut simulation, scenario, |_| ())?;
            session.count()
        };
        match run() {
            Ok(bytes) => recorded_bytes = bytes as usize,
            Err(error) => failed = Some(error),
        }
    });
    if let Some(error) = failed {
        return Err(error);
    }
    let of = |name, speed, log_bytes| Measured {
        name,
        speed,
        simulated_s,
        log_bytes,
    };
    Ok(Report {
        world: scenario.world.label(),
        clock: stopwatch::clock(),
        loops: vec![
            of("plain", plain, 0),
            of("logged", logged, log_bytes),
            of("recorded", recorded, recorded_bytes),
        ],
    })
}

/// `cfmmr loop-bench`.
pub fn run(args: &LoopBenchArgs) -> Result<(), Error> {
    args.json.check()?;
    let scenario = Scenario::in_world(args.choice.world.as_deref())?;
    let report = measure(&scenario, 1, args.repeats as usize)?;
    let mut table = Table::new([
        "closed loop",
        "real-time factor",
        "slowest",
        "fastest",
        "by the clock",
        "simulated (s)",
        "log (kB)",
    ]);
    for row in &report.loops {
        table.row([
            row.name.to_owned(),
            format!("{:.0}", row.speed.real_time_factor),
            format!("{:.0}", row.speed.slowest),
            format!("{:.0}", row.speed.fastest),
            format!("{:.0}", row.speed.wall_real_time_factor),
            format!("{:.1}", row.simulated_s),
            format!("{:.0}", row.log_bytes as f64 * 1e-3),
        ]);
    }
    args.json.write(&Provenance::of(&scenario, 1), &report)?;
    args.json.print(&format!(
        "Plant, sensors, three boards and bus at 1 kHz, world {}, median of {} runs ({} time of the loop's \
         thread)\n\n{table}\n\
         logged: CSV of the epochs. recorded: inputs and outputs of the boards as MCAP, written by a second\n\
         thread.\n",
        report.world, args.repeats, report.clock
    ))
}
