//! The posture and the end forces from the strains, by the mechanics of the strip.
//!
//! A massless strip loaded at its ends only is an elastica: its curvature is linear in position,
//! EI κ = M_root + F_x y − F_y x. Three numbers describe every such shape, bent or post-buckled, so
//! the strains are fitted with them rather than with a polynomial: the posture no longer depends
//! on where the gauges sit, each gauge beyond the third checks the others, and the wrench comes for
//! free (the compliant frame force F_K of paper eq. 8).
//!
//! [`Solver`] is valid by construction; [`Solver::fit`] is infallible and bounded (at most
//! [`MAX_EVALUATIONS`] shapes); it gives `None` where no finite fit exists.

use super::polynomial::Interpolant;
use super::strip::{GaugeMask, MAX_GAUGES, RelativePosture, Strip};
use crate::math::matrix::{
    Mat3, apply, cholesky, cholesky_solve, inverse_spd, is_finite, propagate, scale, subtract,
};
use crate::math::trig::{cos, ln, sin_cos, sinc, sqrt};
use crate::math::{Posture, small_angle};

/// Standard deviations within which a force may be none.
const VOUCHED: f32 = 2.0;
/// Most shapes computed for one fit.
pub const MAX_EVALUATIONS: u8 = 40;
/// Most shapes computed from one start.
const MAX_DESCENT: usize = 10;
/// Longest integration step, as a fraction of the length. Sixth order: 1/8 keeps the posture
/// within 2e-6 of the length up to the second buckling load.
const MAX_STEP: f32 = 0.1;
/// A step this small, in squared standard deviations of the parameters, ends the iteration; what
/// it leaves is smaller by its square.
const CONVERGED: f32 = 1e-2;
/// A step as small as this leaves the rest to the refinement, where there will be one.
const CLOSE: f32 = 4.0;
/// Axial compressions in units of EI/L² at which [`Solver::waves`] looks for a start.
const WAVE_LOADS: [f32; 10] = [0.0, 5.0, 12.0, 20.0, 30.0, 42.0, 55.0, 70.0, 88.0, 110.0];
/// Weight of the load's prior in its tail: cost `TAIL` ln(1 + |f|²/σ²).
const TAIL: f32 = 3.0;
/// What is left of it once the load is known.
const REFINED_TAIL: f32 = 1e-3 * TAIL;
/// The load is known if the prior decides less than this share of a parameter.
const PRIOR_SHARE: f32 = 0.1;
/// Most steps taken after that.
const REFINEMENTS: u8 = 2;
/// A compression of this many prior standard deviations is compared with none.
const LARGE_LOAD: f32 = 3.0;
/// A residual this large makes the fit try other starts.
const SUSPICIOUS: f32 = 12.0;
/// Largest |F| L²/EI the fit may reach: sixteen times the load of the second buckling mode.
const MAX_LOAD: f32 = 1300.0;

/// What the strip exerts on the axles, in the rear axle's frame.
///
/// The strip acts on the rear axle with force (+fx, +fy) and moment +root_moment about its
/// midpoint, and on the front axle with force (−fx, −fy) and moment −tip_moment about its midpoint.
/// Seen the other way, (fx, fy, tip_moment) is what the front axle exerts on the strip. A left
/// bend by pure moments has fx = fy = 0 and both moments positive; a strip compressed between the
/// axles has fx < 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench {
    /// Force along the rear axle's x, N.
    pub fx: f32,
    /// Force along the rear axle's y, N.
    pub fy: f32,
    /// Moment at the rear axle's midpoint, N m.
    pub root_moment: f32,
    /// Moment at the front axle's midpoint, N m.
    pub tip_moment: f32,
    /// Covariance of (fx, fy, root_moment). Of a strip that is nearly straight the strains do not
    /// tell fx: then its variance is that of the prior.
    pub covariance: Mat3,
}

