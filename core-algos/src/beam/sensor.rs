//! The relative position sensor: samples of the bridges in, posture of the front axle in the rear
//! axle's coordinates out.
//!
//! [`RelativePositionSensor::sample`] (1 kHz) sums the conversions and continues an unfinished fit.
//! [`RelativePositionSensor::estimate`] (100 Hz) fits a line to the samples since the last estimate, or averages
//! them, calibrates, checks the gauges, and computes the posture from the healthy gauges. [`Config::build`]
//! validates; afterwards nothing fails: a posture that cannot be computed is `None`.
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

/// Largest number of integrations of the elastica (*shapes*) for a fit that leaves one gauge out.
const SEARCH_BUDGET: u8 = 16;
/// Largest number of integrations of the elastica in the tick of an estimate. Four are enough for all fits except one
/// in thousands.
const TICK_BUDGET: u8 = 5;
/// Largest number of integrations of the elastica in a tick that continues a fit. The number is lower because other
/// starts, and the end of a search, take longer than the integrations that they count as.
const WORK_BUDGET: u8 = 4;
/// Largest number of integrations of the elastica to begin a fit.
const BEGIN_EFFORT: u8 = TICK_BUDGET - FINISH_EFFORT;

/// Largest ratio of the weighted sum of squared residuals to the degrees of freedom that the stated uncertainties
/// explain. A fit of five gauges with these uncertainties exceeds the ratio with probability 0.02.
const EXPLAINED: f32 = 4.0;

/// Ratio of measured to configured noise (standard deviation) of a gauge above which the estimate is not consistent.
/// Healthy bridges have half the default noise.
const NOISY: f32 = 3.0;
/// Averaging length of the measured noise, periods.
const NOISE_PERIODS: u32 = 64;

declare! {
    /// Method that turns strains into a posture.
    pub enum Method, default Elastica {
        /// Polynomial, integrated segment by segment as in the paper.
        Piecewise = "piecewise",
        /// Polynomial, integrated by fast quadrature.
        Quadrature = "quadrature",
        /// Fit of the elastica; also estimates the wrench.
        Elastica = "elastica",
    }
}

declare! {
    /// Relative position sensor.
    pub struct Config {
        /// Strip and gauges.
        pub strip: strip::Config = strip::Config::default();
        /// Method that turns strains into a posture.
        pub method: Method = Method::default();
        /// Segments of the piecewise integration.
        pub segments: u16 = 100, "": Range(1.0, 10_000.0);
        /// True if the estimate is extrapolated to the present: the line fitted to the samples of the period,
        /// `latency_samples` after the last. Otherwise the estimate is the mean of the samples, half a period plus
        /// the latency old. The mean has 0.4 times the noise, but lags 13 mrad behind a frame that bends at its
        /// largest rate.
        pub extrapolate: bool = true;
        /// Delay of amplifier and converter, in sample intervals.
        // 0.8 ms of a 200 Hz amplifier and 1 ms of conversion.
        pub latency_samples: f32 = 1.8, "": Range(0.0, 100.0);
        /// Bridge counts to strain.
        pub calibration: calibration::Config = calibration::Config::default();
        /// Limits beyond which gauges are excluded.
        pub health: health::Config = health::Config::default();
        derived {
            /// Time between two estimates.
            pub period_s: f32 = 0.01, "s": Range(1e-4, 10.0);
        }
    }
}

impl Config {
    /// Builds the validated sensor; the error names the invalid field.
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

/// Posture from one set of strains, with the wrench, and the gauges and method used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// Front axle in the rear axle's coordinates.
    pub relative: RelativePosture,
    /// End forces; `None` unless the elastica gave the posture.
    pub wrench: Option<Wrench>,
    /// Gauges used for the posture.
    pub used: GaugeMask,
    /// Method used: the quadrature replaces a fit of the elastica that did not converge.
    pub method: Method,
    /// Weighted sum of squared residuals of the elastica; `None` if it was not fitted.
    pub chi_square: Option<f32>,
}

