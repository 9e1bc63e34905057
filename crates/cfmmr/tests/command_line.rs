//! Command line: exit codes, error texts, files, determinism.

use crate::program::{assert_refused, files, json_file, succeed, with_input};
use serde_json::Value;
use std::fs;

#[test]
fn bad_input_is_refused_by_name_and_nothing_is_written() {
    for (content, line) in [
        ("[plant", "| scenario.toml"),
        ("[plant]\nmass = 1", "| mass"),
        (
            "[robot.geometry]\nframe_length_m = 0.0",
            "| frame_length_m | 0",
        ),
        (
            "[robot.geometry]\nwheel_radius_m = nan",
            "| wheel_radius_m | NaN",
        ),
        ("[plant]\nstrip_length_m = nan", "| strip_length_m | NaN"),
        ("[plant]\nfriction = -1.0", "| friction | -1"),
        (
            "[robot.beam.strip]\ngauges_m = [0.1, 0.05, 0.2, 0.3, 0.35]",
            "| gauges_m",
        ),
        (
            "[robot.beam.strip]\ngauges_m = [0.1, 0.2, 0.3, 0.35, 0.4]",
            "| gauges_m | 0.4",
        ),
        (
            "[robot.beam.calibration]\ngain = [1, 1, 9, 1, 1]",
            "| robot.beam.calibration.gain[2] = 9",
        ),
        (
            "[robot.beam.calibration]\ngain = [1, 1, 1, 1]",
            "| robot.beam.calibration.gain = 4",
        ),
        ("[bus]\nloss = 1.5", "| bus.loss | 1.5"),
        ("", "--from 1,2 | --from"),
        ("", "--from nan,0,0 | --from | nan"),
        ("", "--set mission.start=[0,0,1e9] | mission.start"),
        ("", "--trials 0 | --trials"),
        ("", "--baud 9600 | --baud 9600 | --on serial"),
        ("", "--duration 3 | --duration | --on serial"),
        ("", "--log /dev/null/a.mcap | --log"),
        ("", "--csv /dev/null/a.csv | --csv"),
        ("", "--csv /dev/null/a | --csv"),
        (
            "",
            "--on serial:front=a,front=b | front: must have one port",
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("scenario.toml"), content).unwrap();
        let command = "posture --scenario scenario.toml --json result.json";
        assert_refused(folder.path(), command, line);
    }
    let folder = tempfile::tempdir().unwrap();
    assert_refused(folder.path(), "posture", "--scenario none.toml | none.toml");
}

#[test]
fn printed_configuration_is_a_scenario_and_stays_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let first = succeed(folder.path(), "config");
    fs::write(folder.path().join("all.toml"), &first).unwrap();
    assert_eq!(first, succeed(folder.path(), "config --scenario all.toml"));
    let changes = "config --set plant.friction=0.5 --set robot.lead.fusion.mode=ci";
    let changed = succeed(folder.path(), changes);
    assert!(changed.contains("friction = 0.5") && changed.contains("\"intersection\""));
}

#[test]
fn one_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let run = |threads: &str, seed: &str| {
        let folder = tempfile::tempdir().unwrap();
        let options = "--trials 2 --rows pair --out out --json result.json";
        let out = succeed(
            folder.path(),
            &format!("posture {options} --seed {seed} --threads {threads}"),
        );
        let result = json_file(folder.path(), "result.json");
        (out, files(folder.path()), result)
    };
    let one = run("1", "5");
    let many = run("3", "5");
    assert_eq!(one.0, many.0, "printed tables");
    let names = |run: &(String, Vec<(String, Vec<u8>)>, Value)| -> Vec<String> {
        run.1.iter().map(|(name, _)| name.clone()).collect()
    };
    assert_eq!(names(&one), names(&many));
    for (a, b) in one.1.iter().zip(&many.1) {
        assert!(a == b, "{} differs", a.0);
    }
    let other = run("2", "6");
    assert_ne!(one.0, other.0, "another seed is another result");
    for name in ["paths.png", "paths.svg", "errors.png", "errors.svg"] {
        assert!(names(&one).contains(&format!("out/{name}")), "{name}");
    }
    let result = &one.2;
    assert_eq!(result["run"]["seed"], 5);
    assert_eq!(
        result["run"]["command"],
        "cfmmr posture --trials 2 --rows pair --seed 5"
    );
    assert_eq!(result["run"]["scenario"]["world"], "careful");
    assert_eq!(result["trials"], 2);
    assert_eq!(result["rows"][1]["fusion"], "joint");
    assert!(result["rows"][1]["e_m"]["mean"].as_f64().unwrap() < 0.05);
}

#[test]
fn eval_continues_after_a_bad_line_and_exits_with_2() {
    let folder = tempfile::tempdir().unwrap();
    let good = r#"{"v":0.2,"kappa":1.0,"kappa_dot":0.1,"length":0.37,"form":"exact"}"#;
    let bad = r#"{"v":0.2,"kappa":1.0,"kappa_dot":0.1,"length":0,"form":"exact"}"#;
    let eval = |lines: &str| with_input(folder.path(), &["eval", "cascade"], lines);
    let run = eval(&format!("{bad}\n{good}\n")).ends_with(2);
    let lines = run.out.lines();
    let lines: Vec<Value> = lines
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines.len(), 2);
    assert!(lines[0]["error"].as_str().unwrap().contains("length"));
    // κ = 2ψ/(L cos ψ) solved for ψ.
    let psi = lines[1]["psi"].as_f64().unwrap();
    assert!((2.0 * psi / (0.37 * psi.cos()) - 1.0).abs() < 1e-5);
    eval(&format!("{good}\n")).ends_with(0);
}
