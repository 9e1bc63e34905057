//! An animated picture of runs beside each other: SVG that a browser, or a page of Markdown, plays.
//!
//! Each panel shows the true robot, its estimate with the 95 % ellipse, the goal and its tolerance, or the path that the
//! robot follows. The picture repeats; a viewer that does not animate shows the end of the runs.

use crate::style::{BODY, ESTIMATE, FRAME, GOAL, INK, OTHERS, REFERENCE, Stroke};
use host_sim::run::final_error::wrap;
use host_sim::run::robot::Record;
use host_sim::world::body::Body;
use std::fmt::Write;

/// Width of a picture of goals, in units of the SVG.
const WIDTH: f64 = 800.0;
/// Width of the picture of a path, in units of the SVG: no less than its legend needs.
const PATH_WIDTH: f64 = 500.0;
/// Height of a picture, in units of the SVG.
const HEIGHT: f64 = 420.0;
/// Height of the titles above the panels.
const TITLE: f64 = 52.0;
/// Height of the legend below the panels.
const LEGEND: f64 = 26.0;
/// Margin around the paths, m.
const MARGIN_M: f64 = 0.32;
/// Simulated time between two drawn positions, s.
const STEP_S: f64 = 0.2;
/// Simulated seconds per second of the animation.
const SPEED: f64 = 2.0;
/// Time for which the picture shows the end of the runs, s.
const HOLD_S: f64 = 3.0;

/// Records, goal and result of a run, shown in one panel.
pub struct Run<'a> {
    /// Title of the panel: the run's configuration.
    pub title: String,
    /// Text about the result of the run, below the title.
    pub result: String,
    /// Records of all epochs.
    pub records: &'a [Record],
    /// Target of the run.
    pub target: Target,
}

/// Target that a panel shows.
pub enum Target {
    /// Goal posture, with its position tolerance, m.
    Goal([f64; 3], f64),
    /// Points of the path that the robot follows, m.
    Path(Vec<[f64; 2]>),
}

impl Target {
    /// Points that the picture has to show, m.
    fn points(&self) -> Vec<[f64; 2]> {
        match self {
            Self::Goal([x, y, _], _) => vec![[*x, *y]],
            Self::Path(points) => points.clone(),
        }
    }
}

/// Transformation from metres in the plane to units of the picture.
#[derive(Clone, Copy)]
struct Map {
    origin: [f64; 2],
    scale: f64,
    center: [f64; 2],
}

impl Map {
    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [x0, y0] = self.origin;
        let [u, v] = self.center;
        [u + self.scale * (x - x0), v - self.scale * (y - y0)]
    }

    fn points(&self, points: impl IntoIterator<Item = [f64; 2]>) -> String {
        let points = points.into_iter().map(|point| {
            let [u, v] = self.at(point);
            format!("{u:.1},{v:.1}")
        });
        points.collect::<Vec<_>>().join(" ")
    }
}

/// Draws the runs, one panel each; returns the text of an SVG file.
pub fn svg(body: &Body, runs: &[Run]) -> String {
    let path = runs.iter().any(|run| matches!(run.target, Target::Path(_)));
    let whole = if path { PATH_WIDTH } else { WIDTH };
    let size = format!("viewBox=\"0 0 {whole} {HEIGHT}\" font-family=\"sans-serif\"");
    let mut text = format!("<svg xmlns=\"http://www.w3.org/2000/svg\" {size}>\n");
    text += &format!("<rect width=\"{whole}\" height=\"{HEIGHT}\" fill=\"#ffffff\"/>\n");
    let steps = runs.iter().map(|run| sampled(run.records).len()).max();
    let clock = Clock::new(steps.unwrap_or(0));
    let width = whole / runs.len().max(1) as f64;
    let room = [width - 8.0, HEIGHT - TITLE - LEGEND];
    let (origin, scale) = limits(runs, room);
    for (n, run) in runs.iter().enumerate() {
        let left = width * n as f64;
        let map = Map {
            origin,
            scale,
            center: [left + 0.5 * width, TITLE + 0.5 * room[1]],
        };
        panel(
            &mut text,
            &Panel {
                body,
                run,
                map,
                clock,
            },
            [left, width],
        );
    }
    text + &legend(path) + "</svg>\n"
}

