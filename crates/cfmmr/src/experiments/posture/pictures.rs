//! The trials of one configuration as pictures.

use crate::experiments::posture::{PostureRow, Trial, Variant};
use host_sim::run::end::Verdict;
use host_sim::run::final_error::FinalError;
use host_sim::run::robot::Record;
use host_sim::scenario::Scenario;
use output::table::plus_minus;
use view::figures::{ErrorsColumn, PathsPanel, Snapshot};
use view::{animation, page};

/// Index of the trial with the median final position error e: of an even number of trials, the lower
/// of the middle two. An error that is not a number counts as the largest.
pub fn median_trial(trials: &[Trial], goal: [f64; 3]) -> usize {
    let e_m = |trial: &Trial| FinalError::of(trial.outcome.midpoint, goal).e_m;
    let mut order: Vec<usize> = (0..trials.len()).collect();
    order.sort_by(|&a, &b| e_m(&trials[a]).total_cmp(&e_m(&trials[b])));
    order[trials.len().saturating_sub(1) / 2]
}

/// Trials of one configuration, with the index of the trial shown in full.
pub struct Picture<'a> {
    variant: &'a Variant,
    scenario: &'a Scenario,
    trials: &'a [Trial],
    shown: usize,
}

impl<'a> Picture<'a> {
    /// Shows the median trial.
    ///
    /// # Panics
    ///
    /// If there is no trial.
    pub fn of(variant: &'a Variant, scenario: &'a Scenario, trials: &'a [Trial]) -> Self {
        let shown = median_trial(trials, scenario.mission.goal);
        Self {
            variant,
            scenario,
            trials,
            shown,
        }
    }

    fn goal(&self) -> [f64; 3] {
        self.scenario.mission.goal
    }

    /// Name of the configuration, and number of the shown trial if there are several trials.
    fn title(&self) -> String {
        let label = self.variant.label();
        match self.trials.len() {
            1 => label,
            count => format!("{label}: trial {}, median e of {count}", self.shown),
        }
    }

    /// Midpoint paths and final positions of all trials, with the shown trial in full.
    pub fn paths(&self, half_track_m: f64) -> PathsPanel {
        let trial = &self.trials[self.shown];
        let others = self.trials.iter().enumerate();
        let others = others.filter(|(n, trial)| *n != self.shown && !trial.path.is_empty());
        let end = |Trial { outcome, .. }: &Trial| {
            let verdict = Verdict::of(outcome.end.kind, outcome.within);
            (verdict, outcome.midpoint)
        };
        let mission = &self.scenario.mission;
        PathsPanel {
            title: self.title(),
            others: others.map(|(_, trial)| trial.path.clone()).collect(),
            path: trial.path.clone(),
            wheels: wheel_paths(&trial.records, half_track_m),
            snapshots: snapshots(&trial.records),
            goal: Some(self.goal()),
            tolerance: [mission.tolerance_m, mission.tolerance_rad],
            ends: self.trials.iter().map(end).collect(),
            measured: None,
        }
    }

    /// Goal errors of the shown trial over time.
    pub fn errors(&self) -> ErrorsColumn {
        let records = &self.trials[self.shown].records;
        ErrorsColumn {
            title: self.title(),
            estimate: trace(records, self.goal(), estimate),
            truth: trace(records, self.goal(), |record| record.midpoint),
            measured: None,
        }
    }

