//! Path following and trajectory tracking of the whole robot: plant, sensors, bus, nodes.

use crate::program::{assert_refused, cfmmr, files, json_file, succeed};
use core_algos::fusion::robot::Mode;
use host_sim::paths::Path;
use host_sim::run::path_run;
use host_sim::run::path_run::{Outcome, PathEpoch, PathMode, Route};
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use std::fs;

/// Waypoints with bends to both sides, the first bend at the start.
const WAVE: &str = "x,y\n0,0\n0.5,0.12\n0.9,0.5\n1.5,0.6\n2.0,0.3\n";

fn scenario() -> Scenario {
    let mut scenario = Scenario::in_world(Some("ideal")).unwrap();
    scenario.mission.settle_s = 0.1;
    scenario.mission.rest_s = 0.1;
    scenario
}

fn run(
    path: &Path,
    path_mode: PathMode,
    scenario: &Scenario,
    seed: u64,
) -> (Outcome, Vec<PathEpoch>) {
    let mut scenario = scenario.clone();
    let route = Route::new(path, 1, &scenario).unwrap();
    scenario.mission.start = route.start();
    let mut moments = Vec::new();
    let outcome = drive(&scenario, &route, path_mode, seed, |moment| {
        moments.push(moment.clone());
    });
    (outcome, moments)
}

fn drive(
    scenario: &Scenario,
    route: &Route,
    path_mode: PathMode,
    seed: u64,
    observe: impl FnMut(&PathEpoch),
) -> Outcome {
    let mut simulation = Simulation::new(scenario, seed, 0).unwrap();
    path_run::drive_on(&mut simulation, scenario, route, path_mode, observe).unwrap()
}

