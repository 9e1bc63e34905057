//! Path following and trajectory tracking.

use crate::experiments::Context;
use crate::experiments::posture::Variant;
use crate::experiments::result::end_lines;
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use host_sim::paths;
use host_sim::paths::Path;
use host_sim::run::end::RunEnd;
use host_sim::run::path_run;
use host_sim::run::path_run::{AxleErrors, Deviation, Errors, Outcome, PathEpoch, PathMode, Route};
use host_sim::run::robot::Record;
use host_sim::scenario::Scenario;
use host_sim::scenario::effect::Taken;
use host_sim::world::body::Body;
use output::files::{Csv, OutputDir};
use output::table::Table;
use recording::csv;
use serde::Serialize;
use std::path::Path as FilePath;
use view::animation;
use view::figures;
use view::figures::{FollowErrors, FollowRun, Snapshot};
use view::page;

/// Path with options from the command line.
#[derive(Clone, Debug)]
pub struct PathOptions {
    /// Line, circle, figure-eight, or a CSV file of waypoints.
    pub path: String,
    /// Length of the line, radius of the circle or half width of the figure eight, m.
    pub size: Option<f64>,
    /// Number of laps of a closed path.
    pub laps: u32,
    /// Limit of the speed along the path, m/s [default: the scenario's].
    pub speed_m_s: Option<f64>,
    /// Start posture of the midpoint O, m, m, rad [default: on the first point of the path, along the path].
    pub start: Option<[f64; 3]>,
}

/// Maximum number of epochs kept for log and picture.
pub const MAX_ROWS: usize = 20_000;
/// Minimum distance between two drawn robots of one frame in the picture, m, and addition for each further frame.
const APART_M: [f64; 2] = [0.65, 0.4];

/// Path errors of a run of `follow` or `track`, for the JSON output.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FollowReport {
    /// Name or file of the path, as typed.
    pub path: String,
    /// Length of the path over all laps, m.
    pub length_m: f64,
    /// Limit of the speed along the path, m/s.
    pub speed_m_s: f64,
    /// True if the relative position sensor was fitted.
    pub rps: bool,
    /// True if inertial sensors were fitted.
    pub imu: bool,
    /// Name of the fusion.
    pub fusion: &'static str,
    /// Path errors of the true midpoint, of three and more axles of the first axle; at the end, of the midpoint.
    #[serde(flatten)]
    pub truth: Errors,
    /// Path errors of the estimate.
    pub estimate: Errors,
    /// Largest |curvature| of the path, 1/m.
    pub path_curvature: f64,
    /// Largest true |curvature| of the midpoint's track, 1/m.
    pub max_curvature: f64,
    /// Curvature bound of the frame, 1/m.
    pub curvature_bound: f64,
    /// Distances of the axles from the path and forces of the frames; `None` for two axles, and without a true state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chain: Option<ChainReport>,
    /// End of the run.
    pub end: RunEnd,
}

impl FollowReport {
    /// Point of the robot that drives on the path.
    fn tracked(&self) -> &'static str {
        match self.chain {
            None => "true midpoint",
            Some(_) => "true front axle",
        }
    }
}

/// Path errors of a robot of three and more axles.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChainReport {
    /// Name of each axle's board, front first.
    pub names: Vec<&'static str>,
    /// Distance of each axle from the path, front first.
    pub axles: Vec<AxleErrors>,
    /// Force of the frames: root mean square and largest, N.
    pub force_n: [f64; 2],
    /// Shear force of a frame that lies on the path, EI times the rate of the curvature: root mean square and largest,
    /// N.
    pub own_force_n: [f64; 2],
}

impl ChainReport {
    fn of(robot: Topology, outcome: &Outcome, own_force_n: [f64; 2]) -> Option<Self> {
        if robot.axle_count() == 2 || outcome.axles.is_empty() {
            return None;
        }
        let names = robot.axles().map(|axle| robot.name(Role::Axle(axle)));
        Some(Self {
            names: names.collect(),
            axles: outcome.axles.clone(),
            force_n: [outcome.rms_force_n, outcome.max_force_n],
            own_force_n,
        })
    }

    /// Sentence about the forces.
    fn force(&self) -> String {
        let ([rms, max], [own_rms, own_max]) = (self.force_n, self.own_force_n);
        format!(
            "rms {rms:.2} N, largest {max:.2} N; of the path itself {own_rms:.2} N, {own_max:.2} N"
        )
    }

