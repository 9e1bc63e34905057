//! Posture regulation from random starts through the command: success, the curvature bound,
//! determinism, refusals.

use core_algos::control::kinematic::LimitsConfig;
use core_algos::control::regulator::{Config, Strategy};
use host_sim::experiments::sweep::{Report, Start, Sweep, SweepModel};
use host_sim::run::kinematic_model::{Model, Trial, random_start, regulate};
use host_sim::run::regulate;
use host_sim::scenario::Scenario;
use rayon::prelude::*;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn sweep(model: SweepModel, kappa_max: f64) -> Sweep {
    Sweep::new(Scenario::default(), model, Some(kappa_max)).unwrap()
}

fn run(sweep: &Sweep, starts: u64) -> Vec<Start> {
    (0..starts)
        .into_par_iter()
        .map(|index| sweep.run(5, index).unwrap().0)
        .collect()
}

fn check(report: &Report) {
    assert_eq!(report.successes, report.starts, "{report:?}");
    assert_eq!(report.bound_broken, 0, "{report:?}");
    for largest in [
        report.max_curvature,
        report.max_path_curvature,
        report.max_commanded_curvature,
    ] {
        // Used, and never exceeded.
        let share = largest / report.kappa_max;
        assert!((0.8..=1.0).contains(&share), "{report:?}");
    }
    assert!(report.time_s.max < 30.0, "{report:?}");
}

#[test]
fn kinematic_starts_all_come_home_within_the_bound() {
    for kappa_max in [1.5, 2.5, 3.3] {
        let sweep = sweep(SweepModel::Kinematic, kappa_max);
        let starts = run(&sweep, 150);
        let report = Report::of(&starts, &sweep);
        check(&report);
        assert!(starts.iter().filter(|start| start.e_m >= 3e-3).count() <= 7);
        // No path of the bound is shorter than the shortest, but for the last millimetres.
        assert!(
            (0.99..1.1).contains(&report.length_ratio.mean),
            "{report:?}"
        );
        assert!(report.max_planning_steps <= 60, "{report:?}");
    }
}

/// Drives the model from a start to the origin with a curvature bound of 3 1/m.
fn bring_home(strategy: Strategy, model: Model, start: [f64; 3], seed: u64, trial: u64) -> Trial {
    let model = Model {
        max_steering_rad: model.steering(3.0),
        ..model
    };
    let config = Config {
        strategy,
        limits: LimitsConfig {
            max_steering_rad: model.max_steering_rad as f32,
            frame_length_m: model.frame_length_m as f32,
            ..Config::default().limits
        },
        ..Config::default()
    };
    let regulator = config.build().unwrap();
    regulate(
        &regulator,
        &model,
        start,
        [0.0; 3],
        seed,
        trial,
        |_, _, _| {},
    )
}

#[test]
fn a_wandering_estimate_and_a_wrong_curvature_are_survived() {
    let disturbed = Model {
        position_noise_m: 0.002,
        heading_noise_rad: 0.005,
        curvature_gain: 0.95,
        curvature_offset_1_m: 0.05,
        ..Model::default()
    };
    let failed = |index: &u64| {
        let start = random_start(8, *index);
        !bring_home(Config::default().strategy, disturbed, start, 8, *index).success
    };
    assert!((0..200).into_par_iter().filter(failed).count() <= 1);
}

#[test]
fn both_strategies_bring_the_papers_start_home() {
    for strategy in [Strategy::Funnel, Strategy::PaperLaw] {
        let trial = bring_home(strategy, Model::default(), [-1.342, -1.342, 0.0], 0, 0);
        assert!(trial.success, "{trial:?}");
        assert!(trial.length_m < 1.1 * trial.shortest_m, "{trial:?}");
    }
}

#[test]
fn starts_of_the_whole_robot_come_home_within_the_bound() {
    for kappa_max in [1.5, 3.3] {
        let sweep = sweep(SweepModel::Plant, kappa_max);
        let report = Report::of(&run(&sweep, 6), &sweep);
        check(&report);
        assert!(
            (0.99..1.2).contains(&report.length_ratio.mean),
            "{report:?}"
        );
    }
}

