//! The relative position sensor: samples of the bridges in, posture of the front axle in the rear
//! axle's frame out.
//!
//! [`RelativePositionSensor::sample`] takes each conversion (1 kHz) and only sums;
//! [`RelativePositionSensor::estimate`] (100 Hz) averages what came since, calibrates, judges the
//! gauges and computes the posture from those that can be believed. [`Config::build`] validates;
//! afterwards nothing fails: a posture that cannot be given is `None`.
//!
//! # Example
//!
//! ```
//! use core_algos::beam::MAX_GAUGES;
//! use core_algos::beam::sensor::{Config, State};
//!
//! let config = Config::default();
//! let sensor = config.build()?;
//! // Counts of each bridge with the strip bent to a circle of 0.5 m radius.
//! let strain = 2.0 * config.strip.half_thickness_m;
//! let zero = config.calibration.zero_counts.padded();
//! let counts = zero.map(|zero| (zero + strain / config.calibration.strain_per_count) as i32);
//! let mut state = State::default();
//! for _ in 0..10 {
//!     sensor.sample(&mut state, &counts);
//! }
//! let estimate = sensor.estimate(&mut state);
//! let posture = estimate.relative.expect("five good gauges").posture;
//! let turn = 2.0 * config.strip.length_m;
//! assert!((posture.phi - turn).abs() < 2e-3);
//! assert!((posture.x - 0.5 * turn.sin()).abs() < 1e-3);
//! assert!((posture.y - 0.5 * (1.0 - turn.cos())).abs() < 1e-3);
//! assert!(estimate.wrench.is_some() && estimate.consistent);
//! // Bridges that are not there give no posture.
//! sensor.sample(&mut state, &[-1; MAX_GAUGES]);
//! assert!(sensor.estimate(&mut state).relative.is_none());
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

mod period;

use super::calibration::{self, Calibration, Conversion};
use super::elastica::{FINISH_EFFORT, Fit, MAX_EVALUATIONS, Search, Solver, Start, Wrench};
use super::health::{self, Fault, Monitor};
use super::polynomial::{Interpolant, Quadrature, piecewise, quadrature};
use super::strip::{self, GaugeMask, MAX_GAUGES, RelativePosture, Strip};
use crate::config::{ConfigError, declare, in_range};
use crate::math::matrix::scale;
use period::Period;

/// Shapes computed for a fit that only looks for the gauge to blame.
const SEARCH_BUDGET: u8 = 16;
/// Most shapes computed in the tick of an estimate; four settle all fits but one in thousands.
const TICK_BUDGET: u8 = 5;
/// The same of a tick of the work that is left: other starts and the end of a search cost more than they count.
const WORK_BUDGET: u8 = 4;
/// Most shapes computed to begin a fit.
const BEGIN_EFFORT: u8 = TICK_BUDGET - FINISH_EFFORT;

/// Weighted sum of squared residuals over degrees of freedom up to which the stated uncertainties explain it. With
/// five gauges of those uncertainties a fit exceeds it with probability 0.02.
const EXPLAINED: f32 = 4.0;

/// Measured over configured standard deviation of a gauge's noise from which on the gauge is inconsistent. Sound bridges
/// have half the default.
const NOISY: f32 = 3.0;
/// Periods over which the noise is measured.
const NOISE_PERIODS: u32 = 64;

declare! {
    /// Method that turns strains into a posture.
    pub enum Method, default Elastica {
        /// Polynomial, integrated segment by segment as in the paper.
        Piecewise = "piecewise",
        /// The same polynomial, fast quadrature.
        Quadrature = "quadrature",
        /// Fit of the elastica; gives the wrench too.
        Elastica = "elastica",
    }
}