impl Wrench {
    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.fx.is_finite()
            && self.fy.is_finite()
            && self.root_moment.is_finite()
            && self.tip_moment.is_finite()
            && is_finite(&self.covariance)
    }

    /// What the strains vouch for: each force less what may be error, to nothing where it is within
    /// two standard deviations. `posture` is that of the front axle, which the balance of
    /// moments needs. Of a strip that is nearly straight the strains do not tell the axial force, and
    /// what the fit gives then must neither stop the robot nor drive its motors.
    pub fn vouched(&self, posture: Posture) -> Self {
        let sure = |force: f32, variance: f32| {
            let share = 1.0 - VOUCHED * VOUCHED * variance / (force * force);
            // Not a number for no force.
            if share > 0.0 { share * force } else { 0.0 }
        };
        let fx = sure(self.fx, self.covariance[0][0]);
        let fy = sure(self.fy, self.covariance[1][1]);
        Self {
            fx,
            fy,
            tip_moment: self.root_moment + fx * posture.y - fy * posture.x,
            ..*self
        }
    }
}

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
    /// Readings minus the parameters they determine (the prior counts as information): what
    /// `chi_square` is on average.
    pub degrees_of_freedom: f32,
    /// Whether the iteration settled.
    pub converged: bool,
    /// Shapes computed.
    pub evaluations: u8,
}

/// Where a fit may start: where another one ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start(Parameters);

/// A fit under way: the lowest minimum so far, and where else one may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    mask: GaugeMask,
    readings: Readings,
    best: Option<Minimum>,
    /// Other starts, once the first is tried, and how many were.
    starts: [Parameters; 3],
    tried: u8,
    /// The lowest minimum is not that of the polynomial's shape.
    elsewhere: bool,
    open: bool,
    evaluations: u8,
}

impl Search {
    /// Whether a lower minimum may be elsewhere.
    pub fn is_open(&self) -> bool {
        self.open
    }

    /// Where the next fit should start, if not from the polynomial's shape.
    pub fn start(&self) -> Option<Start> {
        let best = self.best.as_ref().filter(|_| self.elsewhere)?;
        Some(Start(best.parameters))
    }
}

/// Curvature at the middle and force there, in units of 1/L and EI/L², in the frame of the
/// strip's middle. From the middle, errors grow over half the length only (a strip in tension
/// amplifies them exponentially).
type Parameters = [f32; 3];

/// The shape at one point, in the frame of the middle, with derivatives by the parameters.
/// Lengths in units of L.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ray {
    theta: f32,
    x: f32,
    y: f32,
    d_theta: [f32; 3],
    d_x: [f32; 3],
    d_y: [f32; 3],
}

impl Ray {
    const MIDDLE: Self = Self {
        theta: 0.0,
        x: 0.0,
        y: 0.0,
        d_theta: [0.0; 3],
        d_x: [0.0; 3],
        d_y: [0.0; 3],
    };

    /// Curvature here: the balance of moments, exact whatever the integration step.
    fn curvature(&self, [middle, fx, fy]: Parameters) -> f32 {
        middle + fx * self.y - fy * self.x
    }

    /// Derivative of [`Self::curvature`] by the parameters.
    fn curvature_gradient(&self, [_, fx, fy]: Parameters) -> [f32; 3] {
        let mut gradient = [1.0, self.y, -self.x];
        for j in 0..3 {
            gradient[j] += fx * self.d_y[j] - fy * self.d_x[j];
        }
        gradient
    }

    /// One step of signed length `h` along the strip: θ'' = f_x sin θ − f_y cos θ by the
    /// five-stage, sixth-order Runge–Kutta–Nyström method of Albrecht (1955), positions by the
    /// same stages, derivatives by differentiating the step itself.
    fn step(&mut self, parameters: Parameters, h: f32) {
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
            let (s, c) = if theta.abs() <= small_angle::LIMIT {
                small_angle::sin_cos(theta)
            } else {
                sin_cos(theta)
            };
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

/// A computed shape: curvatures at the gauges, and both ends.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shape {
    curvature: [f32; MAX_GAUGES],
    gradient: [[f32; 3]; MAX_GAUGES],
    root: Ray,
    tip: Ray,
}

/// What is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Readings {
    /// Curvature × length; 0 outside the mask.
    k: [f32; MAX_GAUGES],
    /// Inverse variances; 0 outside the mask.
    weights: [f32; MAX_GAUGES],
    /// Variance that the walk of the zeros added to each reading, (curvature × length)².
    drift: f32,
    /// Weight of the prior.
    tail: f32,
    /// Most shapes computed.
    budget: u8,
}

/// Normal equations at a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Normal {
    /// Jᵀ W J + prior.
    hessian: Mat3,
    /// Negative gradient of the cost.
    descent: [f32; 3],
    /// Share of `hessian` that the prior makes, for each force.
    prior: f32,
    chi_square: f32,
    cost: f32,
}

