//! Health of the gauges.
//!
//! Three kinds of evidence, from cheap to costly:
//! - **a period's own samples**: missing, saturated, or a strain the strip cannot have. Such a
//!   reading is not used at once; the fault is reported after it lasted, and goes when it is over.
//! - **flatness**: not one count of change over a window in which other gauges moved a lot. With
//!   enough gauges, the reading must also contradict the others. The gauge is dead until reset.
//! - **consistency**: with more gauges than the three an elastica needs, the residual of the fit
//!   shows a reading that does not belong (stuck with noise, drifted, come loose). Which one is
//!   found by leaving out one gauge after the other, one extra fit a period; the gauge stays out
//!   until reset.
//!
//! [`Config::build`] validates; the rest never fails.

use super::strip::{GaugeMask, MAX_GAUGES};
use crate::config::{Allowed, ConfigError, config, require};

/// Fault of a gauge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fault {
    /// Nothing.
    #[default]
    None,
    /// The converter gives no counts.
    Missing,
    /// The converter is at an end of its range.
    Saturated,
    /// The strain is larger than the strip can have, or not a number.
    OutOfRange,
    /// The reading does not move although others do.
    Dead,
    /// The reading contradicts the others.
    Inconsistent,
}

impl Fault {
    /// True if it lasts until reset.
    fn is_latched(self) -> bool {
        matches!(self, Self::Dead | Self::Inconsistent)
    }
}

config! {
    /// Limits beyond which a gauge is taken out.
    pub struct Config {
        /// Bad periods in a row until a fault is reported.
        pub trip_periods: u8 = 5, Range(1.0, 255.0);
        /// Good periods in a row until it is over.
        pub clear_periods: u8 = 50, Range(1.0, 255.0);
        /// Periods over which flatness is judged.
        pub flat_window_periods: u16 = 50, Range(2.0, 10_000.0);
        /// Counts by which half of the other gauges must have moved in that window.
        pub active_counts: i32 = 60;
        /// Difference between a flat reading and the fit of the other gauges from which the gauge is dead,
        /// strain.
        pub dead_strain: f32 = 2e-5, Range(1e-7, 1e-2);
        /// True if residuals are watched. Costs one fit a period when the method is not the elastica.
        pub watch_consistency: bool = true;
        /// Weighted sum of squared residuals from which the readings contradict each other. With the
        /// stated uncertainties a healthy strip exceeds 30 with probability 1e-5 or less.
        pub max_chi_square: f32 = 30.0, Range(5.0, 1e6);
        /// Searches in a row that must blame one gauge.
        pub verdicts: u8 = 2, Range(1.0, 255.0);
    }
}

impl Config {
    /// Checks every field.
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

/// All that changes in the monitor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    faults: [Fault; MAX_GAUGES],
    bad_periods: [u8; MAX_GAUGES],
    good_periods: [u8; MAX_GAUGES],
    /// Lowest and highest count in the window; lowest > highest before the first sample.
    window: [Option<(i32, i32)>; MAX_GAUGES],
    window_periods: u16,
    /// Flat in the last window.
    flat: GaugeMask,
    flat_periods: [u8; MAX_GAUGES],
    inconsistent_periods: u8,
    next: u8,
    /// Residual without each gauge, this round.
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

    /// Gauges that are out until reset.
    pub fn latched(&self) -> GaugeMask {
        let mut latched = GaugeMask::NONE;
        for i in 0..MAX_GAUGES {
            if self.faults[i].is_latched() {
                latched = latched.with(i);
            }
        }
        latched
    }

    /// The flat gauge that the others have to speak on in this period; they take turns.
    pub(super) fn suspect(&self) -> Option<usize> {
        let turn = usize::from(self.window_periods) % MAX_GAUGES;
        (turn..MAX_GAUGES)
            .chain(0..turn)
            .find(|i| self.flat.contains(*i))
    }

    /// A count went by.
    pub(super) fn see(&mut self, i: usize, count: i32) {
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
    /// Closes a period: `verdicts` holds the fault of each gauge of `gauges` by its samples.
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
        // Half of the others, at least one.
        if active == 0 || 2 * active < present - 1 {
            flat = GaugeMask::NONE;
        }
        state.flat = flat;
        if present <= 3 {
            // Too few gauges to speak on each other.
            for i in flat.iter() {
                state.latch(i, Fault::Dead);
            }
            state.flat = GaugeMask::NONE;
        }
        state.window = [None; MAX_GAUGES];
        state.window_periods = 0;
    }

