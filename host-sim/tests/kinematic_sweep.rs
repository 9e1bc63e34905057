//! Posture regulation from random starts on the kinematic model.

use core_algos::config::ConfigError;
use core_algos::control::kinematic::LimitsConfig;
use core_algos::control::regulator::{Config, Regulator, Strategy};
use host_sim::kinematic_model::{Model, Trial, random_start, regulate};
use rayon::prelude::*;

const STARTS: u64 = 200;

/// The regulator and the model for a curvature bound (1/m): the steering bound is what eq. 5 makes
/// of it.
fn for_curvature(
    config: Config,
    model: Model,
    kappa_max: f64,
) -> Result<(Regulator, Model), ConfigError> {
    let max_steering_rad = model.steering(kappa_max);
    let config = Config {
        limits: LimitsConfig {
            max_steering_rad: max_steering_rad as f32,
            frame_length_m: model.frame_length_m as f32,
            ..config.limits
        },
        ..config
    };
    let model = Model {
        max_steering_rad,
        ..model
    };
    Ok((config.build()?, model))
}

/// Posture regulation to the origin from `starts` random starts, in their order, whatever the
/// number of threads.
fn sweep(regulator: &Regulator, model: &Model, starts: u64, seed: u64) -> Vec<Trial> {
    (0..starts)
        .into_par_iter()
        .map(|index| {
            let start = random_start(seed, index);
            regulate(regulator, model, start, [0.0; 3], seed, index, |_, _, _| {})
        })
        .collect()
}

fn largest(trials: &[Trial], value: fn(&Trial) -> f64) -> f64 {
    trials.iter().map(value).fold(0.0, f64::max)
}

#[test]
fn every_start_is_regulated_within_the_curvature_bound() {
    for kappa_max in [1.5, 2.5, 3.3] {
        let (regulator, model) =
            for_curvature(Config::default(), Model::default(), kappa_max).unwrap();
        let trials = sweep(&regulator, &model, STARTS, 7);
        assert!(trials.iter().all(|trial| trial.success), "{kappa_max}");
        assert!(largest(&trials, |trial| trial.max_curvature) <= kappa_max * (1.0 + 1e-6));
        let sum = |value: fn(&Trial) -> f64| trials.iter().map(value).sum::<f64>();
        let ratio = sum(|trial| trial.length_m) / sum(|trial| trial.shortest_m);
        // Not below 1 by more than what a goal reached within millimetres saves.
        assert!((0.99..1.1).contains(&ratio), "{kappa_max}: {ratio}");
        let far = trials.iter().filter(|trial| trial.distance_m >= 3e-3);
        assert!(far.count() as u64 <= STARTS / 20, "{kappa_max}");
        assert!(largest(&trials, |trial| trial.planning_ticks.into()) <= 60.0);
    }
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
    let (regulator, model) = for_curvature(Config::default(), disturbed, 3.0).unwrap();
    let trials = sweep(&regulator, &model, STARTS, 8);
    assert!(trials.iter().filter(|trial| !trial.success).count() <= 1);
}

#[test]
fn threads_do_not_change_a_bit() {
    let (regulator, model) = for_curvature(
        Config::default(),
        Model {
            position_noise_m: 0.002,
            ..Model::default()
        },
        2.5,
    )
    .unwrap();
    let with = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| sweep(&regulator, &model, 20, 3))
    };
    assert_eq!(with(1), with(4));
}

#[test]
fn both_strategies_bring_the_papers_start_home() {
    for strategy in [Strategy::Funnel, Strategy::PaperLaw] {
        let config = Config {
            strategy,
            ..Config::default()
        };
        let (regulator, model) = for_curvature(config, Model::default(), 3.0).unwrap();
        let start = [-1.342, -1.342, 0.0];
        let trial = regulate(&regulator, &model, start, [0.0; 3], 0, 0, |_, _, _| {});
        assert!(trial.success, "{trial:?}");
        assert!(trial.length_m < 1.1 * trial.shortest_m, "{trial:?}");
    }
}