/// Figures of the sweep for a trial against the log of its states.
#[test]
fn the_figures_of_a_trial_follow_from_its_states() {
    let mut scenario = Scenario::default();
    scenario.mission.start = random_start(5, 3);
    let (mut length, mut steering, mut commanded) = (0.0, 0.0f64, 0.0f64);
    let mut turning: f64 = 0.0;
    let mut last: Option<[f64; 3]> = None;
    let outcome = regulate::regulate(&scenario, 5, 3, |record| {
        let [x, y, phi] = record.midpoint;
        if let Some([x0, y0, phi0]) = last {
            let step = (x - x0).hypot(y - y0);
            length += step;
            if step > 5e-4 {
                let turned = (phi - phi0).sin().atan2((phi - phi0).cos());
                turning = turning.max((turned / step).abs());
            }
        }
        last = Some(record.midpoint);
        steering = steering.max(0.5 * (record.axles[0][2] - record.axles[1][2]).abs());
        commanded = commanded.max(f64::from(record.lead.motion.psi.0).abs());
    })
    .unwrap();
    // Chord of a circular frame from its arc: κ = 2 sin ψ/(chord cos ψ).
    let kappa = |psi: f64| {
        let radius = 0.37 / (2.0 * psi);
        2.0 * psi.sin() / (2.0 * radius * psi.sin() * psi.cos())
    };
    assert!(outcome.done);
    assert!(
        (outcome.path_m - length).abs() < 2e-3,
        "{outcome:?} {length}"
    );
    assert!((outcome.max_commanded_curvature / kappa(commanded) - 1.0).abs() < 1e-6);
    // The log is ten times coarser.
    let ratio = outcome.max_curvature / kappa(steering);
    assert!((1.0..1.01).contains(&ratio), "{ratio}");
    assert!((outcome.max_path_curvature / turning - 1.0).abs() < 0.02);
    // O follows the circle that the frame's bend describes: an independent measure of it.
    assert!((outcome.max_path_curvature / outcome.max_curvature - 1.0).abs() < 0.02);
}

fn cfmmr(directory: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_cfmmr"))
        .arg("sweep")
        .args(arguments)
        .current_dir(directory)
        .output()
        .unwrap()
}

#[test]
fn threads_do_not_change_a_byte_and_a_start_does_not_know_of_the_others() {
    let folder = tempfile::tempdir().unwrap();
    for (out, threads, starts) in [("one", "1", "6"), ("four", "4", "6"), ("few", "3", "2")] {
        let output = cfmmr(
            folder.path(),
            &[
                "--starts",
                starts,
                "--threads",
                threads,
                "--seed",
                "9",
                "--out",
                out,
            ],
        );
        assert!(output.status.success(), "{output:?}");
    }
    let read = |out: &str, name: &str| fs::read(folder.path().join(out).join(name)).unwrap();
    for name in ["sweep.png", "sweep.svg", "starts.csv", "result.json"] {
        assert!(read("one", name) == read("four", name), "{name}");
    }
    let lines = |out: &str| {
        let text = String::from_utf8(read(out, "starts.csv")).unwrap();
        text.lines().take(3).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(lines("one"), lines("few"));
    let result: Value = serde_json::from_slice(&read("one", "result.json")).unwrap();
    assert_eq!(result["starts"], 6);
    assert_eq!(result["successes"], 6);
    assert_eq!(result["model"], "plant");
}

#[test]
fn a_curvature_out_of_range_is_refused_and_nothing_written() {
    let folder = tempfile::tempdir().unwrap();
    for kappa in ["0.1", "nan", "-2", "50", "inf", "much"] {
        for model in ["kinematic", "plant"] {
            let option = format!("--kappa-max={kappa}");
            let output = cfmmr(folder.path(), &["--starts", "1", "--model", model, &option]);
            let error = String::from_utf8_lossy(&output.stderr).to_lowercase();
            assert_eq!(output.status.code(), Some(2), "{kappa}: {error}");
            assert!(
                error.contains("--kappa-max") && error.contains(kappa),
                "{error}"
            );
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        }
    }
}
