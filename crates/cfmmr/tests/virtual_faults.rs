//! Some faults of virtual boards, and the verdict on their outcomes.

use crate::program::assert_refused;
use core_algos::topology::Topology;
use host_sim::scenario::Scenario;
use remote::images::Images;
use remote::virtual_robot::faults::{
    Campaign, End, Entry, FaultCase, Outcome, SharedRobots, catalogue, reference, run,
};
use std::collections::HashSet;

const AFTER_MS: u64 = 400;
const SEED: u64 = 1;

fn outcomes(entries: &[Entry]) -> Vec<Outcome> {
    let campaign = Campaign {
        scenario: Scenario::default(),
        images: Some(Images::open(None, None).unwrap()),
        quick: true,
    };
    let reference = reference(&campaign, SEED, AFTER_MS).unwrap();
    let case = |entry| FaultCase {
        entry,
        after_ms: AFTER_MS,
        seed: SEED,
    };
    let cases: Vec<FaultCase> = entries.iter().map(case).collect();
    let robots = SharedRobots::of(&cases);
    let run = |case| run(&campaign, case, &reference, &robots).unwrap();
    cases.iter().map(run).collect()
}

fn named(name: &str) -> Entry {
    let mut entries = catalogue(Topology::PAIR).into_iter();
    entries.find(|entry| entry.name == name).unwrap()
}

#[test]
fn catalogue_has_each_fault_once() {
    for axles in [2, 3] {
        let catalogue = catalogue(Topology::new(axles).unwrap());
        let different: HashSet<&String> = catalogue.iter().map(|entry| &entry.name).collect();
        assert!(catalogue.len() >= 40 && different.len() == catalogue.len());
        assert!(different.iter().all(|name| !name.contains('{')));
    }
}

/// A processor fault in the motor current loop stops the robot; a driver fault too short for the firmware to detect
/// does not.
#[test]
fn faults_end_as_the_catalogue_allows() {
    let names = ["HardFault in the current loop", "nFAULT low for 30 µs"];
    let ends = outcomes(&names.map(named)).into_iter().map(|run| run.end);
    assert!(ends.eq([End::Stopped, End::WentOn]));
}

/// A run is wrong if the definition of its fault does not allow the end, code, time or finding.
#[test]
fn outcomes_beyond_an_entry_are_wrong() {
    let mut stops = named("none");
    stops.goes_on = false;
    let mut never_stops = named("nFAULT low for 20 ms");
    (never_stops.goes_on, never_stops.codes) = (true, vec![]);
    let mut sooner = named("nFAULT low for 20 ms");
    sooner.off_within_s = 0.01;
    let mut silent = named("HardFault of the beam's board");
    silent.findings = &[];
    let mut other = named("nFAULT low for 20 ms");
    other.codes = vec![core_algos::safety::Condition::SupplyLow];
    for outcome in outcomes(&[stops, never_stops, sooner, silent, other]) {
        assert!(matches!(outcome.end, End::Wrong(_)), "{outcome:?}");
    }
}

#[test]
fn fault_outside_the_catalogue_is_refused() {
    let table = "
        --only earthquake
        --only crystal
        --quick --seeds 2
        --threads 0
        --on serial:front=/dev/null
        --axle-image x";
    let folder = tempfile::tempdir().unwrap();
    assert_refused(folder.path(), "faults", table);
}
