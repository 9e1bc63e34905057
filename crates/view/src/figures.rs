//! Figures of the experiments, as [`plot::Figure`](crate::plot::Figure)s.
//!
//! Postures are (x, y, heading) in metres and radians.

use crate::plot::{Figure, Height, Panel, extent};
use crate::style::{
    BODY, ESTIMATE, FRAME, GOAL_MARK, Mark, OTHERS, PAPER, PAPER_MARK, REFERENCE, Rgb, Shape,
    TRUTH, WHEELS, color_scale, mark_of, stroke_of,
};
use host_sim::run::end::Verdict;
use host_sim::run::final_error::FinalError;
use host_sim::run::robot::{FrameRecord, Record};
use host_sim::world::body::Body;

/// Goal distance below which θ and α are not drawn, m: near the goal they are dominated by millimetres.
pub const LEAST_DISTANCE_M: f64 = 0.05;

/// Axles and frames of the robot at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// Time of the snapshot, s.
    pub time_s: f64,
    /// Postures of the axles, front first.
    pub axles: Vec<[f64; 3]>,
    /// Points of each bent frame from its root to its tip, front first.
    pub frames: Vec<Vec<[f64; 2]>>,
}

impl Snapshot {
    /// Axles and frames of the robot at the time of a record.
    pub fn of(record: &Record) -> Self {
        let frame = |frame: &FrameRecord| frame.points.map(|p| p.map(f64::from)).to_vec();
        Self {
            time_s: record.time_s,
            axles: record.axles.iter().map(|axle| axle.posture).collect(),
            frames: record.frames.iter().map(frame).collect(),
        }
    }
}

/// Paths and final postures of trials with one configuration; one trial is shown in full.
#[derive(Clone, Debug, PartialEq)]
pub struct PathsPanel {
    /// Title of the panel: configuration, and trial shown in full.
    pub title: String,
    /// Path of O in each of the other trials, m.
    pub others: Vec<Vec<[f64; 2]>>,
    /// Path of O in the trial shown in full, m.
    pub path: Vec<[f64; 2]>,
    /// Paths of the wheels in the trial shown in full, m.
    pub wheels: Vec<Vec<[f64; 2]>>,
    /// Robot at several instants of the trial shown in full.
    pub snapshots: Vec<Snapshot>,
    /// Goal posture of O; `None` without a goal.
    pub goal: Option<[f64; 3]>,
    /// Tolerance of the goal: position (m), heading (rad).
    pub tolerance: [f64; 2],
    /// Verdict and final posture of O in every trial.
    pub ends: Vec<(Verdict, [f64; 3])>,
    /// Measured final errors of the paper's robot; `None` if the panel does not repeat the paper's experiment.
    pub measured: Option<MeasuredEnd>,
}

/// Final errors of the paper's robot (paper Table 1): mean and standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredEnd {
    /// Distance from the goal, m: mean and standard deviation.
    pub e_m: [f64; 2],
    /// Line of sight to the goal, rad: mean and standard deviation.
    pub theta_rad: [f64; 2],
    /// Line of sight to the goal less the robot's heading, rad: mean and standard deviation.
    pub alpha_rad: [f64; 2],
}

impl MeasuredEnd {
    /// Posture with the mean errors, in the coordinates of the goal: cm, cm, rad.
    fn mean_posture(&self) -> [f64; 3] {
        let [x, y] = position_cm(self.e_m[0], self.theta_rad[0]);
        [x, y, self.theta_rad[0] - self.alpha_rad[0]]
    }

    /// Outline of the positions, cm, whose errors e and θ lie within one standard deviation of their means.
    fn outline(&self) -> Vec<[f64; 2]> {
        let ([e, e_sd], [theta, theta_sd]) = (self.e_m, self.theta_rad);
        let arc = |e: f64, side: f64| {
            (-20..=20).map(move |k| position_cm(e, theta + side * theta_sd * f64::from(k) / 20.0))
        };
        let outer = arc(e + e_sd, 1.0);
        let start = position_cm(e + e_sd, theta - theta_sd);
        outer.chain(arc(e - e_sd, -1.0)).chain([start]).collect()
    }
}

/// Position, cm, at a distance (m) from the goal that lies in the direction `theta`.
fn position_cm(e_m: f64, theta: f64) -> [f64; 2] {
    let (sin, cos) = libm::sincos(theta);
    [-100.0 * e_m * cos, -100.0 * e_m * sin]
}