    /// Table and sentence below the path errors of the midpoint.
    fn text(&self) -> String {
        let mut table = Table::new(["distance from the path", "rms (mm)", "max (mm)"]);
        for (name, errors) in self.names.iter().zip(&self.axles) {
            table.row([
                (*name).to_owned(),
                format!("{:.2}", 1e3 * errors.rms_m),
                format!("{:.2}", 1e3 * errors.max_m),
            ]);
        }
        format!("\n{table}\nforce of the frames: {}\n", self.force())
    }
}

/// Command of a path mode, and title of its report.
pub fn names(path_mode: PathMode) -> (&'static str, &'static str) {
    match path_mode {
        PathMode::Follow => ("follow", "Path following"),
        PathMode::Track => ("track", "Trajectory tracking"),
    }
}

/// Path, route and speed of a drive.
#[derive(Clone, Debug)]
pub struct Course {
    /// Name or file of the path, as typed.
    pub name: String,
    /// One lap of the path.
    pub path: Path,
    /// Route of all laps.
    pub route: Route,
    /// Limit of the speed along the path, m/s.
    pub speed_m_s: f64,
}

/// Scenario keys that the path replaces.
pub const PATH: Taken = &[
    ("mission.start", "along a path: use --from"),
    (
        "mission.goal",
        "along a path: the end of the path is the goal",
    ),
    (
        "mission.time_limit_s",
        "along a path: the limit follows from the expected duration",
    ),
];

/// Reads path, speed and start, checks them and writes them into the scenario.
pub fn prepare(options: &PathOptions, scenario: &mut Scenario) -> Result<Course, Error> {
    let path = paths::named(&options.path, ("--size", options.size))
        .map_err(|error| Error::input(format!("--path {}: {error}", options.path)))?;
    if options.laps != 1 && !path.is_closed() {
        return Err(Error::input(format!(
            "--laps {}: must be 1 because the path {} is open",
            options.laps, options.path
        )));
    }
    let limits = &mut scenario.robot.lead.course.path;
    let most = f64::from(scenario.robot.limits.max_speed_m_s);
    if let Some(speed) = options.speed_m_s {
        if !(speed >= f64::from(limits.min_speed_m_s) && speed <= most) {
            return Err(Error::input(format!(
                "--speed {speed}: must be a number from {} to {} m/s",
                limits.min_speed_m_s, scenario.robot.limits.max_speed_m_s
            )));
        }
        limits.max_speed_m_s = speed as f32;
    }
    let speed = f64::from(limits.max_speed_m_s).min(most);
    let route = Route::new(&path, options.laps, scenario)
        .map_err(|error| Error::input(format!("path {}: {error}", options.path)))?;
    scenario.mission.start = options.start.unwrap_or_else(|| route.start());
    scenario.check()?;
    let [planned, _] = path_run::start_distances(scenario);
    route
        .check_start(scenario.mission.start, planned)
        .map_err(|error| Error::input(format!("path {}: {error}", options.path)))?;
    Ok(Course {
        name: options.path.clone(),
        path,
        route,
        speed_m_s: speed,
    })
}

/// Text table, JSON report and files of a run along a path.
pub fn publish(
    context: &Context,
    course: &Course,
    path_mode: PathMode,
    outcome: &Outcome,
    moments: &[PathEpoch],
) -> Result<(String, FollowReport, OutputDir), Error> {
    let (name, title) = names(path_mode);
    let (scenario, route) = (&context.scenario, &course.route);
    let mut files = context.output()?;
    let variant = Variant::of(scenario);
    let report = FollowReport {
        path: course.name.clone(),
        length_m: route.path().length(),
        speed_m_s: (course.speed_m_s * 1e6).round() / 1e6,
        rps: variant.rps,
        imu: variant.imu,
        fusion: variant.fusion(),
        truth: outcome.truth,
        estimate: outcome.estimate,
        path_curvature: course.path.max_curvature(),
        max_curvature: outcome.max_curvature,
        curvature_bound: route.curvature_bound(),
        chain: ChainReport::of(
            scenario.robot.topology(),
            outcome,
            route.own_force(scenario.world.plant.bending_stiffness_n_m2),
        ),
        end: outcome.end.clone(),
    };
    let records: Vec<Record> = moments.iter().map(|moment| moment.record.clone()).collect();
    let run = followed(route, path_mode, moments, &records);
    let shape = FilePath::new(&course.name).file_stem();
    let shape = shape.map_or(course.name.clone(), |stem| {
        stem.to_string_lossy().into_owned()
    });
    let axles = scenario.robot.topology().axle_count();
    let robot = match axles {
        2 => String::new(),
        _ => format!("{axles} axles, "),
    };
    let heading = format!("{title}: {shape}, {robot}{}", variant.label());
    let figure = figures::follow(&heading, &context.body(), &run);
    figure.add(&mut files, name);
    let animation = animated(&context.body(), &heading, &report, &records, &run);
    files.text("drive.svg", animation);
    files.csv("errors.csv", errors(moments));
    files.csv("ends.csv", csv::of_ends([&outcome.end]));
    files.csv("log.csv", csv::of_records(&records));
    let both = |moment: &PathEpoch| {
        [&moment.truth, &moment.estimate].map(|deviation| {
            let distance = match path_mode {
                PathMode::Follow => deviation.lateral_m,
                PathMode::Track => deviation.distance_m,
            };
            [distance, deviation.heading_rad]
        })
    };
    let shown = page::Run {
        title: heading.clone(),
        name: variant.label(),
        goal: Some(route.goal()),
        reference: run.reference.clone(),
        errors: moments.iter().map(both).collect(),
        records: moments.iter().map(|moment| &moment.record).collect(),
        distance: match path_mode {
            PathMode::Follow => "Distance to the left of the path",
            PathMode::Track => "Distance from the reference",
        },
        end: &outcome.end,
        summary: summary(&report),
        scenario,
    };
    page::add(&mut files, &context.subtitle(), &context.body(), &[shown]);
    Ok((table(&heading, &report, outcome), report, files))
}