/// Computes postures from strains; has no state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PostureSolver {
    solver: Solver,
    method: Method,
    segments: u16,
    /// Quadrature through all gauges. A quadrature through fewer gauges is built when needed.
    all: Option<Quadrature>,
}

impl PostureSolver {
    /// A solver for `strip`; an error unless `segments` is 1 to 10 000.
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

    /// Strip for which this solver computes postures.
    pub fn strip(&self) -> &Strip {
        self.solver.strip()
    }

    /// The posture from the strains of the gauges in `mask`. Readings that are not finite or beyond
    /// [`strip::MAX_TURN`] are ignored. `None` with fewer than two usable readings, or if the result is not finite
    /// with positive variances.
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

    /// The posture from a converged fit of the elastica, otherwise from the polynomial.
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

/// Relative position sensor with checked parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativePositionSensor {
    /// Variance that the random walk of a gauge's zero adds in a period, strain².
    drift: f32,
    extrapolation_samples: Option<f32>,
    posture: PostureSolver,
    calibration: Calibration,
    monitor: Monitor,
}

/// State of the sensor: samples of the present period, health of the gauges, age of the zeros.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    periods: [Period; MAX_GAUGES],
    health: health::State,
    /// Number of periods since the node's start, over which the zeros drift.
    age: u32,
    /// Strain of each gauge at the last estimate. `good` holds the gauges whose strain is valid.
    strain: [f32; MAX_GAUGES],
    good: GaugeMask,
    /// Measured variance of the noise of each gauge's strain, strain².
    noise: [f32; MAX_GAUGES],
    /// Fit that continues with the next samples; `None` if every fit is finished. `start` is the start of the next
    /// estimate's fit; `None` for the polynomial's shape.
    work: Option<Work>,
    start: Option<Start>,
}

/// A fit that continues between estimates.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Work {
    curvature: [f32; MAX_GAUGES],
    used: GaugeMask,
    /// Variance of zero drift and excess noise, strain².
    drift: f32,
    purpose: Purpose,
    /// Search of the fit; `None` before the fit has begun.
    search: Option<Search>,
}

/// Purpose of a fit that continues with the next samples.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Purpose {
    /// Fit of the estimate itself. The next estimate starts from the result.
    Settle,
    /// Fit without this gauge, which may be the faulty one.
    LeaveOneOut(usize),
    /// Fit without this suspect, to test if the suspect is dead.
    Flat(usize),
}

/// Output of the sensor at the end of a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Front axle in the rear axle's coordinates; `None` with fewer than two healthy gauges. Valid at the end of the
    /// period; without extrapolation, at the middle less the latency.
    pub relative: Option<RelativePosture>,
    /// End forces; `None` unless the elastica gave the posture.
    pub wrench: Option<Wrench>,
    /// Strain of each gauge in the period; 0 without a valid reading.
    pub strain: [f32; MAX_GAUGES],
    /// Gauges used for the posture.
    pub used: GaugeMask,
    /// Fault of each gauge.
    pub faults: [Fault; MAX_GAUGES],
    /// Method that gave the posture.
    pub method: Method,
    /// Weighted sum of squared residuals of the elastica; `None` if it was not fitted.
    pub chi_square: Option<f32>,
    /// True if the stated uncertainties explain the residual of the fit, and no gauge has more than three times its
    /// stated noise. Excess noise enlarges the covariance. A residual above the limit of [`health::Config`] also
    /// enlarges the covariance, and starts the search for the faulty gauge if it persists.
    pub consistent: bool,
}

impl RelativePositionSensor {
    /// Strip that carries the gauges.
    pub fn strip(&self) -> &Strip {
        self.posture.strip()
    }

