//! Health of the gauges.
//!
//! Three tests, from cheap to costly: samples of a period, flatness, and consistency with the other gauges. Times are
//! periods of the sensor; numbers are the defaults of [`Config`]. A *suspect* is a flat gauge that may be dead. A
//! *round* of the search leaves out each gauge once.
//!
//! | condition | reaction | after | until | reason |
//! |---|---|---|---|---|
//! | samples of a period missing, saturated or out of range | the latest such fault is reported | 5 bad periods in a row, of any kind | 50 good periods in a row | a single bad period is no defect; the sensor excludes its reading at once |
//! | gauge dead or inconsistent | its samples are ignored, also in the tests of other gauges | at once | reset | the fault is latched |
//! | gauge flat: count constant, while at least half of the other gauges, and at least one, moved by 60 counts or more | suspect, if 4 or more gauges have samples | a window of 50 periods | the next window closes | all gauges are flat on a strip at rest |
//! | gauge flat, 3 or fewer gauges with samples | dead | a window of 50 periods | reset | too few other gauges for a comparison |
//! | suspect differs by more than 2e-5 strain from the fit of the others | dead | 5 fits in a row | reset | a healthy gauge may be at a node of the bend, where strain stays constant |
//! | several suspects | one fit a period, in turn | at once | the suspicion ends | computing time |
//! | residual of the fit above 30, or not a number | search: one fit a period, each without one gauge | 5 fits in a row, 5 or more gauges used | a fit at 30 or below, which ends the count and the search | with fewer gauges, every fit without one gauge has a small residual |
//! | round complete: the residual without one gauge is below 15, and the residuals without each other gauge are more than 15 higher | verdict against this gauge | at the end of the round | a round with another result, a fit at 30 or below, a latched gauge | two gauges may be faulty |
//! | 2 verdicts in a row against one gauge | inconsistent | at once | reset | a single round may be chance |
//!
//! A round counts only if the gauges tested in the round are the gauges in use at its end. [`Config::build`]
//! validates; nothing else can fail.

use super::strip::{GaugeMask, MAX_GAUGES};
use crate::config::{Allowed, ConfigError, declare, require};

/// Fault of a gauge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fault {
    /// No fault.
    #[default]
    None,
    /// The converter gives no counts.
    Missing,
    /// The converter is at an end of its range.
    Saturated,
    /// The strain is implausibly large, or not a number.
    OutOfRange,
    /// The reading is constant while the readings of other gauges change.
    Dead,
    /// The reading is inconsistent with the readings of the other gauges.
    Inconsistent,
}

impl Fault {
    /// True if the fault lasts until reset.
    fn is_latched(self) -> bool {
        matches!(self, Self::Dead | Self::Inconsistent)
    }
}

declare! {
    /// Limits beyond which a gauge is excluded.
    pub struct Config {
        /// Bad periods in a row until a fault is reported.
        pub trip_periods: u8 = 5, "": Range(1.0, 255.0);
        /// Good periods in a row until a reported fault ends.
        pub clear_periods: u8 = 50, "": Range(1.0, 255.0);
        /// Periods in the window of the flatness test.
        pub flat_window_periods: u16 = 50, "": Range(2.0, 10_000.0);
        /// Range of a gauge's counts in the window from which the gauge counts as moving. A constant gauge is suspect
        /// only if at least half of the others move.
        pub active_counts: i32 = 60, "counts": Range(2.0, 16_777_216.0);
        /// Difference between a flat gauge and the fit of the other gauges above which the gauge is dead.
        pub dead_strain: f32 = 2e-5, "strain": Range(1e-7, 1e-2);
        /// True if the residual of the fit is monitored. Costs one fit a period when the method is not the elastica.
        pub watch_consistency: bool = true;
        /// Weighted sum of squared residuals above which the readings are inconsistent. With the stated uncertainties
        /// a healthy strip exceeds 30 with probability 2e-6 or less with five gauges, 4e-5 or less with eight.
        pub max_chi_square: f32 = 30.0, "": Range(5.0, 1e6);
        /// Rounds of the search in a row with a verdict against the same gauge after which the gauge is inconsistent.
        pub verdicts: u8 = 2, "": Range(1.0, 255.0);
    }
}

