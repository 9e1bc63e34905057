//! Commands of the host to the lead node.

use core_algos::control::path::{PathPoint, TrajectoryPoint};
use core_algos::link::Order;
use core_algos::link::protocol::{POINTS, Placement};
use core_algos::node::lead::Task;
use serde::{Deserialize, Serialize};

/// Command to the lead node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum HostCommand {
    /// Task for the lead node.
    Task(Task),
    /// Further points of the path.
    Path {
        /// Points, at most the free room of the buffer.
        points: Vec<PathPoint>,
        /// True if the path ends with these points.
        end: bool,
    },
    /// Further points of the trajectory.
    Trajectory {
        /// Points, at most the free room of the buffer.
        points: Vec<TrajectoryPoint>,
        /// True if the trajectory ends with these points.
        end: bool,
    },
    /// Posture of the robot, at rest with its motors off.
    SetPose(Placement),
    /// The commanding host timed out; the board itself issues this command.
    Lost,
}

impl HostCommand {
    /// Orders of the link that execute the command.
    pub fn orders(&self) -> Vec<Order> {
        match self {
            Self::Task(task) => vec![Order::Task(*task)],
            Self::SetPose(placement) => vec![Order::SetPose(*placement)],
            Self::Lost => vec![Order::Lost],
            Self::Path { points, end } => {
                batches(points, *end, |points, end| Order::Path { points, end })
            }
            Self::Trajectory { points, end } => batches(points, *end, |points, end| {
                Order::Trajectory { points, end }
            }),
        }
    }

    /// Name of the command in error texts.
    pub fn subject(&self) -> &'static str {
        match self {
            Self::Task(Task::Drive { .. }) => "speed",
            Self::Task(_) => "task",
            Self::SetPose(_) => "posture",
            Self::Lost => "lost",
            Self::Path { .. } => "path",
            Self::Trajectory { .. } => "trajectory",
        }
    }
}

impl From<Order> for HostCommand {
    fn from(order: Order) -> Self {
        match order {
            Order::SetPose(placement) => Self::SetPose(placement),
            Order::Lost => Self::Lost,
            Order::Task(task) => Self::Task(task),
            Order::Path { points, end } => Self::Path {
                points: points.into_iter().flatten().collect(),
                end,
            },
            Order::Trajectory { points, end } => Self::Trajectory {
                points: points.into_iter().flatten().collect(),
                end,
            },
        }
    }
}

/// Orders of at most [`POINTS`] points each; one order without points if there are no points.
fn batches<T: Copy>(
    points: &[T],
    end: bool,
    order: impl Fn([Option<T>; POINTS], bool) -> Order,
) -> Vec<Order> {
    let count = points.len().div_ceil(POINTS).max(1);
    let batch = |k: usize| {
        let points = std::array::from_fn(|i| points.get(k * POINTS + i).copied());
        order(points, end && k + 1 == count)
    };
    (0..count).map(batch).collect()
}
