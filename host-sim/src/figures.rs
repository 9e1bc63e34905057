//! The figures of the experiments, as [`plot::Figure`](crate::plot::Figure)s.
//!
//! Postures are (x, y, heading) in metres and radians.

use crate::plant::PlantConfig;
use crate::plot::palette::{BLACK, BLUE, GREY, ORANGE, SERIES, SKY, VERMILION};
use crate::plot::{
    Dash, Figure, Height, Legend, Mark, Panel, Rgb, Shape, Stroke, color_scale, extent,
};

/// Outline of the robot seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Half the distance between the wheels of an axle, m.
    pub half_track_m: f64,
    /// Radius of a wheel, m.
    pub wheel_radius_m: f64,
    /// Width of a wheel, m.
    pub wheel_width_m: f64,
}

impl Body {
    /// The robot of a plant.
    pub fn of(plant: &PlantConfig) -> Self {
        Self {
            half_track_m: plant.half_track_m[0],
            wheel_radius_m: plant.wheel_radius_m[0][0],
            wheel_width_m: 0.03,
        }
    }
}

/// The robot at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// Posture of the front axle.
    pub front: [f64; 3],
    /// Posture of the rear axle.
    pub rear: [f64; 3],
    /// Points of the bent frame from the rear axle to the front axle; empty draws a smooth curve
    /// that leaves both axles at right angles.
    pub frame: Vec<[f64; 2]>,
    /// A few words beside the robot, such as its time.
    pub label: String,
}

/// Paths of many trials of one configuration, and one of them in full.
#[derive(Clone, Debug, PartialEq)]
pub struct PathsPanel {
    /// What the trials have in common.
    pub title: String,
    /// Path of O in each of the other trials, m.
    pub others: Vec<Vec<[f64; 2]>>,
    /// Path of O in the trial that is shown in full, m.
    pub middle: Vec<[f64; 2]>,
    /// Paths of the wheels in that trial, m.
    pub wheels: Vec<Vec<[f64; 2]>>,
    /// The robot at some instants of that trial.
    pub snapshots: Vec<Snapshot>,
    /// Posture that O is to reach.
    pub goal: [f64; 3],
    /// True final posture of O in every trial.
    pub ends: Vec<[f64; 3]>,
}

const OTHER: Stroke = Stroke::solid(SKY, 0.9);
const MIDDLE: Stroke = Stroke::solid(BLACK, 2.0);
const WHEEL: Stroke = Stroke {
    color: Rgb(60, 60, 60),
    width: 1.1,
    dash: Dash::Dashed,
};
const FRAME: Stroke = Stroke::solid(ORANGE, 3.0);
const AXLE: Stroke = Stroke::solid(GREY, 2.5);
const TYRE: Rgb = Rgb(60, 60, 60);
const GOAL: Mark = Mark {
    shape: Shape::Ring,
    radius: 6.0,
    color: VERMILION,
};
const REFERENCE: Stroke = Stroke::dashed(VERMILION, 2.0);
const DRIVEN: Stroke = Stroke::solid(BLUE, 2.0);
const ESTIMATED: Stroke = Stroke::dashed(BLACK, 1.4);

/// Robot paths during posture regulation (paper figure 7): one panel for each configuration on
/// the same scale and, below, where the trials ended.
pub fn paths(title: &str, body: &Body, panels: &[PathsPanel]) -> Figure {
    let mut figure = Figure::new(title)
        .legend(Legend::line("middle point O", MIDDLE))
        .legend(Legend::line("wheels", WHEEL))
        .legend(Legend::line("O, other trials", OTHER))
        .legend(Legend::line("frame", FRAME))
        .legend(Legend::mark("goal", GOAL));
    let mut maps: Vec<Panel> = panels.iter().map(|panel| path_map(body, panel)).collect();
    let limits = shared_limits(&maps, 0.07);
    maps = maps
        .into_iter()
        .map(|map| map.x_limits(limits[0]).y_limits(limits[1]))
        .collect();
    let height = Height::Data {
        least: 200.0,
        greatest: 520.0,
    };
    figure = figure.row(height, maps);
    if panels.iter().any(|panel| !panel.ends.is_empty()) {
        let ends: Vec<Panel> = panels.iter().map(end_map).collect();
        let [x, y] = shared_limits(&ends, 0.0);
        // Square and centred on the goal.
        let far = x
            .into_iter()
            .chain(y)
            .fold(1.0, |far: f64, v| far.max(1.12 * v.abs()));
        let ends = ends
            .into_iter()
            .map(|panel| panel.x_limits([-far, far]).y_limits([-far, far]));
        figure = figure.row(Height::Fixed(250.0), ends);
    }
    figure
}