/// SVG text of the legend below the panels, of paths or of goals.
fn legend(path: bool) -> String {
    let target = match path {
        true => "path",
        false => "goal and its position tolerance",
    };
    let words = format!(
        "dashed: robot's estimate with its 95 % ellipse; green: {target}; {SPEED}× real time"
    );
    let (y, ink) = (HEIGHT - 9.0, INK.css());
    format!("<text x=\"12\" y=\"{y}\" font-size=\"12\" fill=\"{ink}\">{words}</text>\n")
}

/// Centre of the region that all runs need, m, and the scale at which the region fits, units per m.
fn limits(runs: &[Run], [width, height]: [f64; 2]) -> ([f64; 2], f64) {
    let points = runs.iter().flat_map(|run| {
        let path = run.records.iter().map(|record| record.midpoint);
        // The axles of a robot with one frame are within the margin.
        let chains = run.records.iter().filter(|record| record.frames.len() > 1);
        let axles = chains.flat_map(|record| record.axles.iter().map(|axle| axle.posture));
        let target = run.target.points();
        path.chain(axles).map(|[x, y, _]| [x, y]).chain(target)
    });
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for point in points {
        for axis in 0..2 {
            low[axis] = low[axis].min(point[axis] - MARGIN_M);
            high[axis] = high[axis].max(point[axis] + MARGIN_M);
        }
    }
    let scale = (width / (high[0] - low[0])).min(height / (high[1] - low[1]));
    ([0, 1].map(|axis| 0.5 * (low[axis] + high[axis])), scale)
}

/// Records that are drawn: one record per [`STEP_S`], and the last record of the run.
fn sampled(records: &[Record]) -> Vec<&Record> {
    let mut next = f64::NEG_INFINITY;
    let due = |record: &&Record| {
        let due = record.time_s >= next - 1e-9;
        if due {
            next = record.time_s + STEP_S;
        }
        due
    };
    let mut kept: Vec<&Record> = records.iter().filter(due).collect();
    kept.extend(records.last());
    kept
}

/// Number of animated values, from which the duration follows.
#[derive(Clone, Copy)]
struct Clock {
    /// Number of values of each animated attribute.
    values: usize,
}

impl Clock {
    fn new(steps: usize) -> Self {
        let hold = (HOLD_S * SPEED / STEP_S) as usize;
        Self {
            values: steps + hold,
        }
    }

    /// Attributes of an animation with a value for each step; the last value is held until the picture repeats.
    fn animate(&self, values: &[String]) -> String {
        let held = values.last().map_or("", String::as_str);
        let values = values.iter().map(String::as_str);
        let values: Vec<&str> = values
            .chain(std::iter::repeat(held))
            .take(self.values)
            .collect();
        let duration = STEP_S * self.values as f64 / SPEED;
        format!(
            "dur=\"{duration:.1}s\" repeatCount=\"indefinite\" values=\"{}\"",
            values.join(";")
        )
    }
}

/// Run, scale and time base with which a panel is drawn.
struct Panel<'a> {
    body: &'a Body,
    run: &'a Run<'a>,
    map: Map,
    clock: Clock,
}

