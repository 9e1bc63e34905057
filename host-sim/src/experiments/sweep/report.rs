//! Result of a sweep: shares, lengths, table and CSV.

use super::{Failure, Start, Sweep, SweepModel, is_within};
use crate::base::output::{Cell, Csv};
use crate::base::statistics::{mean, percentile, sum};
use crate::base::table::Table;
use crate::experiments::posture::CHI_SQUARE_99;
use serde::Serialize;

/// Median, 95th percentile and largest of some values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Largest.
    pub max: f64,
}

impl Spread {
    fn of(values: &[f64]) -> Self {
        Self {
            p50: percentile(values, 0.5),
            p95: percentile(values, 0.95),
            max: percentile(values, 1.0),
        }
    }
}

/// Path length over that of the shortest path within the curvature bound.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LengthRatio {
    /// Mean of the starts' ratios.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// All driven lengths over all shortest lengths.
    pub total: f64,
}

/// Number of failed starts by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Failures {
    /// Not done within the time limit.
    pub time: usize,
    /// Given up.
    pub gave_up: usize,
    /// Done but moving.
    pub moving: usize,
    /// Done but too far off.
    pub position: usize,
    /// Done but turned too far.
    pub heading: usize,
}

/// The result of the command.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Number of starts.
    pub starts: usize,
    /// Number of starts that ended at rest on the goal: within 3 cm and 3°, or within what the robot then
    /// claimed (95 %).
    pub successes: usize,
    /// Number of starts that ended within 3 cm and 3° of the goal.
    pub within_3cm_3deg: usize,
    /// Number of starts whose error of the estimate of O lay in the claimed 99 % ellipsoid, on the whole
    /// robot.
    pub inside_99: Option<usize>,
    /// `kinematic` or `plant`.
    pub model: &'static str,
    /// Bound of curvature, 1/m.
    pub kappa_max: f64,
    /// Failed starts by reason.
    pub failures: Failures,
    /// Driven length over the shortest.
    pub length_ratio: LengthRatio,
    /// True final distance from the goal, m.
    pub e_m: Spread,
    /// True final heading error (magnitude), rad.
    pub heading_rad: Spread,
    /// Time of a trial, s.
    pub time_s: Spread,
    /// Largest true curvature by the frame's bend over all starts, 1/m.
    pub max_curvature: f64,
    /// Largest true curvature of a driven path over all starts, 1/m.
    pub max_path_curvature: f64,
    /// Largest commanded curvature over all starts, 1/m.
    pub max_commanded_curvature: f64,
    /// Starts in which the command or a true curvature exceeded the bound.
    pub bound_broken: usize,
    /// Mean number of changes of direction.
    pub mean_cusps: f64,
    /// Starts that needed more than one plan.
    pub replanned: usize,
    /// Longest search for a plan, steps of the lead node (10 ms).
    pub max_planning_steps: u32,
    /// Candidate postures the planner may look at in a step of the lead node.
    pub planner_budget: u32,
}

impl Report {
    /// Summarises the starts of one sweep.
    pub fn of(starts: &[Start], sweep: &Sweep) -> Self {
        let values = |pick: fn(&Start) -> f64| -> Vec<f64> { starts.iter().map(pick).collect() };
        let largest = |pick: fn(&Start) -> f64| starts.iter().map(pick).fold(0.0, f64::max);
        let count = |reason| starts.iter().filter(|s| s.failure == Some(reason)).count();
        let ratios = values(|s| s.length_m / s.shortest_m);
        Self {
            starts: starts.len(),
            successes: starts.iter().filter(|s| s.failure.is_none()).count(),
            within_3cm_3deg: starts.iter().filter(|start| is_within(start)).count(),
            inside_99: starts
                .iter()
                .map(|s| s.nees.map(|nees| usize::from(nees <= CHI_SQUARE_99)))
                .sum(),
            model: match sweep.model {
                SweepModel::Kinematic => "kinematic",
                SweepModel::Plant => "plant",
            },
            kappa_max: sweep.kappa_max,
            failures: Failures {
                time: count(Failure::Time),
                gave_up: count(Failure::GaveUp),
                moving: count(Failure::Moving),
                position: count(Failure::Position),
                heading: count(Failure::Heading),
            },
            length_ratio: LengthRatio {
                mean: mean(&ratios),
                p50: percentile(&ratios, 0.5),
                p95: percentile(&ratios, 0.95),
                total: sum(values(|s| s.length_m)) / sum(values(|s| s.shortest_m)),
            },
            e_m: Spread::of(&values(|s| s.e_m)),
            heading_rad: Spread::of(&values(|s| s.heading_rad.abs())),
            time_s: Spread::of(&values(|s| s.time_s)),
            max_curvature: largest(|s| s.max_curvature),
            max_path_curvature: largest(|s| s.max_path_curvature),
            max_commanded_curvature: largest(|s| s.max_commanded_curvature),
            bound_broken: starts
                .iter()
                .filter(|s| {
                    let largest = s.max_curvature.max(s.max_path_curvature);
                    !(largest.max(s.max_commanded_curvature) <= sweep.kappa_max)
                })
                .count(),
            mean_cusps: mean(&values(|s| f64::from(s.cusps))),
            replanned: starts.iter().filter(|s| s.plans > 1).count(),
            max_planning_steps: starts.iter().map(|s| s.planning_steps).max().unwrap_or(0),
            planner_budget: sweep.scenario.robot.lead.regulator.planner_budget,
        }
    }
}

