//! Consistency of the fused estimates: errors against covariances.
//!
//! The measure is the normalised estimation error squared, NEES = eᵀ P⁻¹ e, of the first axle, the last axle and O on the full plant.
//! Each NEES has three degrees of freedom. If errors are normal with covariance P, the mean NEES of N runs is in the
//! band of χ² with 3 N degrees of freedom with probability 0.95. Above the band the estimator is overconfident, below
//! the band it is cautious.

use crate::experiments::posture::Variant;
use crate::experiments::{Context, Seeds, Workers};
use core_algos::fusion::Estimate;
use core_algos::fusion::ekf::Verdict;
use host_sim::base::error::Error;
use host_sim::base::statistics;
use host_sim::base::statistics::{
    NIS_EXPECTED, chi_square_quantile, error, mean_square_band, nees,
};
use host_sim::run::end::{Ends, RunEnd};
use host_sim::run::regulate::regulate;
use host_sim::run::robot::Record;
use host_sim::scenario::Scenario;
use output::files::Csv;
use output::table::Table;
use recording::csv;
use serde::Serialize;
use view::plot::{Figure, Height, Panel};
use view::style::{BAND, series};

/// Degrees of freedom of a posture's error: x, y and heading.
pub const DEGREES: usize = 3;
/// Probability that the mean NEES of a consistent estimator is in the band, and a single NEES below the quantile.
pub const PROBABILITY: f64 = 0.95;
/// Evaluated bodies, in the order of all arrays in this module.
pub const BODIES: [&str; 3] = ["front", "rear", "O"];
/// Epochs between two evaluated instants.
const INTERVAL: usize = 50;
/// Time between two evaluated instants, s.
const INTERVAL_S: f64 = 0.5;

/// Estimate of a posture compared with the true posture at the instant of the estimate.
#[derive(Clone, Copy, Debug, Default)]
struct EstimateCheck {
    nees: f64,
    error: [f64; 3],
    variance: [f64; 3],
}

impl EstimateCheck {
    fn of(estimate: &Estimate, truth: [f64; 3]) -> Self {
        Self {
            nees: nees(estimate, truth),
            error: error(estimate, truth),
            variance: [0, 1, 2].map(|k| f64::from(estimate.covariance[k][k])),
        }
    }
}

/// Estimate checks of one run, every [`INTERVAL`] epochs and at the end.
#[derive(Clone, Debug, Default)]
struct RunChecks {
    path: Vec<[EstimateCheck; 3]>,
    end: [EstimateCheck; 3],
    beam_nis: Vec<f64>,
    ended: RunEnd,
}

/// Collects the checks of a run. An estimate is of the beginning of its epoch, so the record of the preceding epoch has
/// the true posture.
struct CheckObserver {
    run: RunChecks,
    before: Option<Record>,
    start_s: f64,
    epochs: usize,
}

impl CheckObserver {
    fn new(start_s: f64) -> Self {
        Self {
            run: RunChecks::default(),
            before: None,
            start_s,
            epochs: 0,
        }
    }

    fn observe(&mut self, record: &Record) {
        let before = self.before.replace(record.clone());
        let Some(truth) = before.filter(|before| before.time_s >= self.start_s - 1e-6) else {
            return;
        };
        let fused = &record.lead.fused;
        let [first, .., last] = truth.axles.as_slice() else {
            return;
        };
        let checks = [
            EstimateCheck::of(&fused.front, first.posture),
            EstimateCheck::of(&fused.rear, last.posture),
            EstimateCheck::of(&fused.robot, truth.midpoint),
        ];
        if self.epochs.is_multiple_of(INTERVAL) {
            self.run.path.push(checks);
        }
        if fused.beam.verdict == Verdict::Used {
            self.run.beam_nis.push(f64::from(fused.beam.nis));
        }
        self.run.end = checks;
        self.epochs += 1;
    }
}