declare! {
    /// The whole sensor.
    pub struct Config {
        /// Strip and gauges.
        pub strip: strip::Config = strip::Config::default();
        /// Method that turns strains into a posture.
        pub method: Method = Method::default();
        /// Pieces of the piecewise integration.
        pub segments: u16 = 100, "": Range(1.0, 10_000.0);
        /// True if the estimate is that of the present: on the line fitted to the samples of the
        /// period, `latency_samples` after the last. Otherwise their mean, half a period old, which has
        /// a third of the noise but lags 10 mrad behind a frame that bends at its largest rate.
        pub extrapolate: bool = true;
        /// Age of a conversion when it arrives, in sample intervals: amplifier and converter.
        // 0.8 ms of a 200 Hz amplifier and 1 ms of conversion.
        pub latency_samples: f32 = 1.8, "": Range(0.0, 100.0);
        /// Bridge counts to strain.
        pub calibration: calibration::Config = calibration::Config::default();
        /// Limits beyond which gauges are taken out.
        pub health: health::Config = health::Config::default();
        derived {
            /// Time between two estimates.
            pub period_s: f32 = 0.01, "s": Range(1e-4, 10.0);
        }
    }
}

impl Config {
    /// Checks every field.
    pub fn build(&self) -> Result<RelativePositionSensor, ConfigError> {
        self.check_ranges()?;
        let strip = self.strip.build()?;
        let period = self.period_s;
        let walk = self.strip.uncertainty.zero_walk_strain_per_sqrt_s;
        let latency = self.latency_samples;
        Ok(RelativePositionSensor {
            drift: walk * walk * period,
            extrapolation_samples: self.extrapolate.then_some(latency),
            posture: PostureSolver::new(strip, self.method, self.segments)?,
            calibration: self.calibration.build(strip.gauges().count() as usize)?,
            monitor: self.health.build()?,
        })
    }
}

/// Posture with wrench, gauges and method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// Front axle in the rear axle's frame.
    pub relative: RelativePosture,
    /// End forces; from the elastica only.
    pub wrench: Option<Wrench>,
    /// Gauges it was made from.
    pub used: GaugeMask,
    /// The method that gave it: the quadrature stands in for an elastica that did not settle.
    pub method: Method,
    /// Weighted sum of squared residuals of the elastica, where it was fitted.
    pub chi_square: Option<f32>,
}

/// Strains to posture, without memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PostureSolver {
    solver: Solver,
    method: Method,
    segments: u16,
    /// Quadrature through all gauges; one through fewer is made when it is needed.
    all: Option<Quadrature>,
}

impl PostureSolver {
    /// A solver for `strip`.
    pub fn new(strip: Strip, method: Method, segments: u16) -> Result<Self, ConfigError> {
        in_range("segments", f32::from(segments), 1.0, 10_000.0)?;
        Ok(Self {
            solver: Solver::new(strip),
            method,
            segments,
            all: Interpolant::new(&strip, strip.gauges())
                .map(|interpolant| Quadrature::new(&strip, interpolant)),
        })
    }

    /// The strip.
    pub fn strip(&self) -> &Strip {
        self.solver.strip()
    }

    /// The posture from the strains of the gauges `mask`; readings that are not finite or bend the
    /// strip beyond reason are left out. `None` if fewer than two are left or nothing sound came
    /// out.
    pub fn solve(&self, strain: &[f32; MAX_GAUGES], mask: GaugeMask) -> Option<Solution> {
        let curvature = self.strip().curvature(strain);
        let used = self.strip().usable(&curvature, mask);
        let fit = (self.method == Method::Elastica)
            .then(|| {
                self.solver
                    .fit_within(&curvature, used, 0.0, MAX_EVALUATIONS)
            })
            .flatten();
        self.solution(&curvature, used, fit.filter(|fit| fit.converged))
    }

    /// The posture from an elastica that settled, else from the polynomial.
    fn solution(
        &self,
        curvature: &[f32; MAX_GAUGES],
        used: GaugeMask,
        fit: Option<Fit>,
    ) -> Option<Solution> {
        let chi_square = fit.map(|fit| fit.chi_square);
        match (self.method, fit) {
            (Method::Elastica, Some(fit)) => Some(Solution {
                relative: fit.relative,
                wrench: Some(fit.wrench),
                used,
                method: Method::Elastica,
                chi_square,
            }),
            (Method::Piecewise, _) => {
                self.polynomial(curvature, used, Method::Piecewise, chi_square)
            }
            _ => self.polynomial(curvature, used, Method::Quadrature, chi_square),
        }
    }