fn paths() -> [(&'static str, Path); 4] {
    [
        ("line", Path::line(1.5).unwrap()),
        ("circle", Path::circle(0.5).unwrap()),
        ("eight", Path::figure_eight(1.05).unwrap()),
        ("wave", Path::from_csv(WAVE.as_bytes()).unwrap()),
    ]
}

#[test]
fn robot_follows_every_path_within_the_estimate_error() {
    for (name, path) in paths() {
        let (outcome, _) = run(&path, PathMode::Follow, &scenario(), 3);
        let (truth, estimate) = (outcome.truth, outcome.estimate);
        assert!(outcome.end.is_success(), "{name}");
        assert!(
            estimate.rms_m < 1.5e-3 && estimate.max_m < 5e-3,
            "{name}: {estimate:?}"
        );
        assert!(estimate.final_m < 3e-3, "{name}: {estimate:?}");
        // Placement contributes 2 mm to the error, odometry the rest.
        assert!(truth.rms_m < 0.015, "{name}: {truth:?}");
        assert!(truth.final_m < 0.025, "{name}: {truth:?}");
        assert!(truth.final_heading_rad.abs() < 0.035, "{name}: {truth:?}");
    }
}

#[test]
fn robot_tracks_every_trajectory() {
    for (name, path) in paths() {
        let (outcome, moments) = run(&path, PathMode::Track, &scenario(), 4);
        let (truth, estimate) = (outcome.truth, outcome.estimate);
        assert!(outcome.end.is_success(), "{name}");
        assert!(
            estimate.rms_m < 3e-3 && estimate.max_m < 0.01,
            "{name}: {estimate:?}"
        );
        assert!(estimate.final_m < 3e-3, "{name}: {estimate:?}");
        assert!(truth.rms_m < 0.026, "{name}: {truth:?}");
        // Final error on the figure eight: 18 mm rms over seeds, at most 47 mm in 200 seeds.
        assert!(truth.final_m < 0.04, "{name}: {truth:?}");
        // The target leads by the trailing distance, so the mean along-track error of O is small.
        let fast: Vec<f64> = moments
            .iter()
            .filter(|moment| moment.record.lead.motion.v > 0.15)
            .map(|moment| {
                let center = moment.record.lead.fused.robot.posture;
                let (s, c) = moment.target.phi.sin_cos();
                let (dx, dy) = (
                    f64::from(center.x) - moment.target.x,
                    f64::from(center.y) - moment.target.y,
                );
                // The estimate is one epoch older than the target, so the travel of one epoch, 0.01 s, is added.
                c * dx + s * dy + 0.01 * f64::from(moment.record.lead.motion.v)
            })
            .collect();
        let mean = fast.iter().sum::<f64>() / fast.len() as f64;
        assert!(mean.abs() < 5e-3, "{name}: {mean}");
    }
}

#[test]
fn curvature_keeps_its_bound_on_the_tightest_path() {
    let path = Path::figure_eight(0.99).unwrap();
    for path_mode in [PathMode::Follow, PathMode::Track] {
        let (outcome, moments) = run(&path, path_mode, &scenario(), 5);
        let bound = path_run::bounds(&scenario()).max_curvature();
        assert!(path.max_curvature() > 0.99 * bound);
        assert!(
            outcome.end.is_success() && outcome.max_curvature <= bound,
            "{outcome:?}"
        );
        assert!(outcome.estimate.rms_m < 5e-3, "{outcome:?}");
        // The curvature is computed from the motion of the midpoint in each tenth of a second.
        for pair in moments.windows(11).step_by(10) {
            let [a, b] = [pair[0].record.midpoint, pair[10].record.midpoint];
            let distance = (b[0] - a[0]).hypot(b[1] - a[1]);
            if distance > 0.015 {
                let turn = (b[2] - a[2] + 9.0).rem_euclid(std::f64::consts::TAU) - 9.0;
                let turn = turn - std::f64::consts::TAU * (turn / std::f64::consts::TAU).round();
                assert!(
                    (turn / distance).abs() < 1.03 * bound,
                    "{}",
                    turn / distance
                );
            }
        }
    }
}

#[test]
fn robot_beside_the_path_converges_to_it() {
    let path = Path::line(1.5).unwrap();
    let mut scenario = scenario();
    let route = Route::new(&path, 1, &scenario).unwrap();
    scenario.mission.start = [-0.1, 0.12, -0.4];
    let mut late = 0.0f64;
    let outcome = drive(&scenario, &route, PathMode::Follow, 2, |moment| {
        if moment.target.s > 0.9 {
            late = late.max(moment.estimate.lateral_m.abs());
        }
    });
    assert!(outcome.end.is_success() && outcome.estimate.final_m < 2e-3);
    assert!(late < 2e-3, "{late}");
}

#[test]
fn several_laps_are_streamed_through_the_boards_buffer() {
    // A lap has more points than the board's buffer.
    let path = Path::circle(0.45).unwrap();
    let mut scenario = scenario();
    let route = Route::new(&path, 2, &scenario).unwrap();
    scenario.mission.start = route.start();
    let mut turned = 0.0;
    let mut last = scenario.mission.start[2];
    let outcome = drive(&scenario, &route, PathMode::Follow, 6, |moment| {
        let step = moment.record.midpoint[2] - last;
        turned += step - std::f64::consts::TAU * (step / std::f64::consts::TAU).round();
        last = moment.record.midpoint[2];
    });
    assert!(
        outcome.end.is_success() && outcome.estimate.rms_m < 2e-3,
        "{outcome:?}"
    );
    assert!(
        (turned - 2.0 * std::f64::consts::TAU).abs() < 0.1,
        "{turned}"
    );
}

/// Without the relative position sensor, creep of the axles against each other in a bend is not measured.
#[test]
fn without_the_sensor_the_true_path_error_grows() {
    let path = Path::circle(0.5).unwrap();
    let mut scenario = scenario();
    scenario.mission.rps = false;
    scenario.robot.lead.fusion.mode = Mode::Odometry;
    let (without, _) = run(&path, PathMode::Follow, &scenario, 3);
    assert!(without.truth.rms_m > 0.1, "{without:?}");
    assert!(without.estimate.rms_m < 0.03, "{without:?}");
}

#[test]
fn path_beyond_the_frame_is_refused_with_place_and_value() {
    let bend = Path::from_csv("0,0\n1,0\n1.1,0.3\n0.4,0.4\n".as_bytes()).unwrap();
    let error = Route::new(&bend, 1, &scenario()).unwrap_err().to_string();
    for word in ["curvature", "x = ", "waypoint 3, line 3", "3.04"] {
        assert!(error.contains(word), "no {word:?} in {error}");
    }
    let circle = Path::circle(0.3).unwrap();
    let error = Route::new(&circle, 1, &scenario()).unwrap_err().to_string();
    assert!(error.contains("3.333"), "{error}");
    let long = Path::line(900.0).unwrap();
    assert!(Route::new(&long, 2, &scenario()).is_ok(), "open: one lap");
    let ring = Path::circle(100.0).unwrap();
    assert!(Route::new(&ring, 8, &scenario()).is_err());
}

/// Refused paths, each with texts that its error contains.
const REFUSED: &str = "
--path hook.csv | hook.csv | curvature | line 4
--path word.csv | word.csv | line 3 | one
--path short.csv | short.csv | at least 2
--path nan.csv | nan.csv | line 2 | NaN
--path none.csv | none.csv
--path circle --size 0.3 | circle | 3.333
--path line --size 0 | --size | 0
--path line --size NaN | --size | NaN
--path hook.csv --size 1 | --size
--speed 0.3 | --speed | 0.3 | 0.25
--from 1,2 | --from
";

#[test]
fn commands_refuse_bad_paths_by_name_and_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    file("hook.csv", "x,y\n0,0\n1,0\n1.1,0.3\n0.4,0.4\n");
    file("word.csv", "x,y\n0,0\none,0\n");
    file("short.csv", "x,y\n0,0\n");
    file("nan.csv", "0,0\n1,NaN\n");
    for command in ["follow", "track"] {
        assert_refused(
            folder.path(),
            &format!("{command} --json result.json"),
            REFUSED,
        );
    }
}

