//! One run of path following or trajectory tracking, with the path errors of the true and the estimated midpoint.

use crate::base::error::Error;
use crate::base::statistics::square;
use crate::paths::{
    Bounds, MAX_LENGTH_M, Path, PathError, SPACING_M, Sample, StartFault, TimeLimits, Trajectory,
};
use crate::run::drive::{DriveTask, Progress, drive};
use crate::run::end::RunEnd;
use crate::run::robot::{Record, Robot};
use crate::scenario::Scenario;
use crate::targets::{HostCommand, Room};
use core_algos::control::path::{PathPoint, TrajectoryPoint};
use core_algos::control::regulator::Tolerance;
use core_algos::node::lead::Task;
use core_algos::time::Micros;
use serde::Serialize;

/// Half the search range along the path for the nearest point, about the previous nearest point, m: more than the robot
/// drives in an epoch, less than the loop between two passes of a crossing.
const WINDOW_M: f64 = 0.1;
/// Time limit of a run is the first number times the expected duration, plus the second number, s.
const LIMIT_FACTOR_AND_EXTRA_S: (f64, f64) = (2.0, 30.0);
/// Share of the allowed distance from the start of the path that a planned start may use; the rest is left for the
/// placement error.
const START_SHARE: f64 = 0.8;
/// Largest allowed length of the path behind the robot at the start, m.
const MAX_PASSED_M: f64 = 0.2;
/// Largest allowed angle between robot and path at the start, rad: paths are driven forward.
const TURN_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// Share of the robot's speed limit that a trajectory may use; the rest is left for catching up.
const TIMED_SHARE: f64 = 0.9;

/// Choice of the reference point at each epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathMode {
    /// Path following: the nearest point of the path.
    Follow,
    /// Trajectory tracking: the point of the present time.
    Track,
}

/// A path the robot can drive, with the time law that trajectory tracking uses.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    path: Path,
    trajectory: Trajectory,
    max_curvature: f64,
    /// Distance of the point that drives on the path ahead of O, on a straight, m: 0 for O itself. Of three and more
    /// axles the first one drives on the path.
    ahead_m: f64,
}

/// Largest allowed distances of a robot from the start of a path, m: at a planned posture, and at the estimated
/// posture.
pub fn start_distances(scenario: &Scenario) -> [f64; 2] {
    let most = f64::from(scenario.robot.lead.course.max_deviation_m);
    [START_SHARE * most, most]
}

/// Limits on paths from the frame and the steering of the scenario's robot.
pub fn bounds(scenario: &Scenario) -> Bounds {
    let robot = &scenario.robot;
    Bounds {
        frame_length_m: robot.geometry.frame_length_m.into(),
        rigid_end_m: robot.geometry.rigid_end_m.into(),
        // Commands stay below the steering limit by a margin.
        max_steering_rad: robot.limits.commanded_steering_rad().into(),
        max_steering_rate_rad_s: robot.lead.governor.max_steering_rate_rad_s.into(),
        min_speed_m_s: robot.lead.course.path.min_speed_m_s.into(),
    }
}

impl Route {
    /// Deviations of the true and of the estimated midpoint, `since` µs after the beginning of the task. The estimate
    /// is `age` µs old. `arc_lengths` holds the arc lengths of both midpoints, m, and is updated.
    fn deviations(
        &self,
        path_mode: PathMode,
        record: &Record,
        (since, age): (Micros, Micros),
        arc_lengths: &mut [f64; 2],
    ) -> [Deviation; 2] {
        let fused = &record.lead.fused;
        let (truth, estimate) = match self.ahead_m {
            0.0 => (record.midpoint, fused.robot.posture),
            _ => {
                let first = record.axles.first().map(|axle| axle.posture);
                (first.unwrap_or(record.midpoint), fused.front.posture)
            }
        };
        let estimate = [estimate.x, estimate.y, estimate.phi].map(f64::from);
        let ages = [0, age];
        let mut deviations = [Deviation::default(); 2];
        for (i, [x, y, phi]) in [truth, estimate].into_iter().enumerate() {
            arc_lengths[i] = match path_mode {
                PathMode::Follow => self.path.nearest(x, y, arc_lengths[i], WINDOW_M),
                PathMode::Track => {
                    let time = since.saturating_sub(ages[i]) as f64 * 1e-6;
                    self.trajectory.arc_length(time)
                }
            };
            deviations[i] = Deviation::of([x, y, phi], &self.path.at(arc_lengths[i]));
        }
        if record.midpoint[0].is_nan() {
            // Without a true posture the estimated arc length replaces the true arc length.
            arc_lengths[0] = arc_lengths[1];
        }
        deviations
    }

