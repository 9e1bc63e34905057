//! Report page: a run as one self-contained HTML file.
//!
//! `page.html` beside this file is the template; `base.css`, `scene.js` and `chart.js` are shared with the browser page. The data of a run are inserted as JSON, with at most `MOST_SAMPLES`
//! samples, about 50 per second.

use crate::style;
use crate::style::{ESTIMATE, TRUTH};
use core_algos::control::regulator::Phase;
use core_algos::math::Posture;
use core_algos::topology::Role;
use host_sim::run::end::{EndKind, RunEnd};
use host_sim::run::final_error::wrap;
use host_sim::run::robot::{Record, estimated_axles};
use host_sim::scenario::Scenario;
use host_sim::world::body::Body;
use output::files::OutputDir;
use serde::{Serialize, Serializer};
use serde_json::json;

const PAGE: &str = include_str!("page.html");
/// Placeholder of the data in the template.
const DATA: &str = "/*DATA*/";
/// Placeholder of the style sheet in the template.
const STYLE: &str = "/*STYLE*/";
/// Placeholder of the scripts in the template.
const SCRIPT: &str = "/*SCRIPT*/";
/// Scripts that draw the robot and curves, shared with the browser page.
const SCRIPTS: &str = concat!(include_str!("scene.js"), "\n", include_str!("chart.js"));
/// Name of the report file.
pub const FILE: &str = "report.html";

/// Upper limit of the number of samples per run.
const MOST_SAMPLES: usize = 3_000;
/// Samples per second; fewer if the run would exceed [`MOST_SAMPLES`].
const SAMPLES_PER_S: f64 = 50.0;

/// Number that is rounded to `PLACES` decimal places in JSON.
#[derive(Clone, Copy, Debug)]
struct Rounded<const PLACES: i32>(f64);

impl<const PLACES: i32> Serialize for Rounded<PLACES> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let scale = libm::pow(10.0, f64::from(PLACES));
        let value = (self.0 * scale).round() / scale;
        // NaN and infinity become null, which plots show as a gap.
        match value.is_finite() {
            true if value == value.trunc() => to.serialize_i64(value as i64),
            true => to.serialize_f64(value),
            false => to.serialize_none(),
        }
    }
}

/// Position rounded to 10 µm, or angle rounded to 10 µrad.
type Coordinate = Rounded<5>;

fn coordinates<const N: usize>(values: [f64; N]) -> [Coordinate; N] {
    values.map(Rounded)
}

/// Errors of a midpoint relative to goal or reference: distance (m) and heading (rad).
pub type MidpointError = [f64; 2];

/// Data of a run on the report page.
pub struct Run<'a> {
    /// Title of the page.
    pub title: String,
    /// Name that distinguishes the run from other runs of the page.
    pub name: String,
    /// Goal posture; `None` without a goal.
    pub goal: Option<[f64; 3]>,
    /// Reference path of the run, m.
    pub reference: Vec<[f64; 2]>,
    /// Records of the epochs, in order.
    pub records: Vec<&'a Record>,
    /// Errors of the true and of the estimated midpoint, one pair per record.
    pub errors: Vec<[MidpointError; 2]>,
    /// Title of the distance plot.
    pub distance: &'static str,
    /// End of the run, the first rows of the summary.
    pub end: &'a RunEnd,
    /// Rows of the summary after the end of the run: name and value.
    pub summary: Vec<(String, String)>,
    /// Scenario of the run.
    pub scenario: &'a Scenario,
}

#[derive(Serialize)]
struct Series {
    name: String,
    /// Name of the CSS variable of the curve's colour; the variable of the dash adds `-dash`.
    look: String,
    data: Vec<Rounded<4>>,
}

#[derive(Serialize)]
struct Plot {
    title: String,
    unit: &'static str,
    series: Vec<Series>,
}

fn posture(p: Posture) -> [f64; 3] {
    [p.x, p.y, p.phi].map(f64::from)
}