fn panel(text: &mut String, panel: &Panel, [left, width]: [f64; 2]) {
    let Panel { run, map, .. } = panel;
    let records = sampled(run.records);
    let ink = INK.css();
    let height = HEIGHT - TITLE - LEGEND;
    // Writing to a string does not fail.
    let _ = writeln!(
        text,
        "<text x=\"{0:.0}\" y=\"20\" font-size=\"15\" font-weight=\"bold\" fill=\"{ink}\">{1}</text>\n\
         <text x=\"{0:.0}\" y=\"40\" font-size=\"14\" fill=\"{ink}\">{2}</text>\n\
         <svg x=\"{3:.0}\" y=\"{TITLE}\" width=\"{4:.0}\" height=\"{5:.0}\" viewBox=\"{3:.0} {TITLE} {4:.0} {5:.0}\">",
        left + 12.0,
        run.title,
        run.result,
        left + 4.0,
        width - 8.0,
        height,
    );
    let path = map.points(
        run.records
            .iter()
            .step_by(10)
            .map(|r| [r.midpoint[0], r.midpoint[1]]),
    );
    match &run.target {
        Target::Goal(goal, tolerance_m) => {
            line(text, &path, OTHERS.stroke);
            target(text, map, *goal, *tolerance_m);
        }
        Target::Path(points) => {
            line(text, &map.points(points.iter().copied()), REFERENCE.stroke);
            // The midpoint of three and more axles cuts the curves that the axles drive on.
            if run.records.iter().all(|record| record.axles.len() == 2) {
                line(text, &path, OTHERS.stroke);
            }
        }
    }
    estimate(text, panel, &records);
    let axles = records.first().map_or(0, |record| record.axles.len());
    for axle in 0..axles {
        axle_of(text, panel, &records, axle);
    }
    let frames = records.first().map_or(0, |record| record.frames.len());
    for frame in 0..frames {
        let shape = |record: &&Record| {
            let points = record.frames[frame].points;
            map.points(points.map(|point| point.map(f64::from)))
        };
        let shapes: Vec<String> = records.iter().map(shape).collect();
        let _ = writeln!(
            text,
            "<polyline fill=\"none\" {} points=\"{}\"><animate attributeName=\"points\" {}/></polyline>",
            stroke(FRAME.stroke),
            shapes.last().map_or("", String::as_str),
            panel.clock.animate(&shapes),
        );
    }
    text.push_str("</svg>\n");
}

/// Draws a goal posture: the circle of its tolerance, and an arrow along its heading.
fn target(text: &mut String, map: &Map, [x, y, heading]: [f64; 3], tolerance_m: f64) {
    let [u, v] = map.at([x, y]);
    let radius = tolerance_m * map.scale;
    let circle = format!("<circle cx=\"{u:.1}\" cy=\"{v:.1}\" r=\"{radius:.1}\"");
    let _ = writeln!(
        text,
        "{circle} fill=\"none\" {}/>",
        stroke(REFERENCE.stroke)
    );
    let (sin, cos) = libm::sincos(heading);
    let arrow = map.points([[x, y], [x + 0.16 * cos, y + 0.16 * sin]]);
    line(text, &arrow, GOAL.stroke);
}

/// Draws an axle with its wheels, moving along the records.
fn axle_of(text: &mut String, panel: &Panel, records: &[&Record], axle: usize) {
    let scale = panel.map.scale;
    let [d, r] = [panel.body.half_track_m, panel.body.wheel_radius_m].map(|it| it * scale);
    let w = (panel.body.wheel_width_m * scale).max(3.0);
    let body = BODY.stroke.color.css();
    let mut shape = format!(
        "<line x1=\"0\" x2=\"0\" y1=\"{:.1}\" y2=\"{d:.1}\" {}/>",
        -d,
        stroke(BODY.stroke)
    );
    for side in [d, -d] {
        let _ = write!(
            shape,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{w:.1}\" fill=\"{body}\"/>",
            -r,
            side - 0.5 * w,
            2.0 * r
        );
    }
    let postures: Vec<[f64; 3]> = records
        .iter()
        .map(|record| record.axles[axle].posture)
        .collect();
    moving(text, panel, &postures, &shape);
}

