//! Result of trials: rows, their table and their CSV file.

use super::Trial;
use super::Variant;
use core_algos::fusion::robot::Mode;
use host_sim::base::statistics;
use host_sim::base::statistics::Summary;
use host_sim::run::end::{EndKind, Ends, RunEnd};
use host_sim::run::final_error::FinalError;
use host_sim::run::regulate::Outcome;
use output::files::Csv;
use output::table::{Table, plus_minus};
use output::terminal::wrapped;
use recording::csv;
use serde::Serialize;

/// 99 % quantile of χ² with three degrees of freedom.
pub const CHI_SQUARE_99: f64 = 11.345;

/// Row of the result.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PostureRow {
    /// True if the relative position sensor was fitted.
    pub rps: bool,
    /// True if inertial sensors were fitted.
    pub imu: bool,
    /// Name of the fusion.
    pub fusion: &'static str,
    /// Distance of O from the goal, m.
    pub e_m: Summary,
    /// Distance of O from the goal, 95th percentile of the trials, m.
    pub e_95_m: f64,
    /// Heading error of O, rad.
    pub heading_rad: Summary,
    /// θ of the paper: direction to the goal less heading of the goal, rad.
    pub theta_rad: Summary,
    /// α of the paper: direction to the goal less heading of the robot, rad.
    pub alpha_rad: Summary,
    /// Share of trials within the tolerance of the goal.
    pub within_tolerance: f64,
    /// Share of trials that ended as commanded.
    pub done: f64,
    /// Mean NEES of the estimate of O; 3 if the covariance is right.
    pub nees: f64,
    /// True if the 95 % error of the estimate is an upper bound.
    pub error_95_is_bound: bool,
    /// Share of trials with the error of the estimate of O in the estimated 99 % ellipsoid.
    pub inside_share: f64,
    /// Numbers of trials by end.
    pub ends: Ends,
    /// End of each trial.
    pub runs: Vec<RunEnd>,
    /// Trials reported as reached that were not within the tolerance of the goal.
    pub false_successes: u32,
    /// 95 % error of the estimated position, m.
    pub error_95_m: Summary,
    /// 95 % error of the estimated heading, rad.
    pub error_95_rad: Summary,
    /// Error of the estimated position of the front axle in the frame of the rear axle, m.
    pub drift_m: Summary,
    /// Root mean square of the frame's force in a trial, N.
    pub force_rms_n: Summary,
    /// Time of a trial, s.
    pub duration_s: Summary,
}

/// Result of the command.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PostureReport {
    /// Trials in each row.
    pub trials: u32,
    /// Results by configuration.
    pub rows: Vec<PostureRow>,
}

/// Summarises the trials of one configuration.
pub fn summarize(variant: &Variant, trials: &[Trial], goal: [f64; 3]) -> PostureRow {
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
    let runs: Vec<RunEnd> = outcomes.iter().map(|outcome| outcome.end.clone()).collect();
    let count = |is: fn(&Outcome) -> bool| outcomes.iter().filter(|outcome| is(outcome)).count();
    let share = |is: fn(&Outcome) -> bool| count(is) as f64 / outcomes.len().max(1) as f64;
    let error_95 = |k: usize| {
        let known = runs.iter().filter_map(|end| end.error_95);
        Summary::of(&known.map(|error| error[k]).collect::<Vec<_>>())
    };
    PostureRow {
        rps: variant.rps,
        imu: variant.imu,
        fusion: variant.fusion(),
        e_m: Summary::of(&e_m),
        e_95_m: statistics::percentile(&e_m, 0.95),
        heading_rad: angle(|error| error.heading_rad),
        theta_rad: angle(|error| error.theta_rad),
        alpha_rad: angle(|error| error.alpha_rad),
        within_tolerance: share(|outcome| outcome.within),
        done: share(|outcome| outcome.end.is_success()),
        nees: Summary::of(&outcome(|o| o.nees)).mean,
        inside_share: statistics::share(&outcome(|o| o.nees), |nees| nees <= CHI_SQUARE_99),
        error_95_is_bound: variant.is_bound(),
        ends: Ends::of(&runs),
        false_successes: count(|o| o.end.kind == EndKind::Reached && !o.within) as u32,
        error_95_m: error_95(0),
        error_95_rad: error_95(1),
        runs,
        drift_m: Summary::of(&outcome(|o| {
            libm::hypot(o.relative_error[0], o.relative_error[1])
        })),
        force_rms_n: Summary::of(&outcome(|o| o.force_rms_n)),
        duration_s: Summary::of(&outcome(|o| o.end.duration_s)),
    }
}

