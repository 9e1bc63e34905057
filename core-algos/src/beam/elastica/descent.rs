//! Descents of the fit: damped Gauss–Newton steps, each with at most one integration of the elastica.

use super::minimum::{Minimum, determines_load};
use super::ray::Parameters;
use super::{CONVERGED, Readings, Solver, bounded};
use crate::math::matrix::{cholesky, cholesky_solve};

/// Limit of the integrations of the elastica from one start.
const MAX_DESCENT: u8 = 10;
/// Predicted decrease of the cost below which the refinement, if one follows, replaces further steps.
const CLOSE: f32 = 4.0;

/// A descent from a start, with its lowest point so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Descent {
    pub(super) lowest: Minimum,
    pub(super) damping: f32,
    /// Number of steps, including the start.
    pub(super) steps: u8,
    pub(super) done: bool,
}

impl Solver {
    /// Runs a whole descent from `start`; returns its lowest point.
    pub(super) fn descend(
        &self,
        start: Parameters,
        readings: &Readings,
        evaluations: &mut u8,
    ) -> Option<Minimum> {
        let mut descent = self.start_at(start, readings, evaluations)?;
        while !descent.done {
            self.descend_once(&mut descent, readings, evaluations);
        }
        Some(descent.lowest)
    }

    /// Begins a descent: computes the shape of its start. `None` if the budget is used up or the shape is not finite.
    pub(super) fn start_at(
        &self,
        parameters: Parameters,
        readings: &Readings,
        evaluations: &mut u8,
    ) -> Option<Descent> {
        if *evaluations >= readings.budget {
            return None;
        }
        let shape = self.shape(parameters);
        let normal = self.normal(&shape, parameters, readings);
        *evaluations += 1;
        normal.cost.is_finite().then_some(Descent {
            lowest: Minimum {
                parameters,
                shape,
                normal,
                converged: false,
            },
            damping: 0.0,
            steps: 1,
            done: false,
        })
    }

    /// One damped Gauss–Newton step: at most one integration of the elastica.
    pub(super) fn descend_once(
        &self,
        descent: &mut Descent,
        readings: &Readings,
        evaluations: &mut u8,
    ) {
        let Descent {
            lowest,
            damping,
            steps,
            done,
        } = descent;
        if *evaluations >= readings.budget || *steps >= MAX_DESCENT {
            *done = true;
            return;
        }
        *steps += 1;
        let mut hessian = lowest.normal.hessian;
        for i in 0..3 {
            hessian[i][i] *= 1.0 + *damping;
        }
        let Some(factor) = cholesky(&hessian) else {
            *damping = 10.0 * *damping + 1e-3;
            return;
        };
        let step = cholesky_solve(&factor, &lowest.normal.descent);
        // Predicted decrease of the cost by the step, in squared standard deviations.
        let mut decrease = 0.0;
        for i in 0..3 {
            decrease += step[i] * lowest.normal.descent[i];
        }
        // The refinement that follows repeats this step, so the predicted cost is enough for comparisons. With a
        // large load the step is computed.
        let modest = lowest.parameters[1].abs() <= self.large_load();
        if *damping == 0.0 && modest && decrease < CLOSE && determines_load(&lowest.normal) {
            lowest.normal.cost -= decrease;
            (lowest.converged, *done) = (true, true);
            return;
        }
        let mut trial = lowest.parameters;
        for i in 0..3 {
            trial[i] += step[i];
        }
        let trial = bounded(trial);
        let shape = self.shape(trial);
        let normal = self.normal(&shape, trial, readings);
        *evaluations += 1;
        // The slack covers rounding in the sum of squares.
        if normal.cost <= lowest.normal.cost * (1.0 + 1e-5) + 1e-3 {
            (lowest.parameters, lowest.shape, lowest.normal) = (trial, shape, normal);
            *damping = if *damping > 1e-3 { 0.1 * *damping } else { 0.0 };
        } else {
            *damping = 10.0 * *damping + 1e-2;
        }
        if decrease < CONVERGED {
            (lowest.converged, *done) = (true, true);
        }
    }
}