/// Draws the moving estimate: its 95 % ellipse, and a cross with the heading.
fn estimate(text: &mut String, panel: &Panel, records: &[&Record]) {
    let postures = records.iter().map(|record| {
        let p = record.lead.fused.robot.posture;
        let truth = record.midpoint[2];
        let [x, y, phi] = [p.x, p.y, p.phi].map(f64::from);
        [x, y, truth + wrap(phi - truth)]
    });
    let postures: Vec<[f64; 3]> = postures.collect();
    let style = stroke(ESTIMATE.stroke);
    let cross = format!(
        "<line x1=\"-6\" x2=\"14\" y1=\"0\" y2=\"0\" {style}/><line x1=\"0\" x2=\"0\" y1=\"-6\" y2=\"6\" {style}/>"
    );
    moving(text, panel, &postures, &cross);
    // The covariance is in global coordinates, so the ellipse turns by the angle of its first axis, not by the heading.
    let ellipses: Vec<([f64; 2], f64)> = records
        .iter()
        .map(|r| ellipse(r, panel.map.scale))
        .collect();
    let turned: Vec<[f64; 3]> = postures
        .iter()
        .zip(&ellipses)
        .map(|([x, y, _], (_, angle))| [*x, *y, *angle])
        .collect();
    let axis = |k: usize| -> Vec<String> {
        ellipses
            .iter()
            .map(|(axes, _)| format!("{:.1}", axes[k]))
            .collect()
    };
    let [rx, ry] = [axis(0), axis(1)];
    let last = |values: &[String]| values.last().cloned().unwrap_or_default();
    let shape = format!(
        "<ellipse rx=\"{}\" ry=\"{}\" fill=\"{}\" fill-opacity=\"0.08\" {style}>\
         <animate attributeName=\"rx\" {}/><animate attributeName=\"ry\" {}/></ellipse>",
        last(&rx),
        last(&ry),
        ESTIMATE.stroke.color.css(),
        panel.clock.animate(&rx),
        panel.clock.animate(&ry),
    );
    moving(text, panel, &turned, &shape);
}

/// Half axes of the 95 % ellipse in units of the picture, and the direction of the first half axis, rad.
fn ellipse(record: &Record, scale: f64) -> ([f64; 2], f64) {
    let p = record
        .lead
        .fused
        .robot
        .covariance
        .map(|row| row.map(f64::from));
    let mean = 0.5 * (p[0][0] + p[1][1]);
    let half = libm::hypot(0.5 * (p[0][0] - p[1][1]), p[0][1]);
    // 95th percentile of χ² with two degrees of freedom.
    let axis = |variance: f64| scale * (5.991 * variance.max(0.0)).sqrt();
    let angle = 0.5 * libm::atan2(2.0 * p[0][1], p[0][0] - p[1][1]);
    ([axis(mean + half), axis(mean - half)], angle)
}

/// Draws `shape`, which is given around the origin, moving through the postures.
fn moving(text: &mut String, panel: &Panel, postures: &[[f64; 3]], shape: &str) {
    let place = |[x, y, _]: &[f64; 3]| {
        let [u, v] = panel.map.at([*x, *y]);
        format!("{u:.1} {v:.1}")
    };
    let turn = |[_, _, phi]: &[f64; 3]| format!("{:.1}", -phi.to_degrees());
    let places: Vec<String> = postures.iter().map(place).collect();
    let turns: Vec<String> = postures.iter().map(turn).collect();
    let (Some(end), Some(end_turn)) = (places.last(), turns.last()) else {
        return;
    };
    let animate = "<animateTransform attributeName=\"transform\" type=";
    let _ = writeln!(
        text,
        "<g transform=\"translate({end})\">{animate}\"translate\" {}/>\
         <g transform=\"rotate({end_turn})\">{animate}\"rotate\" {}/>{shape}</g></g>",
        panel.clock.animate(&places),
        panel.clock.animate(&turns),
    );
}

fn line(text: &mut String, points: &str, style: Stroke) {
    let _ = writeln!(
        text,
        "<polyline fill=\"none\" {} points=\"{points}\"/>",
        stroke(style)
    );
}