/// Position of the mean NEES relative to the χ² band.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum BandPosition {
    /// Below the band: errors smaller than claimed.
    Below,
    /// In the band.
    Inside,
    /// Above the band: errors larger than claimed.
    Above,
}

impl BandPosition {
    /// Position of the mean NEES `mean` relative to the bounds of the band.
    pub fn of(mean: f64, [low, high]: [f64; 2]) -> Self {
        if mean < low {
            Self::Below
        } else if mean <= high {
            Self::Inside
        } else {
            Self::Above
        }
    }
}

/// Verdict on a configuration, from the NEES of both axles at the end of the runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Statement {
    /// Both axles inside the band.
    Consistent,
    /// No axle above the band, at least one below.
    Cautious,
    /// At least one axle above the band.
    Overconfident,
}

impl Statement {
    /// Verdict from the band positions of front and rear axle.
    pub fn of(axles: [BandPosition; 2]) -> Self {
        if axles.contains(&BandPosition::Above) {
            Self::Overconfident
        } else if axles.contains(&BandPosition::Below) {
            Self::Cautious
        } else {
            Self::Consistent
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Consistent => "consistent (in band)",
            Self::Cautious => "cautious (below)",
            Self::Overconfident => "overconfident (above)",
        }
    }
}

/// Consistency of the front axle, the rear axle or O over all runs of a configuration, at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BodyConsistency {
    /// Mean NEES.
    pub nees: f64,
    /// Position of the mean NEES relative to the χ² band.
    pub band: BandPosition,
    /// Share of the runs with a NEES of at most the χ² quantile.
    pub within: f64,
    /// Root mean square error of the estimate: x, y (m), heading (rad).
    pub rms: [f64; 3],
    /// Root of the mean estimated variance: x, y (m), heading (rad).
    pub claimed: [f64; 3],
}

impl BodyConsistency {
    fn of(checks: &[EstimateCheck], band: [f64; 2], quantile: f64) -> Self {
        let all: Vec<f64> = checks.iter().map(|check| check.nees).collect();
        let mean = statistics::mean(&all);
        let root = |pick: &dyn Fn(&EstimateCheck) -> f64| {
            statistics::mean(&checks.iter().map(pick).collect::<Vec<_>>()).sqrt()
        };
        Self {
            nees: mean,
            band: BandPosition::of(mean, band),
            within: statistics::share(&all, |value| value <= quantile),
            rms: [0, 1, 2].map(|k| root(&|check| check.error[k] * check.error[k])),
            claimed: [0, 1, 2].map(|k| root(&|check| check.variance[k])),
        }
    }
}

/// Consistency of front axle, rear axle and O at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct InstantConsistency {
    /// Time since the beginning of the task, s.
    pub time_s: f64,
    /// Front axle.
    pub front: BodyConsistency,
    /// Rear axle.
    pub rear: BodyConsistency,
    /// Midpoint.
    pub midpoint: BodyConsistency,
}

impl InstantConsistency {
    fn of(time_s: f64, checks: &[[EstimateCheck; 3]], band: [f64; 2], quantile: f64) -> Self {
        let body = |which: usize| {
            let one: Vec<EstimateCheck> = checks.iter().map(|all| all[which]).collect();
            BodyConsistency::of(&one, band, quantile)
        };
        Self {
            time_s,
            front: body(0),
            rear: body(1),
            midpoint: body(2),
        }
    }

    /// Consistency of front axle, rear axle and O, in the order of [`BODIES`].
    pub fn bodies(&self) -> [&BodyConsistency; 3] {
        [&self.front, &self.rear, &self.midpoint]
    }
}