/// A strip prepared for fitting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solver {
    strip: Strip,
    /// Distance of each gauge from the one before it on the way from the middle outward, and the
    /// steps it takes.
    legs: [Leg; MAX_GAUGES],
    /// The last leg to the root and to the tip.
    root_leg: Leg,
    tip_leg: Leg,
}

/// A stretch between two points of interest: step length (signed, in units of L) and count.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Leg {
    step: f32,
    count: u8,
}

impl Leg {
    fn new(from_u: f32, to_u: f32) -> Self {
        let length = 0.5 * (to_u - from_u);
        let mut count = 0u8;
        // At most half the strip, so at most four steps.
        while f32::from(count) * MAX_STEP < length.abs() && count < 8 {
            count += 1;
        }
        Self {
            step: length / f32::from(count.max(1)),
            count,
        }
    }
}

impl Solver {
    /// Prepares `strip`.
    pub fn new(strip: Strip) -> Self {
        let mut legs = [Leg::default(); MAX_GAUGES];
        let mut tip_u = 0.0;
        for i in 0..MAX_GAUGES {
            if strip.gauges.contains(i) && strip.u[i] >= 0.0 {
                legs[i] = Leg::new(tip_u, strip.u[i]);
                tip_u = strip.u[i];
            }
        }
        let mut root_u = 0.0;
        for i in (0..MAX_GAUGES).rev() {
            if strip.gauges.contains(i) && strip.u[i] < 0.0 {
                legs[i] = Leg::new(root_u, strip.u[i]);
                root_u = strip.u[i];
            }
        }
        Self {
            strip,
            legs,
            root_leg: Leg::new(root_u, -1.0),
            tip_leg: Leg::new(tip_u, 1.0),
        }
    }

    /// The strip.
    pub fn strip(&self) -> &Strip {
        &self.strip
    }

    /// Walks from the middle to the root and to the tip; `advance` moves over a leg that begins
    /// at the given u, `visit` sees each gauge.
    fn walk<T: Copy>(
        &self,
        middle: T,
        mut advance: impl FnMut(&mut T, &Leg, f32),
        mut visit: impl FnMut(usize, &T),
    ) -> (T, T) {
        let strip = &self.strip;
        let mut tip = middle;
        let mut u = 0.0;
        for i in 0..MAX_GAUGES {
            if strip.gauges.contains(i) && strip.u[i] >= 0.0 {
                advance(&mut tip, &self.legs[i], u);
                visit(i, &tip);
                u = strip.u[i];
            }
        }
        advance(&mut tip, &self.tip_leg, u);
        let mut root = middle;
        u = 0.0;
        for i in (0..MAX_GAUGES).rev() {
            if strip.gauges.contains(i) && strip.u[i] < 0.0 {
                advance(&mut root, &self.legs[i], u);
                visit(i, &root);
                u = strip.u[i];
            }
        }
        advance(&mut root, &self.root_leg, u);
        (root, tip)
    }

    fn shape(&self, parameters: Parameters) -> Shape {
        let mut curvature = [0.0; MAX_GAUGES];
        let mut gradient = [[0.0; 3]; MAX_GAUGES];
        let (root, tip) = self.walk(
            Ray::MIDDLE,
            |ray, leg, _| {
                for _ in 0..leg.count {
                    ray.step(parameters, leg.step);
                }
            },
            |i, ray| {
                if let (Some(k), Some(g)) = (curvature.get_mut(i), gradient.get_mut(i)) {
                    *k = ray.curvature(parameters);
                    *g = ray.curvature_gradient(parameters);
                }
            },
        );
        Shape {
            curvature,
            gradient,
            root,
            tip,
        }
    }

    /// Weights of the readings `k` (curvature × length): inverse variances, 0 outside the mask;
    /// `drift` is what the walk of the zeros added to them.
    fn weights(&self, k: &[f32; MAX_GAUGES], mask: GaugeMask, drift: f32) -> [f32; MAX_GAUGES] {
        let length = self.strip.length;
        let mut weights = [0.0; MAX_GAUGES];
        for i in 0..MAX_GAUGES {
            if mask.contains(i) {
                let variance = self.strip.gauge_variance(k[i] / length);
                weights[i] = 1.0 / (length * length * variance + drift);
            }
        }
        weights
    }

