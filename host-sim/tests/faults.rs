//! The fault campaign and its committed table.

use core_algos::safety::Condition;
use core_algos::topology::{Node, Role};
use host_sim::experiments::faults::campaign;
use host_sim::run::regulate::regulate_on;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::world::faults::{CATALOGUE, Disturbance, Fault};
use rayon::prelude::*;
use std::path::Path;

#[test]
fn no_fault_leads_to_uncontrolled_motion_and_the_table_is_as_committed() {
    let report = campaign(None, 2, &[]).unwrap();
    for row in &report.rows {
        assert!(row.wrong.is_empty(), "{}: {:?}", row.fault, row.wrong);
    }
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/faults.md");
    let committed = std::fs::read_to_string(page).unwrap();
    let found = report.markdown();
    for (committed, found) in committed.lines().zip(found.lines()) {
        assert_eq!(
            committed, found,
            "tools/scripts/regenerate.py faults rewrites the page"
        );
    }
    assert_eq!(committed, found);
}

/// Runs beside those of the catalogue: narrow limits, and what the drivers of an axle report.
const RUNS: &[(&str, Fault)] = &[
    ("robot.lead.limits.bend_rad=0.2", Fault::None),
    ("robot.lead.limits.position_sigma_m=0.01", Fault::None),
    (
        "robot.axle.limits.tracking_m=0.01",
        Fault::Bus(Disturbance::corruption(0.05)),
    ),
    (
        "robot.lead.supervisor.degraded_time_s=1.0",
        Fault::Loss(Role::Beam),
    ),
    (
        "bus.loss=0.0",
        Fault::Reported(0, Condition::TemperatureHigh, 0, 1.0),
    ),
    (
        "bus.loss=0.0",
        Fault::Reported(0, Condition::NotANumber, 20, 1.0),
    ),
    (
        "bus.loss=0.0",
        Fault::Reported(0, Condition::BusOff, 0, 1.0),
    ),
];
/// Codes that no run in this process raises, each with what does.
const ELSEWHERE: &[(Condition, &str)] = &[
    (Condition::InertialLost, "virtual boards: inertial sensor"),
    (
        Condition::ConversionsLost,
        "virtual boards: converter overrun",
    ),
    (
        Condition::ParameterDefault,
        "virtual boards: flipped bits in stored parameters",
    ),
    (
        Condition::SupplyWarning,
        "virtual boards: battery sags to 10.3 V",
    ),
    (Condition::TickLate, "core-algos: node/tick_sync.rs"),
    (Condition::TickOverrun, "core-algos: node/tick_sync.rs"),
    (Condition::ClockStepped, "core-algos: safety/supervisor.rs"),
];

fn raised(change: &str, fault: Fault, tick: u32) -> Vec<Condition> {
    let imu = [
        "sensors.gyro.fitted=true",
        "sensors.accelerometer.fitted=true",
    ];
    let changes: Vec<String> = imu.into_iter().chain([change]).map(str::to_owned).collect();
    let scenario = Scenario::parse(None, "", "test", &changes).unwrap();
    let mut simulation = Simulation::new(&scenario, 1, 0).unwrap();
    simulation.inject(fault, tick);
    regulate_on(&mut simulation, &scenario, |_| {}).unwrap();
    let monitor = simulation.monitor();
    let reasons = monitor.changes().iter().filter_map(|status| status.reason);
    let notices = Node::ALL
        .into_iter()
        .flat_map(|node| monitor.noticed(node).iter());
    reasons.chain(notices).collect()
}

#[test]
fn each_code_is_raised_by_a_fault() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/faults_virtual.md");
    let page = std::fs::read_to_string(page).unwrap();
    let catalogue = CATALOGUE
        .iter()
        .map(|entry| ("bus.loss=0.001", entry.fault));
    let runs: Vec<_> = catalogue.chain(RUNS.iter().copied()).collect();
    let seen = runs.par_iter().flat_map(|&(change, fault)| {
        [1500, 2000, 4000]
            .map(|tick| raised(change, fault, tick))
            .concat()
    });
    let seen: Vec<Condition> = seen.collect();
    let by_none = Condition::ALL.into_iter().filter(|condition| {
        let listed = ELSEWHERE.iter().any(|(other, _)| other == condition);
        !seen.contains(condition) && !page.contains(condition.entry().name) && !listed
    });
    let by_none: Vec<Condition> = by_none.collect();
    assert!(by_none.is_empty(), "raised by no fault: {by_none:?}");
}