/// Consistency of one configuration, from all its runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ConsistencyRow {
    /// True if the relative position sensor was fitted.
    pub rps: bool,
    /// True if inertial sensors were fitted.
    pub imu: bool,
    /// Name of the fusion.
    pub fusion: &'static str,
    /// Verdict on the consistency.
    pub statement: Statement,
    /// Numbers of runs by end. Every run is evaluated, whatever its end.
    pub ends: Ends,
    /// Consistency at the end of the runs; `time_s` is the mean end time.
    pub end: InstantConsistency,
    /// Mean NEES of front, rear and O over runs and instants of the path.
    pub path_mean: [f64; 3],
    /// Share of the instants at which the mean NEES of both axles is above the band.
    pub path_above: f64,
    /// Mean NIS of the beam's measurements; `None` if the fusion does not use the beam.
    pub beam_nis: Option<f64>,
    /// Consistency at every half second of the path, until the shortest run ends.
    pub path: Vec<InstantConsistency>,
}

/// Consistency of all configurations, the JSON output of the command.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ConsistencyReport {
    /// Runs of each configuration.
    pub runs: u32,
    /// Degrees of freedom of a posture.
    pub degrees: usize,
    /// Probability of the NEES band and of the quantile.
    pub probability: f64,
    /// Band of the mean NEES over the runs.
    pub band: [f64; 2],
    /// χ² quantile: bound of the NEES of one run.
    pub quantile: f64,
    /// One row per configuration.
    pub rows: Vec<ConsistencyRow>,
}

/// Runs each configuration of a scenario and evaluates the NEES.
pub fn measure(
    workers: &Workers,
    scenario: &Scenario,
    seeds: Seeds,
    variants: &[Variant],
) -> Result<ConsistencyReport, Error> {
    let scenarios: Vec<Scenario> = variants
        .iter()
        .map(|variant| variant.apply(scenario))
        .collect();
    let rows = (variants.len(), seeds.trials);
    let blocks = workers.run_rows("runs", rows, |row, trial| {
        let scenario = &scenarios[row];
        let mut observer = CheckObserver::new(scenario.mission.settle_s);
        let observe_record = |record: &Record| observer.observe(record);
        let outcome = regulate(scenario, seeds.seed, trial as u64, observe_record)?;
        observer.run.ended = outcome.end;
        let duration_s = observer.epochs as f64 * 0.01;
        Ok((observer.run, duration_s))
    })?;
    if blocks.iter().any(Vec::is_empty) {
        let text = "interrupted before each row had a run: nothing is written";
        return Err(Error::Interrupted(text.to_owned()));
    }
    let band = mean_square_band(DEGREES, seeds.trials, PROBABILITY);
    let quantile = chi_square_quantile(PROBABILITY, DEGREES as f64);
    let rows = variants
        .iter()
        .zip(&blocks)
        .map(|(variant, block)| summarize(variant, block, band, quantile))
        .collect();
    Ok(ConsistencyReport {
        runs: seeds.trials as u32,
        degrees: DEGREES,
        probability: PROBABILITY,
        band,
        quantile,
        rows,
    })
}

fn summarize(
    variant: &Variant,
    block: &[(RunChecks, f64)],
    band: [f64; 2],
    quantile: f64,
) -> ConsistencyRow {
    let length = block.iter().map(|(run, _)| run.path.len()).min();
    let path: Vec<InstantConsistency> = (0..length.unwrap_or(0))
        .map(|i| {
            let checks: Vec<_> = block.iter().map(|(run, _)| run.path[i]).collect();
            InstantConsistency::of(i as f64 * INTERVAL_S, &checks, band, quantile)
        })
        .collect();
    let ends: Vec<_> = block.iter().map(|(run, _)| run.end).collect();
    let durations: Vec<f64> = block.iter().map(|(_, duration)| *duration).collect();
    let over = |which: usize| -> Vec<f64> {
        path.iter()
            .map(|instant| instant.bodies()[which].nees)
            .collect()
    };
    let above: Vec<f64> = path
        .iter()
        .map(|i| {
            f64::from(u8::from(
                i.front.band == BandPosition::Above && i.rear.band == BandPosition::Above,
            ))
        })
        .collect();
    let nis: Vec<f64> = block
        .iter()
        .flat_map(|(run, _)| run.beam_nis.iter().copied())
        .collect();
    let end = InstantConsistency::of(statistics::mean(&durations), &ends, band, quantile);
    ConsistencyRow {
        rps: variant.rps,
        imu: variant.imu,
        fusion: variant.fusion(),
        statement: Statement::of([end.front.band, end.rear.band]),
        end,
        ends: Ends::of(block.iter().map(|(run, _)| &run.ended)),
        path_mean: [0, 1, 2].map(|which| statistics::mean(&over(which))),
        path_above: statistics::mean(&above),
        beam_nis: (!nis.is_empty()).then(|| statistics::mean(&nis)),
        path,
    }
}

