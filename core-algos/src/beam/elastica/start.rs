//! Starts of a fit other than the polynomial's shape.

use super::ray::Parameters;
use super::{Solver, bounded};
use crate::beam::strip::MAX_GAUGES;
use crate::math::matrix::{cholesky, cholesky_solve};
use crate::math::trig::{cos, sinc, sqrt};

/// Axial compressions in units of EI/L² at which [`Solver::waves`] looks for a start.
const WAVE_LOADS: [f32; 10] = [0.0, 5.0, 12.0, 20.0, 30.0, 42.0, 55.0, 70.0, 88.0, 110.0];

/// Parameters of an earlier fit, from which the next fit starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start(pub(super) Parameters);

impl Solver {
    /// Starts from small-deflection theory. At a given axial load the curvature is a wave κ = a cos ωs + b sin ωs,
    /// with ω² the compression: one linear fit per load. Returns the best three, best first.
    pub(super) fn waves(
        &self,
        k: &[f32; MAX_GAUGES],
        weights: &[f32; MAX_GAUGES],
    ) -> [Parameters; 3] {
        let mut best = [(f32::INFINITY, [0.0; 3]); 3];
        for load in WAVE_LOADS {
            let omega = sqrt(load);
            // A very weak prior keeps the normal matrix regular.
            let mut hessian = [[1e-3, 0.0], [0.0, 1e-3]];
            let mut right = [0.0; 2];
            let mut rows = [[0.0; 2]; MAX_GAUGES];
            for i in 0..MAX_GAUGES {
                let s = 0.5 * self.strip.u[i];
                rows[i] = [cos(omega * s), s * sinc(omega * s)];
                for r in 0..2 {
                    right[r] += weights[i] * rows[i][r] * k[i];
                    for c in 0..2 {
                        hessian[r][c] += weights[i] * rows[i][r] * rows[i][c];
                    }
                }
            }
            let Some(factor) = cholesky(&hessian) else {
                continue;
            };
            let [middle, slope] = cholesky_solve(&factor, &right);
            let mut chi_square = 0.0;
            for i in 0..MAX_GAUGES {
                let residual = k[i] - rows[i][0] * middle - rows[i][1] * slope;
                chi_square += weights[i] * residual * residual;
            }
            // At the middle, θ = 0 and κ' = −f_y; the rest of the load is axial.
            let axial = -sqrt((load * load - slope * slope).max(0.0));
            let mut found = (chi_square, bounded([middle, axial, -slope]));
            for slot in &mut best {
                if found.0 < slot.0 {
                    core::mem::swap(slot, &mut found);
                }
            }
        }
        best.map(|(_, parameters)| parameters)
    }
}
