//! The paper's experiment: its algorithms in world `paper`, beside the figures that the paper prints.

use crate::experiments::posture::pictures::Picture;
use crate::experiments::posture::{PostureRow, Trial, Variant, summaries, trials, trials_csv};
use crate::experiments::{Context, Seeds};
use core_algos::control::regulator::Strategy;
use host_sim::base::error::Error;
use host_sim::base::statistics::mean;
use host_sim::run::final_error::FinalError;
use host_sim::scenario::Scenario;
use output::table::{Table, plus_minus};
use output::terminal::wrapped;
use serde::Serialize;
use view::figures;
use view::figures::MeasuredEnd;

/// Sensors and fusion of the rows: encoders alone, and the relative position sensor with the paper's fusion.
pub const ROWS: [Variant; 2] = [Variant::ALL[0], Variant::ALL[2]];

/// Paper Table 1: mean and standard deviation of e (cm), θ and α (°), in the order of [`ROWS`].
pub const TABLE_1: [[[f64; 2]; 3]; 2] = [
    [[10.6, 3.4], [-31.7, 9.4], [-45.4, 12.2]],
    [[9.5, 2.1], [-13.3, 14.2], [-21.6, 14.9]],
];

/// Paper section VII B: reductions of e, θ and α by the sensor, %.
const REDUCTIONS: [f64; 3] = [10.0, 58.0, 52.0];

/// Paper section VII B, figure 8: final e (m), θ and α (rad) according to odometry.
const FIGURE_8: [f64; 3] = [0.015, 0.035, 0.18];

/// Figures of the repeated experiment, the JSON output of the command.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PaperReport {
    /// Trials in each row.
    pub trials: u32,
    /// Rows in the order of [`ROWS`].
    pub rows: Vec<PostureRow>,
    /// Reductions of the means of e, θ and α by the sensor, %.
    pub reductions: [f64; 3],
    /// Mean final e (m), θ and α (rad) by the robot's own estimate, magnitudes, in the order of [`ROWS`].
    pub estimated: Vec<[f64; 3]>,
}

/// The paper's algorithms in world `paper`, in the order of [`ROWS`].
pub fn scenarios() -> Result<[Scenario; 2], Error> {
    let mut scenario = Scenario::in_world(Some("paper"))?;
    scenario.robot.lead.regulator.strategy = Strategy::PaperLaw;
    Ok(ROWS.map(|variant| variant.apply(&scenario)))
}

/// Distance e (cm), angles θ and α (°) of a row, each as mean and standard deviation.
pub fn figures(row: &PostureRow) -> [[f64; 2]; 3] {
    let degrees = |angle: f64| angle.to_degrees();
    [
        [100.0 * row.e_m.mean, 100.0 * row.e_m.sd],
        [row.theta_rad.mean, row.theta_rad.sd].map(degrees),
        [row.alpha_rad.mean, row.alpha_rad.sd].map(degrees),
    ]
}

/// Runs the trials of both rows, prints the comparison with the paper and writes the files.
pub fn run(context: &Context, seeds: Seeds) -> Result<(), Error> {
    let scenarios = scenarios()?;
    let blocks = trials::run(&context.workers, &scenarios, seeds, |_| true)?;
    let goal = context.scenario.mission.goal;
    let pairs = || ROWS.iter().zip(&blocks);
    let rows = summaries(pairs(), goal)?;
    let report = PaperReport {
        trials: blocks.iter().map(Vec::len).max().unwrap_or(0) as u32,
        reductions: reductions(&rows),
        estimated: blocks.iter().map(|block| estimated(block, goal)).collect(),
        rows,
    };
    let mut files = context.output()?;
    let body = context.body();
    let mut panels = Vec::new();
    let mut columns = Vec::new();
    for (n, ((variant, block), scenario)) in pairs().zip(&scenarios).enumerate() {
        let picture = Picture::of(variant, scenario, block);
        let mut panel = picture.paths(body.half_track_m);
        let [e, theta, alpha] = TABLE_1[n];
        panel.measured = Some(MeasuredEnd {
            e_m: e.map(|cm| 0.01 * cm),
            theta_rad: theta.map(f64::to_radians),
            alpha_rad: alpha.map(f64::to_radians),
        });
        panels.push(panel);
        let mut column = picture.errors();
        column.measured = Some(FIGURE_8);
        columns.push(column);
    }
    let title = "Paths during posture regulation, paper figure 7";
    figures::paths(title, &body, &panels).add(&mut files, "figure-7");
    let title = "Posture errors, paper figure 8";
    figures::errors(title, &columns).add(&mut files, "figure-8");
    files.csv("trials.csv", trials_csv(pairs(), goal));
    let text = screen(context, &report);
    context.finish(&text, &report, files, &[], None)
}

