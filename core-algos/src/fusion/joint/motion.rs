//! Linear part of the motion of a tick.

use super::{FIRST, N, REL, REL_PHI};
use crate::fusion::constants;
use crate::math::Posture;
use crate::math::matrix::{Mat, Mat3};

/// Derivatives of the error of an axle's odometric increment.
pub(super) struct IncrementError {
    pub(super) by_constants: Mat<3, { constants::COUNT }>,
    pub(super) by_heading: [f32; 3],
}

impl IncrementError {
    /// Error of the increment due to errors of the states; only nonzero derivatives are summed.
    fn of<const AXLE: usize>(&self, states: &[f32; N]) -> [f32; 3] {
        let error = constants::error_by::<AXLE>(&self.by_constants, |k| states[(FIRST + k) % N]);
        core::array::from_fn(|i| error[i] + self.by_heading[i] * states[REL_PHI])
    }
}

/// Linear part of a tick's motion (F); states that do not change have no row here.
pub(super) struct Motion {
    pub(super) front_error: IncrementError,
    pub(super) rear_error: IncrementError,
    pub(super) by_rear: Mat3,
    pub(super) turn_back: Mat3,
    pub(super) by_relative: Mat3,
    pub(super) by_front: Mat3,
    pub(super) by_base: Mat3,
}

impl Motion {
    /// Errors of the rear axle's posture and of the relative posture after the tick, from the errors of all states
    /// before the tick.
    pub(super) fn apply(&self, states: &[f32; N]) -> [f32; 6] {
        let front = self.front_error.of::<0>(states);
        let rear = self.rear_error.of::<1>(states);
        let [x, y, phi, ahead, aside, turned, ..] = *states;
        let mut moved = [0.0; 6];
        // The loop leaves out the last row of each matrix, (0, 0, 1), which keeps the heading error.
        for i in 0..2 {
            moved[i] = row_times_column(&self.by_rear[i], &[x, y, phi])
                + row_times_column(&self.turn_back[i], &rear);
            moved[REL + i] = row_times_column(&self.by_relative[i], &[ahead, aside, turned])
                + row_times_column(&self.by_front[i], &front)
                + row_times_column(&self.by_base[i], &rear);
        }
        moved[2] = phi + rear[2];
        moved[REL_PHI] = turned + front[2] - rear[2];
        moved
    }
}

/// Product of a row and a column.
fn row_times_column(row: &[f32; 3], column: &[f32; 3]) -> f32 {
    row[0] * column[0] + row[1] * column[1] + row[2] * column[2]
}

/// Error of a posture `q` in a frame, due to an error of the frame along its own axes.
pub(super) fn carried(error: &[f32; 3], q: Posture) -> [f32; 3] {
    let [x, y, phi] = *error;
    [x - q.y * phi, y + q.x * phi, phi]
}

/// Covariance rotated by the angle with this sine and cosine: R C Rᵀ.
pub(super) fn turned(covariance: &Mat3, sin: f32, cos: f32) -> Mat3 {
    let [[xx, xy, xp], [_, yy, yp], [.., pp]] = *covariance;
    let (sin2, cos2) = (sin * sin, cos * cos);
    let both = 2.0 * sin * cos * xy;
    let xy = sin * cos * (xx - yy) + (cos2 - sin2) * xy;
    let (xx, yy) = (cos2 * xx + sin2 * yy - both, sin2 * xx + cos2 * yy + both);
    let (xp, yp) = (cos * xp - sin * yp, sin * xp + cos * yp);
    [[xx, xy, xp], [xy, yy, yp], [xp, yp, pp]]
}
