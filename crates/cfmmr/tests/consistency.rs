//! Errors of the estimates against their covariance, for the whole robot on the plant.

use cfmmr::experiments::consistency::{ConsistencyReport, ConsistencyRow, Statement, measure};
use cfmmr::experiments::posture::Variant;
use cfmmr::experiments::{Seeds, Workers};
use core_algos::fusion::robot::Mode;
use host_sim::scenario::Scenario;

const SEEDS: Seeds = Seeds {
    seed: 21,
    trials: 20,
};

fn report() -> ConsistencyReport {
    // The estimators' priors are from the data sheets that describe this world.
    let scenario = Scenario::in_world(Some("ordinary")).unwrap();
    let workers = Workers::new(None).unwrap();
    let variant = |rps, imu, mode| Variant { rps, imu, mode };
    let variants = [
        variant(true, false, Mode::Joint),
        variant(true, true, Mode::Joint),
        variant(true, false, Mode::Intersection),
        variant(false, false, Mode::Odometry),
    ];
    measure(&workers, &scenario, SEEDS, &variants).unwrap()
}

/// NEES of both axles at the end of the runs.
fn axles(row: &ConsistencyRow) -> [f64; 2] {
    [row.end.front.nees, row.end.rear.nees]
}

#[test]
fn no_fusion_is_overconfident() {
    let report = report();
    let [joint, inertial, intersection, odometry] = &report.rows[..] else {
        panic!("four rows");
    };
    // Correct covariances: mean 3, standard deviation √(6/20) = 0.55. Halved covariances: mean 6.
    for row in [joint, inertial] {
        for nees in axles(row) {
            assert!(nees > 1.4 && nees < 4.6, "{} {nees}", row.imu);
        }
        for nees in &row.path_mean[..2] {
            assert!(*nees > 1.4 && *nees < 4.6, "{} path {nees}", row.imu);
        }
    }
    for row in [intersection, odometry] {
        assert_ne!(row.statement, Statement::Overconfident, "{:?}", axles(row));
    }
    // With a gyro the heading error is smaller.
    assert!(inertial.end.midpoint.rms[2] < joint.end.midpoint.rms[2]);
}