    fn polynomial(
        &self,
        curvature: &[f32; MAX_GAUGES],
        used: GaugeMask,
        method: Method,
        chi_square: Option<f32>,
    ) -> Option<Solution> {
        let strip = self.strip();
        let fewer;
        let rule = match &self.all {
            Some(all) if all.interpolant().mask() == used => all,
            _ => {
                fewer = Quadrature::new(strip, Interpolant::new(strip, used)?);
                &fewer
            }
        };
        let relative = match method {
            Method::Piecewise => piecewise(strip, rule, curvature, self.segments),
            _ => quadrature(strip, rule, curvature),
        };
        relative.is_sound().then_some(Solution {
            relative,
            wrench: None,
            used,
            method,
            chi_square,
        })
    }
}

/// Validated sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativePositionSensor {
    /// Variance that the walk of a gauge's zero adds in a period, strain².
    drift: f32,
    extrapolation_samples: Option<f32>,
    posture: PostureSolver,
    calibration: Calibration,
    monitor: Monitor,
}

/// All that changes in the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    periods: [Period; MAX_GAUGES],
    health: health::State,
    /// Periods since the zeros were known.
    age: u32,
    /// Last strains and the gauges they are good for.
    strain: [f32; MAX_GAUGES],
    good: GaugeMask,
    /// Measured variance of the noise of each gauge's strain, strain².
    noise: [f32; MAX_GAUGES],
    /// Work left by the last estimate, with the start of the next one.
    work: Option<Work>,
    start: Option<Start>,
}

/// A fit that goes on between estimates.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Work {
    curvature: [f32; MAX_GAUGES],
    used: GaugeMask,
    /// Variance of walk and excess noise, strain².
    drift: f32,
    purpose: Purpose,
    /// `None` before it has begun.
    search: Option<Search>,
}

/// Purpose of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Purpose {
    /// The estimate's own: the next one starts where it ends.
    Settle,
    /// Fit without this gauge, which may be the faulty one.
    Blame(usize),
    /// Fit of the other gauges, to test if this one is flat.
    Flat(usize),
}

/// Output of the sensor at the end of a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Front axle in the rear axle's frame; `None` if fewer than two gauges can be believed. It is
    /// that of the end of the period, or of its middle without extrapolation.
    pub relative: Option<RelativePosture>,
    /// End forces, if the elastica gave the posture.
    pub wrench: Option<Wrench>,
    /// Average strain of each gauge; 0 where there is none.
    pub strain: [f32; MAX_GAUGES],
    /// Gauges the posture was made from.
    pub used: GaugeMask,
    /// Fault of each gauge.
    pub faults: [Fault; MAX_GAUGES],
    /// Method that gave the posture.
    pub method: Method,
    /// Weighted sum of squared residuals of the elastica, where it was fitted.
    pub chi_square: Option<f32>,
    /// True if the stated uncertainties of zeros and gains explain the residual of the readings, and no gauge has several
    /// times its stated noise. More of either enlarges the covariance; with a residual the gauge to blame is searched.
    pub consistent: bool,
}

impl RelativePositionSensor {
    /// The strip.
    pub fn strip(&self) -> &Strip {
        self.posture.strip()
    }

    /// The calibration in use.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// Takes one conversion of every gauge (entries beyond the strip's gauges are not read). A
    /// count outside the converter's range means that there was none. Cost about 100 operations; while an
    /// estimate has left work, at most five shapes of it, so that nine calls do it all.
    pub fn sample(&self, state: &mut State, counts: &[i32; MAX_GAUGES]) {
        if state.work.is_some() {
            self.work(state);
        }
        let gauges = self.strip().gauges();
        for i in 0..MAX_GAUGES {
            if !gauges.contains(i) {
                continue;
            }
            let period = &mut state.periods[i];
            match self.calibration.judge(counts[i]) {
                Conversion::Good => {
                    period.put(counts[i]);
                    state.health.see(i, counts[i]);
                }
                Conversion::Saturated => period.saturated = period.saturated.saturating_add(1),
                Conversion::Missing => period.missing = period.missing.saturating_add(1),
            }
            period.seen = period.seen.saturating_add(1);
        }
    }