    /// The calibration in use.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// Takes one conversion of every gauge (entries beyond the strip's gauges are not read). A count outside the
    /// converter's range is a missing conversion. Cost: about 100 operations; with an unfinished fit, also four
    /// integrations of the elastica.
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
            match self.calibration.classify(counts[i]) {
                Conversion::Good => {
                    period.put(counts[i]);
                    state.health.add_sample(i, counts[i]);
                }
                Conversion::Saturated => period.saturated = period.saturated.saturating_add(1),
                Conversion::Missing => period.missing = period.missing.saturating_add(1),
            }
            period.conversions = period.conversions.saturating_add(1);
        }
    }

    /// Closes the period and estimates the posture from the samples since the last call. Cost: one fit of at most
    /// five integrations of the elastica. If the fit does not converge, the quadrature gives the posture. The fit then
    /// continues with the next samples ([`Self::sample`]), and the next estimate starts from the result of this fit.
    /// The search for a faulty gauge also runs with the next samples.
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
        // Without a converged fit the polynomial gives the posture, at the cost of the refinement that is then left
        // out.
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
            self.check_consistency(state, work, fit);
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

    /// Variance that the drift of the zeros has added to each gauge, strain².
    fn drift(&self, state: &State) -> f32 {
        self.drift * state.age as f32
    }

    /// Mean measured noise variance of the gauges in `good` above the configured variance, strain². True if no gauge
    /// is noisy ([`NOISY`]).
    fn excess_noise(&self, state: &State, good: GaugeMask) -> (f32, bool) {
        let sigma = self.strip().uncertainty.noise_strain;
        let configured = sigma * sigma;
        let (mut sum, mut quiet) = (0.0, true);
        for i in good.iter() {
            let noise = state.noise[i];
            sum += noise;
            quiet &= noise <= NOISY * NOISY * configured;
        }
        // Without gauges the quotient is NaN, and `max` returns 0.
        let excess = (sum / good.count() as f32 - configured).max(0.0);
        (excess, quiet)
    }

    /// Strain and fault of each gauge from its samples; starts a new period.
    fn close_period(&self, state: &mut State) -> ([f32; MAX_GAUGES], [Fault; MAX_GAUGES]) {
        let gauges = self.strip().gauges();
        let mut counts = [0.0; MAX_GAUGES];
        let mut verdicts = [Fault::None; MAX_GAUGES];
        for i in 0..MAX_GAUGES {
            let period = &state.periods[i];
            if period.saturated > 0 {
                // The average of the other samples would be biased.
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

    /// Schedules a fit without a gauge that may be faulty, if there is such a gauge.
    fn check_consistency(&self, state: &mut State, done: Work, fit: Option<Fit>) {
        let Some(fit) = fit.filter(|_| self.monitor.config.watch_consistency) else {
            return;
        };
        let health = &mut state.health;
        let left_out = self.monitor.add_residual(health, done.used, fit.chi_square);
        let flat = || health.suspect().filter(|&i| done.used.contains(i));
        let purpose = match left_out {
            Some(i) => Purpose::LeaveOneOut(i),
            None => match flat() {
                Some(i) => Purpose::Flat(i),
                None => return,
            },
        };
        state.work = Some(Work { purpose, ..done });
    }

    /// Continues the unfinished fit.
    #[inline(never)]
    fn work(&self, state: &mut State) {
        let mut effort = WORK_BUDGET;
        while let Some(work) = &mut state.work {
            let solver = &self.posture.solver;
            let (mask, budget) = match work.purpose {
                Purpose::Settle => (work.used, MAX_EVALUATIONS),
                Purpose::LeaveOneOut(i) | Purpose::Flat(i) => (work.used.without(i), SEARCH_BUDGET),
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

    /// Finishes the fit and uses its result according to the purpose of the fit.
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
                self.check_consistency(state, work, fit.filter(|fit| fit.converged));
            }
            Purpose::LeaveOneOut(i) => {
                // A failed fit counts as a large residual: the gauge is not faulty.
                let residual = fit.map_or(f32::MAX, |fit| fit.chi_square);
                self.monitor
                    .add_residual_without(&mut state.health, used, i, residual);
            }
            Purpose::Flat(i) => {
                let difference = fit.zip(work.curvature.get(i).copied());
                let difference = difference.map_or(0.0, |(fit, curvature)| {
                    curvature - fit.curvature.get(i).copied().unwrap_or(curvature)
                });
                let strain = difference * self.strip().half_thickness;
                self.monitor
                    .add_flat_difference(&mut state.health, i, strain);
            }
        }
    }
}

#[cfg(test)]
mod tests;