/// Curves and robots in the picture of a run.
fn followed(
    route: &Route,
    path_mode: PathMode,
    moments: &[PathEpoch],
    records: &[Record],
) -> FollowRun {
    FollowRun {
        reference: route
            .path()
            .samples()
            .iter()
            .map(|at| [at.x, at.y])
            .collect(),
        driven: driven(records),
        snapshots: snapshots(records),
        distance_label: match path_mode {
            PathMode::Follow => "distance to the left of the path",
            PathMode::Track => "distance from the reference",
        },
        truth: over_time(moments, path_mode, |moment| &moment.truth),
        estimate: over_time(moments, path_mode, |moment| &moment.estimate),
    }
}

/// Path of the midpoint; of three and more axles the paths of the axles, because their midpoint cuts curves.
fn driven(records: &[Record]) -> Vec<Vec<[f64; 2]>> {
    let track = |place: &dyn Fn(&Record) -> [f64; 3]| {
        let at = records.iter().map(place);
        at.map(|[x, y, _]| [x, y]).collect()
    };
    match records.first().map_or(0, |record| record.axles.len()) {
        0..=2 => vec![track(&|record| record.midpoint)],
        axles => (0..axles)
            .map(|axle| track(&|record| record.axles[axle].posture))
            .collect(),
    }
}

/// The run as an animated picture. Draws the estimate if the true posture is unknown.
fn animated(
    body: &Body,
    heading: &str,
    report: &FollowReport,
    records: &[Record],
    run: &FollowRun,
) -> String {
    let shown: Vec<Record> = records.iter().map(Record::with_estimate).collect();
    let errors = match report.truth.rms_m.is_finite() {
        true => report.truth,
        false => report.estimate,
    };
    let worst = report.chain.iter().flat_map(|chain| &chain.axles);
    let worst = worst.map(|axle| axle.rms_m).reduce(f64::max);
    let result = match worst {
        Some(rms_m) => format!("worst axle: rms {:.0} mm from the path", 1e3 * rms_m),
        None => format!("rms {:.0} mm from the path", 1e3 * errors.rms_m),
    };
    let run = animation::Run {
        title: heading.to_owned(),
        result,
        records: &shown,
        target: animation::Target::Path(run.reference.clone()),
    };
    animation::svg(body, &[run])
}

/// Names and values in the summary of the report page.
fn summary(report: &FollowReport) -> Vec<(String, String)> {
    let row = |name: &str, value: String| (name.to_owned(), value);
    let errors = |errors: &Errors| {
        format!(
            "rms {:.2} mm, largest {:.2} mm, final {:.2} mm and {:.2}°",
            1e3 * errors.rms_m,
            1e3 * errors.max_m,
            1e3 * errors.final_m,
            errors.final_heading_rad.to_degrees()
        )
    };
    let chain = report.chain.iter().flat_map(|chain| {
        let axles = chain.names.iter().zip(&chain.axles).map(|(name, errors)| {
            let (rms, max) = (1e3 * errors.rms_m, 1e3 * errors.max_m);
            (
                format!("Distance of {name}"),
                format!("rms {rms:.2} mm, largest {max:.2} mm"),
            )
        });
        axles.chain([("Force of the frames".to_owned(), chain.force())])
    });
    let rows = vec![
        row("Path", report.path.clone()),
        row(
            "Length",
            format!("{:.2} m at up to {} m/s", report.length_m, report.speed_m_s),
        ),
        row(report.tracked(), errors(&report.truth)),
        row("Errors as estimated", errors(&report.estimate)),
        row(
            "Largest curvature",
            format!(
                "path {:.2}, true {:.2}, bound of the frame {:.2} 1/m",
                report.path_curvature, report.max_curvature, report.curvature_bound
            ),
        ),
    ];
    rows.into_iter().chain(chain).collect()
}

