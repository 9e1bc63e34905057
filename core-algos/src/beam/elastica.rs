//! The posture and the end forces from the strains, by the mechanics of the strip.
//!
//! A massless strip loaded at its ends only is an elastica: its curvature is linear in position,
//! EI κ = M_root + F_x y − F_y x. Three numbers describe every such shape, bent or post-buckled, and are fitted to
//! the strains. Unlike with a polynomial, the posture does not depend on the placement of the gauges. Each gauge
//! beyond the third checks the others, and the fit also gives the wrench (the frame force F_K of paper eq. 8).
//!
//! [`Solver`] is valid by construction. [`Solver::fit`] is infallible, bounded to [`MAX_EVALUATIONS`] shapes
//! (integrations of the elastica with derivatives), and returns `None` if no finite fit exists.

mod descent;
mod fit;
mod minimum;
mod ray;
mod start;
mod wrench;

use super::polynomial::Interpolant;
use super::strip::{GaugeMask, MAX_GAUGES, Strip};
use crate::math::matrix::{Mat3, cholesky, cholesky_solve};
use crate::math::trig::{ln, sin_cos, sinc};
use descent::Descent;
pub use fit::Fit;
use minimum::{Minimum, determines_load, is_exact, is_suspicious, lower, predicted_decrease};
use ray::{Leg, Parameters, Ray};
pub use start::Start;
pub use wrench::Wrench;
/// Largest number of integrations of the elastica (*shapes*) for one fit.
pub const MAX_EVALUATIONS: u8 = 40;
/// Predicted decrease of the cost, in squared standard deviations of the parameters, below which a step is the last:
/// this step is shorter than a tenth of a standard deviation.
const CONVERGED: f32 = 1e-2;
/// Weight of the heavy-tailed prior of the end force f: cost `TAIL` ln(1 + |f|²/σ²).
const TAIL: f32 = 3.0;
/// Weight of the force's prior once the strains determine the force.
const REFINED_TAIL: f32 = 1e-3 * TAIL;
/// Most Gauss–Newton steps with [`REFINED_TAIL`].
const REFINEMENTS: u8 = 2;
/// Upper limit of the residual (weighted sum of squares) that the prior causes with exact readings.
const PULLED: f32 = 2.0;
/// Residual without the prior's pull below which readings may be far more accurate than stated.
const NEARLY_EXACT: f32 = 0.1;
/// Decrease of the residual below which the prior's pull is negligible: 0.15 mm at the default uncertainty, a tenth of
/// a standard deviation.
const NEGLIGIBLE: f32 = 0.08;
/// Axial load, as a multiple of the prior's scale, above which the fit is compared with a fit from zero axial load.
const LARGE_LOAD: f32 = 3.0;
/// Cost of [`Solver::waves`], as a number of integrations of the elastica.
const STARTS_EFFORT: u8 = 2;
/// Limit of the integrations of the elastica in [`Solver::finish`].
pub const FINISH_EFFORT: u8 = REFINEMENTS;
/// Limit of |F_x| L²/EI and |F_y| L²/EI in a fit: sixteen times the load of the second buckling mode.
const MAX_LOAD: f32 = 1300.0;

/// A fit in progress: the lowest minimum so far, and the starts still to try.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    mask: GaugeMask,
    readings: Readings,
    best: Option<Minimum>,
    /// Starts of [`Solver::waves`]; `None` until they are computed. `tried` counts the starts already used.
    starts: Option<[Parameters; 3]>,
    tried: u8,
    /// Descent in progress from one of `starts`.
    descent: Option<Descent>,
    /// True if the lowest minimum came from an earlier fit's result or from one of `starts`.
    elsewhere: bool,
    open: bool,
    evaluations: u8,
}

impl Search {
    /// True if another start of the search may still lead to a lower minimum.
    pub fn is_open(&self) -> bool {
        self.open
    }

    /// True if the descent to the best minimum so far converged.
    pub fn is_converged(&self) -> bool {
        self.best.as_ref().is_some_and(|best| best.converged)
    }

