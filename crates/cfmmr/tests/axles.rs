//! Robots of three to five axles: runs, their files, and refusals by name.

use crate::program::{assert_refused, cfmmr, json_file, succeed};
use tempfile::tempdir;

/// Each error names the key or option and the allowed values.
#[test]
fn options_beyond_the_axles_are_refused_by_name() {
    let folder = tempdir().unwrap();
    let posture = "posture --trials 1 --rows joint";
    assert_refused(
        folder.path(),
        posture,
        "--axles 6 | --axles | from 2 to 5
         --axles 1 | --axles | from 2 to 5
         --axles 3 --set robot.geometry.axles=3 | --axles 3 | leave one out
         --set robot.geometry.axles=6 | robot.geometry.axles = 6 | from 2 to 5
         --axles 3 --set robot.lead.fusion.mode=intersection | robot.lead.fusion.mode = intersection | joint
         --axles 3 --set mission.rps=false | mission.rps = false | must be true
         --axles 3 --set plant.mass_kg=[4,5] | plant.mass_kg | 1 per axle
         --axles 3 --set bus.late_ms=[1,2,3] | bus.late_ms has 3 entries | must have 5
         --axles 3 --set boards.beam.robot.beam.segments=5 | boards.beam | beam-1, beam-2
         --set boards.axle-2.robot.geometry.wheel_radius_m=0.07 | boards.axle-2 | front, rear, beam",
    );
    assert_refused(
        folder.path(),
        "posture",
        "--axles 3 --on serial:beam=/dev/none | beam | beam-1 or beam-2",
    );
    assert_refused(
        folder.path(),
        "calibrate wheels",
        "--axles 3 | robot.geometry.axles = 3 | must be 2",
    );
    assert_refused(
        folder.path(),
        "consistency --trials 2",
        "--axles 3 --fusion intersection | robot.lead.fusion.mode = intersection | joint",
    );
}

/// A world with lists of one entry serves any number of axles; a list of one per axle serves its own.
#[test]
fn lists_of_axles_and_boards_fit_the_robot() {
    let folder = tempdir().unwrap();
    for changes in [
        "--axles 2",
        "--axles 5",
        "--axles 3 --set plant.mass_kg=[4,5,6] --set bus.late_ms=[0,0,1,0,0]",
        "--axles 4 --set bus.late_ms=[1]",
        "--axles 3 --set boards.axle-2.robot.geometry.wheel_radius_m=0.0731",
    ] {
        let text = succeed(folder.path(), &format!("config {changes}"));
        let axles = changes.split_whitespace().nth(1).unwrap();
        assert!(text.contains(&format!("axles = {axles}")), "{text}");
    }
}

/// A log of a robot at rest has every axle, and its replay is identical.
#[test]
fn log_of_three_axles_replays_bit_for_bit() {
    let folder = tempdir().unwrap();
    let run = cfmmr(
        folder.path(),
        "drive wait 1 --axles 3 --log run.mcap --csv tables --out out --json end.json",
    );
    run.ends_with(0);
    let replay = succeed(folder.path(), "replay run.mcap");
    assert!(replay.contains("identical over"), "{replay}");
    for board in ["front", "axle-2", "rear", "beam-1", "beam-2"] {
        assert!(replay.contains(&format!("{board} board: ")), "{replay}");
    }
    let table = std::fs::read_to_string(folder.path().join("tables/beam.csv")).unwrap();
    assert!(
        table.lines().any(|line| line.contains("beam-2")),
        "board of each frame"
    );
    let epochs = std::fs::read_to_string(folder.path().join("tables/epochs.csv")).unwrap();
    assert!(
        epochs
            .lines()
            .next()
            .unwrap()
            .contains("lead.axle-2.phi_rad")
    );
    assert!(json_file(folder.path(), "end.json").is_object());
}

/// Uneven bends push the axles aside and turn them. With the tyres' slip of these loads estimated, no sound sensor is
/// blamed, and the axles do not push against each other.
#[test]
fn chains_reach_the_ends_of_curved_paths_without_blame_or_a_fight() {
    let folder = tempdir().unwrap();
    // Sine with a length of 3 m and a largest curvature of 2.5 1/m.
    let wave = std::f64::consts::TAU / 3.0;
    let points = (0..=600).map(|k| {
        let x = 0.01 * f64::from(k);
        format!("{x},{}\n", 2.5 / (wave * wave) * (wave * x).sin())
    });
    let path = format!("x_m,y_m\n{}", points.collect::<String>());
    std::fs::write(folder.path().join("sine.csv"), path).unwrap();
    for (n, (options, share)) in [
        ("--axles 5 --seed 16", 2.0),
        ("--axles 3 --seed 206 --path sine.csv --imu", 1.0),
    ]
    .into_iter()
    .enumerate()
    {
        let command = format!("follow {options} --world careful --out {n}");
        cfmmr(folder.path(), &command).ends_with(0);
        let result = json_file(folder.path(), &format!("{n}/result.json"));
        assert_eq!(result["end"]["kind"], "uncertain", "{}", result["end"]);
        let notices = result["end"]["notices"].to_string();
        assert!(!notices.contains("inconsistent"), "{options}: {notices}");
        let [force, of_path] =
            ["force_n", "own_force_n"].map(|key| result["chain"][key][0].as_f64().unwrap());
        assert!(force < share * of_path, "{options}: {force} N, {of_path} N");
    }
}
