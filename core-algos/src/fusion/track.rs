//! A posture whose error has two parts: a random part, and the effect of errors that are constant throughout a drive.
//!
//! e = S c + ε: c are the [`CONSTANTS`] in units of their standard deviations, S is the posture's sensitivity to
//! them, ε the random rest with covariance R. The covariance of e is S Sᵀ + R.
//!
//! Covariance intersection assumes nothing about the correlation of its inputs. S holds the known part of the
//! correlation: axles that yaw against each other under the frame's moment, or a start error common to both. A fusion
//! is linear in its inputs, so S passes through it exactly. The fused covariance P is an upper bound of the true
//! covariance, so P − S Sᵀ is an upper bound of the covariance of ε.
//!
//! Nothing here panics; NaN propagates.

use super::Estimate;
use super::compound::Chain;
use super::constants;
use super::intersection::Intersection;
use crate::math::Posture;
use crate::math::matrix::{self, Mat, Mat3};

/// Index of the start errors: posture of O (3), posture of the front axle seen from the rear axle (3).
pub const START: usize = 0;
/// Index of the constants of [`super::constants`].
pub const SHARED: usize = START + 6;
/// Index of the slip of front and rear under an unmeasured load of the frame: along, across, in heading (3 each).
pub const LOAD: usize = SHARED + constants::COUNT;
/// Index of the displacement of both axles by the floor, along the floor's x and y.
pub const DRIFTED: usize = LOAD + 6;
/// Number of constants.
pub const CONSTANTS: usize = DRIFTED + 2;

/// Effect of one standard deviation of each constant on a posture (m, m, rad).
pub type Sensitivity = Mat<3, CONSTANTS>;

/// Smallest variance of the random part: (10 µm)², (10 µrad)².
const FLOOR: f32 = 1e-10;

/// A posture with both parts of its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    /// The posture (m, m, rad).
    pub posture: Posture,
    /// R: covariance of the random part.
    pub random: Mat3,
    /// S: effect of the constants on the posture.
    pub constants: Sensitivity,
}

impl Track {
    /// A posture whose error comes from the constants alone.
    pub fn new(posture: Posture, constants: Sensitivity) -> Self {
        Self {
            posture,
            random: matrix::diagonal([FLOOR; 3]),
            constants,
        }
    }

    /// A posture whose error is all random.
    pub fn random(estimate: Estimate) -> Self {
        Self {
            posture: estimate.posture,
            random: estimate.covariance,
            constants: [[0.0; CONSTANTS]; 3],
        }
    }

    /// The posture with the covariance of its whole error.
    pub fn estimate(&self) -> Estimate {
        Estimate::new(
            self.posture,
            matrix::add(&self.random, &outer(&self.constants)),
        )
    }

    /// Posture that `chain` computes with this posture as its base. `relative` is the relative posture of the chain,
    /// with its error.
    pub fn propagated(&self, chain: &Chain, relative: &Track) -> Self {
        Self {
            posture: chain.posture,
            random: matrix::add(
                &matrix::propagate(&chain.by_base, &self.random),
                &matrix::propagate(&chain.by_relative, &relative.random),
            ),
            constants: matrix::add(
                &matrix::multiply(&chain.by_base, &self.constants),
                &matrix::multiply(&chain.by_relative, &relative.constants),
            ),
        }
    }

    /// Covariance intersection of `self` and `other`, and the weight of `self`. `None` if a covariance is not positive
    /// definite or a number not finite.
    pub fn intersect(&self, other: &Self, intersection: &Intersection) -> Option<(Self, f32)> {
        let b = other.estimate();
        let fused = intersection.fuse(&self.estimate(), &b)?;
        let omega = fused.omega;
        if omega >= 1.0 {
            return Some((*self, omega));
        }
        if omega <= 0.0 {
            return Some((*other, omega));
        }
        let p = fused.estimate.covariance;
        // The gain of b is (1 − ω) P B⁻¹.
        let factor = matrix::cholesky(&b.covariance)?;
        let mut gain = p.map(|row| matrix::cholesky_solve(&factor, &row));
        gain = matrix::scale(&gain, 1.0 - omega);
        let gap = matrix::add(&other.constants, &matrix::scale(&self.constants, -1.0));
        let constants = matrix::add(&self.constants, &matrix::multiply(&gain, &gap));
        let random = matrix::add(&p, &matrix::scale(&outer(&constants), -1.0));
        let fused = if matrix::cholesky(&random).is_some() {
            Self {
                posture: fused.estimate.posture,
                random,
                constants,
            }
        } else {
            // Rounding has made R indefinite, so the whole covariance counts as random.
            Self::random(fused.estimate)
        };
        Some((fused, omega))
    }
}

