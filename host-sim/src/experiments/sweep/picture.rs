//! Starts and paths of a sweep as a picture.

use crate::experiments::sweep::{Failure, Report, Start, is_within};
use crate::view::figures::{self, SweepStart};
use crate::view::plot::Figure;
use crate::view::style::End;

/// Paths the picture shows: of the first starts, and of failed ones.
const SHOWN_PATHS: usize = 40;
const SHOWN_FAILURES: usize = 10;

/// The end that the picture shows: by the tolerance alone, not by what the robot claims to know.
fn end(start: &Start) -> End {
    use Failure::{GaveUp, Moving, Time};
    let at_rest = !matches!(start.failure, Some(Time | GaveUp | Moving));
    End::of(at_rest, is_within(start))
}

/// The picture of all starts with the paths of some.
pub fn figure(
    starts: &[Start],
    paths: Vec<Vec<[f64; 2]>>,
    report: &Report,
    goal: [f64; 3],
) -> Figure {
    let title = format!(
        "Regulation from {} random starts, {}, curvature ≤ {:.2} 1/m",
        report.starts,
        match report.model {
            "plant" => "whole robot",
            _ => "kinematic model",
        },
        report.kappa_max,
    );
    let mut failed = 0;
    let marks: Vec<SweepStart> = starts
        .iter()
        .zip(paths)
        .enumerate()
        .map(|(index, (start, path))| {
            failed += usize::from(start.failure.is_some());
            let more = start.failure.is_some() && failed <= SHOWN_FAILURES;
            let shown = index < SHOWN_PATHS || more;
            SweepStart {
                posture: start.start,
                value: start.time_s,
                end: end(start),
                path: if shown { path } else { Vec::new() },
            }
        })
        .collect();
    figures::sweep(&title, "time to rest on the goal (s)", &marks, goal)
}