/// Line with the goal errors of the joint filter (else of the last row) and of the first row; empty for a single row.
pub fn verdict(rows: &[PostureRow], variants: &[Variant]) -> String {
    let mut pairs = rows.iter().zip(variants);
    let named = |(row, variant): (&PostureRow, &Variant)| {
        let fusion = match variant.mode {
            Mode::Odometry => String::new(),
            _ => format!(" ({})", variant.fusion()),
        };
        format!("{} cm with {}{fusion}", row.e_text(), variant.sensors())
    };
    let first = pairs.next();
    let default = pairs
        .clone()
        .rfind(|(_, variant)| variant.mode == Mode::Joint);
    match (default.or_else(|| pairs.next_back()), first) {
        (Some(row), Some(first)) => format!("Goal error: {}, {}.\n\n", named(row), named(first)),
        _ => String::new(),
    }
}

/// Meaning of the columns and of the ends that occur. `tolerance` holds position, m, and heading, rad.
pub fn meanings(rows: &[PostureRow], [position, heading]: [f64; 2]) -> String {
    let mut lines = vec![
        "goal: true distance from the goal at the end, mean ± standard deviation".to_owned(),
        "heading: true heading less that of the goal, mean of the magnitude".to_owned(),
        "claim: 95 % error of the position by the robot's own estimate, mean".to_owned(),
    ];
    if rows.iter().any(|row| row.error_95_is_bound) {
        lines.push("≤: upper bound; tyre slip is unobserved without gauges or gyros".to_owned());
    }
    for kind in EndKind::ALL {
        let mut ends = rows.iter().flat_map(|row| &row.runs);
        if ends.any(|end| end.kind == kind) {
            lines.push(format!("{}: {}", kind.name(), kind.meaning()));
        }
    }
    let [cm, degrees] = [100.0 * position, heading.to_degrees()];
    lines.push(format!("tolerance: {cm:.0} cm and {degrees:.0}°"));
    lines.iter().map(|line| wrapped(line)).collect()
}

/// The rows as a table for the screen.
pub fn table(rows: &[PostureRow], variants: &[Variant]) -> String {
    let mut table = Table::new([
        "sensors",
        "fusion",
        "goal (cm)",
        "heading (°)",
        "claim (cm)",
        "ends",
    ]);
    for (row, variant) in rows.iter().zip(variants) {
        table.row([
            variant.sensors().to_owned(),
            variant.fusion().to_owned(),
            row.e_text(),
            format!("{:.2}", row.heading_rad.mean_abs.to_degrees()),
            row.error_95_text(),
            row.ends.text(),
        ]);
    }
    table.to_string()
}

impl PostureRow {
    /// Goal error, mean and standard deviation, cm.
    fn e_text(&self) -> String {
        plus_minus(100.0 * self.e_m.mean, 100.0 * self.e_m.sd, 1)
    }

    /// Mean 95 % error of the position, cm.
    fn error_95_text(&self) -> String {
        let bound = if self.error_95_is_bound { "≤ " } else { "" };
        format!("{bound}{:.1}", 100.0 * self.error_95_m.mean)
    }
}

/// Table `trials.csv`: end and errors of each trial.
pub fn trials_csv<'a>(
    blocks: impl IntoIterator<Item = (&'a Variant, &'a Vec<Trial>)>,
    goal: [f64; 3],
) -> Csv {
    let trials = blocks.into_iter().flat_map(|(variant, block)| {
        let numbered = block.iter().enumerate();
        numbered.map(move |(trial, Trial { outcome, .. })| (variant, trial, outcome))
    });
    csv::CsvRow::table(
        trials.map(|(variant, trial, outcome)| csv::of_trial(variant, trial, outcome, goal)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::control::kinematic::PolarError;
    use core_algos::math::Posture;

    #[test]
    fn final_errors_agree_with_the_polar_error_of_the_controller() {
        // `PolarError`, in f32 on board, implements the definitions of `FinalError` a second time.
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
