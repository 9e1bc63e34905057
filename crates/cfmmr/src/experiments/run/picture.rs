//! Log, picture and report page of a run.

use crate::experiments::Context;
use crate::experiments::posture::pictures;
use host_sim::run::end::{RunEnd, Verdict};
use host_sim::run::robot::Record;
use output::files::OutputDir;
use recording::csv;
use view::figures;
use view::figures::PathsPanel;
use view::page;

/// Adds log, picture and report page of a run with its end and goal. Draws the estimate if the true posture is unknown.
pub fn draw(
    context: &Context,
    files: &mut OutputDir,
    records: &[Record],
    (end, goal): (&RunEnd, Option<[f64; 3]>),
    title: String,
    summary: Vec<(String, String)>,
) {
    files.csv("log.csv", csv::of_records(records));
    let shown: Vec<Record> = records.iter().map(Record::with_estimate).collect();
    let Some(last) = shown.last() else {
        return;
    };
    let body = context.body();
    let mission = &context.scenario.mission;
    let within = goal.is_none_or(|goal| mission.is_near(last.midpoint, goal));
    let panel = PathsPanel {
        title: title.clone(),
        others: Vec::new(),
        path: shown
            .iter()
            .map(|at| [at.midpoint[0], at.midpoint[1]])
            .collect(),
        wheels: pictures::wheel_paths(&shown, body.half_track_m),
        snapshots: pictures::snapshots(&shown),
        goal,
        tolerance: [mission.tolerance_m, mission.tolerance_rad],
        ends: vec![(Verdict::of(end.kind, within), last.midpoint)],
        measured: None,
    };
    let heading = match records[0].midpoint[0].is_nan() {
        true => "Path of the robot, as estimated",
        false => "Path of the robot",
    };
    let figure = figures::paths(heading, &body, &[panel]);
    figure.add(files, "paths");
    let error = |record: &Record| {
        let at = record.lead.fused.robot.posture;
        let [x, y, phi] = record.midpoint;
        let off = libm::hypot(f64::from(at.x) - x, f64::from(at.y) - y);
        [[f64::NAN; 2], [off, f64::from(at.phi) - phi]]
    };
    let run = page::Run {
        title: heading.to_owned(),
        name: title,
        goal,
        reference: Vec::new(),
        records: records.iter().collect(),
        errors: records.iter().map(error).collect(),
        distance: "Distance of the estimate from the truth",
        end,
        summary,
        scenario: &context.scenario,
    };
    page::add(files, &context.subtitle(), &body, &[run]);
}