/// Robot paths during posture regulation (paper figure 7): one panel per configuration with a common scale, and a row
/// with the final postures below.
pub fn paths(title: &str, body: &Body, panels: &[PathsPanel]) -> Figure {
    let maps: Vec<Panel> = panels.iter().map(|panel| path_map(body, panel)).collect();
    let [x, y] = shared_limits(&maps, 0.07);
    let maps = maps.into_iter().map(|map| map.x_limits(x).y_limits(y));
    let height = Height::Data {
        least: 200.0,
        greatest: 520.0,
    };
    let figure = Figure::new(title).row(height, maps);
    let shown = |panel: &PathsPanel| panel.goal.is_some() && !panel.ends.is_empty();
    if !panels.iter().any(shown) {
        return figure;
    }
    let ends: Vec<Panel> = panels.iter().map(end_map).collect();
    // The panels are square and centred on the goal.
    let corners = shared_limits(&ends, 0.0);
    let far = corners.into_iter().flatten();
    let far = far.fold(1.0, |far: f64, v| far.max(1.12 * v.abs()));
    let ends = ends
        .into_iter()
        .map(|panel| panel.x_limits([-far, far]).y_limits([-far, far]));
    figure.row(Height::Fixed(250.0), ends)
}

fn path_map(body: &Body, data: &PathsPanel) -> Panel {
    let mut panel = Panel::new("x (m)", "y (m)")
        .title(data.title.clone())
        .caption(times(&data.snapshots))
        .equal_axes();
    for path in &data.others {
        panel.line("O, other trials", path.iter().copied(), OTHERS.stroke);
    }
    for path in &data.wheels {
        panel.line("wheel tracks", path.iter().copied(), WHEELS.stroke);
    }
    for snapshot in &data.snapshots {
        robot(&mut panel, body, snapshot);
    }
    let name = match data.others.is_empty() {
        true => "path of O",
        false => "O, median trial",
    };
    panel.line(name, data.path.iter().copied(), TRUTH.stroke);
    if let Some(at) = data.goal {
        goal(&mut panel, at);
    }
    panel
}

/// Final postures in the coordinates of the goal, cm.
fn end_map(data: &PathsPanel) -> Panel {
    let mut panel = Panel::new("along the goal's heading (cm)", "across (cm)")
        .title(match data.ends.len() {
            1 => "final O and heading".to_owned(),
            trials => format!("final O and heading, {trials} trials"),
        })
        .equal_axes();
    let radius = 100.0 * data.tolerance[0];
    let circle = (0..=72).map(|k| {
        let (sin, cos) = libm::sincos(f64::from(5 * k).to_radians());
        [radius * cos, radius * sin]
    });
    panel.line("tolerance", circle, REFERENCE.stroke);
    let [x, y, phi] = data.goal.unwrap_or_default();
    let (sin, cos) = libm::sincos(phi);
    for (verdict, posture) in &data.ends {
        let (dx, dy) = (posture[0] - x, posture[1] - y);
        let at = [100.0 * (cos * dx + sin * dy), 100.0 * (cos * dy - sin * dx)];
        let mark = mark_of(*verdict, 3.0).heading(posture[2] - phi);
        panel.mark(verdict.label(data.tolerance), at, mark);
    }
    if let Some(measured) = data.measured {
        let name = "paper, Table 1: mean ± standard deviation";
        panel.line(name, measured.outline(), PAPER.stroke);
        let [x, y, heading] = measured.mean_posture();
        panel.mark(name, [x, y], PAPER_MARK.heading(heading));
    }
    goal(&mut panel, [0.0; 3]);
    panel
}

fn shared_limits(panels: &[Panel], margin: f64) -> [[f64; 2]; 2] {
    let corners: Vec<[f64; 2]> = panels
        .iter()
        .filter_map(Panel::extent)
        .flat_map(|[x, y]| [[x[0], y[0]], [x[1], y[1]]])
        .collect();
    extent(&corners)
        .unwrap_or([[0.0, 1.0]; 2])
        .map(|[low, high]| {
            let pad = margin * (high - low);
            [low - pad, high + pad]
        })
}

fn goal(panel: &mut Panel, [x, y, heading]: [f64; 3]) {
    panel.mark("goal", [x, y], GOAL_MARK.heading(heading));
}

