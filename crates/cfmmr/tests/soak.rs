//! Short soak: 400 s of driving from goal to goal with all sensors and all noise. In shorter runs, the motions of the
//! windows differ too much for a trend. `cfmmr soak` is the long soak.

use cfmmr::experiments::soak;
use host_sim::run::simulation::Simulation;

#[test]
fn short_soak_has_no_problems() {
    let mut pieces = 0;
    let scenario = soak::scenario(Some("ideal"), &[], true).unwrap();
    let mut robot = Simulation::new(&scenario, 5, 0).unwrap();
    let report = soak::run(&mut robot, &scenario, (400_000, 4, 5), &mut || {
        pieces += 1;
        true
    })
    .unwrap();
    assert_eq!(pieces, soak::pieces());
    assert!(report.problems().is_empty(), "{:?}", report.problems());
    // The NIS is below 3, because the filter allows for backlash and calibration errors, which this world lacks.
    let nis = report.nis.unwrap().mean;
    assert!((0.05..3.0).contains(&nis), "{nis}");
    for window in &report.windows {
        assert!(
            window.reached > 0 && window.resident_kib.unwrap() > 1000,
            "{window:?}"
        );
        // The filter allows for a floor drift of 1.5 % of the path.
        assert!(
            window.sigma_m < 1.2 && window.sigma_rad < 0.25,
            "{window:?}"
        );
        assert!(window.relative_m < 3e-3, "{window:?}");
        assert!(window.nees.unwrap() > 0.005, "{window:?}");
    }
}