fn path_map(body: &Body, data: &PathsPanel) -> Panel {
    let mut panel = Panel::new("x (m)", "y (m)")
        .title(data.title.clone())
        .equal_axes();
    for path in &data.others {
        panel.line(path.iter().copied(), OTHER);
    }
    for path in &data.wheels {
        panel.line(path.iter().copied(), WHEEL);
    }
    for snapshot in &data.snapshots {
        robot(&mut panel, body, snapshot);
    }
    panel.line(data.middle.iter().copied(), MIDDLE);
    goal(&mut panel, data.goal);
    panel
}

/// Final postures in the frame of the goal, in centimetres.
fn end_map(data: &PathsPanel) -> Panel {
    let mut panel = Panel::new("along the goal's heading (cm)", "across (cm)")
        .title(format!("final O and heading, {} trials", data.ends.len()))
        .equal_axes();
    let (sin, cos) = data.goal[2].sin_cos();
    for end in &data.ends {
        let (dx, dy) = (end[0] - data.goal[0], end[1] - data.goal[1]);
        let at = [100.0 * (cos * dx + sin * dy), 100.0 * (cos * dy - sin * dx)];
        panel.needle(
            at,
            end[2] - data.goal[2],
            13.0,
            Stroke::solid(BLUE.lighter(0.45), 1.0),
        );
        panel.mark(
            at,
            Mark {
                shape: Shape::Disc,
                radius: 2.6,
                color: BLUE,
            },
        );
    }
    panel.mark([0.0, 0.0], GOAL);
    panel.mark(
        [0.0, 0.0],
        Mark {
            shape: Shape::Plus,
            ..GOAL
        },
    );
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
    panel.mark([x, y], GOAL);
    panel.needle([x, y], heading, 20.0, Stroke::solid(VERMILION, 2.0));
}

/// Wheels, axles, frame and an arrow at the front.
fn robot(panel: &mut Panel, body: &Body, snapshot: &Snapshot) {
    let Snapshot {
        front,
        rear,
        frame,
        label,
    } = snapshot;
    let mut lowest = [f64::INFINITY; 2];
    for &axle in [rear, front] {
        let ends = [body.half_track_m, -body.half_track_m].map(|y| ahead(axle, [0.0, y]));
        panel.line(ends, AXLE);
        for side in [1.0, -1.0] {
            let (r, w) = (body.wheel_radius_m, 0.5 * body.wheel_width_m);
            let corners = [[r, w], [-r, w], [-r, -w], [r, -w]]
                .map(|[x, y]| ahead(axle, [x, y + side * body.half_track_m]));
            panel.area(corners, TYRE);
            for corner in corners {
                if corner[1] < lowest[1] {
                    lowest = corner;
                }
            }
        }
    }
    if frame.is_empty() {
        panel.line(smooth_frame(*rear, *front), FRAME);
    } else {
        panel.line(frame.iter().copied(), FRAME);
    }
    let tip = 0.9 * body.wheel_radius_m;
    let arrow = [[tip, 0.0], [0.0, 0.6 * tip], [0.0, -0.6 * tip]];
    panel.area(arrow.map(|point| ahead(*front, point)), ORANGE);
    if !label.is_empty() && lowest[1].is_finite() {
        // Anchored below the wheel, so that the panel's limits leave room for it.
        let below = [lowest[0], lowest[1] - body.wheel_radius_m];
        panel.note(below, [-16.0, -6.0], label.clone(), TYRE);
    }
}

/// A point given in the frame of a posture.
fn ahead([x, y, heading]: [f64; 3], [forward, left]: [f64; 2]) -> [f64; 2] {
    let (sin, cos) = heading.sin_cos();
    [
        x + cos * forward - sin * left,
        y + sin * forward + cos * left,
    ]
}