    /// Closes the period: the posture from the samples since the last call. Cost: one fit of at most
    /// five shapes. Where that does not settle, the quadrature stands in; the search goes on
    /// with the next samples ([`Self::sample`]), and the next estimate starts where it ended. So does
    /// the search for a gauge to blame.
    pub fn estimate(&self, state: &mut State) -> Estimate {
        let strip = self.strip();
        let gauges = strip.gauges();
        let drift = self.drift(state);
        let (strain, verdicts) = self.close_period(state);
        state.age = state.age.saturating_add(1);
        self.monitor
            .close_period(&mut state.health, gauges, &verdicts);
        let latched = state.health.latched();
        let mut good = GaugeMask::NONE;
        for i in 0..MAX_GAUGES {
            if gauges.contains(i) && verdicts[i] == Fault::None && !latched.contains(i) {
                good = good.with(i);
            }
        }
        let (excess, quiet) = self.excess_noise(state, good);
        let drift = drift + excess;
        let watched = self.monitor.config.watch_consistency;
        let curvature = strip.curvature(&strain);
        let used = strip.usable(&curvature, good);
        let solver = &self.posture.solver;
        let search = if watched || self.posture.method == Method::Elastica {
            solver.begin(&curvature, used, (drift, state.start), TICK_BUDGET)
        } else {
            None
        };
        // Without a minimum the polynomial replaces the fit, at the cost of a refinement.
        let minimum = search.as_ref().filter(|search| search.is_converged());
        let fit = minimum.and_then(|search| solver.finish(search));
        let solution = self.posture.solution(&curvature, used, fit);
        state.start = search.as_ref().and_then(Search::start);
        state.work = None;
        let work = Work {
            curvature,
            used,
            drift,
            purpose: Purpose::Settle,
            search: None,
        };
        if search.as_ref().is_some_and(Search::is_open) {
            state.work = Some(Work { search, ..work });
        } else {
            self.cross_examine(state, work, fit);
        }
        state.strain = strain;
        state.good = good;
        let within = |limit: f32| fit.is_none_or(|fit| !watched || fit.chi_square <= limit);
        let degrees = fit.map_or(1.0, |fit| fit.degrees_of_freedom.max(1.0));
        let contradictory = !within(self.monitor.config.max_chi_square);
        let mut relative =
            solution.map(|solution| strip.with_excess_noise(solution.relative, excess));
        if let (Some(relative), Some(fit), true) = (&mut relative, &fit, contradictory) {
            let factor = fit.chi_square / degrees;
            for covariance in [&mut relative.covariance, &mut relative.noise] {
                let enlarged = scale(covariance, factor.max(1.0));
                if crate::math::matrix::is_finite(&enlarged) {
                    *covariance = enlarged;
                }
            }
        }
        Estimate {
            relative,
            wrench: solution.and_then(|solution| solution.wrench),
            strain,
            used: solution.map_or(GaugeMask::NONE, |solution| solution.used),
            faults: state.health.faults(),
            method: solution.map_or(self.posture.method, |solution| solution.method),
            chi_square: fit.map(|fit| fit.chi_square),
            consistent: within(EXPLAINED * degrees) && quiet,
        }
    }

    /// Variance that the walk of the zeros has added to each gauge, strain².
    fn drift(&self, state: &State) -> f32 {
        self.drift * state.age as f32
    }

    /// Mean measured noise of the gauges `good` beyond the configured one, strain²; true if none of them is noisy.
    fn excess_noise(&self, state: &State, good: GaugeMask) -> (f32, bool) {
        let sigma = self.strip().uncertainty.noise_strain;
        let configured = sigma * sigma;
        let (mut sum, mut quiet) = (0.0, true);
        for i in good.iter() {
            let noise = state.noise[i];
            sum += noise;
            quiet &= noise <= NOISY * NOISY * configured;
        }
        // Without gauges not a number, of which the maximum makes 0.
        let excess = (sum / good.count() as f32 - configured).max(0.0);
        (excess, quiet)
    }

