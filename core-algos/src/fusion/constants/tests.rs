use super::*;
use crate::beam::sensor::{Method, PostureSolver};
use crate::beam::strip;

const TYRES: Tyres = Tyres {
    half_track: 0.162,
    compliance: 0.09,
    sliding: 2.4,
};

fn step(axle: usize, gyro_share: f32) -> IncrementInputs {
    IncrementInputs {
        axle,
        moved: Posture::new(0.4, 0.02, 0.3),
        relative_heading: RelativeHeading(0.5),
        dt: 2.0,
        gyro_share,
    }
}

/// A step without a gyro: frame bent by `heading`, `x` ahead, turn `phi`.
fn bent(axle: usize, x: f64, phi: f64, heading: f64) -> IncrementInputs {
    IncrementInputs {
        moved: Posture::new(x as f32, 0.0, phi as f32),
        relative_heading: RelativeHeading(heading as f32),
        ..step(axle, 0.0)
    }
}

/// Heading error of an increment of 2 s if `constant` is 1 and the other constants are 0.
fn heading(axle: usize, gyro_share: f32, constant: usize) -> f32 {
    step(axle, gyro_share).by_constants(&TYRES)[2][constant]
}

#[test]
fn heading_error_comes_from_the_sensor_that_measures_the_heading() {
    for axle in 0..2 {
        assert_eq!(heading(axle, 0.0, DRIFT + axle), 0.4);
        assert_eq!(heading(axle, 0.0, TURN + axle), 0.3);
        assert_eq!(heading(axle, 0.0, GYRO_BIAS + axle), 0.0);
        assert_eq!(heading(axle, 1.0, DRIFT + axle), 0.0);
        assert_eq!(heading(axle, 1.0, COMPLIANCE), 0.0);
        assert_eq!(heading(axle, 1.0, GYRO_BIAS + axle), 2.0);
        assert_eq!(heading(axle, 1.0, GYRO_SCALE + axle), 0.3);
        // A gyro present half of the time halves each effect.
        assert_eq!(heading(axle, 0.5, DRIFT + axle), 0.2);
        assert_eq!(heading(axle, 0.5, GYRO_BIAS + axle), 1.0);
    }
}

#[test]
fn axles_share_only_the_constants_of_slip_under_the_frame_moment() {
    for constant in 0..COUNT {
        let both = [0, 1].map(|axle| {
            let by = step(axle, 0.5).by_constants(&TYRES);
            [0, 1, 2].map(|i| by[i][constant])
        });
        let [front, rear] = both;
        if constant == COMPLIANCE {
            assert_eq!(front, rear.map(|by| -by));
            assert!(rear[2] > 0.0);
        } else if constant == COMPLIANCE + 1 {
            assert_eq!(front, rear);
            assert!(rear[2] < 0.0);
        } else {
            assert!(front == [0.0; 3] || rear == [0.0; 3], "{constant}");
        }
    }
}

/// Reference: advance and turn of an axle from force and slip of each wheel by the brush model.
#[test]
fn increment_error_equals_the_brush_model_of_each_wheel() {
    let (track, load, stiffness, friction, moment) = (0.324f64, 23.35, 20.0, 0.7, 2.25);
    let tyres = Tyres {
        half_track: 0.162,
        compliance: (moment / (0.5 * track * track * load * stiffness)) as f32,
        sliding: (track * friction * load / moment) as f32,
    };
    for (x, phi) in [(0.3, 0.1), (0.0, 0.4), (-0.2, 0.3)] {
        for heading in [-0.9f64, 0.2, 0.9] {
            for (axle, sign) in [(0, -1.0), (1, 1.0)] {
                // Force on the right tyre against the moment; the force on the left tyre is opposite.
                let force = -sign * moment * heading / track;
                let slip = |force: f64, rolled: f64| {
                    let small = -force * f64::abs(rolled) / (load * stiffness);
                    small / (1.0 - force.abs() / (friction * load))
                };
                let [left, right] = [
                    slip(-force, x - 0.5 * track * phi),
                    slip(force, x + 0.5 * track * phi),
                ];
                let step = bent(axle, x, phi, heading);
                let (error, _) = step.error(&tyres, &step.by_constants(&tyres), &[0.0; COUNT]);
                let case = format!("{axle} {x} {phi} {heading}: {error:?}");
                let ahead = 0.5 * (left + right);
                let turn = (right - left) / track;
                assert!((f64::from(error[0]) - ahead).abs() < 1e-7, "{case} {ahead}");
                assert!((f64::from(error[2]) - turn).abs() < 1e-7, "{case} {turn}");
            }
        }
    }
}