#[test]
fn commands_write_the_same_bytes_for_the_same_seed() {
    for command in ["follow", "track"] {
        let run = |seed: &str| {
            let folder = tempfile::tempdir().unwrap();
            let options = "--path line --size 0.5 --out out --json result.json";
            let out = succeed(folder.path(), &format!("{command} {options} --seed {seed}"));
            let written = files(&folder.path().join("out"));
            (out, written, json_file(folder.path(), "result.json"))
        };
        let one = run("3");
        assert!(one == run("3"), "{command}");
        assert_ne!(one.0, run("4").0, "{command}");
        for ending in ["png", "svg"] {
            let name = format!("{command}.{ending}");
            assert!(one.1.iter().any(|(file, _)| *file == name), "{name}");
        }
        for field in ["rms_m", "final_m", "final_heading_rad"] {
            assert!(one.2[field].as_f64().unwrap().abs() < 0.02, "{field}");
        }
    }
}

#[test]
fn stopped_run_fails_and_names_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = "follow --set robot.lead.limits.moment_n_m=0.1 --json result.json";
    let error = cfmmr(folder.path(), arguments).ends_with(1).error;
    for word in ["wrench high (0x87)", " s: ", "check for a blocked wheel"] {
        assert!(error.contains(word), "no {word:?} in {error}");
    }
    let result = fs::read_to_string(folder.path().join("result.json")).unwrap();
    assert!(
        result.contains("\"kind\": \"stopped\"") && result.contains("0x87"),
        "{result}"
    );
}

/// Loads of the ground: a slope of 3° up, down and across a line along x, cogging, rolling resistance.
fn loads() -> [(&'static str, Scenario); 5] {
    let mut scenario = Scenario::in_world(Some("careful")).unwrap();
    scenario.mission.rest_s = 20.0;
    [
        ("down", 3.0, 0.0, 0.0, 0.03),
        ("up", 3.0, 180.0, 0.0, 0.03),
        ("across", 3.0, 90.0, 0.0, 0.03),
        ("cogging", 0.0, 0.0, 0.1, 0.03),
        ("rolling", 0.0, 0.0, 0.0, 0.06),
    ]
    .map(
        |(name, slope, downhill, cogging, rolling): (_, f64, f64, _, _)| {
            let mut scenario = scenario.clone();
            let plant = &mut scenario.world.plant;
            plant.slope_rad = slope.to_radians();
            plant.downhill_rad = downhill.to_radians();
            plant.cogging_torque_n_m = cogging;
            plant.rolling_resistance = rolling;
            (name, scenario)
        },
    )
}

/// The law of an axle alone ends 5 to 8 mm beside the end and creeps by 160 mm in 20 s on the slopes.
#[test]
fn line_ends_and_is_held_under_every_load_of_the_ground() {
    let path = Path::line(1.5).unwrap();
    for path_mode in [PathMode::Follow, PathMode::Track] {
        for (name, scenario) in loads() {
            let (outcome, moments) = run(&path, path_mode, &scenario, 31);
            assert!(outcome.end.is_success(), "{name}: {outcome:?}");
            let done = moments.iter().position(|moment| moment.record.lead.done);
            let rest = &moments[done.unwrap()..];
            assert!(rest.len() > 1900, "{name}");
            let along = |moment: &PathEpoch| moment.record.lead.fused.robot.posture.x - 1.5;
            assert!(along(&rest[0]).abs() < 1e-3, "{name}: {}", along(&rest[0]));
            // The rolling resistance ends with the motion: its force, 1.5 N or 3 N, over the stiffness of 2000 N/m.
            let truth = |moment: &PathEpoch| moment.record.midpoint[0];
            for moment in rest {
                let moved = truth(moment) - truth(&rest[0]);
                assert!(moved.abs() < 1.5e-3, "{name}: {moved}");
            }
        }
    }
}