    /// Start of the next fit; `None` if the next fit should start from the polynomial's shape.
    pub fn start(&self) -> Option<Start> {
        let best = self.best.as_ref().filter(|_| self.elsewhere)?;
        Some(Start(best.parameters))
    }
}

/// Elastica integrated for one set of parameters: curvatures at the gauges with derivatives, and both ends.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shape {
    curvature: [f32; MAX_GAUGES],
    gradient: [[f32; 3]; MAX_GAUGES],
    root: Ray,
    tip: Ray,
}

/// Readings of the gauges, with the weights and the budget of their fit.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Readings {
    /// Measured curvature × length of each gauge; 0 outside the mask.
    k: [f32; MAX_GAUGES],
    /// Inverse variance of each reading; 0 outside the mask.
    weights: [f32; MAX_GAUGES],
    /// Variance that the drift of the zeros added to each reading, (curvature × length)².
    drift: f32,
    /// Weight of the force's prior.
    tail: f32,
    /// Limit of the integrations of the elastica before the refinement.
    budget: u8,
}

/// Normal equations of the fit, linearised at one set of parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Normal {
    /// Jᵀ W J + prior: half the Hessian of the cost, approximately.
    hessian: Mat3,
    /// Half the negative gradient of the cost.
    descent: [f32; 3],
    /// Contribution of the prior to `hessian`, for each force.
    prior: f32,
    chi_square: f32,
    cost: f32,
}

/// Fits the elastica to the gauges of a strip. Holds the integration steps from gauge to gauge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solver {
    strip: Strip,
    /// Integration steps to each gauge, outward from the gauge before or from the middle.
    legs: [Leg; MAX_GAUGES],
    /// Integration steps from the outermost gauges to the root and to the tip.
    root_leg: Leg,
    tip_leg: Leg,
}

impl Solver {
    /// Solver for `strip`; computes the integration steps.
    pub fn new(strip: Strip) -> Self {
        let mut legs = [Leg::default(); MAX_GAUGES];
        let mut tip_u = 0.0;
        for i in strip.gauges.iter().filter(|&i| strip.u[i] >= 0.0) {
            legs[i] = Leg::new(tip_u, strip.u[i]);
            tip_u = strip.u[i];
        }
        let mut root_u = 0.0;
        for i in strip.gauges.iter().rev().filter(|&i| strip.u[i] < 0.0) {
            legs[i] = Leg::new(root_u, strip.u[i]);
            root_u = strip.u[i];
        }
        Self {
            strip,
            legs,
            root_leg: Leg::new(root_u, -1.0),
            tip_leg: Leg::new(tip_u, 1.0),
        }
    }

    /// Strip whose readings are fitted.
    pub fn strip(&self) -> &Strip {
        &self.strip
    }

    /// Integrates from the middle to the root and to the tip. `advance` integrates up to the next gauge or end, from
    /// the given u; `visit` is called at each gauge.
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

    /// Weights of the readings `k` (curvature × length): inverse variances, 0 outside the mask; `drift` is the
    /// variance added by the drift of the zeros.
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

    /// Start of the fit. The shape of the interpolating polynomial, integrated in arcs, gives the positions of the
    /// gauges; the balance of moments is then linear in the parameters.
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
    /// Gauss–Newton, damped only when a step fails, from the polynomial's shape; also from waves of small-deflection
    /// theory if the residual is large. Readings are weighted by their inverse variance
    /// ([`super::strip::Uncertainty`]). A weak heavy-tailed prior bounds forces that the strains do not determine.
    /// The weight of the prior falls to a thousandth if the readings determine the load at their stated variance, if
    /// the best shape of four or more readings has a large load, or if their residual shows that they are far more
    /// accurate than stated. With two gauges the prior determines the third parameter, and the covariance includes
    /// the prior. `None` if fewer than two readings are usable or no finite shape was found.
    ///
    /// Four or more readings determine the shape uniquely among all shapes that a robot can take. Three readings may
    /// fit several shapes near the buckling load; the fit returns the least loaded. Cost: about 8 000 instructions a
    /// shape, three or four shapes as a rule, at most [`MAX_EVALUATIONS`].
    pub fn fit(&self, curvature: &[f32; MAX_GAUGES], mask: GaugeMask) -> Option<Fit> {
        self.fit_within(curvature, mask, 0.0, MAX_EVALUATIONS)
    }

