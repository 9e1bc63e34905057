use super::*;
use crate::fusion::testing::{Matrix, Random, random_covariance, wide};
use crate::math::matrix::diagonal;

const SIGMAS: [f32; N] = [0.02, 0.03, 0.04, 0.5, 1.0, 3.0, 2.0];

/// Compares each entry with its expected value, relative to the standard deviations.
fn assert_near(found: &Covariance, expected: &Matrix<N, N>, slack: f64) {
    for (i, j) in (0..N * N).map(|k| (k / N, k % N)) {
        let scale = (expected[i][i] * expected[j][j]).sqrt();
        for entry in [f64::from(found.entry(i, j)), found.wide_matrix()[i][j]] {
            assert!(
                (entry - expected[i][j]).abs() <= slack * scale,
                "{i} {j} {entry:e}"
            );
        }
    }
}

#[test]
fn variance_above_the_limit_is_scaled_back_by_its_upkeep_part_alone() {
    for state in 0..N {
        for part in 0..UPKEEP {
            let mut sigmas = SIGMAS;
            sigmas[state] = 3e3;
            let before = random_covariance(&mut Random::new(state as u64), sigmas, 0.3);
            let mut covariance = Covariance::from_matrix(&before);
            let kept = covariance;
            covariance.keep_up(part);
            let mut expected = wide(&before);
            if part == state {
                let shrink = 1e3 / expected[state][state].sqrt();
                assert!(shrink < 1.0);
                for j in 0..N {
                    expected[state][j] *= shrink;
                    expected[j][state] *= shrink;
                }
                assert_near(&covariance, &expected, 1e-5);
            } else {
                assert_eq!(covariance, kept, "{state} {part}");
            }
        }
    }
}

/// Parts of the upkeep that the tests run: the eight parts that do something, and one that does nothing.
const UPKEEP: usize = N + 2;

/// One motion state of (v, v̇) and one of (φ̇, φ̈) each, by index in the whole state.
const TIES: [[usize; 2]; 4] = [[3, 4], [3, 6], [4, 5], [5, 6]];

#[test]
fn coupling_below_a_millionth_is_removed_by_its_upkeep_part() {
    for ([i, j], (correlation, stays)) in TIES
        .into_iter()
        .flat_map(|tie| [1e-3f32, 2e-6, 5e-7, 1e-9].map(|c| (tie, (c, c > 1e-6))))
    {
        let mut matrix = diagonal(SIGMAS.map(|sigma| sigma * sigma));
        let entry = correlation * SIGMAS[i] * SIGMAS[j];
        (matrix[i][j], matrix[j][i]) = (entry, entry);
        let mut covariance = Covariance::from_matrix(&matrix);
        assert!(covariance.is_coupled());
        for part in (0..UPKEEP).filter(|&part| part != N) {
            let before = covariance;
            covariance.keep_up(part);
            assert_eq!(covariance, before);
        }
        covariance.keep_up(N);
        assert_eq!(covariance.is_coupled(), stays, "{i} {j} {correlation}");
        let found = covariance.entry(i, j);
        let expected = if stays { entry } else { 0.0 };
        assert!((found - expected).abs() <= 1e-5 * expected, "{found:e}");
        let mut others = matrix;
        (others[i][j], others[j][i]) = (found, found);
        assert_near(&covariance, &wide(&others), 1e-6);
    }
    assert!(!Covariance::from_matrix(&diagonal([1.0; N])).is_coupled());
}

#[test]
fn states_without_a_finite_positive_variance_get_zero_and_others_keep_theirs() {
    for (state, bad) in
        (0..N).flat_map(|k| [0.0, -1.0, f32::INFINITY, f32::NAN].map(|bad| (k, bad)))
    {
        let mut matrix = random_covariance(&mut Random::new(5), SIGMAS, 0.3);
        for k in 0..N {
            (matrix[state][k], matrix[k][state]) = (0.0, 0.0);
        }
        let expected = wide(&matrix);
        matrix[state][state] = bad;
        let covariance = Covariance::from_matrix(&matrix);
        assert!(covariance.is_finite());
        assert_near(&covariance, &expected, 1e-5);
    }
}

#[test]
fn covariance_is_finite_if_every_part_is() {
    let sound = Covariance::from_matrix(&random_covariance(&mut Random::new(5), SIGMAS, 0.3));
    assert!(sound.is_finite());
    for spoil in [
        |p: &mut Covariance| p.motion[1][2] = f32::NAN,
        |p: &mut Covariance| p.follow[1][2] = f32::INFINITY,
        |p: &mut Covariance| p.own[1][2] = f32::NAN,
    ] {
        let mut covariance = sound;
        spoil(&mut covariance);
        assert!(!covariance.is_finite());
    }
}

/// Position noise along one direction has no variance across this direction. Rounding must not make that variance
/// negative.
#[test]
fn position_noise_along_one_line_makes_no_pivot_negative() {
    for k in 0..200u8 {
        let (sin, cos) = crate::math::trig::sin_cos(0.03 * f32::from(k));
        let mut covariance = Covariance::ZERO;
        covariance.add(&[[0.0; N]; N]);
        for _ in 0..3 {
            covariance.add_model_noise(0.0, [0.0; 2], [cos, sin], [0.7, 0.0, 0.0]);
            assert!((0..N).all(|state| covariance.pivot(state) >= 0.0), "{k}");
            let expected = [[cos * cos, cos * sin], [sin * cos, sin * sin]];
            let scale = covariance.entry(X, X) + covariance.entry(Y, Y);
            for (i, j) in [(0, 0), (0, 1), (1, 1)] {
                let error = covariance.entry(i, j) / scale - expected[i][j];
                assert!(error.abs() < 1e-5, "{k} {i} {j}");
            }
        }
    }
}