/// Caption with the times of the snapshots, outside the panel, where it covers no track.
fn times(snapshots: &[Snapshot]) -> String {
    let mut times: Vec<f64> = snapshots.iter().map(|snapshot| snapshot.time_s).collect();
    times.sort_by(f64::total_cmp);
    let times: Vec<String> = times.iter().map(|time| format!("{time:.1}")).collect();
    match times.join(", ") {
        times if times.is_empty() => times,
        times => format!("robot at {times} s"),
    }
}

/// Draws the robot of a snapshot: wheels, axles, frames, and an arrow at the front.
fn robot(panel: &mut Panel, body: &Body, snapshot: &Snapshot) {
    for &axle in snapshot.axles.iter().rev() {
        let ends = [body.half_track_m, -body.half_track_m].map(|y| ahead(axle, [0.0, y]));
        panel.line("axles and wheels", ends, BODY.stroke);
        for side in [body.half_track_m, -body.half_track_m] {
            let (r, w) = (body.wheel_radius_m, 0.5 * body.wheel_width_m);
            let corners = [[r, w], [-r, w], [-r, -w], [r, -w]];
            let corners = corners.map(|[x, y]| ahead(axle, [x, y + side]));
            panel.area("", corners, BODY.stroke.color);
        }
    }
    for frame in &snapshot.frames {
        panel.line("frame, arrow in front", frame.iter().copied(), FRAME.stroke);
    }
    let tip = 0.9 * body.wheel_radius_m;
    let arrow = [[tip, 0.0], [0.0, 0.6 * tip], [0.0, -0.6 * tip]];
    if let Some(&front) = snapshot.axles.first() {
        panel.area(
            "",
            arrow.map(|point| ahead(front, point)),
            FRAME.stroke.color,
        );
    }
}

/// Converts a point from the coordinates of a posture to global coordinates.
fn ahead([x, y, heading]: [f64; 3], [forward, left]: [f64; 2]) -> [f64; 2] {
    let (sin, cos) = libm::sincos(heading);
    [
        x + cos * forward - sin * left,
        y + sin * forward + cos * left,
    ]
}

/// Goal errors of one configuration over time.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorsColumn {
    /// Title of the column: configuration and trial.
    pub title: String,
    /// Time, s, and goal errors of the robot's estimate.
    pub estimate: Vec<(f64, FinalError)>,
    /// Time, s, and true goal errors.
    pub truth: Vec<(f64, FinalError)>,
    /// Final e (m), θ and α (rad) that the paper prints for the estimate of its robot; `None` without printed values.
    pub measured: Option<[f64; 3]>,
}

/// Axis of one of the three errors: label, unit in the caption, factor from the curve's unit to the caption's unit, and
/// value.
struct ErrorAxis {
    label: &'static str,
    unit: &'static str,
    per_unit: f64,
    pick: fn(&FinalError) -> f64,
}

const ERROR_AXES: [ErrorAxis; 3] = [
    ErrorAxis {
        label: "e (m)",
        unit: " cm",
        per_unit: 100.0,
        pick: |error| error.e_m,
    },
    ErrorAxis {
        label: "θ (°) at e ≥ 5 cm",
        unit: "°",
        per_unit: 1.0,
        pick: |error| angle_far_away(error, error.theta_rad),
    },
    ErrorAxis {
        label: "α (°) at e ≥ 5 cm",
        unit: "°",
        per_unit: 1.0,
        pick: |error| angle_far_away(error, error.alpha_rad),
    },
];

/// The angle `angle` in degrees; NaN within [`LEAST_DISTANCE_M`] of the goal.
fn angle_far_away(error: &FinalError, angle: f64) -> f64 {
    match error.e_m < LEAST_DISTANCE_M {
        true => f64::NAN,
        false => angle.to_degrees(),
    }
}

/// Posture errors over time (paper figure 8): e, θ and α, estimated and true, with the final values in the caption.
/// The curves of θ and α end where e falls below [`LEAST_DISTANCE_M`].
pub fn errors(title: &str, columns: &[ErrorsColumn]) -> Figure {
    let mut figure = Figure::new(title);
    for (row, axis) in ERROR_AXES.iter().enumerate() {
        let panels: Vec<Panel> = columns
            .iter()
            .map(|column| error_panel(axis, row, column))
            .collect();
        let [mut time, values] = shared_limits(&panels, 0.0);
        // The time axis is extended so that marks at its end are drawn whole.
        if columns.iter().any(|column| column.measured.is_some()) {
            time[1] += 0.03 * (time[1] - time[0]);
        }
        let pad = (0.06 * (values[1] - values[0])).max(1e-6);
        let limits = [values[0] - pad, values[1] + pad];
        let panels = panels
            .into_iter()
            .map(|panel| panel.x_limits(time).y_limits(limits));
        figure = figure.row(Height::Fixed(165.0), panels);
    }
    figure
}

