//! Paths and trajectories as tasks of the lead node: buffers, progress, and the end at rest.
//!
//! A host streams points into a buffer of fixed size, before the task begins and while it runs:
//! it asks for room, pushes points, and declares the end. Points behind the robot are dropped, so
//! a path may be of any length. When the host falls behind, the robot slows down and waits at the
//! last point of the path it knows; a trajectory has its own time and rests at the last point.
//!
//! # Steering along a path
//!
//! Law (4) leaves a free choice of ε once its reference is led (see [`control::path`]): a
//! deviation from the path decays over the length e*/2, e* = r√(2ε). With ε = 0.15 and r = 0.2 m
//! that is 5.5 cm, a rate of 3.6 1/s at 0.2 m/s, somewhat below half of the 8 rad/s at which the
//! governor steers. (For the posture regulator, which stops on a point, e* is to be small instead.)
//! A bend too early or too late by the lag of steering also feeds k2: at 4 rad/s the robot weaves,
//! at 1 rad/s a disturbance has faded after one swing. Deviations along the path decay at the rate
//! k1; with the governor's lag of 6 1/s of speed in the loop, k1 = 3 m/s leaves a damping of 0.7.
//!
//! # The end
//!
//! Once the end of the path is reached (or the time of the trajectory is over) the law goes on with
//! its reference at rest, which takes out what is left, until the speed it asks for has faded. Then
//! the robot brakes, keeps its bend and is done; it does not start again by itself.
//!
//! # Panic contract
//!
//! [`Config::build`] validates and the buffers refuse bad points; nothing else can fail.
//!
//! [`control::path`]: crate::control::path

use crate::config::{ConfigError, positive};
use crate::control::cascade::{Cascade, Motion};
use crate::control::governor::Wish;
use crate::control::kinematic;
use crate::control::path::{
    self, Follower, PathBuffer, PathError, PathPoint, Progress, Tracker, TrajectoryBuffer,
    TrajectoryPoint,
};
use crate::math::{Posture, Transform};
use crate::time::{Micros, seconds};

/// Points of a path that are held at a time: 2.56 m at 1 cm. What braking and the lead of the
/// reference look ahead is 0.3 m.
pub const PATH_POINTS: usize = 256;
/// Points of a trajectory that are held at a time: 6.4 s at 50 ms.
pub const TRAJECTORY_POINTS: usize = 128;

/// Parameters of path following and trajectory tracking.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Config {
    /// Limits along a path. Trajectories use its nominal speed only: they bring their own limits.
    pub path: path::Config,
    /// Gains of law (4) along paths and trajectories.
    pub law: kinematic::Config,
    /// Speed asked for at the end below which the robot is brought to rest, m/s. The law asks for
    /// k1 times the distance left.
    pub rest_speed_m_s: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            path: path::Config {
                max_speed_m_s: 0.2,
                nominal_speed_m_s: 0.2,
                ..path::Config::default()
            },
            law: kinematic::Config {
                epsilon: 0.15,
                approach_gain_m_s: 3.0,
                heading_gain_rad_s: 1.0,
                ..kinematic::Config::default()
            },
            rest_speed_m_s: 1e-3,
        }
    }
}

impl Config {
    /// The ready-to-run form for a frame; the error names the field that is wrong.
    pub fn build(&self, cascade: &Cascade) -> Result<PathTask, ConfigError> {
        let law = self.law.build()?;
        Ok(PathTask {
            follower: self.path.build(cascade, &law)?,
            tracker: Tracker::new(cascade, &law, self.path.nominal_speed_m_s)?,
            rest_speed: positive("rest_speed_m_s", self.rest_speed_m_s)?,
        })
    }
}

/// Path and trajectory, and how far the robot is along them.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    path: PathBuffer<PATH_POINTS>,
    trajectory: TrajectoryBuffer<TRAJECTORY_POINTS>,
    /// Whether the last point of the trajectory is its end.
    trajectory_ended: bool,
    progress: Progress,
    /// When the trajectory began, and at which of its times.
    start: Option<(Micros, f32)>,
    /// The end has been reached and the robot is being brought to rest.
    resting: bool,
}

impl Default for State {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl State {
    /// No path, no trajectory. A constant goes to its place without a copy on the stack.
    pub const EMPTY: Self = Self {
        path: PathBuffer::new(),
        trajectory: TrajectoryBuffer::new(),
        trajectory_ended: false,
        progress: Progress {
            s: 0.0,
            started: false,
            finished: false,
        },
        start: None,
        resting: false,
    };

    /// Forgets path and trajectory.
    pub fn clear(&mut self) {
        *self = Self::EMPTY;
    }

    /// Goes to the beginning of what the buffers hold.
    pub fn restart(&mut self) {
        // The path is entered at its first point and not where it comes nearest to the robot: a
        // loop ends where it begins, and a path may cross its own beginning.
        self.progress = Progress {
            s: self.path.start(),
            started: true,
            finished: false,
        };
        self.start = None;
        self.resting = false;
    }