impl Run<'_> {
    /// Indices of the records that the page shows.
    fn shown(&self) -> impl Iterator<Item = usize> + use<> {
        let count = self.records.len();
        let time = |record: &&Record| record.time_s;
        let span = self.records.last().map_or(0.0, time) - self.records.first().map_or(0.0, time);
        let wanted = ((span * SAMPLES_PER_S) as usize).clamp(1, MOST_SAMPLES);
        let stride = count.saturating_sub(1).div_ceil(wanted).max(1);
        // The last epoch is always included.
        let last = count.checked_sub(1).filter(|last| last % stride != 0);
        (0..count).step_by(stride).chain(last)
    }

    #[expect(clippy::too_many_lines, reason = "one list of plots")]
    fn plots(&self, shown: &[usize]) -> Vec<Plot> {
        let column = |name: &str, look: &str, value: &dyn Fn(usize) -> f64| Series {
            name: name.to_owned(),
            look: format!("--{look}"),
            data: shown.iter().map(|&i| Rounded(value(i))).collect(),
        };
        // `value` takes the index of the epoch and the number of the series.
        let numbered = |names: &[&str], value: &dyn Fn(usize, usize) -> f64| {
            let names = names.iter().enumerate();
            names
                .map(|(n, name)| column(name, &format!("c{n}"), &|i| value(i, n)))
                .collect::<Vec<_>>()
        };
        let both = |value: &dyn Fn(usize, usize) -> f64| {
            vec![
                column("true", TRUTH.name, &|i| value(i, 0)),
                column("as estimated", ESTIMATE.name, &|i| value(i, 1)),
            ]
        };
        let plot = |title: &str, unit, series| Plot {
            title: title.to_owned(),
            unit,
            series,
        };
        let record = |i: usize| self.records[i];
        let sigma = |i: usize, axis: usize| {
            f64::from(record(i).lead.fused.robot.covariance[axis][axis]).sqrt()
        };
        let off = |i: usize, axis: usize| {
            let estimate = posture(record(i).lead.fused.robot.posture);
            estimate[axis] - record(i).midpoint[axis]
        };
        let degrees = |angle: f64| wrap(angle).to_degrees();
        let position = |i: usize, n: usize| match n {
            0 | 1 => 1e3 * off(i, n),
            _ => 2e3 * sigma(i, n - 2),
        };
        let heading = |i: usize, n: usize| match n {
            0 => degrees(off(i, 2)),
            _ => 2.0 * sigma(i, 2).to_degrees(),
        };
        let names = ["x", "y", "2σ x", "2σ y"];
        let topology = self.scenario.robot.topology();
        let chain = topology.frame_count() > 1;
        let strains = ["1", "2", "3", "4", "5", "6", "7", "8"];
        let fitted = self.scenario.robot.beam.strip.gauges_m.count();
        let gauges = if self.scenario.mission.rps { fitted } else { 0 };
        let distances = both(&|i, k| 1e3 * self.errors[i][k][0]);
        let headings = both(&|i, k| degrees(self.errors[i][k][1]));
        let mut plots = vec![
            plot(self.distance, "mm", distances),
            plot("Heading error", "°", headings),
            plot(
                "Position error of the estimate",
                "mm",
                numbered(&names, &position),
            ),
            plot(
                "Heading error of the estimate",
                "°",
                numbered(&["heading", "2σ"], &heading),
            ),
        ];
        if chain {
            // Ten wheels in one plot could not be told apart.
            plots.extend(topology.axles().map(|axle| {
                let torque = |i: usize, n: usize| record(i).axles[axle.index()].torque[n];
                let title = format!("Wheel torques of {}", topology.name(Role::Axle(axle)));
                plot(&title, "N m", numbered(&["left", "right"], &torque))
            }));
            let beams = topology.frames().map(Role::Beam);
            let beams: Vec<&str> = beams.map(|beam| topology.name(beam)).collect();
            let force = |i: usize, n: usize| {
                let [along, across] = record(i).frames[n].wrench.force;
                libm::hypot(along, across)
            };
            plots.push(plot("Frame forces", "N", numbered(&beams, &force)));
        } else {
            let wheels: Vec<String> = topology
                .axles()
                .map(|axle| topology.name(Role::Axle(axle)))
                .flat_map(|axle| ["left", "right"].map(|side| format!("{axle} {side}")))
                .collect();
            let wheels: Vec<&str> = wheels.iter().map(String::as_str).collect();
            let torque = |i: usize, n: usize| record(i).axles[n / 2].torque[n % 2];
            plots.push(plot("Wheel torques", "N m", numbered(&wheels, &torque)));
        }
        let frames = topology.frames().filter(|_| gauges > 0);
        plots.extend(frames.map(|frame| {
            let strain =
                |i: usize, n: usize| 1e6 * f64::from(record(i).frames[frame.index()].strain[n]);
            let series = numbered(&strains[..gauges], &strain);
            let title = match chain {
                true => format!(
                    "Strains of {}, from the rear end on",
                    topology.name(Role::Beam(frame))
                ),
                false => "Strains, from the rear end on".to_owned(),
            };
            plot(&title, "µm/m", series)
        }));
        // The true state of a real robot is unknown, so its curves are left out.
        for plot in &mut plots {
            let known = |series: &Series| series.data.iter().any(|value| value.0.is_finite());
            plot.series.retain(known);
        }
        plots.retain(|plot| !plot.series.is_empty());
        plots
    }

    fn json(&self) -> serde_json::Value {
        let shown: Vec<usize> = self.shown().collect();
        let records: Vec<Record> = shown
            .iter()
            .map(|&i| self.records[i].with_estimate())
            .collect();
        let list = |value: &dyn Fn(&Record) -> [f64; 3]| -> Vec<[Coordinate; 3]> {
            let values = records.iter().map(value);
            values.map(coordinates).collect()
        };
        // Points of the frames relative to the midpoint, from the rear frame to the front frame.
        let frame = |record: &Record| -> Vec<Coordinate> {
            let [x, y, _] = record.midpoint;
            let points = record.frames.iter().rev().flat_map(|frame| &frame.points);
            points
                .flat_map(|&[a, b]| [Rounded(f64::from(a) - x), Rounded(f64::from(b) - y)])
                .collect()
        };
        let covariance = |record: &Record| -> [Rounded<9>; 4] {
            let p = record
                .lead
                .fused
                .robot
                .covariance
                .map(|row| row.map(f64::from));
            [p[0][0], p[0][1], p[1][1], p[2][2]].map(Rounded)
        };
        let target = |record: &Record| record.lead.target.map(|p| coordinates(posture(p)));
        // Upper bound of the distance from the truth to the 2σ ellipse of the estimate.
        let spread = |record: &Record| {
            let [x, y, _] = posture(record.lead.fused.robot.posture);
            let p = &record.lead.fused.robot.covariance;
            let off = libm::hypot(x - record.midpoint[0], y - record.midpoint[1]);
            let sigma = f64::from(p[0][0].max(p[1][1])).max(0.0).sqrt();
            let reach = off + 2.0 * sigma;
            if reach.is_finite() { reach } else { 0.0 }
        };
        let spread = records.iter().map(spread).fold(1e-3, f64::max);
        let with_target = self
            .records
            .iter()
            .any(|record| record.lead.target.is_some());
        let each = |value: &dyn Fn(&Record) -> serde_json::Value| -> Vec<serde_json::Value> {
            records.iter().map(value).collect()
        };
        let mission = &self.scenario.mission;
        let topology = self.scenario.robot.topology();
        // For two axles the cross of the midpoint is enough.
        let chain = topology.frame_count() > 1;
        let estimated = topology.axles().filter(|_| chain);
        let configuration = self.scenario.to_toml().unwrap_or_default();
        let world = [("world".to_owned(), self.scenario.world.label())].into_iter();
        json!({
            "title": self.title,
            "known": self.records.iter().any(|record| !record.midpoint[0].is_nan()),
            "name": self.name,
            "goal": self.goal.map(coordinates),
            "tolerance": [mission.tolerance_m, mission.tolerance_rad],
            "reference": self.reference.iter().map(|&p| coordinates(p)).collect::<Vec<_>>(),
            "t": shown.iter().map(|&i| Rounded::<3>(self.records[i].time_s)).collect::<Vec<_>>(),
            "truth": list(&|record| record.midpoint),
            "axles": topology.axles().map(|axle| list(&|record| record.axles[axle.index()].posture)).collect::<Vec<_>>(),
            "estimated_axles": estimated.map(|axle| list(&|record| {
                let all: Vec<Posture> = estimated_axles(&record.lead).collect();
                let known = all.len() == topology.axle_count();
                let at = all.get(axle.index()).filter(|_| known);
                let at = at.map_or([f64::NAN; 3], |&at| posture(at));
                let truth = record.axles[axle.index()].posture[2];
                [at[0], at[1], truth + wrap(at[2] - truth)]
            })).collect::<Vec<_>>(),
            // Distance from the true to the estimated position, plus twice the larger standard deviation of x and y.
            "estimate": list(&|record| {
                let [x, y, phi] = posture(record.lead.fused.robot.posture);
                let truth = record.midpoint[2];
                [x, y, truth + wrap(phi - truth)]
            }),
            "frame": each(&|record| json!(frame(record))),
            "covariance": each(&|record| json!(covariance(record))),
            "target": if with_target { json!(each(&|record| json!(target(record)))) } else { json!(null) },
            "phase": each(&|record| json!(phase(record))),
            "spread": Rounded::<5>(spread),
            "plots": self.plots(&shown),
            "summary": world.chain(self.end.summary()).chain(self.summary.clone()).collect::<Vec<_>>(),
            "end": self.end,
            "configuration": configuration,
        })
    }
}