    fn normal(&self, shape: &Shape, [_, fx, fy]: Parameters, readings: &Readings) -> Normal {
        let Readings {
            k, weights, tail, ..
        } = readings;
        let mut hessian = [[0.0; 3]; 3];
        let mut descent = [0.0; 3];
        let mut chi_square = 0.0;
        for i in 0..MAX_GAUGES {
            let residual = k[i] - shape.curvature[i];
            let gradient = &shape.gradient[i];
            chi_square += weights[i] * residual * residual;
            for r in 0..3 {
                let weighted = weights[i] * gradient[r];
                descent[r] += weighted * residual;
                for c in 0..3 {
                    hessian[r][c] += weighted * gradient[c];
                }
            }
        }
        // A heavy-tailed prior, by iterated reweighting.
        let scale = self.strip.uncertainty.load_prior * self.strip.uncertainty.load_prior;
        let load = fx * fx + fy * fy;
        let prior = tail / (scale + load);
        hessian[1][1] += prior;
        hessian[2][2] += prior;
        descent[1] -= prior * fx;
        descent[2] -= prior * fy;
        Normal {
            hessian,
            descent,
            prior,
            chi_square,
            cost: chi_square + tail * ln(1.0 + load / scale),
        }
    }

    /// Start: the shape of the interpolating polynomial, walked in arcs, gives the positions of
    /// the gauges; then the balance of moments is linear in the parameters.
    fn start(
        &self,
        interpolant: &Interpolant,
        k: &[f32; MAX_GAUGES],
        weights: &[f32; MAX_GAUGES],
    ) -> Parameters {
        let mut position = [[0.0f32; 2]; MAX_GAUGES];
        self.walk(
            (0.0f32, 0.0f32, 0.0f32),
            |(theta, x, y), leg, from| {
                let mut u = from;
                for _ in 0..leg.count {
                    let turn = leg.step * interpolant.value(u + leg.step, k);
                    let chord = leg.step * sinc(0.5 * turn);
                    let (s, c) = sin_cos(*theta + 0.5 * turn);
                    *x += chord * c;
                    *y += chord * s;
                    *theta += turn;
                    u += 2.0 * leg.step;
                }
            },
            |i, (_, x, y)| {
                if let Some(slot) = position.get_mut(i) {
                    *slot = [*x, *y];
                }
            },
        );
        let scale = self.strip.uncertainty.load_prior * self.strip.uncertainty.load_prior;
        let mut hessian = [[0.0; 3], [0.0, 1.0 / scale, 0.0], [0.0, 0.0, 1.0 / scale]];
        let mut right = [0.0; 3];
        for i in 0..MAX_GAUGES {
            let row = [1.0, position[i][1], -position[i][0]];
            for r in 0..3 {
                right[r] += weights[i] * row[r] * k[i];
                for c in 0..3 {
                    hessian[r][c] += weights[i] * row[r] * row[c];
                }
            }
        }
        match cholesky(&hessian) {
            Some(factor) => bounded(cholesky_solve(&factor, &right)),
            None => [0.0; 3],
        }
    }

    /// Fits the curvatures (1/m) of the gauges of `mask`.
    ///
    /// Gauss–Newton, damped only when a step fails, from the polynomial's shape; from an arc if
    /// that leaves large residuals. The readings weigh by their own variance
    /// ([`super::strip::Uncertainty`]); a weak heavy-tailed prior holds forces that the strains do
    /// not tell. With two gauges the prior decides the rest, and the covariance says so. `None` if
    /// fewer than two readings are usable or no finite shape was found.
    ///
    /// Readings of four gauges or more tell a shape apart from all others a robot can take; three
    /// can be met by several shapes when the load nears the buckling load: the least loaded is
    /// given. Cost: about 8 000 instructions a shape, three or four shapes as a rule, at most
    /// [`MAX_EVALUATIONS`]. What was tried to lower it: sine and cosine without reduction (a tenth
    /// less), and no shape for the last step before the prior is withdrawn (a shape less).
    pub fn fit(&self, curvature: &[f32; MAX_GAUGES], mask: GaugeMask) -> Option<Fit> {
        self.fit_within(curvature, mask, 0.0, MAX_EVALUATIONS)
    }