    /// Number of path points that can be pushed.
    pub fn path_room(&self) -> usize {
        self.path.room()
    }

    /// Appends a point to the path.
    pub fn push_path_point(&mut self, point: PathPoint) -> Result<(), PathError> {
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

    /// Appends a point to the trajectory, unless that has been ended.
    pub fn push_trajectory_point(&mut self, point: TrajectoryPoint) -> Result<(), PathError> {
        if self.trajectory_ended {
            return Err(PathError::Ended);
        }
        self.trajectory.push(point)
    }

    /// Declares the last point of the trajectory its end.
    pub fn finish_trajectory(&mut self) {
        self.trajectory_ended = true;
    }
}

/// What is to be done at an epoch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// Wish for the governor; none: brake and keep the bend.
    pub wish: Option<Wish>,
    /// Where O should be; none without a path.
    pub target: Option<Posture>,
    /// The end has been reached and the robot is at rest.
    pub done: bool,
}

/// Drives along paths and trajectories.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathTask {
    follower: Follower,
    tracker: Tracker,
    rest_speed: f32,
}

impl PathTask {
    /// One epoch along the path, with O estimated at `center` and `motion` as last commanded.
    pub fn follow(&self, state: &mut State, center: impl Into<Transform>, motion: &Motion) -> Step {
        let center = center.into();
        let step = self
            .follower
            .step(&state.progress, &state.path, center.posture);
        let Some((progress, reference)) = step else {
            return Step::default();
        };
        state.progress = progress;
        state.path.discard_before(progress.s);
        let wish = self.follower.wish(center, &reference);
        self.conclude(state, progress.finished, wish, reference.target, motion)
    }

    /// One epoch along the trajectory, which begins with the first call; `epoch` is the time at
    /// which O was at `center`.
    pub fn track(
        &self,
        state: &mut State,
        epoch: Micros,
        center: impl Into<Transform>,
        motion: &Motion,
    ) -> Step {
        if state.trajectory.is_empty() {
            return Step::default();
        }
        // What lies behind has been dropped: a task given again goes on where it was left.
        let begin = state.trajectory.start_time();
        let (start, first) = *state.start.get_or_insert((epoch, begin));
        let time = first + seconds(epoch.saturating_sub(start));
        let Some(reference) = self.tracker.at(&state.trajectory, time) else {
            return Step::default();
        };
        state.trajectory.discard_before(time);
        let wish = self.tracker.wish(center, &reference);
        let finished = reference.finished && state.trajectory_ended;
        self.conclude(state, finished, wish, reference.target, motion)
    }

