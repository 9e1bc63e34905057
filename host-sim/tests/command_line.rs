//! The command line as a user meets it: exit codes, error texts, files, determinism.

#[path = "shared/program.rs"]
mod program;

use program::cfmmr;
use serde_json::Value;
use std::fs;
use std::path::Path;

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Names and bytes of all files below a directory.
fn files(directory: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    let mut open = vec![directory.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                let name = path.strip_prefix(directory).unwrap();
                found.push((name.display().to_string(), fs::read(&path).unwrap()));
            }
        }
    }
    found.sort();
    found
}

#[test]
fn bad_input_is_refused_by_name_and_nothing_is_written() {
    let scenario = |content: &str| {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("scenario.toml"), content).unwrap();
        folder
    };
    let cases: [(&str, &[&str], &[&str]); 13] = [
        ("[plant", &["posture"], &["scenario.toml"]),
        ("[plant]\nmass = 1", &["posture"], &["mass"]),
        (
            "[robot.geometry]\nframe_length_m = 0.0",
            &["posture"],
            &["frame_length_m", "0"],
        ),
        (
            "[robot.geometry]\nwheel_radius_m = nan",
            &["posture"],
            &["wheel_radius_m", "NaN"],
        ),
        (
            "[plant]\nstrip_length_m = nan",
            &["posture"],
            &["strip_length_m", "NaN"],
        ),
        (
            "[plant]\nfriction = -1.0",
            &["posture"],
            &["friction", "-1"],
        ),
        (
            "[robot.beam.strip]\ngauges_m = [0.1, 0.05, 0.2, 0.3, 0.35]",
            &["posture"],
            &["gauges_m"],
        ),
        (
            "[robot.beam.strip]\ngauges_m = [0.1, 0.2, 0.3, 0.35, 0.4]",
            &["posture"],
            &["gauges_m", "0.4"],
        ),
        ("[bus]\nloss = 1.5", &["posture"], &["bus.loss", "1.5"]),
        ("", &["posture", "--from", "1,2"], &["--from"]),
        ("", &["posture", "--from", "nan,0,0"], &["--from", "nan"]),
        (
            "",
            &["posture", "--set", "mission.start=[0,0,1e9]"],
            &["mission.start"],
        ),
        ("", &["posture", "--trials", "0"], &["--trials"]),
    ];
    for (content, arguments, expected) in cases {
        let folder = scenario(content);
        let mut all = arguments.to_vec();
        all.extend(["--scenario", "scenario.toml", "--json", "result.json"]);
        let output = cfmmr(folder.path(), &all, "");
        let error = text(&output.stderr);
        assert_eq!(
            output.status.code(),
            Some(2),
            "{content} {arguments:?}: {error}"
        );
        for word in expected {
            assert!(
                error.contains(word),
                "{content} {arguments:?}: no {word:?} in {error}"
            );
        }
        assert_eq!(
            files(folder.path()).len(),
            1,
            "{content} {arguments:?} wrote files"
        );
    }
}

#[test]
fn missing_scenario_file_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let output = cfmmr(folder.path(), &["posture", "--scenario", "none.toml"], "");
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("none.toml"));
}

#[test]
fn printed_configuration_is_a_scenario_and_stays_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let first = cfmmr(folder.path(), &["config"], "");
    assert!(first.status.success());
    fs::write(folder.path().join("all.toml"), &first.stdout).unwrap();
    let second = cfmmr(folder.path(), &["config", "--scenario", "all.toml"], "");
    assert!(second.status.success(), "{}", text(&second.stderr));
    assert_eq!(text(&first.stdout), text(&second.stdout));
    let changed = cfmmr(
        folder.path(),
        &[
            "config",
            "--set",
            "plant.friction=0.5",
            "--set",
            "robot.lead.fusion.mode=ci",
        ],
        "",
    );
    let changed = text(&changed.stdout);
    assert!(changed.contains("friction = 0.5") && changed.contains("\"intersection\""));
}

#[test]
fn one_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let run = |threads: &str, seed: &str| {
        let folder = tempfile::tempdir().unwrap();
        let output = cfmmr(
            folder.path(),
            &[
                "posture",
                "--trials",
                "2",
                "--rows",
                "pair",
                "--seed",
                seed,
                "--threads",
                threads,
                "--out",
                "out",
                "--json",
                "result.json",
            ],
            "",
        );
        assert!(output.status.success(), "{}", text(&output.stderr));
        (text(&output.stdout), files(folder.path()))
    };
    let one = run("1", "5");
    let many = run("3", "5");
    assert_eq!(one.0, many.0, "printed tables");
    let names = |run: &(String, Vec<(String, Vec<u8>)>)| -> Vec<String> {
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
    let result = one
        .1
        .iter()
        .find(|(name, _)| name == "result.json")
        .unwrap();
    let result: Value = serde_json::from_slice(&result.1).unwrap();
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
fn eval_goes_on_after_a_bad_line_and_ends_with_2() {
    let folder = tempfile::tempdir().unwrap();
    let good = r#"{"v":0.2,"kappa":1.0,"kappa_dot":0.1,"length":0.37,"form":"exact"}"#;
    let bad = r#"{"v":0.2,"kappa":1.0,"kappa_dot":0.1,"length":0,"form":"exact"}"#;
    let output = cfmmr(
        folder.path(),
        &["eval", "cascade"],
        &format!("{bad}\n{good}\n"),
    );
    assert_eq!(output.status.code(), Some(2));
    let lines: Vec<Value> = text(&output.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines.len(), 2);
    assert!(lines[0]["error"].as_str().unwrap().contains("length"));
    // κ = 2ψ/(L cos ψ) solved for ψ.
    let psi = lines[1]["psi"].as_f64().unwrap();
    assert!((2.0 * psi / (0.37 * psi.cos()) - 1.0).abs() < 1e-5);
    let output = cfmmr(folder.path(), &["eval", "cascade"], &format!("{good}\n"));
    assert_eq!(output.status.code(), Some(0));
}

#[test]
fn help_names_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let help = text(&cfmmr(folder.path(), &["--help"], "").stdout);
    for command in [
        "posture",
        "follow",
        "track",
        "hil",
        "consistency",
        "eval",
        "config",
        "dbc",
    ] {
        assert!(help.contains(command), "{command}");
    }
}
