//! Profile, failures of boards and soak on virtual boards.

use crate::program::{Run, assert_refused, cfmmr, json_file};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;

fn posture(folder: &Path, arguments: &str) -> Run {
    cfmmr(folder, &format!("posture --on virtual {arguments}"))
}

/// Folder of a run with a profile.
fn traced() -> &'static Path {
    static RUN: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = RUN.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let files = "--profile";
        let arguments = format!("--stop-after 1.2 --out . {files}");
        let output = posture(folder.path(), &arguments).ends_with(0).out;
        for words in ["front board\n", "with preemption"] {
            assert!(output.contains(words), "{words}: {output}");
        }
        folder
    });
    folder.path()
}

#[test]
fn profile_sums_to_the_load_and_has_the_longest_tick() {
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
        // The tolerance is for the start, when the clock is the internal oscillator, which is slower than 168 MHz.
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
        // Longest tick by the board's own counter, to compare with the profile.
        let board_us = board["longest_tick_us"].as_f64().unwrap();
        let interrupt_us = of("UART4")["longest_with_preemption_us"].as_f64().unwrap();
        // The interrupt includes the health report of 30 to 35 µs, which the board does not count.
        assert!(
            (interrupt_us - board_us).abs() < 45.0,
            "{name}: {interrupt_us} {board_us}"
        );
    }
}

#[test]
fn rear_board_without_power_stops_the_robot() {
    let folder = tempfile::tempdir().unwrap();
    let run = posture(folder.path(), "--kill rear@1.2 --out .").ends_with(1);
    let (error, output) = (run.error, run.out);
    assert!(
        error.contains("the rear board was lost") && output.contains("FrontAxle: Fault, neighbour"),
        "{error}"
    );
    let result = json_file(folder.path(), "result.json");
    let events = result["events"].as_array().unwrap();
    assert_eq!(events[0]["time_s"], 1.2, "{events:?}");
    let off = events[1]["what"]["motors-off"].as_u64().unwrap();
    // Upper limit: detection 50 ms, braking 250 ms, rest 100 ms, release of the frame 750 ms.
    assert!((100..1150).contains(&off), "{off}");
    // Warnings of the boards are also on the terminal, with the board's name.
    let log = fs::read_to_string(folder.path().join("board-front.log")).unwrap();
    let warnings = log
        .lines()
        .filter(|line| line.contains(" WARN ") || line.contains(" ERROR "));
    for warning in warnings {
        assert!(
            error.contains(&format!("front board: {warning}")),
            "{warning}: {error}"
        );
    }
}

#[test]
fn restarted_front_board_drives_after_clearing() {
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
    // One press of the button clears the faults of all nodes.
    assert_eq!(what, ["restarted", "cleared", "resumed"], "{events:?}");
    let log = fs::read_to_string(folder.path().join("board-front.log")).unwrap();
    assert_eq!(log.matches("reset by PowerOn").count(), 2, "{log}");
}

#[test]
fn robot_without_beam_board_drives_on() {
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
fn error_names_value_and_range() {
    let folder = tempfile::tempdir().unwrap();
    let table = "--kill rear@-1 | -1 | 0 to 36000
         --kill left@1 | left@1 | front, rear or beam
         --kill rear@3 --stop-after 2 | 3 s | at 2 s
         --kill rear@91 | 91 s | at 90.5 s
         --kill beam@1 --no-rps | beam@1 | front or rear
         --restart-after 0 | 0 | 0.001 to 36000
         --rows all | --rows | --on in-process";
    assert_refused(folder.path(), "posture --on virtual", table);
    let options = "--profile";
    assert_refused(folder.path(), "posture", options);
    let table = "--laps 3 | --laps | --follow
         --kill front@99 | 99 s | at 90.5 s
         --kill beam@1 --no-rps | beam@1 | front or rear";
    assert_refused(folder.path(), "hil --on virtual", table);
}

/// The soak reaches goals without a missed tick, and its memory grows by less than 400 KiB.
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
