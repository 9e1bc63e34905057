//! Posture regulation from random starts on the kinematic model.

use core_algos::control::regulator::{Config, Strategy};
use host_sim::kinematic_model::{Model, for_curvature, regulate, summarise, sweep};

const STARTS: u64 = 200;

#[test]
fn every_start_is_regulated_within_the_curvature_bound() {
    for kappa_max in [1.5, 2.5, 3.3] {
        let (regulator, model) =
            for_curvature(Config::default(), Model::default(), kappa_max).unwrap();
        let summary = summarise(&sweep(&regulator, &model, STARTS, 7));
        assert_eq!(summary.successes, summary.starts, "{summary:?}");
        assert!(
            summary.max_curvature <= kappa_max * (1.0 + 1e-6),
            "{summary:?}"
        );
        // Not below 1 by more than what a goal reached within millimetres saves.
        assert!((0.99..1.1).contains(&summary.length_ratio), "{summary:?}");
        assert!(summary.p95_distance_m < 3e-3, "{summary:?}");
        assert!(summary.max_planning_ticks <= 60, "{summary:?}");
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
    let summary = summarise(&sweep(&regulator, &model, STARTS, 8));
    assert!(summary.starts - summary.successes <= 1, "{summary:?}");
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