    /// Route of `laps` laps of a closed path, or of an open path, for the robot of `scenario`.
    /// Refuses a path beyond the limits of the frame.
    pub fn new(path: &Path, laps: u32, scenario: &Scenario) -> Result<Self, PathError> {
        let bounds = bounds(scenario);
        path.check(&bounds)?;
        let length = path.length() * f64::from(if path.is_closed() { laps } else { 1 });
        if length > MAX_LENGTH_M {
            return Err(PathError::TooLong(length));
        }
        let path = path.unrolled(laps);
        let limits = scenario.robot.completed().lead.course.path;
        let timed = TIMED_SHARE * f64::from(scenario.robot.limits.max_speed_m_s);
        let speed = f64::from(limits.max_speed_m_s).min(timed);
        let trajectory = Trajectory::fastest(
            &path,
            &bounds,
            &TimeLimits {
                max_speed_m_s: speed,
                max_steering_rate_rad_s: limits.max_steering_rate_rad_s.into(),
                max_steering_acceleration_rad_s2: limits.max_steering_acceleration_rad_s2.into(),
                // About one point per sample of the path, so that the buffer on board reaches far enough ahead.
                interval_s: (SPACING_M / speed).clamp(0.05, 0.25),
                ..TimeLimits::default()
            },
        )?;
        Ok(Self {
            path,
            trajectory,
            max_curvature: bounds.max_curvature(),
            ahead_m: match scenario.robot.topology().frame_count() {
                1 => 0.0,
                frames => 0.5 * frames as f64 * (bounds.frame_length_m + 2.0 * bounds.rigid_end_m),
            },
        })
    }

    /// Path of the route, with all laps as one open path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Largest curvature the frame allows, 1/m.
    pub fn curvature_bound(&self) -> f64 {
        self.max_curvature
    }

    /// Posture of O at the start of the route: m, m, rad. O is at the first point; of three and more axles, the first
    /// one is.
    pub fn start(&self) -> [f64; 3] {
        moved_ahead(posture(&self.path.samples()[0]), -self.ahead_m)
    }

    /// Refuses a posture from which the robot cannot begin the path: farther than `most` (m) from the start, too far
    /// along the path, or turned away from the path.
    pub fn check_start(&self, at: [f64; 3], most: f64) -> Result<(), PathError> {
        let at = moved_ahead(at, self.ahead_m);
        let [x, y, _] = at;
        let s = self.path.nearest(x, y, 0.0, most.max(MAX_PASSED_M));
        let off = Deviation::of(at, &self.path.at(0.0));
        let (distance, turn) = (off.distance_m, off.heading_rad);
        let refuse = |what: StartFault| Err(PathError::Start(what));
        match () {
            () if distance > most => refuse(StartFault::Distance(distance, most)),
            () if s > MAX_PASSED_M => refuse(StartFault::Passed(s, MAX_PASSED_M)),
            () if turn.abs() > TURN_RAD => refuse(StartFault::Turn(turn)),
            () => Ok(()),
        }
    }

    /// True once the first axle of a robot with three and more axles is beyond the end, where it goes on until O is at
    /// the end. `since` is the time since the beginning of the task, µs.
    fn has_passed(&self, path_mode: PathMode, arc_length: f64, since: Micros) -> bool {
        let over = match path_mode {
            PathMode::Follow => arc_length >= self.path.length(),
            PathMode::Track => since as f64 * 1e-6 >= self.trajectory.duration(),
        };
        self.ahead_m > 0.0 && over
    }

    /// Posture of the route's last point: m, m, rad.
    pub fn goal(&self) -> [f64; 3] {
        posture(&self.end())
    }

    /// Postures of all points of the route: m, m, rad.
    pub fn postures(&self) -> Vec<[f64; 3]> {
        self.path.samples().iter().map(posture).collect()
    }

    /// Time limit of a run, s.
    pub fn limit_s(&self) -> f64 {
        LIMIT_FACTOR_AND_EXTRA_S.0 * self.trajectory.duration() + LIMIT_FACTOR_AND_EXTRA_S.1
    }