/// Reference: each wheel with its own error of radius and tyre slip.
#[test]
fn increment_error_equals_that_of_unequal_wheels_and_tyres() {
    let (half_track, own) = (f64::from(TYRES.half_track), [0.03, -0.01]);
    let radius = [0.004, -0.002];
    for (x, phi) in [(0.3, 0.1), (0.0, 0.4), (-0.2, 0.3)] {
        for (heading, axle) in [(-0.9f64, 0), (0.2, 1), (0.9, 0), (-0.6, 1)] {
            let load = heading / (1.0 - heading.abs() / f64::from(TYRES.sliding));
            let sign = if axle == 0 { -1.0 } else { 1.0 };
            // Errors of the distances rolled by the left and the right wheel.
            let [left, right]: [f64; 2] = core::array::from_fn(|side| {
                let out = if side == 0 { -1.0 } else { 1.0 };
                let rolled: f64 = x + out * half_track * phi;
                let slip = (f64::from(TYRES.compliance) + own[side]) * load * half_track;
                radius[side] * rolled + out * sign * slip * rolled.abs()
            });
            let step = bent(axle, x, phi, heading);
            let mut constants = [0.0; COUNT];
            let mean = 0.5 * (radius[0] + radius[1]);
            constants[SCALE + axle] = mean as f32;
            constants[TURN + axle] = mean as f32;
            constants[DRIFT + axle] = (0.5 * (radius[1] - radius[0]) / half_track) as f32;
            constants[COMPLIANCE] = (0.5 * (own[0] + own[1])) as f32;
            constants[UNEVEN + axle] = (0.5 * (own[1] - own[0])) as f32;
            let (error, _) = step.error(&TYRES, &step.by_constants(&TYRES), &constants);
            let case = format!("{axle} {x} {phi} {heading}: {error:?}");
            let (ahead, turn) = (0.5 * (left + right), 0.5 * (right - left) / half_track);
            assert!((f64::from(error[0]) - ahead).abs() < 1e-7, "{case} {ahead}");
            assert!((f64::from(error[2]) - turn).abs() < 3e-7, "{case} {turn}");
        }
    }
}

/// Relative headings below and above the limit of the friction share. At the limit the slope jumps, and the reference
/// is a difference from above.
#[test]
fn error_follows_the_relative_heading_by_its_derivative() {
    let tyres = Tyres {
        sliding: 1.0,
        ..TYRES
    };
    let mut constants = [0.0; COUNT];
    constants[COMPLIANCE..GYRO_BIAS].copy_from_slice(&[0.03, 0.02, 0.05, -0.04]);
    for (axle, x, phi) in [(0, 0.3, 0.1), (1, 0.3, 0.1), (0, 0.02, 0.4), (1, -0.2, 0.4)] {
        let error = |heading: f64| {
            let step = bent(axle, x, phi, heading);
            step.error(&tyres, &step.by_constants(&tyres), &constants)
        };
        for heading in [-1.4f64, -0.75, -0.6, 0.0, 0.3, 0.65, 0.7, 0.9, 1.2] {
            let (_, by_heading) = error(heading);
            let (low, high) = match heading == 0.7 {
                true => (heading, heading + 0.02),
                false => (heading - 0.01, heading + 0.01),
            };
            let (low, high) = (error(low).0, error(high).0);
            for i in 0..3 {
                let found = (high[i] - low[i]) / 0.02;
                let slack = 2e-5 + 0.02 * by_heading[i].abs();
                assert!(
                    (found - by_heading[i]).abs() < slack,
                    "{axle} {heading} {i}"
                );
            }
        }
    }
}