/// Cubic curve that leaves both axles at right angles.
fn smooth_frame(rear: [f64; 3], front: [f64; 3]) -> Vec<[f64; 2]> {
    let chord = (front[0] - rear[0]).hypot(front[1] - rear[1]);
    let one = ahead(rear, [chord / 3.0, 0.0]);
    let two = ahead(front, [-chord / 3.0, 0.0]);
    (0..=24)
        .map(|k| {
            let t = f64::from(k) / 24.0;
            let s = 1.0 - t;
            let weights = [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t];
            [0, 1].map(|i| {
                weights[0] * rear[i]
                    + weights[1] * one[i]
                    + weights[2] * two[i]
                    + weights[3] * front[i]
            })
        })
        .collect()
}

/// Posture errors of one trial over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorTrace {
    /// Time, s.
    pub t_s: Vec<f64>,
    /// Distance of O from the goal, m.
    pub e_m: Vec<f64>,
    /// Line of sight minus the goal's heading, rad.
    pub theta_rad: Vec<f64>,
    /// Line of sight minus the robot's heading, rad.
    pub alpha_rad: Vec<f64>,
}

/// Posture errors of one configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorsColumn {
    /// What the trial shows.
    pub title: String,
    /// As the robot's own estimate has it.
    pub estimate: ErrorTrace,
    /// As it is.
    pub truth: ErrorTrace,
}

/// One of the three errors: label, caption unit, plotted values and factor of the caption.
struct ErrorAxis {
    label: &'static str,
    right: Option<&'static str>,
    unit: &'static str,
    per_unit: f64,
    pick: fn(&ErrorTrace) -> Vec<f64>,
}

const ERROR_AXES: [ErrorAxis; 3] = [
    ErrorAxis {
        label: "e (m)",
        right: None,
        unit: " cm",
        per_unit: 100.0,
        pick: |trace| trace.e_m.clone(),
    },
    ErrorAxis {
        label: "θ (°)",
        right: Some("θ (rad)"),
        unit: "°",
        per_unit: 1.0,
        pick: |trace| trace.theta_rad.iter().map(|v| v.to_degrees()).collect(),
    },
    ErrorAxis {
        label: "α (°)",
        right: Some("α (rad)"),
        unit: "°",
        per_unit: 1.0,
        pick: |trace| trace.alpha_rad.iter().map(|v| v.to_degrees()).collect(),
    },
];

/// Posture errors over time (paper figure 8): e, θ and α as estimated and as they are, with the
/// final values in words.
pub fn errors(title: &str, columns: &[ErrorsColumn]) -> Figure {
    let (estimate, truth) = (Stroke::dashed(VERMILION, 1.8), Stroke::solid(BLUE, 1.8));
    let figure = Figure::new(title)
        .legend(Legend::line("true", truth))
        .legend(Legend::line("as the robot estimates", estimate));
    ERROR_AXES
        .iter()
        .enumerate()
        .fold(figure, |figure, (row, axis)| {
            let panels: Vec<Panel> = columns
                .iter()
                .map(|column| {
                    let mut panel = Panel::new("t (s)", axis.label);
                    if row == 0 {
                        panel = panel.title(column.title.clone());
                    }
                    if row + 1 < ERROR_AXES.len() {
                        panel = panel.hide_x();
                    }
                    // Two columns leave no room for a second scale.
                    if let (Some(right), [_]) = (axis.right, columns) {
                        panel = panel.right_axis(right, 1f64.to_radians());
                    }
                    let mut last = [None; 2];
                    let traces = [(&column.truth, truth), (&column.estimate, estimate)];
                    for ((trace, stroke), last) in traces.into_iter().zip(&mut last) {
                        let values = (axis.pick)(trace);
                        *last = values.last().map(|value| value * axis.per_unit);
                        let points = trace.t_s.iter().zip(values).map(|(&t, value)| [t, value]);
                        panel.line(with_gaps(points, 180.0), stroke);
                    }
                    if let [Some(truth), Some(estimate)] = last {
                        let unit = axis.unit;
                        let text = format!("final {truth:.1}{unit}, estimate {estimate:.1}{unit}");
                        panel = panel.caption(text.replace('-', "−"));
                    }
                    panel
                })
                .collect();
            let [time, values] = shared_limits(&panels, 0.0);
            let pad = 0.06 * (values[1] - values[0]);
            let limits = [values[0] - pad, values[1] + pad];
            let panels = panels
                .into_iter()
                .map(|panel| panel.x_limits(time).y_limits(limits));
            figure.row(Height::Fixed(165.0), panels)
        })
}

/// Interrupts a line where it jumps by more than `gap`, as an angle does that wraps around.
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