pub(super) fn csv(starts: &[Start]) -> Csv {
    let mut csv = Csv::new([
        "start",
        "x_m",
        "y_m",
        "phi_rad",
        "success",
        "failure",
        "e_m",
        "heading_rad",
        "nees",
        "time_s",
        "length_m",
        "shortest_m",
        "max_curvature_1_m",
        "max_path_curvature_1_m",
        "max_commanded_curvature_1_m",
        "cusps",
        "plans",
        "planning_steps",
    ]);
    for (index, start) in starts.iter().enumerate() {
        csv.row::<Cell>([
            index.into(),
            start.start[0].into(),
            start.start[1].into(),
            start.start[2].into(),
            start.failure.is_none().into(),
            start.failure.map(Failure::name).into(),
            start.e_m.into(),
            start.heading_rad.into(),
            start.nees.into(),
            start.time_s.into(),
            start.length_m.into(),
            start.shortest_m.into(),
            start.max_curvature.into(),
            start.max_path_curvature.into(),
            start.max_commanded_curvature.into(),
            start.cusps.into(),
            start.plans.into(),
            start.planning_steps.into(),
        ]);
    }
    csv
}

pub(super) fn table(report: &Report) -> String {
    let share = 100.0 * report.successes as f64 / report.starts as f64;
    let mut lines = vec![
        format!(
            "Posture regulation from {} random starts within 2 m in x and y, any heading; model: {}",
            report.starts, report.model
        ),
        String::new(),
        format!(
            "{} of {} ({share:.2} %) ended at rest on the goal by the estimate; {} within 3 cm and 3°{}",
            report.successes,
            report.starts,
            report.within_3cm_3deg,
            report.inside_99.map_or(String::new(), |inside| format!(
                ",\n{inside} with the true posture in the 99 % ellipsoid of the estimate"
            ))
        ),
    ];
    let failures = &report.failures;
    for (reason, number) in [
        ("out of time", failures.time),
        ("gave up", failures.gave_up),
        ("still moving", failures.moving),
        ("position error too large", failures.position),
        ("heading error too large", failures.heading),
    ] {
        if number > 0 {
            lines.push(format!("  {reason}: {number}"));
        }
    }
    let mut table = Table::new(["true final state and effort", "median", "95 %", "largest"]);
    let mut row = |name: &str, spread: &Spread, scale: f64, digits: usize| {
        table.row([
            name.to_owned(),
            format!("{:.digits$}", scale * spread.p50),
            format!("{:.digits$}", scale * spread.p95),
            format!("{:.digits$}", scale * spread.max),
        ]);
    };
    row("e (mm)", &report.e_m, 1e3, 2);
    row("|heading| (°)", &report.heading_rad, 1f64.to_degrees(), 2);
    row("time (s)", &report.time_s, 1.0, 1);
    lines.push(format!("\n{table}"));
    let ratio = &report.length_ratio;
    lines.push(format!(
        "path length over the shortest path of bounded curvature: mean {:.3}, median {:.3}, 95 % below \
         {:.3}",
        ratio.mean, ratio.p50, ratio.p95
    ));
    lines.push(format!(
        "curvature (1/m): bound {:.3}; largest commanded {:.3}, true of the frame {:.3}, true of the \
         path {:.3};\nstarts beyond the bound: {}",
        report.kappa_max,
        report.max_commanded_curvature,
        report.max_curvature,
        report.max_path_curvature,
        report.bound_broken
    ));
    lines.push(format!(
        "cusps: mean {:.2}; starts with more than one plan: {}; longest search for a plan: {} \
         steps of 10 ms,\nat most {} candidate postures each\n",
        report.mean_cusps, report.replanned, report.max_planning_steps, report.planner_budget
    ));
    lines.join("\n")
}