/// Writes and prints the result.
pub fn publish(
    context: &Context,
    report: &ConsistencyReport,
    variants: &[Variant],
) -> Result<(), Error> {
    let text = table(report, variants);
    let mut files = context.output()?;
    let figure = figure(report);
    figure.add(&mut files, "consistency");
    files.csv("consistency.csv", csv(report));
    context.finish(&text, report, files, &[], None)
}

fn csv(report: &ConsistencyReport) -> Csv {
    let mut rows = Vec::new();
    for row in &report.rows {
        let instants = row.path.iter().map(|instant| (false, instant));
        for (end, instant) in instants.chain([(true, &row.end)]) {
            for (name, body) in BODIES.into_iter().zip(instant.bodies()) {
                let mut cells = csv::CsvRow::default();
                cells.put("rps imu", &[row.rps, row.imu]);
                cells.put("fusion body", &[row.fusion, name]);
                cells.put("end", &[end]);
                cells.put("time_s nees", &[instant.time_s, body.nees]);
                cells.put("band_low band_high", &report.band);
                cells.put("within", &[body.within]);
                cells.put("rms_x_m rms_y_m rms_phi_rad", &body.rms);
                cells.put("claimed_x_m claimed_y_m claimed_phi_rad", &body.claimed);
                rows.push(cells);
            }
        }
    }
    csv::CsvRow::table(rows)
}

/// Fusions in the picture, in the order of their colours.
const FUSIONS: [&str; 4] = ["joint", "odometry", "intersection", "intersection-ipec"];

/// NEES over time: a row of panels for each body, the left panel without and the right panel with inertial sensors.
fn figure(report: &ConsistencyReport) -> Figure {
    let last = report.rows.iter().filter_map(|row| row.path.last());
    let last = last.fold(1.0, |most: f64, instant| most.max(instant.time_s));
    let mut figure = Figure::new("NEES of the estimates and its 95 % band");
    for (which, name) in ["front axle", "rear axle", "midpoint O"]
        .into_iter()
        .enumerate()
    {
        let panels = [false, true].map(|imu| {
            let sensors = if imu { "with IMU" } else { "encoders" };
            let mut panel = Panel::new("time since the start of the task (s)", "mean NEES")
                .title(format!("{name}, {sensors}"))
                .logarithmic([false, true])
                .x_limits([0.0, last])
                .y_limits([0.05, 2e4]);
            if which < 2 {
                panel = panel.hide_x();
            }
            let [low, high] = report.band;
            let band = [[0.0, low], [last, low], [last, high], [0.0, high]];
            panel.area("95 % band", band, BAND.stroke.color);
            for row in report.rows.iter().filter(|row| row.imu == imu) {
                let points = row.path.iter().map(|instant| {
                    let nees = instant.bodies()[which].nees;
                    [instant.time_s, nees.max(1e-9)]
                });
                let known = FUSIONS.iter().position(|fusion| *fusion == row.fusion);
                let color = series(known.unwrap_or(FUSIONS.len()));
                panel.line(row.fusion, points, color.stroke);
            }
            panel
        });
        figure = figure.row(Height::Fixed(170.0), panels);
    }
    figure
}