/// Reductions of e, θ and α from the first row to the second, %.
fn reductions(rows: &[PostureRow]) -> [f64; 3] {
    let mut means = rows.iter().map(|row| figures(row).map(|[mean, _]| mean));
    match (means.next(), means.next()) {
        (Some(without), Some(with)) => {
            std::array::from_fn(|k| 100.0 * (1.0 - with[k] / without[k]))
        }
        _ => [f64::NAN; 3],
    }
}

/// Mean magnitudes of e, θ and α at the end by the robot's own estimate.
fn estimated(block: &[Trial], goal: [f64; 3]) -> [f64; 3] {
    let ends = block.iter().filter_map(|trial| trial.outcome.end.estimate);
    let errors = ends.map(|posture| FinalError::of(posture, goal));
    let errors: Vec<[f64; 3]> = errors
        .map(|error| [error.e_m, error.theta_rad.abs(), error.alpha_rad.abs()])
        .collect();
    std::array::from_fn(|k| mean(&errors.iter().map(|error| error[k]).collect::<Vec<_>>()))
}

/// Verdict and tables, as the command prints them.
fn screen(context: &Context, report: &PaperReport) -> String {
    let percent = |values: [f64; 3]| values.map(|value| format!("{value:.0} %"));
    let [ours, papers] = [report.reductions, REDUCTIONS].map(percent);
    let verdict = wrapped(&format!(
        "The gauges reduce the mean errors e, θ and α by {}; the paper's robot: {}.",
        ours.join(", "),
        papers.join(", ")
    ));
    let mut table = Table::new(["Table 1", "e (cm)", "θ (°)", "α (°)"]);
    for ((variant, measured), row) in ROWS.iter().zip(TABLE_1).zip(&report.rows) {
        for (source, figures) in [("paper", measured), ("simulated", figures(row))] {
            let mut cells = vec![format!("{}, {source}", variant.sensors())];
            cells.extend(figures.map(|[mean, sd]| plus_minus(mean, sd, 1)));
            table.row(cells);
        }
    }
    table.rule();
    for (name, values) in [("reduction, paper", papers), ("reduction, simulated", ours)] {
        let mut cells = vec![name.to_owned()];
        cells.extend(values);
        table.row(cells);
    }
    let mut ends = Table::new([
        "Figure 8, end by the robot's own estimate",
        "e (cm)",
        "θ (°)",
        "α (°)",
    ]);
    let simulated = ROWS.iter().zip(&report.estimated);
    let simulated =
        simulated.map(|(variant, end)| (format!("{}, simulated", variant.sensors()), *end));
    for (name, [e, theta, alpha]) in [("paper".to_owned(), FIGURE_8)]
        .into_iter()
        .chain(simulated)
    {
        let [e, theta, alpha] = [100.0 * e, theta.to_degrees(), alpha.to_degrees()];
        table_row(&mut ends, name, [e, theta, alpha]);
    }
    let counts = ROWS.iter().zip(&report.rows);
    let counts = counts.map(|(variant, row)| format!("{}: {}", variant.sensors(), row.ends.text()));
    let folder = context.folder().display();
    format!(
        "{verdict}\nThe paper's experiment: {} trials a row, seed {}, world paper\n\n{table}\n{ends}\n{}{}{}\
         \nopen {folder}/figure-7.png, {folder}/figure-8.png\n",
        report.trials,
        context.seed,
        wrapped(
            "e: distance from the goal; θ: direction of the goal; α: direction of the goal less the robot's heading."
        ),
        wrapped(&format!("ends: {}", counts.collect::<Vec<_>>().join("; "))),
        wrapped(
            "World paper has three constants fitted to the six means of Table 1, so their agreement is no evidence. \
             Standard deviations and figure 8 are not fitted."
        ),
    )
}

fn table_row(table: &mut Table, name: String, values: [f64; 3]) {
    let values = values.map(|value| format!("{value:.1}"));
    table.row([name].into_iter().chain(values));
}