    /// As [`Self::fit`] with zeros that have walked, each by itself, and at most `budget` shapes (4 to
    /// [`MAX_EVALUATIONS`]). `drift` is the variance of that walk, strain². It makes the readings weigh
    /// less and the wrench less certain; the posture's covariance stays that of a sensor whose zeros are
    /// fresh, for what walks is no noise and whoever follows the posture must follow it
    /// ([`crate::fusion::joint`]).
    pub fn fit_within(
        &self,
        curvature: &[f32; MAX_GAUGES],
        mask: GaugeMask,
        drift: f32,
        budget: u8,
    ) -> Option<Fit> {
        let mut search = self.begin(curvature, mask, (drift, None), budget)?;
        while search.is_open() {
            self.go_on(&mut search, budget);
        }
        self.finish(&search)
    }

    /// Begins a fit as [`Self::fit_within`] does it: from the polynomial's shape alone, or from `start`,
    /// where an earlier fit ended, first. At most `budget` shapes, with those of [`Self::finish`].
    pub fn begin(
        &self,
        curvature: &[f32; MAX_GAUGES],
        mask: GaugeMask,
        (drift, start): (f32, Option<Start>),
        budget: u8,
    ) -> Option<Search> {
        let strip = &self.strip;
        let scale = strip.length / strip.half_thickness;
        let drift = drift * scale * scale;
        let mask = strip.usable(curvature, mask);
        let interpolant = Interpolant::new(strip, mask)?;
        let mut k = [0.0; MAX_GAUGES];
        for i in 0..MAX_GAUGES {
            if mask.contains(i) {
                k[i] = curvature[i] * strip.length;
            }
        }
        let weights = self.weights(&k, mask, drift);
        let mut evaluations = 0;
        let readings = Readings {
            k,
            weights,
            drift,
            tail: TAIL,
            budget: before_refinement(budget),
        };
        // Three readings fit more than one shape exactly; the prior takes the least load.
        let ambiguous = mask.count() <= 3;
        let mut best = None;
        if let Some(Start(start)) = start {
            best = self.descend(start, &readings, &mut evaluations);
        }
        let remembered = best.as_ref().map(|found| found.parameters);
        if ambiguous || is_suspicious(best.as_ref()) {
            let start = self.start(&interpolant, &k, &weights);
            best = lower(best, self.descend(start, &readings, &mut evaluations));
        }
        // Noise on a strip that is nearly straight can look like a small buckled shape: a large
        // load must win against none.
        let mut compared = true;
        if let Some([middle, fx, fy]) = best.as_ref().map(|found| found.parameters)
            && fx.abs() > self.large_load()
        {
            let light = [middle, 0.0, fy];
            best = lower(best, self.descend(light, &readings, &mut evaluations));
            compared = evaluations < readings.budget;
        }
        Some(Search {
            mask,
            readings,
            best,
            starts: [[0.0; 3]; 3],
            tried: 0,
            elsewhere: remembered.is_some()
                && best.as_ref().map(|found| found.parameters) == remembered,
            open: is_suspicious(best.as_ref()) || ambiguous || !compared,
            evaluations,
        })
    }

    /// Tries one start more: at most ten shapes, and `budget` in all.
    pub fn go_on(&self, search: &mut Search, budget: u8) {
        search.readings.budget = before_refinement(budget);
        let readings = &search.readings;
        if search.tried == 0 {
            search.starts = self.waves(&readings.k, &readings.weights);
        }
        let tried = usize::from(search.tried);
        if let Some(&start) = search.starts.get(tried) {
            let before = search.best.as_ref().map(|best| best.parameters);
            let found = self.descend(start, readings, &mut search.evaluations);
            search.best = lower(search.best, found);
            search.elsewhere |= search.best.as_ref().map(|best| best.parameters) != before;
        }
        search.tried += 1;
        let ambiguous = search.mask.count() <= 3;
        search.open =
            tried + 1 < search.starts.len() && (ambiguous || is_suspicious(search.best.as_ref()));
    }

    /// What was found so far, refined: at most two shapes. `None` if it is no finite shape.
    pub fn finish(&self, search: &Search) -> Option<Fit> {
        let mut best = search.best?;
        let mut readings = search.readings;
        let mut evaluations = search.evaluations;
        // Where the strains tell the load, or a large one has won, the prior has done its work and
        // would only bias.
        let [_, fx, fy] = best.parameters;
        let ambiguous = search.mask.count() <= 3;
        let won = fx.abs().max(fy.abs()) > self.large_load() && !ambiguous;
        if won || told(&best.normal) {
            readings.tail = REFINED_TAIL;
            for _ in 0..REFINEMENTS {
                let (refined, settled) = self.refined(best, &readings, &mut evaluations);
                best = refined;
                if settled {
                    break;
                }
            }
        }
        self.result(&best, search.mask, &readings, evaluations)
    }