fn error_panel(axis: &ErrorAxis, row: usize, column: &ErrorsColumn) -> Panel {
    let mut panel = Panel::new("t (s)", axis.label);
    if row == 0 {
        panel = panel.title(column.title.clone());
    }
    if row + 1 < ERROR_AXES.len() {
        panel = panel.hide_x();
    }
    let mut last = Vec::new();
    for (name, trace, appearance) in [
        ("true", &column.truth, TRUTH),
        ("robot's estimate", &column.estimate, ESTIMATE),
    ] {
        let points = trace.iter().map(|(t, error)| [*t, (axis.pick)(error)]);
        last.extend(
            points
                .clone()
                .next_back()
                .map(|[_, value]| match value.is_finite() {
                    true => format!("{:.1}{}", value * axis.per_unit, axis.unit).replace('-', "−"),
                    false => "–".to_owned(),
                }),
        );
        panel.line(name, with_gaps(points, 180.0), appearance.stroke);
    }
    let end = column.estimate.last().zip(column.measured);
    if let Some(((time, _), measured)) = end {
        let value = match row {
            0 => measured[0],
            _ => measured[row].to_degrees(),
        };
        panel.mark("paper, final value by odometry", [*time, value], PAPER_MARK);
    }
    match last.as_slice() {
        [truth, estimate] => panel.caption(format!("final: {truth}; estimate: {estimate}")),
        _ => panel,
    }
}

/// Interrupts a line at jumps larger than `gap`, such as the wrap of an angle.
fn with_gaps(points: impl Iterator<Item = [f64; 2]>, gap: f64) -> Vec<[f64; 2]> {
    let mut out: Vec<[f64; 2]> = Vec::new();
    for point in points {
        if out
            .last()
            .is_some_and(|last| (point[1] - last[1]).abs() > gap)
        {
            out.push([f64::NAN; 2]);
        }
        out.push(point);
    }
    out
}

/// Paths and errors of a run along a path or after a moving reference.
#[derive(Clone, Debug, PartialEq)]
pub struct FollowRun {
    /// Reference path, m.
    pub reference: Vec<[f64; 2]>,
    /// Paths as driven, m: of O, or of every axle of a robot of three and more axles.
    pub driven: Vec<Vec<[f64; 2]>>,
    /// Robot at several instants.
    pub snapshots: Vec<Snapshot>,
    /// Caption of the distance panel.
    pub distance_label: &'static str,
    /// Path errors of the true posture of O, of three and more axles of the first axle.
    pub truth: FollowErrors,
    /// Path errors of the estimated posture of O, of three and more axles of the first axle.
    pub estimate: FollowErrors,
}

/// Path errors of the true or of the estimated posture over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FollowErrors {
    /// Time of each error, s.
    pub t_s: Vec<f64>,
    /// Distance from the reference, m; signed if it is measured across the path.
    pub distance_m: Vec<f64>,
    /// Heading less the reference's heading, rad.
    pub heading_rad: Vec<f64>,
}

/// Figure of the reference path, the driven path, and the path errors over time.
pub fn follow(title: &str, body: &Body, run: &FollowRun) -> Figure {
    let mut map = Panel::new("x (m)", "y (m)")
        .caption(times(&run.snapshots))
        .equal_axes();
    // Paths of axles lie on the frames, so the robot is drawn over them; the path of O is drawn over the robot.
    let (below, above) = match run.driven.len() {
        1 => (&[][..], &run.driven[..]),
        _ => (&run.driven[..], &[][..]),
    };
    for path in below {
        map.line("true", path.iter().copied(), TRUTH.stroke);
    }
    for snapshot in &run.snapshots {
        robot(&mut map, body, snapshot);
    }
    for path in above {
        map.line("true", path.iter().copied(), TRUTH.stroke);
    }
    map.line("reference", run.reference.iter().copied(), REFERENCE.stroke);
    let mut distance = Panel::new("t (s)", "distance (mm)")
        .caption(run.distance_label)
        .hide_x();
    let mut heading = Panel::new("t (s)", "heading error (°)");
    for (name, errors, appearance) in [
        ("true", &run.truth, TRUTH),
        ("robot's estimate", &run.estimate, ESTIMATE),
    ] {
        let over_time = |values: &[f64], factor: f64| -> Vec<[f64; 2]> {
            let pairs = errors.t_s.iter().zip(values);
            pairs.map(|(&t, &value)| [t, factor * value]).collect()
        };
        distance.line(name, over_time(&errors.distance_m, 1e3), appearance.stroke);
        let turns = over_time(&errors.heading_rad, 1f64.to_degrees());
        heading.line(name, with_gaps(turns.into_iter(), 180.0), appearance.stroke);
    }
    let height = Height::Data {
        least: 180.0,
        greatest: 560.0,
    };
    Figure::new(title)
        .row(height, [map])
        .row(Height::Fixed(140.0), [distance])
        .row(Height::Fixed(140.0), [heading])
}

