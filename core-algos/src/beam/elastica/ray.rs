//! Integration of the elastica from the middle outward.

use crate::math::trig::sin_cos;

/// Curvature at the middle and force there, in units of 1/L and EI/L², in the frame of the
/// strip's middle. From the middle, errors grow over half the length only (a strip in tension
/// amplifies them exponentially).
pub(super) type Parameters = [f32; 3];

/// The shape at one point, in the frame of the middle, with derivatives by the parameters.
/// Lengths in units of L.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ray {
    pub(super) theta: f32,
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) d_theta: [f32; 3],
    pub(super) d_x: [f32; 3],
    pub(super) d_y: [f32; 3],
}

impl Ray {
    pub(super) const MIDDLE: Self = Self {
        theta: 0.0,
        x: 0.0,
        y: 0.0,
        d_theta: [0.0; 3],
        d_x: [0.0; 3],
        d_y: [0.0; 3],
    };

    /// Curvature at this point by the balance of moments: exact for any integration step.
    pub(super) fn curvature(&self, [middle, fx, fy]: Parameters) -> f32 {
        middle + fx * self.y - fy * self.x
    }

    /// Derivative of [`Self::curvature`] with respect to the parameters.
    pub(super) fn curvature_gradient(&self, [_, fx, fy]: Parameters) -> [f32; 3] {
        let mut gradient = [1.0, self.y, -self.x];
        for j in 0..3 {
            gradient[j] += fx * self.d_y[j] - fy * self.d_x[j];
        }
        gradient
    }

    /// One step of signed length `h` along the strip. θ'' = f_x sin θ − f_y cos θ is integrated by the five-stage,
    /// sixth-order Runge–Kutta–Nyström method of Albrecht (1955), positions by the same stages. Derivatives are those
    /// of the step itself.
    pub(super) fn step(&mut self, parameters: Parameters, h: f32) {
        const A: [[f32; 4]; 5] = [
            [0.0; 4],
            [1.0 / 32.0, 0.0, 0.0, 0.0],
            [-1.0 / 24.0, 1.0 / 6.0, 0.0, 0.0],
            [3.0 / 32.0, 1.0 / 8.0, 1.0 / 16.0, 0.0],
            [0.0, 3.0 / 7.0, -1.0 / 14.0, 1.0 / 7.0],
        ];
        const C: [f32; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
        const B_ANGLE: [f32; 5] = [7.0 / 90.0, 4.0 / 15.0, 1.0 / 15.0, 4.0 / 45.0, 0.0];
        const B_POSITION: [f32; 5] = [7.0 / 90.0, 16.0 / 45.0, 2.0 / 15.0, 16.0 / 45.0, 7.0 / 90.0];
        let [_, fx, fy] = parameters;
        let curvature = self.curvature(parameters);
        let d_curvature = self.curvature_gradient(parameters);
        let h2 = h * h;
        let mut bend = [0.0; 5];
        let mut d_bend = [[0.0; 3]; 5];
        let mut next = *self;
        next.theta += h * curvature;
        for j in 0..3 {
            next.d_theta[j] += h * d_curvature[j];
        }
        for stage in 0..5 {
            let reach = C[stage] * h;
            let mut theta = self.theta + reach * curvature;
            let mut d_theta = [0.0; 3];
            for j in 0..3 {
                d_theta[j] = self.d_theta[j] + reach * d_curvature[j];
            }
            for earlier in 0..stage {
                let a = h2 * A[stage][earlier];
                theta += a * bend[earlier];
                for j in 0..3 {
                    d_theta[j] += a * d_bend[earlier][j];
                }
            }
            let (s, c) = sin_cos(theta);
            bend[stage] = fx * s - fy * c;
            let stiffness = fx * c + fy * s;
            d_bend[stage] = [
                stiffness * d_theta[0],
                stiffness * d_theta[1] + s,
                stiffness * d_theta[2] - c,
            ];
            let (angle, position) = (h2 * B_ANGLE[stage], h * B_POSITION[stage]);
            next.theta += angle * bend[stage];
            next.x += position * c;
            next.y += position * s;
            for j in 0..3 {
                next.d_theta[j] += angle * d_bend[stage][j];
                next.d_x[j] -= position * s * d_theta[j];
                next.d_y[j] += position * c * d_theta[j];
            }
        }
        *self = next;
    }
}

/// Longest integration step, as a fraction of the length. The method is of sixth order: a step of 1/8 keeps the
/// posture within 2e-6 of the length up to the second buckling load.
const MAX_STEP: f32 = 0.1;

/// Integration steps from the middle or a gauge to the next gauge or an end: signed step length in units of L, count.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Leg {
    pub(super) step: f32,
    pub(super) count: u8,
}

impl Leg {
    pub(super) fn new(from_u: f32, to_u: f32) -> Self {
        let length = 0.5 * (to_u - from_u);
        let mut count = 0u8;
        // The distance is at most half the strip, so five steps are enough.
        while f32::from(count) * MAX_STEP < length.abs() && count < 8 {
            count += 1;
        }
        Self {
            step: length / f32::from(count.max(1)),
            count,
        }
    }
}
