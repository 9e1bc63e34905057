//! Posture regulation from random starts: success and the curvature bound.

use cfmmr::experiments::campaign::study::random_start;
use host_sim::run::regulate;
use host_sim::run::regulate::curvature;
use host_sim::scenario::Scenario;

#[test]
fn random_starts_reach_the_goal_within_the_curvature_bound() {
    let kappa_max = 1.5;
    for index in 0..6 {
        let mut scenario = Scenario::default();
        scenario.mission.start = random_start(5, index);
        let geometry = scenario.robot.completed().geometry;
        let steps = (1..1500).map(|step| 1e-3 * f64::from(step));
        let within = steps.take_while(|&steering| curvature(&geometry, steering) <= kappa_max);
        scenario.robot.limits.max_steering_rad = within.last().unwrap() as f32;
        let outcome = regulate::regulate(&scenario, 5, index, |_| {}).unwrap();
        assert!(
            outcome.end.is_success() && outcome.end.duration_s < 30.0,
            "{outcome:?}"
        );
        for largest in [
            outcome.max_curvature,
            outcome.max_path_curvature,
            outcome.max_commanded_curvature,
        ] {
            assert!(largest <= kappa_max, "{outcome:?}");
        }
    }
}

/// Compares figures of a trial with figures computed from its records.
#[test]
fn figures_of_a_trial_agree_with_its_records() {
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
        steering = steering.max(0.5 * (record.frames[0].relative[2]).abs());
        commanded = commanded.max(f64::from(record.lead.motion.psi.0).abs());
    })
    .unwrap();
    // For a circular frame of arc length 0.37 m bent by 2ψ, κ = 2 sin ψ/(chord cos ψ).
    let kappa = |psi: f64| {
        let radius = 0.37 / (2.0 * psi);
        2.0 * psi.sin() / (2.0 * radius * psi.sin() * psi.cos())
    };
    assert!(outcome.end.is_success());
    assert!(
        (outcome.path_m - length).abs() < 2e-3,
        "{outcome:?} {length}"
    );
    assert!((outcome.max_commanded_curvature / kappa(commanded) - 1.0).abs() < 1e-6);
    // `outcome` has the maximum over all ticks, the records only every tenth tick, so the ratio is at least 1.
    let ratio = outcome.max_curvature / kappa(steering);
    assert!((1.0..1.01).contains(&ratio), "{ratio}");
    assert!((outcome.max_path_curvature / turning - 1.0).abs() < 0.02);
    // O follows the circle given by the frame's bend, so both curvatures agree.
    assert!((outcome.max_path_curvature / outcome.max_curvature - 1.0).abs() < 0.02);
}