    /// A compression that is compared with none.
    fn large_load(&self) -> f32 {
        LARGE_LOAD * self.strip.uncertainty.load_prior
    }

    /// Starts from small-deflection theory: at a given axial load the curvature is a wave,
    /// κ = a cos ωs + b sin ωs with ω² the compression, so one linear fit per load; the best
    /// three, best first.
    fn waves(&self, k: &[f32; MAX_GAUGES], weights: &[f32; MAX_GAUGES]) -> [Parameters; 3] {
        let mut best = [(f32::INFINITY, [0.0; 3]); 3];
        for load in WAVE_LOADS {
            let omega = sqrt(load);
            // A trace of a prior keeps the normal matrix regular.
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
            // At the middle, θ = 0 and κ' = −f_y; what is left of the load is along the strip.
            let along = -sqrt((load * load - slope * slope).max(0.0));
            let mut found = (chi_square, bounded([middle, along, -slope]));
            for slot in &mut best {
                if found.0 < slot.0 {
                    core::mem::swap(slot, &mut found);
                }
            }
        }
        best.map(|(_, parameters)| parameters)
    }

    /// One Gauss–Newton step from a minimum to that of other readings, and whether it was small.
    fn refined(&self, from: Minimum, readings: &Readings, evaluations: &mut u8) -> (Minimum, bool) {
        let normal = self.normal(&from.shape, from.parameters, readings);
        let Some(factor) = cholesky(&normal.hessian) else {
            return (from, true);
        };
        let step = cholesky_solve(&factor, &normal.descent);
        let mut parameters = from.parameters;
        let mut promise = 0.0;
        for i in 0..3 {
            parameters[i] += step[i];
            promise += step[i] * normal.descent[i];
        }
        let parameters = bounded(parameters);
        let shape = self.shape(parameters);
        let refined = self.normal(&shape, parameters, readings);
        *evaluations += 1;
        if refined.cost <= normal.cost + 1e-3 {
            let refined = Minimum {
                parameters,
                shape,
                normal: refined,
                ..from
            };
            (refined, promise < CONVERGED)
        } else {
            (from, true)
        }
    }

    fn descend(
        &self,
        start: Parameters,
        readings: &Readings,
        evaluations: &mut u8,
    ) -> Option<Minimum> {
        if *evaluations >= readings.budget {
            return None;
        }
        let mut parameters = start;
        let mut shape = self.shape(parameters);
        let mut normal = self.normal(&shape, parameters, readings);
        *evaluations += 1;
        if !normal.cost.is_finite() {
            return None;
        }
        let mut damping = 0.0;
        let mut converged = false;
        for _ in 1..MAX_DESCENT {
            if *evaluations >= readings.budget {
                break;
            }
            let mut hessian = normal.hessian;
            for i in 0..3 {
                hessian[i][i] *= 1.0 + damping;
            }
            let Some(factor) = cholesky(&hessian) else {
                damping = 10.0 * damping + 1e-3;
                continue;
            };
            let step = cholesky_solve(&factor, &normal.descent);
            // Decrease that the step promises, in squared standard deviations.
            let mut promise = 0.0;
            for i in 0..3 {
                promise += step[i] * normal.descent[i];
            }
            // The refinement that follows makes this step too; other minima are compared with what
            // it will reach. A large load must show what it reaches.
            let modest = parameters[1].abs() <= self.large_load();
            if damping == 0.0 && modest && promise < CLOSE && told(&normal) {
                normal.cost -= promise;
                converged = true;
                break;
            }
            let mut trial = parameters;
            for i in 0..3 {
                trial[i] += step[i];
            }
            let trial = bounded(trial);
            let trial_shape = self.shape(trial);
            let trial_normal = self.normal(&trial_shape, trial, readings);
            *evaluations += 1;
            let small = promise < CONVERGED;
            // The slack covers rounding in the sum of squares.
            if trial_normal.cost <= normal.cost * (1.0 + 1e-5) + 1e-3 {
                parameters = trial;
                shape = trial_shape;
                normal = trial_normal;
                damping = if damping > 1e-3 { 0.1 * damping } else { 0.0 };
            } else {
                damping = 10.0 * damping + 1e-2;
            }
            if small {
                converged = true;
                break;
            }
        }
        Some(Minimum {
            parameters,
            shape,
            normal,
            converged,
        })
    }