    /// Shear force of a strip that lies on the path: its bending stiffness (N m²) times the rate of the curvature, root
    /// mean square and largest, N.
    pub fn own_force(&self, stiffness: f64) -> [f64; 2] {
        let (mut squares, mut length, mut most) = (0.0, 0.0, 0.0f64);
        for pair in self.path.samples().windows(2) {
            let step = pair[1].s - pair[0].s;
            let rate = (pair[1].kappa - pair[0].kappa) / step;
            squares += step * square(rate);
            length += step;
            most = most.max(rate.abs());
        }
        [(squares / length).sqrt(), most].map(|rate| stiffness * rate)
    }

    fn end(&self) -> Sample {
        self.path.at(self.path.length())
    }
}

fn posture(at: &Sample) -> [f64; 3] {
    [at.x, at.y, at.phi]
}

/// The posture `distance` (m) ahead on a straight.
fn moved_ahead([x, y, phi]: [f64; 3], distance: f64) -> [f64; 3] {
    let (sin, cos) = libm::sincos(phi);
    [x + distance * cos, y + distance * sin, phi]
}

/// Deviation of a posture from the reference point of a path or trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    /// Distance to the left of the path, m.
    pub lateral_m: f64,
    /// Distance from the reference point, m; across the path in path following.
    pub distance_m: f64,
    /// Heading minus heading of the path, rad.
    pub heading_rad: f64,
}

impl Deviation {
    fn of(at: [f64; 3], target: &Sample) -> Self {
        let (dx, dy) = (at[0] - target.x, at[1] - target.y);
        let (s, c) = libm::sincos(target.phi);
        let turn = std::f64::consts::TAU;
        let heading = at[2] - target.phi;
        Self {
            lateral_m: c * dy - s * dx,
            distance_m: libm::hypot(dx, dy),
            heading_rad: heading - turn * (heading / turn).round(),
        }
    }
}

/// Record, reference and deviations at the end of one epoch.
#[derive(Clone, Debug, Default)]
pub struct PathEpoch {
    /// Record of the robot.
    pub record: Record,
    /// Reference of O: the point of the path beside the true O, or the point of the trajectory.
    pub target: Sample,
    /// Deviation of the true midpoint.
    pub truth: Deviation,
    /// Deviation of the estimated midpoint.
    pub estimate: Deviation,
    /// True curvature of O's path, from the bend of the frame that is bent most, 1/m.
    pub curvature: f64,
}

/// Path errors over a run and at its end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Errors {
    /// Root mean square of the distance from the reference point, m; across the path in path following.
    pub rms_m: f64,
    /// Largest distance from the reference point, m; across the path in path following.
    pub max_m: f64,
    /// Largest distance across the path, m.
    pub max_cross_track_m: f64,
    /// Root mean square of the heading error, rad.
    pub rms_heading_rad: f64,
    /// Distance from the end of the path at rest, m.
    pub final_m: f64,
    /// Heading at rest minus heading of the path's end, rad.
    pub final_heading_rad: f64,
}

/// Sums and maxima over the epochs, from which [`Errors`] is computed.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    distance: f64,
    heading: f64,
    max: f64,
    max_lateral: f64,
    count: f64,
}

impl Sums {
    fn add(&mut self, deviation: &Deviation) {
        self.distance += square(deviation.distance_m);
        self.heading += square(deviation.heading_rad);
        self.max = self.max.max(deviation.distance_m);
        self.max_lateral = self.max_lateral.max(deviation.lateral_m.abs());
        self.count += 1.0;
    }

    fn errors(&self, last: &Deviation) -> Errors {
        let rms = |sum: f64| (sum / self.count.max(1.0)).sqrt();
        // Unknown distances are NaN, which `f64::max` skips: without them the maxima are unknown too.
        let largest = |value: f64| {
            if self.distance.is_nan() {
                f64::NAN
            } else {
                value
            }
        };
        Errors {
            rms_m: rms(self.distance),
            max_m: largest(self.max),
            max_cross_track_m: largest(self.max_lateral),
            rms_heading_rad: rms(self.heading),
            final_m: last.distance_m,
            final_heading_rad: last.heading_rad,
        }
    }
}