    /// The shown trial for the animated picture.
    pub fn animation(&self) -> animation::Run<'a> {
        let Trial {
            outcome, records, ..
        } = &self.trials[self.shown];
        let end = FinalError::of(outcome.midpoint, self.goal());
        animation::Run {
            title: self.variant.label(),
            result: format!(
                "ends {:.1} cm from the goal: {}",
                100.0 * end.e_m,
                outcome.end.kind.name()
            ),
            records,
            target: animation::Target::Goal(self.goal(), self.scenario.mission.tolerance_m),
        }
    }

    /// The shown trial for the report page.
    pub fn page(&self, row: &PostureRow) -> page::Run<'a> {
        let (goal, trials) = (self.goal(), self.trials);
        let error = |posture: [f64; 3]| {
            let error = FinalError::of(posture, goal);
            [error.e_m, error.heading_rad]
        };
        let Trial {
            outcome, records, ..
        } = &trials[self.shown];
        let last = FinalError::of(outcome.midpoint, goal);
        let [e_mm, heading] = [1e3 * last.e_m, last.heading_rad.to_degrees()];
        let mut summary = vec![
            ("Goal error", format!("{e_mm:.2} mm, {heading:.2}°")),
            (
                "Path length",
                format!("{:.2} m, {} cusps", outcome.path_m, outcome.cusps),
            ),
            (
                "Force of the frame, rms",
                format!("{:.2} N", outcome.force_rms_n),
            ),
        ];
        let all = format!("Goal error of all {} trials", trials.len());
        if trials.len() > 1 {
            let [mean, sd] = [row.heading_rad.mean, row.heading_rad.sd].map(f64::to_degrees);
            let e_mm = plus_minus(1e3 * row.e_m.mean, 1e3 * row.e_m.sd, 2);
            summary.push((&all, format!("{e_mm} mm, {}°", plus_minus(mean, sd, 2))));
            summary.push(("Ends of all trials", row.ends.text()));
        }
        let summary = summary.into_iter();
        page::Run {
            title: format!("Posture regulation: {}", self.title()),
            name: self.title(),
            goal: Some(goal),
            reference: Vec::new(),
            errors: records
                .iter()
                .map(|record| [error(record.midpoint), error(estimate(record))])
                .collect(),
            records: records.iter().collect(),
            distance: "Distance to the goal",
            end: &outcome.end,
            summary: summary
                .map(|(name, text)| (name.to_owned(), text))
                .collect(),
            scenario: self.scenario,
        }
    }
}

fn estimate(record: &Record) -> [f64; 3] {
    let p = record.lead.fused.robot.posture;
    [p.x, p.y, p.phi].map(f64::from)
}

/// Paths of the wheels, at 20 Hz.
pub fn wheel_paths(records: &[Record], half_track: f64) -> Vec<Vec<[f64; 2]>> {
    let mut paths = Vec::new();
    for axle in 0..records.first().map_or(0, |record| record.axles.len()) {
        for side in [half_track, -half_track] {
            paths.push(
                records
                    .iter()
                    .step_by(5)
                    .map(|record| {
                        let [x, y, phi] = record.axles[axle].posture;
                        [x - side * libm::sin(phi), y + side * libm::cos(phi)]
                    })
                    .collect(),
            );
        }
    }
    paths
}

/// The robot at five evenly spaced instants, from the start to the end.
pub fn snapshots(records: &[Record]) -> Vec<Snapshot> {
    let Some(last) = records.len().checked_sub(1) else {
        return Vec::new();
    };
    let parts = (0..=4).map(|part| Snapshot::of(&records[last * part / 4]));
    parts.collect()
}

/// Goal errors of the posture that `posture` selects, over time at 50 Hz.
fn trace(
    records: &[Record],
    goal: [f64; 3],
    posture: impl Fn(&Record) -> [f64; 3],
) -> Vec<(f64, FinalError)> {
    let some = records.iter().step_by(2);
    some.map(|record| (record.time_s, FinalError::of(posture(record), goal)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_trial_is_the_lower_middle_one_by_e() {
        let trial = |x: f64| {
            let mut trial = Trial::default();
            trial.outcome.midpoint = [x, 0.0, 0.0];
            trial
        };
        let trials = [3.0, -1.0, f64::NAN, 2.0].map(trial);
        assert_eq!(median_trial(&trials, [0.0; 3]), 3);
        assert_eq!(median_trial(&trials[..3], [0.0; 3]), 0);
        assert_eq!(median_trial(&trials[2..3], [0.0; 3]), 0);
    }
}
