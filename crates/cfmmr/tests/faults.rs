//! Fault campaign and its committed table.

use cfmmr::experiments::faults;
use cfmmr::experiments::faults::scenario;
use core_algos::safety::Condition;
use core_algos::topology::{Role, Topology};
use host_sim::bus::virtual_bus::BusConfig;
use host_sim::run::regulate::regulate_on;
use host_sim::run::robot::Robot;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::world::faults::Fault;
use rayon::prelude::*;
use remote::virtual_robot::faults::{Campaign, End, Entry, FaultCase, RunKind, catalogue, model};
use std::path::Path;

#[test]
fn no_fault_leads_to_uncontrolled_motion_and_the_rows_are_as_committed() {
    let campaign = Campaign {
        scenario: scenario(None, &[]).unwrap(),
        images: None,
        quick: false,
    };
    let all = catalogue(Topology::PAIR);
    let entries: Vec<&Entry> = all.iter().filter(|entry| !entry.needs_images()).collect();
    let report = faults::campaign(&campaign, &entries, 2).unwrap();
    assert_eq!(report.failures_text(), "");
    let page =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/faults.md"))
            .unwrap();
    let unexpected = report.unexpected(&page, false);
    assert_eq!(
        unexpected, None,
        "tools/scripts/regenerate.py faults rewrites the page"
    );
}

/// A run is wrong if the definition of its fault does not allow the actual end, code or time.
#[test]
fn outcomes_beyond_an_entry_are_wrong() {
    let all = catalogue(Topology::PAIR);
    let named = |name| {
        all.iter()
            .find(|entry: &&Entry| entry.name == name)
            .unwrap()
            .clone()
    };
    let mut never_finishes = named("bus doubles 30 %");
    never_finishes.goes_on = false;
    let mut never_stops = named("encoder missing");
    (never_stops.goes_on, never_stops.codes) = (true, vec![]);
    let mut sooner = named("encoder missing");
    sooner.off_within_s = 0.5;
    let mut other = named("encoder missing");
    other.codes = vec![Condition::SupplyLow];
    let short = "mission.time_limit_s=3";
    for (entry, change) in [
        (never_finishes, ""),
        (never_stops, ""),
        (sooner, ""),
        (other, ""),
        (named("bus doubles 30 %"), short),
    ] {
        let changes: Vec<String> = [change]
            .iter()
            .filter(|it| !it.is_empty())
            .map(|it| (*it).to_owned())
            .collect();
        let scenario = Scenario::parse(None, "", "test", &changes).unwrap();
        let case = FaultCase {
            entry: &entry,
            after_ms: 300,
            seed: 1,
        };
        let RunKind::Model(fault) = entry.kind.clone() else {
            panic!("{}", entry.name)
        };
        let mut simulation = Simulation::new(&scenario, 1, 0).unwrap();
        let outcome = model::run_on(&mut simulation, &scenario, &case, fault).unwrap();
        assert!(matches!(outcome.end, End::Wrong(_)), "{outcome:?}");
    }
}

/// Runs in addition to the faults of `cfmmr faults`: narrow limits, and conditions that the drivers of an axle report.
fn runs() -> Vec<(&'static str, Fault)> {
    vec![
        ("robot.lead.limits.bend_rad=0.2", Fault::None),
        ("robot.lead.limits.position_sigma_m=0.01", Fault::None),
        (
            "robot.axle.limits.tracking_m=0.003",
            Fault::Bus(BusConfig {
                corruption: 0.2,
                ..BusConfig::default()
            }),
        ),
        (
            "robot.lead.supervisor.degraded_time_s=1.0",
            Fault::Loss(Role::beam(0)),
        ),
        (
            "bus.loss=0.0",
            Fault::Reported {
                axle: 0,
                condition: Condition::TemperatureHigh,
                ms: 0,
            },
        ),
        (
            "bus.loss=0.0",
            Fault::Reported {
                axle: 0,
                condition: Condition::NotANumber,
                ms: 20,
            },
        ),
        (
            "bus.loss=0.0",
            Fault::Reported {
                axle: 0,
                condition: Condition::BusOff,
                ms: 0,
            },
        ),
    ]
}
/// Codes that no run in this process raises, with the test or fault that raises each.
const ELSEWHERE: &[(Condition, &str)] = &[
    (Condition::InertialLost, "virtual boards: inertial sensor"),
    (
        Condition::CommanderSilent,
        "tests/real_robot.rs: a loose cable",
    ),
    (Condition::GaveUp, "no fault: a goal that is missed"),
    (
        Condition::NoProgress,
        "core-algos: node/lead/tests/drives.rs",
    ),
    (Condition::PathLost, "core-algos: node/lead/tests/drives.rs"),
    (
        Condition::TrackingLost,
        "core-algos: node/axle/watch/tests.rs",
    ),
    (Condition::ReachedUncertain, "no fault: a goal that is far"),
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
    let notices = Topology::PAIR
        .nodes()
        .flat_map(|node| monitor.noticed(node).iter());
    reasons.chain(notices).collect()
}

#[test]
fn each_code_is_raised_by_a_fault() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/faults.md");
    let page = std::fs::read_to_string(page).unwrap();
    let modelled = catalogue(Topology::PAIR)
        .into_iter()
        .filter_map(|entry| match entry.kind {
            RunKind::Model(fault) => Some(("bus.loss=0.001", fault)),
            _ => None,
        });
    let runs: Vec<_> = modelled.chain(runs()).collect();
    let raised_conditions = runs.par_iter().flat_map(|(change, fault)| {
        [1500, 2000, 4000]
            .map(|tick| raised(change, fault.clone(), tick))
            .concat()
    });
    let raised_conditions: Vec<Condition> = raised_conditions.collect();
    let by_none = Condition::ALL.into_iter().filter(|condition| {
        let listed = ELSEWHERE.iter().any(|(other, _)| other == condition);
        !raised_conditions.contains(condition) && !page.contains(condition.entry().name) && !listed
    });
    let by_none: Vec<Condition> = by_none.collect();
    assert!(by_none.is_empty(), "raised by no fault: {by_none:?}");
}