    /// As [`Self::fit`], with zeros that have drifted independently, and at most `budget` integrations of the elastica
    /// (4 to [`MAX_EVALUATIONS`]). `drift` is the variance of the zeros' random walk, strain². The drift lowers the
    /// weight of the readings and enlarges the covariance of the wrench. The covariance of the posture excludes the
    /// drift, which is not noise: the filter that uses the posture must model the drift ([`crate::fusion::joint`]).
    pub fn fit_within(
        &self,
        curvature: &[f32; MAX_GAUGES],
        mask: GaugeMask,
        drift: f32,
        budget: u8,
    ) -> Option<Fit> {
        let mut search = self.begin(curvature, mask, (drift, None), budget)?;
        self.go_on(&mut search, budget, u8::MAX);
        self.finish(&search)
    }

    /// Begins the fit of [`Self::fit_within`]. The fit starts at `start`, the result of an earlier fit, if there is one,
    /// and at the shape of the polynomial. `budget` is the most integrations of the elastica that this function and
    /// [`Self::finish`] make together.
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
        // Several shapes can fit three readings exactly; the prior selects the least loaded.
        let ambiguous = mask.count() <= 3;
        let mut best = None;
        if let Some(Start(start)) = start {
            best = self.descend(start, &readings, &mut evaluations);
        }
        let remembered = best.as_ref().map(|found| found.parameters);
        let affordable = evaluations < readings.budget;
        if affordable && (ambiguous || is_suspicious(best.as_ref())) {
            let start = self.start(&interpolant, &k, &weights);
            best = lower(best, self.descend(start, &readings, &mut evaluations));
        }
        // Noise on a nearly straight strip can look like a small buckled shape: a large load must have a lower cost
        // than zero axial load.
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
            starts: None,
            tried: 0,
            descent: None,
            elsewhere: remembered.is_some()
                && best.as_ref().map(|found| found.parameters) == remembered,
            open: is_suspicious(best.as_ref()) || ambiguous || !compared,
            evaluations,
        })
    }

    /// Continues the search with at most `effort` integrations of the elastica, and at most `budget` for the whole fit.
    /// The starts from small-deflection theory cost two integrations. Returns the unused effort.
    pub fn go_on(&self, search: &mut Search, budget: u8, mut effort: u8) -> u8 {
        search.readings.budget = before_refinement(budget);
        let readings = &search.readings;
        while search.open {
            let Some(starts) = search.starts else {
                if effort < STARTS_EFFORT {
                    return 0;
                }
                effort -= STARTS_EFFORT;
                search.starts = Some(self.waves(&readings.k, &readings.weights));
                continue;
            };
            let evaluations = &mut search.evaluations;
            let limit = evaluations.saturating_add(effort);
            let start = starts.get(usize::from(search.tried)).copied();
            let fresh = |evaluations: &mut u8| self.start_at(start?, readings, evaluations);
            let mut descent = match search.descent.take() {
                None if effort == 0 => return 0,
                None => fresh(evaluations),
                under_way => under_way,
            };
            while let Some(descent) = descent.as_mut().filter(|descent| !descent.done) {
                if *evaluations >= limit {
                    search.descent = Some(*descent);
                    return 0;
                }
                self.descend_once(descent, readings, evaluations);
            }
            effort = limit.saturating_sub(*evaluations);
            let before = search.best.as_ref().map(|best| best.parameters);
            search.best = lower(search.best, descent.map(|descent| descent.lowest));
            search.elsewhere |= search.best.as_ref().map(|best| best.parameters) != before;
            search.tried += 1;
            let more = usize::from(search.tried) < starts.len();
            let ambiguous = search.mask.count() <= 3;
            search.open = more && (ambiguous || is_suspicious(search.best.as_ref()));
        }
        effort
    }

    /// Refined fit of the best minimum so far: at most two integrations of the elastica. `None` if the shape is not
    /// finite.
    pub fn finish(&self, search: &Search) -> Option<Fit> {
        let mut best = search.best?;
        let mut readings = search.readings;
        let mut evaluations = search.evaluations;
        // If the strains determine the load, or the best minimum has a large load, the prior would only bias the fit.
        let [_, fx, fy] = best.parameters;
        let ambiguous = search.mask.count() <= 3;
        let won = fx.abs().max(fy.abs()) > self.large_load() && !ambiguous;
        let known = won || determines_load(&best.normal);
        let weak = Readings {
            tail: REFINED_TAIL,
            ..readings
        };
        if known || self.may_be_exact(&best, &weak) {
            // The budget bounds the time of the tick. A search that has used up its budget leaves time for one step.
            let spent = evaluations >= readings.budget;
            for _ in 0..if spent { 1 } else { REFINEMENTS } {
                let (refined, settled) = self.refined(best, &weak, &mut evaluations);
                best = refined;
                if settled {
                    break;
                }
            }
            if known || self.is_exact(&best, &weak, search.mask) {
                readings = weak;
            } else {
                best = search.best?;
            }
        }
        self.result(&best, search.mask, &readings, evaluations)
    }

    /// True if the readings seem to be far more accurate than stated and determine the load, so that the prior biases
    /// the shape.
    fn may_be_exact(&self, minimum: &Minimum, weak: &Readings) -> bool {
        // With exact readings, the residual due to the prior is below this limit.
        if !(minimum.normal.chi_square < PULLED) {
            return false;
        }
        let normal = self.normal(&minimum.shape, minimum.parameters, weak);
        predicted_decrease(&normal).is_some_and(|decrease| {
            decrease > NEGLIGIBLE
                && normal.chi_square - decrease < NEARLY_EXACT
                && determines_load(&normal)
        })
    }

    /// True if the residual shows that the readings are far more accurate than stated.
    fn is_exact(&self, minimum: &Minimum, weak: &Readings, mask: GaugeMask) -> bool {
        let within = |residual| is_exact(mask, residual);
        let residual = minimum.normal.chi_square;
        // A used-up budget may have ended the refinement one step too early.
        within(residual)
            || residual < NEARLY_EXACT && {
                let normal = self.normal(&minimum.shape, minimum.parameters, weak);
                predicted_decrease(&normal).is_some_and(|decrease| within(residual - decrease))
            }
    }

    /// Axial load, EI/L², above which the fit is compared with a fit from zero axial load.
    fn large_load(&self) -> f32 {
        LARGE_LOAD * self.strip.uncertainty.load_prior
    }

    /// One Gauss–Newton step from a minimum towards the minimum for `readings`. True if the step was small or failed.
    fn refined(&self, from: Minimum, readings: &Readings, evaluations: &mut u8) -> (Minimum, bool) {
        let normal = self.normal(&from.shape, from.parameters, readings);
        let Some(factor) = cholesky(&normal.hessian) else {
            return (from, true);
        };
        let step = cholesky_solve(&factor, &normal.descent);
        let mut parameters = from.parameters;
        let mut decrease = 0.0;
        for i in 0..3 {
            parameters[i] += step[i];
            decrease += step[i] * normal.descent[i];
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
            (refined, decrease < CONVERGED)
        } else {
            (from, true)
        }
    }
}

/// Part of a budget of integrations that the search may use; the rest is kept for the refinement.
fn before_refinement(budget: u8) -> u8 {
    budget.clamp(4, MAX_EVALUATIONS) - REFINEMENTS
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