/// SVG attributes of a line with the given style.
fn stroke(style: Stroke) -> String {
    let dash: Vec<String> = style.dash.pattern().iter().map(f64::to_string).collect();
    let dash = match dash.is_empty() {
        true => String::new(),
        false => format!(" stroke-dasharray=\"{}\"", dash.join(" ")),
    };
    format!(
        "stroke=\"{}\" stroke-width=\"{}\" stroke-linecap=\"round\"{dash}",
        style.color.css(),
        style.width
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::checks::{attributes, check_svg};
    use host_sim::run::robot::{AxleRecord, FrameRecord};

    const BODY: Body = Body {
        half_track_m: 0.162,
        wheel_radius_m: 0.073,
        wheel_width_m: 0.03,
    };

    /// A run along x at 0.1 m/s.
    fn records(seconds: u32) -> Vec<Record> {
        let epoch = |k: u32| {
            let time_s = 0.01 * f64::from(k);
            let mut record = Record {
                time_s,
                midpoint: [0.1 * time_s - 1.0, 0.0, 0.0],
                axles: vec![AxleRecord::default(); 2],
                frames: vec![FrameRecord::default()],
                ..Record::default()
            };
            record.lead.fused.robot.covariance[0][0] = 1e-4;
            record
        };
        (0..=100 * seconds).map(epoch).collect()
    }

    #[test]
    fn every_animation_has_as_many_values_and_ends_at_the_last_record() {
        let (short, long) = (records(4), records(10));
        let run = |title: &str, records| Run {
            title: title.to_owned(),
            result: "at the goal".to_owned(),
            records,
            target: Target::Goal([0.0; 3], 0.1),
        };
        let text = svg(&BODY, &[run("short", &short), run("long", &long)]);
        check_svg(&text);
        for element in ["animate", "animateTransform"] {
            let values = attributes(&text, element, "values");
            assert!(!values.is_empty());
            // 51 values are 10 s in steps of 0.2 s, one repeats the end, and 30 hold it: 3 s of the picture at twice
            // the speed.
            for values in values {
                assert_eq!(values.split(';').count(), 51 + 1 + 30);
            }
        }
        // Without animation the shapes show the end of the run: the estimate at the origin, and the 95 % ellipse.
        let radius: Vec<f64> = attributes(&text, "ellipse", "rx")
            .iter()
            .map(|rx| rx.parse().unwrap())
            .collect();
        let tolerance: f64 = attributes(&text, "circle", "r")[0].parse().unwrap();
        let expected = tolerance / 0.1 * 0.01 * 5.991f64.sqrt();
        assert!((radius[0] - expected).abs() < 0.1, "{radius:?} {expected}");
    }

    /// Three axles on a path: three moving axles, two moving frames, and the path as one line.
    #[test]
    fn every_axle_and_frame_of_a_chain_on_a_path_moves() {
        let mut records = records(4);
        for record in &mut records {
            record.axles = vec![AxleRecord::default(); 3];
            record.frames = vec![FrameRecord::default(); 2];
        }
        let points = vec![[0.0, 0.0], [3.0, 2.0]];
        let run = Run {
            title: "path".to_owned(),
            result: String::new(),
            records: &records,
            target: Target::Path(points),
        };
        let text = svg(&BODY, &[run]);
        check_svg(&text);
        let wheels = attributes(&text, "rect", "fill")
            .iter()
            .filter(|fill| **fill != "#ffffff")
            .count();
        assert_eq!(wheels, 6);
        let moving = attributes(&text, "animate", "attributeName");
        assert_eq!(moving.iter().filter(|name| **name == "points").count(), 2);
        assert_eq!(attributes(&text, "polyline", "points").len(), 3);
        assert!(text.contains("green: path"));
    }

    #[test]
    fn a_run_without_records_gives_a_picture() {
        check_svg(&svg(&BODY, &[]));
    }
}