fn phase(record: &Record) -> String {
    let lead = &record.lead;
    match (lead.done, lead.phase) {
        (true, _) => EndKind::Done.name().to_owned(),
        (false, Phase::Stop) => format!("{:?}", lead.mode).to_lowercase(),
        (false, phase) => format!("{phase:?}").to_lowercase(),
    }
}

/// Adds the report page with these runs to the files; the page first shows the last of `runs`.
pub fn add(files: &mut OutputDir, subtitle: &str, body: &Body, runs: &[Run]) {
    files.text(FILE, page(subtitle, body, runs));
}

fn page(subtitle: &str, body: &Body, runs: &[Run]) -> String {
    let data = json!({
        "subtitle": subtitle,
        "body": {
            "half_track": body.half_track_m,
            "wheel_radius": body.wheel_radius_m,
            "wheel_width": body.wheel_width_m,
        },
        "runs": runs.iter().map(Run::json).collect::<Vec<_>>(),
    });
    // Tags are escaped, so that the data cannot end the HTML element that contains them.
    let data = data
        .to_string()
        .replace("</", "<\\/")
        .replace("<!--", "<\\u0021--");
    PAGE.replacen(STYLE, &style::sheet(), 1)
        .replacen(SCRIPT, SCRIPTS, 1)
        .replacen(DATA, &data, 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::safety::{Condition, Conditions};
    use host_sim::run::robot::{AxleRecord, FRAME_POINTS, FrameRecord};

    fn data(page: &str) -> serde_json::Value {
        let (_, rest) = page.split_once("id=\"data\">").unwrap();
        let (json, _) = rest.split_once("</script>").unwrap();
        serde_json::from_str(json).unwrap()
    }

    /// Each axle and frame of three axles is drawn, estimated, and named in the plots.
    #[test]
    fn page_of_three_axles_has_every_axle_and_frame_by_name() {
        let text = "[robot.geometry]\naxles = 3";
        let scenario = Scenario::parse(None, text, "scenario", &[]).unwrap();
        let mut record = Record {
            time_s: 0.01,
            axles: vec![AxleRecord::default(); 3],
            frames: vec![FrameRecord::default(); 2],
            ..Record::default()
        };
        record.axles[1].torque = [0.25, 0.5];
        record.frames[0].points[0] = [1.0, 0.0];
        record.frames[1].points[0] = [2.0, 0.0];
        record.frames[1].wrench.force = [3.0, 4.0];
        record.frames[1].strain[2] = 5e-6;
        let unknown = record.clone();
        record.lead.inner[0] = Some(Posture::new(0.5, 0.0, 0.0));
        let end = RunEnd::default();
        let run = Run {
            title: String::new(),
            name: String::new(),
            goal: None,
            reference: Vec::new(),
            errors: vec![[[0.0; 2]; 2]; 2],
            records: vec![&unknown, &record],
            distance: "Distance",
            end: &end,
            summary: Vec::new(),
            scenario: &scenario,
        };
        let page = page("", &Body::of(&scenario.world.plant), &[run]);
        let data = data(&page);
        let run = &data["runs"][0];
        assert_eq!(run["axles"].as_array().unwrap().len(), 3);
        // Without an estimate of the inner axle no axle is taken for another one.
        assert!(run["estimated_axles"][2][0][0].is_null());
        assert_eq!(run["estimated_axles"][1][1][0], 0.5);
        let points = run["frame"][1].as_array().unwrap();
        assert_eq!(points.len(), 2 * 2 * FRAME_POINTS);
        assert_eq!(
            (&points[0], &points[2 * FRAME_POINTS]),
            (&json!(2), &json!(1))
        );
        let plots = run["plots"].as_array().unwrap();
        let value = |title: &str, name: &str| {
            let plot = plots.iter().find(|plot| plot["title"] == title).unwrap();
            let series = plot["series"].as_array().unwrap();
            let found = series.iter().find(|series| series["name"] == name).unwrap();
            found["data"][1].as_f64().unwrap()
        };
        assert_eq!(value("Wheel torques of axle-2", "right"), 0.5);
        assert_eq!(value("Frame forces", "beam-2"), 5.0);
        assert_eq!(value("Strains of beam-2, from the rear end on", "3"), 5.0);
        assert_eq!(plots.len(), 4 + 3 + 1 + 2);
    }

    #[test]
    fn page_contains_the_run_and_escapes_tags_in_its_data() {
        let scenario = Scenario::default();
        let records: Vec<Record> = (1..=1001)
            .map(|epoch| Record {
                time_s: 0.01 * f64::from(epoch),
                midpoint: [f64::from(epoch) * 1e-3, f64::NAN, 0.0],
                axles: vec![AxleRecord::default(); 2],
                frames: vec![FrameRecord::default()],
                ..Record::default()
            })
            .collect();
        let end = RunEnd {
            kind: EndKind::Uncertain,
            notices: Conditions::only(Condition::EstimateVague),
            error_95: Some([0.25, 0.0]),
            ..RunEnd::default()
        };
        let run = Run {
            title: "a </script> b".to_owned(),
            name: "one".to_owned(),
            goal: Some([0.0; 3]),
            reference: Vec::new(),
            errors: vec![[[0.25, 0.5]; 2]; records.len()],
            records: records.iter().collect(),
            distance: "Distance",
            end: &end,
            summary: vec![("a".to_owned(), "b".to_owned())],
            scenario: &scenario,
        };
        let page = page(
            "cfmmr posture, seed 3",
            &Body::of(&scenario.world.plant),
            &[run],
        );
        let data = data(&page);
        let run = &data["runs"][0];
        assert_eq!(run["title"], "a </script> b");
        assert_eq!(run["summary"][0], json!(["world", "base"]));
        let end = "uncertain after 0.0 s, 95 % error ±25.0 cm, ±0.0°";
        assert_eq!(run["summary"][1], json!(["End", end]));
        assert_eq!(run["summary"][2], json!(["Notices", "estimate vague"]));
        let times = run["t"].as_array().unwrap();
        // 10 s give 50 samples per second, with the first and the last.
        assert!((500..=503).contains(&times.len()), "{}", times.len());
        assert_eq!(times[0], 0.01);
        assert_eq!(times[times.len() - 1], 10.01);
        assert_eq!(run["truth"][0][0], 0.001);
        assert!(run["truth"][0][1].is_null(), "no number is no number");
        assert_eq!(run["plots"][0]["series"][0]["data"][7], 250);
        assert_eq!(run["plots"].as_array().unwrap().len(), 6);
        // Each colour and dash of a plot is in the style sheet once per colour scheme.
        for series in run["plots"].as_array().unwrap() {
            for one in series["series"].as_array().unwrap() {
                let look = one["look"].as_str().unwrap();
                assert_eq!(page.matches(&format!("{look}: #")).count(), 2, "{look}");
                assert_eq!(page.matches(&format!("{look}-dash: ")).count(), 2, "{look}");
            }
        }
        // The page fetches nothing: it contains no address.
        assert!(!page.contains("http://") && !page.contains("https://"));
    }
}