/// Maximum number of points of a curve in the picture.
const MAX_POINTS: usize = 2_000;

fn over_time(
    moments: &[PathEpoch],
    path_mode: PathMode,
    of: impl Fn(&PathEpoch) -> &Deviation,
) -> FollowErrors {
    let mut errors = FollowErrors::default();
    for moment in moments
        .iter()
        .step_by(moments.len().div_ceil(MAX_POINTS).max(1))
    {
        let deviation = of(moment);
        errors.t_s.push(moment.record.time_s);
        errors.distance_m.push(match path_mode {
            PathMode::Follow => deviation.lateral_m,
            PathMode::Track => deviation.distance_m,
        });
        errors.heading_rad.push(deviation.heading_rad);
    }
    errors
}

/// Drawn robots: at the start, at the end, and between them at least [`APART_M`] apart.
fn snapshots(records: &[Record]) -> Vec<Snapshot> {
    let mut shown: Vec<&Record> = Vec::new();
    for share in [0.0, 1.0, 0.33, 0.67, 0.17, 0.83, 0.5] {
        let place = share * records.len().saturating_sub(1) as f64;
        let Some(record) = records.get(place as usize) else {
            break;
        };
        let apart = |other: &&Record| {
            let [x, y, _] = other.midpoint;
            let further = record.frames.len().saturating_sub(1) as f64;
            let apart = APART_M[0] + APART_M[1] * further;
            libm::hypot(record.midpoint[0] - x, record.midpoint[1] - y) > apart
        };
        if shown.iter().all(apart) {
            shown.push(record);
        }
    }
    shown.into_iter().map(Snapshot::of).collect()
}

/// Path errors over time, as the CSV file.
fn errors(moments: &[PathEpoch]) -> Csv {
    csv::CsvRow::table(moments.iter().map(|moment| {
        let (target, truth, estimate) = (&moment.target, &moment.truth, &moment.estimate);
        let mut row = csv::CsvRow::default();
        row.put("time_s target_s_m", &[moment.record.time_s, target.s]);
        let at = [target.x, target.y, target.phi, target.kappa];
        let names = "target_x_m target_y_m target_phi_rad target_kappa_per_m";
        row.put(names, &at);
        let errors = |of: &Deviation| [of.distance_m, of.lateral_m, of.heading_rad];
        row.put("distance_m lateral_m heading_rad", &errors(truth));
        let names = "distance_est_m lateral_est_m heading_est_rad";
        row.put(names, &errors(estimate));
        row.put("kappa_per_m", &[moment.curvature]);
        row
    }))
}

fn table(heading: &str, report: &FollowReport, outcome: &Outcome) -> String {
    let mut table = Table::new([
        "",
        "rms (mm)",
        "max (mm)",
        "max lateral (mm)",
        "rms heading (°)",
        "final (mm)",
        "final heading (°)",
    ]);
    for (name, errors) in [
        (report.tracked(), &outcome.truth),
        ("as estimated", &outcome.estimate),
    ] {
        table.row([
            name.to_owned(),
            format!("{:.2}", 1e3 * errors.rms_m),
            format!("{:.2}", 1e3 * errors.max_m),
            format!("{:.2}", 1e3 * errors.max_cross_track_m),
            format!("{:.2}", errors.rms_heading_rad.to_degrees()),
            format!("{:.2}", 1e3 * errors.final_m),
            format!("{:.2}", errors.final_heading_rad.to_degrees()),
        ]);
    }
    let end = end_lines(&report.end, "end of the path");
    let chain = report
        .chain
        .as_ref()
        .map_or(String::new(), ChainReport::text);
    format!(
        "{heading}\n{:.2} m at up to {} m/s\n\n{table}{chain}\n\
         curvature: path {:.2}, true {:.2}, bound of the frame {:.2} 1/m\n{end}",
        report.length_m,
        report.speed_m_s,
        report.path_curvature,
        report.max_curvature,
        report.curvature_bound,
    )
}