/// Distance of an axle from the path; behind the start and beyond the end, from the straight line that continues the
/// path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct AxleErrors {
    /// Root mean square of the distance, m.
    pub rms_m: f64,
    /// Largest distance, m.
    pub max_m: f64,
}

/// An axle's place along the path, and its distances so far.
#[derive(Clone, Copy, Debug)]
struct AxleSums {
    arc_length: f64,
    square: f64,
    max: f64,
    count: f64,
}

impl AxleSums {
    /// Before the first epoch, with the axle `ahead` (m) of the point where O starts.
    fn new(ahead: f64) -> Self {
        Self {
            arc_length: ahead,
            square: 0.0,
            max: 0.0,
            count: 0.0,
        }
    }

    fn add(&mut self, path: &Path, [x, y, phi]: [f64; 3]) {
        self.arc_length = path.nearest(x, y, self.arc_length, WINDOW_M);
        let off = Deviation::of([x, y, phi], &path.at(self.arc_length)).lateral_m;
        self.square += square(off);
        self.max = self.max.max(off.abs());
        self.count += 1.0;
    }

    fn errors(&self) -> AxleErrors {
        AxleErrors {
            rms_m: (self.square / self.count.max(1.0)).sqrt(),
            max_m: self.max,
        }
    }
}

/// Path errors and end of a run along a path.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Errors of the true midpoint.
    pub truth: Errors,
    /// Errors of the estimated midpoint.
    pub estimate: Errors,
    /// Largest true |curvature| of O's path, 1/m.
    pub max_curvature: f64,
    /// Deviations of the axles from the path, front first; empty without a true state.
    pub axles: Vec<AxleErrors>,
    /// Root mean square of the magnitude of the frames' forces, N; NaN without a true state.
    pub rms_force_n: f64,
    /// Largest magnitude of a frame's force, N; NaN without a true state.
    pub max_force_n: f64,
    /// End of the task.
    pub end: RunEnd,
}

/// Drive along a route, in progress.
struct Drive<'a, F> {
    route: &'a Route,
    path_mode: PathMode,
    within: Tolerance,
    observe: F,
    stream: Stream,
    /// Arc lengths of the true and of the estimated midpoint, m.
    arc_lengths: [f64; 2],
    sums: [Sums; 2],
    /// Places and distances of the axles; empty before the first epoch and without a true state.
    axles: Vec<AxleSums>,
    /// Sum of the squares of the frames' forces, N², and number of forces.
    forces: (f64, f64),
    max_force_n: f64,
    latest: PathEpoch,
    max_curvature: f64,
    done: bool,
}

impl<R: Robot, F: FnMut(&PathEpoch)> DriveTask<R> for Drive<'_, F> {
    fn task(&self) -> Option<Task> {
        let within = self.within;
        Some(match self.path_mode {
            PathMode::Follow => Task::Follow { within },
            PathMode::Track => Task::Track { within },
        })
    }

    fn feed(&mut self, robot: &mut R) -> Result<(), Error> {
        let room = robot.room();
        match self.stream.next(room) {
            Some(points) => robot.command(&points),
            None => Ok(()),
        }
    }

    fn epoch(&mut self, robot: &R, record: &Record, since: Option<Micros>) -> Progress {
        let Some(since) = since else {
            return Progress::Driving;
        };
        let times = (since, robot.estimate_age());
        let deviations =
            self.route
                .deviations(self.path_mode, record, times, &mut self.arc_lengths);
        self.latest = PathEpoch {
            target: self.route.path.at(self.arc_lengths[0]),
            truth: deviations[0],
            estimate: deviations[1],
            curvature: record.curvature(),
            record: record.clone(),
        };
        self.max_curvature = self.max_curvature.max(self.latest.curvature.abs());
        (self.observe)(&self.latest);
        if !self.done {
            if !self
                .route
                .has_passed(self.path_mode, self.arc_lengths[0], since)
            {
                for (sum, deviation) in self.sums.iter_mut().zip(&deviations) {
                    sum.add(deviation);
                }
            }
            self.add_axles(record);
        }
        self.done |= record.lead.done;
        match record.lead.done {
            true => Progress::Done,
            false => Progress::Driving,
        }
    }
}