/// One run along a path or after a moving reference.
#[derive(Clone, Debug, PartialEq)]
pub struct FollowRun {
    /// Reference path, m.
    pub reference: Vec<[f64; 2]>,
    /// Path of O as driven, m.
    pub driven: Vec<[f64; 2]>,
    /// The robot at some instants.
    pub snapshots: Vec<Snapshot>,
    /// What the distance is, with its unit mm: the label of its axis.
    pub distance_label: &'static str,
    /// Errors of the true position of O.
    pub truth: FollowErrors,
    /// Errors of O as the robot estimates it.
    pub estimate: FollowErrors,
}

/// Errors of a run over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FollowErrors {
    /// Time of each error, s.
    pub t_s: Vec<f64>,
    /// Distance from the reference, m (signed where it is a distance across the path).
    pub distance_m: Vec<f64>,
    /// Heading minus the reference's heading, rad.
    pub heading_rad: Vec<f64>,
}

/// Reference and driven path, and the errors over time.
pub fn follow(title: &str, body: &Body, run: &FollowRun) -> Figure {
    let mut map = Panel::new("x (m)", "y (m)").equal_axes();
    for snapshot in &run.snapshots {
        robot(&mut map, body, snapshot);
    }
    map.line(run.driven.iter().copied(), DRIVEN);
    map.line(run.reference.iter().copied(), REFERENCE);
    let mut distance = Panel::new("t (s)", run.distance_label).hide_x();
    let mut heading = Panel::new("t (s)", "heading error (°)");
    for (errors, stroke) in [(&run.truth, DRIVEN), (&run.estimate, ESTIMATED)] {
        let over_time = |values: &[f64], factor: f64| -> Vec<[f64; 2]> {
            let pairs = errors.t_s.iter().zip(values);
            pairs.map(|(&t, &value)| [t, factor * value]).collect()
        };
        distance.line(over_time(&errors.distance_m, 1e3), stroke);
        let turns = over_time(&errors.heading_rad, 1f64.to_degrees());
        heading.line(with_gaps(turns.into_iter(), 180.0), stroke);
    }
    Figure::new(title)
        .legend(Legend::line("reference", REFERENCE))
        .legend(Legend::line("true position of O", DRIVEN))
        .legend(Legend::line("as the robot estimates", ESTIMATED))
        .row(
            Height::Data {
                least: 180.0,
                greatest: 560.0,
            },
            [map],
        )
        .row(Height::Fixed(140.0), [distance])
        .row(Height::Fixed(140.0), [heading])
}

/// One start of a sweep.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SweepStart {
    /// Start posture of O.
    pub posture: [f64; 3],
    /// What is shown by colour where the trial succeeded.
    pub value: f64,
    /// Whether the trial succeeded.
    pub success: bool,
    /// Path of O, m; empty where it is not to be shown.
    pub path: Vec<[f64; 2]>,
}

const FAILED: Mark = Mark {
    shape: Shape::Cross,
    radius: 6.5,
    color: VERMILION,
};

/// Limits of the colours of starts that succeeded: up to the 98th percentile.
fn color_limits<'a>(starts: impl Iterator<Item = &'a SweepStart>) -> [f64; 2] {
    let values: Vec<f64> = starts
        .filter(|start| start.success)
        .map(|start| start.value)
        .filter(|value| value.is_finite())
        .collect();
    let [low, high] = if values.is_empty() {
        [0.0, 1.0]
    } else {
        [0.0, 0.98].map(|share| crate::statistics::percentile(&values, share))
    };
    [low, if high > low { high } else { low + 1.0 }]
}

fn reached(radius: f64, color: Rgb) -> Mark {
    Mark {
        shape: Shape::Disc,
        radius,
        color,
    }
}