#[test]
fn distance_rolled_is_the_mean_of_both_wheels_without_sign() {
    for (x, phi) in [
        (0.4, 0.3),
        (-0.4, 0.3),
        (0.02, 0.3),
        (-0.02, -0.3),
        (0.0, 0.3),
    ] {
        let d = f64::from(TYRES.half_track) * phi;
        let mean_distance = 0.5 * (f64::abs(x - d) + f64::abs(x + d));
        assert!(
            (f64::from(bent(0, x, phi, 0.0).mean_distance(&TYRES)) - mean_distance).abs() < 1e-7
        );
    }
}

#[test]
fn axle_index_above_one_counts_as_the_rear() {
    let [rear, other] = [1, 2].map(|axle| {
        let step = step(axle, 0.5);
        let by = step.by_constants(&TYRES);
        (by, step.error(&TYRES, &by, &[0.01; COUNT]))
    });
    assert_eq!(rear, other);
}

/// Covers the series for small angles and the quotient for large angles.
#[test]
fn shortening_is_half_the_logarithmic_derivative_of_sinc() {
    for k in 1..=150 {
        let a = 0.01 * f64::from(k);
        let exact = 0.5 * (1.0 / a.tan() - 1.0 / a);
        for sign in [-1.0, 1.0] {
            let found = f64::from(shortening((sign * a) as f32));
            assert!((found - sign * exact).abs() < 5e-7, "{a} {found} {exact}");
        }
    }
    assert_eq!(shortening(0.0), 0.0);
}

/// Reference: the sensor's posture from strains with an added error, constant or rising from root to tip, absolute or
/// proportional to the relative heading.
#[test]
fn beam_derivatives_equal_those_of_the_sensor_with_changed_zeros_and_gains() {
    let config = strip::Config::default();
    let built = config.build().unwrap();
    let solver = PostureSolver::new(built, Method::Quadrature, 100).unwrap();
    let (length, half) = (config.length_m, config.half_thickness_m);
    for heading in [-1.2f32, -0.4, 0.0, 0.1, 0.7, 1.6] {
        let at = |change: &dyn Fn(f32) -> f32| {
            let mut strain = [0.0; crate::beam::MAX_GAUGES];
            for (strain, gauge) in strain.iter_mut().zip(config.gauges_m.iter()) {
                *strain = half * (heading / length + change(gauge - 0.5 * length));
            }
            let solution = solver.solve(&strain, built.gauges()).unwrap();
            solution.relative.posture
        };
        let step = 2e-2;
        let tilt = 12.0 / (length * length * length);
        let changes: [&dyn Fn(f32) -> f32; OF_BEAM] = [
            &|_| step / length,
            &|s| step * tilt * length * s,
            &|_| step * heading / length,
            &|s| step * heading * tilt * length * s,
        ];
        let by = beam_by_constants(at(&|_| 0.0));
        for (k, change) in changes.into_iter().enumerate() {
            let moved = at(change).minus(at(&|s| -change(s)));
            let size = if k % 2 == 0 { step } else { step * length };
            for i in 0..3 {
                let found = moved[i] / (2.0 * size);
                let error = (found - by[i][k]).abs();
                // The derivatives by tilt are exact only for a straight strip.
                let slack = match k % 2 {
                    0 => 2e-4,
                    _ => 0.03 * heading * heading,
                };
                assert!(error < slack + 2e-4, "{heading} {k} {i}: {error}");
            }
        }
    }
}
