//! Paths and trajectories as tasks of the lead node: buffers, progress, and the end at rest.
//!
//! A host streams points into a buffer of fixed size, before the task begins and while it runs:
//! it asks for room, pushes points, and declares the end. Points behind the robot are dropped, so
//! a path may be of any length. When the host falls behind, the robot slows down and waits at the
//! last point of the path it knows; a trajectory has its own time and rests at the last point.
//!
//! # Steering along a path
//!
//! Law (4) leaves ε free if its reference has a lead (see [`control::path`]): a deviation from the path decays over
//! the length e*/2, e* = r√(2ε). With ε = 0.15 and r = 0.2 m that is 5.5 cm, a rate of 3.6 1/s at 0.2 m/s, somewhat
//! below half of the 8 rad/s at which the governor steers. (For the posture regulator, which stops on a point, e*
//! must be small.) The lag of steering makes a bend too early or too late, which also acts through k2: with 4 rad/s
//! the robot weaves, with 1 rad/s a disturbance has faded after one swing. Deviations along the path decay at the
//! rate k1; with the governor's lag of 6 1/s of speed in the loop, k1 = 3 m/s leaves a damping of 0.7.
//!
//! # The end
//!
//! At the end of the path (or of the trajectory's time) the law continues with its reference at rest and removes the
//! remaining error, until its speed has faded. Then the robot brakes, keeps its bend and is done; it does not start
//! again by itself. A robot that friction holds within the tolerance of the end rests there.
//!
//! # Without an end
//!
//! A robot farther from its path or trajectory than [`Config::max_deviation_m`] is lost. A robot that should move and
//! does not makes no progress. Both results stay until the task is given again.
//!
//! # Panic contract
//!
//! [`Config::build`] validates and the buffers reject bad points; nothing else can fail.
//!
//! [`control::path`]: crate::control::path

use crate::config::{ConfigError, declare};
use crate::control::cascade::{Cascade, Motion};
use crate::control::governor::GovernorInput;
use crate::control::kinematic;
use crate::control::path::{
    self, Follower, PathBuffer, PathError, PathPoint, Progress, Tracker, TrajectoryBuffer,
    TrajectoryPoint,
};
use crate::control::regulator::Tolerance;
use crate::control::stuck::{STUCK_S, Stuck};
use crate::math::{Posture, Transform};
use crate::time::{EPOCH, Micros, seconds};

/// Points of a path that are held at a time: 2.56 m at 1 cm. Braking and the lead of the reference look 0.3 m ahead.
pub const PATH_POINTS: usize = 256;
/// Points of a trajectory that are held at a time: 6.4 s at 50 ms.
pub const TRAJECTORY_POINTS: usize = 128;

/// Time without motion after which a robot within the tolerance of the end rests, s.
const REST_S: f32 = 1.0;
/// Reference speed above which the robot must move, before the end of the path is known or the time is over, m/s.
const MOVING_M_S: f32 = 5e-3;

declare! {
    /// Parameters of path following and trajectory tracking.
    pub struct Config {
        /// Limits along a path. Trajectories use only the nominal speed of these: they have their own limits.
        pub path: path::Config = path::Config {
            max_speed_m_s: 0.2,
            nominal_speed_m_s: 0.2,
            ..path::Config::default()
        };
        /// Gains of law (4) along paths and trajectories.
        pub law: kinematic::Config = kinematic::Config {
            epsilon: 0.15,
            approach_gain_m_s: 3.0,
            heading_gain_rad_s: 1.0,
            ..kinematic::Config::default()
        };
        /// Distance of O from its path or trajectory beyond which the robot stops.
        pub max_deviation_m: f32 = 0.5, "m": Positive;
        /// Speed requested at the end below which the robot is brought to rest. The law requests k1 times the
        /// distance left.
        pub rest_speed_m_s: f32 = 1e-3, "m/s": Positive;
    }
}

impl Config {
    /// Builds the path task for a frame; the error names the field that is wrong.
    pub fn build(&self, cascade: &Cascade) -> Result<PathTask, ConfigError> {
        self.check_ranges()?;
        let law = self.law.build()?;
        Ok(PathTask {
            follower: self.path.build(cascade, &law)?,
            tracker: Tracker::new(cascade, &law, self.path.nominal_speed_m_s)?,
            rest_speed: self.rest_speed_m_s,
            max_deviation: self.max_deviation_m,
        })
    }
}

