//! Ends of runs: what a command prints, writes and returns.

use crate::program::{Run, cfmmr, json_file, succeed};
use cfmmr::experiments::posture::Variant;
use host_sim::run::end::EndKind;
use host_sim::scenario::Scenario;
use recording::log::read::read;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Function from a column name to the cell in row `number` of a CSV file.
fn row(folder: &Path, file: &str, number: usize) -> impl Fn(&str) -> String + use<> {
    let mut reader = csv::Reader::from_path(folder.join(file)).unwrap();
    let header = reader.headers().unwrap().clone();
    let row = reader.records().nth(number).unwrap().unwrap();
    move |name: &str| {
        let place = header.iter().position(|column| column == name);
        row[place.unwrap_or_else(|| panic!("no column {name}"))].to_owned()
    }
}

/// Embedded JSON data of the report page.
fn page(folder: &Path, file: &str) -> Value {
    let page = fs::read_to_string(folder.join(file)).unwrap();
    let (_, rest) = page.split_once("id=\"data\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

fn float(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}"))
}

#[test]
fn uncertain_end_of_a_path_is_in_table_json_csv_log_and_page() {
    for command in ["follow", "track"] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        let options = "--path line --size 5 --out out --log run.mcap --csv csv";
        let run = cfmmr(path, &format!("{command} {options}")).ends_with(0);
        let end = json_file(path, "out/result.json")["end"].clone();
        assert_eq!(end["kind"], "uncertain", "{end}");
        assert_eq!(end["code"], "0x0d");
        assert_eq!(end["notices"][0], "goal uncertain");
        let [position, heading] = [0, 1].map(|k| float(&end["error_95"][k]));
        // The 95 % errors of position and heading exceed the tolerances of 10 cm and 5°.
        assert!((0.1..0.5).contains(&position) && heading > 0.0873, "{end}");
        // The truth is within the 95 % error of the estimate.
        let at = |key: &str, k: usize| float(&end[key][k]);
        let off = (at("truth", 0) - at("estimate", 0)).hypot(at("truth", 1) - at("estimate", 1));
        assert!((0.01..position).contains(&off), "{end}");

        let stated = format!("±{:.1} cm, ±{:.1}°", 100.0 * position, heading.to_degrees());
        let line = format!(
            "uncertain (0x0d) after {:.1} s, 95 % error {stated}",
            float(&end["duration_s"])
        );
        assert!(run.out.contains(&format!("end: {line}")), "{}", run.out);
        assert!(run.out.contains("notices: goal uncertain"), "{}", run.out);
        assert!(run.error.contains(&line) && run.error.contains("drive a shorter path"));
        for file in ["out/ends.csv", "csv/end.csv"] {
            let cell = row(path, file, 0);
            assert_eq!(
                (cell("end"), cell("code")),
                ("uncertain".to_owned(), "0x0d".to_owned())
            );
            assert_eq!(cell("error_95_m").parse::<f64>().unwrap(), position);
        }
        let log = read(&fs::read(path.join("run.mcap")).unwrap(), "run.mcap").unwrap();
        assert_eq!(
            (log.run.end["kind"].as_str(), log.run.end["code"].as_str()),
            ("uncertain", "0x0d")
        );
        let logged: [f64; 2] = serde_json::from_str(&log.run.end["error_95"]).unwrap();
        assert_eq!(logged, [position, heading]);
        let run = page(path, "out/report.html")["runs"][0].clone();
        assert_eq!(run["end"], end);
        assert!(
            run["summary"].to_string().contains(&line),
            "{}",
            run["summary"]
        );
    }
}

/// A heading standard deviation of 0.9 rad is beyond the linear range of the filter, whatever the tolerance; 0.4 rad is
/// not.
#[test]
fn estimate_beyond_the_linear_range_is_uncertain_at_any_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    let wide = "--set mission.tolerance_m=50 --set mission.tolerance_rad=3.2";
    for (sigma, kind) in [(0.4, "reached"), (0.9, "uncertain")] {
        let vague =
            format!("follow --path line --size 1 --set mission.placement_rad={sigma} {wide}");
        succeed(folder.path(), &format!("{vague} --json result.json"));
        assert_eq!(json_file(folder.path(), "result.json")["end"]["kind"], kind);
    }
}

