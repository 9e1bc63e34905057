//! Calibration of the simulated robot finds its true constants.

use crate::program::{command, json_file, succeed};
use crate::terminal::pseudo_terminal;
use cfmmr::experiments::calibrate::CalibrationBench;
use core_algos::params::find;
use core_algos::topology::{Role, Topology};
use host_sim::scenario::Scenario;
use host_sim::targets::Target;
use remote::Remote;
use remote::board_log::BoardLog;
use remote::images::Images;
use remote::virtual_link::VirtualLink;
use serde_json::Value;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::Path;
use std::process::Stdio;

/// JSON report of `calibrate WHAT`; the seed draws the robot.
fn calibrate(directory: &Path, what: &str, seed: u32, more: &str) -> Value {
    let arguments = format!("calibrate {what} --seed {seed} --json report.json {more}");
    succeed(directory, &arguments);
    json_file(directory, "report.json")
}

/// True errors before and after the calibration, of each parameter whose name contains `name`.
fn errors(report: &Value, name: &str) -> Vec<[f64; 2]> {
    let rows = report["parameters"].as_array().unwrap().iter();
    let named = rows.filter(|row| row["name"].as_str().unwrap().contains(name));
    let found: Vec<_> = named
        .map(|row| {
            let number = |key: &str| row[key].as_f64().unwrap();
            ["before", "after"].map(|key| number(key) - number("truth"))
        })
        .collect();
    assert!(!found.is_empty(), "{name}");
    found
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.map(|value| value * value).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

/// Checks that every remaining error of three robots is below five times the given standard deviation.
fn assert_found(what: &str, bounds: &[(&str, f64)], more: &str) {
    let folder = tempfile::tempdir().unwrap();
    let reports: Vec<Value> = [1, 2, 4]
        .into_iter()
        .map(|seed| calibrate(folder.path(), what, seed, more))
        .collect();
    for (name, sigma) in bounds {
        let all: Vec<[f64; 2]> = reports.iter().flat_map(|r| errors(r, name)).collect();
        let before = rms(all.iter().map(|pair| pair[0]));
        let after = rms(all.iter().map(|pair| pair[1]));
        println!("{name}: {before:.3e} before, {after:.3e} after, {sigma:.1e} expected");
        assert!(
            all.iter().all(|pair| pair[1].abs() < 5.0 * sigma),
            "{name}: {all:?}"
        );
        assert!(after < 0.5 * before, "{name}: {before} {after}");
    }
}

/// Formers have an error of 0.1 %: four formers of ±1 and ±2 per metre leave 0.07 % common to all gains. The zeros have
/// errors of 1 µε from the edge and 0.4 µε from the formers; 1 µε is two counts.
#[test]
fn gauge_calibration_is_limited_by_edge_and_formers() {
    let bounds = [("zero_counts", 2.2), ("gain", 7e-4)];
    assert_found("gauges", &bounds, "");
}

/// Two turns of 18.85 rad, each stopped at a mark with 2 mrad, leave a gain error of 0.75e-4. The bias walks by 0.5e-4
/// rad/s/√s, in the 18 s of a turn by an integrated angle of 3.8e-3 rad, less the part that the rests measure.
#[test]
fn gyro_calibration_is_limited_by_marks_and_bias_walk() {
    assert_found("imu", &[("gyro_gain", 1.5e-4)], "");
}

/// Two straight lines of 4 m with ends measured to 1 mm determine the radius to 1.8e-4. The remaining error of the
/// ratio is mostly creep that differs between squares. With one square per direction, the track is uncertain by several
/// thousandths, so it has no bound here.
#[test]
fn wheel_calibration_finds_radius_and_ratio() {
    let bounds = [("wheel_radius_m", 1.3e-5), ("wheel_ratio", 1e-4)];
    // In world ideal, because drift on carpet could not be distinguished from larger wheels.
    let more = "--laps 1 --world ideal";
    assert_found("wheels", &bounds, more);
    let folder = tempfile::tempdir().unwrap();
    let report = calibrate(folder.path(), "wheels", 1, more);
    for effect in report["effects"].as_array().unwrap() {
        if effect["what"].as_str().unwrap().ends_with("less creep") {
            let number = |key: &str| effect[key].as_f64().unwrap();
            assert!(number("after") < 0.2 * number("before"), "{effect}");
        }
    }
}

/// A calibration drive on virtual boards is bit-identical to the in-process drive, before and after a changed wheel
/// ratio. `params.rs` tests saving.
#[test]
fn calibration_drive_on_virtual_boards_is_bit_identical() {
    let images = Images::open(None, None).unwrap();
    let boards = Role::PAIR.map(|role| -> Box<dyn Target> {
        let log = BoardLog::new(Topology::PAIR.name(role));
        let board = VirtualLink::start(&images, (Topology::PAIR, role), &log, None);
        Box::new(Remote::new(Topology::PAIR, role, Box::new(board.unwrap())))
    });
    let nominal = Scenario::in_world(Some("ideal")).unwrap();
    let mut found = nominal.clone();
    let ratio = find("robot.geometry.wheel_ratio").unwrap();
    found.boards.put(Role::axle(1), &[(ratio, 0.995)]);
    let mut on_boards = CalibrationBench::new(&nominal, 1, Some(boards.into()));
    let mut here = CalibrationBench::new(&nominal, 1, None);
    let line = host_sim::paths::Path::line(0.3).unwrap();
    let [before, after] = [&nominal, &found].map(|scenario| {
        let run = on_boards.drive(scenario, &line, 1).unwrap();
        assert_eq!(run, here.drive(scenario, &line, 1).unwrap());
        run.axles
    });
    let turned = [&before, &after].map(|axles| [0, 1].map(|i| axles[i].lap.end()[2]));
    // A right wheel configured 0.5 % smaller turns the rear axle's odometry by 0.005·0.3 m/0.324 m.
    let change = turned[1][1] - turned[0][1];
    assert!((change + 0.005 * 0.3 / 0.324).abs() < 1e-3, "{change}");
    // The robot steers by its odometry, so the front axle turns slightly too.
    let other = turned[1][0] - turned[0][0];
    assert!(other.abs() < 0.5 * change.abs(), "{other}");
}

/// Terminal output of the program with typed input.
fn at_a_terminal(directory: &Path, arguments: &str, typed: &str) -> String {
    let (master, path) = pseudo_terminal();
    let inner = File::options().read(true).write(true).open(path).unwrap();
    let mut child = command(directory, arguments)
        .stdin(inner.try_clone().unwrap())
        .stdout(inner)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut outer = File::from(master);
    // The answer is typed before the program asks.
    outer.write_all(typed.as_bytes()).unwrap();
    let (mut shown, mut room) = (Vec::new(), [0; 4096]);
    // Reading fails when the program has closed the terminal.
    while let Ok(count @ 1..) = outer.read(&mut room) {
        shown.extend_from_slice(&room[..count]);
    }
    assert!(child.wait().unwrap().success());
    String::from_utf8_lossy(&shown).into_owned()
}

#[test]
fn calibration_at_a_terminal_saves_after_confirmation_only() {
    let folder = tempfile::tempdir().unwrap();
    let flash = folder.path().join("out/flash");
    for (typed, saved) in [("n\n", false), ("\n", false), ("y\n", true)] {
        let shown = at_a_terminal(folder.path(), "calibrate imu", typed);
        let (before, after) = shown.split_once("save to the boards? [y/N]").unwrap();
        assert!(before.contains("inertial.gyro_gain"), "{shown}");
        assert_eq!(after.contains("not saved"), !saved, "{shown}");
        assert_eq!(after.contains("2 values written"), saved, "{shown}");
        assert_eq!(flash.join("rear.flash").exists(), saved);
    }
}

#[test]
fn calibration_saves_found_values_only_with_yes() {
    let folder = tempfile::tempdir().unwrap();
    let shown = succeed(
        folder.path(),
        "calibrate imu --out found.toml --json report.json",
    );
    assert!(shown.contains("not saved: no terminal"), "{shown}");
    assert!(!folder.path().join("out/flash").exists());
    let report = calibrate(folder.path(), "imu", 1, "--yes");
    assert_eq!(report["saved"], true);
    let export = succeed(folder.path(), "params export");
    let found = fs::read_to_string(folder.path().join("found.toml")).unwrap();
    assert_eq!(export, found);
    assert_eq!(found.matches("inertial.gyro_gain = ").count(), 2, "{found}");
    let config = succeed(folder.path(), "config --scenario found.toml");
    assert!(config.contains("[boards.rear.inertial]"));
}