fn table(report: &ConsistencyReport, variants: &[Variant]) -> String {
    let [low, high] = report.band;
    let mut table = Table::new([
        "",
        "verdict",
        "front",
        "rear",
        "O",
        "below 7.81",
        "path front",
        "path rear",
        "beam NIS",
        "ends",
    ]);
    for (row, variant) in report.rows.iter().zip(variants) {
        let mut cells = vec![variant.label(), row.statement.words().into()];
        cells.extend(row.end.bodies().map(|body| figure_of(body.nees)));
        let within = row.end.front.within.min(row.end.rear.within);
        cells.push(format!("{:.0} %", 100.0 * within));
        cells.extend(row.path_mean[..2].iter().map(|&nees| figure_of(nees)));
        cells.push(row.beam_nis.map_or(String::new(), figure_of));
        cells.push(row.ends.text());
        table.row(cells);
    }
    format!(
        "NEES of the estimated postures (3 degrees of freedom), {} runs a row; consistent: {low:.2} \
         to {high:.2}\n\n{table}\n\
         verdict: NEES of both axles against the 95 % band. front, rear, O: mean NEES at the end of the \
         runs, expected 3.\nbelow 7.81: share of runs within the 95 % ellipsoid (the worse axle). path: \
         mean over runs and time, every\nhalf second. beam NIS: normalised innovation squared of the \
         beam, expected {NIS_EXPECTED}.\n",
        report.runs
    )
}

fn figure_of(value: f64) -> String {
    if value < 100.0 {
        format!("{value:.2}")
    } else {
        format!("{value:.0}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::math::Posture;

    #[test]
    fn nees_sums_squared_errors_in_standard_deviations() {
        let estimate = Estimate::with_sigmas(Posture::new(1.0, 2.0, 3.1), [0.1, 0.2, 0.05]);
        // The errors are one, two and three standard deviations. The whole turn added to the true heading is no error.
        let truth = [0.9, 2.4, 3.1 - 0.15 + std::f64::consts::TAU];
        // The covariance is in f32, so the NEES of 1 + 4 + 9 = 14 is not exact.
        assert!((nees(&estimate, truth) - 14.0).abs() < 1e-4);
    }

    #[test]
    fn nees_is_invariant_under_rotation() {
        // The error ellipse and the error are rotated by the same angle.
        let (s, c) = 0.7f64.sin_cos();
        let turned = |x: f64, y: f64| [c * x - s * y, s * x + c * y];
        let (a, b) = (0.04f64, 0.01f64);
        let mut estimate = Estimate::with_sigmas(Posture::ORIGIN, [1.0; 3]);
        estimate.covariance = [
            [
                (c * c * a + s * s * b) as f32,
                (s * c * (a - b)) as f32,
                0.0,
            ],
            [
                (s * c * (a - b)) as f32,
                (s * s * a + c * c * b) as f32,
                0.0,
            ],
            [0.0, 0.0, 1.0],
        ];
        let [x, y] = turned(0.3, 0.2);
        let expected = 0.09 / a + 0.04 / b + 0.25;
        assert!((nees(&estimate, [x, y, 0.5]) / expected - 1.0).abs() < 1e-5);
        estimate.covariance[2][2] = -1.0;
        assert_eq!(nees(&estimate, [x, y, 0.5]), f64::INFINITY);
    }

    #[test]
    fn one_axle_above_the_band_is_overconfident() {
        let band = [2.5, 3.5];
        let statement =
            |nees: [f64; 2]| Statement::of(nees.map(|mean| BandPosition::of(mean, band)));
        assert_eq!(statement([3.0, 3.4]), Statement::Consistent);
        assert_eq!(statement([3.0, 1.0]), Statement::Cautious);
        assert_eq!(statement([1.0, 3.6]), Statement::Overconfident);
        assert_eq!(statement([3.0, f64::INFINITY]), Statement::Overconfident);
    }
}
