//! A short soak: seven minutes of driving from goal to goal with all sensors and all noise (of two minutes a
//! drift cannot be told: what is driven in each is too different). The long one
//! is `cfmmr soak`.

use cfmmr::experiments::soak;
use host_sim::run::simulation::Simulation;

#[test]
fn health_does_not_drift_memory_does_not_grow_and_every_goal_is_reached() {
    let mut pieces = 0;
    let scenario = soak::scenario(Some("ideal"), true).unwrap();
    let mut robot = Simulation::new(&scenario, 5, 0).unwrap();
    let report = soak::run(&mut robot, &scenario, (400_000, 4, 5), &mut || {
        pieces += 1;
        true
    })
    .unwrap();
    assert_eq!(pieces, soak::pieces());
    assert!(report.problems().is_empty(), "{:?}", report.problems());
    // Below 3: the filter allows for the play of gears and for errors of a calibration, and these have none.
    let nis = report.nis.unwrap().mean;
    assert!((0.05..3.0).contains(&nis), "{nis}");
    for window in &report.windows {
        assert!(
            window.reached > 0 && window.resident_kib.unwrap() > 1000,
            "{window:?}"
        );
        // The floor may take the robot along by 1.5 % of its way.
        assert!(
            window.sigma_m < 1.2 && window.sigma_rad < 0.25,
            "{window:?}"
        );
        assert!(window.relative_m < 3e-3, "{window:?}");
        assert!(window.nees.unwrap() > 0.005, "{window:?}");
    }
}