/// Buffer of a path.
pub type Path = PathBuffer<PATH_POINTS>;
/// Buffer of a trajectory.
pub type Trajectory = TrajectoryBuffer<TRAJECTORY_POINTS>;

/// Path and trajectory, and the progress of the robot along them.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    path: Path,
    trajectory: Trajectory,
    progress: Progress,
    /// Start time of the trajectory, and the trajectory time at that start.
    start: Option<(Micros, f32)>,
    /// True once the end has been reached: the robot is brought to rest and stays at rest.
    resting: bool,
    /// True once the robot was too far from its path or trajectory.
    lost: bool,
    /// Time for which the robot should have moved and did not.
    stuck: Stuck,
}

impl Default for State {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl State {
    /// No path, no trajectory. A constant is written to its place without a copy on the stack.
    pub const EMPTY: Self = Self {
        path: PathBuffer::new(),
        trajectory: TrajectoryBuffer::new(),
        progress: Progress {
            s: 0.0,
            started: false,
            finished: false,
        },
        start: None,
        resting: false,
        lost: false,
        stuck: Stuck::NEW,
    };

    /// Deletes all points of path and trajectory.
    pub fn clear(&mut self) {
        *self = Self::EMPTY;
    }

    /// Returns to the first points in the buffers.
    pub fn restart(&mut self) {
        // The path is entered at its first point and not where it comes nearest to the robot: a
        // loop ends where it begins, and a path may cross its own beginning.
        self.progress = Progress {
            s: self.path.start(),
            started: true,
            finished: false,
        };
        self.start = None;
        (self.resting, self.lost) = (false, false);
        self.stuck.reset();
    }

    /// True if the robot was too far from its path or trajectory since the last [`Self::restart`].
    pub fn is_lost(&self) -> bool {
        self.lost
    }

    /// Number of path points that can be pushed.
    pub fn path_room(&self) -> usize {
        self.path.room()
    }

    /// As [`Self::clear`], except that a state without points and without an end is left as it is.
    pub fn forget(&mut self) {
        let empty = self.path.is_empty() && self.trajectory.is_empty();
        if !empty || self.resting || self.trajectory.is_complete() {
            self.clear();
        }
    }

    /// Appends a point to the path; a new path begins after one that was driven to its end.
    pub fn push_path_point(&mut self, point: PathPoint) -> Result<(), PathError> {
        if self.resting {
            self.clear();
        }
        self.path.push(point)
    }

    /// Declares the last point of the path its end.
    pub fn finish_path(&mut self) {
        self.path.finish();
    }

    /// Number of trajectory points that can be pushed.
    pub fn trajectory_room(&self) -> usize {
        self.trajectory.room()
    }

    /// Appends a point to the trajectory, unless the trajectory has been ended; a new trajectory begins after one
    /// that was driven to its end.
    pub fn push_trajectory_point(&mut self, point: TrajectoryPoint) -> Result<(), PathError> {
        if self.resting {
            self.clear();
        }
        self.trajectory.push(point)
    }

    /// Declares the last point of the trajectory its end.
    pub fn finish_trajectory(&mut self) {
        self.trajectory.finish();
    }

    /// Path and trajectory.
    pub(super) fn buffers(&mut self) -> (&mut Path, &mut Trajectory) {
        (&mut self.path, &mut self.trajectory)
    }

    /// Time on the trajectory at the time `epoch`, s. The trajectory begins with the first call after
    /// [`Self::restart`], at its first point in the buffer.
    pub(super) fn time(&mut self, epoch: Micros) -> f32 {
        // Earlier points have been dropped, so a task given again continues where it stopped.
        let begin = self.trajectory.start();
        let (start, first) = *self.start.get_or_insert((epoch, begin));
        first + seconds(epoch.saturating_sub(start))
    }

    /// Drops the points of the trajectory before `time` (s).
    pub(super) fn discard_before(&mut self, time: f32) {
        self.trajectory.discard_before(time);
    }

    /// Sets whether the robot rests at the end, and whether it was too far from its path.
    pub(super) fn set_end(&mut self, resting: bool, lost: bool) {
        (self.resting, self.lost) = (resting, lost);
    }
}

/// Output of the path task at an epoch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathStep {
    /// Input of the governor; `None` to brake and keep the bend.
    pub governor_input: Option<GovernorInput>,
    /// Target posture of O; `None` without a path.
    pub target: Option<Posture>,
    /// True if the end has been reached and the robot is at rest.
    pub done: bool,
    /// True if the robot should move and did not.
    pub stuck: bool,
}

