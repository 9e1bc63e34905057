//! Runs of the whole robot in this process, 10 s each, with random faults of bus, sensors, drivers and boards, and with
//! random commands. `checks` contains the invariants checked at every tick.
//!
//! The environment variables `RANDOM_FAULT_RUNS` (number of runs) and `RANDOM_FAULT_SEED` (first seed) allow longer
//! checks.

mod board;
mod checks;
mod plan;

use board::{CheckedBoard, Findings};
use core_algos::topology::Role;
use host_sim::run::robot::Robot as _;
use host_sim::run::simulation::Simulation;
use host_sim::targets::Target;
use plan::{Plan, RUN_MS};
use std::sync::{Arc, Mutex};

/// Default number of runs.
const RUNS: u64 = 30;
/// Limit of the wheel speed at which an axle may arm, rad/s.
const ARMING_RAD_S: f64 = 5.0;
/// Limit of the axle speed at which the robot may begin to drive, m/s.
const BEGIN_M_S: f64 = 0.05;

fn from_environment(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// Totals and maxima over all runs.
#[derive(Debug, Default)]
struct Figures {
    /// Time with motors on, summed over the axles, ms.
    driven_ms: u64,
    /// Largest wheel speed of an axle while arming, rad/s.
    armed_rad_s: f64,
    /// Largest axle speed when the robot began to drive, m/s.
    began_m_s: f64,
    /// Number of orders that the lead node refused.
    refused: u32,
}

/// Runs the plan of a seed; an error is the violated invariant.
fn run(seed: u64, figures: &mut Figures) -> Result<(), String> {
    let plan = Arc::new(Plan::draw(seed));
    let findings = Arc::new(Mutex::new(Findings::default()));
    let targets = Role::PAIR
        .map(|role| Box::new(CheckedBoard::new(role, &plan, seed, &findings)) as Box<dyn Target>);
    let mut simulation = Simulation::on(targets.into(), &plan.scenario(), seed, 0).unwrap();
    if let Some((fault, at)) = plan.injected.clone() {
        simulation.inject(fault, at);
    }
    let mut commands = plan.commands.iter().peekable();
    for tick in 0..RUN_MS {
        while let Some((_, command)) = commands.next_if(|(at, _)| *at <= tick) {
            simulation.command(command).unwrap();
        }
        let axles = simulation.plant().axles().to_vec();
        simulation.step().map_err(|error| error.to_string())?;
        let mut findings = findings.lock().unwrap();
        for (i, axle) in axles.iter().enumerate() {
            if std::mem::take(&mut findings.armed[i]) {
                let fastest = axle.wheel_speed[0].abs().max(axle.wheel_speed[1].abs());
                figures.armed_rad_s = figures.armed_rad_s.max(fastest);
                if fastest > ARMING_RAD_S {
                    let what = format!("no axle arms while its wheels turn: {fastest:.2} rad/s");
                    findings.violation.get_or_insert((tick, what));
                }
            }
        }
        if std::mem::take(&mut findings.began) {
            let [front, rear] = [0, 1].map(|i| axles[i].velocity[0].abs());
            let fastest = front.max(rear);
            figures.began_m_s = figures.began_m_s.max(fastest);
            if fastest > BEGIN_M_S {
                let what = format!("no drive begins while the robot moves: {fastest:.3} m/s");
                findings.violation.get_or_insert((tick, what));
            }
        }
        if let Some((tick, violation)) = &findings.violation {
            return Err(format!("seed {seed}, t = {tick} ms: {violation}"));
        }
    }
    let findings = findings.lock().unwrap();
    figures.driven_ms += u64::from(findings.driven);
    figures.refused += findings.refused;
    Ok(())
}

#[test]
fn robot_under_random_faults_keeps_every_invariant() {
    let first = from_environment("RANDOM_FAULT_SEED", 1);
    let runs = from_environment("RANDOM_FAULT_RUNS", RUNS);
    let (mut violations, mut figures) = (Vec::new(), Figures::default());
    for seed in first..first + runs {
        if let Err(violation) = run(seed, &mut figures) {
            println!("{violation}");
            violations.push(violation);
        }
    }
    println!("{runs} runs: {figures:?}");
    assert!(
        violations.is_empty(),
        "{} of {runs}: {}",
        violations.len(),
        violations[0]
    );
    assert!(figures.driven_ms > 1000 * runs, "the robot drives");
}
