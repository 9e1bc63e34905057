//! Orders of a host for the lead node.
//!
//! | order | reaction | refused if | reason |
//! |---|---|---|---|
//! | [`Order::SetPose`] | the node restarts at this posture | a number is not finite or out of range: not finite | the estimate needs a valid start |
//! | [`Order::Task`]: regulate | task begins | goal not finite, or tolerance not a positive number: not finite | |
//! | [`Order::Task`]: follow, track | task begins | tolerance not a positive number: not finite | |
//! | [`Order::Task`]: drive | task begins | curvature beyond the frame's bound by more than a thousandth: too tight; speed or curvature not finite: not finite | the governor would drive another curve |
//! | [`Order::Task`]: others | task begins | never | |
//! | [`Order::Path`], [`Order::Trajectory`] | points appended in order, then the end of the path if `end` is set | a point is too tight, or the buffer refuses it: earlier points stay, later points and the end are dropped | the reported room shows how many points were taken |
//! | [`Order::Lost`] | a moving robot stops | never | no host commands |

use crate::control::path::{PathError, PathPoint, TrajectoryPoint};
pub use crate::node::lead::Placement;
use crate::node::lead::{LeadNode, Task};
use serde::{Deserialize, Serialize};

/// Relative excess over the curvature limit that is accepted as rounding.
const ROUNDING: f32 = 1e-3;

/// Largest number of points in one order.
pub const POINTS: usize = 8;

/// Order for the lead node.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Order {
    /// Sets the posture of the robot at rest. The nodes must not drive the motors.
    SetPose(Placement),
    /// Begins a task.
    Task(Task),
    /// Appends points to the path.
    Path {
        /// Points in order of the path.
        points: [Option<PathPoint>; POINTS],
        /// True if these are the last points of the path.
        end: bool,
    },
    /// Appends points to the trajectory.
    Trajectory {
        /// Points in order of time.
        points: [Option<TrajectoryPoint>; POINTS],
        /// True if these are the last points of the trajectory.
        end: bool,
    },
    /// The commanding host is lost: a moving robot stops.
    Lost,
}

impl Order {
    /// Applies the order to the lead node. Points after a refused point are dropped. Postures, goals, tolerances and
    /// speeds must be finite, and curvatures within the frame's limit.
    pub fn execute(&self, lead: &mut LeadNode) -> Result<(), PathError> {
        let bound = (1.0 + ROUNDING) * lead.cascade().max_curvature();
        let bends = |kappa: f32| match kappa.abs() > bound {
            true => Err(PathError::TooTight),
            false => Ok(()),
        };
        match self {
            Self::SetPose(placement) => match placement.is_sound() {
                true => lead.initialize(placement),
                false => return Err(PathError::NotFinite),
            },
            Self::Lost => lead.on_host_lost(),
            Self::Task(task) => {
                let finite = match *task {
                    Task::Regulate { goal, within } => goal.is_finite() && within.is_valid(),
                    Task::Drive {
                        speed_m_s,
                        curvature,
                    } => {
                        bends(curvature)?;
                        (speed_m_s + curvature).is_finite()
                    }
                    Task::Follow { within } | Task::Track { within } => within.is_valid(),
                    Task::Idle | Task::Stop | Task::Clear => true,
                };
                match finite {
                    true => lead.command(*task),
                    false => return Err(PathError::NotFinite),
                }
            }
            Self::Path { points, end } => {
                let path = lead.path_task();
                points.iter().flatten().try_for_each(|point| {
                    bends(point.kappa)?;
                    path.push_path_point(*point)
                })?;
                if *end {
                    path.finish_path();
                }
            }
            Self::Trajectory { points, end } => {
                let path = lead.path_task();
                points.iter().flatten().try_for_each(|point| {
                    bends(point.point.kappa)?;
                    path.push_trajectory_point(*point)
                })?;
                if *end {
                    path.finish_trajectory();
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