impl Config {
    /// Builds the validated monitor; the error names the invalid field.
    pub fn build(&self) -> Result<Monitor, ConfigError> {
        self.check_ranges()?;
        require(
            self.active_counts >= 2,
            "active_counts",
            self.active_counts as f32,
            Allowed::Condition("2 or more"),
        )?;
        Ok(Monitor { config: *self })
    }
}

/// Validated health monitor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Monitor {
    pub(super) config: Config,
}

/// State of the monitor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    faults: [Fault; MAX_GAUGES],
    bad_periods: [u8; MAX_GAUGES],
    good_periods: [u8; MAX_GAUGES],
    /// Lowest and highest count in the window; `None` before the first sample.
    window: [Option<(i32, i32)>; MAX_GAUGES],
    window_periods: u16,
    /// Suspects: gauges that were flat in the last window.
    flat: GaugeMask,
    flat_periods: [u8; MAX_GAUGES],
    inconsistent_periods: u8,
    next: u8,
    /// Residual of the fit without each gauge, for the gauges tested in the present round of the search.
    without: [f32; MAX_GAUGES],
    tested: GaugeMask,
    verdict: Option<u8>,
    verdicts: u8,
}

impl State {
    /// Fault of each gauge.
    pub fn faults(&self) -> [Fault; MAX_GAUGES] {
        self.faults
    }

    /// Gauges excluded until reset.
    pub fn latched(&self) -> GaugeMask {
        let mut latched = GaugeMask::NONE;
        for i in 0..MAX_GAUGES {
            if self.faults[i].is_latched() {
                latched = latched.with(i);
            }
        }
        latched
    }

    /// Suspect to compare with the fit of the others in this period. Several suspects take turns.
    pub(super) fn suspect(&self) -> Option<usize> {
        let turn = usize::from(self.window_periods) % MAX_GAUGES;
        (turn..MAX_GAUGES)
            .chain(0..turn)
            .find(|i| self.flat.contains(*i))
    }

    /// Extends the range of gauge `i` in the window by `count`.
    pub(super) fn add_sample(&mut self, i: usize, count: i32) {
        if let Some(window) = self.window.get_mut(i) {
            let (low, high) = window.unwrap_or((count, count));
            *window = Some((low.min(count), high.max(count)));
        }
    }

    fn latch(&mut self, i: usize, fault: Fault) {
        if let Some(slot) = self.faults.get_mut(i) {
            *slot = fault;
        }
        self.restart_search();
    }

    fn restart_search(&mut self) {
        self.tested = GaugeMask::NONE;
        self.next = 0;
        self.verdict = None;
        self.verdicts = 0;
    }
}

impl Monitor {
    /// Closes a period; `verdicts` holds the fault of each gauge of `gauges`, from the samples of the period.
    pub(super) fn close_period(
        &self,
        state: &mut State,
        gauges: GaugeMask,
        verdicts: &[Fault; MAX_GAUGES],
    ) {
        for i in 0..MAX_GAUGES {
            if !gauges.contains(i) || state.faults[i].is_latched() {
                continue;
            }
            if verdicts[i] == Fault::None {
                state.bad_periods[i] = 0;
                state.good_periods[i] = state.good_periods[i].saturating_add(1);
                if state.good_periods[i] >= self.config.clear_periods {
                    state.faults[i] = Fault::None;
                }
            } else {
                state.good_periods[i] = 0;
                state.bad_periods[i] = state.bad_periods[i].saturating_add(1);
                if state.bad_periods[i] >= self.config.trip_periods {
                    state.faults[i] = verdicts[i];
                }
            }
        }
        state.window_periods = state.window_periods.saturating_add(1);
        if state.window_periods >= self.config.flat_window_periods {
            self.close_window(state, gauges);
        }
    }