    /// The others have spoken on flat gauge `i`: its reading is `difference` (strain) off.
    pub(super) fn judge_flat(&self, state: &mut State, i: usize, difference: f32) {
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

    /// Looks at the residual of the fit through `used`. Gives the gauge to be left out of one more
    /// fit, whose residual goes to [`Self::hear`]; `None` if there is nothing to search.
    pub(super) fn watch(
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
        (usize::from(state.next)..MAX_GAUGES).find(|&i| used.contains(i))
    }

    /// Residual of the fit through `used` without gauge `i`.
    pub(super) fn hear(&self, state: &mut State, used: GaugeMask, i: usize, chi_square: f32) {
        if let Some(slot) = state.without.get_mut(i) {
            *slot = chi_square;
        }
        state.tested = state.tested.with(i);
        state.next = (i + 1) as u8;
        let remaining = (i + 1..MAX_GAUGES).any(|j| used.contains(j));
        if remaining {
            return;
        }
        // A round is complete: guilty is the one without whom the rest agree, if the rest do not
        // agree without any other.
        let (mut best, mut second, mut guilty) = (f32::INFINITY, f32::INFINITY, 0);
        for j in used.and(state.tested).iter() {
            let residual = state.without[j];
            if residual < best {
                second = best;
                best = residual;
                guilty = j;
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
        state.verdicts = if state.verdict == Some(guilty as u8) {
            state.verdicts.saturating_add(1)
        } else {
            1
        };
        state.verdict = Some(guilty as u8);
        if state.verdicts >= self.config.verdicts {
            state.latch(guilty, Fault::Inconsistent);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIVE: GaugeMask = GaugeMask(0b11111);

    fn monitor() -> Monitor {
        Config::default().build().unwrap()
    }

    fn only(i: usize, fault: Fault) -> [Fault; MAX_GAUGES] {
        core::array::from_fn(|j| if i == j { fault } else { Fault::None })
    }

    #[test]
    fn faults_of_a_period_trip_and_clear_after_their_time() {
        let (monitor, mut state) = (monitor(), State::default());
        for _ in 0..4 {
            monitor.close_period(&mut state, FIVE, &only(2, Fault::Saturated));
        }
        assert_eq!(state.faults()[2], Fault::None);
        monitor.close_period(&mut state, FIVE, &only(2, Fault::Saturated));
        assert_eq!(state.faults(), only(2, Fault::Saturated));
        for _ in 0..49 {
            monitor.close_period(&mut state, FIVE, &only(0, Fault::None));
        }
        assert_eq!(state.faults()[2], Fault::Saturated);
        monitor.close_period(&mut state, FIVE, &only(0, Fault::None));
        assert_eq!(state.faults()[2], Fault::None);
    }

    #[test]
    fn flat_is_suspect_only_while_others_move() {
        let (monitor, mut state) = (monitor(), State::default());
        for period in 0..50 {
            for i in 0..5 {
                state.see(i, if i == 1 { 2048 } else { 2048 + period % 3 });
            }
            monitor.close_period(&mut state, FIVE, &[Fault::None; MAX_GAUGES]);
        }
        assert_eq!(state.suspect(), None);
        for period in 0..50 {
            for i in 0..5 {
                state.see(i, if i == 1 { 2048 } else { 2048 + 3 * period });
            }
            monitor.close_period(&mut state, FIVE, &[Fault::None; MAX_GAUGES]);
        }
        assert_eq!(state.suspect(), Some(1));
        for _ in 0..5 {
            monitor.judge_flat(&mut state, 1, 1e-4);
        }
        assert_eq!(state.faults(), only(1, Fault::Dead));
        assert_eq!(state.latched(), GaugeMask::NONE.with(1));
    }

    #[test]
    fn the_gauge_without_which_the_rest_agree_is_guilty() {
        let (monitor, mut state) = (monitor(), State::default());
        let mut fits = 0;
        for _ in 0..40 {
            if state.latched() != GaugeMask::NONE {
                break;
            }
            if let Some(i) = monitor.watch(&mut state, FIVE, 900.0) {
                fits += 1;
                monitor.hear(&mut state, FIVE, i, if i == 3 { 1.5 } else { 200.0 });
            }
        }
        assert_eq!(state.faults(), only(3, Fault::Inconsistent));
        assert_eq!(fits, 10);
    }

    #[test]
    fn nobody_is_guilty_if_it_could_be_two() {
        let (monitor, mut state) = (monitor(), State::default());
        for _ in 0..200 {
            if let Some(i) = monitor.watch(&mut state, FIVE, 900.0) {
                monitor.hear(&mut state, FIVE, i, if i >= 3 { 1.5 } else { 200.0 });
            }
        }
        assert_eq!(state.latched(), GaugeMask::NONE);
    }

    #[test]
    fn bad_configuration_is_named() {
        crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
            ("dead_strain", |c| c.dead_strain = f32::NAN),
            ("trip_periods", |c| c.trip_periods = 0),
        ]);
    }
}