    /// Posture, wrench and their covariance at a minimum.
    fn result(
        &self,
        minimum: &Minimum,
        mask: GaugeMask,
        readings: &Readings,
        evaluations: u8,
    ) -> Option<Fit> {
        let strip = &self.strip;
        let Readings {
            k, weights, drift, ..
        } = readings;
        let Minimum {
            parameters,
            shape,
            normal,
            converged,
        } = minimum;
        let (root, tip) = (&shape.root, &shape.tip);
        let inverse = inverse_spd(&normal.hessian)?;

        // Parameters: independent errors weigh by construction; common ones move all readings.
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
        let by_offset = apply(&inverse, &by_offset).map(|v| v * offset);
        let by_gain = apply(&inverse, &by_gain).map(|v| v * uncertainty.common_gain);
        let mut spread = inverse;
        for r in 0..3 {
            for c in 0..3 {
                spread[r][c] += by_offset[r] * by_offset[c] + by_gain[r] * by_gain[c];
            }
        }
        // What a variance of 1 of each reading makes of it: the walk of the zeros, and the noise.
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
        let unit = propagate(&inverse, &unit);
        let fresh = subtract(&spread, &scale(&unit, *drift));
        let noise = scale(&unit, strip.noise_variance * strip.length * strip.length);

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
        let [_, fx, fy] = *parameters;
        let (load_x, load_y) = (c * fx + s * fy, c * fy - s * fx);
        let root_curvature = root.curvature(*parameters);
        let d_root_curvature = root.curvature_gradient(*parameters);
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
        // trace(H⁻¹ prior): how much of the parameters the prior decides.
        let decided_by_prior = normal.prior * (inverse[1][1] + inverse[2][2]);
        let fit = Fit {
            relative,
            wrench,
            curvature: shape.curvature.map(|k| k / length),
            chi_square: normal.chi_square,
            degrees_of_freedom: (mask.count() as f32 - 3.0 + decided_by_prior).max(0.0),
            converged: *converged,
            evaluations,
        };
        (relative.is_sound() && wrench.is_finite() && fit.chi_square.is_finite()).then_some(fit)
    }
}

/// Where a descent ended.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Minimum {
    parameters: Parameters,
    shape: Shape,
    normal: Normal,
    converged: bool,
}

impl Minimum {
    /// Whether this is the lower minimum, or the same one but settled.
    fn better_than(&self, other: &Self) -> bool {
        let margin = if self.converged && !other.converged {
            1e-2
        } else {
            -1e-2
        };
        self.normal.cost < other.normal.cost + margin
    }
}

/// Whether the strains alone fix the load.
fn told(normal: &Normal) -> bool {
    inverse_spd(&normal.hessian)
        .is_some_and(|inverse| normal.prior * (inverse[1][1] + inverse[2][2]) < PRIOR_SHARE)
}

/// Whether there may be a better minimum elsewhere.
fn is_suspicious(found: Option<&Minimum>) -> bool {
    found.is_none_or(|found| !found.converged || !(found.normal.chi_square < SUSPICIOUS))
}

/// Shapes that may be computed before those of the refinement.
fn before_refinement(budget: u8) -> u8 {
    budget.clamp(4, MAX_EVALUATIONS) - REFINEMENTS
}

/// The lower of two minima.
fn lower(a: Option<Minimum>, b: Option<Minimum>) -> Option<Minimum> {
    match (a, b) {
        (Some(a), Some(b)) if b.better_than(&a) => Some(b),
        (None, b) => b,
        (a, _) => a,
    }
}

/// Parameters with the force limited to [`MAX_LOAD`], direction kept.
fn bounded([curvature, fx, fy]: Parameters) -> Parameters {
    let load = fx.abs().max(fy.abs());
    let scale = if load > MAX_LOAD {
        MAX_LOAD / load
    } else {
        1.0
    };
    [curvature, scale * fx, scale * fy]
}

#[cfg(test)]
mod tests;
