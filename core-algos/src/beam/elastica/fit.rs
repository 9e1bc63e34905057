//! Posture, wrench and covariance of a fitted shape.

use super::{Minimum, Readings, Shape, Solver, Wrench};
use crate::beam::strip::{GaugeMask, MAX_GAUGES, RelativePosture};
use crate::math::Posture;
use crate::math::matrix::{Mat3, apply, inverse_spd, propagate, scale, subtract};
use crate::math::trig::sin_cos;

/// A fitted elastica.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Front axle in the rear axle's frame.
    pub relative: RelativePosture,
    /// End forces.
    pub wrench: Wrench,
    /// Curvature of the fitted shape at every gauge of the strip, used or not, 1/m.
    pub curvature: [f32; MAX_GAUGES],
    /// Weighted sum of squared residuals.
    pub chi_square: f32,
    /// Number of readings minus the number of parameters that the readings, not the prior, determine: expectation of
    /// `chi_square`.
    pub degrees_of_freedom: f32,
    /// True if the iteration converged.
    pub converged: bool,
    /// Number of integrations of the elastica.
    pub evaluations: u8,
}

impl Solver {
    /// Covariances of the parameters: total, without the drift of the zeros, and of the noise alone.
    fn spreads(&self, inverse: &Mat3, shape: &Shape, readings: &Readings) -> [Mat3; 3] {
        let (strip, Readings { k, weights, .. }) = (&self.strip, readings);
        // The weights contain the errors that are independent between gauges. Errors common to all gauges are added
        // here.
        let mut by_offset = [0.0; 3];
        let mut by_gain = [0.0; 3];
        for i in 0..MAX_GAUGES {
            for r in 0..3 {
                let weighted = weights[i] * shape.gradient[i][r];
                by_offset[r] += weighted;
                by_gain[r] += weighted * k[i];
            }
        }
        let uncertainty = &strip.uncertainty;
        let offset = uncertainty.common_offset_strain / strip.half_thickness * strip.length;
        let by_offset = apply(inverse, &by_offset).map(|v| v * offset);
        let by_gain = apply(inverse, &by_gain).map(|v| v * uncertainty.common_gain);
        let mut spread = *inverse;
        for r in 0..3 {
            for c in 0..3 {
                spread[r][c] += by_offset[r] * by_offset[c] + by_gain[r] * by_gain[c];
            }
        }
        // Covariance for a variance of 1 of each reading: a scale for the drift of the zeros and for the noise.
        let mut unit: Mat3 = [[0.0; 3]; 3];
        for i in 0..MAX_GAUGES {
            let share = weights[i] * weights[i];
            let gradient = &shape.gradient[i];
            for r in 0..3 {
                for c in 0..3 {
                    unit[r][c] += share * gradient[r] * gradient[c];
                }
            }
        }
        let unit = propagate(inverse, &unit);
        let fresh = subtract(&spread, &scale(&unit, readings.drift));
        let noise = scale(&unit, strip.noise_variance * strip.length * strip.length);
        [spread, fresh, noise]
    }

    /// Posture, wrench and their covariance at a minimum.
    pub(super) fn result(
        &self,
        minimum: &Minimum,
        mask: GaugeMask,
        readings: &Readings,
        evaluations: u8,
    ) -> Option<Fit> {
        let strip = &self.strip;
        let (parameters, shape, normal) = (minimum.parameters, &minimum.shape, &minimum.normal);
        let (root, tip) = (&shape.root, &shape.tip);
        let inverse = inverse_spd(&normal.hessian)?;

        let [spread, fresh, noise] = self.spreads(&inverse, shape, readings);

        // Posture of the tip in the root's frame.
        let (s, c) = sin_cos(root.theta);
        let (dx, dy) = (tip.x - root.x, tip.y - root.y);
        let (x, y) = (c * dx + s * dy, c * dy - s * dx);
        let phi = tip.theta - root.theta;
        let length = strip.length;
        let flexible = Posture::new(length * x, length * y, phi);
        let lever = strip.rigid_tip_lever(phi);
        let mut jacobian: Mat3 = [[0.0; 3]; 3];
        // Force in the root's frame and moment at the rear axle, in units of EI/L² and EI/L.
        let [_, fx, fy] = parameters;
        let (load_x, load_y) = (c * fx + s * fy, c * fy - s * fx);
        let root_curvature = root.curvature(parameters);
        let d_root_curvature = root.curvature_gradient(parameters);
        let arm = strip.rigid_root / length;
        let mut wrench_jacobian: Mat3 = [[0.0; 3]; 3];
        for j in 0..3 {
            let turn = root.d_theta[j];
            let (ddx, ddy) = (tip.d_x[j] - root.d_x[j], tip.d_y[j] - root.d_y[j]);
            let d_phi = tip.d_theta[j] - turn;
            jacobian[0][j] = length * (c * ddx + s * ddy + y * turn) + lever.0 * d_phi;
            jacobian[1][j] = length * (c * ddy - s * ddx - x * turn) + lever.1 * d_phi;
            jacobian[2][j] = d_phi;
            let (unit_x, unit_y) = [(0.0, 0.0), (c, -s), (s, c)][j];
            wrench_jacobian[0][j] = unit_x + load_y * turn;
            wrench_jacobian[1][j] = unit_y - load_x * turn;
            wrench_jacobian[2][j] = d_root_curvature[j] + arm * wrench_jacobian[1][j];
        }
        let force_unit = strip.stiffness / (length * length);
        let moment_unit = strip.stiffness / length;
        for j in 0..3 {
            wrench_jacobian[0][j] *= force_unit;
            wrench_jacobian[1][j] *= force_unit;
            wrench_jacobian[2][j] *= moment_unit;
        }
        let posture = strip.with_rigid_ends(flexible);
        let relative = RelativePosture {
            posture,
            covariance: strip.with_unseen_error(propagate(&jacobian, &fresh)),
            noise: strip.with_unseen_error(propagate(&jacobian, &noise)),
        };
        let root_moment = moment_unit * (root_curvature + arm * load_y);
        let (force_x, force_y) = (force_unit * load_x, force_unit * load_y);
        let wrench = Wrench {
            fx: force_x,
            fy: force_y,
            root_moment,
            tip_moment: root_moment + force_x * posture.y - force_y * posture.x,
            covariance: propagate(&wrench_jacobian, &spread),
        };
        // trace(H⁻¹ prior): number of parameters decided by the prior.
        let decided_by_prior = normal.prior * (inverse[1][1] + inverse[2][2]);
        let fit = Fit {
            relative,
            wrench,
            curvature: shape.curvature.map(|k| k / length),
            chi_square: normal.chi_square,
            degrees_of_freedom: (mask.count() as f32 - 3.0 + decided_by_prior).max(0.0),
            converged: minimum.converged,
            evaluations,
        };
        (relative.is_sound() && wrench.is_finite() && fit.chi_square.is_finite()).then_some(fit)
    }
}