    /// Brings the robot to rest once the end is reached and the law asks for little more.
    fn conclude(
        &self,
        state: &mut State,
        finished: bool,
        wish: Wish,
        target: Posture,
        motion: &Motion,
    ) -> Step {
        let faded = wish.v.abs().max(motion.v.abs()) <= self.rest_speed;
        state.resting |= finished && faded;
        Step {
            wish: (!state.resting).then_some(wish),
            target: Some(target),
            done: state.resting && motion.v == 0.0 && motion.psi_rate == 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::cascade;

    fn task() -> PathTask {
        let cascade = cascade::Config::default().build().unwrap();
        Config::default().build(&cascade).unwrap()
    }

    fn on_line(s: f32) -> PathPoint {
        PathPoint {
            posture: Posture::new(s, 0.0, 0.0),
            kappa: 0.0,
            s,
        }
    }

    fn moving(v: f32) -> Motion {
        Motion {
            v,
            ..Motion::default()
        }
    }

    #[test]
    fn path_of_any_length_streams_through_the_buffer() {
        let (task, mut state) = (task(), State::default());
        let (mut pushed, count) = (0, 2000);
        let mut feed = |state: &mut State| {
            while pushed < count && state.path_room() > 0 {
                state
                    .push_path_point(on_line(pushed as f32 * 0.01))
                    .unwrap();
                pushed += 1;
            }
            if pushed == count {
                state.finish_path();
            }
            pushed
        };
        assert_eq!(feed(&mut state), PATH_POINTS);
        assert_eq!(state.push_path_point(on_line(9.0)), Err(PathError::Full));
        state.restart();
        let mut x = 0.0;
        while x < 19.9 {
            feed(&mut state);
            let step = task.follow(&mut state, Posture::new(x, 0.0, 0.0), &moving(0.2));
            assert!((step.target.unwrap().x - x).abs() < 1e-4);
            // The stream keeps ahead, so nothing slows the robot down before the end.
            let expected = if x < 19.7 { 0.2 } else { 0.1 };
            assert!(step.wish.unwrap().v > expected - 1e-3, "{x}: {step:?}");
            x += 0.05;
        }
        assert_eq!(feed(&mut state), count);
        assert_eq!(state.push_path_point(on_line(99.0)), Err(PathError::Ended));
    }

    #[test]
    fn robot_waits_where_the_stream_breaks_off_and_ends_where_the_path_does() {
        let (task, mut state) = (task(), State::default());
        for i in 0..=100 {
            state.push_path_point(on_line(i as f32 * 0.01)).unwrap();
        }
        state.restart();
        let mut x = 0.0;
        let mut drive = |state: &mut State, epochs: usize| {
            let mut last = Step::default();
            let mut v = 0.0;
            for _ in 0..epochs {
                last = task.follow(state, Posture::new(x, 0.0, 0.0), &moving(v));
                v = last.wish.map_or(0.0, |wish| wish.v);
                x += 0.01 * v;
            }
            (x, last)
        };
        let (x, waiting) = drive(&mut state, 1500);
        assert!((x - 1.0).abs() < 3e-3 && !waiting.done, "{x} {waiting:?}");
        for i in 101..=150 {
            state.push_path_point(on_line(i as f32 * 0.01)).unwrap();
        }
        state.finish_path();
        let (x, ended) = drive(&mut state, 1500);
        assert!((x - 1.5).abs() < 1e-3 && ended.done, "{x} {ended:?}");
        assert_eq!(ended.wish, None);
        // Being pushed does not make it start again.
        let pushed = task.follow(&mut state, Posture::new(1.3, 0.0, 0.0), &moving(0.0));
        assert!(pushed.done && pushed.wish.is_none());
    }

    #[test]
    fn loop_begins_at_its_beginning() {
        // A circle of 0.3 m radius: its last points are as near to the robot as its first ones.
        let (task, mut state) = (task(), State::default());
        let count = 189;
        for i in 0..=count {
            let turn = core::f32::consts::TAU * i as f32 / count as f32;
            let s = 0.3 * turn;
            let posture = Posture::ORIGIN.advance(s, turn);
            let kappa = 1.0 / 0.3;
            state
                .push_path_point(PathPoint { posture, kappa, s })
                .unwrap();
        }
        state.finish_path();
        state.restart();
        let behind = Posture::new(-0.002, 0.0, 0.0);
        let step = task.follow(&mut state, behind, &moving(0.0));
        assert!(!step.done && step.wish.unwrap().v > 0.1);
    }

    #[test]
    fn nothing_moves_without_points() {
        let (task, mut state) = (task(), State::default());
        state.restart();
        let step = task.follow(&mut state, Posture::ORIGIN, &moving(0.1));
        assert_eq!(step, Step::default());
        let step = task.track(&mut state, 10_000, Posture::ORIGIN, &moving(0.1));
        assert_eq!(step, Step::default());
        // And time has not begun to run.
        assert_eq!(state.start, None);
    }

    #[test]
    fn a_trajectory_given_again_goes_on_where_it_was_left() {
        let (task, mut state) = (task(), State::default());
        for i in 0..100 {
            let time_s = i as f32 * 0.05;
            let point = TrajectoryPoint {
                time_s,
                v: 0.1,
                point: on_line(0.1 * time_s),
            };
            state.push_trajectory_point(point).unwrap();
        }
        state.restart();
        let at = |state: &mut State, epoch: u64| {
            let step = task.track(state, epoch, Posture::ORIGIN, &moving(0.1));
            step.target.unwrap().x
        };
        at(&mut state, 1_000_000);
        assert!((at(&mut state, 3_020_000) - 0.202).abs() < 1e-4);
        state.restart();
        // Points are 5 mm apart.
        assert!((at(&mut state, 9_000_000) - 0.2).abs() < 1e-4);
        assert!((at(&mut state, 9_100_000) - 0.21).abs() < 1e-4);
    }

    #[test]
    fn trajectory_begins_with_its_first_epoch_and_ends_at_rest() {
        let (task, mut state) = (task(), State::default());
        let mut pushed = 0;
        let mut feed = |state: &mut State| {
            // 0.1 m/s for 10 s; speed at the ends is of no concern here.
            while pushed <= 200 && state.trajectory_room() > 0 {
                let time_s = pushed as f32 * 0.05;
                let point = TrajectoryPoint {
                    time_s,
                    v: if pushed < 200 { 0.1 } else { 0.0 },
                    point: on_line(0.1 * time_s),
                };
                state.push_trajectory_point(point).unwrap();
                pushed += 1;
            }
            if pushed > 200 {
                state.finish_trajectory();
            }
        };
        feed(&mut state);
        assert_eq!(state.trajectory_room(), 0);
        state.restart();
        let begin = 7_770_000;
        let mut last = Step::default();
        for epoch in 0..1100u64 {
            feed(&mut state);
            let now = begin + epoch * 10_000;
            let x = (0.001 * epoch as f32).min(1.0);
            let v = if epoch < 1000 { 0.1 } else { 0.0 };
            last = task.track(&mut state, now, Posture::new(x, 0.0, 0.0), &moving(v));
            // In the last interval the speed falls to zero at once.
            let tolerance = if epoch < 995 { 2e-4 } else { 5e-3 };
            assert!((last.target.unwrap().x - x).abs() < tolerance, "{epoch}");
        }
        assert!(last.done && last.wish.is_none());
    }
}
