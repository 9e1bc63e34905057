//! Posture regulation by the whole loop on the plant: nodes, bus, sensors and frame.

use cfmmr::experiments::paper;
use cfmmr::experiments::posture::{Trial, Variant, summarize};
use host_sim::base::statistics::mean;
use host_sim::run::final_error::FinalError;
use host_sim::run::regulate::{Outcome, regulate};
use host_sim::scenario::Scenario;

fn trials(scenario: &Scenario, count: u64) -> Vec<(Outcome, FinalError)> {
    (0..count)
        .map(|trial| {
            let outcome = regulate(scenario, 11, trial, |_| {}).unwrap();
            let error = FinalError::of(outcome.midpoint, scenario.mission.goal);
            (outcome, error)
        })
        .collect()
}

fn mean_of(trials: &[(Outcome, FinalError)], pick: fn(&Outcome, &FinalError) -> f64) -> f64 {
    mean(&trials.iter().map(|(o, e)| pick(o, e)).collect::<Vec<_>>())
}

#[test]
fn relative_position_sensor_reduces_goal_errors() {
    let [without, with] = Variant::PAIR.map(|v| trials(&v.apply(&Scenario::default()), 6));
    for (outcome, error) in &with {
        assert!(outcome.end.is_success());
        assert!(
            error.e_m < 0.03 && error.heading_rad.abs() < 3f64.to_radians(),
            "{error:?}"
        );
    }
    let e = |trials| mean_of(trials, |_, error| error.e_m);
    let heading = |trials| mean_of(trials, |_, error| error.heading_rad.abs());
    let force = |trials| mean_of(trials, |outcome, _| outcome.force_rms_n);
    assert!(e(&with) < 0.01, "{}", e(&with));
    assert!(heading(&with) < 1.3f64.to_radians());
    assert!(e(&with) < 0.3 * e(&without));
    assert!(heading(&with) < 0.3 * heading(&without));
    assert!(force(&with) < 0.25 * force(&without));
}

#[test]
fn robot_reaches_its_goal_with_lost_and_late_messages() {
    let mut scenario = Scenario::default();
    scenario.world.bus.loss = 0.05;
    scenario.world.bus.latency_ms = 2;
    for (outcome, error) in trials(&scenario, 3) {
        assert!(outcome.end.is_success() && error.e_m < 0.03, "{error:?}");
    }
}

#[test]
fn robot_with_other_dimensions_reaches_its_goal() {
    let mut scenario = Scenario::default();
    scenario.robot.geometry.rigid_end_m = 0.03;
    scenario.world.plant.rigid_root_m = 0.03;
    scenario.world.plant.rigid_tip_m = 0.03;
    scenario.robot.geometry.wheel_radius_m = 0.06;
    scenario.world.plant.wheel_radius_m = [[0.06; 2]].into();
    for (outcome, error) in trials(&scenario, 3) {
        assert!(outcome.end.is_success() && error.e_m < 0.03, "{error:?}");
        assert!(error.heading_rad.abs() < 3f64.to_radians(), "{error:?}");
        assert!(outcome.force_rms_n < 2.0, "{}", outcome.force_rms_n);
    }
}

#[test]
fn every_variant_ends_at_its_goal() {
    for variant in Variant::ALL {
        let scenario = variant.apply(&Scenario::default());
        for (outcome, _) in trials(&scenario, 1) {
            assert!(outcome.end.is_success(), "{}", variant.label());
            let [dx, dy, _]: [f64; 3] = std::array::from_fn(|i| {
                outcome.end.estimate.unwrap()[i] - scenario.mission.goal[i]
            });
            assert!(dx.hypot(dy) < 0.05, "{}: {outcome:?}", variant.label());
        }
    }
}

/// Compares with Table 1 of the paper, assuming that the table is from six runs: means of equal sign and within three
/// standard errors, standard deviations within a factor of 2.5.
#[test]
fn paper_robot_has_the_figures_of_table_1() {
    let scenarios = paper::scenarios().unwrap();
    for ((scenario, variant), measured) in scenarios.iter().zip(paper::ROWS).zip(paper::TABLE_1) {
        let trials: Vec<Trial> = (0..60)
            .map(|trial| Trial {
                outcome: regulate(scenario, 7071, trial, |_| {}).unwrap(),
                ..Trial::default()
            })
            .collect();
        let simulated = paper::figures(&summarize(&variant, &trials, scenario.mission.goal));
        for ([mean, sd], [expected, spread]) in simulated.into_iter().zip(measured) {
            let label = format!(
                "{}: {mean} ±{sd}, measured {expected} ±{spread}",
                variant.label()
            );
            assert!(mean * expected > 0.0, "{label}");
            assert!(
                (mean - expected).abs() < 3.0 * spread / 6f64.sqrt(),
                "{label}"
            );
            assert!(sd < 2.5 * spread && sd > spread / 2.5, "{label}");
        }
    }
}

/// The law of an axle alone rolls away from the goal and returns to it again and again.
#[test]
fn goal_on_a_slope_is_reached_once_and_held() {
    for downhill in [0.0, 90.0, 180.0f64] {
        let mut scenario = Scenario::in_world(Some("careful")).unwrap();
        scenario.mission.rest_s = 20.0;
        scenario.world.plant.slope_rad = 3f64.to_radians();
        scenario.world.plant.downhill_rad = downhill.to_radians();
        let mut rest: Vec<(bool, [f64; 3])> = Vec::new();
        let outcome = regulate(&scenario, 31, 0, |record| {
            if record.lead.done || !rest.is_empty() {
                rest.push((record.lead.done, record.midpoint));
            }
        });
        let outcome = outcome.unwrap();
        assert!(outcome.end.is_success() && outcome.within, "{outcome:?}");
        assert!(rest.len() > 1900 && rest.iter().all(|(done, _)| *done));
        let start = rest[0].1;
        for (_, [x, y, _]) in rest {
            // Across the slope the tyres creep.
            let moved = (x - start[0]).hypot(y - start[1]);
            assert!(moved < 1.5e-3, "{downhill}: {moved}");
        }
    }
}
