//! Result of trials: rows, their table and their CSV file.

use super::Trial;
use super::variant::Variant;
use crate::base::output::Csv;
use crate::base::statistics::{self, Summary};
use crate::base::table::Table;
use crate::recording::csv;
use crate::run::final_error::FinalError;
use crate::run::regulate::Outcome;
use serde::Serialize;
use std::collections::BTreeMap;

/// Of three degrees of freedom, 99 %.
pub const CHI_SQUARE_99: f64 = 11.345;

/// One row of the result.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// True if the relative position sensor was fitted.
    pub rps: bool,
    /// True if inertial sensors were fitted.
    pub imu: bool,
    /// Fusion.
    pub fusion: &'static str,
    /// Distance of O from the goal.
    pub e_m: Summary,
    /// Distance of O from the goal, 95th percentile of the trials, m.
    pub e_95_m: f64,
    /// Heading error of O.
    pub heading_rad: Summary,
    /// θ of the paper.
    pub theta_rad: Summary,
    /// α of the paper.
    pub alpha_rad: Summary,
    /// Share of trials within 3 cm and 3°.
    pub within_3cm_3deg: f64,
    /// Share of trials the robot itself reported as done.
    pub done: f64,
    /// Mean of the squared error of the estimate of O over its claimed covariance; 3 if the claim is right.
    pub nees: f64,
    /// Share of trials whose error of the estimate of O lies in the claimed 99 % ellipsoid.
    pub inside_share: f64,
    /// Ends of trials with their counts: `reached`, `reached, uncertain`, the code of the first stop, or
    /// `time limit`.
    pub ends: BTreeMap<String, u32>,
    /// End of each trial.
    pub runs: Vec<String>,
    /// Trials reported as reached that were not within the tolerance of the goal.
    pub false_successes: u32,
    /// Half axis of the ellipse in which the robot claims to be with 95 %.
    pub claimed_m: Summary,
    /// Half the interval in which it claims its heading to be with 95 %.
    pub claimed_rad: Summary,
    /// Error of the estimated position of the front axle as seen from the rear axle.
    pub drift_m: Summary,
    /// Root mean square of the frame's force in a trial.
    pub force_rms_n: Summary,
    /// Time of a trial.
    pub duration_s: Summary,
}

/// The result of the command.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Trials in each row.
    pub trials: u32,
    /// The rows.
    pub rows: Vec<Row>,
    /// Rows of the paper's algorithms in the world `paper`, if they were run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub paper: Vec<Row>,
}

/// Summarises the trials of one configuration.
pub fn summarize(variant: &Variant, trials: &[Trial], goal: [f64; 3]) -> Row {
    let outcomes: Vec<&Outcome> = trials.iter().map(|trial| &trial.outcome).collect();
    let errors: Vec<FinalError> = outcomes
        .iter()
        .map(|outcome| FinalError::of(outcome.midpoint, goal))
        .collect();
    let angle = |pick: fn(&FinalError) -> f64| -> Summary {
        Summary::of_angles(&errors.iter().map(pick).collect::<Vec<_>>())
    };
    let e_m: Vec<f64> = errors.iter().map(|error| error.e_m).collect();
    let outcome =
        |pick: fn(&Outcome) -> f64| -> Vec<f64> { outcomes.iter().copied().map(pick).collect() };
    let near = errors.iter().filter(|error| error.is_near()).count();
    let runs: Vec<String> = outcomes.iter().copied().map(end_of).collect();
    let mut ends = BTreeMap::new();
    for end in &runs {
        *ends.entry(end.clone()).or_default() += 1;
    }
    let falsely = |o: &&&Outcome| o.done && o.uncertain.is_none() && !o.within;
    let false_successes = outcomes.iter().filter(falsely).count();
    Row {
        rps: variant.rps,
        imu: variant.imu,
        fusion: variant.fusion(),
        e_m: Summary::of(&e_m),
        e_95_m: statistics::percentile(&e_m, 0.95),
        heading_rad: angle(|error| error.heading_rad),
        theta_rad: angle(|error| error.theta_rad),
        alpha_rad: angle(|error| error.alpha_rad),
        within_3cm_3deg: near as f64 / errors.len().max(1) as f64,
        done: statistics::share(&outcome(|o| f64::from(u8::from(o.done))), |v| v > 0.5),
        nees: Summary::of(&outcome(|o| o.nees)).mean,
        inside_share: statistics::share(&outcome(|o| o.nees), |nees| nees <= CHI_SQUARE_99),
        ends,
        runs,
        false_successes: false_successes as u32,
        claimed_m: Summary::of(&outcome(|o| o.claimed[0])),
        claimed_rad: Summary::of(&outcome(|o| o.claimed[1])),
        drift_m: Summary::of(&outcome(|o| o.relative_error[0].hypot(o.relative_error[1]))),
        force_rms_n: Summary::of(&outcome(|o| o.force_rms_n)),
        duration_s: Summary::of(&outcome(|o| o.duration_s)),
    }
}