/// Refused commands, each with parts of its error.
const FAR_PATHS: &str = "
drive --from=1.2,0,0 follow two.csv | begins 1.20 m from the robot | at most 0.40 m | max_deviation_m
drive --from=0.3,0.3,0 follow two.csv | begins 0.42 m
drive --from=0.35,0,0 follow two.csv | 0.35 m past the start of the path | at most 0.20 m
drive --from=0,0,180deg follow two.csv | differs from the start of the path by 180° | at most 90°
drive --from=1.05,0,0 --set robot.lead.course.max_deviation_m=2 follow two.csv | past the start of the path
drive --script far | line 2: follow two.csv | begins 3.00 m
drive --script twice | line 3: follow two.csv | begins 1.00 m
follow --path two.csv --from 1.5,0,0 | begins 1.50 m
track --path two.csv --from=-0.6,0,0 | begins 0.60 m
";

#[test]
fn path_that_the_robot_cannot_begin_is_refused_before_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    file("two.csv", "x,y\n0,0\n1,0\n");
    file("far", "goto 3 0 0\nfollow two.csv\n");
    file("twice", "follow two.csv\nstop\nfollow two.csv\n");
    file("back", "follow two.csv\ngoto 0.1 0.05 0\nfollow two.csv\n");
    file("drift", "speed 0.2 0 6\nstop\nfollow two.csv\n");
    crate::program::assert_refused(folder.path(), "", FAR_PATHS);

    // A second drive along an open path begins at the path's start, so its duration is that of the whole path.
    succeed(folder.path(), "drive --script back --json result.json");
    let steps = json_file(folder.path(), "result.json")["steps"].clone();
    let end = |k: usize, key: &str| steps[k]["end"][key].clone();
    assert_eq!([0, 1, 2].map(|k| end(k, "kind")), ["reached"; 3]);
    assert!(float(&end(2, "duration_s")) > 4.0, "{steps}");

    // The posture before the third step is not known before the run, so the step fails during the run.
    let run = cfmmr(folder.path(), "drive --script drift --json result.json").ends_with(1);
    for part in [
        "line 3: follow two.csv: stopped (0x8f), path lost",
        "begins 1.",
    ] {
        assert!(run.error.contains(part), "{}", run.error);
    }
    let end = json_file(folder.path(), "result.json")["steps"][2]["end"].clone();
    assert_eq!(end["kind"], "stopped", "{end}");
}

/// A loop ends at its start: a robot that cannot leave the start has not reached the end.
#[test]
fn robot_that_cannot_move_makes_no_progress_on_a_loop() {
    let folder = tempfile::tempdir().unwrap();
    let weak = "--set robot.axle.controller.velocity_gain_n_s_m=8 --set plant.rolling_resistance=0.5 \
                --set robot.axle.disturbance.max_force_n=0";
    let options = "--path circle --size 0.38 --speed 0.06 --json result.json";
    let run = cfmmr(folder.path(), &format!("follow {options} {weak}")).ends_with(1);
    let end = json_file(folder.path(), "result.json")["end"].clone();
    assert_eq!(
        (&end["kind"], &end["code"]),
        (&"no progress".into(), &"0x15".into()),
        "{end}"
    );
    assert!(float(&end["duration_s"]) < 25.0 && run.error.contains("check for an obstacle"));
}

/// The end does not depend on the time at rest. A notice of an earlier step is not in a later end.
#[test]
fn end_is_independent_of_time_at_rest_and_earlier_goals() {
    let folder = tempfile::tempdir().unwrap();
    for (rest, size, kind) in [
        (0.0, 5.0, "uncertain"),
        (0.0, 1.0, "reached"),
        (0.01, 5.0, "uncertain"),
    ] {
        let set = format!("--set mission.rest_s={rest} --json result.json");
        succeed(
            folder.path(),
            &format!("follow --path line --size {size} {set}"),
        );
        assert_eq!(
            json_file(folder.path(), "result.json")["end"]["kind"],
            kind,
            "{rest} {size}"
        );
    }
    fs::write(
        folder.path().join("near"),
        "goto 1 0 0\nclear\npose 0 0 0\n",
    )
    .unwrap();
    let set = "--world ordinary --set mission.tolerance_m=0.01 --json result.json";
    succeed(folder.path(), &format!("drive --script near {set}"));
    let steps = json_file(folder.path(), "result.json")["steps"].clone();
    assert_eq!(steps[0]["end"]["kind"], "uncertain");
    for step in [1, 2] {
        let notices = steps[step]["end"]["notices"].to_string();
        assert!(!notices.contains("goal uncertain"), "{steps}");
    }
}