    /// Strain and fault of each gauge by its samples; starts a new period.
    fn close_period(&self, state: &mut State) -> ([f32; MAX_GAUGES], [Fault; MAX_GAUGES]) {
        let gauges = self.strip().gauges();
        let mut counts = [0.0; MAX_GAUGES];
        let mut verdicts = [Fault::None; MAX_GAUGES];
        for i in 0..MAX_GAUGES {
            let period = &state.periods[i];
            if period.saturated > 0 {
                // The average of the rest would be biased.
                verdicts[i] = Fault::Saturated;
            } else if period.good == 0 || period.missing > period.good {
                verdicts[i] = Fault::Missing;
            } else {
                let ahead = self.extrapolation_samples;
                counts[i] = period.count(ahead);
                if let Some(variance) = period.variance(ahead) {
                    let resolution = self.calibration.resolution();
                    let share = 1.0 / (state.age.min(NOISE_PERIODS - 1) + 1) as f32;
                    state.noise[i] += share * (variance * resolution * resolution - state.noise[i]);
                }
            }
        }
        state.periods = [Period::default(); MAX_GAUGES];
        let mut strain = self.calibration.strain(&counts);
        for i in 0..MAX_GAUGES {
            if verdicts[i] == Fault::None && !self.calibration.is_plausible(strain[i]) {
                verdicts[i] = Fault::OutOfRange;
            }
            if verdicts[i] != Fault::None || !gauges.contains(i) {
                strain[i] = 0.0;
            }
        }
        (strain, verdicts)
    }

    /// Asks for one more fit without a gauge that is under suspicion, if any is.
    fn cross_examine(&self, state: &mut State, done: Work, fit: Option<Fit>) {
        let Some(fit) = fit.filter(|_| self.monitor.config.watch_consistency) else {
            return;
        };
        let health = &mut state.health;
        let blame = self.monitor.watch(health, done.used, fit.chi_square);
        let flat = || health.suspect().filter(|&i| done.used.contains(i));
        let purpose = match blame {
            Some(i) => Purpose::Blame(i),
            None => match flat() {
                Some(i) => Purpose::Flat(i),
                None => return,
            },
        };
        state.work = Some(Work { purpose, ..done });
    }

    /// Continues the work that an estimate has left.
    #[inline(never)]
    fn work(&self, state: &mut State) {
        let mut effort = WORK_BUDGET;
        while let Some(work) = &mut state.work {
            let solver = &self.posture.solver;
            let (mask, budget) = match work.purpose {
                Purpose::Settle => (work.used, MAX_EVALUATIONS),
                Purpose::Blame(i) | Purpose::Flat(i) => (work.used.without(i), SEARCH_BUDGET),
            };
            match &mut work.search {
                None if effort < BEGIN_EFFORT => return,
                None => {
                    effort -= BEGIN_EFFORT;
                    let start = (work.drift, None);
                    work.search = solver.begin(&work.curvature, mask, start, TICK_BUDGET);
                    if work.search.is_none() {
                        self.conclude(state);
                    }
                }
                Some(search) if search.is_open() => {
                    effort = solver.go_on(search, budget, effort);
                    if search.is_open() {
                        return;
                    }
                }
                Some(_) if effort < FINISH_EFFORT => return,
                Some(_) => {
                    effort -= FINISH_EFFORT;
                    self.conclude(state);
                }
            }
        }
    }

    /// Ends the fit under way and uses it for its purpose.
    fn conclude(&self, state: &mut State) {
        let Some(work) = state.work.take() else {
            return;
        };
        let solver = &self.posture.solver;
        let used = work.used;
        let search = work.search.as_ref();
        let fit = search.and_then(|search| solver.finish(search));
        let start = search.and_then(Search::start);
        let work = Work {
            search: None,
            ..work
        };
        match work.purpose {
            Purpose::Settle => {
                state.start = start;
                self.cross_examine(state, work, fit.filter(|fit| fit.converged));
            }
            Purpose::Blame(i) => {
                // Without a fit there is nothing to be said for it.
                let residual = fit.map_or(f32::MAX, |fit| fit.chi_square);
                self.monitor.hear(&mut state.health, used, i, residual);
            }
            Purpose::Flat(i) => {
                let difference = fit.zip(work.curvature.get(i).copied());
                let difference = difference.map_or(0.0, |(fit, curvature)| {
                    curvature - fit.curvature.get(i).copied().unwrap_or(curvature)
                });
                let strain = difference * self.strip().half_thickness;
                self.monitor.judge_flat(&mut state.health, i, strain);
            }
        }
    }
}

#[cfg(test)]
mod tests;