/// Start posture in a map, with value and verdict of its run.
#[derive(Clone, Debug, PartialEq)]
pub struct StartMark {
    /// Start posture of O.
    pub posture: [f64; 3],
    /// Value shown as the colour of the mark if the run ended within the tolerance.
    pub value: f64,
    /// Verdict of the run from this start.
    pub end: Verdict,
}

/// Limits of the colour scale: least value and 98th percentile of the runs that ended within the tolerance.
fn color_limits<'a>(starts: impl Iterator<Item = &'a StartMark>) -> [f64; 2] {
    let within = starts.filter(|start| start.end == Verdict::Within);
    let values = within
        .map(|start| start.value)
        .filter(|value| value.is_finite());
    let values: Vec<f64> = values.collect();
    let [low, high] = match values.is_empty() {
        true => [0.0, 1.0],
        false => [0.0, 0.98].map(|share| host_sim::base::statistics::percentile(&values, share)),
    };
    [low, if high > low { high } else { low + 1.0 }]
}

/// Colour of a start: by its value if within the tolerance, otherwise by its verdict.
fn color_of(start: &StartMark, [low, high]: [f64; 2]) -> Rgb {
    match start.end {
        Verdict::Within => color_scale((start.value - low) / (high - low)),
        end => stroke_of(end).color,
    }
}

fn count_of(starts: &[StartMark], end: Verdict) -> usize {
    starts.iter().filter(|start| start.end == end).count()
}

/// Panel of start postures, each with its verdict and its value as colour. `room` sets the size of the marks: their
/// radius is `room` divided by the square root of the number of starts, within limits.
fn starts_panel(
    starts: &[StartMark],
    limits: [f64; 2],
    room: f64,
    (goal_at, tolerance): ([f64; 3], [f64; 2]),
) -> Panel {
    // Marks shrink as the number of starts grows, so that thousands of marks still leave white space.
    let radius = (room / (starts.len() as f64).max(1.0).sqrt()).clamp(0.9, 3.5);
    let mut panel = Panel::new("x (m)", "y (m)").equal_axes();
    for end in Verdict::ALL {
        for start in starts.iter().filter(|start| start.end == end) {
            let [x, y, heading] = start.posture;
            let color = color_of(start, limits);
            let mark = Mark {
                color,
                ..mark_of(end, radius)
            };
            panel.mark(end.label(tolerance), [x, y], mark.heading(heading));
        }
    }
    let halo = Mark::new(Shape::Disc, 9.0, Rgb(255, 255, 255));
    panel.mark("", [goal_at[0], goal_at[1]], halo);
    goal(&mut panel, goal_at);
    panel
}

/// Maps of random starts to a goal with a tolerance (m, rad), side by side, each with its label, with a common colour
/// scale.
pub fn maps(
    title: &str,
    value_label: &str,
    maps: &[(String, Vec<StartMark>)],
    (goal_at, tolerance): ([f64; 3], [f64; 2]),
) -> Figure {
    let limits = color_limits(maps.iter().flat_map(|(_, starts)| starts));
    let columns = maps.len().clamp(1, 2);
    let panels = maps.iter().map(|(label, starts)| {
        let room = 75.0 / columns as f64;
        let within = count_of(starts, Verdict::Within);
        starts_panel(starts, limits, room, (goal_at, tolerance))
            .title(label.clone())
            .caption(format!(
                "{within} of {} {}",
                starts.len(),
                Verdict::Within.label(tolerance)
            ))
            .color_bar(value_label, limits)
    });
    let height = Height::Data {
        least: 240.0,
        greatest: 660.0,
    };
    Figure::new(title).rows_of(columns, height, &panels.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests;