#[test]
fn soak_continues_after_a_missed_goal() {
    let folder = tempfile::tempdir().unwrap();
    let world = "[plant]\nrolling_resistance = 0.5\ncogging_torque_n_m = 0.3\n";
    fs::write(folder.path().join("bad.toml"), world).unwrap();
    let run = cfmmr(folder.path(), "soak --ticks 200000 --world bad.toml");
    assert!(
        run.out.contains("--ticks 200000"),
        "{}{}",
        run.out,
        run.error
    );
}

/// Cogging of 0.1 N m holds the robot millimetres before the end of its path.
#[test]
fn robot_held_by_friction_before_the_end_rests_within_the_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    for seed in [31, 32] {
        let options = "--path line --set plant.cogging_torque_n_m=0.1 --json result.json";
        succeed(folder.path(), &format!("follow {options} --seed {seed}"));
        let result = json_file(folder.path(), "result.json");
        assert!(
            float(&result["end"]["duration_s"]) < 25.0,
            "{}",
            result["end"]
        );
        assert!(float(&result["estimate"]["final_m"]) < 0.02, "{result}");
    }
}

#[test]
fn posture_and_paper_count_their_ends_and_write_every_trial() {
    let folder = tempfile::tempdir().unwrap();
    let posture = "posture --trials 3 --seed 5 --out posture --from=-1.3,-1.3,0";
    let paper = "paper --trials 3 --seed 5 --out paper";
    for (command, out, rows) in [(posture, "posture", 3), (paper, "paper", 2)] {
        let printed = succeed(folder.path(), command);
        assert!(!printed.contains("NaN"), "{printed}");
        // The 95 % error of encoders alone is marked ≤ as an upper bound, and each printed kind of end is explained.
        let bound = |line: &str| line.contains("encoders") && line.contains("≤");
        assert_eq!(printed.lines().any(bound), out == "posture", "{printed}");
        let meaning = format!("uncertain: {}", EndKind::Uncertain.meaning());
        let words = printed.split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(words.contains(&meaning), out == "posture", "{printed}");
        let result = json_file(folder.path(), &format!("{out}/result.json"));
        let mut trials = 0;
        for of in result["rows"].as_array().unwrap() {
            let ends = of["ends"].as_object().unwrap();
            let counted: f64 = ends.values().map(float).sum();
            assert_eq!(
                (counted, of["runs"].as_array().unwrap().len()),
                (3.0, 3),
                "{of}"
            );
            for run in of["runs"].as_array().unwrap() {
                let cell = row(folder.path(), &format!("{out}/trials.csv"), trials);
                let kind: EndKind = serde_json::from_value(run["kind"].clone()).unwrap();
                assert_eq!(cell("end"), kind.name(), "{run}");
                let e = cell("error_95_m").parse::<f64>().unwrap();
                assert_eq!(e, float(&run["error_95"][0]));
                trials += 1;
            }
        }
        assert_eq!(trials, 3 * rows);
    }
}

#[test]
fn stalled_paper_law_gives_up_with_its_code() {
    let folder = tempfile::tempdir().unwrap();
    let options = "--from=-1.342,-1.342,0 --no-rps --world paper --seed 424242 --json result.json";
    let law = "--set robot.lead.regulator.strategy=paper-law";
    let run = cfmmr(folder.path(), &format!("drive goto 0 0 0 {options} {law}")).ends_with(1);
    let end = json_file(folder.path(), "result.json")["steps"][0]["end"].clone();
    assert_eq!(
        (&end["kind"], &end["code"]),
        (&"gave up".into(), &"0x10".into()),
        "{end}"
    );
    assert!(run.error.contains("gave up (0x10)") && run.error.contains("choose a nearer goal"));
}

#[test]
fn single_trial_has_no_spread() {
    let folder = tempfile::tempdir().unwrap();
    let out = succeed(folder.path(), "posture --trials 1");
    let mut rows = out.lines().filter(|line| line.contains("joint"));
    assert!(rows.all(|row| !row.contains('±')), "{out}");
    assert!(out.contains("cm with gauges (joint)"), "{out}");
    assert!(!out.contains("NaN"), "{out}");
}

