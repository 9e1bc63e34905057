//! What looks on while virtual boards run, each by a reader of its own.

use crate::program::{Run, assert_refused, cfmmr, json_file};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;

fn posture(folder: &Path, arguments: &str) -> Run {
    cfmmr(folder, &format!("posture --on virtual {arguments}"))
}

/// A run with everything that writes files.
fn traced() -> &'static Path {
    static RUN: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = RUN.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let files = "--profile";
        let arguments = format!("--stop-after 1.2 --out . {files}");
        let said = posture(folder.path(), &arguments).ends_with(0).out;
        for words in ["front board\n", "with preemption"] {
            assert!(said.contains(words), "{words}: {said}");
        }
        folder
    });
    folder.path()
}

#[test]
fn a_profile_adds_up_to_the_load_and_knows_the_longest_tick() {
    let folder = traced();
    let profiles = json_file(folder, "profile.json");
    let result = json_file(folder, "result.json");
    for (profile, board) in profiles
        .as_array()
        .unwrap()
        .iter()
        .zip(result["boards"].as_array().unwrap())
    {
        let name = profile["board"].as_str().unwrap();
        assert_eq!(profile["board"], board["name"]);
        assert_eq!(profile["stack_used"], board["stack_used"]);
        let functions = profile["functions"].as_array().unwrap();
        let us: f64 = functions.iter().map(|f| f["us"].as_f64().unwrap()).sum();
        let awake = board["load"].as_f64().unwrap() * result["simulated_s"].as_f64().unwrap() * 1e6;
        // The start on the internal oscillator counts as fewer cycles.
        assert!((us / awake - 1.0).abs() < 0.07, "{name}: {us} {awake}");
        let folded = fs::read_to_string(folder.join(format!("profile-{name}.folded"))).unwrap();
        let cycles = folded
            .lines()
            .map(|line| line.rsplit_once(' ').unwrap().1.parse::<f64>().unwrap());
        let in_stacks = cycles.sum::<f64>() / 168.0;
        assert!(
            (in_stacks / us - 1.0).abs() < 1e-6,
            "{name}: {in_stacks} {us}"
        );
        if name == "beam" {
            continue;
        }
        let interrupts = profile["interrupts"].as_array().unwrap();
        let of = |handler: &str| interrupts.iter().find(|i| i["name"] == handler).unwrap();
        // What the board measures by its own counter.
        let told = board["longest_tick_us"].as_f64().unwrap();
        let seen = of("UART4")["longest_with_preemption_us"].as_f64().unwrap();
        // The interrupt also holds the report of health, which the board does not count: 30 to 35 µs.
        assert!((seen - told).abs() < 45.0, "{name}: {seen} {told}");
    }
}

#[test]
fn a_rear_board_that_loses_its_power_stops_the_robot() {
    let folder = tempfile::tempdir().unwrap();
    let run = posture(folder.path(), "--kill rear@1.2 --out .").ends_with(1);
    let (said, told) = (run.error, run.out);
    assert!(
        said.contains("the rear board was lost") && told.contains("FrontAxle: Fault, neighbour"),
        "{said}"
    );
    let result = json_file(folder.path(), "result.json");
    let events = result["events"].as_array().unwrap();
    assert_eq!(events[0]["time_s"], 1.2, "{events:?}");
    let off = events[1]["what"]["motors-off"].as_u64().unwrap();
    // 50 ms until it is noticed, 250 to slow down, 100 at rest, 750 to let the frame go.
    assert!((100..1150).contains(&off), "{off}");
    // What the boards warn of is on the terminal too, with the board's name.
    let log = fs::read_to_string(folder.path().join("board-front.log")).unwrap();
    let warnings = log
        .lines()
        .filter(|line| line.contains(" WARN ") || line.contains(" ERROR "));
    for warning in warnings {
        assert!(
            said.contains(&format!("front board: {warning}")),
            "{warning}: {said}"
        );
    }
}

#[test]
fn after_the_restart_of_a_front_board_the_user_drives_again_from_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = "--from=-0.6,0.1,0.2 --kill front@1.2 --restart-after 0.3 --out .";
    posture(folder.path(), arguments).ends_with(0);
    let result = json_file(folder.path(), "result.json");
    assert!(result["e_m"].as_f64().unwrap() < 0.1, "{result}");
    let events = result["events"].as_array().unwrap();
    let what: Vec<_> = events
        .iter()
        .filter_map(|event| event["what"].as_str())
        .collect();
    // One press clears the faults of all nodes.
    assert_eq!(what, ["restarted", "cleared", "resumed"], "{events:?}");
    let log = fs::read_to_string(folder.path().join("board-front.log")).unwrap();
    assert_eq!(log.matches("reset by PowerOn").count(), 2, "{log}");
}

#[test]
fn without_the_beam_board_the_robot_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = "--kill beam@0.2 --restart-after 0.2 --stop-after 0.9 --out .";
    posture(folder.path(), arguments).ends_with(0);
    let result = json_file(folder.path(), "result.json");
    assert_eq!(result["events"].as_array().unwrap().len(), 2);
    assert_eq!(result["boards"][2]["resets"], Value::Array(Vec::new()));
    let log = fs::read_to_string(folder.path().join("board-beam.log")).unwrap();
    assert_eq!(log.matches("reset by PowerOn").count(), 2, "{log}");
}

#[test]
fn bad_input_is_told_with_its_value_and_range() {
    let folder = tempfile::tempdir().unwrap();
    let table = "--kill rear@-1 | -1 | 0 to 36000
         --kill left@1 | left@1 | front, rear or beam
         --kill rear@3 --stop-after 2 | 3 s | at 2 s
         --kill rear@91 | 91 s | at 90.5 s
         --kill beam@1 --no-rps | beam@1 | front or rear
         --restart-after 0 | 0 | 0.001 to 36000
         --rows all | --rows | in process";
    assert_refused(folder.path(), "posture --on virtual", table);
    let options = "--profile";
    assert_refused(folder.path(), "posture", options);
    let table = "--laps 3 | --laps | --follow
         --kill front@99 | 99 s | at 90.5 s
         --kill beam@1 --no-rps | beam@1 | front or rear";
    assert_refused(folder.path(), "hil --on virtual", table);
}

/// Goals one after the other, with the figures of the boards; memory does not grow with the frames of the bus.
#[test]
fn soak_on_virtual_boards_reaches_goals_in_bounded_memory() {
    let folder = tempfile::tempdir().unwrap();
    let report = cfmmr(folder.path(), "soak --on virtual --ticks 20000 --json -").json();
    let sum = |key: &str| {
        let windows = report["windows"].as_array().unwrap().iter();
        windows
            .map(|window| window[key].as_u64().unwrap())
            .sum::<u64>()
    };
    assert!(sum("reached") >= 1 && sum("missed") == 0, "{report}");
    let memory = |window: usize| report["windows"][window]["resident_kib"].as_u64().unwrap();
    assert!(memory(9) < memory(0) + 400, "{report}");
    for board in report["boards"].as_array().unwrap() {
        assert_eq!(board["missed_ticks"], 0, "{board}");
        assert!(board["longest_tick_us"].as_u64().unwrap() <= 800, "{board}");
    }
}
