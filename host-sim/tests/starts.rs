//! Posture regulation from random starts: success and the curvature bound.

use core_algos::control::kinematic::LimitsConfig;
use core_algos::control::regulator::{Config, Strategy};
use host_sim::run::kinematic_model::{Model, Trial, random_start, regulate};
use host_sim::run::regulate;
use host_sim::scenario::Scenario;
use rayon::prelude::*;

/// Drives the model from a start to the origin.
fn bring_home(strategy: Strategy, model: Model, start: [f64; 3], seed: u64, trial: u64) -> Trial {
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

/// The model with a bound of its curvature, 1/m.
fn bounded(kappa_max: f64) -> Model {
    Model {
        max_steering_rad: Model::default().steering(kappa_max),
        ..Model::default()
    }
}

#[test]
fn kinematic_starts_all_come_home_within_the_bound() {
    for kappa_max in [1.5, 2.5, 3.3] {
        let drive = |index: u64| {
            let start = random_start(5, index);
            bring_home(Strategy::Funnel, bounded(kappa_max), start, 5, index)
        };
        let trials: Vec<Trial> = (0..150).into_par_iter().map(drive).collect();
        assert!(
            trials
                .iter()
                .all(|trial| trial.success && trial.time_s < 30.0)
        );
        assert!(
            trials
                .iter()
                .filter(|trial| trial.distance_m >= 3e-3)
                .count()
                <= 7
        );
        // Used, and never exceeded.
        let largest = trials
            .iter()
            .map(|trial| trial.max_curvature)
            .fold(0.0, f64::max);
        assert!((0.8..=1.0).contains(&(largest / kappa_max)), "{largest}");
        // No path of the bound is shorter than the shortest, but for the last millimetres.
        let ratio = trials
            .iter()
            .map(|trial| trial.length_m / trial.shortest_m)
            .sum::<f64>()
            / 150.0;
        assert!((0.99..1.1).contains(&ratio), "{ratio}");
        assert!(trials.iter().all(|trial| trial.planning_ticks <= 60));
    }
}

#[test]
fn starts_of_the_whole_robot_come_home_within_the_bound() {
    let kappa_max = 1.5;
    for index in 0..6 {
        let mut scenario = Scenario::default();
        scenario.mission.start = random_start(5, index);
        let model = Model::of_robot(&scenario.robot);
        scenario.robot.limits.max_steering_rad = model.steering(kappa_max) as f32;
        let outcome = regulate::regulate(&scenario, 5, index, |_| {}).unwrap();
        assert!(outcome.done && outcome.duration_s < 30.0, "{outcome:?}");
        for largest in [
            outcome.max_curvature,
            outcome.max_path_curvature,
            outcome.max_commanded_curvature,
        ] {
            assert!(largest <= kappa_max, "{outcome:?}");
        }
    }
}

#[test]
fn a_wandering_estimate_and_a_wrong_curvature_are_survived() {
    let disturbed = Model {
        position_noise_m: 0.002,
        heading_noise_rad: 0.005,
        curvature_gain: 0.95,
        curvature_offset_1_m: 0.05,
        ..bounded(3.0)
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
        let trial = bring_home(strategy, bounded(3.0), [-1.342, -1.342, 0.0], 0, 0);
        assert!(trial.success, "{trial:?}");
        assert!(trial.length_m < 1.1 * trial.shortest_m, "{trial:?}");
    }
}

/// Figures of a trial against those computed from the log of its states.
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