fn configurations(run: &Run) -> Vec<(bool, bool, String)> {
    let result = run.json();
    let rows = result["rows"].as_array().unwrap().iter();
    let of = |row: &Value| {
        let is = |key: &str| row[key].as_bool().unwrap();
        (
            is("rps"),
            is("imu"),
            row["fusion"].as_str().unwrap().to_owned(),
        )
    };
    rows.map(of).collect()
}

#[test]
fn no_rps_and_imu_choose_the_rows_of_posture() {
    let folder = tempfile::tempdir().unwrap();
    let rows = |options: &str| {
        let run = cfmmr(
            folder.path(),
            &format!("posture --trials 1 --json - {options}"),
        );
        configurations(&run.ends_with(0))
    };
    let row = |rps, imu, fusion: &str| (rps, imu, fusion.to_owned());
    assert_eq!(rows("--no-rps"), [row(false, false, "odometry")]);
    assert_eq!(
        rows("--imu --rows pair"),
        [row(false, true, "odometry"), row(true, true, "joint")]
    );
    assert_eq!(
        rows("--imu --no-rps --rows all"),
        [row(false, true, "odometry")]
    );
    let error = cfmmr(folder.path(), "posture --no-rps --rows joint")
        .ends_with(2)
        .error;
    assert!(error.contains("--no-rps: no row is left"), "{error}");
}

#[test]
fn pictures_of_a_drive_show_the_goal_and_no_error_of_the_truth() {
    let folder = tempfile::tempdir().unwrap();
    succeed(
        folder.path(),
        "drive follow line 0.5 --from 0.2,0.1,0 --out out",
    );
    let run = page(folder.path(), "out/report.html")["runs"][0].clone();
    let goal = [0, 1].map(|k| float(&run["goal"][k]));
    assert!(
        (goal[0] - 0.7).abs() < 0.01 && (goal[1] - 0.1).abs() < 0.01,
        "{goal:?}"
    );
    let series = run["plots"][0]["series"].as_array().unwrap();
    let names: Vec<&str> = series
        .iter()
        .map(|one| one["name"].as_str().unwrap())
        .collect();
    assert_eq!(
        names,
        ["as estimated"],
        "the error of the truth from itself is none"
    );
    succeed(folder.path(), "drive speed 0.1 0 1 --out out");
    assert!(page(folder.path(), "out/report.html")["runs"][0]["goal"].is_null());
    let svg = fs::read_to_string(folder.path().join("out/paths.svg")).unwrap();
    assert!(!svg.contains("goal"));
}

#[test]
fn picture_and_table_of_posture_have_the_tolerance_of_the_mission() {
    let folder = tempfile::tempdir().unwrap();
    let options = "posture --rows pair --trials 2 --out out --set mission.tolerance_m=0.07";
    succeed(folder.path(), options);
    let svg = fs::read_to_string(folder.path().join("out/paths.svg")).unwrap();
    assert!(
        svg.contains("tolerance") && svg.contains("7 cm") && !svg.contains("3 cm"),
        "{svg}"
    );
    let result = json_file(folder.path(), "out/result.json");
    for of in result["rows"].as_array().unwrap() {
        let near = |run: &&Value| {
            let at = |k: usize| float(&run["truth"][k]);
            at(0).hypot(at(1)) <= 0.07 && at(2).abs() <= 0.0873
        };
        let near = of["runs"].as_array().unwrap().iter().filter(near).count();
        assert_eq!(float(&of["within_tolerance"]), near as f64 / 2.0);
    }
}

#[test]
fn fusion_has_the_name_that_the_scenario_gives_it() {
    for variant in Variant::ALL {
        let scenario = variant.apply(&Scenario::default());
        let text = scenario.to_toml().unwrap();
        let table: toml::Table = text.parse().unwrap();
        let mode = &table["robot"]["lead"]["fusion"]["mode"];
        assert_eq!(mode.as_str(), Some(variant.fusion()));
        assert!(variant.label().ends_with(variant.fusion()));
    }
}

/// No source file of `cfmmr` contains the names of ends: they are in `run/end.rs` of `host-sim`.
#[test]
fn kinds_of_ends_are_named_in_one_source_file() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut open = vec![root];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
                continue;
            }
            let text = fs::read_to_string(&path).unwrap();
            let text = text.split("#[cfg(test)]").next().unwrap();
            for kind in EndKind::ALL {
                let word = format!("\"{}\"", kind.name());
                let only = path.ends_with("run/end.rs");
                assert_eq!(text.contains(&word), only, "{word} in {}", path.display());
            }
        }
    }
}
