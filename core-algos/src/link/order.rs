//! Orders of a host for the lead node.

use super::protocol::{POINTS, Place, Request};
use crate::control::path::{PathError, PathPoint, TrajectoryPoint};
use crate::node::lead::{LeadNode, Task};

/// Share of the curvature's bound that a point may exceed it by, for rounding.
const ROUNDING: f32 = 1e-3;

/// A request to the lead node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Posture of the robot, at rest.
    Place(Place),
    /// Task.
    Task(Task),
    /// Points to append to the path, and whether they are the last.
    Path([Option<PathPoint>; POINTS], bool),
    /// Points to append to the trajectory, and whether they are the last.
    Trajectory([Option<TrajectoryPoint>; POINTS], bool),
}

impl Order {
    /// The order in a request; `None` if it is for another.
    pub fn of(request: &Request) -> Option<Self> {
        match *request {
            Request::Place(place) => Some(Self::Place(place)),
            Request::Command(task) => Some(Self::Task(task)),
            Request::Path { points, end } => Some(Self::Path(points, end)),
            Request::Trajectory { points, end } => Some(Self::Trajectory(points, end)),
            _ => None,
        }
    }

    /// Hands it to the node. Points after one that the node refuses are not taken.
    pub fn carry_out(&self, lead: &mut LeadNode) -> Result<(), PathError> {
        let bound = (1.0 + ROUNDING) * lead.cascade().max_curvature();
        let bends = |kappa: f32| match kappa.abs() > bound {
            true => Err(PathError::TooTight),
            false => Ok(()),
        };
        match self {
            Self::Place(place) => lead.initialize(&place.center, &place.relative),
            Self::Task(task) => lead.command(*task),
            Self::Path(points, end) => {
                let path = lead.path_task();
                points.iter().flatten().try_for_each(|point| {
                    bends(point.kappa)?;
                    path.push_path_point(*point)
                })?;
                if *end {
                    path.finish_path();
                }
            }
            Self::Trajectory(points, end) => {
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