impl<F> Drive<'_, F> {
    /// Adds the distances of the axles from the path, and the forces of the frames.
    fn add_axles(&mut self, record: &Record) {
        if record.midpoint[0].is_nan() {
            return;
        }
        let path = &self.route.path;
        if self.axles.is_empty() {
            // The arc length is that of the point that drives on the path.
            let first = record.axles.first().filter(|_| self.route.ahead_m > 0.0);
            let [x, y, _] = first.map_or(record.midpoint, |first| first.posture);
            let (s, c) = libm::sincos(path.at(self.arc_lengths[0]).phi);
            let ahead = |[ax, ay, _]: [f64; 3]| c * (ax - x) + s * (ay - y);
            let place = |ahead: f64| (self.arc_lengths[0] + ahead).clamp(0.0, path.length());
            let axles = record
                .axles
                .iter()
                .map(|axle| AxleSums::new(place(ahead(axle.posture))));
            self.axles = axles.collect();
            self.max_force_n = 0.0;
        }
        for (sums, axle) in self.axles.iter_mut().zip(&record.axles) {
            sums.add(path, axle.posture);
        }
        for frame in &record.frames {
            let [x, y] = frame.wrench.force;
            let force = libm::hypot(x, y);
            self.forces = (self.forces.0 + square(force), self.forces.1 + 1.0);
            self.max_force_n = self.max_force_n.max(force);
        }
    }
}

/// Drives `route` with a robot of `scenario`; `observe` is called once an epoch from the beginning
/// of the task. The robot starts at the scenario's start posture.
pub fn drive_on(
    robot: &mut impl Robot,
    scenario: &Scenario,
    route: &Route,
    path_mode: PathMode,
    observe: impl FnMut(&PathEpoch),
) -> Result<Outcome, Error> {
    let mut run = Drive {
        route,
        path_mode,
        within: scenario.mission.within(),
        observe,
        stream: Stream::new(route, path_mode),
        arc_lengths: [0.0; 2],
        sums: [Sums::default(); 2],
        axles: Vec::new(),
        forces: (0.0, 0.0),
        max_force_n: f64::NAN,
        latest: PathEpoch::default(),
        max_curvature: 0.0,
        done: false,
    };
    let ended = drive(robot, scenario, route.limit_s(), &mut run)?;
    let end = route.end();
    let record = &run.latest.record;
    let center = record.lead.fused.robot.posture;
    let estimate = [center.x, center.y, center.phi].map(f64::from);
    let at_rest = [record.midpoint, estimate].map(|at| Deviation::of(at, &end));
    Ok(Outcome {
        truth: run.sums[0].errors(&at_rest[0]),
        estimate: run.sums[1].errors(&at_rest[1]),
        max_curvature: run.max_curvature,
        axles: run.axles.iter().map(AxleSums::errors).collect(),
        rms_force_n: (run.forces.0 / run.forces.1).sqrt(),
        max_force_n: run.max_force_n,
        end: ended,
    })
}

/// Points of a path or trajectory that are not yet sent to the robot.
pub struct Stream {
    points: Points,
    /// True if the end of the path was sent.
    ended: bool,
}

enum Points {
    Path(Vec<PathPoint>),
    Trajectory(Vec<TrajectoryPoint>),
}

impl Stream {
    /// Stream of all points of a route.
    pub fn new(route: &Route, path_mode: PathMode) -> Self {
        let points = match path_mode {
            PathMode::Follow => Points::Path(route.path.points()),
            PathMode::Track => Points::Trajectory(route.trajectory.to_points()),
        };
        Self {
            points,
            ended: false,
        }
    }

    /// Command with the next points that fit into `room`, with the end after the last point; `None` if there is nothing
    /// to send.
    pub fn next(&mut self, room: Room) -> Option<HostCommand> {
        if self.ended {
            return None;
        }
        let (command, sent) = match &mut self.points {
            Points::Path(points) => {
                let (points, end) = first(points, room.path);
                let sent = points.len();
                (HostCommand::Path { points, end }, (sent, end))
            }
            Points::Trajectory(points) => {
                let (points, end) = first(points, room.trajectory);
                let sent = points.len();
                (HostCommand::Trajectory { points, end }, (sent, end))
            }
        };
        self.ended = sent.1;
        (sent != (0, false)).then_some(command)
    }
}

/// Removes and returns the first points, at most `room`; true if no point is left.
fn first<T>(points: &mut Vec<T>, room: usize) -> (Vec<T>, bool) {
    let fit = room.min(points.len());
    let removed = points.drain(..fit).collect();
    (removed, points.is_empty())
}