/// End of a trial, in a word.
fn end_of(outcome: &Outcome) -> String {
    match (&outcome.fault, outcome.done) {
        (Some(status), _) => status.reason.map_or_else(
            || status.state.name().to_owned(),
            |code| code.entry().name.to_owned(),
        ),
        (None, true) => outcome
            .uncertain
            .map_or("reached", |notice| notice.entry().name)
            .to_owned(),
        (None, false) if outcome.gave_up => "gave up".to_owned(),
        (None, false) => "time limit".to_owned(),
    }
}

/// The rows as a table for the screen.
pub fn table(rows: &[Row], variants: &[Variant]) -> String {
    let mut table = Table::new([
        "sensors, fusion",
        "e (cm)",
        "e 95 % (cm)",
        "heading (°)",
        "claim (cm)",
        "ends",
    ]);
    for (row, variant) in rows.iter().zip(variants) {
        let ends: Vec<String> = row
            .ends
            .iter()
            .map(|(end, count)| format!("{count} {}", end.trim_start_matches("reached, ")))
            .collect();
        table.row([
            variant.label(),
            format!("{:.1}", 100.0 * row.e_m.mean),
            format!("{:.1}", 100.0 * row.e_95_m),
            format!("{:.2}", row.heading_rad.mean_abs.to_degrees()),
            format!("{:.1}", 100.0 * row.claimed_m.mean),
            ends.join(", "),
        ]);
    }
    table.to_string()
}

/// End of each trial.
pub fn trials_csv(variants: &[Variant], blocks: &[Vec<Trial>], goal: [f64; 3]) -> Csv {
    let trials = variants.iter().zip(blocks).flat_map(|(variant, block)| {
        let numbered = block.iter().enumerate();
        numbered.map(move |(trial, Trial { outcome, .. })| (variant, trial, outcome))
    });
    csv::Row::table(trials.map(|(variant, trial, outcome)| {
        let error = FinalError::of(outcome.midpoint, goal);
        let [dx, dy, _] = outcome.relative_error;
        let mut row = csv::Row::default();
        row.put("rps imu", &[variant.rps, variant.imu]);
        row.put("fusion", &[variant.fusion()]);
        row.put("trial", &[trial]);
        row.put("x_m y_m phi_rad", &outcome.midpoint);
        row.put("e_m heading_rad", &[error.e_m, error.heading_rad]);
        row.put("theta_rad alpha_rad", &[error.theta_rad, error.alpha_rad]);
        row.put(
            "force_rms_n duration_s",
            &[outcome.force_rms_n, outcome.duration_s],
        );
        row.put("done", &[outcome.done]);
        row.put("end", &[end_of(outcome).as_str()]);
        let notices = outcome.notices.iter().map(|notice| notice.entry().name);
        row.put(
            "notices",
            &[notices.collect::<Vec<_>>().join("; ").as_str()],
        );
        row.put("beam_share", &[outcome.beam_share]);
        row.put(
            "nees drift_m claimed_m",
            &[outcome.nees, dx.hypot(dy), outcome.claimed[0]],
        );
        row
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::control::kinematic::PolarError;
    use core_algos::math::Posture;

    #[test]
    fn errors_agree_with_the_controllers_own() {
        // The on-board polar error in f32 is another implementation of the same definitions.
        for (posture, goal) in [
            ([-1.3, -1.3, 0.2], [0.0, 0.0, 0.0]),
            ([0.5, 0.1, 3.0], [1.0, -1.0, -2.5]),
        ] {
            let error = FinalError::of(posture, goal);
            let f = |p: [f64; 3]| Posture::from(p.map(|v| v as f32));
            let board = PolarError::between(f(posture), f(goal));
            assert!((error.e_m - f64::from(board.distance_m)).abs() < 1e-5);
            assert!((error.theta_rad - f64::from(board.theta)).abs() < 1e-5);
            assert!((error.alpha_rad - f64::from(board.alpha)).abs() < 1e-5);
            assert!((error.heading_rad - f64::from(board.heading())).abs() < 1e-5);
        }
    }
}