/// Starts: place, heading, success, and value by colour; `room` is for all marks.
fn starts_panel(starts: &[SweepStart], limits: [f64; 2], room: f64, goal_at: [f64; 3]) -> Panel {
    // Marks shrink so that thousands of them leave some white.
    let size = room / (starts.len() as f64).max(1.0).sqrt();
    let radius = size.clamp(0.9, 3.5);
    let cross = FAILED.radius * (0.4 * size).clamp(0.4, 1.0);
    let mut panel = Panel::new("x (m)", "y (m)").equal_axes();
    for start in starts.iter().filter(|start| start.success) {
        let [x, y, heading] = start.posture;
        let color = color_scale((start.value - limits[0]) / (limits[1] - limits[0]));
        let stroke = Stroke::solid(color, 0.45 * radius);
        panel.needle([x, y], heading, 3.2 * radius, stroke);
        panel.mark([x, y], reached(radius, color));
    }
    for start in starts.iter().filter(|start| !start.success) {
        let [x, y, heading] = start.posture;
        panel.needle([x, y], heading, 2.2 * cross, Stroke::solid(VERMILION, 1.5));
        let mark = Mark {
            radius: cross,
            ..FAILED
        };
        panel.mark([x, y], mark);
    }
    let halo = reached(9.0, Rgb(255, 255, 255));
    panel.mark([goal_at[0], goal_at[1]], halo);
    goal(&mut panel, goal_at);
    panel
}

/// Adds panels to a figure, so many a row.
pub fn in_rows(
    mut figure: Figure,
    height: Height,
    panels: impl IntoIterator<Item = Panel>,
    columns: usize,
) -> Figure {
    let panels: Vec<Panel> = panels.into_iter().collect();
    for row in panels.chunks(columns.max(1)) {
        figure = figure.row(height, row.to_vec());
    }
    figure
}

fn succeeded(starts: &[SweepStart]) -> usize {
    starts.iter().filter(|start| start.success).count()
}

/// Maps of random starts beside each other, each with its label, on one scale of colours.
pub fn maps(
    title: &str,
    value_label: &str,
    maps: &[(String, Vec<SweepStart>)],
    goal_at: [f64; 3],
) -> Figure {
    let limits = color_limits(maps.iter().flat_map(|(_, starts)| starts));
    let columns = maps.len().clamp(1, 2);
    let panels = maps.iter().map(|(label, starts)| {
        let count = format!("{} of {}", succeeded(starts), starts.len());
        let title = match label.as_str() {
            "" => format!("{count} reach the goal"),
            // Half a page has no room for more words.
            label => format!("{label}: {count}"),
        };
        starts_panel(starts, limits, 75.0 / columns as f64, goal_at)
            .title(title)
            .color_bar(value_label, limits)
    });
    let figure = Figure::new(title)
        .legend(Legend::mark(
            "reached the goal",
            reached(3.5, color_scale(0.5)),
        ))
        .legend(Legend::mark("failed", FAILED))
        .legend(Legend::mark("goal", GOAL));
    let height = Height::Data {
        least: 240.0,
        greatest: 660.0,
    };
    in_rows(figure, height, panels, columns)
}

/// Map of random starts: place, heading, success, and `value_label` by colour, beside the paths of
/// some. The scale ends at the 98th percentile.
pub fn sweep(title: &str, value_label: &str, starts: &[SweepStart], goal_at: [f64; 3]) -> Figure {
    let limits = color_limits(starts.iter());
    let scale =
        |start: &SweepStart| color_scale((start.value - limits[0]) / (limits[1] - limits[0]));
    let mut paths = Panel::new("x (m)", "y (m)").equal_axes();
    let shown: Vec<&SweepStart> = starts.iter().filter(|s| !s.path.is_empty()).collect();
    for start in shown.iter().filter(|start| start.success) {
        paths.line(start.path.iter().copied(), Stroke::solid(scale(start), 1.3));
    }
    for start in shown.iter().filter(|start| !start.success) {
        paths.line(start.path.iter().copied(), Stroke::solid(VERMILION, 1.8));
    }
    for start in &shown {
        let [x, y, heading] = start.posture;
        let color = if start.success {
            scale(start)
        } else {
            VERMILION
        };
        paths.needle([x, y], heading, 10.0, Stroke::solid(color, 1.6));
        paths.mark([x, y], reached(3.2, color));
    }
    goal(&mut paths, goal_at);
    let room = if shown.is_empty() { 75.0 } else { 45.0 };
    let panel = starts_panel(starts, limits, room, goal_at)
        .title("starts")
        .color_bar(value_label, limits);
    let count = succeeded(starts);
    let panels = if shown.is_empty() {
        vec![panel]
    } else {
        let failures = shown.iter().filter(|start| !start.success).count();
        let title = match failures {
            0 => format!("paths of {} starts", shown.len()),
            _ => format!("paths of {} starts, failed ones among them", shown.len()),
        };
        vec![paths.title(title), panel]
    };
    Figure::new(title)
        .legend(Legend::mark(
            format!("reached the goal: {count}"),
            reached(3.5, color_scale(0.5)),
        ))
        .legend(Legend::mark(
            format!("failed: {}", starts.len() - count),
            FAILED,
        ))
        .legend(Legend::mark("goal", GOAL))
        .row(
            Height::Data {
                least: 300.0,
                greatest: 660.0,
            },
            panels,
        )
}