/// Drives along paths and trajectories.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathTask {
    follower: Follower,
    tracker: Tracker,
    rest_speed: f32,
    max_deviation: f32,
}

/// State of a path or trajectory at an epoch, from which [`PathTask::conclude`] decides on the end of the task.
struct Course {
    /// True at the end of the path, or once the time of the trajectory is over.
    finished: bool,
    /// Last posture of the path or trajectory; `None` until the robot is near the end of a complete path, or the time
    /// of the trajectory is over.
    end: Option<Posture>,
    /// True if the robot must move.
    asked: bool,
}

impl PathTask {
    /// Runs one epoch along the path, with O estimated at `center` and `motion` as last commanded.
    pub fn follow(
        &self,
        state: &mut State,
        center: impl Into<Transform>,
        within: &Tolerance,
        motion: &Motion,
    ) -> PathStep {
        let center = center.into();
        let step = self
            .follower
            .step(&state.progress, &state.path, center.posture);
        let Some((progress, reference)) = step else {
            return PathStep::default();
        };
        state.progress = progress;
        state.path.discard_before(progress.s);
        if self.loses(state, center.posture, reference.target) {
            return PathStep::default();
        }
        let governor_input = self.follower.governor_input(center, &reference);
        let complete = state.path.is_complete();
        // A loop ends where it begins, so the distance along the path decides.
        let last = complete && state.path.end() - progress.s <= within.position_m;
        let course = Course {
            finished: progress.finished,
            end: last.then(|| state.path.last_posture()),
            asked: complete || reference.reference.v > MOVING_M_S,
        };
        let step = self.conclude(
            state,
            &course,
            (center.posture, within),
            governor_input,
            motion,
        );
        PathStep {
            target: Some(reference.target),
            ..step
        }
    }

    /// Runs one epoch along the trajectory, which begins with the first call; `epoch` is the time at which O was at
    /// `center`.
    pub fn track(
        &self,
        state: &mut State,
        epoch: Micros,
        center: impl Into<Transform>,
        within: &Tolerance,
        motion: &Motion,
    ) -> PathStep {
        let center = center.into();
        if state.trajectory.is_empty() {
            return PathStep::default();
        }
        let time = state.time(epoch);
        let Some(reference) = self.tracker.at(&state.trajectory, time) else {
            return PathStep::default();
        };
        state.trajectory.discard_before(time);
        if self.loses(state, center.posture, reference.target) {
            return PathStep::default();
        }
        let governor_input = self.tracker.governor_input(center, &reference);
        let finished = reference.finished && state.trajectory.is_complete();
        let course = Course {
            finished,
            end: finished.then(|| state.trajectory.last_posture()),
            asked: finished || reference.reference.v > MOVING_M_S,
        };
        let step = self.conclude(
            state,
            &course,
            (center.posture, within),
            governor_input,
            motion,
        );
        PathStep {
            target: Some(reference.target),
            ..step
        }
    }

    /// True if O is too far from its target; stays true. A robot at rest at the end is not checked: it may be carried
    /// away.
    fn loses(&self, state: &mut State, center: Posture, target: Posture) -> bool {
        state.lost |= !state.resting && !(center.distance(target) <= self.max_deviation);
        state.lost
    }

    /// Brings the robot to rest at the end, once the law requests little more speed or friction holds the robot
    /// within the tolerance of the end.
    fn conclude(
        &self,
        state: &mut State,
        course: &Course,
        (center, within): (Posture, &Tolerance),
        governor_input: GovernorInput,
        motion: &Motion,
    ) -> PathStep {
        let faded = governor_input.v.abs().max(motion.v.abs()) <= self.rest_speed;
        let asked = course.asked && !state.resting;
        let still = state.stuck.step(asked, center, seconds(EPOCH));
        let near = course.end.is_some_and(|end| within.is_near(center, end));
        state.resting |= (course.finished && faded) || (near && still >= REST_S);
        PathStep {
            governor_input: (!state.resting).then_some(governor_input),
            target: None,
            done: state.resting && motion.v == 0.0 && motion.psi_rate == 0.0,
            stuck: still >= STUCK_S,
        }
    }
}

#[cfg(test)]
mod tests;