    fn close_window(&self, state: &mut State, gauges: GaugeMask) {
        let range = |window: &Option<(i32, i32)>| {
            window.map(|(low, high)| i64::from(high) - i64::from(low))
        };
        let mut active = 0;
        let mut present = 0;
        let mut flat = GaugeMask::NONE;
        for i in 0..MAX_GAUGES {
            if !gauges.contains(i) || state.faults[i].is_latched() {
                continue;
            }
            if let Some(range) = range(&state.window[i]) {
                present += 1;
                if range >= i64::from(self.config.active_counts) {
                    active += 1;
                }
                if range == 0 {
                    flat = flat.with(i);
                }
            }
        }
        // At least half of the other gauges, and at least one, must have moved.
        if active == 0 || 2 * active < present - 1 {
            flat = GaugeMask::NONE;
        }
        state.flat = flat;
        for i in 0..MAX_GAUGES {
            // A gauge that has moved restarts the count of its contradicting fits.
            if !flat.contains(i) {
                state.flat_periods[i] = 0;
            }
        }
        if present <= 3 {
            // A suspect cannot be compared with so few other gauges, so it counts as dead.
            for i in flat.iter() {
                state.latch(i, Fault::Dead);
            }
            state.flat = GaugeMask::NONE;
        }
        state.window = [None; MAX_GAUGES];
        state.window_periods = 0;
    }

    /// Counts the fits in a row that contradict suspect `i`. `difference` is the suspect's strain less that of the fit
    /// of the others.
    pub(super) fn add_flat_difference(&self, state: &mut State, i: usize, difference: f32) {
        let periods = state.flat_periods.get(i).copied().unwrap_or(0);
        let periods = if difference.abs() > self.config.dead_strain {
            periods.saturating_add(1)
        } else {
            0
        };
        if let Some(slot) = state.flat_periods.get_mut(i) {
            *slot = periods;
        }
        if periods >= self.config.trip_periods {
            state.flat = state.flat.without(i);
            state.latch(i, Fault::Dead);
        }
    }

    /// Takes the residual of the fit through `used`. Returns the gauge to leave out of one more fit, whose residual
    /// goes to [`Self::add_residual_without`]; `None` without a search.
    // Not inlined: its variables would enlarge the stack of every tick.
    #[inline(never)]
    pub(super) fn add_residual(
        &self,
        state: &mut State,
        used: GaugeMask,
        chi_square: f32,
    ) -> Option<usize> {
        if chi_square <= self.config.max_chi_square {
            state.inconsistent_periods = 0;
            state.restart_search();
            return None;
        }
        state.inconsistent_periods = state.inconsistent_periods.saturating_add(1);
        if state.inconsistent_periods < self.config.trip_periods || used.count() < 5 {
            return None;
        }
        // The last gauge of the round may be no longer used: continue with the first.
        let next = usize::from(state.next);
        (next..MAX_GAUGES)
            .chain(0..next)
            .find(|&i| used.contains(i))
    }

    /// Takes the residual of the fit through `used` without gauge `i`.
    pub(super) fn add_residual_without(
        &self,
        state: &mut State,
        used: GaugeMask,
        i: usize,
        chi_square: f32,
    ) {
        if let Some(slot) = state.without.get_mut(i) {
            *slot = chi_square;
        }
        state.tested = state.tested.with(i);
        state.next = (i + 1) as u8;
        let remaining = (i + 1..MAX_GAUGES).any(|j| used.contains(j));
        if remaining {
            return;
        }
        // The round is complete. A gauge is faulty if only the fit without it has a small residual.
        let (mut best, mut second, mut faulty) = (f32::INFINITY, f32::INFINITY, 0);
        for j in used.and(state.tested).iter() {
            let residual = state.without[j];
            if residual < best {
                second = best;
                best = residual;
                faulty = j;
            } else if residual < second {
                second = residual;
            }
        }
        let half = 0.5 * self.config.max_chi_square;
        let clear = best < half && second > best + half && state.tested == used;
        state.tested = GaugeMask::NONE;
        state.next = 0;
        if !clear {
            state.verdict = None;
            state.verdicts = 0;
            return;
        }
        state.verdicts = if state.verdict == Some(faulty as u8) {
            state.verdicts.saturating_add(1)
        } else {
            1
        };
        state.verdict = Some(faulty as u8);
        if state.verdicts >= self.config.verdicts {
            state.latch(faulty, Fault::Inconsistent);
        }
    }
}

#[cfg(test)]
mod tests;