/// S Sᵀ.
fn outer(constants: &Sensitivity) -> Mat3 {
    let mut out = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in i..3 {
            let mut sum = 0.0;
            for k in 0..CONSTANTS {
                sum += constants[i][k] * constants[j][k];
            }
            out[i][j] = sum;
            out[j][i] = sum;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::intersection::{Config, Criterion};
    use crate::fusion::testing::{covariance_error, wide};
    use proptest::prelude::*;

    type Column = [f32; 3];

    fn track() -> impl Strategy<Value = Track> {
        (
            (-2.0f32..2.0, -2.0f32..2.0, -3.1f32..3.1),
            proptest::array::uniform3(proptest::array::uniform3(-0.02f32..0.02)),
            proptest::array::uniform3(proptest::collection::vec(-0.02f32..0.02, CONSTANTS)),
        )
            .prop_map(|((x, y, phi), root, constants)| {
                let unit = matrix::diagonal([1e-5; 3]);
                let spread = matrix::propagate(&root, &matrix::identity());
                Track {
                    posture: Posture::new(x, y, phi),
                    random: matrix::add(&spread, &unit),
                    constants: constants.map(|row| core::array::from_fn(|k| row[k])),
                }
            })
    }

    fn intersection(criterion: Criterion) -> Intersection {
        Config {
            criterion,
            ..Config::default()
        }
        .build()
        .unwrap()
    }

    properties! {
        /// If a constant shifts both inputs, the fused posture shifts by its stored sensitivity to that constant.
        #[test]
        fn fused_posture_shifts_by_its_stored_sensitivity(
            a in track(), mut b in track(), k in 0usize..CONSTANTS, trace in proptest::bool::ANY,
        ) {
            b.posture = a.posture;
            let criterion = if trace { Criterion::Trace } else { Criterion::Determinant };
            let intersection = intersection(criterion);
            let shifted = |t: &Track, by: f32| {
                let d: Column = [0, 1, 2].map(|i| by * t.constants[i][k]);
                let p = t.posture;
                Track {
                    posture: Posture::new(p.x + d[0], p.y + d[1], p.phi + d[2]),
                    ..*t
                }
            };
            let at = |by| {
                shifted(&a, by).intersect(&shifted(&b, by), &intersection).unwrap().0
            };
            let fused = at(0.0);
            let moved = at(1.0).posture.minus(fused.posture);
            for i in 0..3 {
                prop_assert!((moved[i] - fused.constants[i][k]).abs() < 2e-4, "{i} {moved:?}");
            }
        }

        #[test]
        fn fused_parts_add_up_to_the_whole_covariance(a in track(), b in track()) {
            let intersection = intersection(Criterion::Determinant);
            let (fused, omega) = a.intersect(&b, &intersection).unwrap();
            let plain = intersection.fuse(&a.estimate(), &b.estimate()).unwrap();
            prop_assert_eq!(omega, plain.omega);
            let whole = fused.estimate().covariance;
            prop_assert!(covariance_error(&plain.estimate.covariance, &wide(&whole)) < 1e-4);
            prop_assert!(matrix::cholesky(&fused.random).is_some());
        }
    }

    /// Two axles yaw against each other at an unknown rate, each increment a little noisy.
    fn chase(criterion: Criterion) -> Track {
        let intersection = intersection(criterion);
        let mut axles = [Track::new(Posture::ORIGIN, [[0.0; CONSTANTS]; 3]); 2];
        for _ in 0..500 {
            for (axle, sign) in axles.iter_mut().zip([-1.0, 1.0]) {
                axle.constants[2][SHARED + constants::COMPLIANCE] += sign * 1e-3;
                axle.random = matrix::add(&axle.random, &matrix::diagonal([1e-9; 3]));
            }
            let [front, rear] = axles;
            axles = [
                front.intersect(&rear, &intersection).unwrap().0,
                rear.intersect(&front, &intersection).unwrap().0,
            ];
        }
        axles[0]
    }

    #[test]
    fn opposite_yaw_of_both_axles_cancels() {
        // Each axle by itself would turn by 0.5 rad.
        let track = chase(Criterion::Trace);
        let turned = track.constants[2][SHARED + constants::COMPLIANCE];
        assert!(turned.abs() < 0.02, "{track:?}");
    }

    #[test]
    fn dominating_input_is_returned_bit_identical() {
        let spread = |size: f32| {
            let mut track = Track::random(Estimate::with_sigmas(Posture::ORIGIN, [1e-3 * size; 3]));
            track.constants = [0, 1, 2].map(|i| {
                core::array::from_fn(|k| size * 0.01 * crate::math::trig::sin((7 * i + k) as f32))
            });
            track
        };
        let (good, bad) = (spread(1.0), spread(10.0));
        for criterion in [Criterion::Determinant, Criterion::Trace] {
            let intersection = intersection(criterion);
            assert_eq!(good.intersect(&bad, &intersection), Some((good, 1.0)));
            assert_eq!(bad.intersect(&good, &intersection), Some((good, 0.0)));
        }
    }

    #[test]
    fn sensitivities_are_dropped_if_the_random_part_would_be_indefinite() {
        let intersection = intersection(Criterion::Determinant);
        let mut given_up = 0;
        for k in 0..50 {
            let mut a = Track::random(Estimate::with_sigmas(Posture::ORIGIN, [1e-3; 3]));
            a.constants[0][0] = 1e3 + 10.0 * k as f32;
            let mut b = a;
            b.random = matrix::diagonal([1e-6, 0.5e-6, 2e-6]);
            let (fused, _) = a.intersect(&b, &intersection).unwrap();
            assert!(matrix::cholesky(&fused.random).is_some());
            let square = a.constants[0][0] * a.constants[0][0];
            assert!((fused.estimate().covariance[0][0] / square - 1.0).abs() < 1e-3);
            given_up += u32::from(fused.constants == [[0.0; CONSTANTS]; 3]);
        }
        assert!(given_up > 0);
    }
}