/// One signal over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Time (s) and value.
    pub points: Vec<[f64; 2]>,
}

/// Signals that share an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct SeriesPanel {
    /// Label of the axis, unit included.
    pub label: String,
    /// The signals.
    pub series: Vec<Series>,
}

/// Signals over one time axis, a panel for each unit.
pub fn time_series(title: &str, panels: &[SeriesPanel]) -> Figure {
    let mut drawn: Vec<Panel> = Vec::new();
    for (index, data) in panels.iter().enumerate() {
        let mut panel = Panel::new("t (s)", data.label.clone());
        let mut strokes = Vec::new();
        for (number, series) in data.series.iter().enumerate() {
            let color = SERIES[number % SERIES.len()];
            let stroke = if number < SERIES.len() {
                Stroke::solid(color, 1.5)
            } else {
                Stroke::dashed(color, 1.5)
            };
            strokes.push(stroke);
            if !series.name.is_empty() {
                panel = panel.legend(Legend::line(series.name.clone(), stroke));
            }
        }
        // The first series, often the reference, comes to lie on top.
        for (series, stroke) in data.series.iter().zip(strokes).rev() {
            panel.line(series.points.iter().copied(), stroke);
        }
        drawn.push(if index + 1 < panels.len() {
            panel.hide_x()
        } else {
            panel
        });
    }
    let [time, _] = shared_limits(&drawn, 0.0);
    drawn.into_iter().fold(Figure::new(title), |figure, panel| {
        figure.row(Height::Fixed(150.0), [panel.x_limits(time)])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::tests::{check_svg, check_texts, png_size};

    const BODY: Body = Body {
        half_track_m: 0.162,
        wheel_radius_m: 0.073,
        wheel_width_m: 0.03,
    };

    fn panel(title: &str, spread: f64) -> PathsPanel {
        let path = |k: usize| -> Vec<[f64; 2]> {
            let miss = spread * (k as f64).sin();
            (0..=100)
                .map(|i| f64::from(i) / 100.0)
                .map(|s| [1.342 * (s - 1.0), 1.342 * (s * s - 1.0) + miss * s])
                .collect()
        };
        PathsPanel {
            title: title.into(),
            others: (1..20).map(path).collect(),
            middle: path(0),
            wheels: vec![path(0); 4],
            snapshots: vec![Snapshot {
                front: [-1.162, -1.342, 0.1],
                rear: [-1.522, -1.342, -0.1],
                frame: Vec::new(),
                label: "0 s".into(),
            }],
            goal: [0.0; 3],
            ends: (0..20)
                .map(|k| [0.0, spread * f64::from(k).sin(), 0.02])
                .collect(),
        }
    }

    fn trace(offset: f64) -> ErrorTrace {
        let t_s: Vec<f64> = (0..500).map(|k| f64::from(k) * 0.02).collect();
        ErrorTrace {
            e_m: t_s.iter().map(|t| (-t).exp() + offset).collect(),
            theta_rad: t_s
                .iter()
                .map(|t| (3.0 + t).sin().atan2((3.0 + t).cos()))
                .collect(),
            alpha_rad: t_s.iter().map(|t| 2.0 * (-t).exp() - offset).collect(),
            t_s,
        }
    }

    fn column(title: &str) -> ErrorsColumn {
        ErrorsColumn {
            title: title.into(),
            estimate: trace(0.015),
            truth: trace(0.095),
        }
    }

    fn starts(count: u32) -> Vec<SweepStart> {
        (0..count)
            .map(f64::from)
            .map(|k| SweepStart {
                posture: [2.0 * (1.3 * k).sin(), 2.0 * (1.7 * k).cos(), k],
                value: 5.0 + (0.3 * k).sin(),
                success: k != 3.0,
                path: if k < 9.0 {
                    vec![[2.0 * (1.3 * k).sin(), 2.0 * (1.7 * k).cos()], [0.0; 2]]
                } else {
                    Vec::new()
                },
            })
            .collect()
    }

    #[test]
    fn every_figure_is_whole_and_on_the_page() {
        let run = FollowRun {
            reference: vec![[0.0, 0.0], [2.0, 0.0]],
            driven: vec![[0.0, 0.1], [1.0, 0.01], [2.0, 0.0]],
            snapshots: panel("", 0.0).snapshots,
            distance_label: "distance to the left (mm)",
            truth: FollowErrors {
                t_s: vec![0.0, 5.0, 10.0],
                distance_m: vec![0.1, 0.01, 0.0],
                heading_rad: vec![0.0, -0.1, 0.0],
            },
            estimate: FollowErrors::default(),
        };
        let signals = |count: u32| SeriesPanel {
            label: "strain (µε)".into(),
            series: (0..count)
                .map(|k| Series {
                    name: format!("gauge {k}"),
                    points: vec![[0.0, 0.0], [1.0, 1e4 * f64::from(k)]],
                })
                .collect(),
        };
        let (with, without) = (panel("with RPS", 0.01), panel("without RPS", 0.2));
        for figure in [
            paths("Robot paths", &BODY, &[with.clone(), without]),
            paths("Robot paths", &BODY, &[with]),
            errors(
                "Posture errors",
                &[column("with RPS"), column("without RPS")],
            ),
            errors("Posture errors", &[column("with RPS")]),
            follow("Path following", &BODY, &run),
            sweep("Sweep", "time (s)", &starts(200), [0.0; 3]),
            time_series("Signals", &[signals(1), signals(9)]),
        ] {
            let svg = figure.svg();
            check_svg(&svg);
            check_texts(&svg);
            let [width, height] = png_size(&figure.png());
            assert!(width == 1600 && (600..3000).contains(&height), "{height}");
        }
    }

    #[test]
    fn empty_results_still_give_figures() {
        let empty = PathsPanel {
            others: Vec::new(),
            middle: Vec::new(),
            wheels: Vec::new(),
            snapshots: Vec::new(),
            ends: Vec::new(),
            ..panel("none", 0.0)
        };
        let no_errors = ErrorsColumn {
            title: "none".into(),
            estimate: ErrorTrace::default(),
            truth: ErrorTrace::default(),
        };
        for figure in [
            paths("", &BODY, &[empty]),
            errors("", &[no_errors]),
            sweep("", "", &[], [0.0; 3]),
            time_series("", &[]),
        ] {
            check_svg(&figure.svg());
        }
    }

    #[test]
    fn final_errors_stand_beside_their_curves_in_words() {
        let svg = errors("", &[column("with RPS")]).svg();
        // e^-9.98 is below the last digit.
        assert!(svg.contains("final 9.5 cm, estimate 1.5 cm"));
        assert!(svg.contains("final −5.4°, estimate −0.9°"));
    }

    #[test]
    fn an_angle_that_wraps_is_not_joined_across_the_panel() {
        let points = [[0.0, 170.0], [1.0, -175.0], [2.0, -160.0]];
        let line = with_gaps(points.into_iter(), 180.0);
        assert_eq!(line.len(), 4);
        assert!(line[1][0].is_nan() && line[2] == points[1]);
    }

    #[test]
    fn the_drawn_frame_leaves_both_axles_at_right_angles() {
        let (rear, front) = ([0.2, -0.1, -0.4], [0.5, 0.05, 0.9]);
        let curve = smooth_frame(rear, front);
        for (from, to, heading) in [
            (curve[0], curve[1], rear[2]),
            (curve[23], curve[24], front[2]),
        ] {
            let direction = (to[1] - from[1]).atan2(to[0] - from[0]);
            assert!((direction - heading).abs() < 0.06, "{direction} {heading}");
        }
        assert!((curve[24][0] - front[0]).abs() < 1e-12 && (curve[0][1] - rear[1]).abs() < 1e-12);
    }

    #[test]
    fn ends_are_shown_in_the_frame_of_the_goal() {
        let data = PathsPanel {
            goal: [1.0, 1.0, std::f64::consts::FRAC_PI_2],
            // One centimetre ahead, two to the right.
            ends: vec![[1.02, 1.01, 1.0]],
            ..panel("", 0.0)
        };
        let [x, y] = end_map(&data).extent().unwrap();
        assert!(
            (x[1] - 1.0).abs() < 1e-9 && (y[0] + 2.0).abs() < 1e-9,
            "{x:?} {y:?}"
        );
    }
}
